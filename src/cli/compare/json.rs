//! The comparison as JSON (contract C10).

use nalgebra::Matrix3;
use serde_json::{Value, json};

use crate::compare::{Comparison, Model, Relation};

/// Returns the whole document.
pub(super) fn text(made: &Comparison) -> String {
    let matrix = |relation: &Option<Relation>| relation.as_ref().map_or(Value::Null, |r| row_major(&r.matrix));
    let inliers = |relation: &Option<Relation>| relation.as_ref().map_or(0, |r| r.inliers.len());
    let sigma = |relation: &Option<Relation>| relation.as_ref().map(|r| r.sigma_px);
    let found = made.camera_move;
    let model = made.model.map(|model| match model {
        Model::Homography => "homography",
        Model::Fundamental => "fundamental",
        Model::Essential => "essential",
    });
    let all = json!({
        "F": matrix(&made.fundamental), "H": matrix(&made.homography), "E": matrix(&made.essential),
        "rotation_xyzw": found.map(|m| xyzw(&m.rotation)),
        "translation_direction": found.and_then(|m| m.direction).map(|t| [t.x, t.y, t.z]),
        "inliers": {"F": inliers(&made.fundamental), "H": inliers(&made.homography), "E": inliers(&made.essential)},
        "matches": made.matches.len(),
        "model": model,
        "translation_m": made.translation_m().map(|t| [t.x, t.y, t.z]),
        "parallax_deg": found.map(|m| m.parallax_deg),
        "in_front": found.map(|m| m.in_front),
        "sigma_px": {"F": sigma(&made.fundamental), "H": sigma(&made.homography), "E": sigma(&made.essential)},
        "detector": made.settings.detector.name(), "descriptor": made.settings.descriptor.name(),
        "keypoints": [made.features[0].keypoints.len(), made.features[1].keypoints.len()],
        "pairs_px": made.pairs.iter().map(|p| [p.from.x, p.from.y, p.to.x, p.to.y]).collect::<Vec<_>>(),
        "sentence": made.sentence(), "remarks": made.remarks(),
    });
    format!("{all:#}\n")
}

fn row_major(matrix: &Matrix3<f64>) -> Value {
    json!(matrix.transpose().as_slice())
}

/// Returns the rotation with w >= 0 and without negative zeros.
fn xyzw(rotation: &nalgebra::UnitQuaternion<f64>) -> [f64; 4] {
    let sign = if rotation.w < 0.0 { -1.0 } else { 1.0 };
    [rotation.i, rotation.j, rotation.k, rotation.w].map(|v| sign * v + 0.0)
}
