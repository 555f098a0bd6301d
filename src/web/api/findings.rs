//! The findings about a config, as a list that a page can show: the errors for which it is refused,
//! or else warnings and notes.

use std::io::ErrorKind;
use std::path::Path;

use serde::Serialize;

use crate::config::{ConfigError, LensSource, Settings};
use crate::daemon::Supervisor;
use crate::diagnose::{Finding as Diagnosed, Grade, of_corners, of_layout, of_lens, of_shutter};
use crate::safe_file;

/// Maximum size of a config, bytes. A round figure, the same as for the file itself.
pub(super) const MAX_CONFIG: u64 = 4 << 20;

/// One finding.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(super) struct Finding {
    /// `error` (the config cannot be used), `warning` or `note`.
    pub level: &'static str,
    /// The key concerned, if any.
    pub key: Option<String>,
    /// Its line in the config, counted from 1.
    pub line: Option<usize>,
    /// What is wrong.
    pub sentence: String,
    /// How to fix it.
    #[serde(rename = "mend")]
    pub hint: Option<String>,
}

/// Splits a message into sentence and fix. By this project's convention the fix follows the last
/// semicolon.
fn parts(message: &str) -> (String, Option<String>) {
    match message.rsplit_once("; ") {
        Some((sentence, hint)) => (sentence.to_owned(), Some(hint.to_owned())),
        None => (message.to_owned(), None),
    }
}

fn refused(error: &ConfigError) -> Finding {
    let (key, line) = match error {
        ConfigError::Syntax { line, .. } | ConfigError::Unknown { line, .. } => (None, Some(*line)),
        ConfigError::Missing { section, key, .. } => (Some(format!("{section} {key}")), None),
        ConfigError::Value { section, key, line, .. } => (Some(format!("{section} {key}")), Some(*line)),
        ConfigError::PictureSize { line, .. } => (Some("[camera] calibration".to_owned()), Some(*line)),
        _ => (None, None),
    };
    let (sentence, hint) = parts(&error.to_string());
    Finding { level: "error", key, line, sentence, hint }
}

/// Returns what is wrong with the config file, if there is no config to track with or the former
/// one stays in force. Returns nothing if the file's config is in use.
pub(super) fn of_refused(supervisor: &Supervisor) -> Vec<Finding> {
    if supervisor.settings().is_some() && supervisor.refusal().is_none() {
        return Vec::new();
    }
    let error = |text: &str| {
        let (sentence, hint) = parts(text);
        vec![Finding { level: "error", key: None, line: None, sentence, hint }]
    };
    let file = supervisor.file();
    let read = safe_file::read(&supervisor.keeping().current(), MAX_CONFIG).map(String::from_utf8);
    match read {
        Err(e) if e.kind() == ErrorKind::NotFound => error(&format!("{}: there is no config yet; put one", file.display())),
        Err(e) => error(&format!("{}: the config cannot be read ({e}); let the daemon's user read it", file.display())),
        Ok(Err(_)) => error(&format!("{}: the config is not UTF-8 text; put another one", file.display())),
        Ok(Ok(text)) => match (judged(&text, file), supervisor.refusal()) {
            ((None, findings), _) => findings,
            ((Some(_), _), Some(refusal)) => error(&refusal),
            // The file was corrected, but has not been reloaded.
            ((Some(_), _), None) => error(&format!("{}: the config is good, and was not read again yet; put it again", file.display())),
        },
    }
}

fn odd(found: &Diagnosed) -> Finding {
    let level = match found.grade {
        Grade::Note => "note",
        _ => "warning",
    };
    let (sentence, hint) = parts(&found.message);
    Finding { level, key: None, line: None, sentence, hint }
}

/// As [`judged`], and also checks whether this machine provides all that the config requires, as
/// `run` does when it switches to the config.
pub(super) fn judged_to_run(text: &str, file: &Path, supervisor: &Supervisor) -> (Option<Settings>, Vec<Finding>) {
    match judged(text, file) {
        (Some(settings), findings) => match supervisor.rehearse(&settings) {
            Ok(()) => (Some(settings), findings),
            Err(error) => (None, vec![refused(&error)]),
        },
        none => none,
    }
}

/// Parses a config's text as if it were in `file`. Returns the settings, if it can be used, and the
/// findings.
pub(super) fn judged(text: &str, file: &Path) -> (Option<Settings>, Vec<Finding>) {
    let settings = match Settings::from_text(text, file) {
        Ok(settings) => settings,
        Err(error) => return (None, vec![refused(&error)]),
    };
    let mut found: Vec<Diagnosed> = settings.warnings.iter().map(Diagnosed::warning).collect();
    found.extend(of_lens(&settings.camera));
    for body in std::iter::once(&settings.stage).chain(&settings.objects) {
        found.extend(of_layout(body));
        found.extend(of_corners(body, matches!(settings.lens, LensSource::Guess(..))));
    }
    if let Some(fps) = settings.device.fps {
        found.extend(of_shutter(&settings.shutter.or_zero(), 1.0 / fps));
    }
    found.extend(settings.notes.iter().map(Diagnosed::note));
    found.sort_by_key(|finding| finding.grade);
    let findings = found.iter().map(odd).collect();
    (Some(settings), findings)
}
