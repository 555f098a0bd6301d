//! Alignment of one body, frame by frame. [`Aligner`] holds what a body needs between frames: its
//! surfaces, buffers, and slow estimates (light, noise, exposure, point spread) learnt over many
//! frames.
//!
//! [`Aligner::align`] processes one frame in this order. Pixels are selected where the reference is
//! steep (`selection`). Their intensity is predicted with its derivatives (`appearance`). Tiles
//! that show something else are excluded (`tile_correlation`). Pose, motion, light and point spread
//! are solved for together (`system`), coarse to fine (`frame_problem`), with each hypothesis that
//! the frame calls for (`hypotheses`). Then the tiles are counted that agree with the solution
//! (`verdict`). The slow estimates learn from the frame only when the
//! caller accepts the pose with [`Solution::accept`].

use super::frame_problem::{Buffers, FrameProblem};
use super::hypotheses::jump_within_frame::allow_for_jumps;
use super::hypotheses::solve_by_hypotheses;
use super::learned::camera_curve::LearntCurve;
use super::learned::noise::CameraNoise;
use super::learned::online_calibration::{OnlineCalibration, Updates};
use super::picture::surface::{AlignSurface, distance_m};
use super::pixels::level_spec::LevelSpec;
use super::request::AlignRequest;
use super::solve::level_problem::patches::Patch;
#[cfg(feature = "cli")]
use super::solve::level_problem::pixel_shifts::PixelShift;
use super::solve::level_problem::solution::UsedPixel;
use super::solve::shutter_clue::ShutterClue;
use super::solve::verdict::Alignment;
use crate::camera::Shutter;
use crate::geometry::{Body, Camera, Pose};
use crate::light::CameraCurve;
use crate::light::camera_curve::Bend;
use crate::motion::Motion;
use crate::track::frame::frame_levels::{FINEST, FrameLevels};
use crate::track::frame::rays::CameraRays;
use crate::track::frame::tuning::TUNING as FRAME_TUNING;

/// Aligns one body with each frame. Its state is in three places: the surfaces, buffers, and
/// slow estimates.
#[derive(Debug)]
pub struct Aligner {
    surfaces: Vec<AlignSurface>,
    buffers: Buffers,
    slow: OnlineCalibration,
}

/// An aligned frame. It can be queried until the next frame is aligned.
pub struct Solution<'a> {
    aligner: &'a mut Aligner,
    rays: &'a CameraRays,
    /// The pose, its covariance, and how well the tiles agree.
    pub alignment: Alignment,
    /// What the frame says of the shutter; `None` where that was not asked.
    pub shutter_clue: Option<ShutterClue>,
    updates: Updates,
}

/// What the survey of a stage needs besides.
#[cfg(any(test, feature = "cli"))]
impl Aligner {
    /// Prepares a body's reference pictures for alignment.
    pub fn new(body: &crate::track::scene::reference::PreparedBody, shutter: Shutter) -> Self {
        Self::of_surfaces(body.surfaces.iter().map(|s| AlignSurface::new(&s.spec)).collect(), shutter)
    }

    /// Updates the surfaces' places and shapes; their pictures stay. The noise learnt so far keeps
    /// little weight, as it includes the residuals of the former model.
    #[cfg(feature = "cli")]
    pub fn take_places(&mut self, surfaces: &[crate::track::scene::surface::SurfaceSpec]) {
        for (own, spec) in self.surfaces.iter_mut().zip(surfaces) {
            own.take_place(spec);
        }
        self.buffers.has_kept = false;
        self.slow.noise.doubt();
    }
}

impl Aligner {
    /// From now on uses no pixel of surface `k`.
    pub fn leave_out(&mut self, k: usize) {
        self.surfaces[k].is_left_out = true;
    }

    /// Creates an aligner from surfaces that are already prepared.
    pub fn of_surfaces(surfaces: Vec<AlignSurface>, shutter: Shutter) -> Self {
        Self { buffers: Buffers::with_room_for(&surfaces), surfaces, slow: OnlineCalibration::new(shutter) }
    }

    /// Assumes the noise that is usual of cameras with this curve, before any frame. `learns`:
    /// whether frames may bend the curve.
    pub fn assume_curve(&mut self, curve: &CameraCurve, learns: bool) {
        self.slow.noise = CameraNoise::usual(FINEST, curve);
        self.slow.curve = learns.then(LearntCurve::default);
    }

    /// Starts from the curve's corrections learnt in an earlier session. A configured curve is not
    /// replaced.
    pub fn take_learnt_bend(&mut self, bend: Bend) {
        if let Some(curve) = &mut self.slow.curve {
            *curve = LearntCurve::begun_with(bend);
        }
    }

    /// Returns the learnt corrections of the camera's curve with the information that frames have
    /// given; `None` where the curve is configured.
    pub fn learnt_bend(&self) -> Option<(Bend, f64)> {
        self.slow.curve.as_ref().map(|curve| (*curve.bend(), curve.information()))
    }

