//! Whether an alignment may be reported. The criteria are the ratio of tiles that agree with the
//! picture, residuals of the size of the noise, a pose near the predicted one, and a small
//! covariance.

use crate::track::align::tuning::TUNING;
use nalgebra::Matrix6;

use super::aperture::GradientAgreement;
use super::jump_instant::Mixture;
use crate::geometry::{Body, Camera, Pose};
use crate::motion::{Motion, MotionEstimate};
use crate::track::align::kernel::evidence::RunEvidence;

/// The result of aligning one body with one frame.
#[derive(Debug, Clone, Copy)]
pub struct Alignment {
    /// Pose and motion at the frame's stamp, with their covariance by picture and prior.
    pub estimate: MotionEstimate,
    /// Where the camera was at the stamp. `estimate` differs from it if the velocity jumped later
    /// in the frame.
    pub pose: Pose<Body, Camera>,
    /// Covariance of [δp, δθ] of the pose, in m² and rad² (axes as in the motion's error): noise
    /// and model error.
    pub covariance: Matrix6<f64>,
    /// Robust standard deviation of the residuals, in sigmas of the expected noise.
    pub residual_sigma: f64,
    /// Number of pixels that fit.
    pub inliers: f64,
    /// Root mean square of residual over gradient, pixels of the frame.
    pub rms_px: f64,
    /// Number of tiles with detail, counted once per surface, and of those that agree.
    pub tiles: usize,
    /// See `tiles`.
    pub agreeing: usize,
    /// How the observed gradients agree with the expected ones.
    pub gradients: GradientAgreement,
    /// Squared Mahalanobis distance of the pose from the predicted one, by the prediction's
    /// covariance; about 6 if that is right.
    pub squared_mahalanobis: f64,
    /// Whether the opposite velocity explains the frame as well. Possible where the velocity of a
    /// newly found body comes from its blur.
    pub has_opposite: bool,
}

impl Alignment {
    /// Returns the ratio of tiles with detail that agree.
    pub fn inlier_ratio(&self) -> f64 {
        self.agreeing as f64 / self.tiles.max(1) as f64
    }

    /// Returns how well the picture supports the pose, for comparing poses: the ratio of agreeing
    /// tiles, lowered where residuals exceed the noise.
    pub fn strength(&self) -> f64 {
        self.inlier_ratio() / self.residual_sigma.max(1.0)
    }

    /// Corrects pose and motion by a mixture over velocity jumps, and adds its uncertainty.
    pub fn take_mixture(&mut self, mixture: &Mixture) {
        let Self { estimate, pose, covariance, .. } = self;
        *pose = estimate.motion.with_pose_corrected(&mixture.pose);
        *covariance += mixture.pose_covariance;
        *estimate = MotionEstimate { motion: estimate.motion.corrected(&mixture.motion), covariance: mixture.motion_covariance };
    }

    /// Whether the picture alone is conclusive.
    pub fn is_conclusive(&self) -> bool {
        self.tiles >= TUNING.conclusive_tiles && self.inlier_ratio() >= TUNING.conclusive_inlier_ratio
    }

    /// Whether the tiles support the pose although more than half of them show something else. Some
    /// of those took part, as the better half always does, and may pull it: carts that came into
    /// view behind a person were off by three sigmas and more.
    pub fn may_be_pulled(&self) -> bool {
        2 * self.agreeing < self.tiles && are_sure(self.agreeing, self.tiles)
    }

    /// Whether this frame alone supports the pose: enough tiles agree to ignore what occludes the
    /// others, and the pose is sharp. Agreeing tiles are not enough. A picture that is seen small
    /// has local minima near the right one, where tiles agree a pixel off (one was 47 degrees off),
    /// and leaves the pose uncertain. `distance_m`: to the nearest surface.
    pub fn is_supported(&self, distance_m: f64) -> bool {
        let is_clear = self.is_conclusive() || are_sure(self.agreeing, self.tiles);
        is_clear && is_sharp(&self.covariance, distance_m)
    }

    /// Whether the pose is so far from the predicted one that earlier frames say nothing of it.
    pub fn is_far_from_prediction(&self) -> bool {
        self.squared_mahalanobis > TUNING.max_prediction_squared_mahalanobis
    }

