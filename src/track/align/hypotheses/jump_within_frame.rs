//! The velocity jumps while the frame is exposed and read, or jumped shortly before.
//!
//! The frame is not solved again for each instant. `solve::jump_instant` weighs instants, sizes and
//! no jump by their likelihoods from the rows of the solution, and the mixture corrects the pose
//! and widens its covariance.

use super::velocity_jump::{by_bend, by_start};
use crate::motion::{Continuation, UniformMotion};
use crate::track::align::frame_problem::FrameProblem;
use crate::track::align::picture::surface::distance_m;
use crate::track::align::solve::jump_instant::MotionPrior;
use crate::track::align::solve::verdict::Alignment;
use crate::track::align::tuning::TUNING;

/// Adds the uncertainty from velocity jumps since the last frame or within this one, and corrects
/// pose and motion by the jumps that the rows show.
pub fn allow_for_jumps(frame: &mut FrameProblem, found: &mut Alignment) {
    let Some(since_s) = frame.since_s else {
        frame.updates.line = Some(UniformMotion::new(found.pose));
        return allow_for_jump_within_first(frame, found);
    };
    let shutter = &frame.slow.shutter;
    let Alignment { estimate, pose, covariance, .. } = found;
    let distance_m = distance_m(frame.surfaces, pose);
    let mut line = frame.slow.line;
    let led = line.as_mut().filter(|_| since_s > 0.0).and_then(|line| line.add(pose, covariance, since_s, distance_m));
    frame.updates.line = Some(line.unwrap_or(UniformMotion::new(*pose)));
    *covariance += by_bend(frame.expected, estimate, led.as_ref(), shutter, distance_m);
    let with_jerk = MotionPrior {
        information: *frame.known.information,
        error: estimate.motion.error_to(frame.known.motion),
        likelihood: TUNING.jerk_probability,
        // A frame solved with the wider prior has a covariance that does not belong to this one.
        covariance: (!frame.has_jumped).then_some(estimate.covariance),
    };
    let on_line = led.filter(|led| led.has_left && !shutter.is_global()).and_then(|Continuation { expected, .. }| {
        Some(MotionPrior {
            information: expected.covariance.cholesky()?.inverse(),
            error: estimate.motion.error_to(&expected.motion),
            likelihood: 1.0 - TUNING.jerk_probability,
            covariance: None,
        })
    });
    if let Some(mixture) = frame.bands.mixture([Some(with_jerk), on_line], since_s, distance_m) {
        found.take_mixture(&mixture);
    }
}

/// Adds the uncertainty from a velocity jump within the first frame of a body, and corrects the
/// pose by one that the rows of a rolling shutter show. A followed body comes here while the
/// readout time is in question; a jump would absorb the effect of a wrong one.
fn allow_for_jump_within_first(frame: &FrameProblem, found: &mut Alignment) {
    let shutter = &frame.slow.shutter;
    found.covariance += by_start(&found.estimate, shutter);
    if shutter.is_global() || frame.is_followed {
        return;
    }
    let (expected, information) = frame.by_blur.unwrap_or((*frame.known.motion, *frame.known.information));
    let prior = MotionPrior {
        information,
        error: found.estimate.motion.error_to(&expected),
        likelihood: 1.0,
        covariance: Some(found.estimate.covariance),
    };
    if let Some(mixture) = frame.bands.mixture([Some(prior), None], 0.0, distance_m(frame.surfaces, &found.pose)) {
        found.take_mixture(&mixture);
    }
}
