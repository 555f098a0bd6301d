//! Why a config is refused: always the file, the line, the key, what is wrong and what to do.

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
        /// What the system says.
        reason: String,
    },
    /// The text is not TOML.
    #[error("{}: line {line} is not TOML: {reason}", file.display())]
    Syntax {
        /// The config file.
        file: PathBuf,
        /// 1-based.
        line: usize,
        /// The parser's words.
        reason: String,
    },
    /// A key or section that nobody reads.
    #[error("{}: unknown {what}, line {line}; {mend}", file.display())]
    Unknown {
        /// The config file.
        file: PathBuf,
        /// 1-based.
        line: usize,
        /// "key \`x\` in \[y\]", or "section \[x\]".
        what: String,
        /// The nearest known name, or all of them.
        mend: String,
    },
    /// Something that must be there is not.
    #[error("{}: {section} has no `{key}`; add {mend}", file.display())]
    Missing {
        /// The config file.
        file: PathBuf,
        /// The section, with its line where it has one.
        section: String,
        /// The key.
        key: &'static str,
        /// An example of it.
        mend: &'static str,
    },
    /// A value that cannot be used.
    #[error("{}: `{key}` in {section}, line {line}: {problem}", file.display())]
    Value {
        /// The config file.
        file: PathBuf,
        /// 1-based.
        line: usize,
        /// The section in its brackets.
        section: String,
        /// The key.
        key: String,
        /// What is wrong with it.
        problem: Box<Problem>,
    },
    /// The clip's or the device's pictures do not fit the calibration.
    #[error("{}: `calibration` in [camera], line {line}: {problem}", file.display())]
    PictureSize {
        /// The config file.
        file: PathBuf,
        /// 1-based.
        line: usize,
        /// Why.
        problem: CameraError,
    },
}

/// What is wrong with a value.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum Problem {
    /// Another TOML type, or another number of entries.
    #[error("{0}")]
    Type(String),
    /// A text with characters that do not stand for themselves; escaped here.
    #[error(
        "\"{0}\" has control or invisible characters; write it without them (in quotes a backslash begins one: a path may have / on every system)"
    )]
    Characters(String),
    /// Outside of what can be used.
    #[error("{value} cannot be used; give {wanted}")]
    Range {
        /// As typed.
        value: String,
        /// What is allowed.
        wanted: &'static str,
    },
    /// A word that is none of the known ones.
    #[error("`{value}` cannot be used; give {wanted}{}", nearest.as_ref().map_or(String::new(), |word| format!("; did you mean `{word}`?")))]
    Word {
        /// As typed.
        value: String,
        /// The known ones.
        wanted: &'static str,
        /// The one that was meant, probably.
        nearest: Option<String>,
    },
    /// A quaternion whose length is not 1.
    #[error("the length of the quaternion is {0:.4}, not 1; give x, y, z, w of a unit quaternion")]
    Quaternion(f64),
    /// A section of which there may be several, in single brackets.
    #[error("there may be several of these sections, so they stand in double brackets; write {0}")]
    SingleBrackets(&'static str),
    /// A section of which there is one, in double brackets.
    #[error("there is only one of this section, so it stands in single brackets; write {0}")]
    DoubleBrackets(&'static str),
    /// Two keys that exclude or demand one another.
    #[error("{0}")]
    Combination(&'static str),
    /// Two bodies of the same name.
    #[error("the name `{0}` is taken; give each object a name of its own (`stage` is the stage itself)")]
    DuplicateName(String),
    /// An object that receivers cannot tell from the camera.
    #[error("`{0}` is what outputs call the camera itself, and one of them sends both; give the object another name")]
    NamedAsCamera(String),
    /// An address template with a fault.
    #[error("{0}")]
    Template(crate::publish::osc::TemplateError),
    /// An output's address, port or interface that this machine does not give.
    #[error("{0}")]
    Transport(crate::publish::TransportError),
    /// The HTTP server's address is taken or not this machine's.
    #[error("cannot listen on {address} ({reason}); give a free port on an address of this machine")]
    Listen {
        /// Where.
        address: std::net::SocketAddr,
        /// What the system says.
        reason: String,
    },
    /// A picture file that cannot be opened.
    #[error("{}: {reason}; name a readable PNG, JPEG or PGM picture", file.display())]
    PictureFile {
        /// The picture.
        file: PathBuf,
        /// What the system says.
        reason: String,
    },
    /// A shape file that cannot be opened.
    #[error("{}: {reason}; name a shape file of `stagepose survey`", file.display())]
    ShapeFile {
        /// The file.
        file: PathBuf,
        /// What the system says.
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
    /// A picture file that is no picture.
    #[error("{}: {reason}", file.display())]
    PictureContent {
        /// The picture.
        file: PathBuf,
        /// What the decoder says.
        reason: DecodeError,
    },
    /// A picture of which raw pixels are wanted is to be shown turned.
    #[error(
        "{}: the file says to show it {words} (EXIF), but {pixels} the pixels as they lie in the file; remove that mark (exiftool -Orientation= FILE) and take them from the picture as it then shows",
        file.display()
    )]
    PictureTurned {
        /// The picture.
        file: PathBuf,
        /// How it is to be shown.
        words: &'static str,
        /// What goes by raw pixels.
        pixels: &'static str,
    },
    /// A file that is written is one that is read.
    #[error("{}: the config reads this file, which would be written over; give another name", .0.display())]
    OutputIsInput(PathBuf),
    /// A file that cannot be written.
    #[error("{}: {reason}; give the name of a file in a folder that may be written", file.display())]
    OutputFile {
        /// The file.
        file: PathBuf,
        /// Why not.
        reason: String,
    },
    /// A picture that cannot be tracked.
    #[error("{}: {reason}", file.display())]
    Surface {
        /// The picture.
        file: PathBuf,
        /// Why.
        reason: SurfaceError,
    },
    /// A calibration file that cannot be used (its message names the file).
    #[error("{0}")]
    Calibration(Box<CalibrationFileError>),
    /// A calibration that does not fit its picture.
    #[error("{0}")]
    Camera(CameraError),
    /// A mask of another shape than the camera's pictures.
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
    /// A shutter that exposes all rows together, and reads them one after the other.
    #[error("a global shutter exposes all rows together, but `readout_s` is {0}; remove one of the two")]
    GlobalShutterReads(f64),
    /// A mask that leaves nothing to look at.
    #[error("the mask {} is black everywhere, so that nothing could be tracked; leave white what is to be seen", .0.display())]
    MaskBlack(PathBuf),
}
