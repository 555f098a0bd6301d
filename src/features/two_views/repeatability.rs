//! How many keypoints of a picture of a plane are found again in another picture of it, and how
//! precisely (Mikolajczyk & Schmid, Scale & Affine Invariant Interest Point Detectors, IJCV 2004,
//! section 6.1; Mikolajczyk et al., A Comparison of Affine Region Detectors, IJCV 2005, section 4).
//!
//! Two keypoints correspond if their positions agree and, if their detector estimates a size, their
//! regions do. A detector of corners of one fixed size does not measure how large a corner is: its
//! regions would fail under any zoom, however precise the positions. For those only the position
//! counts, as in Schmid, Mohr & Bauckhage, Evaluation of Interest Point Detectors, IJCV 2000,
//! section 3.

use std::collections::BTreeMap;
use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{Matrix2, Vector2};

use super::keypoint::Keypoint;
use crate::geometry::Homography;

/// Maximum distance of corresponding keypoints in the second picture, pixels (2004, section 6.1).
/// Raised, neighbours count as corresponding.
const SAME_PLACE_PX: f64 = 1.5;
/// Maximum overlap error of two regions, as a fraction of their union (2004, section 6.1; 2005,
/// section 4.1). Raised, worse fitting regions count as found again, which descriptors tolerate
/// less.
const MAX_OVERLAP_ERROR: f64 = 0.4;
/// Relative difference of sizes up to which they count as equal: rounding.
const SAME_SIZE: f64 = 1e-6;
/// Maximum number of candidates per keypoint, nearest first. More are within [`SAME_PLACE_PX`] only
/// in a cluster of keypoints, where any will do.
const CANDIDATES: usize = 16;

/// Repeatability of keypoints.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Repeatability {
    /// Fraction of the keypoints in the common part of both pictures with a correspondence,
    /// relative to the picture that has fewer there; 0 if one has none.
    pub share: f64,
    /// Median distance of corresponding keypoints in the second picture, pixels; `None` without
    /// any.
    pub error_px: Option<f64>,
}

/// Compares the keypoints of two pictures of `sizes` (width and height, pixels); `known` maps the
/// first's pixels to the second's. A keypoint that occurs several times with different orientations
/// counts once.
pub fn repeatability(first: &[Keypoint], second: &[Keypoint], known: &Homography, sizes: [(u32, u32); 2]) -> Repeatability {
    let Some(back) = known.inverse() else { return Repeatability { share: 0.0, error_px: None } };
    let here: Vec<Seen> = first.iter().filter_map(|k| seen_through(k, known, sizes)).collect();
    let there = second.iter().filter(|k| seen_through(k, &back, [sizes[1], sizes[0]]).is_some());
    let there: Vec<Seen> = there.map(|k| Seen { place: k.position, spread: k.shape * k.shape.transpose() }).collect();
    let (here, there) = (distinct(here), distinct(there));
    let sized = !one_size(first, second);
    let distances = partners(&here, &there, sized);
    let fewer = here.len().min(there.len());
    let share = if fewer == 0 { 0.0 } else { distances.len() as f64 / fewer as f64 };
    Repeatability { share, error_px: median(distances) }
}

/// A keypoint, mapped to the second picture.
#[derive(Debug, Clone, Copy)]
struct Seen {
    place: Vector2<f64>,
    /// Covariance of its region.
    spread: Matrix2<f64>,
}

/// Maps a keypoint to the other picture, if both pictures show its place.
fn seen_through(keypoint: &Keypoint, map: &Homography, sizes: [(u32, u32); 2]) -> Option<Seen> {
    let shown =
        |p: Vector2<f64>, (w, h): (u32, u32)| (0.0..=f64::from(w) - 1.0).contains(&p.x) && (0.0..=f64::from(h) - 1.0).contains(&p.y);
    let place = shown(keypoint.position, sizes[0]).then(|| map.map(keypoint.position)).flatten()?;
    let h = &map.0;
    let depth = h[(2, 0)] * keypoint.position.x + h[(2, 1)] * keypoint.position.y + h[(2, 2)];
    let slope = Matrix2::from_fn(|r, c| (h[(r, c)] - place[r] * h[(2, c)]) / depth);
    let shape = slope * keypoint.shape;
    shown(place, sizes[1]).then(|| Seen { place, spread: shape * shape.transpose() })
}

