//! A report: one zip with all that is needed to find out what went wrong.
//!
//! Versions, the config with the calibrations that it names, what reading it comes to, what a running daemon says of itself, and of the
//! newest recording and of the ring events, records and their counts. Each part is taken as far as it can be read: a report is
//! made where something is wrong, so nothing that is missing or broken stops it. Pictures show people: they go in only on request.

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

/// More than any config has, bytes: a round figure, so that a wrong file is refused instead of read into memory.
const MOST_CONFIG_BYTES: u64 = 16 << 20;

/// What a report is made of.
pub struct Report<'a> {
    /// The config's file.
    pub config: &'a Path,
    /// Its text; it may be a bad one.
    pub text: Vec<u8>,
    /// What reading it came to.
    pub settings: &'a Result<Settings, ConfigError>,
    /// What a running daemon says of itself: names in the report, and texts.
    pub said: Vec<(&'static str, String)>,
    /// What is taken of the recorder's folder.
    pub recordings: Vec<Recording>,
    /// Seconds of pictures from the end of each recording, and the stage's artwork; none of both where there is no number.
    pub picture_seconds: Option<f64>,
}

/// The text of a config.
///
/// # Errors
/// What the system says, or that it is larger than a config.
pub fn config_text(file: &Path) -> io::Result<Vec<u8>> {
    safe_file::read(file, MOST_CONFIG_BYTES)
}

impl Report<'_> {
    /// Writes the zip and gives the list of what is in it.
    ///
    /// # Errors
    /// Where it cannot be written.
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

/// Program, time and machine.
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
    // Serialising to a string fails only for non-string map keys, of which there are none.
    serde_json::to_string_pretty(&crate::capture::v4l2::devices()).expect("a listing has only string keys")
}
