//! The descent through the pyramid levels, from coarse to fine.
//!
//! A level converges from a start that is a few of its pixels off, and costs four times as much as
//! the level above it. So the first descent starts at the level that usually suffices. If its
//! result is not clearly right, a second descent starts from a coarser level. Where that one meets
//! the first one's path, it would end at the same pose, and stops: an occluded body fits badly from
//! any starting level.

use super::super::solve::level_problem::Corrected;
use super::{FrameProblem, LevelFit, level_for};
use crate::motion::Motion;
use crate::track::align::tuning::TUNING;
use crate::track::frame::frame_levels::FINEST;

/// Result of a descent through the levels.
#[derive(Default)]
struct Descent {
    /// The finest level's solution.
    found: Option<Corrected>,
    /// The coarsest level solved above the finest, and the motion found there.
    coarsest: Option<(usize, Motion)>,
    /// Whether it stopped where it met another descent.
    has_met: bool,
}

impl FrameProblem<'_> {
    /// Aligns from the level whose basin holds the usual start error. If the result is not clearly
    /// right, aligns again from the level that holds the whole uncertainty.
    pub fn coarse_to_fine(&mut self) -> Option<Corrected> {
        let far = level_for(self.uncertain_px()).max(FINEST + 1);
        let near = level_for(TUNING.search_radius_ratio * self.slow.start_error_px).min(far);
        let Descent { mut found, coarsest, .. } = self.descend(near, None);
        let mut is_close = found.is_some_and(|f| self.is_close(&f));
        // Residuals beyond `hopeless_sigma` mean blur, not occlusion.
        let may_fit = !is_close && found.is_some_and(|f| f.residual_sigma < TUNING.hopeless_sigma);
        if may_fit && self.was_reported && !self.known.is_sure && self.buffers.fine.may_be_covered() {
            found = self.settle_by_what_fits();
            is_close = found.is_some_and(|f| f.residual_sigma < TUNING.clear_fit_sigma);
        }
        if !is_close && !self.is_nearby_only && !self.wanders && self.begins_above(near, far) {
            found = self.descend_from_far(far, found, coarsest);
        }
        let found = found?;
        let spec = self.spec(FINEST, &found.motion);
        let start_error_px = spec.moved_px(self.known.motion, &found.motion) * spec.frame_px();
        self.updates.start = Some((start_error_px, self.buffers.fine.inlier_tile_ratio()));
        Some(found)
    }

    /// Whether a level above `near`, up to `far`, has enough pixels; otherwise the second descent
    /// would equal the first.
    fn begins_above(&mut self, near: usize, far: usize) -> bool {
        (near + 1..=far).any(|level| self.has_pixels(level))
    }

    /// Whether a level has enough pixels at the predicted motion.
    pub fn has_pixels(&mut self, level: usize) -> bool {
        let motion = self.known.motion;
        let spec = self.spec(level, motion);
        self.lay_out(&spec, motion)
    }

    /// Whether a solution from nearby is clearly right.
    fn is_close(&self, found: &Corrected) -> bool {
        found.residual_sigma < TUNING.clear_fit_sigma
            && self.buffers.fine.inlier_tile_ratio() > TUNING.clear_fit_inlier_ratio * self.slow.inlier_tile_ratio
    }

    /// Descends from the level that holds the whole uncertainty. Where this descent meets the first
    /// one, the first one's solution is restored. `nearby` and `met`: the first descent's solution,
    /// and its coarsest level with the motion found there.
    fn descend_from_far(&mut self, far: usize, nearby: Option<Corrected>, met: Option<(usize, Motion)>) -> Option<Corrected> {
        let progress = self.progress;
        let is_sure = std::mem::replace(&mut self.known.is_sure, self.is_followed);
        self.buffers.trial_light.clone_from(&self.buffers.light);
        let Descent { found, has_met, .. } = self.descend(far, met);
        if !has_met {
            return found;
        }
        // The coarse levels have not touched the finest, so its solution is still there.
        (self.progress, self.known.is_sure) = (progress, is_sure);
        self.buffers.light.clone_from(&self.buffers.trial_light);
        nearby
    }

    /// Solves each level in turn, from a coarse one down to the finest. `other`: a level that
    /// another descent solved, with the motion found there; if this descent finds the same motion
    /// there, it stops.
    fn descend(&mut self, from: usize, other: Option<(usize, Motion)>) -> Descent {
        self.buffers.has_kept = false;
        self.progress.above = None;
        self.buffers.light.clone_from(&self.slow.light);
        let mut motion = *self.known.motion;
        let mut descent = Descent::default();
        let mut is_first = true;
        for level in (FINEST..=from).rev() {
            let spec = self.spec(level, &motion);
            if !self.lay_out(&spec, &motion) {
                continue;
            }
            let Some(solved) = self.iterate(&spec, motion, is_first) else { break };
            if level == FINEST {
                descent.found = solved.converged;
                break;
            }
            let fit = |corrected: Corrected| LevelFit {
                residual_sigma: corrected.residual_sigma,
                inlier_tile_ratio: self.buffers.coarse.inlier_tile_ratio(),
            };
            self.progress.above = solved.converged.map(fit);
            (motion, is_first) = (solved.motion, false);
            descent.coarsest.get_or_insert((level, motion));
            let meets =
                |(at, met): (usize, Motion)| at == level && self.buffers.coarse.moved_px(&spec, &met, &motion) < TUNING.same_minimum_px;
            if other.is_some_and(meets) {
                descent.has_met = true;
                break;
            }
        }
        descent
    }
}

