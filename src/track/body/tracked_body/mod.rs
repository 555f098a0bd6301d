//! Everything known of one body: its pictures, its track state, its motion, and the anchors of its
//! last verified pose.
//!
//! [`TrackedBody`] is memory; what happens in one frame is its [`Attempt`], which begins empty. Per
//! frame, [`TrackedBody::follow`] aligns the body from its predicted motion; if it is not followed,
//! `body_search` calls [`TrackedBody::align_found`] with candidates or
//! [`TrackedBody::best_verified`].
//!
//! - `attempt`: one frame's attempts to find the body
//! - `alignment`: aligns it, and refuses tilted twins and poses one picture period aside
//! - `body_model`: what its model does not explain
//! - `expected`: predicts where it is

mod alignment;
mod attempt;
pub mod body_model;
mod expected;

use nalgebra::{Matrix6, Vector6};
use tracing::debug;

use self::attempt::Attempt;
use self::body_model::BodyModel;
use super::learnt_readout::ReadoutDoubt;
use super::pixel_watch::Used;
use super::pose_anchors::PoseAnchors;
use super::reason::Reason;
use super::track_state::TrackStateMachine;
use crate::camera::Shutter;
use crate::frame::Timestamp;
use crate::geometry::resection::{Observation, SquaredResiduals, Twist};
use crate::geometry::{Body, Camera, Pose};
use crate::motion::{MotionError, MotionEstimate, ProcessNoise};
use crate::track::acquire::candidate::Recognition;
use crate::track::align::{AlignSurface, Aligner, Patch};
use crate::track::body::tuning::TUNING;
use crate::track::patches::verify::{Verified, VerifyBuffers, View, verify};
use crate::track::scene::reference::PreparedBody;
use crate::track::scene::surface::BodySpec;

/// A body and what its frames showed so far.
pub struct TrackedBody {
    /// Its pictures.
    pub body: PreparedBody,
    /// Its surfaces' numbers in the reference index.
    pub surfaces: std::ops::Range<u32>,
    /// Its track state.
    pub track: TrackStateMachine,
    /// Aligns it; keeps what it learns.
    pub aligner: Aligner,
    /// The anchors of the last verified pose.
    pub anchors: PoseAnchors,
    /// How well its model fits.
    pub model: BodyModel,
    /// The current frame's attempts to find it.
    pub attempt: Attempt,
    /// What was recognised when it was last searched for by features.
    pub recognition: Recognition,
    /// Whether alignment from features failed in the last frame that searched for it.
    pub failed_last_time: bool,
    /// When two copies of its picture were last seen and it was undecided which of them is the
    /// body.
    pub copy_seen_at: Option<Timestamp>,
    /// The pixels on which the last pose rests, if somebody observes them.
    pub used: Option<Used>,
    /// The motion at the last aligned frame, and its timestamp.
    motion: Option<(MotionEstimate, Timestamp)>,
    /// Derivative of that motion by the readout time, per second.
    by_readout: MotionError,
    /// Whether the opposite velocity is as likely; see
    /// [`Alignment::has_opposite`](crate::track::align::Alignment::has_opposite).
    has_opposite: bool,
    /// How jerky that motion is.
    process_noise: ProcessNoise,
    /// The last verified pose, its timestamp, and the twist that led to it.
    before: Option<(Pose<Camera, Body>, Timestamp, Option<Twist>)>,
    /// Followed frames since the last audit.
    unaudited: u32,
    /// Whether every frame is asked about the shutter; for studies.
    asks_shutter: bool,
    buffers: Buffers,
}

/// Buffers that are reused from frame to frame; they carry no information.
struct Buffers {
    patches: Vec<Patch>,
    observations: Vec<Observation>,
    squared: SquaredResiduals,
}

impl TrackedBody {
    /// Prepares a body. `surfaces`: its surfaces, ready for alignment; `first`: the number of its
    /// first surface in the reference index.
    pub fn new(spec: &BodySpec, surfaces: Vec<AlignSurface>, first: u32, shutter: Shutter) -> Self {
        let body = PreparedBody::new(spec);
        let aligner = Aligner::of_surfaces(surfaces, shutter);
        let max_patches = aligner.most_patches();
        Self {
            surfaces: first..first + body.surfaces.len() as u32,
            track: TrackStateMachine::default(),
            aligner,
            anchors: PoseAnchors::with_capacity(max_patches),
            model: BodyModel::new(&body, max_patches),
            attempt: Attempt::default(),
            recognition: Recognition::default(),
            failed_last_time: false,
            copy_seen_at: None,
            used: None,
            motion: None,
            by_readout: MotionError::zeros(),
            has_opposite: false,
            process_noise: ProcessNoise::default(),
            before: None,
            unaudited: 0,
            asks_shutter: false,
            buffers: Buffers {
                patches: Vec::with_capacity(max_patches),
                observations: Vec::with_capacity(max_patches),
                squared: SquaredResiduals::with_room_for(max_patches),
            },
            body,
        }
    }

