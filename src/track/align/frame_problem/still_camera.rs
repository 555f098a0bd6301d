//! Frames of a camera that stands still: more pixels are asked, and their prediction is kept from frame to frame.
//!
//! Laying them out takes several frames' time, so a camera must have stood for some frames first. Each frame is still solved by itself; only what it shows is renewed.

use super::super::pixels::level_spec::LevelSpec;
use super::super::solve::level_problem::Corrected;
use super::{FrameProblem, level_for};
use crate::track::frame::frame_levels::{FINEST, LEVELS};

/// Pixels asked while nothing moves: their prediction is kept from frame to frame. More than the steep pixels of d-still (105,000); with
/// 62,000 its scatter was 0.0134 mm instead of 0.0119. Raised, only the frames of larger cameras cost more.
const STILL_PIXELS: usize = 130_000;
/// A prediction is kept for the next frame while nothing moved by more, pixels of the level; the solution may lie twice as far. Chosen near
/// the last step of a frame. Lowered, still cameras choose their pixels anew, which scatters (d-still: 0.0194 instead of 0.0176 mm);
/// raised, slopes and squares are used where they hold less well.
const KEPT_PX: f64 = 0.05;
/// Frames in a row in which nothing moved before all steep pixels are laid out, which takes several frames' time. Chosen: a camera that stops for a moment does without, and one
/// that stands is asked within a tenth of a second. Raised, still cameras scatter more for longer; at 1, every pause costs that time.
const STILL_FRAMES: u32 = 3;
/// Still frames in a row after which the prediction is made anew, once. A step is too short by an eighth, and as much of what the first prediction was off by stays as long as the
/// camera stands; by now the filter knows better where that is (renderings of d-still: 0.013 to 0.033 mm in the median without, 0.011 to 0.012 with). Lowered, it does not; raised, the error stays longer.
const SETTLED_FRAMES: u32 = 12;

impl FrameProblem<'_> {
    /// The frame may show what the last one did: then the prediction still holds, and it pays to ask more pixels.
    pub(super) fn same_again(&mut self) -> Option<Corrected> {
        let motion = self.known.motion;
        let noise = self.slow.noise.of_still();
        let spec = LevelSpec { count: STILL_PIXELS, is_dense: true, noise, ..self.spec(FINEST, motion) };
        let is_kept = std::mem::take(&mut self.buffers.has_kept);
        let still_frames = std::mem::take(&mut self.buffers.still_frames);
        if self.buffers.fine.moved_since(&spec, motion) > KEPT_PX {
            return None;
        }
        self.buffers.still_frames = still_frames.saturating_add(1);
        if is_kept {
            self.buffers.fine.renew(&spec, self.levels);
            if self.buffers.still_frames == SETTLED_FRAMES {
                self.buffers.fine.predict(&spec, motion);
            }
            // Not that of a frame whose pose was not accepted.
            self.buffers.fine.recall_light(&self.slow.light);
        } else if self.buffers.still_frames >= STILL_FRAMES && self.may_stand_still() && self.lay_out(&spec, motion) {
            self.buffers.fine.predict(&spec, motion);
            // Where the camera had stood for longer, and the pose was pushed, this prediction settles as well.
            self.buffers.still_frames = STILL_FRAMES;
        } else {
            return None;
        }
        self.buffers.has_kept = true;
        let solved = self.solve_kept(&spec)?;
        let predicted_at = self.buffers.fine.predicted_at()?;
        self.last_step = predicted_at.pose_error_to(&solved.motion);
        Some(solved)
    }

    /// The finest level's pixels solved for; `None` where they moved.
    fn solve_kept(&mut self, spec: &LevelSpec) -> Option<Corrected> {
        let motion = self.known.motion;
        let (fine, _, light) = self.buffers.at_level(FINEST);
        let solved = fine.solve(spec, &self.known, light, false, 2)?;
        (fine.moved_px(spec, motion, &solved.motion) < 2.0 * KEPT_PX).then_some(solved)
    }

    /// Right after a body was found its velocity is not known: that it should stand still is no expectation then, but ignorance. Laying out all steep
    /// pixels takes several frames' time, so the usual ones say first whether it moved.
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