#[cfg(test)]
mod tests {
    use image::GrayImage;
    use nalgebra::{Vector3, Vector6};

    use super::super::super::hypotheses::Hypothesis;
    use super::super::super::hypotheses::occluded::Occluded;
    use super::super::super::learned::online_calibration::OnlineCalibration;
    use super::super::super::request::{AlignRequest, Start};
    use super::super::super::{AlignSurface, CameraRays};
    use super::super::Buffers;
    use super::*;
    use crate::camera::Shutter;
    use crate::geometry::resection::perturbed;
    use crate::motion::{Motion, MotionEstimate};
    use crate::track::frame::frame_levels::FrameLevels;
    use crate::track::synthetic::{cloth, facing, lens, moving_view, view};

    /// Solves for a cloth, visible in the first `open_columns` and occluded by another cloth
    /// elsewhere, from a start that is `off_m` metres to the side.
    fn with_problem(open_columns: u32, off_m: f64, since_s: Option<f64>, ask: impl FnOnce(&mut FrameProblem)) {
        let truth = facing(0.2, -0.3, Vector3::new(0.1, 0.05, 3.4));
        let [stage, other] = [1, 2].map(|seed| view(&cloth(seed), &truth, &lens(480, 360)));
        let covered = GrayImage::from_fn(480, 360, |x, y| *if x < open_columns { &stage } else { &other }.get_pixel(x, y));
        let (mut levels, rays) = (FrameLevels::default(), CameraRays::new(lens(480, 360), None));
        levels.update(&covered);
        let surfaces = [AlignSurface::new(&cloth(1))];
        let slow = OnlineCalibration::new(Shutter { readout_s: 0.0, exposure_s: 1e-6 });
        let mut buffers = Buffers::with_room_for(&surfaces);
        let start = perturbed(&truth, &(Vector6::x() * off_m)).inverse();
        let expected = MotionEstimate::unseen(start, 3.4, 0.1, 0.03);
        let information = expected.covariance.cholesky().expect("positive").inverse();
        let request = AlignRequest::new(Start { since_s, ..Start::found(&expected) }, true);
        let mut problem = FrameProblem::new(&surfaces, &slow, &mut buffers, &mut levels, &rays, &request, &information);
        ask(&mut problem);
    }