    /// Begins a frame. `readout_doubt`: how well the readout time is known; `None` if the frame is
    /// not asked about it. `to_next_s`: time to the next frame; see
    /// [`FrameInterval`](super::frame_interval::FrameInterval).
    pub fn begin_frame(&mut self, readout_doubt: Option<ReadoutDoubt>, to_next_s: f64) {
        self.attempt.begin(readout_doubt, to_next_s);
    }

    /// Fixes the shutter to this one; from now on every frame is asked about it.
    pub fn ask_shutter(&mut self, shutter: Shutter) {
        self.aligner.fix_shutter(shutter);
        self.asks_shutter = true;
    }

    /// Sets the readout time, and corrects the motion to what it would be had that always been the
    /// readout time. `change_s`: the difference from the former one.
    pub fn set_readout(&mut self, readout_s: f64, change_s: f64) {
        self.aligner.take_readout(readout_s);
        if let Some((estimate, _)) = &mut self.motion {
            estimate.motion = estimate.motion.corrected(&(self.by_readout * change_s));
        }
    }

    /// Whether this frame moves so fast that the readout's uncertainty displaces its rows
    /// noticeably.
    pub fn is_readout_in_doubt(&self) -> bool {
        let Attempt { clue: Some(clue), readout_doubt: Some(doubt), .. } = &self.attempt else { return false };
        doubt.sigma_s * clue.speed_px_s > TUNING.min_shutter_doubt_px
    }

    /// Returns the covariance of [δp, δθ] of `T_body_camera`, body axes, of the last verified pose
    /// due to the readout's uncertainty `sigma_s`; `None` if it has no effect.
    pub fn covariance_by_readout(&self, verified: &Verified, sigma_s: f64) -> Option<Matrix6<f64>> {
        if sigma_s == 0.0 || self.by_readout == MotionError::zeros() {
            return None;
        }
        let shift = self.by_readout.fixed_rows::<3>(0) * sigma_s;
        let turn = verified.pose.rotation * (self.by_readout.fixed_rows::<3>(3) * sigma_s);
        let step = Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z);
        // The derivative itself is wrong by a fraction of the step, in any direction.
        let [shift, turn] = [shift, turn].map(|part| (TUNING.readout_linearisation_error * part.norm()).powi(2));
        Some(step * step.transpose() + Matrix6::from_diagonal(&Vector6::new(shift, shift, shift, turn, turn, turn)))
    }

    /// Discards this frame's alignment: the body is not followed from there.
    fn forget_alignment(&mut self) {
        self.motion = None;
        self.forget_findings();
    }

    /// Discards what this frame's alignment says about the shutter, and its used pixels.
    fn forget_findings(&mut self) {
        self.attempt.clue = None;
        self.used.iter_mut().for_each(Used::clear);
    }

    /// Discards the pose that this frame seemed to show, and its motion, for this reason.
    pub fn give_up(&mut self, reason: Reason) {
        self.motion = None;
        self.withhold(reason);
    }

    /// Withholds the pose that this frame seems to show, for this reason, but keeps its motion,
    /// from which the next frame is aligned.
    pub fn withhold(&mut self, reason: Reason) {
        self.forget_findings();
        self.model.forget_misfit();
        self.attempt.reason = Some(reason);
    }

    /// Leaves a facet of a map out from now on, since it no longer stands in its place; returns
    /// whether it does. Most of the map must remain, and other surfaces are configured by people,
    /// who are asked instead.
    pub fn leave_out(&mut self, k: usize) -> bool {
        let surfaces = &mut self.body.surfaces;
        let left = surfaces.iter().filter(|surface| !surface.is_left_out).count();
        let may = surfaces[k].spec.is_facet() && left > TUNING.min_pieces && 2 * left > surfaces.len();
        if may {
            surfaces[k].is_left_out = true;
            self.aligner.leave_out(k);
        }
        may
    }

    /// Verifies starts, and returns the first clear success, otherwise the best that passes.
    pub fn best_verified(
        &mut self,
        starts: impl Iterator<Item = Pose<Camera, Body>>,
        view: &View,
        buffers: &mut VerifyBuffers,
    ) -> Option<Verified> {
        let continued = self.track.is_continued();
        let mut best: Option<Verified> = None;
        for start in starts {
            match verify(&self.body, &start, view, continued, buffers) {
                Ok(v) => {
                    debug!(anchors = v.inliers, share = v.share, rms_px = v.solver_rms_px, "verified");
                    if best.is_none_or(|b| v.inliers > b.inliers) {
                        best = Some(v);
                        self.anchors.set_registered(&buffers.anchors, &buffers.found);
                    }
                    if v.share > TUNING.conclusive_anchor_ratio {
                        break;
                    }
                }
                Err(refusal) => {
                    debug!(?refusal, "refused");
                    self.attempt.refuse(refusal);
                }
            }
        }
        best
    }
}

/// Whether alignment from both poses leads to the same result: 0.005 radians (0.3 degrees) and as
/// much of the distance are well within its basin.
pub fn is_near(a: &Pose<Body, Camera>, b: &Pose<Body, Camera>) -> bool {
    a.angle_to(b) < TUNING.same_start_tolerance
        && (a.translation - b.translation).norm() < TUNING.same_start_tolerance * a.translation.norm()
}

#[cfg(test)]
#[path = "tracked_body_tests.rs"]
mod tests;
