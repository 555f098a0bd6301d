//! Dominant gradient directions around a keypoint (Lowe, Distinctive Image Features from
//! Scale-Invariant Keypoints, IJCV 2004, section 5).

use std::f32::consts::TAU;

use super::gradients::Gradients;
use super::region::Region;
use super::window::Window;

/// Number of histogram bins (section 5). Raised, close directions are separated better and the
/// histogram is noisier.
const BINS: usize = 36;
/// Sigma of the weights, in sigmas of the region (section 5). Raised, more of the surroundings
/// count.
const WEIGHT_SIGMA: f64 = 1.5;
/// Radius read, in sigmas of the weights; a hundredth of the weight remains there. Raised, it takes
/// longer.
const REACH: f64 = 3.0;
/// Minimum height of a peak, relative to the highest, that gives another keypoint (section 5: 15 %
/// of keypoints have several, which adds much to the stability of matching). Raised, fewer
/// keypoints are duplicated.
const PEAK: f32 = 0.8;
/// Maximum number of directions per keypoint. Raised, keypoints without a clear orientation are
/// duplicated more often.
const MOST: usize = 4;

/// Reusable buffers.
#[derive(Debug, Default)]
pub struct Orientation {
    window: Window,
    gradients: Gradients,
    found: Vec<(f32, f32)>,
}

impl Orientation {
    /// Returns the dominant directions of a region, radians from x to y, strongest first; none if
    /// there is no gradient.
    pub fn directions(&mut self, region: &Region) -> impl Iterator<Item = f32> + use<> {
        let histogram = smoothed(&self.histogram(region));
        let highest = histogram.iter().fold(0.0_f32, |a, b| a.max(*b));
        self.found.clear();
        for (k, &value) in histogram.iter().enumerate() {
            let [before, after] = [histogram[(k + BINS - 1) % BINS], histogram[(k + 1) % BINS]];
            // Of two equal neighbours, the first is the peak.
            if value > before && value >= after && value >= PEAK * highest {
                // The vertex of the parabola through the three.
                let offset = 0.5 * (before - after) / (before + after - 2.0 * value);
                self.found.push((value, (k as f32 + offset) * TAU / BINS as f32));
            }
        }
        self.found.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut directions = [f32::NAN; MOST];
        for (direction, (_, found)) in directions.iter_mut().zip(&self.found) {
            *direction = *found;
        }
        directions.into_iter().filter(|d| d.is_finite())
    }

    /// Weighted gradient lengths by direction, each shared by the two nearest bins.
    fn histogram(&mut self, region: &Region) -> [f32; BINS] {
        let sigma = WEIGHT_SIGMA * region.sigma;
        let reach = REACH * sigma;
        self.window.set(region, reach, sigma);
        let mut bins = [0.0; BINS + 2];
        for y in self.window.rows() {
            let half = (reach * reach - (y as f64 - region.middle.y).powi(2)).max(0.0).sqrt();
            let Some(row) = self.window.row(region, y, -half, half) else { continue };
            self.gradients.of_row(row.rows, row.weights, row.weight);
            for (length, direction) in self.gradients.lengths.iter().zip(&self.gradients.directions) {
                let bin = (direction + TAU / 2.0) * (BINS as f32 / TAU);
                let first = (bin as usize).min(BINS);
                let share = bin - first as f32;
                bins[first] += length * (1.0 - share);
                bins[first + 1] += length * share;
            }
        }
        // Bin 0 is at -pi, which equals pi; direction 0 is half a turn further.
        std::array::from_fn(|k| {
            let bin = (k + BINS / 2) % BINS;
            bins[bin] + if bin < 2 { bins[bin + BINS] } else { 0.0 }
        })
    }
}

/// Smooths the bins with weights 1 4 6 4 1, so that single-pixel peaks merge.
fn smoothed(histogram: &[f32; BINS]) -> [f32; BINS] {
    std::array::from_fn(|k| {
        let at = |offset: usize| histogram[(k + BINS + offset - 2) % BINS];
        (at(0) + at(4) + 4.0 * (at(1) + at(3)) + 6.0 * at(2)) / 16.0
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::*;
    use crate::features::two_views::FloatImage;

    fn directions(level: impl Fn(f32, f32) -> f32) -> Vec<f32> {
        let values = (0..41 * 41).map(|k| level((k % 41) as f32 - 20.3, (k / 41) as f32 - 19.8)).collect();
        let image = FloatImage { width: 41, height: 41, values };
        let region = Region { image: &image, middle: Vector2::new(20.3, 19.8), sigma: 2.0 };
        Orientation::default().directions(&region).collect()
    }

    #[test]
    fn a_ramp_points_up_its_slope() {
        for k in -17..=18_i8 {
            let angle = f32::from(k) * 0.1745;
            let found = directions(|x, y| 10.0 * (x * angle.cos() + y * angle.sin()));
            let error = (found[0] - angle + TAU * 1.5).rem_euclid(TAU) - TAU / 2.0;
            assert!(found.len() == 1 && error.abs() < 0.01, "{angle}: {found:?}");
        }
    }

    #[test]
    fn two_equally_strong_orientations_are_both_found() {
        let mut found = directions(|x, y| 10.0 * x.max(y));
        found.sort_by(f32::total_cmp);
        assert_eq!(found.len(), 2, "{found:?}");
        assert!(found[0].abs() < 0.1 && (found[1] - TAU / 4.0).abs() < 0.1, "{found:?}");
    }

    #[test]
    fn a_uniform_region_has_no_orientation() {
        assert!(directions(|_, _| 9.0).is_empty());
    }
}