    #[test]
    fn a_descent_stops_where_it_meets_the_earlier_one() {
        with_problem(165, 0.01, Some(1.0 / 30.0), |problem| {
            let nearby = problem.descend(FINEST + 1, None);
            let (found, kept) = (nearby.found.expect("the picture agrees in a third"), problem.verify().expect("solved").0);
            let met = problem.descend(FINEST + 3, nearby.coarsest);
            assert!(met.has_met && met.found.is_none());
            // If it continued, it would end at the same pose.
            let whole = problem.descend(FINEST + 3, None).found.expect("the picture agrees in a third");
            let spec = problem.spec(FINEST, &found.motion);
            assert!(spec.moved_px(&found.motion, &whole.motion) < 0.05, "{}", spec.moved_px(&found.motion, &whole.motion));
            // It must restore the whole solution from nearby.
            let nearby = problem.descend(FINEST + 1, None);
            assert!(problem.descend_from_far(FINEST + 3, nearby.found, nearby.coarsest).is_some());
            let again = problem.verify().expect("solved").0;
            assert_eq!((kept.pose, kept.covariance, kept.rms_px), (again.pose, again.covariance, again.rms_px));
        });
    }

    #[test]
    fn a_descent_that_leads_elsewhere_is_completed() {
        // Off by twenty pixels of the frame: five pixels of the level above the finest.
        with_problem(480, 0.14, Some(1.0 / 30.0), |problem| {
            let nearby = problem.descend(FINEST + 1, None);
            let found = problem.descend_from_far(FINEST + 3, nearby.found, nearby.coarsest).expect("reached");
            assert!(
                found.residual_sigma < TUNING.clear_fit_sigma
                    && nearby.found.is_none_or(|found| found.residual_sigma > TUNING.clear_fit_sigma),
                "{}",
                found.residual_sigma
            );
        });
    }

    #[test]
    fn rows_reveal_a_new_bodys_blur_before_the_finest_level() {
        let shutter = Shutter { readout_s: 0.02, exposure_s: 0.012 };
        let still = Motion::still(facing(0.2, -0.3, Vector3::new(0.1, 0.05, 3.4)).inverse());
        // A blur of twelve pixels of the frame.
        let truth = Motion { angular_velocity: Vector3::new(0.3, 2.0, 0.0), ..still };
        let (mut levels, rays, surfaces) = (FrameLevels::default(), CameraRays::new(lens(480, 360), None), [AlignSurface::new(&cloth(1))]);
        levels.update(&moving_view(&cloth(1), &truth, &shutter, &lens(480, 360)));
        let (slow, mut buffers) = (OnlineCalibration::new(shutter), Buffers::with_room_for(&surfaces));
        let expected = MotionEstimate::unseen(truth.pose, 3.4, 0.1, 0.03);
        let information = expected.covariance.cholesky().expect("positive").inverse();
        let request = AlignRequest::new(Start::found(&expected), true);
        let mut problem = FrameProblem::new(&surfaces, &slow, &mut buffers, &mut levels, &rays, &request, &information);
        let found = problem.descend(FINEST + 1, None).found.expect("the picture agrees");
        let LevelFit { residual_sigma, inlier_tile_ratio } = problem.progress.above.expect("solved");
        assert!(
            residual_sigma < TUNING.clear_fit_sigma && inlier_tile_ratio > 0.9 && found.residual_sigma < TUNING.clear_fit_sigma,
            "{residual_sigma} {inlier_tile_ratio} {}",
            found.residual_sigma
        );
    }

    #[test]
    fn an_occluded_body_converges_once_its_inliers_are_known() {
        for open_columns in [160, 180, 200] {
            with_problem(open_columns, 0.01, None, |problem| {
                let found = problem.coarse_to_fine().expect("the picture agrees in a third");
                let left_px = problem.progress.last_moved_px;
                assert!(
                    found.residual_sigma < TUNING.clear_fit_sigma && (TUNING.fine_converged_px..TUNING.max_last_step_px).contains(&left_px),
                    "{left_px} px"
                );
                assert!(Occluded.is_called_for(problem));
                Occluded.solve(problem).expect("the solution remains");
                assert!(problem.progress.last_moved_px < TUNING.fine_converged_px, "{} px", problem.progress.last_moved_px);
                assert!(!Occluded.is_called_for(problem));
            });
        }
    }
}
