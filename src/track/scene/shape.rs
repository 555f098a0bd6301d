//! The shape of a surface: how far it stands out of its plane, and how it is stretched within it.
//!
//! A painted cloth hangs in folds, a print is longer than its file says. A [`SurfaceShape`] says
//! where each point of the picture really is, in the frame of its surface. Flat is the special
//! case, and costs nothing. Most code only asks where a point is ([`SurfaceShape::at`]) and where a
//! ray meets the surface ([`SurfaceShape::meet`]). For another kind of shape, CONTRIBUTING lists
//! the files that match on the kind; not all of them fail to compile for a new one.

use crate::track::scene::tuning::TUNING;
use std::sync::Arc;

use nalgebra::{Matrix2, Vector2, Vector3};

use crate::geometry::bspline::BicubicSpline;

/// Where the points of a picture are, in the frame of its surface.
#[derive(Debug, Clone, PartialEq, Default)]
#[non_exhaustive]
pub enum SurfaceShape {
    /// In the plane, where the picture has them.
    #[default]
    Flat,
    /// Bent, by a smooth height and a smooth stretch.
    Bent(Arc<BentShape>),
}

/// A smooth height over the plane and a smooth stretch within it.
#[derive(Debug, Clone, PartialEq)]
pub struct BentShape {
    /// Metres along the surface's normal.
    pub height: BicubicSpline<1>,
    /// Metres along the picture's x and y.
    pub stretch: BicubicSpline<2>,
    /// Ways in which the shape may be off, one sigma each: shapes to be added.
    pub ways: Vec<ShapeWay>,
}

/// One way in which a shape may be off.
#[derive(Debug, Clone, PartialEq)]
pub struct ShapeWay {
    /// As [`BentShape::height`], one sigma.
    pub height: BicubicSpline<1>,
    /// As [`BentShape::stretch`], one sigma.
    pub stretch: BicubicSpline<2>,
}

/// A point of a surface and its tangent plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShapePoint {
    /// Position in the surface's frame, metres.
    pub place: Vector3<f64>,
    /// Its derivatives by a metre along the picture's x and y.
    pub by_picture: [Vector3<f64>; 2],
}

impl ShapePoint {
    /// Returns the surface's normal there, out of its face; not of unit length.
    pub fn normal(&self) -> Vector3<f64> {
        self.by_picture[0].cross(&self.by_picture[1])
    }
}

impl BentShape {
    fn at(&self, point: [f64; 2]) -> ShapePoint {
        let (height, stretch) = (self.height.at(point), self.stretch.at(point));
        ShapePoint {
            place: Vector3::new(point[0] + stretch.value.x, point[1] + stretch.value.y, height.value.x),
            by_picture: [
                Vector3::new(1.0 + stretch.by_x.x, stretch.by_x.y, height.by_x.x),
                Vector3::new(stretch.by_y.x, 1.0 + stretch.by_y.y, height.by_y.x),
            ],
        }
    }
}

impl SurfaceShape {
    /// Whether all points are in the plane, where the picture has them.
    pub fn is_flat(&self) -> bool {
        matches!(self, Self::Flat)
    }

    /// Returns where the picture's point (x, y), metres from the centre, is.
    pub fn at(&self, point: [f64; 2]) -> ShapePoint {
        match self {
            Self::Flat => ShapePoint { place: Vector3::new(point[0], point[1], 0.0), by_picture: [Vector3::x(), Vector3::y()] },
            Self::Bent(shape) => shape.at(point),
        }
    }

    /// Returns the picture's point that a ray meets, metres from the centre; the ray is in the
    /// surface's frame. `None` if it runs along the surface.
    pub fn meet(&self, from: &Vector3<f64>, direction: &Vector3<f64>) -> Option<[f64; 2]> {
        let on_plane = (from - direction * (from.z / direction.z)).xy();
        let mut point = [on_plane.x, on_plane.y];
        if !self.is_flat() {
            for _ in 0..TUNING.intersection_steps {
                point = self.at(point).meet(point, from, direction)?;
            }
        }
        point.iter().all(|v| v.is_finite()).then_some(point)
    }
}

impl ShapePoint {
    /// Intersects a ray with the tangent plane at the picture's point `point`; returns the
    /// intersection as a point of the picture.
    fn meet(&self, point: [f64; 2], from: &Vector3<f64>, direction: &Vector3<f64>) -> Option<[f64; 2]> {
        let normal = self.normal();
        let hit = from + direction * (normal.dot(&(self.place - from)) / normal.dot(direction));
        let [a, b] = self.by_picture;
        let step = Matrix2::new(a.x, b.x, a.y, b.y).try_inverse()? * (hit - self.place).xy();
        Some((Vector2::from(point) + step).into())
    }
}

#[cfg(test)]
pub mod tests {
    use nalgebra::Vector1;

    use super::*;

    /// Folds of 12 mm over 4 x 3 m, and a print that is a few millimetres too long.
    pub fn folds() -> SurfaceShape {
        let mut height = BicubicSpline::zero([20, 15], [4.0, 3.0]);
        for (k, c) in height.coefficients_mut().iter_mut().enumerate() {
            let (i, j) = ((k % 23) as f64, (k / 23) as f64);
            *c = Vector1::new(0.012 * (0.9 * i + 0.2 * j).sin() + 0.008 * (0.35 * j - 0.1 * i).cos());
        }
        let mut stretch = BicubicSpline::zero([4, 3], [4.0, 3.0]);
        for (k, c) in stretch.coefficients_mut().iter_mut().enumerate() {
            *c = Vector2::new(0.002 * (k % 7) as f64 - 0.006, 0.001 * ((k / 7) as f64).sin());
        }
        SurfaceShape::Bent(Arc::new(BentShape { height, stretch, ways: Vec::new() }))
    }

    #[test]
    fn a_ray_intersects_the_surface_at_its_point() {
        let shape = folds();
        for k in 0..200 {
            let point = [f64::from(k % 20) * 0.19 - 1.8, f64::from(k / 20) * 0.28 - 1.3];
            let from = Vector3::new(-2.0 + 0.02 * f64::from(k), 0.3, 2.0);
            let direction = (shape.at(point).place - from) * 0.37;
            let met = Vector2::from(shape.meet(&from, &direction).unwrap());
            assert!((met - Vector2::from(point)).norm() < 1e-6, "{point:?} {met}");
        }
    }

    #[test]
    fn a_flat_shape_is_its_plane() {
        let (from, direction) = (Vector3::new(0.3, -0.2, 2.0), Vector3::new(0.2, 0.1, -1.0));
        let met = SurfaceShape::Flat.meet(&from, &direction).unwrap();
        assert!((Vector2::from(met) - Vector2::new(0.7, 0.0)).norm() < 1e-12);
        assert_eq!(SurfaceShape::Flat.at(met).normal(), Vector3::z());
        assert_eq!(SurfaceShape::Flat.meet(&from, &Vector3::x()), None);
    }

    #[test]
    fn the_tangent_plane_agrees_with_differences() {
        let (shape, h) = (folds(), 1e-6);
        for point in [[0.1, 0.2], [-1.7, 1.3], [1.2, -0.9]] {
            let found = shape.at(point).by_picture;
            let by = |axis: usize| {
                let shifted = |sign: f64| {
                    let mut p = point;
                    p[axis] += sign * h;
                    shape.at(p).place
                };
                (shifted(1.0) - shifted(-1.0)) / (2.0 * h)
            };
            assert!((found[0] - by(0)).norm() < 1e-7 && (found[1] - by(1)).norm() < 1e-7);
        }
    }
}
