//! A survey's report: a height map per surface, the layout with the walk, and the verdict.

use std::fmt::Write as _;

use nalgebra::Vector3;

use crate::html_page::svg::{Drawing, escaped, hue};
use crate::html_page::{figure, page};
use crate::survey::walked::judgement::Judgement;
use crate::survey::walked::stage::Survey;
use crate::track::SurfaceSpec;

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
    for view in VIEWS {
        body += &layout(made, &view);
    }
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

/// A view of the stage: the page directions, right and up, of a metre along x, y and z.
struct View {
    right: [f64; 3],
    up: [f64; 3],
    words: &'static str,
}

/// The layout's views. The first one's slants are chosen for looks: all three axes can be told
/// apart.
const VIEWS: [View; 3] = [
    View { right: [0.94, 0.34, 0.0], up: [-0.14, 0.4, 0.9], words: "from the house, from the left and above" },
    View { right: [1.0, 0.0, 0.0], up: [0.0, 1.0, 0.0], words: "from above: x to the right, y up the page (away from the house)" },
    View { right: [1.0, 0.0, 0.0], up: [0.0, 0.0, 1.0], words: "from the house: x to the right, z up" },
];
/// Segments per side of a surface. Raised, folds are smoother and the file grows.
const PIECES: usize = 24;
/// Maximum names on a drawing; raised, they overlap.
const MAX_NAMES: usize = 8;

/// Draws the surfaces' edges as they hang, and the walk's cameras.
fn layout(made: &Survey, view: &View) -> String {
    let seen = |p: &Vector3<f64>| [view.right, view.up].map(|by| p.dot(&Vector3::from(by)));
    let outline = |spec: &SurfaceSpec| -> Vec<[f64; 2]> {
        let [w, h] = spec.size_m;
        let corners = [[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]];
        let along = |n: usize| {
            let (from, to, share) = (corners[n / PIECES], corners[(n / PIECES + 1) % 4], (n % PIECES) as f64 / PIECES as f64);
            let [x, y] = [0, 1].map(|axis| from[axis] + share * (to[axis] - from[axis]));
            seen(&spec.pose.transform(&spec.shape.at([x * w, y * h]).place.into()).coords)
        };
        (0..4 * PIECES).map(along).collect()
    };
    let outlines: Vec<Vec<[f64; 2]>> = made.surfaces.iter().map(outline).collect();
    let cameras: Vec<[f64; 2]> = made.cameras.iter().map(|pose| seen(&pose.translation)).collect();
    let all = || outlines.iter().flatten().chain(&cameras);
    let bound = |axis: usize, pick: fn(f64, f64) -> f64, start: f64| all().map(|p| p[axis]).fold(start, pick);
    let low = [0, 1].map(|axis| bound(axis, f64::min, f64::INFINITY));
    let high = [0, 1].map(|axis| bound(axis, f64::max, f64::NEG_INFINITY));
    let scale = (WIDTH - 40.0) / (high[0] - low[0]).max(high[1] - low[1]).max(1e-6);
    let to_page = |p: &[f64; 2]| [20.0 + (p[0] - low[0]) * scale, 20.0 + (high[1] - p[1]) * scale];
    let mut drawing = Drawing::new(WIDTH, 40.0 + (high[1] - low[1]) * scale);
    for camera in &cameras {
        drawing.circle(to_page(camera), 2.5, "none", "currentColor", 0.0);
    }
    for (k, (outline, spec)) in outlines.iter().zip(&made.surfaces).enumerate() {
        let points: Vec<[f64; 2]> = outline.iter().map(to_page).collect();
        drawing.path(&points, true, &hue(k), "none", 2.0);
        if made.surfaces.len() <= MAX_NAMES {
            let [x, y] = points[0];
            drawing.text([x + 4.0, y + 14.0], 12.0, "start", &hue(k), &spec.name);
        }
    }
    figure(&drawing.finish("layout"), &format!("Surfaces and the cameras of the walk (dots), {}.", view.words))
}
