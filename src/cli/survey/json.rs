//! A survey's result as JSON (contract C11).

use serde_json::json;

use crate::survey::walked::judgement::Judgement;
use crate::survey::walked::stage::Survey;

/// Returns the document.
pub(super) fn text(made: &Survey, judgement: &Judgement) -> String {
    let i = made.camera.intrinsics();
    let uncertainty = made.camera.doubt().map(|doubt| {
        let u = doubt.uncertainty;
        json!({"fx": u.focal_px[0], "fy": u.focal_px[1], "cx": u.centre_px[0], "cy": u.centre_px[1], "skew": u.skew, "distortion": u.distortion})
    });
    // Times about which the walk says nothing are as configured, without a sigma.
    let shutter = made.refines_lens().then(|| {
        let found = made.shutter_found.as_ref();
        let (readout, exposure) = (found.and_then(|f| f.readout), found.and_then(|f| f.exposure));
        json!({
            "readout_s": made.shutter.readout_s,
            "readout_sigma_s": readout.map(|time| time.sigma_s),
            "exposure_s": exposure.map_or(made.shutter.exposure_s, |time| time.seconds),
            "exposure_sigma_s": exposure.map(|time| time.sigma_s),
        })
    });
    let surfaces: Vec<_> = made
        .described()
        .iter()
        .zip(&made.surfaces)
        .map(|(s, spec)| {
            json!({
                "name": spec.name,
                "position_m": spec.pose.translation.as_slice(),
                "orientation_xyzw": spec.pose.orientation_xyzw(),
                "sigma_mm": s.sigma_mm,
                "sigma_deg": s.sigma_deg,
                "height_mm": {"rms": s.height_rms_mm, "max": s.height_max_mm, "sigma": s.height_sigma_mm},
            })
        })
        .collect();
    let document = json!({
        "camera": {
            "width": i.width, "height": i.height, "fx": i.fx, "fy": i.fy, "cx": i.cx, "cy": i.cy, "skew": i.skew, "distortion": i.distortion,
            "uncertainty": uncertainty,
        },
        "shutter": shutter,
        "surfaces": surfaces,
        "size": made.size.map(|size| json!({"growth": size.growth, "sigma": size.sigma})),
        "measured": made.checks.iter().map(|check| json!({
            "name": check.constraint.name,
            "off_mm": 1e3 * check.off_m,
            "off_from_others_mm": 1e3 * check.off_from_others_m,
            "sigmas": check.sigmas,
        })).collect::<Vec<_>>(),
        "verdict": judgement.verdict.words(),
        "reasons": judgement.reasons,
        "frames": made.frames,
        "found": made.found,
        "keyframes": made.keyframes,
        "used": made.used,
        "rms_px": {"configured": made.configured_rms_px, "surveyed": made.rms_px},
        "configured_error_mm": made.configured_error_m.map(|metres| 1e3 * metres),
        "scale": made.scale,
        "rounds": made.rounds,
    });
    format!("{document:#}\n")
}
