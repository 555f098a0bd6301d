//! Alignment of one body, frame by frame: select -> predict -> gate tiles -> solve -> verify -> learn.
//!
//! [`Aligner::align`] is the path of a frame. Pixels are selected where the reference is steep (`selection`), their intensity is predicted with
//! its derivatives (`appearance`), tiles that show something else are left out (`tile_correlation`), pose, motion, light and point spread are
//! solved for together (`system`), coarse to fine (`frame_problem`), and the tiles say how well the solution agrees (`verdict`). Who
//! accepts the pose says so with [`Solution::accept`], and only then the slow estimates learn.

use super::frame_problem::{Buffers, FrameProblem};
use super::learned::slow_estimates::{Lessons, SlowEstimates};
use super::picture::surface::{AlignSurface, distance_m};
use super::pixels::level_spec::LevelSpec;
use super::solve::level_problem::patches::Patch;
use super::solve::level_problem::solution::UsedPixel;
use super::solve::shutter_clue::{ReadoutQuestion, ShutterClue};
use super::solve::verdict::Alignment;
use crate::camera::Shutter;
use crate::geometry::{Body, Camera, Pose};
use crate::motion::{Motion, MotionError, MotionEstimate};
use crate::track::frame::frame_levels::{FINEST, FrameLevels};
use crate::track::frame::rays::CameraRays;
use crate::track::frame::tile_grid::MAX_TILES;
use crate::track::scene::reference::PreparedBody;
use crate::track::scene::surface::SurfaceSpec;

/// Aligns one body. Its state is in three places.
#[derive(Debug)]
pub struct Aligner {
    settings: Settings,
    buffers: Buffers,
    slow: SlowEstimates,
}

/// What does not change from frame to frame.
#[derive(Debug)]
struct Settings {
    surfaces: Vec<AlignSurface>,
    /// Whether every frame is asked what it says of the shutter.
    asks_shutter: bool,
    /// Whether the next frame is asked for its readout, and how.
    question: Option<ReadoutQuestion>,
    /// See [`Aligner::trust`].
    is_trusted: bool,
    /// See [`Aligner::begin_nearby`].
    begins_nearby: bool,
}

/// A frame that was aligned, and what may be asked of it until the next.
pub struct Solution<'a> {
    aligner: &'a mut Aligner,
    rays: &'a CameraRays,
    /// What it came to.
    pub alignment: Alignment,
    /// What the frame says of the shutter; `None` where it is not asked.
    pub shutter_clue: Option<ShutterClue>,
    lessons: Lessons,
}

impl Aligner {
    /// Prepares a body's pictures.
    pub fn new(body: &PreparedBody, shutter: Shutter) -> Self {
        Self::of_surfaces(body.surfaces.iter().map(|s| AlignSurface::new(&s.spec)).collect(), shutter)
    }

    /// Of a body whose pictures are prepared.
    pub fn of_surfaces(surfaces: Vec<AlignSurface>, shutter: Shutter) -> Self {
        Self {
            buffers: Buffers::with_room_for(&surfaces),
            settings: Settings { surfaces, asks_shutter: false, question: None, is_trusted: false, begins_nearby: false },
            slow: SlowEstimates::new(shutter),
        }
    }

    /// Most patches that a frame can show: one a tile of each surface.
    pub fn most_patches(&self) -> usize {
        self.settings.surfaces.len() * MAX_TILES[0] * MAX_TILES[1]
    }

    /// Takes the surfaces' places and shapes anew; their pictures stay. What frames left of the former ones hardly counts as noise any more.
    pub fn take_places(&mut self, surfaces: &[SurfaceSpec]) {
        for (own, spec) in self.settings.surfaces.iter_mut().zip(surfaces) {
            own.take_place(spec);
        }
        self.buffers.has_kept = false;
        self.slow.noise.doubt();
    }

    /// Distance to the nearest surface's centre, metres.
    pub fn distance_m(&self, pose: &Pose<Body, Camera>) -> f64 {
        distance_m(&self.settings.surfaces, pose)
    }

    /// Whether all rows are exposed together, so that a frame shows no velocity but by its blur.
    pub fn is_global(&self) -> bool {
        self.slow.shutter.is_global()
    }

    /// From now on the rows are read in this time; the exposure stays as it is known.
    pub fn take_readout(&mut self, readout_s: f64) {
        self.buffers.has_kept &= self.slow.shutter.readout_s == readout_s;
        self.slow.shutter.readout_s = readout_s;
    }

    /// Its pose was given: from now on what differs from it is in front of it, wherever it is found. Before, its picture or its size may be another than told, and a part of it that fits by
    /// chance must not be taken for what is seen of it.
    pub fn trust(&mut self) {
        self.settings.is_trusted = true;
    }

    /// From now on alignment begins at the level that holds the usual start error alone, or also, where that does not fit, at the one that holds all that is uncertain.
    pub fn begin_nearby(&mut self, is_alone: bool) {
        self.settings.begins_nearby = is_alone;
    }

    /// Begins with an exposure that an earlier session learnt, known to one sigma, seconds; a configured one stays.
    pub fn take_learnt_exposure(&mut self, exposure_s: f64, sigma_s: f64) {
        self.slow.take_learnt_exposure(exposure_s, sigma_s);
    }

