//! The configuration: turns what the user typed into what the program uses.
//!
//! A config file is TOML (contract C5). [`as_typed`] holds it as it stands in the file, every value
//! with its place, so that messages can name the line. [`Settings`] is the result after every value
//! has been checked and every named file has been read: a camera, pictures, surfaces, tunables.
//! Nothing is written back. Unknown keys are refused, because an ignored misspelt key looks exactly
//! like a tracker that does not work.

#[cfg(feature = "cli")]
mod artwork;
pub mod as_typed;
mod bodies;
mod error;
mod filter;
mod fixed;
mod http;
mod known_keys;
mod lens;
pub mod mapped;
mod measured;
mod mount;
mod named_files;
mod named_points;
mod origin;
mod other_tracker;
#[cfg(test)]
mod output_tests;
mod outputs;
mod parse;
mod protocols;
mod rehearsal;
mod rotation;
mod settings;
pub mod shape_file;
mod shutter;
mod source;
mod stage_origin;
#[cfg(test)]
mod stage_words_tests;
pub mod surveyed;
#[cfg(test)]
mod tests;
mod timecode;
mod transfer;
mod typed_values;
mod values;

pub use error::{ConfigError, Problem};
pub use http::{HostName, HttpSettings};
pub use lens::LensSource;
pub use named_files::{FileKind, files_named_in, named_below};
pub use other_tracker::OtherTrackerSettings;
pub use settings::{LOG_LEVELS, LogFormat, LogSettings, RecorderSettings, Settings};
pub use source::{ConfigSource, read_calibration};
pub use timecode::{TimecodeInput, TimecodeSettings};
