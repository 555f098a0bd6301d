//! Notices while a body is tracked that it no longer fits its model, and says so once.
//!
//! A flat that a stagehand moved by a centimetre is no reason to stop: the pose goes on by the others, and the moved one's tiles count as outliers. But
//! somebody should put it back. So some of the frames whose tiles are left displaced are studied (`model_study`), and which part they speak against is told, once.
//! Where all fits within the noise nothing is studied, and nothing is paid.

use nalgebra::Vector3;

use super::misfit::{Misfit, ModelReport};
use super::model_study::{ModelStudy, StudiedFrame};
use super::model_unknowns::MAX_WAVES;
use super::tile_residuals::MIN_MISFIT;
use crate::camera::CameraModel;
use crate::geometry::{Body, Camera, Pose};
use crate::track::scene::reference::PreparedBody;

/// Of so many frames one is studied: those between show much the same. Chosen for time. Raised, a fault is told later; lowered, frames cost more.
const EVERY_FRAMES: u32 = 8;
/// Frames that are studied before a part is asked for, and the share that they then keep. Chosen: some two seconds at 30 frames a second. Raised, a
/// fault is told later; lowered, by views that differ less.
const ASKED_AFTER: u32 = 8;
const KEPT: f64 = 0.6;
/// A part is told where it was found so many times in a row. Chosen: what passes by is found once. Raised, a fault is told later.
const TIMES: u32 = 3;
/// And at once where it explains this share of the squared displacements: what passes by is no rigid motion of a flat, nor a lens. Raised, a flat that was
/// moved is told later; lowered, a part that only resembles the true one is told.
const DECISIVE: f64 = 0.9;
/// Half waves of the shapes that are tried while tracking. Chosen for time. Raised, finer folds are told from other parts.
const WAVES: usize = 8;

/// Views differ where the camera's places do by this share of its distance, five degrees around the stage or a step towards it; so many are counted at most. Chosen, not
/// tuned: from nearer by, a fold and a lens look alike. Raised, only long walks are said to show that no part explains them.
const VIEWS_DIFFER: f64 = 0.09;
const MAX_VIEWS: usize = 16;

/// What a part is, whatever its numbers: its word and its surface.
type Key = (&'static str, Option<usize>);

/// Studies some frames, or all.
#[derive(Debug)]
pub struct ModelWatch {
    study: ModelStudy,
    /// Whether every frame is studied, none is forgotten, and nothing is told before the end.
    is_thorough: bool,
    /// Frames since the last one that was studied.
    passed: u32,
    /// Frames that were studied since a part was asked for.
    studied: u32,
    /// Doubt about the camera's place in each frame that was studied, one sigma: as a share of the distance, and metres.
    doubts: Vec<[f64; 2]>,
    /// Where the camera was, from the body, in views that differ.
    views: Vec<Vector3<f64>>,
    /// What was found last, and how many times in a row.
    found: Option<(Key, u32)>,
    told: Vec<Key>,
}

impl ModelWatch {
    /// Of a body with so many surfaces, beside tracking.
    pub fn new(surfaces: usize) -> Self {
        Self::of(ModelStudy::new(surfaces, WAVES), false)
    }

    /// Of a body with so many surfaces, for what a whole clip says.
    pub fn thorough(surfaces: usize) -> Self {
        Self::of(ModelStudy::new(surfaces, MAX_WAVES), true)
    }

    fn of(study: ModelStudy, is_thorough: bool) -> Self {
        Self { study, is_thorough, passed: 0, studied: 0, doubts: Vec::new(), views: Vec::new(), found: None, told: Vec::new() }
    }

    /// Whether every frame is studied.
    pub fn is_thorough(&self) -> bool {
        self.is_thorough
    }

    /// Counts a frame; true if it is one to be studied. `is_lens_right`: see [`TrackedBody::is_study_due`](crate::track::body::tracked_body::TrackedBody::is_study_due).
    pub fn is_due(&mut self, is_lens_right: bool) -> bool {
        self.passed += 1;
        let is_due = is_lens_right && (self.is_thorough || self.passed >= EVERY_FRAMES);
        if is_due {
            self.passed = 0;
        }
        is_due
    }

    /// Takes a frame's residuals. Beside tracking those that are no more than noise are passed over.
    pub fn take(&mut self, frame: &StudiedFrame, body: &PreparedBody) {
        if self.is_thorough || frame.residuals.is_misfit() {
            self.study.add(frame, body);
            self.studied += 1;
        }
    }

    /// Takes what of the model does not fit leaves open of a frame's pose, whatever its cause. `doubt`: of the camera's place, m².
    pub fn doubt(&mut self, t_body_camera: &Pose<Body, Camera>, doubt_m2: f64, distance_m: f64) {
        let doubt_m = doubt_m2.sqrt();
        self.doubts.push([doubt_m / distance_m, doubt_m]);
        let place = t_body_camera.translation;
        if self.views.len() < MAX_VIEWS && self.views.iter().all(|view| (view - place).norm() > VIEWS_DIFFER * distance_m) {
            self.views.push(place);
        }
    }

    /// A part that frames have spoken against for a while and that was not told yet.
    pub fn news(&mut self, body: &PreparedBody, camera: &CameraModel) -> Option<Misfit> {
        if self.is_thorough || self.studied < ASKED_AFTER {
            return None;
        }
        self.studied = 0;
        let misfit = self.study.misfits(body, camera).into_iter().find(|m| !self.told.contains(&key(m)));
        self.study.forget(KEPT);
        let key = misfit.as_ref().map(key);
        let times = self.found.filter(|(last, _)| Some(*last) == key).map_or(1, |(_, times)| times + 1);
        self.found = key.map(|key| (key, times));
        let is_decisive = misfit.as_ref().is_some_and(|misfit| misfit.share >= DECISIVE);
        if times < TIMES && !is_decisive {
            return None;
        }
        self.told.extend(key);
        misfit
    }

    /// All parts that the frames spoke against, the likeliest first.
    pub fn parts(&self, body: &PreparedBody, camera: &CameraModel) -> Vec<Misfit> {
        self.study.misfits(body, camera)
    }

    /// What the frames say beside the parts.
    pub fn report(&self) -> ModelReport {
        let is_misfit = self.study.misfit() >= MIN_MISFIT;
        let share = if is_misfit { self.study.share_left().sqrt() } else { 0.0 };
        // What most frames show: a person who passes by is no error of the stage.
        let mut sorted = self.doubts.clone();
        sorted.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let [doubt_share, doubt_m] = sorted.get(sorted.len() / 2).map_or([0.0; 2], |doubt| doubt.map(|sigma| share * sigma));
        ModelReport { parts: Vec::new(), left_px: self.study.left_px(), doubt_mm: 1e3 * doubt_m, doubt_share, views: self.views.len() }
    }
}

fn key(misfit: &Misfit) -> Key {
    (misfit.part.word(), misfit.part.surface())
}
