//! Checks of the model after the bodies were found: mixtures of two moments, misfits, a moved lens.
//! They refuse or withhold poses and say why; they never move one.

use nalgebra::Vector6;
use tracing::debug;

use super::BodyTracker;
use crate::frame::{Frame, Timestamp};
use crate::geometry::resection::perturbed;
use crate::motion::Motion;
use crate::track::acquire::matched_focal::matched_focal;
use crate::track::body::reason::Reason;
use crate::track::body::tracked_body::TrackedBody;
use crate::track::body::tracked_body::body_model::{Extent, Observed};
use crate::track::model_error::focal_clue::FocalClue;
use crate::track::model_error::lens_watch::LensState;
use crate::track::model_error::misfit::{ModelNews, Part};
use crate::track::model_error::moments::{Found, Verdict};
use crate::track::patches::row_motion::RowMotion;
use crate::track::tuning::frame_order::TUNING;

impl BodyTracker {
    /// Withholds the stage's pose if the camera moves and the frame shows two moments at once. If
    /// the camera hardly moves, the pose is kept, with a covariance for the unknown moment within
    /// the frame interval before it.
    pub(super) fn withhold_mixture(&mut self, frame: &Frame) {
        self.by_mixture = None;
        let interval_s = self.interval.to_next_s();
        let Self { levels, bodies, verified, mixtures, camera, .. } = self;
        let (Some(pose), Some(stage)) = (verified[0].map(|v| v.pose), bodies.first_mut()) else { return };
        // Uses poses alone: the velocity estimated within a mixed frame is wrong.
        let Some((before, dt_s, twist)) = stage.before_at(frame.timestamp) else {
            if mixtures.is_mixing() {
                verified[0] = None;
                stage.remember(frame.timestamp, &pose);
                stage.withhold(Reason::Mixed);
            }
            return;
        };
        let motion = Motion::between(&before.inverse(), &pose, dt_s);
        let motion_before = twist.map(|twist| Motion::between(&perturbed(&before, &(twist.0 * -dt_s)).inverse(), &before.inverse(), dt_s));
        let motion_before = motion_before.map(|then| Motion { pose, ..then });
        let TrackedBody { body, anchors, .. } = &*stage;
        let anchors = anchors.fitting();
        let found = Found { image: &frame.image, body, anchors, camera, motion, motion_before, interval_s };
        match mixtures.look(&found, levels) {
            Verdict::Whole => {}
            Verdict::Slow => {
                let off = [Some(motion), motion_before].into_iter().flatten().map(|motion| {
                    let [shift, turn] = pose.step_to(&motion.after(-0.5 * interval_s).pose);
                    let turn = pose.rotation * turn;
                    let step = Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z);
                    step * step.transpose()
                });
                self.by_mixture = off.reduce(|sum, more| sum + more);
            }
            Verdict::Withheld => {
                verified[0] = None;
                stage.remember(frame.timestamp, &pose);
                stage.withhold(Reason::Mixed);
            }
        }
    }

    /// Computes how well the model fits every body that was found.
    pub(super) fn fit_models(&mut self, timestamp: Timestamp) {
        let (camera, shutter, asks_focal) = (&self.camera, self.shutter, self.lens_watch.needs_estimate());
        let readout_sigma_s = self.readout.used().sigma_s;
        self.fits.clear();
        let bodies = self.bodies.iter_mut().zip(&self.verified);
        self.fits.extend(bodies.enumerate().map(|(k, (body, verified))| {
            let Some(verified) = verified else {
                body.model.forget_misfit();
                return None;
            };
            let rows = RowMotion { shutter, readout_sigma_s, before: body.before_at(timestamp) };
            let TrackedBody { body, anchors, model, .. } = body;
            let extent = if k == 0 { Extent::Picture } else { Extent::Object };
            model.fit(&Observed { body, anchors, verified, camera }, &rows, asks_focal, extent)
        }));
    }

    /// Updates the lens watch with this frame and returns whether a moved lens would explain the
    /// misfit.
    pub(super) fn watch_lens(&mut self, frame: &Frame) -> LensState {
        // All bodies are seen through one lens, so the body with the smallest sigma decides. An
        // object that was only just found may be a false detection and does not count.
        let bodies = &self.bodies;
        let may_speak = |k: usize| k == 0 || bodies[k].track.is_continued();
        let clues = self.fits.iter().enumerate().filter_map(|(k, fit)| Some((k, fit.as_ref()?.focal.as_ref()?)));
        // An unknown readout time displaces rows as a changed focal length would.
        let clues = clues.filter(|(k, _)| may_speak(*k) && !bodies[*k].is_readout_in_doubt());
        let clue = clues.min_by(|a, b| a.1.sigma.total_cmp(&b.1.sigma));
        let clue = clue.map(|(body, clue)| {
            self.lens_watch.select_body(body);
            *clue
        });
        self.ask_matches(frame, clue.as_ref());
        let focal_px = self.camera.intrinsics().fx;
        let doubt = self.camera.doubt().map_or(0.0, |doubt| doubt.uncertainty.focal_px[0] / (3.0 * focal_px));
        let is_seen = self.fits.iter().zip(&self.bodies).any(|(fit, body)| fit.is_some() && !body.is_readout_in_doubt());
        let step = self.fits.first().and_then(|fit| fit.as_ref()?.step);
        self.lens_watch.update(clue.as_ref(), step, is_seen, doubt)
    }

    /// Asks feature matches for the focal length: those that found the stage, and, at most once per
    /// `focal_match_interval_s`, those of a frame whose tiles disagree with earlier matches.
    fn ask_matches(&mut self, frame: &Frame, clue: Option<&FocalClue>) {
        let Some(found) = self.verified[0] else { return };
        let stage = &mut self.bodies[0];
        let mut matches = std::mem::take(&mut stage.recognition.matches);
        let is_due = self.matches_asked.is_none_or(|then| frame.timestamp.seconds_since(then) >= TUNING.focal_match_interval_s);
        if matches.is_empty() && is_due && clue.is_some_and(|clue| self.lens_watch.contradicts_matches(clue)) {
            self.matches_asked = Some(frame.timestamp);
            let views = self.search.recognise(&frame.image, stage);
            matches.extend(views.iter().flat_map(|view| view.observed(&stage.body)));
        }
        if !matches.is_empty() {
            let suspected = self.lens_watch.by_matches();
            let is_global = self.shutter.readout_s == 0.0 && self.readout.used().sigma_s == 0.0;
            let said = matched_focal(&found.t_camera_body(), &self.camera, &stage.body, &matches, is_global, suspected);
            self.lens_watch.update_by_matches(said);
        }
    }

    /// Refuses objects whose residual tile displacements no pose explains. Blur displaces tiles too
    /// while the motion is unknown, so a newly found object is followed for one more frame, which
    /// shows its motion.
    pub(super) fn refuse_misfits(&mut self) {
        for k in 1..self.bodies.len() {
            let turn = self.fits[k].and_then(|fit| fit.at_most).map_or(0.0, |c| c.fixed_view::<3, 3>(3, 3).trace().max(0.0).sqrt());
            if turn > TUNING.max_misfit_direction_sigma {
                debug!(body = %self.bodies[k].body.name, turn, "misfit");
                (self.verified[k], self.fits[k]) = (None, None);
                let was_followed = self.bodies[k].attempt.followed_from.is_some();
                let refuse = if was_followed { TrackedBody::give_up } else { TrackedBody::withhold };
                refuse(&mut self.bodies[k], Reason::NoPoseFits);
            }
        }
    }

    /// Checks the frame against the stage's model, if a check is due. Returns the news and the
    /// workers' time, milliseconds.
    pub(super) fn study_stage(&mut self, frame: &Frame, lens: LensState) -> Option<(Option<ModelNews>, f64)> {
        let stage = self.bodies.first_mut()?;
        let is_lens_right = lens == LensState::Fits && !stage.is_readout_in_doubt();
        if !stage.model.is_study_due(is_lens_right) {
            return None;
        }
        let verified = self.verified.first()?.as_ref()?;
        self.search.fill_half(&mut self.levels);
        let (distance_m, view) = (stage.aligner.distance_m(&verified.pose), self.search.view(frame, stage));
        let TrackedBody { body, anchors, model, .. } = &mut *stage;
        let mut news = model.study(&Observed { body, anchors, verified, camera: &self.camera }, &view, distance_m);
        if let Some(ModelNews { part: Part::Place { surface, .. }, is_left_out, .. }) = &mut news {
            *is_left_out = stage.leave_out(*surface);
        }
        Some((news, self.search.take_extra_ms()))
    }
}