    /// Returns the maximum number of patches per frame: one per tile of each surface.
    pub fn most_patches(&self) -> usize {
        self.surfaces.len() * FRAME_TUNING.max_tiles[0] * FRAME_TUNING.max_tiles[1]
    }

    /// Returns how many rounds of all levels were solved since the start.
    pub fn rounds(&self) -> u64 {
        self.buffers.coarse.rounds + self.buffers.fine.rounds
    }

    /// Returns the distance to the nearest surface's centre, metres.
    pub fn distance_m(&self, pose: &Pose<Body, Camera>) -> f64 {
        distance_m(&self.surfaces, pose)
    }

    /// Whether the readout time is 0: a global shutter, or an unknown readout. Then a single frame
    /// shows velocity only by its blur.
    pub fn is_global(&self) -> bool {
        self.slow.shutter.is_global()
    }

    /// Sets the readout time from now on, seconds; the exposure is unchanged.
    pub fn take_readout(&mut self, readout_s: f64) {
        self.buffers.has_kept &= self.slow.shutter.readout_s == readout_s;
        self.slow.shutter.readout_s = readout_s;
    }

    /// Starts from an exposure learnt in an earlier session, with one sigma, both in seconds. A
    /// configured exposure is not replaced.
    pub fn take_learnt_exposure(&mut self, exposure_s: f64, sigma_s: f64) {
        self.slow.take_learnt_exposure(exposure_s, sigma_s);
    }

    /// Returns the exposure and one sigma, seconds; `None` unless it is learnt and frames have
    /// informed it.
    pub fn learnt_exposure(&self) -> Option<(f64, f64)> {
        self.slow.learnt_exposure()
    }

    /// Returns the configured exposure and the one that fits, seconds, where frames contradict the
    /// configured one.
    pub fn contradicted_exposure(&self) -> Option<[f64; 2]> {
        self.slow.contradicted_exposure()
    }

    /// Takes over another body's estimates of the shared camera (exposure, noise) where those are
    /// more certain.
    pub fn take_camera(&mut self, other: &Self) {
        self.slow.take_camera(&other.slow);
    }

    /// Fixes the shutter: its exposure is no longer learnt.
    pub fn fix_shutter(&mut self, shutter: Shutter) {
        self.slow.fix_shutter(shutter);
    }

    /// Returns how fast the picture moves through the frame, pixels per second.
    pub fn speed_px_s(&self, motion: &Motion, rays: &CameraRays) -> f64 {
        LevelSpec::new(&self.surfaces, &self.slow, rays, self.slow.is_enlarged, FINEST, motion).speed_px_s(motion)
    }

    /// Aligns a frame from a predicted motion. Returns `None` where too little of the body is in
    /// view, nothing converges, or a covariance is singular.
    pub fn align<'a>(&'a mut self, levels: &mut FrameLevels, rays: &'a CameraRays, request: &AlignRequest) -> Option<Solution<'a>> {
        let Self { surfaces, buffers, slow } = &mut *self;
        let information = request.start.expected.covariance.cholesky()?.inverse();
        let mut frame = FrameProblem::new(surfaces, slow, buffers, levels, rays, request, &information);
        solve_by_hypotheses(&mut frame)?;
        let (mut alignment, exposure) = frame.verified()?;
        allow_for_jumps(&mut frame, &mut alignment);
        let shutter_clue = request.readout.filter(|_| !frame.has_jumped).and_then(|question| frame.shutter_clue(&question, exposure));
        let updates = frame.into_updates();
        Some(Solution { aligner: self, rays, alignment, updates, shutter_clue })
    }
}

impl Solution<'_> {
    /// Appends the pixels that the pose is based on.
    pub fn used_pixels(&mut self, out: &mut Vec<UsedPixel>) {
        if let Some(solution) = self.aligner.buffers.fine.solution() {
            solution.used_pixels(FINEST, out);
        }
    }

    /// Appends what the single pixels of the tiles that fit say about their displacement.
    #[cfg(feature = "cli")]
    pub fn pixel_shifts(&mut self, out: &mut Vec<PixelShift>) {
        let Aligner { surfaces, buffers, slow } = &mut *self.aligner;
        if let Some(solution) = buffers.fine.solution() {
            let spec = LevelSpec::new(surfaces, slow, self.rays, slow.is_enlarged, FINEST, &solution.found.motion);
            solution.pixel_shifts(&spec, out);
        }
    }

    /// Accepts the pose: the slow estimates learn from the frame. Replaces the contents of
    /// `patches` with the patches that fit, at most one per tile.
    pub fn accept(self, patches: &mut Vec<Patch>) {
        let Aligner { surfaces, buffers, slow } = self.aligner;
        slow.learn(&self.updates, &buffers.light);
        patches.clear();
        if let Some(solution) = buffers.fine.solution() {
            let spec = LevelSpec::new(surfaces, slow, self.rays, slow.is_enlarged, FINEST, &solution.found.motion);
            solution.patches(&spec, &mut buffers.shifts, patches);
        }
    }
}

#[cfg(test)]
#[path = "aligner_tests.rs"]
mod tests;
