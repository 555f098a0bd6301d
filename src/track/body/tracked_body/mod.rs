//! Everything known of one body: its pictures, its track state, its motion, and its last verified
//! pose with the anchors on which that rests.
//!
//! Per frame, [`TrackedBody::follow`] aligns it from its predicted motion; if it is not followed,
//! `body_search` calls [`TrackedBody::align_found`] with candidates or
//! [`TrackedBody::best_verified`]. A pose that alignment supports is then checked against the
//! opposite tilt and against poses one picture period aside. [`TrackedBody::model_fit`] and
//! [`TrackedBody::study`] measure what the model does not explain. `expected` predicts where it is.

mod expected;

use crate::track::acquire::tuning::TUNING as ACQUIRE_TUNING;
use crate::track::body::tuning::TUNING;
use crate::track::patches::tuning::TUNING as PATCHES_TUNING;
use nalgebra::{Matrix6, Vector2, Vector3, Vector6};
use tracing::debug;

use super::learnt_readout::ReadoutDoubt;
use super::pixel_watch::{Displaced, Used};
use super::reason::Reason;
use super::track_state::TrackStateMachine;
use crate::camera::{CameraModel, Normalized, Shutter};
use crate::frame::{Frame, Timestamp};
use crate::geometry::covariance::covariance_of_inverse;
use crate::geometry::resection::{MovingCamera, Observation, SquaredResiduals, Twist};
use crate::geometry::{Body, Camera, Pose};
use crate::motion::{MotionError, MotionEstimate, ProcessNoise};
use crate::track::acquire::candidate::Recognition;
use crate::track::align::{AlignSurface, Aligner, Alignment, CameraRays, FrameLevels, Patch, ReadoutQuestion, ShutterClue, is_sharp};
use crate::track::model_error::field_error::{FieldSize, ModelErrorBuffers, blended, model_error};
use crate::track::model_error::focal_clue::{FocalClue, RowDisplacement, focal_clue, is_suspect};
use crate::track::model_error::focal_step::Jump;
use crate::track::model_error::misfit::{Misfit, ModelNews, ModelReport};
use crate::track::model_error::model_study::StudiedFrame;
use crate::track::model_error::model_watch::ModelWatch;
use crate::track::model_error::shape_doubt::ShapeDoubt;
use crate::track::model_error::surface_doubt::covariance_by_surfaces;
use crate::track::model_error::tile_residuals::TileResiduals;
use crate::track::patches::fitted_anchor::FittedAnchor;
use crate::track::patches::planar_ambiguity::{ambiguity_margin, most_frequent_surface};
use crate::track::patches::row_motion::RowMotion;
use crate::track::patches::verify::{Refusal, Verified, VerifyBuffers, View, judged_noise, search_silent, verify};
use crate::track::scene::reference::PreparedBody;
use crate::track::scene::surface::BodySpec;

