//! What a detector and a descriptor are worth on two pictures of a plane whose relation is known: the properties that the source wants of them
//! (repeatability, number, accuracy, distinctiveness; the time is for whoever holds a clock).

use nalgebra::{Matrix3, Vector2};

use super::relations;
use crate::features::Features;
use crate::features::repeatability::{Repeatability, repeatability};
use crate::geometry::{Homography, PointPair};
use crate::matching::{ExactMatch, match_exactly};

/// A match is right where it is within this of where the known homography puts it, pixels. As in Mikolajczyk and Schmid 2005, twice their 1.5: most
/// known relations are good to a pixel. Raised, near misses count.
const RIGHT_PX: f64 = 3.0;

/// What was measured on a pair of pictures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DetectorScore {
    /// Keypoints of both pictures.
    pub keypoints: [usize; 2],
    /// Share of the keypoints that are found again, and how far from where they should be; see [`repeatability`].
    pub repeated: Repeatability,
    /// Matches.
    pub matches: usize,
    /// Share of them that are right.
    pub right: f64,
    /// Root mean square over the first picture's corners of how far the homography from the matches puts them off, pixels; `None` where it found none.
    pub corner_error_px: Option<f64>,
}

/// Scores features of two pictures, of which the first's points are mapped to the second's by `known`.
pub fn score(features: [&Features; 2], sizes: [(u32, u32); 2], known: &Homography, options: &super::CompareOptions) -> DetectorScore {
    let keys = features.map(|f| &f.keypoints);
    let matches = match_exactly(features[0], features[1], &options.matching);
    let pairs: Vec<PointPair> = matches
        .iter()
        .map(|m: &ExactMatch| PointPair { from: keys[0][m.first as usize].position, to: keys[1][m.second as usize].position })
        .collect();
    let is_right = |pair: &&PointPair| known.squared_error(pair) < RIGHT_PX * RIGHT_PX;
    let right = pairs.iter().filter(is_right).count() as f64 / pairs.len().max(1) as f64;
    let found = relations::find(&pairs, None, sizes, options, &|| true).and_then(|found| found.homography);
    DetectorScore {
        keypoints: keys.map(|k| k.len()),
        repeated: repeatability(keys[0], keys[1], known, sizes),
        matches: matches.len(),
        right,
        corner_error_px: found.and_then(|relation| corner_error_px(&relation.matrix, known, sizes[0])),
    }
}

fn corner_error_px(found: &Matrix3<f64>, known: &Homography, (width, height): (u32, u32)) -> Option<f64> {
    let (w, h) = (f64::from(width) - 1.0, f64::from(height) - 1.0);
    let mut sum = 0.0;
    for corner in [Vector2::new(0.0, 0.0), Vector2::new(w, 0.0), Vector2::new(w, h), Vector2::new(0.0, h)] {
        sum += (Homography(*found).map(corner)? - known.map(corner)?).norm_squared();
    }
    Some((sum / 4.0).sqrt())
}
