//! A map as text.

use std::fmt::Write as _;

use crate::survey::walked::judgement::Judgement;
use crate::survey::walked::mapping::map::Mapped;

/// Returns the report for the terminal.
pub(super) fn text(made: &Mapped, judgement: &Judgement) -> String {
    let survey = &made.survey;
    let mut text = String::new();
    // Writing to a String cannot fail.
    let _ = writeln!(
        text,
        "walk        {} frames, a surface was found in {}; {} keyframes, {} of them without a surface, {} of them fit; {:.1} m wide at {:.1} m",
        survey.frames, made.found, survey.keyframes, made.unseen, survey.used, made.extent_m, made.distance_m
    );
    let _ = writeln!(text, "points      {}, {:.2} sigmas", made.points, made.points_scale);
    let area: f64 = made.map.facets.iter().map(|facet| facet.size_m[0] * facet.size_m[1]).sum();
    let _ =
        writeln!(text, "facets      {}, {area:.1} square metres, known to {:.2} mm (median)", made.map.facets.len(), 1e3 * made.sigma_m());
    let _ = writeln!(text, "residual    {:.3} px, {:.2} times the noise", survey.rms_px, made.residual_scale());
    let _ = match made.scale_sigma {
        Some(sigma) => writeln!(text, "scale       known to {:.0} ppm, from {}", 1e6 * sigma, made.scale_from.join(" and ")),
        None => writeln!(text, "scale       not metric: nothing in the config was measured"),
    };
    if let Some(readout) = &made.readout {
        let (ms, sigma_ms) = (1e3 * readout.seconds, 1e3 * readout.sigma_s);
        let _ = writeln!(
            text,
            "shutter     it rolls: {ms:.1} ms from the first row to the last (one sigma {sigma_ms:.1}), learnt from {} keyframes",
            readout.frames
        );
    }
    if let Some(held) = &made.hold_out {
        let (located, keyframes) = (held.located, held.keyframes);
        let _ = writeln!(
            text,
            "hold-out    {located} of {keyframes} keyframes located on a map of the others, {:.2} mm off (median), {:.2} at most",
            1e3 * held.median_m,
            1e3 * held.most_m
        );
    }
    for hint in &made.missing {
        let _ = writeln!(text, "film        {hint}");
    }
    let _ = writeln!(text, "verdict     {}", judgement.sentence());
    text
}