/// A body and what its frames showed so far; keeps its buffers between frames.
pub struct TrackedBody {
    /// Its pictures.
    pub body: PreparedBody,
    /// Its surfaces' numbers in the reference index.
    pub surfaces: std::ops::Range<u32>,
    /// Its track state.
    pub track: TrackStateMachine,
    /// Aligns it; keeps what it learns.
    pub aligner: Aligner,
    /// The anchors that fit the last verified pose.
    pub anchors: Vec<FittedAnchor>,
    /// All anchors that were found near a pose from features, fitting or not; empty if the pose was
    /// aligned.
    found: Vec<FittedAnchor>,
    /// What the last frame said about the shutter, if it was asked and the body was aligned.
    pub clue: Option<ShutterClue>,
    /// What was recognised when it was last searched for by features.
    pub seen: Recognition,
    /// The refusal of the last frame's poses that passed the most checks.
    pub refusal: Option<Refusal>,
    /// Poses from features from which alignment started in this frame, successfully or not.
    pub tried: Vec<Pose<Body, Camera>>,
    /// Whether alignment from features failed in the last frame that searched for it.
    pub is_in_vain: bool,
    /// Whether the last alignment fits what is visible of the body, but too little is visible.
    pub is_seen_in_part: bool,
    /// Its predicted pose in this frame, if it was followed from there, successfully or not.
    pub followed_from: Option<Pose<Body, Camera>>,
    /// Why the last frame has no verified pose.
    pub reason: Option<Reason>,
    /// When two copies of its picture were last seen and it was undecided which of them is the
    /// body.
    pub two_seen: Option<Timestamp>,
    /// The pixels on which the last pose rests, if somebody observes them.
    pub used: Option<Used>,
    patches: Vec<Patch>,
    /// The motion at the last aligned frame, and its timestamp.
    motion: Option<(MotionEstimate, Timestamp)>,
    /// Derivative of that motion by the readout time, per second.
    by_readout: MotionError,
    /// How well the readout time is known; `None` if it is not asked.
    readout_doubt: Option<ReadoutDoubt>,
    /// Whether the opposite velocity is as likely; see [`Alignment::has_opposite`].
    has_opposite: bool,
    /// The motion from which the last frame was followed, and its timestamp.
    followed: Option<(MotionEstimate, Timestamp)>,
    /// How jerky that motion is.
    process_noise: ProcessNoise,
    /// The last verified pose, its timestamp, and the twist that led to it.
    before: Option<(Pose<Camera, Body>, Timestamp, Option<Twist>)>,
    /// Maximum time from a frame to the next, seconds.
    to_next_s: f64,
    /// Followed frames since the last audit.
    unaudited: u32,
    observations: Vec<Observation>,
    squared: SquaredResiduals,
    residuals: TileResiduals,
    error_buffers: ModelErrorBuffers,
    field_size: FieldSize,
    /// Covariance of [δp, δθ] of `T_body_camera`, body axes, of the last verified pose, due to
    /// model misfit.
    model_error: Matrix6<f64>,
    shape_doubt: ShapeDoubt,
    jump: Jump,
    model_watch: ModelWatch,
    /// Anchors of the frame under study, and their residuals.
    studied: Vec<FittedAnchor>,
    study_residuals: TileResiduals,
}

/// What residual tile displacements imply about the model.
#[derive(Debug, Clone, Copy)]
pub struct ModelFit {
    /// Root mean square of the displacements, pixels.
    pub rms_px: f64,
    /// Covariance of [δp, δθ] of `T_body_camera`, body axes, assuming that all misfit is one smooth
    /// field and that the pose rests on this frame alone; `None` if the misfit is within the noise.
    pub at_most: Option<Matrix6<f64>>,
    /// What they imply about the focal length; `None` if that explains nothing and was not asked
    /// for.
    pub focal: Option<FocalClue>,
    /// The change in log focal length that would explain a jump of the pose; `None` if it did not
    /// jump.
    pub step: Option<f64>,
}

impl TrackedBody {
    /// Prepares a body. `surfaces`: its surfaces, ready for alignment; `first`: the number of its
    /// first surface in the reference index.
    pub fn new(spec: &BodySpec, surfaces: Vec<AlignSurface>, first: u32, shutter: Shutter) -> Self {
        let body = PreparedBody::new(spec);
        let aligner = Aligner::of_surfaces(surfaces, shutter);
        let most = aligner.most_patches();
        Self {
            surfaces: first..first + body.surfaces.len() as u32,
            track: TrackStateMachine::default(),
            aligner,
            anchors: Vec::with_capacity(most),
            found: Vec::new(),
            clue: None,
            seen: Recognition::default(),
            refusal: None,
            tried: Vec::new(),
            is_in_vain: false,
            is_seen_in_part: false,
            followed_from: None,
            reason: None,
            two_seen: None,
            used: None,
            patches: Vec::with_capacity(most),
            motion: None,
            by_readout: MotionError::zeros(),
            readout_doubt: None,
            has_opposite: false,
            followed: None,
            process_noise: ProcessNoise::default(),
            before: None,
            to_next_s: 0.0,
            unaudited: 0,
            observations: Vec::with_capacity(most),
            squared: SquaredResiduals::with_room_for(most),
            residuals: TileResiduals::default(),
            error_buffers: ModelErrorBuffers::with_capacity(most),
            field_size: FieldSize::default(),
            model_error: Matrix6::zeros(),
            shape_doubt: ShapeDoubt::of(&body.surfaces),
            jump: Jump::default(),
            model_watch: ModelWatch::new(body.surfaces.len()),
            studied: Vec::with_capacity(most),
            study_residuals: TileResiduals::default(),
            body,
        }
    }

