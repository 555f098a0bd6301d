//! A survey's report: a height map per surface, the layout with the walk, and the verdict.

use std::fmt::Write as _;

use crate::cli::layout_figures::layout;
use crate::html_page::svg::{Drawing, escaped, hue};
use crate::html_page::{figure, page};
use crate::survey::walked::judgement::Judgement;
use crate::survey::walked::stage::Survey;

/// Cells across a surface's height map. Raised, the file grows.
const CELLS: usize = 60;
/// Width of a figure, SVG units. Raised, figures are larger.
const WIDTH: f64 = 640.0;
/// Heights above this many of their own sigmas get the full colour; smaller ones may be noise.
/// Raised, more of the map is pale.
const PALE_BELOW_SIGMAS: f64 = 2.0;

/// Returns the page.
pub(super) fn html(made: &Survey, judgement: &Judgement, date: &str) -> String {
    let mut body = format!("<p><b>{}</b></p>\n", escaped(&judgement.sentence()));
    if let Some(metres) = made.configured_error_m {
        let _ =
            writeln!(body, "<p>Without this survey camera positions would be off by {:.2} mm (median of the keyframes).</p>", 1e3 * metres);
    }
    body += &residuals(made);
    for k in 0..made.surfaces.len() {
        body += &heights(made, k);
    }
    let surfaces: Vec<_> = made.surfaces.iter().enumerate().map(|(k, spec)| (spec, hue(k))).collect();
    body += &layout(&surfaces, &made.cameras);
    page("Survey of a stage", date, &body)
}

fn residuals(made: &Survey) -> String {
    let mut rows = String::new();
    let mut row = |label: &str, value: String| {
        // Writing to a String cannot fail.
        let _ = write!(rows, "<tr><th>{label}</th><td>{}</td></tr>", escaped(&value));
    };
    row("frames", format!("{}, the stage found in {}", made.frames, made.found));
    row("keyframes", format!("{}, {} of them agree with the result", made.keyframes, made.used));
    row("left as configured", made.configured_rms_px.map_or("nothing fits".to_owned(), |px| format!("{px:.3} px")));
    row("left as surveyed", format!("{:.3} px", made.rms_px));
    if let Some(metres) = made.configured_error_m {
        row("error without the survey", format!("{:.2} mm, after the best rigid motion of the stage", 1e3 * metres));
    }
    let i = made.camera.intrinsics();
    row(
        "lens",
        format!(
            "fx {:.2}, fy {:.2}, cx {:.2}, cy {:.2}, distortion {:?}",
            i.fx,
            i.fy,
            i.cx,
            i.cy,
            i.distortion.map(|k| (1e5 * k).round() / 1e5)
        ),
    );
    if let Some(shutter) = super::text::shutter(made) {
        row("shutter", shutter);
    }
    for (description, spec) in made.described().iter().zip(&made.surfaces) {
        let text = format!(
            "heights {:.2} mm rms, {:.1} mm at most, one sigma {:.2} mm ({}); place known to {:.2} mm and {:.3} degrees",
            description.height_rms_mm,
            description.height_max_mm,
            description.height_sigma_mm,
            super::text::narrowest(description),
            description.sigma_mm,
            description.sigma_deg
        );
        row(&escaped(&spec.name), text);
    }
    for line in super::text::measured(made) {
        row("measured", line);
    }
    format!("<table>{rows}</table>\n")
}

/// Draws a surface's heights: red towards the camera, blue away from it, pale where uncertain.
fn heights(made: &Survey, k: usize) -> String {
    let spec = &made.surfaces[k];
    let [w, h] = spec.size_m;
    let rows = ((CELLS as f64 * h / w).round() as usize).clamp(4, 4 * CELLS);
    let cell = WIDTH / CELLS as f64;
    let place = |i: usize, j: usize| [((i as f64 + 0.5) / CELLS as f64 - 0.5) * w, (0.5 - (j as f64 + 0.5) / rows as f64) * h];
    let all: Vec<(usize, usize, f64, f64)> = (0..rows)
        .flat_map(|j| (0..CELLS).map(move |i| (i, j)))
        .map(|(i, j)| (i, j, spec.shape.at(place(i, j)).place.z, made.height_sigma_m(k, place(i, j))))
        .collect();
    let most = all.iter().map(|(.., height, _)| height.abs()).fold(1e-4, f64::max);
    let mut drawing = Drawing::new(WIDTH, cell * rows as f64 + 22.0);
    for (i, j, height, sigma) in &all {
        let share = (height / most).clamp(-1.0, 1.0);
        let sureness = (height.abs().max(0.05 * most) / (PALE_BELOW_SIGMAS * sigma.max(1e-9))).min(1.0);
        let colour = format!("hsl({} {:.0}% {:.0}%)", if share > 0.0 { 8 } else { 215 }, 75.0 * sureness, 96.0 - 50.0 * share.abs());
        drawing.rect([*i as f64 * cell, *j as f64 * cell], [cell + 0.3, cell + 0.3], "none", &colour);
    }
    let legend = format!("{:+.1} mm (blue, away from the house) to {:+.1} mm (red)", -1e3 * most, 1e3 * most);
    drawing.text([0.0, cell * rows as f64 + 16.0], 13.0, "start", "currentColor", &legend);
    let caption =
        format!("Heights of {} over its plane, as its picture lies. Grey parts are poorly known: film them again.", escaped(&spec.name));
    figure(&drawing.finish(&format!("heights of {}", spec.name)), &caption)
}
