//! The frame shows what the last one did: a still camera. More pixels are used then, and their
//! prediction is kept from frame to frame.
//!
//! Selecting that many pixels takes as long as several frames, so the camera must have been still
//! for some frames first. Each frame is still solved on its own; only the observed intensities are
//! updated.

use super::Hypothesis;
use crate::track::align::frame_problem::{FrameProblem, level_for};
use crate::track::align::pixels::level_spec::LevelSpec;
use crate::track::align::solve::level_problem::Corrected;
use crate::track::align::tuning::TUNING;
use crate::track::frame::frame_levels::{FINEST, LEVELS};

/// The same picture as in the frame before. Leaves the frame unsolved where something moved.
pub struct Unchanged;

impl Hypothesis for Unchanged {
    fn name(&self) -> &'static str {
        "unchanged"
    }

    fn is_called_for(&self, _: &mut FrameProblem) -> bool {
        true
    }

    fn solve(&self, frame: &mut FrameProblem) -> Option<()> {
        frame.buffers.has_kept = frame.same_again().is_some();
        Some(())
    }
}

impl FrameProblem<'_> {
    /// Tries whether the frame shows what the last one did. Then the prediction still holds, and it
    /// pays to use more pixels. `None` if something moved, or the camera has not been still for
    /// long enough.
    fn same_again(&mut self) -> Option<Corrected> {
        let motion = self.known.motion;
        let noise = self.slow.noise.of_still();
        let spec = LevelSpec { count: TUNING.still_pixels, is_dense: true, noise, ..self.spec(FINEST, motion) };
        let is_kept = std::mem::take(&mut self.buffers.has_kept);
        let still_frames = std::mem::take(&mut self.buffers.still_frames);
        if self.buffers.fine.moved_since(&spec, motion) > TUNING.max_still_motion_px {
            return None;
        }
        self.buffers.still_frames = still_frames.saturating_add(1);
        if is_kept {
            self.buffers.fine.renew(&spec, self.levels);
            if self.buffers.still_frames == TUNING.prediction_renewal_frames {
                self.buffers.fine.predict(&spec, motion);
            }
            // The light of a frame whose pose was not accepted must not be kept.
            self.buffers.fine.recall_light(&self.slow.light);
        } else if self.buffers.still_frames >= TUNING.still_frames && self.may_stand_still() && self.lay_out(&spec, motion) {
            self.buffers.fine.predict(&spec, motion);
            // Restarts the count, so that this prediction is renewed once too, even if the camera
            // was still for longer and has been pushed.
            self.buffers.still_frames = TUNING.still_frames;
        } else {
            return None;
        }
        self.buffers.has_kept = true;
        let solved = self.solve_kept(&spec)?;
        let predicted_at = self.buffers.fine.predicted_at()?;
        self.progress.last_step = predicted_at.pose_error_to(&solved.motion);
        Some(solved)
    }

    /// Solves the finest level's pixels; `None` if they moved.
    fn solve_kept(&mut self, spec: &LevelSpec) -> Option<Corrected> {
        let motion = self.known.motion;
        let (fine, _, light) = self.buffers.at_level(FINEST);
        let solved = fine.solve(spec, &self.known, light, false, 2)?;
        (fine.moved_px(spec, motion, &solved.motion) < 2.0 * TUNING.max_still_motion_px).then_some(solved)
    }

    /// Whether the camera may be still. Right after a body was found, its zero velocity means
    /// unknown, not at rest. Selecting all steep pixels takes as long as several frames, so the
    /// usual pixels first show whether it moved.
    fn may_stand_still(&mut self) -> bool {
        if level_for(self.uncertain_px()) < LEVELS - 1 {
            return true;
        }
        let motion = self.known.motion;
        let spec = self.spec(FINEST, motion);
        if !self.lay_out(&spec, motion) {
            return false;
        }
        self.buffers.fine.predict(&spec, motion);
        let is_still = self.solve_kept(&spec).is_some();
        self.buffers.light.clone_from(&self.slow.light);
        is_still
    }
}
