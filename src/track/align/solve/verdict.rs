//! Whether an alignment may be believed: tiles that agree, residuals of the noise's size, and a pose that is where it was expected.

use nalgebra::Matrix6;

use super::aperture::GradientAgreement;
use crate::geometry::{Body, Camera, Pose};
use crate::motion::{Motion, MotionEstimate};
use crate::track::align::kernel::evidence::RunEvidence;

/// What an alignment came to.
#[derive(Debug, Clone, Copy)]
pub struct Alignment {
    /// Pose and motion at the frame's stamp, and what the picture and the prior leave open of them.
    pub estimate: MotionEstimate,
    /// Where the camera was at the stamp. The motion differs from it where the velocity jumped later in the frame.
    pub pose: Pose<Body, Camera>,
    /// Covariance of [δp, δθ] of the pose (axes as in the motion's error): noise and model error.
    pub covariance: Matrix6<f64>,
    /// Robust standard deviation of the residuals, in sigmas of the expected noise.
    pub scale: f64,
    /// Pixels that fit.
    pub inliers: f64,
    /// Root mean square of residual over gradient, pixels of the frame.
    pub rms_px: f64,
    /// Tiles with detail, and those that agree.
    pub tiles: usize,
    /// See `tiles`.
    pub agreeing: usize,
    /// How the gradients that are seen go with those that are expected.
    pub gradients: GradientAgreement,
    /// Squared Mahalanobis distance of the found pose from the expected one, by the covariance of what was expected; about 6 where that is right.
    pub squared_mahalanobis: f64,
    /// Whether the opposite velocity explains the frame as well: of a body that was just found, by its blur.
    pub has_opposite: bool,
}

impl Alignment {
    /// Share of the tiles with detail that agree.
    pub fn share(&self) -> f64 {
        self.agreeing as f64 / self.tiles.max(1) as f64
    }

    /// How well the picture bears the pose out, to compare poses by: the share of the tiles that agree, less where their residuals are larger than noise.
    pub fn strength(&self) -> f64 {
        self.share() / self.scale.max(1.0)
    }

    /// Whether the picture alone leaves no doubt.
    pub fn is_conclusive(&self) -> bool {
        self.tiles >= CONCLUSIVE_TILES && self.share() >= CONCLUSIVE_SHARE
    }

    /// Whether the tiles bear the pose out although more than half of them show something else: of those that took part, the better half, some do, and pull it. Carts that came into view
    /// behind a person were off by three sigmas and more.
    pub fn may_be_pulled(&self) -> bool {
        2 * self.agreeing < self.tiles && are_sure(self.agreeing, self.tiles)
    }

    /// Whether this frame alone may give the pose: so many tiles agree that what is in front of the others does not matter, and the pose is sharp. Tiles
    /// alone do not do: a picture that is seen small has minima beside the right one, where tiles agree a pixel off (one was 47 degrees away), and leaves the
    /// pose open. `distance_m`: to the nearest surface.
    pub fn is_borne_out(&self, distance_m: f64) -> bool {
        let is_clear = self.is_conclusive() || are_sure(self.agreeing, self.tiles);
        is_clear && is_sharp(&self.covariance, distance_m)
    }

    /// Whether the pose was found so far from where it was expected that earlier frames say nothing of it.
    pub fn is_pushed(&self) -> bool {
        self.squared_mahalanobis > MAX_SQUARED_MAHALANOBIS
    }

    /// Whether the pose may be given: it is credible, or bears itself out. What was followed and is found where nothing expected it must show itself as a whole: a
    /// few tiles agree by chance where it goes behind something (a flag in quick motion, at 0.24 of its tiles, was half a degree off). Of what was found anew features
    /// speak for the place as well. `is_followed`: whether it was looked for where it was expected; `was_given`: whether a pose of it ever was.
    pub fn may_be_given(&self, is_followed: bool, was_given: bool, distance_m: f64) -> bool {
        let is_expected = is_followed && !self.is_pushed();
        let may_be_covered = is_expected || !is_followed || self.is_conclusive();
        // Unless the pose is sharp, a second frame has to agree.
        let is_found_again = !is_followed && was_given && self.is_covered_in_part() && self.scale < FITTING_PART_SCALE;
        let is_credible = self.is_credible(is_expected) || is_found_again || (may_be_covered && self.is_borne_out(distance_m));
        is_credible && !self.gradients.may_have_slid(self.share())
    }

    /// Whether enough tiles agree to take the others for covered: less than half of them, but at least `PART_SHARE`.
    pub fn is_covered_in_part(&self) -> bool {
        self.share() >= PART_SHARE && self.may_be_pulled()
    }

