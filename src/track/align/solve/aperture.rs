//! The aperture problem of a whole picture: along the stripes of a curtain almost nothing shows
//! where the camera is, so a pose may slide along them.
//!
//! Nearly all tiles of a pose that slid agree. Across the stripes everything fits, and along them
//! there is almost nothing to see. The little there is (grain, a small picture in between)
//! disagrees and is outvoted. So each direction is tested on its own, by a regression of observed
//! on expected gradients. For a right pose the two are equal in each direction. For one that slid
//! they are unrelated along the stripes.
//!
//! Somebody in front of a part of the picture has the same effect: there, observed gradients are
//! unrelated to the expected ones. So a pose is not refused if the tiles that agree support each
//! direction on their own. Those of a pose that slid do not.

use crate::track::align::tuning::TUNING;
use std::ops::Range;

use nalgebra::{Matrix2, SymmetricEigen, Vector2};

use crate::track::align::pixels::appearance::Appearance;
use crate::track::align::pixels::runs::{Pixels, Run};
use crate::track::frame::light_levels::LightLevel;

/// How the observed gradients agree with the expected ones.
#[derive(Debug, Clone, Copy, Default)]
pub struct GradientAgreement {
    /// Over all pixels where the picture is expected.
    everywhere: GradientSums,
    /// Over the tiles that agree.
    where_agreeing: GradientSums,
}

/// Products of the observed and the expected gradients, summed over pixels.
#[derive(Debug, Clone, Copy, Default)]
struct GradientSums {
    /// Sum of the outer products of the expected gradient with itself.
    expected: Matrix2<f64>,
    /// Sum of the outer products of the observed with the expected gradient.
    both: Matrix2<f64>,
    /// Sum of the outer products of the observed gradient with itself.
    seen: Matrix2<f64>,
    /// Number of pixels.
    count: f64,
}

/// How well a direction is supported: 1 where the observed gradients equal the expected ones, 0
/// where the two are unrelated.
#[derive(Debug, Clone, Copy)]
pub struct DirectionSupport {
    /// Coefficient of the regression of observed on expected gradients.
    pub coefficient: f64,
    /// Its standard deviation if the observed gradients were only noise.
    pub sigma: f64,
}

impl GradientAgreement {
    /// Adds the pixels of a run of a solved level; `agrees`: whether its tile does.
    pub fn add(&mut self, run: &Run, agrees: bool, pixels: &Pixels, appearance: &Appearance, level: LightLevel) {
        let sums = GradientSums::of(run.range(), pixels, appearance, level);
        self.everywhere.join(&sums);
        if agrees {
            self.where_agreeing.join(&sums);
        }
    }

    /// Returns how well the worst and the best direction are supported. `None` where a direction
    /// has no expected gradient.
    pub fn direction_support(&self) -> Option<[DirectionSupport; 2]> {
        self.everywhere.direction_support()
    }

    /// Whether a pose may have slid along stripes. `inlier_ratio`: ratio of tiles that agree.
    pub fn may_have_slid(&self, inlier_ratio: f64) -> bool {
        let is_refuted = |[worst, best]: [DirectionSupport; 2]| {
            worst.coefficient + TUNING.direction_support_sigmas * worst.sigma < TUNING.min_direction_support * best.coefficient
        };
        let is_supported = |[worst, best]: [DirectionSupport; 2]| {
            worst.coefficient - TUNING.direction_support_sigmas * worst.sigma > TUNING.min_direction_support * best.coefficient
        };
        let is_in_doubt =
            inlier_ratio > TUNING.max_hidden_direction_inlier_ratio && self.everywhere.direction_support().is_some_and(is_refuted);
        is_in_doubt && !self.where_agreeing.direction_support().is_some_and(is_supported)
    }
}

impl GradientSums {
    /// Sums over every third of these pixels of a solved level.
    fn of(range: Range<usize>, pixels: &Pixels, appearance: &Appearance, level: LightLevel) -> Self {
        let mut sums = Self::default();
        let first = range.start.next_multiple_of(TUNING.aperture_stride);
        for k in (first..range.end).step_by(TUNING.aperture_stride).filter(|k| pixels.counts[*k] > 0.0) {
            if let Some(seen) = level.gradient(pixels.place.each_ref().map(|place| place[k] as usize)) {
                sums.add(seen, Vector2::new(appearance.across[k].into(), appearance.down[k].into()));
            }
        }
        sums
    }

    fn join(&mut self, other: &Self) {
        self.expected += other.expected;
        self.both += other.both;
        self.seen += other.seen;
        self.count += other.count;
    }

    fn add(&mut self, seen: Vector2<f64>, expected: Vector2<f64>) {
        let product = |a: Vector2<f64>, b: Vector2<f64>| Matrix2::new(a.x * b.x, a.x * b.y, a.y * b.x, a.y * b.y);
        self.expected += product(expected, expected);
        self.both += product(seen, expected);
        self.seen += product(seen, seen);
        self.count += 1.0;
    }

