//! Calibration files: stagepose's own TOML, OpenCV and ROS YAML, EuRoC sensor YAML and Bouguet's
//! Calib_Results.m.
//!
//! Each format has one file here that turns text into a [`Calibration`]. This file recognises the
//! format and adds the path and the line number to errors.

mod bouguet;
mod foreign;
mod opencv;
mod problem;
pub(crate) mod slips;
mod stagepose;
mod window;
mod write_yaml;
mod yaml;

use std::path::Path;

use super::doubt::IntrinsicsUncertainty;
use super::model::{CameraModel, Intrinsics};
use super::{plausible, utf16};
pub use problem::{CalibrationFileError, CalibrationProblem};
use problem::{Fault, fault};

/// The content of a calibration file.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Calibration {
    /// The camera.
    pub model: CameraModel,
    /// Uncertainty of each parameter, if the file states it.
    pub uncertainty: Option<IntrinsicsUncertainty>,
    /// Reprojection error per point, sqrt(mean(dx² + dy²)), pixels.
    pub rms_px: Option<f64>,
    /// Number of pictures used for the calibration.
    pub images: Option<u32>,
    /// When it was made, as written in the file.
    pub date: Option<String>,
    /// The format it was read from.
    pub form: CalibrationForm,
    /// Remarks on how the file was read, one sentence each.
    pub notes: Vec<String>,
}

/// The supported formats.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum CalibrationForm {
    /// stagepose's own TOML.
    Stagepose,
    /// OpenCV's FileStorage YAML.
    OpenCv,
    /// ROS camera_info YAML.
    Ros,
    /// EuRoC / Kalibr sensor YAML.
    Euroc,
    /// Calib_Results.m of Bouguet's toolbox.
    Bouguet,
}

impl Calibration {
    /// Creates a calibration of which only the camera is known.
    pub fn new(model: CameraModel) -> Self {
        Self { model, uncertainty: None, rms_px: None, images: None, date: None, form: CalibrationForm::Stagepose, notes: Vec::new() }
    }

    /// Writes stagepose's own format; reading it back returns bit-identical numbers.
    pub fn to_toml(&self) -> String {
        stagepose::write(self)
    }

    /// Writes OpenCV's FileStorage YAML (which cannot hold uncertainties).
    pub fn to_opencv_yaml(&self) -> String {
        write_yaml::opencv(self)
    }

    /// Writes ROS's camera_info YAML for a camera of this name (which cannot hold uncertainties).
    pub fn to_ros_yaml(&self, camera_name: &str) -> String {
        write_yaml::ros(self, camera_name)
    }
}

/// Errors and uncertainties a file may state, in the units of their parameters; far beyond any
/// camera's. Raised until their squares overflow, covariances become NaN; lowered, vague
/// calibrations are refused.
const POSSIBLE_ERRORS: std::ops::RangeInclusive<f64> = 0.0..=1e5;

/// Reads the bytes of a calibration file in any [`CalibrationForm`]. `path` is used only for its
/// extension and in messages.
///
/// # Errors
/// When the bytes are not a calibration; the message names the file, the line and the key.
pub fn parse_calibration(bytes: &[u8], path: &Path) -> Result<Calibration, CalibrationFileError> {
    let bytes = &*utf16::as_utf8(bytes);
    // Comments in other encodings are common in files of other programs; stagepose's own are UTF-8.
    let is_ours = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("toml"));
    if let Err(e) = std::str::from_utf8(bytes).map_err(|e| e.valid_up_to()) {
        let line = 1 + bytes[..e].iter().filter(|b| **b == b'\n').count();
        let problem = CalibrationProblem::Syntax { reason: "there is a character that is not UTF-8".to_owned() };
        if is_ours {
            return Err(CalibrationFileError::at(path, Fault { line: Some(line), problem }));
        }
    }
    let text = String::from_utf8_lossy(bytes);
    let text = text.strip_prefix('\u{feff}').unwrap_or(&text);
    let parsed = match recognise(text, path) {
        Some(Grammar::Toml) => stagepose::parse(text),
        Some(Grammar::Yaml) => opencv::parse(text),
        Some(Grammar::Matlab) => bouguet::parse(text),
        None => Err(fault(CalibrationProblem::UnknownForm)),
    };
    parsed.map_err(|f| CalibrationFileError::at(path, f))
}

/// The grammar of a text.
enum Grammar {
    Toml,
    Yaml,
    Matlab,
}

/// Chooses the grammar by extension, else by content.
fn recognise(text: &str, path: &Path) -> Option<Grammar> {
    match path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase).as_deref() {
        Some("toml") => return Some(Grammar::Toml),
        Some("yaml" | "yml") => return Some(Grammar::Yaml),
        Some("m") => return Some(Grammar::Matlab),
        _ => {}
    }
    if text.starts_with("%YAML") || text.contains("!!opencv-matrix") {
        return Some(Grammar::Yaml);
    }
    let starts = |key: &str, sign: char| {
        text.lines().any(|l| l.trim_start().strip_prefix(key).is_some_and(|rest| rest.trim_start().starts_with(sign)))
    };
    if starts("fc", '=') {
        Some(Grammar::Matlab)
    } else if starts("fx", '=') {
        Some(Grammar::Toml)
    } else if ["camera_matrix", "K", "intrinsics", "image_width"].iter().any(|key| starts(key, ':')) {
        Some(Grammar::Yaml)
    } else {
        None
    }
}

/// Builds the camera model; errors carry the line of the wrong key, which `line_of(key)` looks up.
fn model(intrinsics: Intrinsics, line_of: impl Fn(&str) -> Option<usize>) -> Result<CameraModel, Fault> {
    use super::model::CameraError::{Aspect, FocalLength, Implausible, NotFinite, NotInvertible, Size};
    let possible = CameraModel::new(intrinsics).and_then(|model| plausible::judge(&model).map(|_| model));
    possible.map_err(|e| {
        let key = match e {
            NotFinite { name, .. } | FocalLength { name, .. } | Implausible { name, .. } => name,
            NotInvertible { .. } => "distortion",
            Size { width: 0, .. } => "width",
            Size { .. } | Aspect { .. } => "height",
        };
        let line = line_of(key.split(' ').next().unwrap_or(key));
        Fault { line, problem: CalibrationProblem::Camera(e) }
    })
}

#[cfg(test)]
mod tests;
