//! The aperture problem of a whole picture: along the stripes of a curtain next to nothing tells where the camera is, and a pose may slide.
//!
//! Nearly all tiles of a pose that slid agree: across the stripes all is right, and along them there is next to nothing to see. What there is -
//! grain, a small picture amidst - disagrees, and is outvoted. So directions are asked one by one: of a right pose the gradients of what is seen
//! are those of what is expected in each direction; of one that slid they have nothing to do with each other along the stripes.
//!
//! Somebody in front of a part of the picture has the same effect: there, what is seen has nothing to do with what is expected. So a pose is not refused where the tiles that agree support each
//! direction on their own. Those of a pose that slid do not.

use std::ops::Range;

use nalgebra::{Matrix2, SymmetricEigen, Vector2};

use crate::track::align::pixels::appearance::Appearance;
use crate::track::align::pixels::runs::{Pixels, Run};
use crate::track::frame::frame_levels::Level;

/// Where this share of the tiles agrees, what stands in front of the others does not hide all that tells of one direction. Chosen: poses that slid have above 0.59. Raised,
/// poses slide along stripes behind people; lowered, what is in front may by chance look like the opposite of what it hides.
const MIN_SHARE: f64 = 0.4;
/// The direction that is borne out least must be by this share of the one that is borne out best. Chosen: right poses have above 0.42, behind people too (lines a pixel
/// wide are as steep as differences of neighbours can tell); poses that slid have less than 0.1, strongly blurred ones up to 0.3. Raised, stages of fine level lines
/// are lost; lowered, poses slide along stripes.
const MIN_BORNE_OUT: f64 = 0.3;
/// Where a direction is not borne out, that must be known so well, standard deviations: of plain stripes nothing is expected along them, and chance says anything.
/// Chosen, not tuned. Raised, poses slide along stripes with faint grain; lowered, plain stripes are lost by chance.
const SURE_SIGMAS: f64 = 3.0;
/// Every third chosen pixel is compared. Chosen, not tuned: some 3000 remain of 9000, enough for a regression. Raised, its deviation grows; lowered, frames cost more.
const STRIDE: usize = 3;

/// How the gradients that are seen go with those that are expected.
#[derive(Debug, Clone, Copy, Default)]
pub struct GradientAgreement {
    /// Wherever the picture is expected.
    everywhere: GradientSums,
    /// In the tiles that agree.
    where_agreeing: GradientSums,
}

/// Products of the gradients that are seen and expected, summed over pixels.
#[derive(Debug, Clone, Copy, Default)]
struct GradientSums {
    /// Sum of the outer products of what is expected with itself.
    expected: Matrix2<f64>,
    /// Sum of the outer products of what is seen with what is expected.
    both: Matrix2<f64>,
    /// Sum of the outer products of what is seen with itself.
    seen: Matrix2<f64>,
    /// Pixels.
    count: f64,
}

/// How well a direction is borne out: 1 where what is seen is what is expected, 0 where they have nothing to do with each other.
#[derive(Debug, Clone, Copy)]
pub struct BorneOut {
    /// The regression of what is seen on what is expected.
    pub share: f64,
    /// Its standard deviation, were what is seen nothing but noise.
    pub sigma: f64,
}

impl GradientAgreement {
    /// Takes the pixels of a run of a solved level; `agrees`: whether its tile does.
    pub fn add(&mut self, run: &Run, agrees: bool, pixels: &Pixels, appearance: &Appearance, level: &Level) {
        let sums = GradientSums::of(run.range(), pixels, appearance, level);
        self.everywhere.join(&sums);
        if agrees {
            self.where_agreeing.join(&sums);
        }
    }

    /// How well the directions are borne out, the worst and the best. `None` where a direction expects nothing at all.
    pub fn borne_out(&self) -> Option<[BorneOut; 2]> {
        self.everywhere.borne_out()
    }

    /// Whether a pose may have slid along stripes, of whose tiles this share agrees.
    pub fn may_have_slid(&self, share: f64) -> bool {
        let is_refuted = |[worst, best]: [BorneOut; 2]| worst.share + SURE_SIGMAS * worst.sigma < MIN_BORNE_OUT * best.share;
        let is_borne_out = |[worst, best]: [BorneOut; 2]| worst.share - SURE_SIGMAS * worst.sigma > MIN_BORNE_OUT * best.share;
        let is_in_doubt = share > MIN_SHARE && self.everywhere.borne_out().is_some_and(is_refuted);
        is_in_doubt && !self.where_agreeing.borne_out().is_some_and(is_borne_out)
    }
}

