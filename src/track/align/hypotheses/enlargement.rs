//! Between its pixels the picture may be smooth, as the enlarged copies have it, or linear (a
//! projector or LED wall that scales it, a print of exactly these pixels). The frame shows which.

use super::Hypothesis;
use crate::track::align::frame_problem::{Buffers, FrameProblem};
use crate::track::align::pixels::level_spec::LevelSpec;
use crate::track::align::solve::level_problem::Corrected;
use crate::track::align::tuning::TUNING;
use crate::track::frame::frame_levels::FINEST;

/// The enlargement that is not the current one. From time to time both are tried beside the
/// solution, which is kept unless the other is clearly better.
pub struct OtherEnlargement;

impl Hypothesis for OtherEnlargement {
    fn name(&self) -> &'static str {
        "other enlargement"
    }

    fn is_called_for(&self, frame: &mut FrameProblem) -> bool {
        !frame.buffers.has_kept && frame.slow.is_trial_due() && frame.surfaces.iter().any(|s| s.texture.own_level() > 0)
    }

    fn solve(&self, frame: &mut FrameProblem) -> Option<()> {
        let found = frame.found()?;
        frame.updates.has_tried = true;
        let was = frame.updates.is_enlarged;
        let [misfit, other] = [was, !was].map(|is_enlarged| misfit_of_trial(frame, is_enlarged, &found));
        frame.updates.is_enlarged = was;
        tracing::debug!(was, misfit, other, "enlargement");
        if other >= TUNING.max_enlargement_misfit_ratio * misfit {
            return Some(());
        }
        frame.buffers.trial_light.clone_from(&frame.buffers.light);
        frame.updates.is_enlarged = !was;
        frame.solve_again(&found).or_else(|| {
            frame.updates.is_enlarged = was;
            frame.buffers.light.clone_from(&frame.buffers.trial_light);
            frame.solve_again(&found)
        })?;
        Some(())
    }
}

/// Returns the finest level's misfit with or without the enlarged copies, solved in separate
/// buffers; infinite where it cannot be solved.
fn misfit_of_trial(frame: &mut FrameProblem, is_enlarged: bool, found: &Corrected) -> f64 {
    frame.updates.is_enlarged = is_enlarged;
    let spec = LevelSpec { count: TUNING.enlargement_trial_pixels, ..frame.spec(FINEST, &found.motion) };
    // The coarse levels are finished, so their buffers are free.
    let Buffers { coarse: aside, selector, light, trial_light, .. } = &mut *frame.buffers;
    trial_light.clone_from(light);
    if !aside.lay_out(&spec, frame.levels, &found.motion, selector, trial_light) {
        return f64::INFINITY;
    }
    aside.predict(&spec, &found.motion);
    aside.solve(&spec, &frame.known, trial_light, false, 2).and_then(|_| aside.solution()).map_or(f64::INFINITY, |mut s| s.misfit())
}