    /// Whether the pose may be reported. One of three must hold: it is credible, this frame alone
    /// supports it, or a known body was found again behind an occluder. And it must not have slid
    /// along stripes. A followed body that is found where it was not predicted must show
    /// itself as a whole. When it goes behind something, a few tiles agree by chance (a fast flag,
    /// with 0.24 of its tiles, was half a degree off). For a newly found body, features support the
    /// place as well. `is_followed`: whether it was searched for where it was predicted;
    /// `was_reported`: whether a pose of it was ever reported.
    pub fn may_be_reported(&self, is_followed: bool, was_reported: bool, distance_m: f64) -> bool {
        let is_predicted = is_followed && !self.is_far_from_prediction();
        let may_be_covered = is_predicted || !is_followed || self.is_conclusive();
        // Such a pose, unless it is sharp, waits for a second frame to agree.
        let is_found_again = !is_followed && was_reported && self.is_covered_in_part() && self.residual_sigma < TUNING.max_occluded_sigma;
        let is_credible = self.is_credible(is_predicted) || is_found_again || (may_be_covered && self.is_supported(distance_m));
        is_credible && !self.gradients.may_have_slid(self.inlier_ratio())
    }

    /// Whether enough tiles agree to take the others for occluded: less than half of them, but at
    /// least `min_occluded_inlier_ratio`.
    pub fn is_covered_in_part(&self) -> bool {
        self.inlier_ratio() >= TUNING.min_occluded_inlier_ratio && self.may_be_pulled()
    }

    /// Whether the pose is clearly right, or less clearly but where it was predicted.
    pub fn is_credible(&self, is_predicted: bool) -> bool {
        let continues = is_predicted
            && self.inlier_ratio() >= TUNING.min_continued_inlier_ratio
            && self.squared_mahalanobis < TUNING.max_prediction_squared_mahalanobis
            && self.residual_sigma < TUNING.max_continued_sigma;
        self.agreeing >= TUNING.min_agreeing_tiles && (self.inlier_ratio() >= TUNING.min_new_inlier_ratio || continues)
    }
}

/// Whether enough tiles agree, in number and ratio, to ignore the others.
pub fn are_sure(agreeing: usize, tiles: usize) -> bool {
    agreeing >= TUNING.sufficient_tiles && agreeing as f64 >= TUNING.sufficient_inlier_ratio * tiles as f64
}

/// Whether a pose is certain enough for one frame alone to report it. `covariance`: of shift and
/// rotation, with all contributions, m² and rad²; `distance_m`: to the nearest surface.
pub fn is_sharp(covariance: &Matrix6<f64>, distance_m: f64) -> bool {
    let sigma = |first: usize| covariance.fixed_view::<3, 3>(first, first).trace().max(0.0).sqrt();
    sigma(0) < TUNING.max_single_frame_shift_sigma * distance_m && sigma(3) < TUNING.max_single_frame_rotation_sigma
}

/// Returns [`Alignment::squared_mahalanobis`]; infinite where the covariance is singular.
pub fn squared_mahalanobis(expected: &MotionEstimate, found: &Motion) -> f64 {
    let error = expected.motion.error_to(found).fixed_rows::<6>(0).into_owned();
    let covariance: Matrix6<f64> = expected.covariance.fixed_view::<6, 6>(0, 0).into_owned();
    covariance.cholesky().map_or(f64::INFINITY, |c| error.dot(&c.solve(&error)))
}

