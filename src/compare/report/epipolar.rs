//! Epipolar lines and epipoles in both pictures.

use image::GrayImage;
use nalgebra::{Matrix3, Vector2};

use super::pairs::{Small, WIDTH};
use crate::compare::{Comparison, Relation};
use crate::geometry::epipolar::{Epipole, clipped, epipoles};
use crate::html_page::svg::{Drawing, hue};

/// Number of matches whose lines are drawn, as in the source's figures 25 and 26.
const LINES: usize = 20;

/// Draws both pictures, with the lines of the same matches in the same colours.
pub(super) fn lines(made: &Comparison, (relation, f): &(&Relation, Matrix3<f64>), pictures: [&GrayImage; 2]) -> String {
    let small = pictures.map(Small::new);
    let mut drawing = Drawing::new(2.0 * WIDTH, small[0].size[1].max(small[1].size[1]));
    let chosen: Vec<usize> = relation.inliers.iter().copied().step_by(relation.inliers.len().div_ceil(LINES).max(1)).collect();
    let poles = epipoles(f);
    for (side, (picture, small)) in pictures.iter().zip(&small).enumerate() {
        let shift = side as f64 * WIDTH;
        let at = |p: Vector2<f64>| {
            let [x, y] = small.at(p);
            [x + shift, y]
        };
        small.draw(&mut drawing, [shift, 0.0]);
        let size = (picture.width(), picture.height());
        for (n, &k) in chosen.iter().enumerate() {
            let pair = &made.pairs[k];
            let (point, line) = if side == 0 { (pair.from, f.transpose() * pair.to.push(1.0)) } else { (pair.to, f * pair.from.push(1.0)) };
            if let Some([p, q]) = clipped(&line, [size.0, size.1]) {
                drawing.line(at(p), at(q), &hue(n), 0.8);
            }
            drawing.circle(at(point), 2.2, &hue(n), "none", 1.0);
        }
        let inside = |p: &Vector2<f64>| p.x >= 0.0 && p.y >= 0.0 && p.x < f64::from(size.0) && p.y < f64::from(size.1);
        let at_point = poles.and_then(|both| if let Epipole::At(pole) = both[side] { Some(pole) } else { None });
        if let Some(pole) = at_point.filter(inside) {
            drawing.circle(at(pole), 6.0, "hsl(0 90% 60%)", "none", 2.0);
        }
    }
    drawing.finish("Epipolar lines in both pictures")
}
