//! What can be wrong with a calibration file, each as one sentence with the mend.

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
        /// What the system said.
        source: std::io::Error,
    },
    /// The text is no calibration.
    #[error("{}{}: {problem}", path.display(), line.map(|l| format!(" line {l}")).unwrap_or_default())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// The line, from 1, where one is to blame.
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
    /// None of the forms fits.
    #[error(
        "this is no calibration file that is known here; give stagepose TOML (.toml), OpenCV or ROS YAML (.yaml, .yml) or Bouguet's Calib_Results.m"
    )]
    UnknownForm,
    /// The TOML, YAML or m-file grammar is broken.
    #[error("{reason}; mend the file's syntax")]
    Syntax {
        /// What the parser said.
        reason: String,
    },
    /// A key that must be there is not.
    #[error("`{key}` is missing; add it ({hint})")]
    MissingKey {
        /// The key.
        key: String,
        /// What belongs there.
        hint: &'static str,
    },
    /// A key that nobody reads.
    #[error("`{key}` is not a calibration key; did you mean `{nearest}`?")]
    UnknownKey {
        /// As typed.
        key: String,
        /// The known key most like it.
        nearest: String,
    },
    /// A value of the wrong type.
    #[error("`{key}` holds {found}; write {expected}")]
    WrongType {
        /// The key.
        key: String,
        /// What it holds.
        found: String,
        /// What it should hold.
        expected: &'static str,
    },
    /// An array of the wrong length.
    #[error("`{key}` has {found} numbers; write {expected}")]
    WrongLength {
        /// The key.
        key: String,
        /// How many numbers it has.
        found: usize,
        /// How many it should have.
        expected: &'static str,
    },
    /// A number out of its range.
    #[error("`{key}` is {value}; write {expected}")]
    OutOfRange {
        /// The key.
        key: String,
        /// What it holds.
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
    /// A window of the sensor of which the numbers cannot be told.
    #[error("{0}; write the numbers of the pictures as they come: width, height and a matrix of the window, and a `roi` of zeros")]
    Window(String),
    /// A form of another program that is not read.
    #[error("this is a file of {program}, whose form is not read; {mend}")]
    OtherProgram {
        /// The program.
        program: &'static str,
        /// What to do.
        mend: &'static str,
    },
    /// ROS's way to say that nobody has calibrated the camera.
    #[error(
        "`{key}` is all zeros, which is how ROS says that this camera has not been calibrated; calibrate it (`stagepose calibrate`, or ROS's camera_calibration) and give that file"
    )]
    NotCalibrated {
        /// The key.
        key: String,
    },
    /// The numbers are no camera.
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

/// A key that is not there. Its line is the first: there it may be added in every form.
pub(super) fn missing(key: &str, hint: &'static str) -> Fault {
    Fault { line: Some(1), problem: CalibrationProblem::MissingKey { key: key.to_owned(), hint } }
}