/// Whether a tile agrees with its prediction; `None` where it has too little detail to tell.
pub fn agreement(e: &RunEvidence) -> Option<bool> {
    if e.count < 12.0 {
        return None;
    }
    let n = e.count;
    let [s, p, ss, pp, sp] = e.moments.map(|m| m / n);
    let (seen, predicted, both) = (ss - s * s, pp - p * p, sp - s * p);
    let noise = e.noise / n;
    if predicted < TUNING.min_tile_detail * noise || n * predicted < TUNING.min_tile_detail_sum * noise {
        return None;
    }
    // Noise lowers the correlation of a right tile. Its variance is subtracted, but not in full, as
    // it is not known exactly.
    let clean = (seen - noise).max(TUNING.min_signal_ratio * seen);
    Some(both > 0.0 && both * both > TUNING.min_agreeing_correlation.powi(2) * clean * predicted)
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::motion::MotionEstimate;

    /// An alignment at 4 m in which `agreeing` of 100 tiles agree, with these standard deviations
    /// of each axis: metres, radians.
    fn found(agreeing: usize, shift_m: f64, rotation_rad: f64) -> Alignment {
        let variances = [shift_m, shift_m, shift_m, rotation_rad, rotation_rad, rotation_rad].map(|sigma| sigma * sigma);
        Alignment {
            estimate: MotionEstimate::unseen(Pose::identity(), 4.0, shift_m, rotation_rad),
            pose: Pose::identity(),
            covariance: Matrix6::from_diagonal(&variances.into()),
            residual_sigma: 1.0,
            inliers: 5000.0,
            rms_px: 0.05,
            tiles: 100,
            agreeing,
            gradients: GradientAgreement::default(),
            squared_mahalanobis: 6.0,
            has_opposite: false,
        }
    }

    #[test]
    fn a_sharp_pose_is_supported_despite_occlusion() {
        assert!(found(30, 0.001, 0.0003).is_supported(4.0));
        assert!(!found(10, 0.001, 0.0003).is_supported(4.0));
    }

    #[test]
    fn agreeing_tiles_alone_do_not_support_an_uncertain_pose() {
        // A small tray had 30 agreeing tiles at a pose that was 47 degrees off; only its standard
        // deviation showed it.
        for (shift_m, rotation_rad) in [(0.001, 0.02), (0.05, 0.0003)] {
            let open = found(30, shift_m, rotation_rad);
            assert!(!open.is_supported(4.0) && !open.is_credible(false));
            assert!(!found(95, shift_m, rotation_rad).is_supported(4.0));
        }
        // The same deviation in metres is sharp from far away.
        assert!(found(30, 0.01, 0.0003).is_supported(40.0) && !found(30, 0.01, 0.0003).is_supported(4.0));
    }

    #[test]
    fn a_followed_pose_far_from_its_prediction_must_be_unoccluded() {
        let covered = found(26, 0.001, 0.0003);
        let far_from_prediction = |agreeing| Alignment { squared_mahalanobis: 140.0, ..found(agreeing, 0.001, 0.0003) };
        assert!(
            covered.may_be_reported(true, true, 4.0)
                && far_from_prediction(26).may_be_reported(false, true, 4.0)
                && far_from_prediction(80).may_be_reported(true, true, 4.0)
        );
        assert!(!far_from_prediction(26).may_be_reported(true, true, 4.0));
    }

    #[test]
    fn a_half_occluded_known_body_may_be_confirmed_by_two_frames() {
        let open = |agreeing| found(agreeing, 0.003, 0.0015);
        assert!(!open(45).is_supported(4.0) && open(45).may_be_reported(false, true, 4.0));
        // A body that was never reported may be another picture; one that fits badly may be
        // something else; of one seen by a third, too little is visible.
        assert!(!open(45).may_be_reported(false, false, 4.0) && !open(30).may_be_reported(false, true, 4.0));
        assert!(!Alignment { residual_sigma: 1.8, ..open(45) }.may_be_reported(false, true, 4.0));
        assert!(!Alignment { tiles: 45, ..open(20) }.may_be_reported(false, true, 4.0), "a few tiles agree by chance");
    }

    /// A tile of 55 pixels: detail of this standard deviation, in noise of two grey levels, or
    /// other detail of the same size.
    fn tile(random: &mut Pcg64Mcg, detail: f64, is_right: bool) -> RunEvidence {
        let (pixels, noise) = (55, 2.0);
        let mut normal = move || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        let mut moments = [0.0; 5];
        for _ in 0..pixels {
            let predicted = 100.0 + detail * normal();
            let seen = if is_right { predicted } else { 100.0 + detail * normal() } + noise * normal();
            moments.iter_mut().zip([seen, predicted, seen * seen, predicted * predicted, seen * predicted]).for_each(|(m, v)| *m += v);
        }
        let count = f64::from(pixels);
        RunEvidence { count, moments, noise: count * noise * noise, ..RunEvidence::default() }
    }

    #[test]
    fn tile_agreement_separates_right_from_wrong_in_haze() {
        let mut random = Pcg64Mcg::seed_from_u64(3);
        // From detail half as large as the noise, which is not judged, to clear detail.
        for (detail, tells, right) in [(1.0, 0..1, 0..1), (2.5, 1000..1001, 650..1001), (20.0, 1000..1001, 1000..1001)] {
            let mut of = |is_right: bool| (0..1000).filter_map(|_| agreement(&tile(&mut random, detail, is_right))).collect::<Vec<_>>();
            let (of_right, of_wrong) = (of(true), of(false));
            let agree = |all: &[bool]| all.iter().filter(|agrees| **agrees).count();
            assert!(tells.contains(&of_right.len()), "{detail}: {}", of_right.len());
            assert!(right.contains(&agree(&of_right)), "{detail}: {} agree", agree(&of_right));
            assert!(agree(&of_wrong) < 3, "{detail}: {} of wrong ones agree", agree(&of_wrong));
        }
    }
}