impl GradientSums {
    /// Of every third of these pixels of a solved level.
    fn of(range: Range<usize>, pixels: &Pixels, appearance: &Appearance, level: &Level) -> Self {
        let mut sums = Self::default();
        let first = range.start.next_multiple_of(STRIDE);
        for k in (first..range.end).step_by(STRIDE).filter(|k| pixels.counts[*k] > 0.0) {
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

    /// How well the directions are borne out, the worst and the best: the eigenvalues of the products of seen and expected, measured by what is expected. `None` where a
    /// direction expects nothing at all.
    fn borne_out(&self) -> Option<[BorneOut; 2]> {
        let root = self.expected.cholesky()?.l();
        let both = 0.5 * (self.both + self.both.transpose());
        let whitened = root.solve_lower_triangular(&root.solve_lower_triangular(&both)?.transpose())?;
        let SymmetricEigen { eigenvalues, eigenvectors } = whitened.symmetric_eigen();
        let of = |n: usize| {
            // In this direction the sum of squares of what is expected is 1.
            let direction = root.tr_solve_lower_triangular(&eigenvectors.column(n))?;
            let sigma = (direction.dot(&(self.seen * direction)) / self.count).sqrt();
            Some(BorneOut { share: eigenvalues[n], sigma })
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

    /// Stripes with grain, in any direction: gradients that are expected, and those that are seen with noise; of a pose that slid the grain is another.
    fn striped(degrees: f64, grain: f64, has_slid: bool) -> GradientSums {
        let mut random = Pcg64Mcg::seed_from_u64(1);
        let mut draw = |size: f64| size * (random.random::<f64>() - 0.5);
        let (sin, cos) = degrees.to_radians().sin_cos();
        let turned = |across: f64, along: f64| Vector2::new(cos * across - sin * along, sin * across + cos * along);
        let mut sums = GradientSums::default();
        for _ in 0..3000 {
            let (across, along) = (draw(50.0), draw(grain));
            let other = if has_slid { draw(grain) } else { along };
            let noise = Vector2::new(draw(1.0), draw(1.0));
            sums.add(turned(across, other) + noise, turned(across, along));
        }
        sums
    }

    #[test]
    fn a_pose_that_slid_along_stripes_is_told_by_their_grain() {
        for degrees in [0.0, 30.0, 77.0, 135.0] {
            assert!(agreeing(striped(degrees, 3.0, true)).may_have_slid(0.9), "{degrees}");
            assert!(!agreeing(striped(degrees, 3.0, false)).may_have_slid(1.0), "{degrees}");
        }
    }

    #[test]
    fn the_same_gradients_are_borne_out_in_all_directions() {
        let [worst, best] = striped(30.0, 3.0, false).borne_out().expect("both directions have detail");
        assert!((worst.share - 1.0).abs() < 0.05 && (best.share - 1.0).abs() < 0.01, "{worst:?} {best:?}");
        let [worst, best] = striped(30.0, 3.0, true).borne_out().expect("both directions have detail");
        assert!(worst.share.abs() < 4.0 * worst.sigma && worst.sigma < 0.03 && (best.share - 1.0).abs() < 0.01, "{worst:?} {best:?}");
    }

    #[test]
    fn people_and_plain_stripes_refuse_nothing() {
        // What is covered is borne out in no direction; here it has more of the one than of the other.
        let mut sums = striped(30.0, 30.0, false);
        sums.expected += striped(60.0, 30.0, true).expected;
        assert!(!agreeing(sums).may_have_slid(0.5));
        for grain in [0.0, 1e-9, 0.01] {
            assert!(!agreeing(striped(30.0, grain, true)).may_have_slid(1.0), "nothing is to be seen along them");
        }
        assert!(!GradientAgreement::default().may_have_slid(1.0));
    }

    #[test]
    fn what_stands_before_a_part_of_the_picture_does_not_refute_what_agrees_beside_it() {
        let agree = striped(30.0, 30.0, false);
        // Its own stripes lie across what is expected behind it.
        let mut everywhere = agree;
        let covered = striped(120.0, 3.0, false);
        everywhere.expected += striped(30.0, 3.0, false).expected;
        everywhere.both -= covered.both;
        everywhere.seen += covered.seen;
        everywhere.count += covered.count;
        assert!(agreeing(everywhere).may_have_slid(0.5));
        assert!(!GradientAgreement { everywhere, where_agreeing: agree }.may_have_slid(0.5));
        // Stripes that slid agree but across themselves, and plain ones do not tell.
        for grain in [3.0, 0.01] {
            assert!(GradientAgreement { everywhere, where_agreeing: striped(30.0, grain, true) }.may_have_slid(0.5), "{grain}");
        }
    }
}