    /// The exposure and one sigma, seconds, where it is learnt and frames told of it.
    pub fn learnt_exposure(&self) -> Option<(f64, f64)> {
        self.slow.learnt_exposure()
    }

    /// The configured exposure and the one that fits, seconds, where frames contradict it.
    pub fn contradicted_exposure(&self) -> Option<[f64; 2]> {
        self.slow.contradicted_exposure()
    }

    /// Takes what another body has learnt of the camera that both are seen by, where it knows that better.
    pub fn take_camera(&mut self, other: &Self) {
        self.slow.take_camera(&other.slow);
    }

    /// From now on every frame is asked what it says of the shutter, which is taken as given here.
    pub fn ask_shutter(&mut self, shutter: Shutter) {
        self.slow.fix_shutter(shutter);
        self.settings.asks_shutter = true;
    }

    /// The next frame is asked for its readout; the exposure goes on being learnt.
    pub fn ask_readout(&mut self, question: Option<ReadoutQuestion>) {
        self.settings.question = question;
    }

    /// How fast the picture moves through the frame, pixels per second.
    pub fn speed_px_s(&self, motion: &Motion, rays: &CameraRays) -> f64 {
        LevelSpec::new(&self.settings.surfaces, &self.slow, rays, self.slow.is_enlarged, FINEST, motion).speed_px_s(motion)
    }

    /// Aligns a frame from an expected motion; `None` where too little of the body is in view or nothing converges.
    ///
    /// `since_s`: seconds since the last frame, if the body is followed; its velocity may have jumped meanwhile.
    pub fn align<'a>(
        &'a mut self,
        levels: &mut FrameLevels,
        rays: &'a CameraRays,
        expected: &MotionEstimate,
        since_s: Option<f64>,
    ) -> Option<Solution<'a>> {
        let Self { settings: Settings { surfaces, asks_shutter, question, is_trusted, begins_nearby }, buffers, slow } = &mut *self;
        let always = ReadoutQuestion { expected_by_readout: MotionError::zeros(), is_open: true, may_teach: true, min_speed_px_s: 0.0 };
        let question = question.take().or(asks_shutter.then_some(always));
        let is_open = question.is_some_and(|question| question.is_open);
        let is_followed = since_s.is_some();
        // A velocity that may jump within the frame explains what a wrong readout leaves, and the shutter would be found there.
        let since_s = since_s.filter(|_| !is_open);
        let information = expected.covariance.cholesky()?.inverse();
        let mut frame = FrameProblem::new(surfaces, slow, buffers, levels, rays, expected, &information);
        frame.follows(is_followed, *is_trusted);
        frame.begins_nearby = *begins_nearby;
        let found = frame.solve()?;
        let jumped_since_s = since_s.filter(|_| frame.is_surprising(&found));
        if let Some(since_s) = jumped_since_s {
            frame.solve_with_jump(&found, since_s)?;
        }
        let may_ask_blur = since_s.is_none() && !is_open;
        let is_by_blur = may_ask_blur && frame.solve_with_blur()?;
        if !is_by_blur {
            frame.settle_rest()?;
        }
        let (mut alignment, mut exposure) = frame.verify()?;
        if *is_trusted && !frame.is_by_what_fits() && !is_by_blur && alignment.may_be_pulled() {
            frame.settle_by_what_fits()?;
            (alignment, exposure) = frame.verify()?;
        } else if !is_by_blur && frame.settle_uncovered()? {
            (alignment, exposure) = frame.verify()?;
        }
        if may_ask_blur && !is_by_blur && alignment.is_covered_in_part() && frame.solve_covered_with_blur(alignment.scale)? {
            (alignment, exposure) = frame.verify()?;
        }
        frame.allow_for_jumps(&mut alignment, since_s, jumped_since_s.is_some());
        let shutter_clue = question.filter(|_| jumped_since_s.is_none()).and_then(|question| frame.shutter_clue(&question, exposure));
        let lessons = frame.into_lessons();
        Some(Solution { aligner: self, rays, alignment, lessons, shutter_clue })
    }
}

impl Solution<'_> {
    /// Adds the pixels that the pose rests on.
    pub fn used_pixels(&mut self, out: &mut Vec<UsedPixel>) {
        if let Some(solution) = self.aligner.buffers.fine.solution() {
            solution.used_pixels(FINEST, out);
        }
    }

    /// The pose is accepted: the slow estimates learn what the frame taught. Fills `patches` with those that fit, one a tile.
    pub fn accept(self, patches: &mut Vec<Patch>) {
        let Aligner { settings, buffers, slow } = self.aligner;
        slow.learn(&self.lessons, &buffers.light);
        patches.clear();
        if let Some(solution) = buffers.fine.solution() {
            let spec = LevelSpec::new(&settings.surfaces, slow, self.rays, slow.is_enlarged, FINEST, &solution.found.motion);
            solution.patches(&spec, &mut buffers.shifts, patches);
        }
    }
}

#[cfg(test)]
#[path = "aligner_tests.rs"]
mod tests;
