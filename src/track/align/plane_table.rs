//! A bent surface, ready to be asked for thousands of touching planes a frame.
//!
//! A spline costs sixteen coefficients for each of its three numbers. But within centimetres a smooth surface is its parabola, up to a few micrometres. So the parabolas of a
//! grid of points are made once, and a plane costs a look at the nearest one. Four numbers beside each other are one step of the processor: the stretch along x and
//! y, the height, and nothing.

use nalgebra::{Vector2, Vector3};

use crate::track::shape::{ShapePoint, SurfaceShape};

/// Points of the grid to an interval of the height's spline, along each axis. Chosen: of folds of 12 mm and 0.7 m, parabolas part by
/// ten micrometres. Raised, the table grows by the square, and leaves the cache; lowered, edges of sharp folds are off.
const TO_AN_INTERVAL: usize = 4;
/// Step by which slopes are differenced, as a share of the grid's spacing. Any small one would do.
const STEP: f64 = 0.25;

/// Stretch along x and y, and height; the fourth makes them four.
type Numbers = [f32; 4];

/// The parabola about a point.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(32))]
struct Parabola {
    value: Numbers,
    by_x: Numbers,
    by_y: Numbers,
    by_xx: Numbers,
    by_xy: Numbers,
    by_yy: Numbers,
}

/// The parabolas of a grid of points.
#[derive(Debug, Clone)]
pub struct PlaneTable {
    parabolas: Vec<Parabola>,
    /// Steps of the grid across and up.
    steps: [usize; 2],
    /// Width and height of the picture, metres.
    size_m: [f64; 2],
}

impl PlaneTable {
    /// Of a shape of a picture of this size; `None` of a flat one, which needs none.
    pub fn of(shape: &SurfaceShape, size_m: [f64; 2]) -> Option<Self> {
        let SurfaceShape::Bent(bent) = shape else { return None };
        let steps = bent.height.intervals().map(|n| n * TO_AN_INTERVAL);
        let spacing = [0, 1].map(|axis| size_m[axis] / steps[axis] as f64);
        let place = |index: usize, axis: usize| index as f64 * spacing[axis] - 0.5 * size_m[axis];
        let points = (0..=steps[1]).flat_map(|j| (0..=steps[0]).map(move |i| [place(i, 0), place(j, 1)]));
        Some(Self { parabolas: points.map(|point| Parabola::about(shape, point, size_m, spacing)).collect(), steps, size_m })
    }

    /// The surface at a point of its picture, as [`SurfaceShape::at`] up to micrometres.
    #[inline(always)]
    pub fn at(&self, point: Vector2<f64>) -> ShapePoint {
        let nearest = |axis: usize| {
            let steps = self.steps[axis] as f64;
            // `clamp` keeps a coordinate that is no number; as an index it becomes 0.
            let index = ((point[axis] / self.size_m[axis] + 0.5) * steps).clamp(0.0, steps) + 0.5;
            let index = index as usize;
            (index, (point[axis] - (index as f64 * (self.size_m[axis] / steps) - 0.5 * self.size_m[axis])) as f32)
        };
        let ((i, x), (j, y)) = (nearest(0), nearest(1));
        let p = &self.parabolas[j * (self.steps[0] + 1) + i];
        let (mut value, mut by_x, mut by_y) = ([0.0; 4], [0.0; 4], [0.0; 4]);
        for k in 0..4 {
            by_x[k] = p.by_x[k] + x * p.by_xx[k] + y * p.by_xy[k];
            by_y[k] = p.by_y[k] + x * p.by_xy[k] + y * p.by_yy[k];
            value[k] = p.value[k] + 0.5 * (x * (p.by_x[k] + by_x[k]) + y * (p.by_y[k] + by_y[k]));
        }
        let wide = |[x, y, z, _]: Numbers| Vector3::new(f64::from(x), f64::from(y), f64::from(z));
        ShapePoint {
            place: Vector3::new(point.x, point.y, 0.0) + wide(value),
            by_picture: [Vector3::x() + wide(by_x), Vector3::y() + wide(by_y)],
        }
    }
}

impl Parabola {
    fn about(shape: &SurfaceShape, point: [f64; 2], size_m: [f64; 2], spacing: [f64; 2]) -> Self {
        let numbers = |v: Vector3<f64>| [v.x as f32, v.y as f32, v.z as f32, 0.0];
        let at = shape.at(point);
        // The change of the slopes along an axis; beyond the picture there is no shape.
        let curvature = |axis: usize| {
            let side = |sign: f64| {
                let mut p = point;
                p[axis] = (p[axis] + sign * STEP * spacing[axis]).clamp(-0.5 * size_m[axis], 0.5 * size_m[axis]);
                (p[axis], shape.at(p).by_picture)
            };
            let ((low, before), (high, after)) = (side(-1.0), side(1.0));
            [0, 1].map(|k| (after[k] - before[k]) / (high - low))
        };
        let ([xx, xy], [yx, yy]) = (curvature(0), curvature(1));
        Self {
            value: numbers(at.place - Vector3::new(point[0], point[1], 0.0)),
            by_x: numbers(at.by_picture[0] - Vector3::x()),
            by_y: numbers(at.by_picture[1] - Vector3::y()),
            by_xx: numbers(xx),
            by_xy: numbers((xy + yx) * 0.5),
            by_yy: numbers(yy),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::track::shape::tests::folds;

    #[test]
    fn it_is_the_shape_up_to_micrometres() {
        let (shape, size_m) = (folds(), [4.0, 3.0]);
        let table = PlaneTable::of(&shape, size_m).unwrap();
        for (i, j) in (0..=90).flat_map(|i| (0..=70).map(move |j| (i, j))) {
            let point = [size_m[0] * (f64::from(i) / 90.0 - 0.5), size_m[1] * (f64::from(j) / 70.0 - 0.5)];
            let (fast, plain) = (table.at(point.into()), shape.at(point));
            assert!((fast.place - plain.place).norm() < 1e-5, "{point:?} {fast:?} {plain:?}");
            let off = [0, 1].map(|k| (fast.by_picture[k] - plain.by_picture[k]).norm());
            assert!(off.iter().all(|off| *off < 2e-3), "{point:?} {off:?}");
        }
        assert!(PlaneTable::of(&SurfaceShape::Flat, size_m).is_none());
        assert!(table.at(Vector2::new(f64::NAN, 9.0)).place.x.is_nan());
    }
}
