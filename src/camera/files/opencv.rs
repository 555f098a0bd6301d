//! The YAML formats: OpenCV's FileStorage, ROS camera_info, EuRoC sensor files.
//!
//! They differ only in key names, so one reader handles all spellings. A matrix K holds the skew as
//! K\[0\]\[1\] = fx alpha_c. More than five coefficients are accepted if the rest are zero.

use super::foreign::{names_brown, refuse_other_lenses, refuse_other_programs};
use super::problem::{CalibrationProblem, Fault, missing};
use super::yaml::{self, Content, Node, whole};
use super::{Calibration, CalibrationForm, model, window};
use crate::camera::Intrinsics;

/// Names that programs use for the 3 x 3 matrix and for the coefficients; the first in this order
/// counts. The hint is for messages.
const MATRIX: [&str; 4] = ["camera_matrix", "K", "intrinsic_matrix", "M"];
const DISTORTION: [&str; 5] = ["distortion_coefficients", "dist_coeffs", "distortion_coeffs", "dist_coeff", "D"];
const DISTORTION_HINT: &str = "4 or 5 numbers k1, k2, p1, p2, k3";

pub(super) fn parse(text: &str) -> Result<Calibration, Fault> {
    let document = yaml::parse(text)?;
    // Kalibr writes one map per camera.
    let root = document.find(&["cam0"]).map_or(&document, |(_, camera)| camera);
    refuse_other_lenses(root)?;
    refuse_other_programs(root)?;
    let (width, height) = size(root)?;
    let pinhole = if root.find(&MATRIX).is_some() { from_matrix(root)? } else { from_list(root)? };
    let (distortion, four) = distortion(root)?;
    let (intrinsics, window) = window::applied(root, Intrinsics { width, height, distortion, ..pinhole })?;
    let notes = other_cameras(&document).into_iter().chain(window).chain(four).collect();
    let line_of = |key: &str| {
        let names: &[&str] = match key {
            "width" => &["image_width"],
            "height" => &["image_height"],
            "distortion" => &DISTORTION,
            _ => &["camera_matrix", "K", "intrinsic_matrix", "M", "intrinsics"],
        };
        root.find(names).map(|(_, n)| n.line)
    };
    Ok(Calibration {
        model: model(intrinsics, line_of)?,
        uncertainty: None,
        rms_px: root.find(&["avg_reprojection_error"]).and_then(|(_, n)| n.number()).filter(|v| v.is_finite() && *v >= 0.0),
        images: root.find(&["nframes", "nr_of_frames"]).and_then(|(_, n)| n.text()?.parse().ok()),
        date: root.find(&["calibration_time"]).and_then(|(_, n)| n.text().map(str::to_owned)),
        form: form(root),
        notes,
    })
}

/// Remarks on other cameras in the same file, which are not read.
fn other_cameras(document: &Node) -> Option<String> {
    let names: Vec<String> = (0..).map(|n| format!("cam{n}")).take_while(|name| document.find(&[name]).is_some()).collect();
    (names.len() > 1).then(|| {
        format!(
            "it has {} cameras ({}), of which cam0 is read; put another one into a file of its own to use that",
            names.len(),
            names.join(", ")
        )
    })
}

fn form(root: &Node) -> CalibrationForm {
    if root.find(&["intrinsics"]).is_some() {
        CalibrationForm::Euroc
    } else if root.find(&["distortion_model"]).is_some() {
        CalibrationForm::Ros
    } else {
        CalibrationForm::OpenCv
    }
}

fn size(root: &Node) -> Result<(u32, u32), Fault> {
    if let Some((key, node)) = root.find(&["resolution", "image_size"]) {
        let numbers = numbers(key, node, "2 numbers, width and height")?;
        let [w, h] = exactly(key, node, numbers, "2 numbers, width and height")?;
        return Ok((whole(key, node, w)?, whole(key, node, h)?));
    }
    let one = |names: &[&str]| {
        let (key, node) = root.find(names).ok_or_else(|| missing(names[0], "the picture's size in whole pixels"))?;
        let number = node.number().ok_or_else(|| wrong_type(key, node, "a whole number of pixels"))?;
        whole(key, node, number)
    };
    Ok((one(&["image_width", "width"])?, one(&["image_height", "height"])?))
}

