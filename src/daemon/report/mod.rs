//! A report: one zip with everything needed to find a fault.
//!
//! It has versions, the config with its calibrations, the result of reading it, what a running
//! daemon says about itself, and events, records and their counts from the newest recording and the
//! ring. A report is made when something is wrong, so a missing or broken part does not stop it.
//! Pictures show people: they are included only on request.

mod bundle;
mod machine;
mod recordings;

use std::io::{self, Write};
use std::path::Path;

use crate::config::{ConfigError, FileKind, Settings, files_named_in};
use crate::safe_file;
use crate::utc;
use bundle::Bundle;
pub use recordings::{Recording, find};

/// Maximum size of a config, bytes: a round figure above any, so that a wrong file is refused and
/// not read into memory.
const MAX_CONFIG_BYTES: u64 = 16 << 20;

/// The content of a report.
pub struct Report<'a> {
    /// The config file.
    pub config: &'a Path,
    /// Its text; it may be invalid.
    pub text: Vec<u8>,
    /// The result of reading it.
    pub settings: &'a Result<Settings, ConfigError>,
    /// What a running daemon says about itself: names in the report, and texts.
    pub said: Vec<(&'static str, String)>,
    /// The recordings to include.
    pub recordings: Vec<Recording>,
    /// Seconds of pictures from the end of each recording, plus the stage's artwork; `None`
    /// includes neither.
    pub picture_seconds: Option<f64>,
}

/// Reads a config's text.
///
/// # Errors
/// The system's error, or that the file is too large for a config.
pub fn config_text(file: &Path) -> io::Result<Vec<u8>> {
    safe_file::read(file, MAX_CONFIG_BYTES)
}

impl Report<'_> {
    /// Writes the zip and returns its list of contents.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write(&self, to: impl Write) -> io::Result<Vec<String>> {
        let mut bundle = Bundle::begin(to);
        bundle.add("about.txt", about())?;
        #[cfg(feature = "live")]
        bundle.add("devices.json", devices())?;
        bundle.add("config/stage.toml", &self.text)?;
        let verdict = match self.settings {
            Ok(settings) => settings.notes.iter().fold("good\n".to_owned(), |text, note| text + note + "\n"),
            Err(problem) => format!("{problem}\n"),
        };
        bundle.add("config/verdict.txt", &verdict)?;
        let named = files_named_in(&String::from_utf8_lossy(&self.text), self.config);
        for (number, (file, kind)) in named.iter().enumerate() {
            let name = file.file_name().unwrap_or_default().to_string_lossy();
            if self.picture_seconds.is_some() || *kind != FileKind::Picture {
                bundle.add_file(&format!("config/{number}-{name}"), file)?;
            }
        }
        self.said.iter().try_for_each(|(name, text)| bundle.add(name, text))?;
        self.recordings.iter().try_for_each(|recording| recording.add(&mut bundle, self.picture_seconds))?;
        bundle.finish()
    }
}

fn about() -> String {
    let features = [("live", cfg!(feature = "live")), ("http", cfg!(feature = "http"))];
    let features: Vec<&str> = features.into_iter().filter_map(|(name, is_on)| is_on.then_some(name)).collect();
    format!(
        "stagepose {} ({})\nmade {}\n{}",
        env!("CARGO_PKG_VERSION"),
        if features.is_empty() { "no features".to_owned() } else { features.join(", ") },
        utc::date_and_time(utc::now_s()),
        machine::describe()
    )
}

#[cfg(feature = "live")]
fn devices() -> String {
    // Serialising to a string fails only for non-string map keys, and a listing has none.
    serde_json::to_string_pretty(&crate::capture::v4l2::devices()).expect("a listing has only string keys")
}
