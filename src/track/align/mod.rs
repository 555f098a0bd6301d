//! Alignment: the pose that makes the reference, as the camera should see it, agree with the frame pixel by pixel.
//!
//! From where the motion filter expects the camera, pixels are chosen where the reference is steep (`selection`), their
//! grey is predicted with its derivatives (`appearance`), and pose, motion, light and point spread are solved for
//! together (`normal`, `system`), from small copies of the frame to its half size. Every frame is compared with the
//! reference; earlier frames only give the start and the motion.
//!
//! Source: direct alignment in the manner of Lucas and Kanade (1981) and Baker and Matthews (2004), iteratively
//! reweighted; the joint state follows the continuous-time rolling-shutter literature (Hedborg et al. 2012).

mod aligner;
mod aperture;
// Index loops: what closures do would not be compiled for the wider registers of the function around them.
#[allow(clippy::needless_range_loop)]
mod appearance;
#[allow(clippy::needless_range_loop)]
mod columns;
mod enlarge;
#[allow(clippy::needless_range_loop)]
mod evidence;
mod exposure;
mod exposure_watch;
mod frame_levels;
mod frame_problem;
#[allow(clippy::needless_range_loop)]
mod gradient_gain;
mod jump_instant;
mod kernels;
mod lanes;
mod level_problem;
mod level_spec;
mod light;
mod noise;
#[allow(clippy::needless_range_loop)]
mod noise_sums;
#[allow(clippy::needless_range_loop)]
mod normal;
mod pixels;
#[allow(clippy::needless_range_loop)]
mod plane_table;
mod rays;
mod rows;
mod selection;
mod shutter_clue;
#[allow(clippy::needless_range_loop)]
mod sight;
mod slow_estimates;
#[allow(clippy::needless_range_loop)]
mod system;
mod texture;
mod tile_correlation;
mod tile_equations;
mod tile_grid;
#[allow(clippy::needless_range_loop)]
mod tile_products;
#[allow(clippy::needless_range_loop)]
mod touching_planes;
mod velocity_by_blur;
mod velocity_jump;
mod verdict;

use image::GrayImage;

pub use aligner::Aligner;
pub use frame_levels::{FrameLevels, LEVELS};
pub use kernels::AlignKernels;
pub use level_problem::patches::Patch;
pub use level_problem::solution::UsedPixel;
use plane_table::PlaneTable;
use rays::RayTable;
#[cfg(test)]
pub use shutter_clue::ReadoutClue;
pub use shutter_clue::{ReadoutQuestion, ShutterClue};
pub use system::schur_complement::Clue;
use texture::Texture;
pub use verdict::{Alignment, is_sharp};

use super::rectangle::Rectangle;
use super::shape::ShapePoint;
use super::surface::SurfaceSpec;
use nalgebra::Vector3;

use crate::camera::CameraModel;
use crate::geometry::{Body, Camera, Pose};

/// Frames with less motion blur than this, pixels of the frame, tell of the point spread, of the noise, and by what their patches leave of the model. Chosen, not tuned: such blur is
/// no wider than a pixel. Raised, blur passes for point spread; lowered, a camera that always moves never teaches its noise.
const SHARP_FRAME_PX: f64 = 1.0;

/// A surface as alignment needs it.
#[derive(Debug, Clone)]
pub struct AlignSurface {
    texture: Texture,
    rectangle: Rectangle,
    /// Of a bent surface.
    planes: Option<PlaneTable>,
}

impl AlignSurface {
    /// Prepares a surface.
    pub fn new(spec: &SurfaceSpec) -> Self {
        Self { texture: Texture::new(&spec.artwork), rectangle: Rectangle::of(spec), planes: PlaneTable::of(&spec.shape, spec.size_m) }
    }

    /// Where a point of its picture is, up to micrometres.
    fn at(&self, point: [f64; 2]) -> ShapePoint {
        self.planes.as_ref().map_or_else(|| self.rectangle.shape.at(point), |table| table.at(point.into()))
    }

    /// Takes its place and shape anew.
    fn take_place(&mut self, spec: &SurfaceSpec) {
        self.planes = PlaneTable::of(&spec.shape, spec.size_m);
        self.rectangle = Rectangle::of(spec);
    }
}

/// From a camera to the centre of the nearest surface, body axes, metres.
fn way_to_nearest(surfaces: &[AlignSurface], pose: &Pose<Body, Camera>) -> Option<Vector3<f64>> {
    let ways = surfaces.iter().map(|s| s.rectangle.centre - pose.translation);
    ways.min_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared()))
}

/// Where a camera sees the centre of the nearest surface, camera axes, metres.
fn nearest_centre(surfaces: &[AlignSurface], pose: &Pose<Body, Camera>) -> Vector3<f64> {
    pose.rotation.inverse() * way_to_nearest(surfaces, pose).unwrap_or_default()
}

/// Distance of a camera from the nearest surface's centre, metres.
fn distance_m(surfaces: &[AlignSurface], pose: &Pose<Body, Camera>) -> f64 {
    way_to_nearest(surfaces, pose).map_or(f64::INFINITY, |way| way.norm()).max(1e-3)
}

/// The camera's part of alignment, shared by all bodies.
#[derive(Debug)]
pub struct CameraRays {
    camera: CameraModel,
    /// Rays of levels 1 and up.
    tables: [RayTable; LEVELS - 1],
}

impl CameraRays {
    /// Finds the rays of a camera's pixels. `mask`: pixels to leave out (0), of the frame's size.
    pub fn new(camera: CameraModel, mask: Option<GrayImage>) -> Self {
        let tables = std::array::from_fn(|k| RayTable::new(&camera, k + 1, mask.as_ref()));
        Self { camera, tables }
    }

    /// Rays of a level, from 1.
    pub(super) fn table(&self, level: usize) -> &RayTable {
        &self.tables[level - 1]
    }

    /// The lens.
    pub fn camera(&self) -> &CameraModel {
        &self.camera
    }
}

#[cfg(test)]
mod kernel_tests;
