//! Parses a config file's text into a [`Config`]: first the checks that name a line, then TOML's
//! own types.

use std::ops::Range;
use std::path::Path;

use toml::de::{DeTable, DeValue};

use super::as_typed::Config;
use super::known_keys::{not_toml, place_type_error, refuse_first, refuse_unknown, section_name};
use super::origin::Origin;
use super::{ConfigError, Problem};
use crate::printable::{printable, stands_for_itself};

impl Config {
    /// Reads the text of a config file; `file` is used in messages only.
    ///
    /// # Errors
    /// [`ConfigError::Syntax`], [`ConfigError::Unknown`], or [`ConfigError::Value`] with a
    /// [`Problem::Type`](super::Problem::Type).
    pub fn parse(text: &str, file: &Path) -> Result<Self, ConfigError> {
        let origin = Origin::new(file, text);
        let table = DeTable::parse(text).map_err(|e| not_toml(&e, &origin))?;
        refuse_control_characters(table.get_ref(), &origin)?;
        refuse_unknown(table.get_ref(), &origin)?;
        toml::from_str(text).map_err(|e| place_type_error(table.get_ref(), &origin, &e))
    }
}

/// Refuses the first key or text in the file that has a control or invisible character.
///
/// A config's names and files appear in records, packets, lines and logs. Characters that a
/// terminal obeys, or that make one name look like another, must not get there; they are refused
/// here once, with their line.
fn refuse_control_characters(root: &DeTable<'_>, origin: &Origin<'_>) -> Result<(), ConfigError> {
    refuse_first(root, |path, key, key_span, value| {
        let in_key = (!is_plain(key)).then(|| (key_span.clone(), key.to_owned()));
        let (span, text) = in_key.or_else(|| text_with_one(value, key_span))?;
        let problem = Problem::Characters(printable(&text).into_owned());
        Some((span.start, origin.value(&section_name(path), &printable(key), &span, problem)))
    })
}

fn is_plain(text: &str) -> bool {
    text.chars().all(stands_for_itself)
}

/// Returns the text in a value, or in its arrays, that has such a character. Tables are visited
/// separately.
fn text_with_one(value: &DeValue<'_>, span: Range<usize>) -> Option<(Range<usize>, String)> {
    match value {
        DeValue::String(text) if !is_plain(text) => Some((span, text.clone().into_owned())),
        DeValue::Array(items) => items.iter().find_map(|item| text_with_one(item.get_ref(), item.span())),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use crate::config::as_typed::Config;

    #[test]
    fn terminal_control_characters_are_refused_with_their_line() {
        for (text, parts) in [
            ("[camera]\ncalibration = \"a\\u001b[2J.toml\"\n", ["line 2", "`calibration` in [camera]", "\"a\\u001b[2J.toml\""]),
            ("[log]\n[[object]]\nname = \"p\\u202Eq\"\n", ["line 3", "`name` in [[object]]", "\"p\\u202eq\""]),
            ("[[output]]\nbodies = [\"a\", \"\\u009b\"]\n", ["line 2", "`bodies` in [[output]]", "\"\\u009b\""]),
            ("[camera]\ncontrols = { \"a\\nb\" = 1 }\n", ["line 2", "`a\\nb` in [camera.controls]", "\"a\\nb\""]),
            ("[stage]\n[[stage.surface]]\nimage = \"\"\"a\nb\"\"\"\n", ["line 3", "`image` in [[stage.surface]]", "\"a\\nb\""]),
        ] {
            let refusal = Config::parse(text, Path::new("stage.toml")).unwrap_err().to_string();
            parts.iter().for_each(|part| assert!(refusal.contains(part), "`{part}` is not in {refusal}"));
        }
        assert!(Config::parse("[camera]\ncalibration = \"Bühne/舞台.toml\"\n", Path::new("stage.toml")).is_ok());
    }
}
