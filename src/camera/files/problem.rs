//! Errors of calibration files, each as one sentence with the fix.

use std::path::{Path, PathBuf};

use thiserror::Error;

use crate::camera::CameraError;

/// Why a calibration file was not read.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum CalibrationFileError {
    /// The file is missing or cannot be read.
    #[error("cannot read the calibration file {}: {source}; check its path and permissions", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The I/O error.
        source: std::io::Error,
    },
    /// The text is not a valid calibration.
    #[error("{}{}: {problem}", path.display(), line.map(|l| format!(" line {l}")).unwrap_or_default())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// The line at fault, from 1, if there is one.
        line: Option<usize>,
        /// What is wrong.
        problem: CalibrationProblem,
    },
}

impl CalibrationFileError {
    pub(super) fn at(path: &Path, Fault { line, problem }: Fault) -> Self {
        Self::Malformed { path: path.to_owned(), line, problem }
    }
}

/// What is wrong with a calibration's text.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum CalibrationProblem {
    /// The text has no known format.
    #[error(
        "this is not a known kind of calibration file; give stagepose TOML (.toml), OpenCV or ROS YAML (.yaml, .yml) or Bouguet's \
         Calib_Results.m"
    )]
    UnknownForm,
    /// The TOML, YAML or m-file grammar is broken.
    #[error("{reason}; fix the file's syntax")]
    Syntax {
        /// The parser's message.
        reason: String,
    },
    /// A required key is missing.
    #[error("`{key}` is missing; add it ({hint})")]
    MissingKey {
        /// The key.
        key: String,
        /// What it should hold.
        hint: &'static str,
    },
    /// An unknown key.
    #[error("`{key}` is not a calibration key; did you mean `{nearest}`?")]
    UnknownKey {
        /// The key as typed.
        key: String,
        /// The most similar known key.
        nearest: String,
    },
    /// A value has the wrong type.
    #[error("`{key}` holds {found}; write {expected}")]
    WrongType {
        /// The key.
        key: String,
        /// What it holds.
        found: String,
        /// What it should hold.
        expected: &'static str,
    },
    /// An array has the wrong length.
    #[error("`{key}` has {found} numbers; write {expected}")]
    WrongLength {
        /// The key.
        key: String,
        /// Its number of elements.
        found: usize,
        /// The required number of elements.
        expected: &'static str,
    },
    /// A number is out of range.
    #[error("`{key}` is {value}; write {expected}")]
    OutOfRange {
        /// The key.
        key: String,
        /// The number.
        value: f64,
        /// What it should hold.
        expected: &'static str,
    },
    /// A lens model that is not Brown's with five coefficients.
    #[error("the lens model is {model}, which is not supported; calibrate again with the 5-coefficient model (k1, k2, p1, p2, k3)")]
    UnsupportedModel {
        /// The model.
        model: String,
    },
    /// A sensor window whose parameters are ambiguous or impossible.
    #[error("{0}; write the numbers of the pictures as they come: width, height and a matrix of the window, and a `roi` of zeros")]
    Window(String),
    /// An unsupported format of another program.
    #[error("this is a file of {program}, whose format is not supported; {hint}")]
    OtherProgram {
        /// The program.
        program: &'static str,
        /// What to do.
        hint: &'static str,
    },
    /// ROS's way of saying that the camera is not calibrated.
    #[error(
        "`{key}` is all zeros, which is how ROS says that this camera has not been calibrated; calibrate it (`stagepose calibrate`, or ROS's camera_calibration) and give that file"
    )]
    NotCalibrated {
        /// The key.
        key: String,
    },
    /// The numbers do not describe a camera.
    #[error("{0}; correct it or calibrate again")]
    Camera(CameraError),
}

/// A problem and its line, before the path is known.
#[derive(Debug)]
pub(super) struct Fault {
    pub line: Option<usize>,
    pub problem: CalibrationProblem,
}

/// A fault of the file as a whole.
pub(super) fn fault(problem: CalibrationProblem) -> Fault {
    Fault { line: None, problem }
}

/// A missing key. Reported at line 1, where it can be added in every format.
pub(super) fn missing(key: &str, hint: &'static str) -> Fault {
    Fault { line: Some(1), problem: CalibrationProblem::MissingKey { key: key.to_owned(), hint } }
}
