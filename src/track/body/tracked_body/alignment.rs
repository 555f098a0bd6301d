//! Aligns a body from its predicted motion or from a candidate, and refuses what another pose
//! explains as well: the opposite tilt, or a place one picture period aside.

use nalgebra::{Matrix6, Vector2, Vector3};
use tracing::debug;

use super::{Buffers, TrackedBody, is_near};
use crate::camera::{CameraModel, Normalized};
use crate::frame::Frame;
use crate::geometry::resection::{MovingCamera, Observation};
use crate::geometry::{Body, Camera, Pose};
use crate::motion::{MotionError, MotionEstimate, ProcessNoise};
use crate::track::acquire::tuning::TUNING as ACQUIRE_TUNING;
use crate::track::align::{AlignRequest, Alignment, CameraRays, FrameLevels, Patch, ReadoutQuestion, Start, is_sharp};
use crate::track::body::pixel_watch::Displaced;
use crate::track::body::tuning::TUNING;
use crate::track::patches::fitted_anchor::FittedAnchor;
use crate::track::patches::planar_ambiguity::{ambiguity_margin, most_frequent_surface};
use crate::track::patches::tuning::TUNING as PATCHES_TUNING;
use crate::track::patches::verify::{Refusal, Verified, judged_noise};

impl TrackedBody {
    /// Aligns the body from its predicted motion; `None` if it was not aligned recently, or the
    /// picture does not confirm it.
    pub fn follow(&mut self, frame: &Frame, levels: &mut FrameLevels, camera_rays: &CameraRays) -> Option<Verified> {
        let (estimate, then) = self.motion.take()?;
        self.attempt.motion_before = Some(estimate);
        let dt_s = frame.timestamp.seconds_since(then);
        if dt_s <= 0.0 || dt_s > TUNING.max_followed_gap_s.max(self.attempt.to_next_s) {
            return None;
        }
        let has_opposite = std::mem::take(&mut self.has_opposite);
        let distance_m = self.aligner.distance_m(&estimate.motion.pose);
        let expected = estimate.after(dt_s, distance_m, &self.process_noise);
        self.attempt.followed_from = Some(expected.motion.pose);
        // Blur shows the axis of motion but not its direction. And under a global shutter, the
        // acceleration estimated from two or three frames may be wrong, so constant velocity is
        // tried too.
        let opposite = has_opposite.then(|| estimate.motion.reversed());
        let even = (self.aligner.is_global() && self.process_noise.is_unlearnt()).then(|| estimate.motion.even());
        let verified = self.align(frame, levels, camera_rays, &Start::predicted(&expected, dt_s)).or_else(|| {
            opposite.into_iter().chain(even).find_map(|motion| {
                let other = MotionEstimate { motion, ..estimate }.after(dt_s, distance_m, &self.process_noise);
                let is_new = !is_near(&other.motion.pose, &expected.motion.pose);
                is_new.then(|| self.align(frame, levels, camera_rays, &Start::predicted(&other, dt_s)))?
            })
        })?;
        self.unaudited += 1;
        if self.unaudited >= TUNING.tilt_audit_interval_frames && !self.is_audited(&verified.t_camera_body(), camera_rays.camera()) {
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
        let Self { body, anchors, buffers: Buffers { observations, squared, .. }, .. } = self;
        observations.clear();
        observations.extend(anchors.fitting().iter().map(|a| a.observation));
        let surface = most_frequent_surface(anchors.fitting(), body.surfaces.len());
        let margin = ambiguity_margin(body, surface, pose, &MovingCamera::still(camera), observations, squared);
        debug!(margin, "planar ambiguity");
        margin
    }

    /// Aligns the body from a pose that features found, with `start` stating its uncertainty,
    /// without verifying anchors first: small and occluded stages have too few features for that.
    /// The picture decides, and the planar twin must be clearly worse.
    pub fn align_found(&mut self, frame: &Frame, levels: &mut FrameLevels, camera_rays: &CameraRays, start: &Start) -> Option<Verified> {
        let verified = self.align(frame, levels, camera_rays, start)?;
        let margin = self.twin_margin(&verified.t_camera_body(), camera_rays.camera());
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
        self.attempt.refuse(refusal);
        None
    }

    /// Aligns the body from a start and verifies the result.
    pub fn align(&mut self, frame: &Frame, levels: &mut FrameLevels, camera_rays: &CameraRays, start: &Start) -> Option<Verified> {
        let Start { expected, since_s, is_nearby_only } = *start;
        self.attempt.is_seen_in_part = false;
        let distance_m = self.aligner.distance_m(&expected.motion.pose);
        let was_reported = self.track.was_reported();
        let readout = self.readout_question(expected, camera_rays, since_s).or(self.standing_question());
        let request = AlignRequest { start: *start, was_reported, readout };
        let mut solution = self.aligner.align(levels, camera_rays, &request)?;
        let found = solution.alignment;
        // A pose found far from its prediction is treated as a new one.
        let is_expected = since_s.is_some() && !found.is_far_from_prediction();
        debug!(
            share = found.inlier_ratio(),
            tiles = found.tiles,
            borne_out = ?found.gradients.direction_support(),
            scale = found.residual_sigma,
            inliers = found.inliers,
            squared_mahalanobis = found.squared_mahalanobis,
            sigma_m = found.covariance.fixed_view::<3, 3>(0, 0).trace().sqrt(),
            sigma_rad = found.covariance.fixed_view::<3, 3>(3, 3).trace().sqrt(),
            "aligned"
        );
        if !found.may_be_reported(since_s.is_some(), was_reported, distance_m) {
            self.attempt.is_seen_in_part = found.residual_sigma < TUNING.max_fitting_sigma;
            return None;
        }
        self.attempt.clue = solution.shutter_clue;
        if !is_expected {
            self.process_noise = ProcessNoise::default();
        } else if self.attempt.clue.is_none_or(|clue| !clue.is_open) {
            // While the shutter is uncertain, process noise must not absorb what a wrong readout
            // time causes.
            self.process_noise.learn(expected.innovations(&found.estimate));
        }
        self.motion = Some((found.estimate, frame.timestamp));
        self.by_readout = self.attempt.clue.map_or(MotionError::zeros(), |clue| clue.readout.motion_by_readout);
        self.has_opposite = found.has_opposite;
        if let Some(used) = &mut self.used {
            used.clear();
            solution.used_pixels(&mut used.pixels);
        }
        solution.accept(&mut self.buffers.patches);
        if let Some(used) = &mut self.used {
            used.displaced
                .extend(self.buffers.patches.iter().map(|patch| Displaced { centre_px: patch.centre_px, shift_px: patch.shift_px }));
        }
        let verified = self.aligned(&found, camera_rays.camera());
        if self.may_be_a_period_off(expected, &found, since_s.is_some())
            && self.is_a_period_off(&found, levels, camera_rays, is_nearby_only)
        {
            self.forget_alignment();
            self.attempt.refuse(Refusal::Repeated);
            return None;
        }
        Some(verified)
    }

    /// Returns how to ask the frame for its readout time, if at all; `since_s` as for
    /// [`align`](Self::align).
    fn readout_question(&self, expected: &MotionEstimate, camera_rays: &CameraRays, since_s: Option<f64>) -> Option<ReadoutQuestion> {
        let doubt = self.attempt.readout_doubt?;
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
        let before = self.attempt.motion_before?;
        let expected_by_readout = before.error_after(&self.by_readout, dt_s);
        if let Some(speed_px_s) = doubt.query_speed_px_s(|| self.aligner.speed_px_s(&expected.motion, camera_rays)) {
            let is_open = doubt.is_open(speed_px_s);
            return Some(ReadoutQuestion { expected_by_readout, is_open, may_teach: true, min_speed_px_s: 0.0 });
        }
        // A body that was just found is predicted to stand still. If the frame shows that it moves,
        // its pose is as uncertain as the readout is.
        let min_speed_px_s = doubt.noticed_speed_px_s()?;
        Some(ReadoutQuestion { expected_by_readout, is_open: false, may_teach: false, min_speed_px_s })
    }

    /// Returns the question about the shutter that every frame is asked in a study.
    fn standing_question(&self) -> Option<ReadoutQuestion> {
        let question = ReadoutQuestion { expected_by_readout: MotionError::zeros(), is_open: true, may_teach: true, min_speed_px_s: 0.0 };
        self.asks_shutter.then_some(question)
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
        let surface = &self.body.surfaces[most_frequent_surface(self.anchors.fitting(), self.body.surfaces.len()) as usize];
        let (width, height) = surface.spec.artwork.dimensions();
        let middle = Vector2::new(f64::from(width), f64::from(height)) * 0.5;
        surface.periods.iter().map(move |period| surface.spec.body_point(middle + period) - surface.spec.body_point(middle))
    }

    /// Whether a pose one period aside explains the frame clearly better.
    fn is_a_period_off(&mut self, found: &Alignment, levels: &mut FrameLevels, camera_rays: &CameraRays, is_nearby_only: bool) -> bool {
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
            let (was_reported, readout) = (self.track.was_reported(), self.standing_question());
            let request = AlignRequest { start: Start { is_nearby_only, ..Start::found(&expected) }, was_reported, readout };
            let Some(solution) = self.aligner.align(levels, camera_rays, &request) else { return false };
            let rival = solution.alignment;
            let is_other = (rival.pose.translation - found.pose.translation).norm() > 0.5 * aside.norm();
            debug!(body = %self.body.name, own = found.strength(), rival = rival.strength(), is_other, "a period aside");
            is_other && rival.strength() > TUNING.min_period_strength_ratio * found.strength()
        })
    }

    /// Converts an alignment to the record's conventions, and keeps its anchors.
    fn aligned(&mut self, found: &Alignment, camera: &CameraModel) -> Verified {
        // Alignment rotates the camera in its own axes, R <- R Exp(δθ); the record uses the body's
        // axes.
        let mut by_error = Matrix6::identity();
        by_error.fixed_view_mut::<3, 3>(3, 3).copy_from(&found.pose.rotation_matrix());
        let covariance = by_error * found.covariance * by_error.transpose();
        let t_camera_body = found.pose.inverse();
        let Self { body, anchors, buffers: Buffers { patches, .. }, .. } = self;
        let anchor = |p: &Patch| {
            let spec = &body.surfaces[p.surface as usize].spec;
            let artwork = spec.to_artwork(p.on_surface_m);
            let point = spec.body_point(artwork);
            let seen = t_camera_body.transform(&point);
            let corrected_px = camera.project(Normalized(seen.coords.xy() / seen.z)).0 + p.shift_px;
            let observation = Observation { point, pixel: corrected_px, information: p.information, delay_s: p.delay_s, group: p.tile };
            FittedAnchor { surface: p.surface, artwork, observation, corrected_px }
        };
        anchors.set_aligned(patches.iter().map(anchor));
        Verified {
            pose: found.pose,
            covariance: (covariance + covariance.transpose()) * 0.5,
            by_model: None,
            share: found.inlier_ratio(),
            inliers: found.inliers as usize,
            solver_rms_px: found.rms_px,
            // Before a body was first reported, tiles that do not fit are downweighted only once it
            // is followed; until then they may pull the pose.
            is_conclusive: found.is_supported(self.aligner.distance_m(&found.pose))
                && (self.track.was_reported() || !found.may_be_pulled()),
        }
    }

    /// Whether anchors found in a frame show a second copy of what a pose explains elsewhere: they
    /// lie on a surface of which the last verified pose explains enough, and far from where it puts
    /// them. A flat that was moved alone is no copy, nor are folds.
    pub fn is_elsewhere(&self, verified: &Verified, copy: &[FittedAnchor], camera: &CameraModel) -> bool {
        let surface = most_frequent_surface(copy, self.body.surfaces.len());
        let t_camera_body = verified.t_camera_body();
        let limit_px = TUNING.min_copy_distance * f64::from(camera.width());
        let is_away = |anchor: &&FittedAnchor| {
            let seen = t_camera_body.transform(&anchor.observation.point);
            let is_far = || (camera.project(Normalized(seen.coords.xy() / seen.z)).0 - anchor.observation.pixel).norm() > limit_px;
            seen.z <= 0.0 || is_far()
        };
        let on_surface = |anchors: &[FittedAnchor]| anchors.iter().filter(|a| a.surface == surface).count();
        let away = copy.iter().filter(is_away).count();
        debug!(body = %self.body.name, away, of = copy.len(), own = on_surface(self.anchors.fitting()), "is elsewhere");
        on_surface(self.anchors.fitting()) >= TUNING.min_surface_anchors && 4 * away > 3 * copy.len()
    }
}
