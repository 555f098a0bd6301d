//! A surface as alignment needs it: its texture at all levels, its place, and its shape as a table.

use nalgebra::Vector3;

use super::plane_table::PlaneTable;
use super::texture::Texture;
use crate::geometry::{Body, Camera, Pose};
use crate::track::scene::rectangle::Rectangle;
use crate::track::scene::shape::ShapePoint;
use crate::track::scene::surface::SurfaceSpec;

/// A surface as alignment needs it.
#[derive(Debug, Clone)]
pub struct AlignSurface {
    pub texture: Texture,
    pub rectangle: Rectangle,
    /// Of a bent surface.
    pub planes: Option<PlaneTable>,
}

impl AlignSurface {
    /// Prepares a surface.
    pub fn new(spec: &SurfaceSpec) -> Self {
        Self { texture: Texture::new(&spec.artwork), rectangle: Rectangle::of(spec), planes: PlaneTable::of(&spec.shape, spec.size_m) }
    }

    /// Where a point of its picture is, up to micrometres.
    pub fn at(&self, point: [f64; 2]) -> ShapePoint {
        self.planes.as_ref().map_or_else(|| self.rectangle.shape.at(point), |table| table.at(point.into()))
    }

    /// Takes its place and shape anew.
    pub fn take_place(&mut self, spec: &SurfaceSpec) {
        self.planes = PlaneTable::of(&spec.shape, spec.size_m);
        self.rectangle = Rectangle::of(spec);
    }
}

/// From a camera to the centre of the nearest surface, body axes, metres.
pub fn way_to_nearest(surfaces: &[AlignSurface], pose: &Pose<Body, Camera>) -> Option<Vector3<f64>> {
    let ways = surfaces.iter().map(|s| s.rectangle.centre - pose.translation);
    ways.min_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared()))
}

/// Where a camera sees the centre of the nearest surface, camera axes, metres.
pub fn nearest_centre(surfaces: &[AlignSurface], pose: &Pose<Body, Camera>) -> Vector3<f64> {
    pose.rotation.inverse() * way_to_nearest(surfaces, pose).unwrap_or_default()
}

/// Distance of a camera from the nearest surface's centre, metres.
pub fn distance_m(surfaces: &[AlignSurface], pose: &Pose<Body, Camera>) -> f64 {
    way_to_nearest(surfaces, pose).map_or(f64::INFINITY, |way| way.norm()).max(1e-3)
}
