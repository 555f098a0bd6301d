//! Where a value stands: turns byte spans of the config's text into lines, and lines into messages.

use std::cell::RefCell;
use std::ops::Range;
use std::path::{Path, PathBuf};

use super::source::FilesRead;
use super::{ConfigError, Problem};
use crate::camera::slips;

/// A config's file name and text, and what was read of the files that it names.
pub(super) struct Origin<'a> {
    pub file: &'a Path,
    text: &'a str,
    pub files: FilesRead,
    /// What is to be said of the files that were read, a sentence each.
    pub remarks: RefCell<Vec<String>>,
    /// What every command warns of, a sentence each.
    pub warnings: RefCell<Vec<String>>,
}

impl<'a> Origin<'a> {
    pub fn new(file: &'a Path, text: &'a str) -> Self {
        Self { file, text, files: FilesRead::default(), remarks: RefCell::default(), warnings: RefCell::default() }
    }

    /// The 1-based line of a byte span's start.
    pub fn line(&self, span: &Range<usize>) -> usize {
        let before = &self.text.as_bytes()[..span.start.min(self.text.len())];
        1 + before.iter().filter(|&&b| b == b'\n').count()
    }

    /// A file name in the config, relative to the config's own folder.
    pub fn beside(&self, name: &str) -> PathBuf {
        self.file.parent().unwrap_or(Path::new("")).join(name)
    }

    pub fn syntax(&self, error: &toml::de::Error) -> ConfigError {
        self.syntax_with(error, None)
    }

    /// The same with words on what to do, where they are known.
    pub fn syntax_with(&self, error: &toml::de::Error, hint: Option<String>) -> ConfigError {
        let span = error.span().unwrap_or(0..0);
        let words = one_line(error.message());
        let hint = hint.or_else(|| slips::what_to_type(self.text, span.start));
        let reason = hint.map_or(words.clone(), |hint| format!("{words}; {hint}"));
        ConfigError::Syntax { file: self.file.to_owned(), line: self.line(&span), reason }
    }

    /// The section in single brackets that begins there for the second time, and the line of the
    /// first.
    pub fn section_again(&self, at: usize) -> Option<(&str, usize)> {
        let name = slips::single_section(self.text, at)?;
        let start = self.text.get(..at)?.rfind('\n').map_or(0, |newline| newline + 1);
        let lines = self.text[..start].split_inclusive('\n');
        let mut earlier = lines.scan(0, |at, line| Some(std::mem::replace(at, *at + line.len())));
        let first = earlier.find(|at| slips::single_section(self.text, *at) == Some(name))?;
        Some((name, self.line(&(first..first))))
    }

    /// A type error's words, and what to type.
    pub fn type_words(&self, error: &toml::de::Error) -> String {
        let words = one_line(error.message());
        let wanted = words.rsplit_once("expected an array of ").and_then(|(_, rest)| rest.split(' ').next()?.parse().ok());
        let hint = wanted.zip(error.span()).and_then(|(wanted, span)| slips::points_for_commas(self.text, span, wanted));
        hint.map_or(words.clone(), |hint| format!("{words}; {hint}"))
    }

    pub fn value(&self, section: &str, key: &str, span: &Range<usize>, problem: Problem) -> ConfigError {
        ConfigError::Value {
            file: self.file.to_owned(),
            line: self.line(span),
            section: section.to_owned(),
            key: key.to_owned(),
            problem: Box::new(problem),
        }
    }

    /// `section` may carry its own line ("[[object]], line 7,"), since a missing key has none.
    pub fn missing(&self, section: String, key: &'static str, mend: &'static str) -> ConfigError {
        ConfigError::Missing { file: self.file.to_owned(), section, key, mend }
    }

    /// A section's name followed by the line on which it begins.
    pub fn section_at(&self, section: &str, span: &Range<usize>) -> String {
        format!("{section}, line {},", self.line(span))
    }
}

/// Parser messages may span lines; ours are one sentence.
pub(super) fn one_line(message: &str) -> String {
    message.lines().map(str::trim).filter(|l| !l.is_empty()).collect::<Vec<_>>().join("; ")
}
