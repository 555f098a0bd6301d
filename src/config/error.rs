//! Why a config is refused: always the file, the line, the key, what is wrong and how to fix it.

use std::path::PathBuf;

use thiserror::Error;

use crate::camera::{CalibrationFileError, CameraError};
use crate::capture::DecodeError;
use crate::track::SurfaceError;

/// Why a config is refused.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// The config file itself cannot be read.
    #[error("{}: the config cannot be read ({reason}); name a readable TOML file with --config", file.display())]
    Unreadable {
        /// The config file.
        file: PathBuf,
        /// The system's error.
        reason: String,
    },
    /// The text is not TOML.
    #[error("{}: line {line} is not TOML: {reason}", file.display())]
    Syntax {
        /// The config file.
        file: PathBuf,
        /// Line, counted from 1.
        line: usize,
        /// The parser's message.
        reason: String,
    },
    /// An unknown key or section.
    #[error("{}: unknown {what}, line {line}; {hint}", file.display())]
    Unknown {
        /// The config file.
        file: PathBuf,
        /// Line, counted from 1.
        line: usize,
        /// "key \`x\` in \[y\]", or "section \[x\]".
        what: String,
        /// The nearest known name, or all known names.
        hint: String,
    },
    /// A required key is missing.
    #[error("{}: {section} has no `{key}`; add {hint}", file.display())]
    Missing {
        /// The config file.
        file: PathBuf,
        /// The section, with its line if it has one.
        section: String,
        /// The key.
        key: &'static str,
        /// An example of the key.
        hint: &'static str,
    },
    /// A value that cannot be used.
    #[error("{}: `{key}` in {section}, line {line}: {problem}", file.display())]
    Value {
        /// The config file.
        file: PathBuf,
        /// Line, counted from 1.
        line: usize,
        /// The section in its brackets.
        section: String,
        /// The key.
        key: String,
        /// What is wrong with it.
        problem: Box<Problem>,
    },
    /// The clip's or device's pictures do not fit the calibration.
    #[error("{}: `calibration` in [camera], line {line}: {problem}", file.display())]
    PictureSize {
        /// The config file.
        file: PathBuf,
        /// Line, counted from 1.
        line: usize,
        /// Why they do not fit.
        problem: CameraError,
    },
}

