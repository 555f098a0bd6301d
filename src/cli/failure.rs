//! How a command fails: an error sentence and an exit code.

use std::io;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use thiserror::Error;

use crate::capture::CaptureError;
use crate::config::ConfigError;
use crate::publish::PublishError;

/// Exit code for bad usage or config, as shells and clap use it. Every other failure is 1.
pub(super) const USAGE: u8 = 2;

/// Why a command failed.
#[derive(Debug, Error)]
pub enum Failure {
    /// The arguments are wrong or inconsistent.
    #[error("{0}")]
    Usage(String),
    /// The config, or a file it names, cannot be used.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The tracker cannot be set up.
    #[error(transparent)]
    Setup(#[from] crate::tracker::SetupError),
    /// The clip cannot be read.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// No frame of the clip could be read.
    #[error("{}: none of its {rows} frames could be read{}; check the clip", clip.display(), first.as_ref().map_or(String::new(), |r| format!(" (the first: {r})")))]
    NoFrame {
        /// The clip.
        clip: PathBuf,
        /// Number of rows in it.
        rows: u64,
        /// Why the first row could not be read.
        first: Option<String>,
    },
    /// An output cannot be created or written.
    #[error("{}: cannot be written ({source}); give a writable path with free space", file.display())]
    Output {
        /// The file.
        file: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// A recording would be mixed with an earlier one; holds the first existing file.
    #[error("{}: exists already and would be overwritten; give a new folder", .0.display())]
    ClipIsThere(PathBuf),
    /// Pictures would overwrite others or be mixed with them.
    #[error("{}: holds pictures that no earlier --overlay wrote; give a new folder", .0.display())]
    FolderIsUsed(PathBuf),
    /// `check` found something wrong with a config or clip; the report has all findings.
    #[error("{}: {reason}", file.display())]
    Check {
        /// The clip if the stage is not followed in it, otherwise the config.
        file: PathBuf,
        /// The worst finding, with its fix.
        reason: String,
    },
    /// The camera cannot be used.
    #[error("the camera: {0}")]
    Device(String),
    /// An output or the HTTP server cannot be started (the message names it).
    #[error("{0}")]
    Publishing(String),
    /// A signal arrived before the first frame.
    #[error("interrupted before the first frame of the clip; nothing was tracked")]
    Interrupted,
    /// A recording ended early.
    #[error("the recording ended early: {0}")]
    Recording(String),
    /// The demo ended early.
    #[error("{0}")]
    Demo(String),
    /// The pictures yield no calibration, or none that should be used.
    #[error("{0}")]
    Calibration(String),
    /// A picture cannot be read.
    #[error("{}: cannot be read as a picture: {reason}", file.display())]
    Picture {
        /// The file.
        file: PathBuf,
        /// The decoder's error.
        reason: String,
    },
    /// Two pictures could not be compared.
    #[error("{0}")]
    Comparison(String),
    /// A walk yields no survey, or none that should be used.
    #[error("{0}")]
    Survey(String),
    /// Poses cannot be exported.
    #[error("{}: {reason}", file.display())]
    Export {
        /// The file of poses.
        file: PathBuf,
        /// What is wrong with it, and the fix.
        reason: String,
    },
    /// A sound, or a recording's timecode, cannot be read, or has no timecode.
    #[error("{}: {reason}", file.display())]
    Timecode {
        /// The file.
        file: PathBuf,
        /// What is wrong with it, and the fix.
        reason: String,
    },
    /// Two clips yield no mount.
    #[error("{0}")]
    Mount(String),
    /// Two clips yield no delay, or none that should be used.
    #[error("{0}")]
    Delay(String),
    /// Two logs cannot be compared, or do not agree.
    #[error("{0}")]
    PoseComparison(String),
    /// A clip does not say where its camera stands.
    #[error("{0}")]
    Standing(String),
    /// The browser pairing code is missing.
    #[error("{0}")]
    Pairing(String),
    /// The tracker or one of its threads failed.
    #[error("tracking failed: {0}")]
    Tracking(String),
}

impl From<PublishError> for Failure {
    fn from(error: PublishError) -> Self {
        Self::Publishing(error.to_string())
    }
}

impl Failure {
    /// Returns a closure for `map_err` that makes an I/O error a [`Failure::Output`].
    pub fn output(file: &Path) -> impl FnOnce(io::Error) -> Self + '_ {
        move |source| Self::Output { file: file.to_owned(), source }
    }

    /// Whether the reader closed our output pipe, which is not an error.
    pub fn is_closed_pipe(&self) -> bool {
        match self {
            Self::Output { source, .. } => source.kind() == io::ErrorKind::BrokenPipe,
            _ => false,
        }
    }

    /// Returns the exit code, 1 or 2 (contract C1).
    pub fn exit_code(&self) -> ExitCode {
        ExitCode::from(match self {
            Self::Usage(_) | Self::Config(_) | Self::Setup(_) => USAGE,
            _ => 1,
        })
    }
}