    /// Returns how well the worst and the best direction are supported: the eigenvalues of the
    /// products of observed and expected gradients, whitened by the expected ones. `None` where a
    /// direction has no expected gradient.
    fn direction_support(&self) -> Option<[DirectionSupport; 2]> {
        let root = self.expected.cholesky()?.l();
        let both = 0.5 * (self.both + self.both.transpose());
        let whitened = root.solve_lower_triangular(&root.solve_lower_triangular(&both)?.transpose())?;
        let SymmetricEigen { eigenvalues, eigenvectors } = whitened.symmetric_eigen();
        let of = |n: usize| {
            // In this direction the sum of squares of the expected gradient is 1.
            let direction = root.tr_solve_lower_triangular(&eigenvectors.column(n))?;
            let sigma = (direction.dot(&(self.seen * direction)) / self.count).sqrt();
            Some(DirectionSupport { coefficient: eigenvalues[n], sigma })
        };
        let worst = eigenvalues.imin();
        Some([of(worst)?, of(1 - worst)?])
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    /// Of a picture all of whose tiles agree.
    fn agreeing(sums: GradientSums) -> GradientAgreement {
        GradientAgreement { everywhere: sums, where_agreeing: sums }
    }

    /// Gradients of stripes with grain, at an angle: the expected ones, and the observed ones with
    /// noise. For a pose that slid, the grain is another.
    fn striped(degrees: f64, grain: f64, has_slid: bool) -> GradientSums {
        let mut random = Pcg64Mcg::seed_from_u64(1);
        let mut draw = |size: f64| size * (random.random::<f64>() - 0.5);
        let (sin, cos) = degrees.to_radians().sin_cos();
        let rotated = |across: f64, along: f64| Vector2::new(cos * across - sin * along, sin * across + cos * along);
        let mut sums = GradientSums::default();
        for _ in 0..3000 {
            let (across, along) = (draw(50.0), draw(grain));
            let other = if has_slid { draw(grain) } else { along };
            let noise = Vector2::new(draw(1.0), draw(1.0));
            sums.add(rotated(across, other) + noise, rotated(across, along));
        }
        sums
    }

    #[test]
    fn texture_along_stripes_reveals_a_pose_that_slid() {
        for degrees in [0.0, 30.0, 77.0, 135.0] {
            assert!(agreeing(striped(degrees, 3.0, true)).may_have_slid(0.9), "{degrees}");
            assert!(!agreeing(striped(degrees, 3.0, false)).may_have_slid(1.0), "{degrees}");
        }
    }

    #[test]
    fn equal_gradients_are_supported_in_all_directions() {
        let [worst, best] = striped(30.0, 3.0, false).direction_support().expect("both directions have detail");
        assert!((worst.coefficient - 1.0).abs() < 0.05 && (best.coefficient - 1.0).abs() < 0.01, "{worst:?} {best:?}");
        let [worst, best] = striped(30.0, 3.0, true).direction_support().expect("both directions have detail");
        assert!(
            worst.coefficient.abs() < 4.0 * worst.sigma && worst.sigma < 0.03 && (best.coefficient - 1.0).abs() < 0.01,
            "{worst:?} {best:?}"
        );
    }

    #[test]
    fn people_and_plain_stripes_refute_no_pose() {
        // An occluded part supports no direction; this one has more expected gradients in one
        // direction than in the other.
        let mut sums = striped(30.0, 30.0, false);
        sums.expected += striped(60.0, 30.0, true).expected;
        assert!(!agreeing(sums).may_have_slid(0.5));
        for grain in [0.0, 1e-9, 0.01] {
            assert!(!agreeing(striped(30.0, grain, true)).may_have_slid(1.0), "nothing is to be seen along them");
        }
        assert!(!GradientAgreement::default().may_have_slid(1.0));
    }

    #[test]
    fn a_partial_occluder_does_not_refute_the_rest() {
        let agree = striped(30.0, 30.0, false);
        // The occluder's own stripes run across those expected behind it.
        let mut everywhere = agree;
        let covered = striped(120.0, 3.0, false);
        everywhere.expected += striped(30.0, 3.0, false).expected;
        everywhere.both -= covered.both;
        everywhere.seen += covered.seen;
        everywhere.count += covered.count;
        assert!(agreeing(everywhere).may_have_slid(0.5));
        assert!(!GradientAgreement { everywhere, where_agreeing: agree }.may_have_slid(0.5));
        // Stripes that slid agree only across themselves, and plain ones say nothing.
        for grain in [3.0, 0.01] {
            assert!(GradientAgreement { everywhere, where_agreeing: striped(30.0, grain, true) }.may_have_slid(0.5), "{grain}");
        }
    }
}
