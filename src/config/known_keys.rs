//! The known keys of every section; refuses all others and suggests the nearest known name.

use std::ops::Range;

use serde::Deserialize;
use serde::de::{self, Visitor};
use serde::forward_to_deserialize_any;
use toml::de::{DeTable, DeValue};

use super::as_typed;
use super::origin::Origin;
use super::{ConfigError, Problem};

/// Returns a section's keys, from its typed form.
type Keys = fn() -> &'static [&'static str];

/// Every section of this version: its path, its name in messages, its keys.
const SECTIONS: [(&[&str], &str, Keys); 26] = [
    (&[], "the config", fields::<as_typed::Config>),
    (&["camera"], "[camera]", fields::<as_typed::Camera>),
    (&["camera", "pose"], "[camera.pose]", fields::<as_typed::CameraPose>),
    (&["stage"], "[stage]", fields::<as_typed::Stage>),
    (&["stage", "surface"], "[[stage.surface]]", fields::<as_typed::Surface>),
    (&["stage", "map"], "[stage.map]", fields::<as_typed::MapOfStage>),
    (&["object"], "[[object]]", fields::<as_typed::Object>),
    (&["object", "surface"], "[[object.surface]]", fields::<as_typed::Surface>),
    (&["survey"], "[survey]", fields::<as_typed::Survey>),
    (&["survey", "distance"], "[[survey.distance]]", fields::<as_typed::SurveyDistance>),
    (&["survey", "point"], "[[survey.point]]", fields::<as_typed::SurveyPoint>),
    (&["map"], "[map]", fields::<as_typed::Map>),
    (&["map", "point"], "[[map.point]]", fields::<as_typed::MapPoint>),
    (&["map", "point", "seen"], "[[map.point.seen]]", fields::<as_typed::MapClick>),
    (&["map", "distance"], "[[map.distance]]", fields::<as_typed::MapDistance>),
    (&["mount"], "[mount]", fields::<as_typed::Mount>),
    (&["tracker"], "[tracker]", fields::<as_typed::Tracker>),
    (&["timecode"], "[timecode]", fields::<as_typed::Timecode>),
    (&["other_tracker"], "[other_tracker]", fields::<as_typed::OtherTracker>),
    (&["filter"], "[filter]", fields::<as_typed::Filter>),
    (&["safety"], "[safety]", fields::<as_typed::Safety>),
    (&["output"], "[[output]]", fields::<as_typed::Output>),
    (&["output", "value"], "[[output.value]]", fields::<as_typed::OutputValue>),
    (&["http"], "[http]", fields::<as_typed::Http>),
    (&["recorder"], "[recorder]", fields::<as_typed::Recorder>),
    (&["log"], "[log]", fields::<as_typed::Log>),
];

