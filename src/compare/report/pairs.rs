//! Draws matches as lines between the two pictures, and the first picture mapped by the homography.

use image::GrayImage;
use image::imageops::{self, FilterType};
use nalgebra::Vector2;

use crate::compare::{Comparison, Relation};
use crate::geometry::Homography;
use crate::html_page::svg::{Drawing, data_uri};

/// Width of a picture in a figure, in figure units. Raised, the file grows.
pub(super) const WIDTH: f64 = 480.0;
/// Maximum number of matches drawn as lines; more would hide the pictures.
const MAX_LINES: usize = 100;
/// Number of grid lines over a picture, each way.
const GRID: usize = 4;

/// A picture, scaled down for a figure.
pub(super) struct Small {
    uri: String,
    /// Figure units per pixel.
    pub scale: f64,
    /// Width and height, figure units.
    pub size: [f64; 2],
}

impl Small {
    pub fn new(picture: &GrayImage) -> Self {
        let (w, h) = (f64::from(picture.width().max(1)), f64::from(picture.height().max(1)));
        let scale = WIDTH / w;
        let size = [WIDTH, (scale * h).max(1.0)];
        // Twice the figure's units, for sharp screens; never enlarged.
        let factor = (2.0 * scale).min(1.0);
        let (width, height) = ((w * factor).round().max(1.0) as u32, (h * factor).round().max(1.0) as u32);
        Self { uri: data_uri(&imageops::resize(picture, width, height, FilterType::Triangle)), scale, size }
    }

    /// Converts a picture position to figure coordinates.
    pub fn at(&self, p: Vector2<f64>) -> [f64; 2] {
        [(p.x + 0.5) * self.scale, (p.y + 0.5) * self.scale]
    }

    /// Draws it with its upper left corner at `at`.
    pub fn draw(&self, drawing: &mut Drawing, at: [f64; 2]) {
        drawing.picture_at(&self.uri, at, self.size);
    }
}

pub(super) struct Sheet([Small; 2]);

impl Sheet {
    pub fn new(pictures: [&GrayImage; 2]) -> Self {
        Self(pictures.map(Small::new))
    }

    /// Draws lines between the two positions of each of these matches.
    pub fn drawn(&self, made: &Comparison, which: &[usize], colour: &str, title: &str) -> String {
        let [a, b] = &self.0;
        let mut drawing = Drawing::new(2.0 * WIDTH, a.size[1].max(b.size[1]));
        a.draw(&mut drawing, [0.0, 0.0]);
        b.draw(&mut drawing, [WIDTH, 0.0]);
        let every = which.len().div_ceil(MAX_LINES).max(1);
        for &k in which.iter().step_by(every) {
            let [p, q] = made.raw_places(k);
            let (from, to) = (a.at(p), b.at(q));
            drawing.line(from, [to[0] + WIDTH, to[1]], colour, 0.7);
        }
        drawing.finish(title)
    }
}

/// Draws picture B with A's outline, grid and points mapped by the homography.
pub(super) fn transfer(made: &Comparison, relation: &Relation, pictures: [&GrayImage; 2]) -> String {
    let small = Small::new(pictures[1]);
    let mut drawing = Drawing::new(small.size[0], small.size[1]);
    small.draw(&mut drawing, [0.0, 0.0]);
    let homography = Homography(relation.matrix);
    let (w, h) = (f64::from(pictures[0].width()), f64::from(pictures[0].height()));
    for k in 0..=GRID {
        let share = k as f64 / GRID as f64;
        let width = if k % GRID == 0 { 1.6 } else { 0.7 };
        for ends in [[(share, 0.0), (share, 1.0)], [(0.0, share), (1.0, share)]] {
            let places: Vec<[f64; 2]> = (0..=GRID * 4)
                .filter_map(|step| {
                    let t = step as f64 / (GRID * 4) as f64;
                    let mix = |from: f64, to: f64| from + t * (to - from);
                    let p = Vector2::new(mix(ends[0].0, ends[1].0) * w - 0.5, mix(ends[0].1, ends[1].1) * h - 0.5);
                    homography.map(p).map(|q| small.at(made.raw_in_second(q)))
                })
                .collect();
            drawing.path(&places, false, "hsl(210 90% 60%)", "none", width);
        }
    }
    let every = relation.inliers.len().div_ceil(MAX_LINES).max(1);
    for &k in relation.inliers.iter().step_by(every) {
        if let Some(mapped) = homography.map(made.pairs[k].from) {
            drawing.cross(small.at(made.raw_in_second(mapped)), 3.0, "hsl(50 95% 55%)", 0.8);
        }
        drawing.circle(small.at(made.raw_places(k)[1]), 1.1, "none", "hsl(140 70% 45%)", 0.0);
    }
    drawing.finish("Picture A laid onto picture B by the homography")
}