    /// Whether the pose is clearly right, or less clearly where it was expected.
    pub fn is_credible(&self, is_expected: bool) -> bool {
        let continues = is_expected
            && self.share() >= CONTINUED_SHARE
            && self.squared_mahalanobis < MAX_SQUARED_MAHALANOBIS
            && self.scale < CONTINUED_SCALE;
        self.agreeing >= MIN_TILES && (self.share() >= NEW_SHARE || continues)
    }
}

/// Fewest agreeing tiles of a pose that is given. Chosen, not tuned. Raised, pictures seen small are lost; lowered, a few tiles that agree
/// by chance are enough.
const MIN_TILES: usize = 8;
/// Least share of the tiles with detail that agree: of any pose, and of one that is where the motion filter expected it. Of 405 wrong poses
/// below 10 % agree, of 638 right ones three quarters above 90 % (docs/alignment.md). Raised, partly covered stages are lost;
/// `CONTINUED_SHARE` below 0.1 would let wrong poses pass.
const NEW_SHARE: f64 = 0.5;
const CONTINUED_SHARE: f64 = 0.12;
/// Least share of agreeing tiles with which a body that was given before is found again while something covers the rest of it. Chosen: flags that came out from behind a person had 0.44 to 0.5. One at 0.39
/// was 0.38 degrees off, three sigmas, probably pulled by tiles at the outline of the person; a wrong pose had 0.3. Raised, such bodies are found later; lowered, their poses are pulled.
const PART_SHARE: f64 = 0.4;
/// Largest residuals of such a pose, sigmas. Chosen: those flags left 1.1 once their blur was known. Raised, something else that fits in part may pass; lowered, blurred bodies are found later.
const FITTING_PART_SCALE: f64 = 1.5;
/// Largest squared Mahalanobis distance of a pose that is where it was expected: ten sigmas, as jerk is not white. Chosen, not tuned.
/// Raised, a jump into a wrong minimum passes for motion; lowered, starts and stops must prove themselves like new poses.
const MAX_SQUARED_MAHALANOBIS: f64 = 100.0;
/// Largest residuals of such a pose, sigmas, of what takes part. It came with `LEVELS` and `MAX_LAST_STEP_PX`: with all three, none of
/// every third frame of d-steep is wrong, before 12.5 % were. Raised, such poses may come back; lowered, a stage that is partly covered is
/// lost sooner.
const CONTINUED_SCALE: f64 = 2.5;
/// Tiles and their agreeing share that leave no doubt: noise is learnt from such a frame, and where its pose is sharp it needs no second one to confirm it. Chosen well above `NEW_SHARE`. Raised, bodies are found a frame later; lowered, a single wrong frame could
/// be given.
const CONCLUSIVE_TILES: usize = 40;
const CONCLUSIVE_SHARE: f64 = 0.7;

/// Agreeing tiles, and their share, that leave no doubt where people or scenery cover the rest. Of 405 wrong poses below 10 % agree
/// (docs/alignment.md). Raised, stages behind people are found late; lowered, poses that are right in a corner may be given.
const SURE_TILES: usize = 24;
const SURE_SHARE: f64 = 0.15;
/// Least variance of a tile's prediction that tells anything, and least sum of it over the tile's pixels, in variances of a pixel's noise. A tile has some 55 pixels:
/// the correlation of a right one, corrected for noise, scatters by 0.2 at the second. With 4 for the first, and no correction, hazy stages had no tile that told
/// (d-haze: 0 to 2 of 160 in five of fifty frames; now 50 to 120, nearly all of which agree). Raised, hazy and dim stages are not found; lowered, noise is asked.
const MIN_DETAIL: f64 = 0.5;
const MIN_DETAIL_IN_ALL: f64 = 25.0;
/// Share of a tile's seen variance that cannot be noise: a usual camera's is assumed at first, and may be too large. Lowered, plain tiles agree by chance.
const MIN_CLEAN: f64 = 0.25;
/// Least correlation of a tile that agrees. Raised, tiles behind gauze and in changing light do not; lowered, tiles of other pictures agree by chance.
const AGREEING_CORRELATION: f64 = 0.9;
/// Largest standard deviation of a pose that a single frame may give, of the distance and in radians: a third of what counts as wrong
/// (1 % and 0.3 degrees). Raised, first poses of a shaken camera may be wrong; lowered, they wait for a second frame.
const SHARP_SHIFT: f64 = 0.0033;
const SHARP_TURN: f64 = 0.00175;

/// Whether enough tiles agree, and a large enough share of all, for the others to be ignored.
pub fn are_sure(agreeing: usize, tiles: usize) -> bool {
    agreeing >= SURE_TILES && agreeing as f64 >= SURE_SHARE * tiles as f64
}

/// Whether a pose is known so well that one frame alone may give it. `covariance`: of shift and turn, with all that is left open; `distance_m`: to the nearest
/// surface.
pub fn is_sharp(covariance: &Matrix6<f64>, distance_m: f64) -> bool {
    let sigma = |first: usize| covariance.fixed_view::<3, 3>(first, first).trace().max(0.0).sqrt();
    sigma(0) < SHARP_SHIFT * distance_m && sigma(3) < SHARP_TURN
}

