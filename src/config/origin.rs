//! Positions of values: turns byte spans of the config's text into lines, and lines into messages.

use std::cell::RefCell;
use std::ops::Range;
use std::path::{Path, PathBuf};

use super::source::FilesRead;
use super::{ConfigError, Problem};
use crate::camera::slips;

/// A config's file name and text, and the content of the files it names.
pub(super) struct Origin<'a> {
    pub file: &'a Path,
    text: &'a str,
    pub files: FilesRead,
    /// Notes on the files that were read, one sentence each.
    pub remarks: RefCell<Vec<String>>,
    /// Warnings that every command prints, one sentence each.
    pub warnings: RefCell<Vec<String>>,
}

impl<'a> Origin<'a> {
    pub fn new(file: &'a Path, text: &'a str) -> Self {
        Self { file, text, files: FilesRead::default(), remarks: RefCell::default(), warnings: RefCell::default() }
    }

    /// Returns the line of a byte span's start, counted from 1.
    pub fn line(&self, span: &Range<usize>) -> usize {
        let before = &self.text.as_bytes()[..span.start.min(self.text.len())];
        1 + before.iter().filter(|&&b| b == b'\n').count()
    }

    /// Resolves a file name in the config relative to the config's folder.
    pub fn beside(&self, name: &str) -> PathBuf {
        self.file.parent().unwrap_or(Path::new("")).join(name)
    }

    pub fn syntax(&self, error: &toml::de::Error) -> ConfigError {
        self.syntax_with(error, None)
    }

    /// As [`syntax`](Self::syntax), with a hint if one is known.
    pub fn syntax_with(&self, error: &toml::de::Error, hint: Option<String>) -> ConfigError {
        let span = error.span().unwrap_or(0..0);
        let words = one_line(error.message());
        let hint = hint.or_else(|| slips::what_to_type(self.text, span.start));
        let reason = hint.map_or(words.clone(), |hint| format!("{words}; {hint}"));
        ConfigError::Syntax { file: self.file.to_owned(), line: self.line(&span), reason }
    }

    /// Returns the single-bracket section that starts there for the second time, and the line of
    /// the first.
    pub fn section_again(&self, at: usize) -> Option<(&str, usize)> {
        let name = slips::single_section(self.text, at)?;
        let start = self.text.get(..at)?.rfind('\n').map_or(0, |newline| newline + 1);
        let lines = self.text[..start].split_inclusive('\n');
        let mut earlier = lines.scan(0, |at, line| Some(std::mem::replace(at, *at + line.len())));
        let first = earlier.find(|at| slips::single_section(self.text, *at) == Some(name))?;
        Some((name, self.line(&(first..first))))
    }

    /// Returns a type error's message, with a hint on what to type.
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

    /// Returns the error for a missing key. `section` may include its line ("[[object]], line 7,"),
    /// since a missing key has none.
    pub fn missing(&self, section: String, key: &'static str, hint: &'static str) -> ConfigError {
        ConfigError::Missing { file: self.file.to_owned(), section, key, hint }
    }

    /// Returns a section's name with the line on which it starts.
    pub fn section_at(&self, section: &str, span: &Range<usize>) -> String {
        format!("{section}, line {},", self.line(span))
    }
}

/// Joins the lines of a parser's message: our messages are one sentence.
pub(super) fn one_line(message: &str) -> String {
    message.lines().map(str::trim).filter(|l| !l.is_empty()).collect::<Vec<_>>().join("; ")
}
