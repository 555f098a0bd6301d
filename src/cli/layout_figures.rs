//! Figures of a stage's layout for reports: its surfaces and the cameras of a walk.

use nalgebra::Vector3;

use crate::geometry::{Body, Camera, Pose};
use crate::html_page::figure;
use crate::html_page::svg::Drawing;
use crate::track::SurfaceSpec;

/// Width of a figure, SVG units. Raised, figures are larger.
const WIDTH: f64 = 640.0;

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

/// Draws surfaces as they hang, each in its colour, and the cameras of a walk, from several sides.
pub(super) fn layout(surfaces: &[(&SurfaceSpec, String)], cameras: &[Pose<Body, Camera>]) -> String {
    VIEWS.iter().map(|view| seen_from(view, surfaces, cameras)).collect()
}

fn seen_from(view: &View, surfaces: &[(&SurfaceSpec, String)], cameras: &[Pose<Body, Camera>]) -> String {
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
    let outlines: Vec<Vec<[f64; 2]>> = surfaces.iter().map(|(spec, _)| outline(spec)).collect();
    let cameras: Vec<[f64; 2]> = cameras.iter().map(|pose| seen(&pose.translation)).collect();
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
    for (outline, (spec, colour)) in outlines.iter().zip(surfaces) {
        let points: Vec<[f64; 2]> = outline.iter().map(to_page).collect();
        drawing.path(&points, true, colour, "none", 2.0);
        if surfaces.len() <= MAX_NAMES {
            let [x, y] = points[0];
            drawing.text([x + 4.0, y + 14.0], 12.0, "start", colour, &spec.name);
        }
    }
    figure(&drawing.finish("layout"), &format!("Surfaces and the cameras of the walk (dots), {}.", view.words))
}
