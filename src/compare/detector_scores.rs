//! Scores a detector and a descriptor on two pictures of a plane with a known homography, by the
//! properties the source asks for (repeatability, number, accuracy, distinctiveness; callers
//! measure the time).

use nalgebra::{Matrix3, Vector2};

use super::relations;
use crate::features::two_views::Features;
use crate::features::two_views::repeatability::{Repeatability, repeatability};
use crate::geometry::{Homography, PointPair};
use crate::matching::exact::{ExactMatch, match_exactly};

/// Maximum distance of a right match from where the known homography puts it, pixels. Twice the 1.5
/// of Mikolajczyk and Schmid 2005, since most known homographies are accurate to a pixel. Raised,
/// near misses count.
const RIGHT_PX: f64 = 3.0;

/// The scores of a pair of pictures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DetectorScore {
    /// Number of keypoints in both pictures.
    pub keypoints: [usize; 2],
    /// Fraction of keypoints found again, and their position error; see [`repeatability`].
    pub repeated: Repeatability,
    /// Number of matches.
    pub matches: usize,
    /// Fraction of them that are right.
    pub right: f64,
    /// RMS error of the matches' homography over the first picture's corners, pixels; `None` if
    /// none was found.
    pub corner_error_px: Option<f64>,
}

/// Scores features of two pictures; `known` maps the first's points to the second's.
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
