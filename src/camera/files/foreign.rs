//! Recognises files of other programs whose lens model is not Brown's or whose format is not
//! supported.

use super::problem::{CalibrationProblem, Fault};
use super::yaml::{Content, Node};

/// Keys that name the lens model in files of OpenCV, ROS, Kalibr, Camodocal, ORB-SLAM and similar
/// programs.
const MODEL_KEYS: [&str; 14] = [
    "distortion_model",
    "camera_model",
    "distortion_type",
    "camera_type",
    "lens_type",
    "lens_model",
    "model",
    "model_type",
    "model_name",
    "projection_model",
    "projection_type",
    "projection",
    "Camera.type",
    "type",
];
/// Keys that hold nothing but a lens model, so unknown values are refused too.
const STRICT_KEYS: [&str; 2] = ["distortion_model", "camera_model"];
/// Names programs use for Brown's model and for the plain pinhole.
const BROWN: [&str; 14] = [
    "plumbbob",
    "rationalpolynomial",
    "radialtangential",
    "radtan",
    "brown",
    "brownconrady",
    "pinhole",
    "perspective",
    "pinholeradtan",
    "pinholeradialtangential",
    "opencv",
    "standard",
    "none",
    "",
];
/// Parts of names of other models.
const OTHERS: [&str; 17] = [
    "fisheye",
    "equidist",
    "equisolid",
    "stereographic",
    "orthographic",
    "kannala",
    "kb4",
    "kb8",
    "mei",
    "omni",
    "eucm",
    "ucm",
    "doublesphere",
    "scaramuzza",
    "ocam",
    "divis",
    "fov",
];
/// Short names of other models; they must match whole, since they are parts of many words.
const OTHER_WORDS: [&str; 4] = ["ds", "equi", "atan", "unified"];
/// Boolean keys that mark a fisheye lens.
const FLAGS: [&str; 3] = ["fisheye_model", "fisheye", "is_fisheye"];
/// Parameters that only other models have.
const NUMBERS: [(&str, &str); 3] =
    [("xi", "omnidirectional (xi)"), ("mirror_parameters", "omnidirectional (mirror_parameters)"), ("mu", "Kannala's (mu, mv)")];

/// Refuses a file with another lens model, at the line that states it.
pub(super) fn refuse_other_lenses(root: &Node) -> Result<(), Fault> {
    let unsupported = |node: &Node, model: &str| {
        let problem = CalibrationProblem::UnsupportedModel { model: model.to_owned() };
        Err(Fault { line: Some(node.line), problem })
    };
    for (_, node) in FLAGS.iter().filter_map(|key| root.find(&[key])) {
        let is_off = node.number() == Some(0.0) || node.text().is_some_and(|t| matches!(plain(t).as_str(), "false" | "no" | "off"));
        if !is_off {
            return unsupported(node, "fisheye");
        }
    }
    for key in MODEL_KEYS {
        let Some((_, node)) = root.find(&[key]) else { continue };
        let name = node.text().unwrap_or("no word");
        let is_other = OTHERS.iter().any(|part| plain(name).contains(part)) || OTHER_WORDS.contains(&plain(name).as_str());
        let is_known = BROWN.contains(&plain(name).as_str());
        // `type` or `model` may name the camera's product instead.
        if is_other || (STRICT_KEYS.contains(&key) && !is_known) {
            return unsupported(node, name);
        }
    }
    for (key, model) in NUMBERS {
        let Some((_, node)) = root.find(&[key]) else { continue };
        if node.number() != Some(0.0) {
            return unsupported(node, model);
        }
    }
    Ok(())
}

/// Refuses files in unsupported formats of other programs, with what to do.
pub(super) fn refuse_other_programs(root: &Node) -> Result<(), Fault> {
    let refused = |line: usize, program: &'static str, hint: &'static str| {
        Err(Fault { line: Some(line), problem: CalibrationProblem::OtherProgram { program, hint } })
    };
    if let Some((_, node)) = root.find(&["pinhole"])
        && matches!(node.content, Content::Map(_))
    {
        let hint = "write its numbers to a .toml file: width, height, fx, fy, cx, cy, skew = skew / fx, distortion = [radial 1, radial 2, t1, t2, 0]";
        return refused(node.line, "BoofCV", hint);
    }
    if let Some((_, node)) = root.find(&["Camera.fx", "Camera1.fx"]) {
        let hint = "write its numbers to a .toml file: width, height, fx, fy, cx, cy, distortion = [k1, k2, p1, p2, k3]";
        return refused(node.line, "ORB-SLAM", hint);
    }
    if let Some((_, node)) = root.find(&["projection_parameters"]) {
        let hint = "write its numbers to a .toml file: width, height, fx, fy, cx, cy, distortion = [k1, k2, p1, p2, 0]";
        return refused(node.line, "Camodocal (VINS)", hint);
    }
    Ok(())
}

/// Whether the file names Brown's model, so that four coefficients are unambiguous.
pub(super) fn names_brown(root: &Node) -> bool {
    let text_of = |key: &str| root.find(&[key]).and_then(|(_, node)| node.text().map(plain));
    ["distortion_model", "distortion_type", "model_type"]
        .into_iter()
        .filter_map(text_of)
        .any(|name| !name.is_empty() && name != "none" && name != "pinhole" && BROWN.contains(&name.as_str()))
}

/// Normalises case, underscores, hyphens and spaces, which vary between programs.
fn plain(word: &str) -> String {
    word.trim().to_ascii_lowercase().replace(['_', '-', ' '], "")
}