/// Returns every section below the config with its keys, as in messages:
/// `("[camera]", ["calibration", …])`.
pub(super) fn known_keys() -> impl Iterator<Item = (&'static str, &'static [&'static str])> {
    SECTIONS.into_iter().skip(1).map(|(_, name, keys)| (name, keys()))
}

/// Returns the name and keys of the section at a path, or `None` if any key is allowed (driver
/// controls).
fn section(path: &[&str]) -> Option<(&'static str, &'static [&'static str])> {
    SECTIONS.into_iter().find(|(known, ..)| *known == path).map(|(_, name, keys)| (name, keys()))
}

/// Returns the section at a path as written in messages.
pub(super) fn section_name(path: &[&str]) -> String {
    section(path).map_or_else(|| format!("[{}]", path.join(".")), |(name, _)| name.to_owned())
}

/// Refuses the first unknown key in the file.
pub(super) fn refuse_unknown(root: &DeTable<'_>, origin: &Origin<'_>) -> Result<(), ConfigError> {
    refuse_first(root, |path, key, span, value| Some((span.start, refusal(path, key, &span, value, origin)?)))
}

/// Refuses the first item in the file that `judge` rejects; `judge` also returns the place of its
/// refusal.
pub(super) fn refuse_first(
    root: &DeTable<'_>,
    mut judge: impl FnMut(&[&str], &str, Range<usize>, &DeValue<'_>) -> Option<(usize, ConfigError)>,
) -> Result<(), ConfigError> {
    let mut found = Vec::new();
    visit(root, &mut Vec::new(), &mut |path, key, span, value| found.extend(judge(path, key, span, value)));
    found.into_iter().min_by_key(|(start, _)| *start).map_or(Ok(()), |(_, error)| Err(error))
}

fn refusal(path: &[&str], key: &str, span: &Range<usize>, value: &DeValue<'_>, origin: &Origin<'_>) -> Option<ConfigError> {
    let (name, known) = section(path)?;
    if known.contains(&key) {
        return wrong_brackets(path, key, value).map(|problem| origin.value(name, key, span, problem));
    }
    let (file, line) = (origin.file.to_owned(), origin.line(span));
    let is_section = path.is_empty() && !is_plain(value);
    let what = if is_section { format!("section [{key}]") } else { format!("key `{key}` in {name}") };
    Some(ConfigError::Unknown { file, line, what, hint: suggestion(key, name, known) })
}

/// Returns the error for a text that is not TOML, with a hint for a section that occurs twice.
pub(super) fn not_toml(error: &toml::de::Error, origin: &Origin<'_>) -> ConfigError {
    let again = error.span().and_then(|span| origin.section_again(span.start));
    let hint = again.map(|(name, line)| {
        let path: Vec<&str> = name.split('.').map(str::trim).collect();
        match section(&path).filter(|(name, _)| name.starts_with("[[")) {
            Some((double, _)) => {
                format!("this section can occur several times, so it needs double brackets; write {double} each time")
            }
            None => format!("[{name}] already exists at line {line}; write its keys there"),
        }
    });
    origin.syntax_with(error, hint)
}

/// Whether a repeatable section is in single brackets, or a unique one in double brackets.
fn wrong_brackets(path: &[&str], key: &str, value: &DeValue<'_>) -> Option<Problem> {
    let name = section(&[path, &[key]].concat())?.0;
    match (name.starts_with("[["), value) {
        (true, DeValue::Table(_)) => Some(Problem::SingleBrackets(name)),
        (false, DeValue::Array(items)) if items.iter().any(|item| item.get_ref().is_table()) => Some(Problem::DoubleBrackets(name)),
        _ => None,
    }
}

/// Whether the value is neither a table nor an array of tables.
fn is_plain(value: &DeValue<'_>) -> bool {
    match value {
        DeValue::Table(_) => false,
        DeValue::Array(items) => !items.iter().any(|item| item.get_ref().is_table()),
        _ => true,
    }
}

fn suggestion(key: &str, name: &str, known: &[&str]) -> String {
    let nearest = known.iter().map(|k| (strsim::jaro_winkler(key, k), k)).max_by(|a, b| a.0.total_cmp(&b.0));
    if let Some((likeness, nearest)) = nearest
        && likeness > 0.8
    {
        return format!("did you mean `{nearest}`?");
    }
    let elsewhere = known_keys().find(|(_, keys)| keys.contains(&key));
    match elsewhere {
        Some((other, _)) => format!("it belongs to {other}"),
        None => format!("{name} knows {}", known.join(", ")),
    }
}

/// Calls `see(path of the section, key, span of the key, value)` for every key in every table.
fn visit<'t>(table: &'t DeTable<'_>, path: &mut Vec<&'t str>, see: &mut impl FnMut(&[&str], &str, Range<usize>, &DeValue<'_>)) {
    for (key, value) in table {
        see(path, key.get_ref(), key.span(), value.get_ref());
        path.push(key.get_ref());
        match value.get_ref() {
            DeValue::Table(inner) => visit(inner, path, see),
            DeValue::Array(items) => items.iter().filter_map(|i| i.get_ref().as_table()).for_each(|t| visit(t, path, see)),
            _ => {}
        }
        path.pop();
    }
}

/// Adds key, section and line to the reader's type error.
pub(super) fn place_type_error(root: &DeTable<'_>, origin: &Origin<'_>, error: &toml::de::Error) -> ConfigError {
    let Some(span) = error.span() else { return origin.syntax(error) };
    let mut deepest: Option<(usize, String, String)> = None;
    visit(root, &mut Vec::new(), &mut |path, key, key_span, _| {
        // A value's key is the last one that starts before it.
        if key_span.start <= span.start && deepest.as_ref().is_none_or(|(start, ..)| *start <= key_span.start) {
            deepest = Some((key_span.start, section_name(path), key.to_owned()));
        }
    });
    match deepest {
        Some((_, section, key)) => origin.value(&section, &key, &span, Problem::Type(origin.type_words(error))),
        None => origin.syntax(error),
    }
}

/// Returns a struct's field names, as its `Deserialize` requests them.
fn fields<'de, T: Deserialize<'de>>() -> &'static [&'static str] {
    let mut names: &'static [&'static str] = &[];
    // The deserializer fails on purpose as soon as it has the names; the error itself is
    // meaningless.
    let _ = T::deserialize(FieldNames(&mut names));
    names
}

struct FieldNames<'a>(&'a mut &'static [&'static str]);

impl<'de> de::Deserializer<'de> for FieldNames<'_> {
    type Error = de::value::Error;

    fn deserialize_any<V: Visitor<'de>>(self, _: V) -> Result<V::Value, Self::Error> {
        Err(de::Error::custom("only field names are read here"))
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Self::Error> {
        *self.0 = fields;
        self.deserialize_any(visitor)
    }

    forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf option unit unit_struct
        newtype_struct seq tuple tuple_struct map enum identifier ignored_any
    }
}