/// Whether all keypoints have one size, so that their detector does not estimate it.
fn one_size(first: &[Keypoint], second: &[Keypoint]) -> bool {
    let mut all = first.iter().chain(second);
    let Some(size) = all.next().map(Keypoint::scale) else { return true };
    all.all(|k| (k.scale() - size).abs() <= SAME_SIZE * size && k.is_round())
}

/// Sorts by row and removes duplicates of position and region.
fn distinct(mut all: Vec<Seen>) -> Vec<Seen> {
    let key = |s: &Seen| [s.place.y, s.place.x, s.spread[(0, 0)], s.spread[(1, 1)], s.spread[(0, 1)]];
    all.sort_by(|a, b| {
        let places = key(a).into_iter().zip(key(b)).map(|(a, b)| a.total_cmp(&b));
        places.fold(std::cmp::Ordering::Equal, std::cmp::Ordering::then)
    });
    // Rotating a region leaves its spread the same up to rounding.
    all.dedup_by(|a, b| a.place == b.place && (a.spread - b.spread).amax() <= SAME_SIZE * b.spread.amax());
    all
}

/// Returns the distances of corresponding keypoints, matched one to one, nearest first.
fn partners(here: &[Seen], there: &[Seen], sized: bool) -> Vec<f64> {
    let cell = |p: Vector2<f64>| ((p.y / SAME_PLACE_PX).floor() as i64, (p.x / SAME_PLACE_PX).floor() as i64);
    let mut cells: BTreeMap<(i64, i64), Vec<usize>> = BTreeMap::new();
    for (k, seen) in there.iter().enumerate() {
        cells.entry(cell(seen.place)).or_default().push(k);
    }
    let mut pairs = Vec::new();
    for (i, seen) in here.iter().enumerate() {
        let (row, column) = cell(seen.place);
        let near = (row - 1..=row + 1).flat_map(|r| cells.range((r, column - 1)..=(r, column + 1))).flat_map(|(_, all)| all);
        let distance = |k: usize| (there[k].place - seen.place).norm();
        let mut near: Vec<(f64, usize, usize)> = near.map(|&k| (distance(k), i, k)).filter(|n| n.0 <= SAME_PLACE_PX).collect();
        near.retain(|&(_, _, k)| !sized || overlap_error(&seen.spread, &there[k].spread) < MAX_OVERLAP_ERROR);
        near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.2.cmp(&b.2)));
        pairs.extend(near.into_iter().take(CANDIDATES));
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let (mut free_here, mut free_there) = (vec![true; here.len()], vec![true; there.len()]);
    pairs.retain(|&(_, i, k)| {
        let both = free_here[i] && free_there[k];
        if both {
            (free_here[i], free_there[k]) = (false, false);
        }
        both
    });
    pairs.into_iter().map(|(distance, _, _)| distance).collect()
}

/// Returns the fraction of the union of two concentric ellipses that is not in both. Their
/// positions are compared separately.
fn overlap_error(a: &Matrix2<f64>, b: &Matrix2<f64>) -> f64 {
    // In the frame where `a` is the unit circle, `b` has these squared half axes.
    let Some(inverse) = a.try_inverse() else { return 1.0 };
    let product = inverse * b;
    let (half, determinant) = (0.5 * product.trace(), product.determinant());
    let root = (half * half - determinant).max(0.0).sqrt();
    let (long, short) = ((half + root).sqrt(), (half - root).sqrt());
    let common = if short >= 1.0 {
        PI
    } else if long <= 1.0 {
        PI * long * short
    } else {
        // They cross at this height. The circle bounds the common part near the long axis, the
        // ellipse the rest.
        let height = ((1.0 - long.powi(-2)) / (short.powi(-2) - long.powi(-2))).sqrt().min(short);
        2.0 * height.asin() + 2.0 * long * short * (FRAC_PI_2 - (height / short).asin())
    };
    let error = 1.0 - common / (PI + PI * long * short - common);
    if error.is_finite() { error } else { 1.0 }
}

