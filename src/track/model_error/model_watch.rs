//! Notices during tracking that a body no longer fits its model, and reports it once.
//!
//! If a stagehand moves a flat by a centimetre, tracking need not stop: the pose rests on the other
//! surfaces, and the tiles of the moved one count as outliers. But somebody should put it back. So
//! some of the frames with displaced tiles are studied (`model_study`), and the part that
//! contradicts them is reported once. If everything fits within the noise, nothing is studied and
//! no time is spent.

use crate::track::model_error::tuning::TUNING;
use nalgebra::Vector3;

use super::misfit::{Misfit, ModelReport};
use super::model_study::{ModelStudy, StudiedFrame};
use super::model_unknowns::MAX_WAVES;
use crate::camera::CameraModel;
use crate::geometry::{Body, Camera, Pose};
use crate::track::scene::reference::PreparedBody;

/// Identifies a part whatever its numbers: its word and its surface.
type Key = (&'static str, Option<usize>);

/// Studies some frames of a body, or all of them.
#[derive(Debug)]
pub struct ModelWatch {
    study: ModelStudy,
    /// Whether it is a map, whose pieces are moved more often than flats, and then left out.
    is_mapped: bool,
    /// Whether every frame is studied, none is forgotten, and nothing is reported before the end.
    is_thorough: bool,
    /// Frames since the last one that was due.
    passed: u32,
    /// Studied frames since the last comparison of the parts.
    studied: u32,
    /// Sigma of the camera's position in each frame, from the model error: as a fraction of the
    /// distance, and in metres.
    doubts: Vec<[f64; 2]>,
    /// Camera positions in body axes, of views that differ.
    views: Vec<Vector3<f64>>,
    /// The part found last, and how many times in a row.
    found: Option<(Key, u32)>,
    reported: Vec<Key>,
}

impl ModelWatch {
    /// Creates a watch of a body during tracking.
    pub fn new(body: &PreparedBody) -> Self {
        Self::of(body, TUNING.max_tracking_waves, false)
    }

    /// Creates a watch of a body over a whole clip.
    pub fn thorough(body: &PreparedBody) -> Self {
        Self::of(body, MAX_WAVES, true)
    }

    fn of(body: &PreparedBody, most_waves: usize, is_thorough: bool) -> Self {
        let is_mapped = body.surfaces.iter().any(|surface| surface.spec.is_facet());
        let study = ModelStudy::new(body.surfaces.len(), most_waves);
        Self {
            study,
            is_mapped,
            is_thorough,
            passed: 0,
            studied: 0,
            doubts: Vec::new(),
            views: Vec::new(),
            found: None,
            reported: Vec::new(),
        }
    }

    /// Whether every frame is studied.
    pub fn is_thorough(&self) -> bool {
        self.is_thorough
    }

    /// Counts a frame; returns whether it is to be studied. `is_lens_right`: see
    /// [`TrackedBody::is_study_due`](crate::track::body::tracked_body::TrackedBody::is_study_due).
    pub fn is_due(&mut self, is_lens_right: bool) -> bool {
        self.passed += 1;
        let interval = if self.is_mapped { TUNING.map_study_interval_frames } else { TUNING.study_interval_frames };
        let is_due = is_lens_right && (self.is_thorough || self.passed >= interval);
        if is_due {
            self.passed = 0;
        }
        is_due
    }

    /// Takes a frame's residuals. During tracking, frames with no more than noise are skipped.
    pub fn take(&mut self, frame: &StudiedFrame, body: &PreparedBody) {
        if self.is_thorough || frame.residuals.is_misfit() {
            self.study.add(frame, body);
            self.studied += 1;
        }
    }

    /// Takes the pose covariance from the model error of a frame, whatever its cause. `doubt_m2`:
    /// variance of the camera's position, m².
    pub fn doubt(&mut self, t_body_camera: &Pose<Body, Camera>, doubt_m2: f64, distance_m: f64) {
        let doubt_m = doubt_m2.sqrt();
        self.doubts.push([doubt_m / distance_m, doubt_m]);
        let place = t_body_camera.translation;
        if self.views.len() < TUNING.max_views
            && self.views.iter().all(|view| (view - place).norm() > TUNING.min_view_distance * distance_m)
        {
            self.views.push(place);
        }
    }

    /// Returns a part that has contradicted the frames for a while and was not reported yet.
    pub fn news(&mut self, body: &PreparedBody, camera: &CameraModel) -> Option<Misfit> {
        let frames = if self.is_mapped { TUNING.map_frames_per_comparison } else { TUNING.frames_per_comparison };
        if self.is_thorough || self.studied < frames {
            return None;
        }
        self.studied = 0;
        let misfit = self.study.misfits(body, camera).into_iter().find(|m| !self.reported.contains(&key(m)));
        self.study.forget(TUNING.studied_frame_weight_kept);
        let key = misfit.as_ref().map(key);
        let times = self.found.filter(|(last, _)| Some(*last) == key).map_or(1, |(_, times)| times + 1);
        self.found = key.map(|key| (key, times));
        let decisive = if self.is_mapped { TUNING.map_decisive_ratio } else { TUNING.decisive_ratio };
        let is_decisive = misfit.as_ref().is_some_and(|misfit| misfit.share >= decisive);
        if times < TUNING.comparisons_to_report && !is_decisive {
            return None;
        }
        self.reported.extend(key);
        misfit
    }

    /// Returns all parts that contradict the frames, the likeliest first.
    pub fn parts(&self, body: &PreparedBody, camera: &CameraModel) -> Vec<Misfit> {
        self.study.misfits(body, camera)
    }

    /// Returns the other figures of the report; its parts are empty.
    pub fn report(&self) -> ModelReport {
        let is_misfit = self.study.misfit() >= TUNING.min_model_misfit;
        let share = if is_misfit { self.study.share_left().sqrt() } else { 0.0 };
        // The median, because a person who passes by is no error of the stage.
        let mut sorted = self.doubts.clone();
        sorted.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let [doubt_share, doubt_m] = sorted.get(sorted.len() / 2).map_or([0.0; 2], |doubt| doubt.map(|sigma| share * sigma));
        ModelReport { parts: Vec::new(), left_px: self.study.left_px(), doubt_mm: 1e3 * doubt_m, doubt_share, views: self.views.len() }
    }
}

fn key(misfit: &Misfit) -> Key {
    (misfit.part.word(), misfit.part.surface())
}
