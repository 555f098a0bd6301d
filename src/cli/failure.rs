//! How a command ends when it does not succeed: a sentence and an exit code.

use std::io;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use thiserror::Error;

use crate::capture::CaptureError;
use crate::config::ConfigError;
use crate::publish::PublishError;

/// Exit code of bad usage or config: what shells and clap use for it. Every other failure is 1.
pub(super) const USAGE: u8 = 2;

/// Why a command did not succeed.
#[derive(Debug, Error)]
pub enum Failure {
    /// The arguments do not fit together.
    #[error("{0}")]
    Usage(String),
    /// The config, or something that it names, cannot be used.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The tracker cannot be set up.
    #[error(transparent)]
    Setup(#[from] crate::tracker::SetupError),
    /// The clip cannot be read.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// Not one frame of the clip could be read.
    #[error("{}: none of its {rows} frames could be read{}; check the clip", clip.display(), first.as_ref().map_or(String::new(), |r| format!(" (the first: {r})")))]
    NoFrame {
        /// The clip.
        clip: PathBuf,
        /// Rows in it.
        rows: u64,
        /// Why the first one could not.
        first: Option<String>,
    },
    /// An output cannot be created or written.
    #[error("{}: cannot be written ({source}); give a path with room that may be written", file.display())]
    Output {
        /// The file.
        file: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// A recording would be mixed with another one; holds what is there of it.
    #[error("{}: is there already and would be written over; give a new folder", .0.display())]
    ClipIsThere(PathBuf),
    /// Pictures would be written over, or mixed with others.
    #[error("{}: holds pictures that are not of an earlier --overlay; give a new folder", .0.display())]
    FolderIsUsed(PathBuf),
    /// A config or a clip was checked, and something is wrong with it (the report has all of it).
    #[error("{}: {reason}", file.display())]
    Check {
        /// The clip where the stage is not followed in it, else the config.
        file: PathBuf,
        /// The worst finding, with its mend.
        reason: String,
    },
    /// The camera cannot be used.
    #[error("the camera: {0}")]
    Device(String),
    /// An output or the HTTP server cannot be started (the message names it).
    #[error("{0}")]
    Publishing(String),
    /// A signal came before there was anything to show.
    #[error("interrupted before the first frame of the clip came; nothing was tracked")]
    Interrupted,
    /// A recording ended before its time.
    #[error("the recording ended early: {0}")]
    Recording(String),
    /// The demo ended early.
    #[error("{0}")]
    Demo(String),
    /// The pictures make no calibration, or none that should be used.
    #[error("{0}")]
    Calibration(String),
    /// A picture cannot be read.
    #[error("{}: cannot be read as a picture: {reason}", file.display())]
    Picture {
        /// The file.
        file: PathBuf,
        /// What the decoder says.
        reason: String,
    },
    /// Two pictures were not compared.
    #[error("{0}")]
    Comparison(String),
    /// A walk makes no survey, or none that should be used.
    #[error("{0}")]
    Survey(String),
    /// Two clips tell no mount.
    #[error("{0}")]
    Mount(String),
    /// The code that pairs a browser is not there.
    #[error("{0}")]
    Pairing(String),
    /// The tracker or one of its threads gave up.
    #[error("tracking failed: {0}")]
    Tracking(String),
}

impl From<PublishError> for Failure {
    fn from(error: PublishError) -> Self {
        Self::Publishing(error.to_string())
    }
}

impl Failure {
    /// An output that cannot be written, for `map_err`.
    pub fn output(file: &Path) -> impl FnOnce(io::Error) -> Self + '_ {
        move |source| Self::Output { file: file.to_owned(), source }
    }

    /// True where the reader of our output left, which is their right.
    pub fn is_closed_pipe(&self) -> bool {
        match self {
            Self::Output { source, .. } => source.kind() == io::ErrorKind::BrokenPipe,
            _ => false,
        }
    }

    /// 1 or 2 (contract C1).
    pub fn exit_code(&self) -> ExitCode {
        ExitCode::from(match self {
            Self::Usage(_) | Self::Config(_) | Self::Setup(_) => USAGE,
            _ => 1,
        })
    }
}
