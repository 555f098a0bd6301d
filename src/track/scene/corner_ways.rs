//! How the picture of a photographed surface moves if its configured corners are slightly wrong.

use nalgebra::{Matrix3, Vector2};

use super::surface::SurfaceSpec;
use crate::camera::Pixel;
use crate::geometry::{Homography, PointPair};

/// How one sigma of each corner coordinate moves the points of a surface's picture.
#[derive(Debug, Clone)]
pub struct CornerWays([Homography; 8]);

impl CornerWays {
    /// Computes them for a surface with uncertain corners: in each way, one coordinate of one
    /// corner is off by a sigma. `None` if the corners are certain or the photograph's lens does
    /// not map them.
    pub fn of(spec: &SurfaceSpec) -> Option<Self> {
        let outer = [(-0.5, 0.5), (0.5, 0.5), (0.5, -0.5), (-0.5, -0.5)].map(|(x, y)| Vector2::new(x * spec.size_m[0], y * spec.size_m[1]));
        let sigma_px = spec.doubt.corner_px;
        if spec.doubt.corners_share() == 0.0 {
            return None;
        }
        let mut ways = [Homography(Matrix3::identity()); 8];
        for (k, way) in ways.iter_mut().enumerate() {
            let mut pairs = outer.map(|corner| PointPair { from: corner, to: corner });
            let mut off = spec.raw_pixel(spec.to_artwork(outer[k / 2]))?;
            off[k % 2] += sigma_px;
            pairs[k / 2].from = spec.to_metres(spec.artwork_pixel(Pixel(off))?);
            *way = Homography::from_four(&pairs)?;
        }
        Some(Self(ways))
    }

    /// Returns how each way moves a point of the picture, metres.
    pub fn shifts(&self, at: Vector2<f64>) -> [Vector2<f64>; 8] {
        std::array::from_fn(|k| self.0[k].map(at).map_or(Vector2::zeros(), |moved| moved - at))
    }
}