/// What is wrong with a value.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum Problem {
    /// Wrong TOML type, or wrong number of entries.
    #[error("{0}")]
    Type(String),
    /// A text with control or invisible characters, escaped here.
    #[error(
        "\"{0}\" has control or invisible characters; write it without them (in quotes a backslash begins one: a path may have / on every system)"
    )]
    Characters(String),
    /// A value out of range.
    #[error("{value} cannot be used; give {wanted}")]
    Range {
        /// The value as typed.
        value: String,
        /// What is allowed.
        wanted: &'static str,
    },
    /// A word that is not one of the known ones.
    #[error("`{value}` cannot be used; give {wanted}{}", nearest.as_ref().map_or(String::new(), |word| format!("; did you mean `{word}`?")))]
    Word {
        /// The word as typed.
        value: String,
        /// The known words.
        wanted: &'static str,
        /// The word that was probably meant.
        nearest: Option<String>,
    },
    /// A quaternion whose length is not 1.
    #[error("the length of the quaternion is {0:.4}, not 1; give x, y, z, w of a unit quaternion")]
    Quaternion(f64),
    /// A section that may occur several times, in single brackets.
    #[error("this section can occur several times, so it needs double brackets; write {0}")]
    SingleBrackets(&'static str),
    /// A section that may occur once, in double brackets.
    #[error("this section occurs only once, so it needs single brackets; write {0}")]
    DoubleBrackets(&'static str),
    /// Two keys that exclude or require each other.
    #[error("{0}")]
    Combination(&'static str),
    /// Two bodies with the same name.
    #[error("the name `{0}` is taken; give each object a name of its own (`stage` is the stage itself)")]
    DuplicateName(String),
    /// An object that receivers cannot tell from the camera.
    #[error("`{0}` is the outputs' name for the camera itself, and one output sends both; give the object another name")]
    NamedAsCamera(String),
    /// An invalid address template.
    #[error("{0}")]
    Template(crate::publish::osc::TemplateError),
    /// An output's address, port or interface that is not available on this machine.
    #[error("{0}")]
    Transport(crate::publish::TransportError),
    /// The HTTP server's address is taken or not this machine's.
    #[error("cannot listen on {address} ({reason}); give a free port on an address of this machine")]
    Listen {
        /// The address.
        address: std::net::SocketAddr,
        /// The system's error.
        reason: String,
    },
    /// A picture file that cannot be opened.
    #[error("{}: {reason}; name a readable PNG, JPEG or PGM picture", file.display())]
    PictureFile {
        /// The picture.
        file: PathBuf,
        /// The system's error.
        reason: String,
    },
    /// A shape file that cannot be opened.
    #[error("{}: {reason}; name a shape file of `stagepose survey`", file.display())]
    ShapeFile {
        /// The file.
        file: PathBuf,
        /// The system's error.
        reason: String,
    },
    /// A shape file that does not fit.
    #[error("{}: {reason}", file.display())]
    ShapeContent {
        /// The file.
        file: PathBuf,
        /// What is wrong with it.
        reason: super::shape_file::ShapeFileError,
    },
    /// A map file that cannot be opened.
    #[error("{}: {reason}; name a map of `stagepose map`", file.display())]
    MapFile {
        /// The file.
        file: PathBuf,
        /// The system's error.
        reason: String,
    },
    /// A map file that cannot be used.
    #[error("{}: {reason}", file.display())]
    MapContent {
        /// The file.
        file: PathBuf,
        /// What is wrong with it.
        reason: crate::track::MapFileError,
    },
    /// A picture file that is not a picture.
    #[error("{}: {reason}", file.display())]
    PictureContent {
        /// The picture.
        file: PathBuf,
        /// The decoder's error.
        reason: DecodeError,
    },
    /// A picture whose raw pixels are needed has an EXIF rotation.
    #[error(
        "{}: the file says to show it {words} (EXIF), but {pixels} the pixels as stored in the file; remove that mark (exiftool \
         -Orientation= FILE) and read them from the picture as it then appears",
        file.display()
    )]
    PictureTurned {
        /// The picture.
        file: PathBuf,
        /// How it is to be shown.
        words: &'static str,
        /// What uses the raw pixels.
        pixels: &'static str,
    },
    /// An output file that is also an input.
    #[error("{}: the config reads this file, which would be overwritten; give another name", .0.display())]
    OutputIsInput(PathBuf),
    /// A file that cannot be written.
    #[error("{}: {reason}; give the name of a file in a writable folder", file.display())]
    OutputFile {
        /// The file.
        file: PathBuf,
        /// Why it cannot be written.
        reason: String,
    },
    /// A picture that cannot be tracked.
    #[error("{}: {reason}", file.display())]
    Surface {
        /// The picture.
        file: PathBuf,
        /// Why it cannot be tracked.
        reason: SurfaceError,
    },
    /// A calibration file that cannot be used (its message names the file).
    #[error("{0}")]
    Calibration(Box<CalibrationFileError>),
    /// A calibration that does not fit its picture.
    #[error("{0}")]
    Camera(CameraError),
    /// A mask with another aspect ratio than the camera's pictures.
    #[error(
        "the mask {} is {width} x {height} pixels, the camera {camera_width} x {camera_height}; paint it on a picture of the camera",
        file.display()
    )]
    MaskSize {
        /// The mask.
        file: PathBuf,
        /// Its width in pixels.
        width: u32,
        /// Its height in pixels.
        height: u32,
        /// The camera's width in pixels.
        camera_width: u32,
        /// The camera's height in pixels.
        camera_height: u32,
    },
    /// A global shutter, which exposes all rows together, with a readout time.
    #[error("a global shutter exposes all rows together, but `readout_s` is {0}; remove one of the two")]
    GlobalShutterReads(f64),
    /// A mask that hides everything.
    #[error("the mask {} is black everywhere, so nothing could be tracked; leave white what to use", .0.display())]
    MaskBlack(PathBuf),
}
