//! The text of a config file becomes a [`Config`]: first come the refusals that name a line, then TOML's own types.

use std::path::Path;

use super::ConfigError;
use super::as_typed::Config;
use super::origin::Origin;
use super::{characters, known_keys};

impl Config {
    /// Reads the text of a config file; `file` is used in messages only.
    ///
    /// # Errors
    /// [`ConfigError::Syntax`], [`ConfigError::Unknown`], or [`ConfigError::Value`] with a
    /// [`Problem::Type`](super::Problem::Type).
    pub fn parse(text: &str, file: &Path) -> Result<Self, ConfigError> {
        let origin = Origin::new(file, text);
        let table = toml::de::DeTable::parse(text).map_err(|e| origin.syntax(&e))?;
        characters::refuse_control_characters(table.get_ref(), &origin)?;
        known_keys::refuse_unknown(table.get_ref(), &origin)?;
        toml::from_str(text).map_err(|e| known_keys::place_type_error(table.get_ref(), &origin, &e))
    }
}
