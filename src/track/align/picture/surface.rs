//! A surface prepared for alignment: its texture at all levels, its place in the body, and its
//! shape as a table. Also computes where the nearest surface of a body is relative to a camera.

use nalgebra::Vector3;

use super::plane_table::PlaneTable;
use super::texture::Texture;
use crate::geometry::{Body, Camera, Pose};
use crate::light::square_root::roots_of;
use crate::track::scene::rectangle::Rectangle;
use crate::track::scene::shape::ShapePoint;
use crate::track::scene::surface::SurfaceSpec;

/// A surface prepared for alignment.
#[derive(Debug, Clone)]
pub struct AlignSurface {
    /// The picture at all levels.
    pub texture: Texture,
    /// Place in the body, size and shape.
    pub rectangle: Rectangle,
    /// Tabulated tangent planes of a bent surface; `None` for a flat one.
    pub planes: Option<PlaneTable>,
    /// Whether no pixel of it counts: it no longer stands in its place.
    pub is_left_out: bool,
}

impl AlignSurface {
    /// Prepares a surface: enlarges, halves and ranks its picture, and tabulates its shape.
    pub fn new(spec: &SurfaceSpec) -> Self {
        Self {
            texture: Texture::new(&roots_of(&spec.artwork, spec.transfer)),
            rectangle: Rectangle::of(spec),
            planes: PlaneTable::of(&spec.shape, spec.size_m),
            is_left_out: false,
        }
    }

    /// Returns where a point of the picture (x, y from its middle, metres) lies on the surface, to
    /// a few micrometres.
    pub fn at(&self, point: [f64; 2]) -> ShapePoint {
        self.planes.as_ref().map_or_else(|| self.rectangle.shape.at(point), |table| table.at(point.into()))
    }

    /// Replaces place and shape; the picture stays.
    pub fn take_place(&mut self, spec: &SurfaceSpec) {
        self.planes = PlaneTable::of(&spec.shape, spec.size_m);
        self.rectangle = Rectangle::of(spec);
    }
}

/// Returns the vector from a camera to the centre of the nearest surface, body axes, metres; `None`
/// without surfaces.
pub fn way_to_nearest(surfaces: &[AlignSurface], pose: &Pose<Body, Camera>) -> Option<Vector3<f64>> {
    let ways = surfaces.iter().map(|s| s.rectangle.centre - pose.translation);
    ways.min_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared()))
}

/// Returns the centre of the nearest surface in camera axes, metres; zero without surfaces.
pub fn nearest_centre(surfaces: &[AlignSurface], pose: &Pose<Body, Camera>) -> Vector3<f64> {
    pose.rotation.inverse() * way_to_nearest(surfaces, pose).unwrap_or_default()
}

/// Returns the distance from a camera to the centre of the nearest surface, metres: at least 1 mm,
/// and infinite without surfaces.
pub fn distance_m(surfaces: &[AlignSurface], pose: &Pose<Body, Camera>) -> f64 {
    way_to_nearest(surfaces, pose).map_or(f64::INFINITY, |way| way.norm()).max(1e-3)
}
