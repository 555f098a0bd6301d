//! The result as JSON (contract C7): the calibration file's fields, the verdict, and every view.

use serde_json::{Value, json};

use crate::calibrate::judge::map::{MAP_COLUMNS, MAP_ROWS, PixelMap};
use crate::calibrate::lateral_colour::LateralColour;
use crate::calibrate::report::Comparison;
use crate::calibrate::session::{CalibrationView, CameraCalibration};
use crate::camera::Calibration;

/// Returns the whole document.
pub(super) fn text(made: &CameraCalibration, calibration: &Calibration, comparison: Option<&Comparison>) -> String {
    let i = calibration.model.intrinsics();
    let u = calibration.uncertainty.unwrap_or_default();
    let judgement = &made.judgement;
    let all = json!({
        "width": i.width, "height": i.height,
        "fx": i.fx, "fy": i.fy, "cx": i.cx, "cy": i.cy, "skew": i.skew, "distortion": i.distortion,
        "uncertainty": {"fx": u.focal_px[0], "fy": u.focal_px[1], "cx": u.centre_px[0], "cy": u.centre_px[1], "skew": u.skew, "distortion": u.distortion},
        "rms_px": calibration.rms_px, "images": calibration.images, "date": calibration.date,
        "err_px": made.estimate.axis_error_px,
        "board": {"columns": made.board.columns(), "rows": made.board.rows(), "square_m": made.board.square_m()},
        "verdict": judgement.verdict.to_string(),
        "sentence": judgement.sentence(),
        "reasons": judgement.reasons(),
        "next_picture": judgement.next_picture,
        "insignificant": judgement.insignificant,
        "coverage": judgement.coverage,
        "tilted_views": judgement.tilted_views,
        "uncertainty_map": map(&judgement.uncertainty),
        "halves": judgement.halves.as_ref().map(|h| json!({"agree": h.agree(), "sigmas": h.sigmas, "px": h.most_px})),
        "lateral_colour": made.lateral_colour.as_ref().ok().map(lateral_colour),
        "compare": comparison.map(|c| json!({"file": c.name, "px": map(&c.lengths())})),
        "views": made.views.iter().map(view).collect::<Vec<_>>(),
    });
    format!("{all:#}\n")
}

fn map(map: &PixelMap) -> Value {
    json!({"columns": MAP_COLUMNS, "rows": MAP_ROWS, "values_px": map.values_px, "worst_px": map.worst(), "median_px": finite(map.quantile(0.5))})
}

fn lateral_colour(colours: &LateralColour) -> Value {
    let mut value = json!({"pictures": colours.pictures});
    for (name, c) in colours.named() {
        value[name] = json!({
            "scale": c.scale, "uncertainty": c.scale_uncertainty,
            "corner_px": c.corner_px, "corner_uncertainty_px": c.corner_uncertainty_px,
            "shift_px": [c.shift_px.x, c.shift_px.y], "corners": c.corners,
        });
    }
    value
}

fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

fn view(view: &CalibrationView) -> Value {
    let pair = |v: &nalgebra::Vector2<f64>| [v.x, v.y];
    let three = |v: &nalgebra::Vector3<f64>| [v.x, v.y, v.z];
    let pose = view.extrinsics.as_ref();
    json!({
        "file": view.file.to_string_lossy(),
        "found": view.corners.is_some(),
        "used": view.used,
        "rms_px": view.rms_px,
        "reason": view.reason,
        "corners": view.corners.as_ref().map(|all| all.iter().map(|c| c.as_ref().map(pair)).collect::<Vec<_>>()),
        "outliers": view.outliers,
        "rotation_vector": pose.map(|p| three(&p.rotation_vector)),
        "translation_m": pose.map(|p| three(&p.translation_m)),
        "uncertainty": pose.map(|p| json!({
            "rotation_vector": three(&p.rotation_uncertainty), "translation_m": three(&p.translation_uncertainty_m)
        })),
    })
}
