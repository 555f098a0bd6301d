//! Epipolar lines and epipoles in both pictures.

use image::GrayImage;
use nalgebra::{Matrix3, Vector2, Vector3};

use super::pairs::{Small, WIDTH};
use crate::compare::{Comparison, Relation};
use crate::geometry::two_views::epipolar::{Epipole, epipoles};
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

/// Clips a line to a picture of this width and height (pixel centres at integers, so from -0.5 to
/// width - 0.5); `None` if it misses the picture.
fn clipped(line: &Vector3<f64>, [width, height]: [u32; 2]) -> Option<[Vector2<f64>; 2]> {
    let across = line.xy().norm();
    let along = Vector2::new(-line.y, line.x) / across;
    // Working from the line's point nearest to the picture's centre keeps the numbers small.
    let middle = Vector2::new(0.5 * (f64::from(width) - 1.0), 0.5 * (f64::from(height) - 1.0));
    let foot = middle - line.xy() / across * ((line.xy().dot(&middle) + line.z) / across);
    let (mut from, mut to) = (f64::NEG_INFINITY, f64::INFINITY);
    for (k, size) in [width, height].into_iter().enumerate() {
        let (low, high) = (-0.5 - foot[k], f64::from(size) - 0.5 - foot[k]);
        if along[k] == 0.0 {
            if low > 0.0 || high < 0.0 {
                return None;
            }
            continue;
        }
        let (enter, leave) = (low / along[k], high / along[k]);
        (from, to) = (from.max(enter.min(leave)), to.min(enter.max(leave)));
    }
    let ends = [foot + along * from, foot + along * to];
    (from <= to && ends.iter().flatten().all(|v| v.is_finite())).then_some(ends)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn epipolar_lines_are_clipped_at_the_picture_edges() {
        // y = 3 over a 10 x 5 picture.
        let [a, b] = clipped(&Vector3::new(0.0, 2.0, -6.0), [10, 5]).expect("crosses");
        assert!((a.x - b.x).abs() == 10.0 && a.y == 3.0 && b.y == 3.0 && a.x.min(b.x) == -0.5);
        assert_eq!(clipped(&Vector3::new(0.0, 1.0, -5.0), [10, 5]), None);
        for none in [Vector3::zeros(), Vector3::z(), Vector3::repeat(f64::NAN)] {
            assert_eq!(clipped(&none, [10, 5]), None);
        }
        assert_eq!(clipped(&Vector3::new(1.0, 0.0, 0.0), [1, 1]).map(|ends| ends[0].x), Some(0.0));
    }

    proptest! {
        /// Clipped segments lie on the line and in the picture; lines without one miss the picture.
        #[test]
        fn a_clipped_line_lies_on_the_line_within_the_picture(angle in 0.0..6.3_f64, offset in -900.0..900.0_f64, scale in 1e-3..1e3_f64, w in 1..800_u32, h in 1..600_u32) {
            let line = Vector3::new(angle.cos(), angle.sin(), offset) * scale;
            let inside = |p: Vector2<f64>, slack: f64| {
                p.x > -0.5 - slack && p.y > -0.5 - slack && p.x < f64::from(w) - 0.5 + slack && p.y < f64::from(h) - 0.5 + slack
            };
            match clipped(&line, [w, h]) {
                Some(ends) => for p in ends {
                    prop_assert!(line.dot(&p.push(1.0)).abs() < 1e-8 * scale && inside(p, 1e-8));
                },
                None => {
                    let corners = [(-0.5, -0.5), (f64::from(w) - 0.5, -0.5), (-0.5, f64::from(h) - 0.5), (f64::from(w) - 0.5, f64::from(h) - 0.5)];
                    let sides = corners.map(|(x, y)| line.dot(&Vector3::new(x, y, 1.0)) / scale);
                    prop_assert!(sides.iter().all(|s| *s > -1e-9) || sides.iter().all(|s| *s < 1e-9));
                }
            }
        }
    }
}
