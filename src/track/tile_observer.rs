//! What single frames say of a stage whose model is still in question: where each tile of a surface is seen.
//!
//! A survey asks the frames of a walk again and again, each time with a better model of the stage and of the lens. Nothing is followed here: every
//! frame is aligned by itself, from the motion that it had before.

use image::GrayImage;
use nalgebra::{Matrix2, Vector2};

use super::align::{Aligner, CameraRays, FrameLevels, Patch};
use super::reference::PreparedBody;
use super::surface::{BodySpec, SurfaceSpec};
use crate::camera::{CameraModel, Shutter};
use crate::motion::{Motion, MotionEstimate};

/// How far off a frame's motion may be after the model changed, one sigma: of the distance, and radians. Chosen: a lens that was 2 % off moves poses
/// by as much. Raised, frames begin at coarser levels than they need; lowered, those of a model that changed much are lost.
const START_SHIFT: f64 = 0.02;
const START_TURN: f64 = 0.01;

/// Asks frames for the tiles of one body.
#[derive(Debug)]
pub struct TileObserver {
    aligner: Aligner,
    rays: CameraRays,
    mask: Option<GrayImage>,
    levels: FrameLevels,
    patches: Vec<Patch>,
}

/// A tile of a surface in a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObservedTile {
    /// Index of the surface in its body.
    pub surface: usize,
    /// The middle of its detail, metres on the picture from its centre.
    pub on_picture_m: [f64; 2],
    /// How far from where the model puts it the frame shows it, pixels of the frame.
    pub shift_px: Vector2<f64>,
    /// Information of that, pixels^-2.
    pub information: Matrix2<f64>,
    /// When its rows were exposed, seconds after the frame's stamp.
    pub delay_s: f64,
    /// Its number among the frame's tiles.
    pub number: u32,
}

/// What a frame said.
#[derive(Debug, Clone)]
pub struct ObservedFrame {
    /// The camera's motion, by the model as it is.
    pub motion: Motion,
    /// The tiles that fit.
    pub tiles: Vec<ObservedTile>,
    /// Share of the tiles with detail that agree.
    pub share: f64,
}

impl TileObserver {
    /// Prepares a body's pictures.
    pub fn new(camera: CameraModel, shutter: Shutter, mask: Option<GrayImage>, body: &BodySpec) -> Self {
        let aligner = Aligner::new(&PreparedBody::new(body), shutter);
        let patches = Vec::with_capacity(aligner.most_patches());
        Self { aligner, rays: CameraRays::new(camera, mask.clone()), mask, levels: FrameLevels::default(), patches }
    }

    /// Takes another model: the same pictures, elsewhere, of another shape or seen by another lens.
    pub fn take_model(&mut self, camera: &CameraModel, surfaces: &[SurfaceSpec]) {
        self.aligner.take_places(surfaces);
        if self.rays.camera() != camera {
            self.rays = CameraRays::new(*camera, self.mask.clone());
        }
    }

    /// Where a frame shows the tiles, from the motion that it had before; `None` where the picture does not bear the model out.
    pub fn observe(&mut self, image: &GrayImage, start: &Motion) -> Option<ObservedFrame> {
        let distance_m = self.aligner.distance_m(&start.pose);
        let unseen = MotionEstimate::unseen(start.pose, distance_m, START_SHIFT * distance_m, START_TURN);
        let expected = MotionEstimate { motion: *start, ..unseen };
        self.levels.update(image);
        let solution = self.aligner.align(&mut self.levels, &self.rays, &expected, None)?;
        let found = solution.alignment;
        if !found.is_credible(true) {
            return None;
        }
        solution.accept(&mut self.patches);
        let tile = |p: &Patch| ObservedTile {
            surface: p.surface as usize,
            on_picture_m: p.on_surface_m.into(),
            shift_px: p.shift_px,
            information: p.information,
            delay_s: p.delay_s,
            number: p.tile,
        };
        Some(ObservedFrame { motion: found.estimate.motion, tiles: self.patches.iter().map(tile).collect(), share: found.share() })
    }
}