/// Reads fx, fy, cx, cy and skew from a 3x3 matrix; the other fields stay zero.
fn from_matrix(root: &Node) -> Result<Intrinsics, Fault> {
    // Required content of the matrix, for messages.
    const HINT: &str = "9 numbers fx, fx*skew, cx, 0, fy, cy, 0, 0, 1";
    let (key, node) = root.find(&MATRIX).ok_or_else(|| missing(MATRIX[0], HINT))?;
    let k: [f64; 9] = exactly(key, node, numbers(key, node, HINT)?, HINT)?;
    if k == [0.0; 9] {
        return Err(Fault { line: Some(node.line), problem: CalibrationProblem::NotCalibrated { key: key.to_owned() } });
    }
    for (found, wanted) in [(k[3], 0.0), (k[6], 0.0), (k[7], 0.0), (k[8], 1.0)] {
        if found != wanted {
            let problem = CalibrationProblem::OutOfRange { key: key.to_owned(), value: found, expected: HINT };
            return Err(Fault { line: Some(node.line), problem });
        }
    }
    // Avoids a division by zero; the model refuses a zero focal length later.
    let skew = if k[1] == 0.0 || k[0] == 0.0 { 0.0 } else { k[1] / k[0] };
    Ok(Intrinsics { width: 0, height: 0, fx: k[0], fy: k[4], cx: k[2], cy: k[5], skew, distortion: [0.0; 5] })
}

/// Reads fx, fy, cx and cy from EuRoC's list; the other fields stay zero.
fn from_list(root: &Node) -> Result<Intrinsics, Fault> {
    let (key, node) = root.find(&["intrinsics"]).ok_or_else(|| missing(MATRIX[0], "the 3 x 3 matrix K"))?;
    let [fx, fy, cx, cy] = exactly(key, node, numbers(key, node, "4 numbers fx, fy, cx, cy")?, "4 numbers fx, fy, cx, cy")?;
    Ok(Intrinsics { width: 0, height: 0, fx, fy, cx, cy, skew: 0.0, distortion: [0.0; 5] })
}

/// Reads the coefficients, with a remark if their model is ambiguous.
fn distortion(root: &Node) -> Result<([f64; 5], Option<String>), Fault> {
    let (key, node) = root.find(&DISTORTION).ok_or_else(|| missing(DISTORTION[0], DISTORTION_HINT))?;
    let all = match &node.content {
        Content::List(items) if items.is_empty() => return Ok(([0.0; 5], None)), // ROS: an empty list means no distortion
        _ => numbers(key, node, DISTORTION_HINT)?,
    };
    if all.len() < 4 {
        let problem = CalibrationProblem::WrongLength { key: key.to_owned(), found: all.len(), expected: DISTORTION_HINT };
        return Err(Fault { line: Some(node.line), problem });
    }
    if all.iter().skip(5).any(|v| *v != 0.0) {
        let model = format!("one of {} coefficients (rational, thin prism or fisheye)", all.len());
        return Err(Fault { line: Some(node.line), problem: CalibrationProblem::UnsupportedModel { model } });
    }
    let is_unsure = all.len() == 4 && all.iter().any(|v| *v != 0.0) && !names_brown(root);
    let word = is_unsure.then(|| {
        format!(
            "`{key}` has four numbers, which are read as k1, k2, p1, p2 of Brown's model; a fisheye calibration has four too (k1 to k4): such a \
             lens is not supported"
        )
    });
    let mut five = [0.0; 5];
    five.iter_mut().zip(all).for_each(|(to, from)| *to = from);
    Ok((five, word))
}

fn wrong_type(key: &str, node: &Node, expected: &'static str) -> Fault {
    let found = match &node.content {
        Content::Scalar(text) => format!("\"{}\"", text.chars().take(40).collect::<String>()),
        Content::List(_) => "a list that is not all numbers".to_owned(),
        Content::Map(_) => "a map without a list of numbers named data".to_owned(),
    };
    Fault { line: Some(node.line), problem: CalibrationProblem::WrongType { key: key.to_owned(), found, expected } }
}

fn numbers(key: &str, node: &Node, expected: &'static str) -> Result<Vec<f64>, Fault> {
    node.numbers().ok_or_else(|| wrong_type(key, node, expected))
}

fn exactly<const N: usize>(key: &str, node: &Node, numbers: Vec<f64>, expected: &'static str) -> Result<[f64; N], Fault> {
    numbers.try_into().map_err(|v: Vec<f64>| {
        let problem = CalibrationProblem::WrongLength { key: key.to_owned(), found: v.len(), expected };
        Fault { line: Some(node.line), problem }
    })
}
