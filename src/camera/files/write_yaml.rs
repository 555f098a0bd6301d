//! Writes OpenCV's and ROS's YAML formats for other programs.

use super::Calibration;

/// Formats K row by row: `fx, fx*skew, cx, ...`.
fn matrix(calibration: &Calibration) -> String {
    let k = calibration.model.k_matrix();
    let rows: Vec<String> = k.transpose().iter().map(|v| format!("{v:?}")).collect();
    rows.join(", ")
}

fn distortion(calibration: &Calibration) -> String {
    let d = calibration.model.intrinsics().distortion;
    d.map(|v| format!("{v:?}")).join(", ")
}

/// Quotes a text so that YAML reads it as one string, whatever it contains.
fn quoted(text: &str) -> String {
    format!("\"{}\"", text.replace(['"', '\\', '\n', '\r'], " "))
}

/// Writes OpenCV's FileStorage YAML as its calibration sample does.
pub(super) fn opencv(calibration: &Calibration) -> String {
    let i = calibration.model.intrinsics();
    let mut text = "%YAML:1.0\n---\n".to_owned();
    if let Some(date) = &calibration.date {
        text += &format!("calibration_time: {}\n", quoted(date));
    }
    if let Some(images) = calibration.images {
        text += &format!("nframes: {images}\n");
    }
    text += &format!("image_width: {}\nimage_height: {}\n", i.width, i.height);
    let array = |name: &str, rows: u32, cols: u32, data: String| {
        format!("{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: [ {data} ]\n")
    };
    text += &array("camera_matrix", 3, 3, matrix(calibration));
    text += &array("distortion_coefficients", 5, 1, distortion(calibration));
    if let Some(rms) = calibration.rms_px {
        text += &format!("avg_reprojection_error: {rms:?}\n");
    }
    text
}

/// Writes ROS's camera_info YAML.
pub(super) fn ros(calibration: &Calibration, name: &str) -> String {
    let i = calibration.model.intrinsics();
    let k = calibration.model.k_matrix();
    let array = |name: &str, rows: u32, cols: u32, data: &str| format!("{name}:\n  rows: {rows}\n  cols: {cols}\n  data: [{data}]\n");
    let projection: Vec<String> = (0..3).flat_map(|r| [k[(r, 0)], k[(r, 1)], k[(r, 2)], 0.0]).map(|v| format!("{v:?}")).collect();
    let mut text = format!("image_width: {}\nimage_height: {}\ncamera_name: {}\n", i.width, i.height, quoted(name));
    text += &array("camera_matrix", 3, 3, &matrix(calibration));
    text += "distortion_model: plumb_bob\n";
    text += &array("distortion_coefficients", 1, 5, &distortion(calibration));
    text += &array("rectification_matrix", 3, 3, "1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0");
    text += &array("projection_matrix", 3, 4, &projection.join(", "));
    text
}
