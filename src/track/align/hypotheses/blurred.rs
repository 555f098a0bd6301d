//! A body that was just found moves, and its motion blur shows the velocity.
//!
//! One frame does not show how a body moves, only how it is smeared. Blur is estimated only for
//! bodies where it is likely and useful. Where it shows a velocity, the finest level is solved once
//! more with it. The estimate itself is `velocity_by_blur`.

use super::Hypothesis;
use super::velocity_by_blur::{KnownBlur, VelocityByBlur, velocity_by_blur};
use crate::track::align::frame_problem::{Buffers, FrameProblem};
use crate::track::align::picture::surface::nearest_centre;
use crate::track::align::pixels::level_spec::LevelSpec;
use crate::track::align::solve::level_problem::LevelPrior;
use crate::track::align::tuning::TUNING;
use crate::track::frame::frame_levels::{FINEST, LEVELS};

/// A newly found body that moves. Where blur shows no velocity, the rounds that a descent leaves
/// out in expectation of it are solved.
pub struct Blurred;

impl Hypothesis for Blurred {
    fn name(&self) -> &'static str {
        "blurred"
    }

    fn is_called_for(&self, frame: &mut FrameProblem) -> bool {
        !frame.is_followed
    }

    fn solve(&self, frame: &mut FrameProblem) -> Option<()> {
        let is_worthwhile = !frame.is_readout_open && is_blur_worthwhile(frame)?;
        if !(is_worthwhile && settle_with_blur(frame)?) && frame.may_ask_blur() && !has_converged(frame) {
            frame.settle_found()?;
        }
        Some(())
    }
}

/// The same of a partly occluded body, once it is known which tiles fit.
pub struct BlurredBehindOccluder;

impl Hypothesis for BlurredBehindOccluder {
    fn name(&self) -> &'static str {
        "blurred behind an occluder"
    }

    fn is_called_for(&self, frame: &mut FrameProblem) -> bool {
        let may_be = frame.is_found_again() && frame.slow.shutter.is_global() && !frame.is_readout_open && frame.by_blur.is_none();
        let is_called_for = may_be
            && frame
                .verified()
                .is_some_and(|(alignment, _)| alignment.is_covered_in_part() && alignment.residual_sigma > TUNING.min_occluded_blur_sigma);
        is_called_for && !frame.has_pixels(LEVELS - 1)
    }

    fn solve(&self, frame: &mut FrameProblem) -> Option<()> {
        settle_with_blur(frame).map(drop)
    }
}

fn has_converged(frame: &FrameProblem) -> bool {
    frame.progress.last_moved_px < TUNING.fine_converged_px
}

/// Whether blur may show a velocity that matters. `None` if no solution remains.
fn is_blur_worthwhile(frame: &mut FrameProblem) -> Option<bool> {
    // A still camera has no blur. In a wrong pose the better half of the tiles takes part as
    // always, and their blur means nothing.
    let is_global = frame.slow.shutter.is_global();
    let residual_sigma = frame.found()?.residual_sigma;
    let is_blurred = frame.is_clearly_blurred(residual_sigma);
    if frame.buffers.has_kept || (frame.buffers.fine.inlier_tile_ratio() < TUNING.min_blur_inlier_ratio && !is_blurred) {
        return Some(false);
    }
    // With a global shutter the pose does not depend on the velocity. A picture that is large
    // enough for the coarsest level can be followed without it, unless it fits badly.
    Some(!(is_global && !is_blurred && frame.has_pixels(LEVELS - 1)))
}

/// Continues to convergence with the velocity that the blur shows; false if it shows none.
fn settle_with_blur(frame: &mut FrameProblem) -> Option<bool> {
    let Some(by_blur) = shown_velocity(frame) else { return Some(false) };
    // Fuses the predicted velocity with the blur's.
    let (mut expected, mut information) = (frame.expected.motion, *frame.known.information);
    let mut of_velocity = information.fixed_view_mut::<6, 6>(6, 6);
    let score = of_velocity.clone_owned() * expected.twist() + by_blur.score;
    of_velocity += by_blur.information;
    expected = expected.with_twist(&of_velocity.clone_owned().cholesky()?.solve(&score));
    frame.has_opposite = by_blur.has_opposite;
    frame.by_blur = Some((expected, information));
    frame.settle(by_blur.motion, &LevelPrior { motion: &expected, information: &information, ..frame.known })?;
    Some(true)
}

/// Returns the velocity that the blur of the solved frame shows, if any.
fn shown_velocity(frame: &mut FrameProblem) -> Option<VelocityByBlur> {
    let found = frame.found()?;
    let spec = frame.spec(FINEST, &found.motion);
    let estimate = frame.buffers.fine.solution()?.estimate();
    let middle = nearest_centre(frame.surfaces, &found.motion.pose);
    let spec = LevelSpec { count: TUNING.blur_pixels, ..spec };
    // The coarse levels are finished, so their buffers are free.
    let Buffers { coarse: aside, selector, light, .. } = &mut *frame.buffers;
    if !aside.lay_out(&spec, frame.levels, &found.motion, selector, light) {
        return None;
    }
    let known = KnownBlur {
        exposure_sigma: frame.slow.exposure_sigma(),
        psf_variance: frame.slow.psf_variance,
        psf_variance_sigma: TUNING.psf_variance_sigma,
    };
    velocity_by_blur(aside, &spec, &estimate, middle, known)
}