/// Median of ascending values.
fn median(values: Vec<f64>) -> Option<f64> {
    let upper = values.get(values.len() / 2)?;
    let lower = values.get((values.len() - 1) / 2)?;
    Some(0.5 * (lower + upper))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

    const SIZES: [(u32, u32); 2] = [(400, 300), (400, 300)];

    /// Places all over a picture, none near another.
    fn scattered(sigma: impl Fn(usize) -> f64) -> Vec<Keypoint> {
        let place = |k: usize| Vector2::new((k % 20) as f64 * 20.0 + (k * 7 % 11) as f64, (k / 20) as f64 * 20.0 + (k * 5 % 13) as f64);
        (0..300).map(|k| Keypoint::round(place(k), sigma(k), 1.0)).collect()
    }

    /// A zoom by `s` with a little perspective.
    fn view(s: f64) -> Homography {
        Homography(Matrix3::new(s, 0.1, 5.0, -0.1, s, 30.0, 1e-4, -1e-4, 1.0))
    }

    /// The keypoints mapped to the second picture, moved by `offset`.
    fn moved(all: &[Keypoint], h: &Homography, offset: f64) -> Vec<Keypoint> {
        let there = |k: &Keypoint| {
            let position = h.map(k.position).unwrap();
            let slope = |d: Vector2<f64>| (h.map(k.position + 1e-4 * d).unwrap() - position) / 1e-4;
            let shape = Matrix2::from_columns(&[slope(Vector2::x()), slope(Vector2::y())]) * k.shape;
            Keypoint { position: position + Vector2::new(offset, 0.0), shape, response: 1.0 }
        };
        all.iter().map(there).collect()
    }

    #[test]
    fn keypoints_moving_with_the_plane_repeat_with_their_error() {
        let (h, first) = (view(0.8), scattered(|k| 2.0 + (k % 5) as f64));
        let found = repeatability(&first, &moved(&first, &h, 0.3), &h, SIZES);
        assert!(found.share > 0.99 && (found.error_px.unwrap() - 0.3).abs() < 1e-6, "{found:?}");
        assert_eq!(repeatability(&first, &moved(&first, &h, 1.6), &h, SIZES), Repeatability { share: 0.0, error_px: None });
    }

    #[test]
    fn the_wrong_size_or_shape_is_not_found_again() {
        let (h, first) = (view(0.8), scattered(|k| 2.0 + (k % 5) as f64));
        for (factor, share) in [(0.8, 1.0), (1.25, 1.0), (0.7, 0.0), (1.4, 0.0)] {
            let mut second = moved(&first, &h, 0.0);
            second.iter_mut().for_each(|k| k.shape *= factor);
            assert!((repeatability(&first, &second, &h, SIZES).share - share).abs() < 0.01, "{factor}");
            let mut second = moved(&first, &h, 0.0);
            // The same area, but an ellipse.
            second.iter_mut().for_each(|k| k.shape = Matrix2::new(1.5, 0.0, 0.0, 1.0 / 1.5) * k.shape);
            assert!(repeatability(&first, &second, &h, SIZES).share < 0.01);
        }
    }

    #[test]
    fn corners_of_equal_size_are_compared_by_position() {
        let (h, first) = (view(0.5), scattered(|_| 2.0));
        let mut second = moved(&first, &h, 0.5);
        second.iter_mut().for_each(|k| k.shape = Matrix2::identity() * 2.0);
        let found = repeatability(&first, &second, &h, SIZES);
        assert!(found.share > 0.99 && (found.error_px.unwrap() - 0.5).abs() < 1e-6, "{found:?}");
    }

    #[test]
    fn partners_are_one_to_one_within_the_common_area() {
        let first = scattered(|_| 2.0);
        // Two for each: half of them correspond to none, and the smaller number counts.
        let twice: Vec<Keypoint> = first.iter().flat_map(|k| [0.2, 0.9].map(|d| moved(&[*k], &view(1.0), d)[0])).collect();
        let found = repeatability(&first, &twice, &view(1.0), SIZES);
        assert!(found.share > 0.95 && found.share <= 1.0 && (found.error_px.unwrap() - 0.2).abs() < 1e-3, "{found:?}");
        // A keypoint with three orientations counts once, so two of four are found again.
        let [a, b] = [first[0], first[5]];
        let rotated = [a, a.rotated(1.0), a.rotated(2.0), b];
        let other = [a, Keypoint::round(Vector2::new(300.0, 200.0), 2.0, 1.0)];
        let still = Homography(Matrix3::identity());
        assert_eq!(repeatability(&rotated, &other, &still, SIZES).share, 0.5);
        // Parts that the second picture does not show do not count against it.
        let aside = Homography(Matrix3::new(1.0, 0.0, 200.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0));
        assert!(repeatability(&first, &moved(&first, &aside, 0.0), &aside, SIZES).share > 0.99);
    }

    #[test]
    fn ellipse_overlap_matches_pixel_counting() {
        let ellipse = |a: f64, b: f64, angle: f64| {
            let rotation = nalgebra::Rotation2::new(angle).into_inner();
            rotation * Matrix2::new(a * a, 0.0, 0.0, b * b) * rotation.transpose()
        };
        for (a, b) in [((20.0, 10.0, 0.3), (15.0, 12.0, 1.2)), ((20.0, 20.0, 0.0), (10.0, 10.0, 0.0)), ((9.0, 8.0, 0.1), (30.0, 20.0, 2.0))]
        {
            let (a, b) = (ellipse(a.0, a.1, a.2), ellipse(b.0, b.1, b.2));
            let inside = |m: &Matrix2<f64>, p: Vector2<f64>| (p.transpose() * m.try_inverse().unwrap() * p)[0] < 1.0;
            let (mut both, mut either) = (0, 0);
            for k in 0..640 * 640 {
                let p = Vector2::new(f64::from(k % 640) - 320.0, f64::from(k / 640) - 320.0) * 0.1;
                both += i32::from(inside(&a, p) && inside(&b, p));
                either += i32::from(inside(&a, p) || inside(&b, p));
            }
            let exact = 1.0 - f64::from(both) / f64::from(either);
            assert!((overlap_error(&a, &b) - exact).abs() < 3e-3 && (overlap_error(&b, &a) - exact).abs() < 3e-3, "{exact}");
        }
    }

    #[test]
    fn empty_and_invalid_keypoints_have_no_partners() {
        let nothing = Repeatability { share: 0.0, error_px: None };
        let (some, still) = (scattered(|_| 2.0), Homography(Matrix3::identity()));
        let odd: Vec<Keypoint> = some.iter().map(|k| Keypoint { position: k.position * f64::NAN, ..*k }).collect();
        let flat: Vec<Keypoint> = some.iter().map(|k| Keypoint { shape: Matrix2::zeros(), ..*k }).collect();
        assert_eq!(repeatability(&[], &[], &still, SIZES), nothing);
        assert_eq!(repeatability(&some, &[], &still, SIZES), nothing);
        assert_eq!(repeatability(&some, &odd, &still, SIZES), nothing);
        assert_eq!(repeatability(&some, &flat, &still, SIZES), nothing);
        assert_eq!(repeatability(&some, &some, &Homography(Matrix3::zeros()), SIZES), nothing);
        assert_eq!(repeatability(&some, &some, &still, [(0, 0), (400, 300)]), nothing);
        let heap: Vec<Keypoint> = (0..3000).map(|k| Keypoint::round(Vector2::new(5.0 + 1e-4 * f64::from(k), 5.0), 2.0, 1.0)).collect();
        assert!(repeatability(&heap, &heap, &still, SIZES).share > 0.99);
    }
}
