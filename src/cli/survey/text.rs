//! A survey's result as text.

use std::fmt::Write as _;

use crate::survey::shutter::ShutterTime;
use crate::survey::walked::constraints::{ConstraintCheck, Measured};
use crate::survey::walked::judgement::{Judgement, SurfaceDescription};
use crate::survey::walked::stage::Survey;

/// Returns the report for the terminal.
pub(super) fn text(made: &Survey, judgement: &Judgement) -> String {
    let mut text = String::new();
    // Writing to a String cannot fail.
    let _ = writeln!(
        text,
        "walk        {} frames, the stage was found in {}; {} keyframes, {} of them fit",
        made.frames, made.found, made.keyframes, made.used
    );
    let configured =
        made.configured_rms_px.map_or_else(|| "nothing fits as configured".to_owned(), |px| format!("{px:.3} px as configured"));
    let _ = writeln!(text, "residual    {configured}, {:.3} px as surveyed", made.rms_px);
    if let Some(metres) = made.configured_error_m {
        let _ = writeln!(
            text,
            "gain        without the survey camera positions would be off by {:.2} mm (after the best rigid motion of the stage)",
            1e3 * metres
        );
    }
    let i = made.camera.intrinsics();
    let _ = writeln!(text, "lens        fx {:.2}, fy {:.2}, cx {:.2}, cy {:.2}, distortion {:.4?}", i.fx, i.fy, i.cx, i.cy, i.distortion);
    if let Some(shutter) = shutter(made) {
        let _ = writeln!(text, "shutter     {shutter}");
    }
    for (k, (surface, spec)) in made.described().iter().zip(&made.surfaces).enumerate() {
        let label = if k == 0 { "surfaces" } else { "" };
        let _ = writeln!(
            text,
            "{label:<11} {}: heights {:.2} mm rms, {:.1} mm at most, known to {:.2} mm ({}); place {:.2} mm, {:.3} degrees",
            spec.name,
            surface.height_rms_mm,
            surface.height_max_mm,
            surface.height_sigma_mm,
            narrowest(surface),
            surface.sigma_mm,
            surface.sigma_deg
        );
    }
    for line in measured(made) {
        let _ = writeln!(text, "measured    {line}");
    }
    let _ = writeln!(text, "verdict     {}", judgement.sentence());
    text
}

/// Describes how narrow wrinkles of a surface show, and how much of its sigma is by narrower ones.
pub(super) fn narrowest(surface: &SurfaceDescription) -> String {
    let (narrowest_mm, unmodelled_mm) = (surface.narrowest_wrinkle_mm, surface.unmodelled_mm);
    format!("{unmodelled_mm:.2} mm of it not shown: wrinkles show down to {narrowest_mm:.0} mm")
}

/// Describes what the walk says about the shutter; `None` if it was not estimated.
pub(super) fn shutter(made: &Survey) -> Option<String> {
    let found = made.shutter_found.as_ref();
    let milliseconds = |time: &ShutterTime| format!("{:.2} ms (sigma {:.2})", 1e3 * time.seconds, 1e3 * time.sigma_s);
    let say = |name: &str, time: Option<ShutterTime>, configured_s: f64| match time {
        Some(time) => format!("{name} {}", milliseconds(&time)),
        None => format!("{name} {:.2} ms as configured: the walk has too little motion to estimate it", 1e3 * configured_s),
    };
    made.refines_lens().then(|| {
        let readout = say("readout", found.and_then(|f| f.readout), made.shutter.readout_s);
        format!(
            "{readout}, used as {:.2} ms; {}",
            1e3 * made.shutter.readout_s,
            say("exposure", found.and_then(|f| f.exposure), made.shutter.exposure_s)
        )
    })
}

/// Compares the tape measurements with the result, one line each; the size comes first.
pub(super) fn measured(made: &Survey) -> Vec<String> {
    let size =
        made.size.map(|size| format!("the stage is {:.5} times as large as size_m says, known to {:.5}", 1.0 + size.growth, size.sigma));
    let check = |check: &ConstraintCheck| {
        let (name, sigmas) = (&check.constraint.name, check.sigmas);
        match &check.constraint.measured {
            Measured::Distance { length_m, .. } => {
                format!(
                    "{name}: {length_m:.4} m as measured, {:.4} m as found, {sigmas:.1} sigmas from everything else",
                    length_m - check.off_m
                )
            }
            Measured::Place { .. } => {
                format!("{name}: found {:.1} mm from its measured position, {sigmas:.1} sigmas from everything else", 1e3 * check.off_m)
            }
        }
    };
    size.into_iter().chain(made.checks.iter().map(check)).collect()
}
