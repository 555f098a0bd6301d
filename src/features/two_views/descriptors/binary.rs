//! The tracker's own descriptor for any keypoint: oriented brightness comparisons (see
//! `descriptor`) on the pyramid level that matches the keypoint's size.

use super::Describer;
use crate::features::descriptor::{describe, orientation};
use crate::features::extractor::BORDER;
use crate::features::pyramid::Level;
use crate::features::two_views::detectors::REGION_SIGMA;
use crate::features::two_views::keypoint::{Descriptors, Features, Keypoint, PictureForms};

/// 256 brightness comparisons, rotated with the patch.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct BinaryComparisons;

impl Describer for BinaryComparisons {
    fn describe(&self, picture: &PictureForms, keypoints: &[Keypoint]) -> Features {
        let levels = picture.pyramid();
        let described = picture.watch.over(keypoints).filter_map(|keypoint| {
            let level = level_of(levels, keypoint.scale())?;
            let [x, y] = [0, 1].map(|axis| (keypoint.position[axis] + 0.5) * level.scale[axis] - 0.5);
            let inside = |v: f64, n: u32| (f64::from(BORDER)..f64::from(n) - 1.0 - f64::from(BORDER)).contains(&v);
            if !inside(x, level.image.width()) || !inside(y, level.image.height()) {
                return None;
            }
            let (x, y) = (x.round() as u32, y.round() as u32);
            let angle = orientation(&level.smooth, x, y);
            let round = Keypoint::round(keypoint.position, keypoint.scale(), keypoint.response);
            Some((round.rotated(f64::from(angle)), describe(&level.smooth, x, y, angle)))
        });
        let (keypoints, bits) = described.unzip();
        Features { keypoints, descriptors: Descriptors::Bits(bits) }
    }
}

/// Returns the level whose corner regions are closest in size, by ratio.
fn level_of(levels: &[Level], sigma: f64) -> Option<&Level> {
    let off = |level: &&Level| (sigma * level.scale[0] / REGION_SIGMA).ln().abs();
    levels.iter().min_by(|a, b| off(a).total_cmp(&off(b)))
}