/// See [`Alignment::squared_mahalanobis`].
pub fn squared_mahalanobis(expected: &MotionEstimate, found: &Motion) -> f64 {
    let error = expected.motion.error_to(found).fixed_rows::<6>(0).into_owned();
    let covariance: Matrix6<f64> = expected.covariance.fixed_view::<6, 6>(0, 0).into_owned();
    covariance.cholesky().map_or(f64::INFINITY, |c| error.dot(&c.solve(&error)))
}

/// Whether a tile agrees with the prediction; `None` where it has too little detail to tell.
pub fn agreement(e: &RunEvidence) -> Option<bool> {
    if e.count < 12.0 {
        return None;
    }
    let n = e.count;
    let [s, p, ss, pp, sp] = e.moments.map(|m| m / n);
    let (seen, predicted, both) = (ss - s * s, pp - p * p, sp - s * p);
    let noise = e.noise / n;
    if predicted < MIN_DETAIL * noise || n * predicted < MIN_DETAIL_IN_ALL * noise {
        return None;
    }
    // Noise is a part of what is seen, and lowers the correlation of a right tile; its size is not known exactly.
    let clean = (seen - noise).max(MIN_CLEAN * seen);
    Some(both > 0.0 && both * both > AGREEING_CORRELATION.powi(2) * clean * predicted)
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::motion::MotionEstimate;

    /// An alignment at 4 m in which so many tiles of 100 agree, with these deviations of each axis: metres, radians.
    fn found(agreeing: usize, shift_m: f64, turn_rad: f64) -> Alignment {
        let variances = [shift_m, shift_m, shift_m, turn_rad, turn_rad, turn_rad].map(|sigma| sigma * sigma);
        Alignment {
            estimate: MotionEstimate::unseen(Pose::identity(), 4.0, shift_m, turn_rad),
            pose: Pose::identity(),
            covariance: Matrix6::from_diagonal(&variances.into()),
            scale: 1.0,
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
    fn a_frame_whose_pose_is_sharp_bears_itself_out_behind_people() {
        assert!(found(30, 0.001, 0.0003).is_borne_out(4.0));
        assert!(!found(10, 0.001, 0.0003).is_borne_out(4.0));
    }

    #[test]
    fn agreeing_tiles_alone_give_no_pose_that_the_picture_leaves_open() {
        // So a small tray had 30 agreeing tiles at a pose that was 47 degrees off, and nothing but its deviation told.
        for (shift_m, turn_rad) in [(0.001, 0.02), (0.05, 0.0003)] {
            let open = found(30, shift_m, turn_rad);
            assert!(!open.is_borne_out(4.0) && !open.is_credible(false));
            assert!(!found(95, shift_m, turn_rad).is_borne_out(4.0));
        }
        // The same deviation in metres is sharp from far away.
        assert!(found(30, 0.01, 0.0003).is_borne_out(40.0) && !found(30, 0.01, 0.0003).is_borne_out(4.0));
    }

    #[test]
    fn what_was_followed_to_where_nothing_expected_it_must_show_itself_as_a_whole() {
        let covered = found(26, 0.001, 0.0003);
        let pushed = |agreeing| Alignment { squared_mahalanobis: 140.0, ..found(agreeing, 0.001, 0.0003) };
        assert!(
            covered.may_be_given(true, true, 4.0) && pushed(26).may_be_given(false, true, 4.0) && pushed(80).may_be_given(true, true, 4.0)
        );
        assert!(!pushed(26).may_be_given(true, true, 4.0));
    }

    #[test]
    fn of_a_known_body_that_is_half_covered_a_pose_that_is_nearly_sharp_waits_for_a_second_frame() {
        let open = |agreeing| found(agreeing, 0.003, 0.0015);
        assert!(!open(45).is_borne_out(4.0) && open(45).may_be_given(false, true, 4.0));
        // What was never given may be another picture, what fits badly something else, and of a third too little is seen.
        assert!(!open(45).may_be_given(false, false, 4.0) && !open(30).may_be_given(false, true, 4.0));
        assert!(!Alignment { scale: 1.8, ..open(45) }.may_be_given(false, true, 4.0));
        assert!(!Alignment { tiles: 45, ..open(20) }.may_be_given(false, true, 4.0), "a few tiles agree by chance");
    }

    /// What a tile of 55 pixels shows: detail of this standard deviation, in noise of two grey levels; or other detail of the same size.
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
    fn tiles_tell_right_from_wrong_in_haze_too() {
        let mut random = Pcg64Mcg::seed_from_u64(3);
        // From detail half as high as the noise, which is not asked, to clear detail.
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
