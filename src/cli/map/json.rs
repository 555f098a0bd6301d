//! A map as JSON (contract C13).

use serde_json::json;

use crate::survey::walked::judgement::Judgement;
use crate::survey::walked::mapping::map::Mapped;

/// Returns the document.
pub(super) fn text(made: &Mapped, judgement: &Judgement) -> String {
    let survey = &made.survey;
    let i = survey.camera.intrinsics();
    let described = survey.described();
    let facet = |(k, facet): (&usize, &crate::track::Facet)| {
        let description = described.get(*k);
        json!({
            "name": facet.name,
            "position_m": facet.pose.translation.as_slice(),
            "orientation_xyzw": facet.pose.orientation_xyzw(),
            "size_m": facet.size_m,
            "sigma_mm": description.map(|d| d.sigma_mm),
            "sigma_deg": description.map(|d| d.sigma_deg),
        })
    };
    let document = json!({
        "camera": {
            "width": i.width, "height": i.height, "fx": i.fx, "fy": i.fy, "cx": i.cx, "cy": i.cy, "skew": i.skew, "distortion": i.distortion,
        },
        "scale": {"ppm_sigma": made.scale_sigma.map(|sigma| 1e6 * sigma), "from": made.scale_from.join(" and ")},
        "facets": made.kept.iter().zip(&made.map.facets).map(facet).collect::<Vec<_>>(),
        "keyframes": survey.keyframes,
        "used": survey.used,
        "unseen": made.unseen,
        "points": made.points,
        "residual_scale": made.residual_scale(),
        "rms_px": survey.rms_px,
        "hold_out_mm": made.hold_out.map(|held| 1e3 * held.median_m),
        "hold_out": made.hold_out.map(|held| json!({
            "keyframes": held.keyframes, "located": held.located, "median_mm": 1e3 * held.median_m, "most_mm": 1e3 * held.most_m,
        })),
        "readout_s": made.readout.map(|found| found.seconds),
        "readout_sigma_s": made.readout.map(|found| found.sigma_s),
        "missing": made.missing,
        "verdict": judgement.verdict.words(),
        "reasons": judgement.reasons,
    });
    format!("{document:#}\n")
}
