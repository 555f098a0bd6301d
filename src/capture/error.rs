//! Errors of opening or writing a clip, each one sentence with a hint for the fix.

use std::io;
use std::path::PathBuf;

use thiserror::Error;

/// Why a clip cannot be opened or written.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum CaptureError {
    /// The path does not exist.
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
        /// The system's error.
        source: io::Error,
    },
    /// The clip has no rows.
    #[error("the clip {} is empty; give a clip with at least one picture", path.display())]
    Empty {
        /// The clip.
        path: PathBuf,
    },
    /// The folder has pictures, but none in a supported format.
    #[error("the clip {} has no JPEG, PNG or PGM pictures, but {found}", path.display())]
    OtherPictures {
        /// The folder.
        path: PathBuf,
        /// Counts by format, with a hint for the fix.
        found: String,
    },
    /// The clip has rows, but none of them is a readable picture.
    #[error("no frame of the clip {} is readable ({rows} rows; the first: {reason}); check that its pictures are whole", path.display())]
    NoFrameReadable {
        /// The clip.
        path: PathBuf,
        /// Number of rows.
        rows: u64,
        /// What is wrong with the first row.
        reason: String,
    },
    /// The first line of timestamps.csv is not EuRoC's header.
    #[error("{} line 1 is \"{found}\"; write \"#timestamp [ns],filename\" there", path.display())]
    TimestampsHeader {
        /// The csv file.
        path: PathBuf,
        /// The line found, shortened.
        found: String,
    },
    /// A line of timestamps.csv names a file outside the clip.
    #[error("{} line {line} names \"{name}\", which lies outside of the clip; name pictures in its folder frames", path.display())]
    OutsideClip {
        /// The csv file.
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// The name, shortened.
        name: String,
    },
    /// The stream's header is broken, or describes pictures that are not supported.
    #[error("{}: {reason}", path.display())]
    Stream {
        /// The file.
        path: PathBuf,
        /// What is wrong, with a hint for the fix.
        reason: String,
    },
    /// The file states no frame rate.
    #[error("the clip {} does not state its frame rate; give it with --fps", path.display())]
    RateUnknown {
        /// The clip.
        path: PathBuf,
    },
    /// The given frame rate is out of range.
    #[error("the frame rate {fps} is not possible; give --fps a number above 0 and up to 1000000")]
    Rate {
        /// The rate as given.
        fps: f64,
    },
    /// The file needs ffmpeg, which is not installed.
    #[error("reading {} needs the program ffmpeg, which is not installed; install it or convert the clip to .y4m", path.display())]
    FfmpegMissing {
        /// The file.
        path: PathBuf,
    },
    /// ffmpeg delivered no pictures.
    #[error("ffmpeg cannot read {}: {reason}; convert the clip to .y4m", path.display())]
    FfmpegFailed {
        /// The file.
        path: PathBuf,
        /// ffmpeg's first complaint.
        reason: String,
    },
    /// The file ends before the index that is needed to find its pictures.
    #[error("the recording {} was cut off, and there is no picture in it that can be read (ffmpeg: {reason}); take another recording, and stop the next one before its program or camera is switched off", path.display())]
    CutOff {
        /// The file.
        path: PathBuf,
        /// ffmpeg's complaint.
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
    /// Returns `NotFound` or `NotReadable`, depending on the system's error for `path`.
    pub(super) fn reading(path: &std::path::Path, source: io::Error) -> Self {
        let path = path.to_owned();
        if source.kind() == io::ErrorKind::NotFound { Self::NotFound { path } } else { Self::NotReadable { path, source } }
    }
}