    /// Sets the time to the next frame, seconds; see
    /// [`FrameInterval`](super::frame_interval::FrameInterval).
    pub fn expect_next(&mut self, to_next_s: f64) {
        self.to_next_s = to_next_s;
    }

    /// Sets how well the readout time is known for the coming frame.
    pub fn expect_readout(&mut self, doubt: Option<ReadoutDoubt>) {
        self.readout_doubt = doubt;
    }

    /// Sets the readout time, and corrects the motion to what it would be had that always been the
    /// readout time. `change_s`: the difference from the former one.
    pub fn take_readout(&mut self, readout_s: f64, change_s: f64) {
        self.aligner.take_readout(readout_s);
        if let Some((estimate, _)) = &mut self.motion {
            estimate.motion = estimate.motion.corrected(&(self.by_readout * change_s));
        }
    }

    /// Whether this frame moves so fast that the readout's uncertainty displaces its rows
    /// noticeably.
    pub fn is_readout_in_doubt(&self) -> bool {
        self.clue.is_some_and(|clue| self.readout_doubt.is_some_and(|doubt| doubt.sigma_s * clue.speed_px_s > TUNING.min_shutter_doubt_px))
    }

    /// Returns the covariance of [δp, δθ] of `T_body_camera`, body axes, of the last verified pose
    /// due to the readout's uncertainty `sigma_s`; `None` if it has no effect.
    pub fn covariance_by_readout(&self, pose: &Pose<Body, Camera>, sigma_s: f64) -> Option<Matrix6<f64>> {
        if sigma_s == 0.0 || self.by_readout == MotionError::zeros() {
            return None;
        }
        let shift = self.by_readout.fixed_rows::<3>(0) * sigma_s;
        let turn = pose.rotation * (self.by_readout.fixed_rows::<3>(3) * sigma_s);
        let step = Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z);
        // The derivative itself is wrong by a fraction of the step, in any direction.
        let [shift, turn] = [shift, turn].map(|part| (TUNING.readout_linearisation_error * part.norm()).powi(2));
        Some(step * step.transpose() + Matrix6::from_diagonal(&Vector6::new(shift, shift, shift, turn, turn, turn)))
    }

    /// Returns how to ask the frame for its readout time, if at all; `since_s` as for
    /// [`align`](Self::align).
    fn readout_question(&self, expected: &MotionEstimate, camera_rays: &CameraRays, since_s: Option<f64>) -> Option<ReadoutQuestion> {
        let doubt = self.readout_doubt?;
        let Some(dt_s) = since_s else {
            // A newly found body has no predicted motion: the frame alone determines it.
            let expected_by_readout = MotionError::zeros();
            return (doubt.sigma_s > 0.0).then_some(ReadoutQuestion {
                expected_by_readout,
                is_open: false,
                may_teach: true,
                min_speed_px_s: 0.0,
            });
        };
        let (before, _) = self.followed?;
        let expected_by_readout = before.error_after(&self.by_readout, dt_s);
        if let Some(speed_px_s) = doubt.asks(|| self.aligner.speed_px_s(&expected.motion, camera_rays)) {
            let is_open = doubt.is_open(speed_px_s);
            return Some(ReadoutQuestion { expected_by_readout, is_open, may_teach: true, min_speed_px_s: 0.0 });
        }
        // A body that was just found is predicted to stand still. If the frame shows that it moves,
        // its pose is as uncertain as the readout is.
        let min_speed_px_s = doubt.noticed_speed_px_s()?;
        Some(ReadoutQuestion { expected_by_readout, is_open: false, may_teach: false, min_speed_px_s })
    }

    /// Aligns the body from its predicted motion; `None` if it was not aligned recently, or the
    /// picture does not confirm it.
    pub fn follow(&mut self, frame: &Frame, levels: &mut FrameLevels, camera_rays: &CameraRays) -> Option<Verified> {
        let (estimate, then) = self.motion.take()?;
        self.followed = Some((estimate, then));
        let dt_s = frame.timestamp.seconds_since(then);
        if dt_s <= 0.0 || dt_s > TUNING.max_followed_gap_s.max(self.to_next_s) {
            return None;
        }
        let has_opposite = std::mem::take(&mut self.has_opposite);
        let distance_m = self.aligner.distance_m(&estimate.motion.pose);
        let expected = estimate.after(dt_s, distance_m, &self.process_noise);
        self.followed_from = Some(expected.motion.pose);
        // Blur shows the axis of motion but not its direction. And under a global shutter, the
        // acceleration estimated from two or three frames may be wrong, so constant velocity is
        // tried too.
        let opposite = has_opposite.then(|| estimate.motion.reversed());
        let even = (self.aligner.is_global() && self.process_noise.is_untold()).then(|| estimate.motion.even());
        let verified = self.align(frame, levels, camera_rays, &expected, Some(dt_s)).or_else(|| {
            opposite.into_iter().chain(even).find_map(|motion| {
                let other = MotionEstimate { motion, ..estimate }.after(dt_s, distance_m, &self.process_noise);
                let is_new = !is_near(&other.motion.pose, &expected.motion.pose);
                is_new.then(|| self.align(frame, levels, camera_rays, &other, Some(dt_s)))?
            })
        })?;
        self.unaudited += 1;
        if self.unaudited >= TUNING.tilt_audit_interval_frames && !self.is_audited(&verified.pose.inverse(), camera_rays.camera()) {
            self.motion = None;
            return None;
        }
        Some(verified)
    }

    /// Whether the opposite tilt does not explain the frame clearly better.
    fn is_audited(&mut self, pose: &Pose<Camera, Body>, camera: &CameraModel) -> bool {
        self.unaudited = 0;
        self.twin_margin(pose, camera) > -PATCHES_TUNING.min_twin_margin
    }

    /// Returns how much worse than the pose its planar twin explains the anchors.
    fn twin_margin(&mut self, pose: &Pose<Camera, Body>, camera: &CameraModel) -> f64 {
        self.observations.clear();
        self.observations.extend(self.anchors.iter().map(|a| a.observation));
        let surface = most_frequent_surface(&self.anchors, self.body.surfaces.len());
        let margin = ambiguity_margin(&self.body, surface, pose, &MovingCamera::still(camera), &self.observations, &mut self.squared);
        debug!(margin, "planar ambiguity");
        margin
    }

    /// Aligns the body from a pose that features found, with `expected` stating its uncertainty,
    /// without verifying anchors first: small and occluded stages have too few features for that.
    /// The picture decides, and the planar twin must be clearly worse.
    pub fn align_found(
        &mut self,
        frame: &Frame,
        levels: &mut FrameLevels,
        camera_rays: &CameraRays,
        expected: &MotionEstimate,
    ) -> Option<Verified> {
        let verified = self.align(frame, levels, camera_rays, expected, None)?;
        let margin = self.twin_margin(&verified.pose.inverse(), camera_rays.camera());
        let distance_m = self.aligner.distance_m(&verified.pose);
        // Such a pose would resume a track by itself, where a new track waits for a second frame.
        // Under a rolling shutter tilt and motion are correlated: of 48 flags one was 0.37 degrees
        // off.
        let is_doubtful = self.track.is_continued() && !self.aligner.is_global() && !is_sharp(&verified.covariance, distance_m);
        let refusal = if margin < PATCHES_TUNING.min_twin_margin {
            Some(Refusal::Ambiguous(margin))
        } else {
            judged_noise(&verified.covariance, distance_m).err().or(is_doubtful.then_some(Refusal::Uncertain))
        };
        let Some(refusal) = refusal else { return Some(verified) };
        debug!(?refusal, "aligned, and refused");
        // What one frame leaves uncertain, such as motion under a rolling shutter, the next may
        // determine, so the body is still followed from here.
        if refusal != Refusal::Uncertain {
            self.forget_alignment();
        }
        self.refuse(refusal);
        None
    }

    /// Discards this frame's alignment: the body is not followed from there.
    fn forget_alignment(&mut self) {
        self.motion = None;
        self.forget_findings();
    }

    /// Discards what this frame's alignment says about the shutter, and its used pixels.
    fn forget_findings(&mut self) {
        self.clue = None;
        self.used.iter_mut().for_each(Used::clear);
    }

    /// Discards the pose that this frame seemed to show, and its motion, for this reason.
    pub fn give_up(&mut self, reason: Reason) {
        self.motion = None;
        self.leave_open(reason);
    }

    /// Withholds the pose that this frame seems to show, for this reason, but keeps its motion,
    /// from which the next frame is aligned.
    pub fn leave_open(&mut self, reason: Reason) {
        self.forget_findings();
        self.forget_model_error();
        self.reason = Some(reason);
    }

    /// Keeps the refusal that passed the most checks.
    fn refuse(&mut self, refusal: Refusal) {
        if self.refusal.is_none_or(|other| refusal.stage() > other.stage()) {
            self.refusal = Some(refusal);
        }
    }

    /// Aligns the body from a start and verifies the result. `since_s`: seconds since the last
    /// frame, if the start is predicted from an aligned body's motion.
    pub fn align(
        &mut self,
        frame: &Frame,
        levels: &mut FrameLevels,
        camera_rays: &CameraRays,
        expected: &MotionEstimate,
        since_s: Option<f64>,
    ) -> Option<Verified> {
        self.is_seen_in_part = false;
        let distance_m = self.aligner.distance_m(&expected.motion.pose);
        if self.track.was_given() {
            self.aligner.trust();
        }
        self.aligner.ask_readout(self.readout_question(expected, camera_rays, since_s));
        let mut solution = self.aligner.align(levels, camera_rays, expected, since_s)?;
        let found = solution.alignment;
        // A pose found far from its prediction is treated as a new one.
        let is_expected = since_s.is_some() && !found.is_pushed();
        debug!(
            share = found.share(),
            tiles = found.tiles,
            borne_out = ?found.gradients.borne_out(),
            scale = found.scale,
            inliers = found.inliers,
            squared_mahalanobis = found.squared_mahalanobis,
            sigma_m = found.covariance.fixed_view::<3, 3>(0, 0).trace().sqrt(),
            sigma_rad = found.covariance.fixed_view::<3, 3>(3, 3).trace().sqrt(),
            "aligned"
        );
        if !found.may_be_given(since_s.is_some(), self.track.was_given(), distance_m) {
            self.is_seen_in_part = found.scale < TUNING.max_fitting_sigma;
            return None;
        }
        self.clue = solution.shutter_clue;
        if !is_expected {
            self.process_noise = ProcessNoise::default();
        } else if self.clue.is_none_or(|clue| !clue.is_open) {
            // While the shutter is uncertain, process noise must not absorb what a wrong readout
            // time causes.
            self.process_noise.learn(expected.innovations(&found.estimate));
        }
        self.motion = Some((found.estimate, frame.timestamp));
        self.by_readout = self.clue.map_or(MotionError::zeros(), |clue| clue.readout.motion_by_readout);
        self.has_opposite = found.has_opposite;
        if let Some(used) = &mut self.used {
            used.clear();
            solution.used_pixels(&mut used.pixels);
        }
        solution.accept(&mut self.patches);
        if let Some(used) = &mut self.used {
            used.displaced.extend(self.patches.iter().map(|patch| Displaced { centre_px: patch.centre_px, shift_px: patch.shift_px }));
        }
        let verified = self.aligned(&found, camera_rays.camera());
        if self.may_be_a_period_off(expected, &found, since_s.is_some()) && self.is_a_period_off(&found, levels, camera_rays) {
            self.forget_alignment();
            self.refuse(Refusal::Repeated);
            return None;
        }
        Some(verified)
    }

    /// Whether the pose may be one period of the picture off: it was found anew, its start was or
    /// may have been far off, or a periodic check is due.
    fn may_be_a_period_off(&self, expected: &MotionEstimate, found: &Alignment, is_followed: bool) -> bool {
        let Some(period_m) = self.periods_m().map(|period| period.norm()).min_by(f64::total_cmp) else { return false };
        let distance_m = self.aligner.distance_m(&found.pose);
        let moved_m =
            (found.pose.translation - expected.motion.pose.translation).norm() + distance_m * found.pose.angle_to(&expected.motion.pose);
        let sigma = |first: usize| expected.covariance.fixed_view::<3, 3>(first, first).trace().max(0.0).sqrt();
        let open_m = sigma(0) + distance_m * sigma(3);
        let is_due = self.unaudited + 1 >= TUNING.tilt_audit_interval_frames;
        !is_followed || is_due || moved_m > TUNING.period_check_distance * period_m || 3.0 * open_m > 0.5 * period_m
    }

    /// Whether one of its pictures is repetitive.
    pub fn repeats(&self) -> bool {
        self.body.surfaces.iter().any(|surface| !surface.periods.is_empty())
    }

    /// Returns the periods of the surface with the most anchors, body axes, metres.
    fn periods_m(&self) -> impl Iterator<Item = Vector3<f64>> {
        let surface = &self.body.surfaces[most_frequent_surface(&self.anchors, self.body.surfaces.len()) as usize];
        let (width, height) = surface.spec.artwork.dimensions();
        let middle = Vector2::new(f64::from(width), f64::from(height)) * 0.5;
        surface.periods.iter().map(move |period| surface.spec.body_point(middle + period) - surface.spec.body_point(middle))
    }

    /// Whether a pose one period aside explains the frame clearly better.
    fn is_a_period_off(&mut self, found: &Alignment, levels: &mut FrameLevels, camera_rays: &CameraRays) -> bool {
        let rivals: Vec<Vector3<f64>> = self.periods_m().flat_map(|period| [period, -period]).collect();
        rivals.iter().any(|aside| {
            let start = Pose::new(found.pose.rotation, found.pose.translation + aside);
            let distance_m = self.aligner.distance_m(&start);
            let unseen = self.unseen(
                start,
                [ACQUIRE_TUNING.feature_pose_shift_sigma * distance_m, ACQUIRE_TUNING.feature_pose_rotation_sigma],
                None,
            );
            let expected = MotionEstimate { motion: unseen.motion.with_twist(&found.estimate.motion.twist()), ..unseen };
            let Some(solution) = self.aligner.align(levels, camera_rays, &expected, None) else { return false };
            let rival = solution.alignment;
            let is_other = (rival.pose.translation - found.pose.translation).norm() > 0.5 * aside.norm();
            debug!(body = %self.body.name, own = found.strength(), rival = rival.strength(), is_other, "a period aside");
            is_other && rival.strength() > TUNING.min_period_strength_ratio * found.strength()
        })
    }

    /// Converts an alignment to the record's conventions and keeps its anchors.
    fn aligned(&mut self, found: &Alignment, camera: &CameraModel) -> Verified {
        // Alignment rotates the camera in its own axes, R <- R Exp(δθ); the record uses the body's
        // axes.
        let mut by_error = Matrix6::identity();
        by_error.fixed_view_mut::<3, 3>(3, 3).copy_from(&found.pose.rotation_matrix());
        let covariance = by_error * found.covariance * by_error.transpose();
        let t_camera_body = found.pose.inverse();
        let Self { body, patches, anchors, .. } = self;
        let anchor = |p: &Patch| {
            let spec = &body.surfaces[p.surface as usize].spec;
            let artwork = spec.to_artwork(p.on_surface_m);
            let point = spec.body_point(artwork);
            let seen = t_camera_body.transform(&point);
            let corrected_px = camera.project(Normalized(seen.coords.xy() / seen.z)).0 + p.shift_px;
            let observation = Observation { point, pixel: corrected_px, information: p.information, delay_s: p.delay_s, group: p.tile };
            FittedAnchor { surface: p.surface, artwork, observation, corrected_px }
        };
        self.found.clear();
        anchors.clear();
        anchors.extend(patches.iter().map(anchor));
        Verified {
            pose: found.pose,
            covariance: (covariance + covariance.transpose()) * 0.5,
            by_model: None,
            share: found.share(),
            inliers: found.inliers as usize,
            rms_px: found.rms_px,
            // Before a body was first reported, tiles that do not fit are downweighted only once it
            // is followed; until then they may pull the pose.
            is_conclusive: found.is_borne_out(self.aligner.distance_m(&found.pose)) && (self.track.was_given() || !found.may_be_pulled()),
        }
    }

    /// Measures the residual displacements of a verified pose's anchors and updates the covariance
    /// by misfit; `None` if there are too few anchors. `asks_focal`: estimate the focal length in
    /// any case. `is_stage`: a lens error spans the picture, and the stage shows it; the model
    /// error of an object is no larger than the object.
    pub fn model_fit(
        &mut self,
        verified: &Verified,
        camera: &CameraModel,
        rows: &RowMotion,
        asks_focal: bool,
        is_stage: bool,
    ) -> Option<ModelFit> {
        let t_camera_body = verified.pose.inverse();
        let Self { residuals, anchors, found, body, error_buffers, field_size, model_error: own_error, .. } = self;
        // Includes anchors that do not fit: a wrong lens or shape may be why they do not.
        let anchors = if found.is_empty() { anchors } else { found };
        residuals.take(&t_camera_body, camera, anchors)?;
        let field_px = if is_stage { f64::from(camera.width()) } else { residuals.extent_px() };
        let error = model_error(&t_camera_body, field_px, residuals, error_buffers);
        // An object with few tiles cannot separate model error from noise: all of it counts as a
        // field.
        let tells = is_stage || residuals.weight() > TUNING.min_model_error_tiles;
        let of_frame = error.map_or(Matrix6::zeros(), |e| if tells { field_size.take(&e) } else { e.at_most() });
        let noise = error.map_or(1.0, |e| e.noise);
        *own_error = blended(&t_camera_body, residuals, &verified.covariance, &of_frame, own_error).unwrap_or(of_frame);
        let asks_focal = asks_focal || residuals.is_misfit() || is_suspect(residuals);
        let step = self.jump.step(&t_camera_body, rows, residuals);
        let rows = RowDisplacement::new(camera, rows, &t_camera_body);
        let focal = if asks_focal || step.is_some() { focal_clue(residuals, &t_camera_body, body, anchors, &rows) } else { None };
        let fit = ModelFit { rms_px: residuals.rms_px(), at_most: error.map(|e| e.at_most()), focal, step };
        debug!(body = %body.name, rms_px = fit.rms_px, doubts = error.is_some(), noise, focal = ?fit.focal, step, "model");
        Some(fit)
    }

    /// Forgets the model error: the next verified pose does not rest on earlier frames.
    pub fn forget_model_error(&mut self) {
        (self.model_error, self.field_size) = (Matrix6::zeros(), FieldSize::default());
    }

    /// Returns the covariance of [δp, δθ] of `T_body_camera`, body axes, due to misfit, of the last
    /// pose passed to [`model_fit`](Self::model_fit); zero if everything fits.
    pub fn covariance_by_misfit(&self) -> Matrix6<f64> {
        self.model_error
    }

    /// Returns the covariance of [δp, δθ] of `T_body_camera`, body axes, of a verified pose due to
    /// doubt about the surfaces' shapes and places; `None` without such doubt.
    pub fn covariance_by_shape(&self, pose: &Pose<Body, Camera>, camera: &CameraModel) -> Option<Matrix6<f64>> {
        self.shape_doubt.covariance(pose, camera, &self.body.surfaces, &self.anchors)
    }

    /// Like [`covariance_by_shape`](Self::covariance_by_shape), due to the configured uncertainty
    /// of corners and places.
    pub fn covariance_by_surfaces(&self, pose: &Pose<Body, Camera>, camera: &CameraModel) -> Option<Matrix6<f64>> {
        covariance_by_surfaces(pose, camera, &self.body.surfaces, &self.anchors)
    }

    /// Returns the covariance of [δp, δθ] of `T_body_camera`, body axes, of the last pose passed to
    /// [`model_fit`](Self::model_fit), if the log focal length has this sigma.
    pub fn covariance_by_focal(&self, pose: &Pose<Body, Camera>, sigma: f64) -> Option<Matrix6<f64>> {
        let step = self.residuals.pose_by_focal()? * sigma;
        let linear = covariance_of_inverse(&pose.inverse(), &(step * step.transpose()));
        // The linear step is wrong by the square of sigma, in every direction.
        let (turn, shift) = (sigma.powi(2), sigma.powi(2) * self.aligner.distance_m(pose));
        Some(linear + Matrix6::from_diagonal(&Vector6::new(shift, shift, shift, turn, turn, turn).map(|off| off.powi(2))))
    }

    /// Whether this frame is to be studied. `is_lens_right`: otherwise the misfit is due to a moved
    /// lens, not to the model.
    pub fn is_study_due(&mut self, is_lens_right: bool) -> bool {
        self.model_watch.is_due(is_lens_right)
    }

    /// Studies which part of the model the frame of a verified pose contradicts. Returns a part
    /// that frames have contradicted for some time.
    pub fn study(&mut self, pose: &Pose<Body, Camera>, view: &View, buffers: &mut VerifyBuffers) -> Option<ModelNews> {
        let t_camera_body = pose.inverse();
        let Self { anchors, found, body, studied, residuals, study_residuals, model_watch, error_buffers, aligner, .. } = self;
        let aligned = if found.is_empty() { anchors } else { found };
        search_silent(body, &t_camera_body, view, aligned, buffers);
        if model_watch.is_thorough() {
            let doubt_m2 = model_error(&t_camera_body, f64::from(view.camera.width()), residuals, error_buffers);
            let doubt_m2 = doubt_m2.map_or(0.0, |error| error.covariance().fixed_view::<3, 3>(0, 0).trace());
            model_watch.doubt(pose, doubt_m2, aligner.distance_m(pose));
        }
        if !model_watch.is_thorough() && buffers.searched.is_empty() && !residuals.is_misfit() {
            return None;
        }
        let is_searched = |surface: u32| buffers.searched.iter().any(|a| a.surface == surface);
        studied.clear();
        studied.extend(aligned.iter().filter(|a| !is_searched(a.surface)));
        studied.extend_from_slice(&buffers.searched);
        study_residuals.take(&t_camera_body, view.camera, studied)?;
        let rows = RowDisplacement::new(view.camera, &view.row_motion, &t_camera_body);
        model_watch.take(&StudiedFrame { residuals: study_residuals, pose: &t_camera_body, anchors: studied, rows: &rows }, body);
        let misfit = model_watch.news(body, view.camera)?;
        Some(self.named(&misfit))
    }

    /// From now on studies every frame, for the final [`ModelWatch::parts`].
    pub fn study_model(&mut self) {
        self.model_watch = ModelWatch::thorough(self.body.surfaces.len());
    }

    /// Returns how well the model fitted the frames since [`study_model`](Self::study_model).
    pub fn model_report(&self, camera: &CameraModel) -> ModelReport {
        let parts = self.model_watch.parts(&self.body, camera);
        ModelReport { parts: parts.iter().map(|m| self.named(m)).collect(), ..self.model_watch.report() }
    }

    fn named(&self, misfit: &Misfit) -> ModelNews {
        let surface = misfit.part.surface().and_then(|k| self.body.surfaces.get(k));
        ModelNews { part: misfit.part, surface: surface.map(|s| s.spec.name.clone()), cost_mm: misfit.cost_mm }
    }

    /// Whether anchors found in a frame show a second copy of what a pose explains elsewhere: they
    /// lie on a surface of which the last verified pose explains enough, and far from where it puts
    /// them. A flat that was moved alone is no copy, nor are folds.
    pub fn is_elsewhere(&self, pose: &Pose<Body, Camera>, copy: &[FittedAnchor], camera: &CameraModel) -> bool {
        let surface = most_frequent_surface(copy, self.body.surfaces.len());
        let t_camera_body = pose.inverse();
        let limit_px = TUNING.min_copy_distance * f64::from(camera.width());
        let is_away = |anchor: &&FittedAnchor| {
            let seen = t_camera_body.transform(&anchor.observation.point);
            let is_far = || (camera.project(Normalized(seen.coords.xy() / seen.z)).0 - anchor.observation.pixel).norm() > limit_px;
            seen.z <= 0.0 || is_far()
        };
        let on_surface = |anchors: &[FittedAnchor]| anchors.iter().filter(|a| a.surface == surface).count();
        let away = copy.iter().filter(is_away).count();
        debug!(body = %self.body.name, away, of = copy.len(), own = on_surface(&self.anchors), "is elsewhere");
        on_surface(&self.anchors) >= TUNING.min_surface_anchors && 4 * away > 3 * copy.len()
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
                    debug!(anchors = v.inliers, share = v.share, rms_px = v.rms_px, "verified");
                    if best.is_none_or(|b| v.inliers > b.inliers) {
                        best = Some(v);
                        self.anchors.clone_from(&buffers.anchors);
                        self.found.clone_from(&buffers.found);
                    }
                    if v.share > TUNING.conclusive_anchor_ratio {
                        break;
                    }
                }
                Err(refusal) => {
                    debug!(?refusal, "refused");
                    self.refuse(refusal);
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
