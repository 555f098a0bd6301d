//! Why a clip could not be opened or written, each as one sentence with the mend.

use std::io;
use std::path::PathBuf;

use thiserror::Error;

/// Why there is no clip.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum CaptureError {
    /// Nothing is at the path.
    #[error("the clip {} does not exist; check its path", path.display())]
    NotFound {
        /// The clip.
        path: PathBuf,
    },
    /// The file or folder cannot be read.
    #[error("cannot read {}: {source}; {}", path.display(), if source.kind() == io::ErrorKind::Other { "give a clip in plain files, or - for y4m on standard input" } else { "check its permissions" })]
    NotReadable {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The clip has no rows.
    #[error("the clip {} is empty; give a clip with at least one picture", path.display())]
    Empty {
        /// The clip.
        path: PathBuf,
    },
    /// A folder without pictures that are read, but with others.
    #[error("the clip {} has no JPEG, PNG or PGM pictures, but {found}", path.display())]
    OtherPictures {
        /// The folder.
        path: PathBuf,
        /// How many of which form, with the mend.
        found: String,
    },
    /// The clip has rows, but none of them is a picture.
    #[error("no frame of the clip {} is readable ({rows} rows; the first: {reason}); check that its pictures are whole", path.display())]
    NoFrameReadable {
        /// The clip.
        path: PathBuf,
        /// How many rows it has.
        rows: u64,
        /// What is wrong with the first.
        reason: String,
    },
    /// The first line of timestamps.csv is not EuRoC's.
    #[error("{} line 1 is \"{found}\"; write \"#timestamp [ns],filename\" there", path.display())]
    TimestampsHeader {
        /// The csv file.
        path: PathBuf,
        /// What the line says, shortened.
        found: String,
    },
    /// A line of timestamps.csv names a file that is none of the clip's.
    #[error("{} line {line} names \"{name}\", which lies outside of the clip; name pictures in its folder frames", path.display())]
    OutsideClip {
        /// The csv file.
        path: PathBuf,
        /// From 1.
        line: usize,
        /// The name, shortened.
        name: String,
    },
    /// The stream's header is broken, or speaks of pictures that are not read here.
    #[error("{}: {reason}", path.display())]
    Stream {
        /// The file.
        path: PathBuf,
        /// What is wrong, with the mend.
        reason: String,
    },
    /// The file says no frame rate.
    #[error("the clip {} does not tell its frame rate; give it with --fps", path.display())]
    RateUnknown {
        /// The clip.
        path: PathBuf,
    },
    /// The given frame rate is no rate.
    #[error("the frame rate {fps} is not possible; give --fps a number above 0 and up to 1000000")]
    Rate {
        /// As given.
        fps: f64,
    },
    /// The file needs ffmpeg, and there is none.
    #[error("reading {} needs the program ffmpeg, which is not installed; install it or convert the clip to .y4m", path.display())]
    FfmpegMissing {
        /// The file.
        path: PathBuf,
    },
    /// ffmpeg did not deliver pictures.
    #[error("ffmpeg cannot read {}: {reason}; convert the clip to .y4m", path.display())]
    FfmpegFailed {
        /// The file.
        path: PathBuf,
        /// ffmpeg's last words.
        reason: String,
    },
    /// The file ends before what its pictures are found by.
    #[error("the recording {} was cut off, and there is no picture in it that can be read (ffmpeg: {reason}); take another recording, and stop the next one before its program or camera is switched off", path.display())]
    CutOff {
        /// The file.
        path: PathBuf,
        /// What ffmpeg says.
        reason: String,
    },
    /// A clip could not be written.
    #[error("cannot write {}: {reason}; check the folder's permissions and free space", path.display())]
    NotWritable {
        /// The file or folder.
        path: PathBuf,
        /// What went wrong.
        reason: String,
    },
}

impl CaptureError {
    /// Not found or not readable, by what the system said about `path`.
    pub(super) fn reading(path: &std::path::Path, source: io::Error) -> Self {
        let path = path.to_owned();
        if source.kind() == io::ErrorKind::NotFound { Self::NotFound { path } } else { Self::NotReadable { path, source } }
    }
}
