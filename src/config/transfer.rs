//! The key `transfer`: how a picture or the camera encodes light.

use toml::Spanned;

use super::ConfigError;
use super::values::Section;
use crate::light::Transfer;

/// Returns what the key says; `None` where it is absent.
pub(super) fn transfer(section: &Section<'_>, typed: Option<&Spanned<String>>) -> Result<Option<Transfer>, ConfigError> {
    let words = [("srgb", Some(Transfer::Srgb)), ("bt709", Some(Transfer::Bt709)), ("linear", Some(Transfer::Linear))];
    section.word("transfer", typed, None, &words, "srgb, bt709 or linear")
}
