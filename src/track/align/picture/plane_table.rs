//! The tangent planes of a bent surface, tabulated, because each frame asks for thousands of them.
//!
//! Evaluating the spline of a surface takes sixteen coefficients for each of its three coordinates.
//! Within centimetres a smooth surface equals its osculating paraboloid (value, slopes and second
//! derivatives at one point) up to a few micrometres. So these are computed once, for a grid of
//! points, and a lookup evaluates the one of the nearest grid point.

use crate::track::align::tuning::TUNING;
use nalgebra::{Vector2, Vector3};

use crate::track::align::lanes::{LANES, Lanes};
use crate::track::scene::shape::{ShapePoint, SurfaceShape};

/// Rows of a paraboloid: value and slope by x; slope by y and by xx; by xy and by yy. Half a row
/// has the offsets along x, y and z, and a zero: so the rows of eight points transpose cheaply.
const ROWS: usize = 3;
type Parabola = [[f32; LANES]; ROWS];
/// Length of half a row.
const HALF_ROW: usize = LANES / 2;

/// The paraboloids of a grid of points.
#[derive(Debug, Clone)]
pub struct PlaneTable {
    /// Rows of all paraboloids, [`ROWS`] for each grid point, row of the grid by row of the grid.
    rows: Vec<[f32; LANES]>,
    /// Steps of the grid along x and y.
    steps: [usize; 2],
    /// Width and height of the picture, metres.
    size_m: [f64; 2],
}

/// The surface at several points (x, y) of its picture, metres.
#[derive(Clone, Copy)]
pub struct TablePoint<L> {
    /// Offset of the surface from (x, y, 0), metres.
    pub off: [L; 3],
    /// Derivative of `off` by x, metres per metre.
    pub off_by_x: [L; 3],
    /// Derivative of `off` by y, metres per metre.
    pub off_by_y: [L; 3],
}

impl PlaneTable {
    /// Tabulates a shape for a picture of this size, metres; `None` for a flat shape, which needs
    /// no table.
    pub fn of(shape: &SurfaceShape, size_m: [f64; 2]) -> Option<Self> {
        let SurfaceShape::Bent(bent) = shape else { return None };
        let steps = bent.height.intervals().map(|n| n * TUNING.grid_steps_per_interval);
        let spacing = [0, 1].map(|axis| size_m[axis] / steps[axis] as f64);
        let place = |index: usize, axis: usize| index as f64 * spacing[axis] - 0.5 * size_m[axis];
        let points = (0..=steps[1]).flat_map(|j| (0..=steps[0]).map(move |i| [place(i, 0), place(j, 1)]));
        let rows = points.flat_map(|point| parabola(shape, point, size_m, spacing)).collect();
        Some(Self { rows, steps, size_m })
    }

    /// Returns the surface at a point of its picture, metres. It agrees with [`SurfaceShape::at`]
    /// to a few micrometres.
    pub fn at(&self, point: Vector2<f64>) -> ShapePoint {
        let nearest = |axis: usize| {
            let steps = self.steps[axis] as f64;
            // `clamp` keeps a NaN, which becomes index 0.
            let index = ((point[axis] / self.size_m[axis] + 0.5) * steps).clamp(0.0, steps) + 0.5;
            let index = index as usize;
            (index, point[axis] - (index as f64 * (self.size_m[axis] / steps) - 0.5 * self.size_m[axis]))
        };
        let ((i, x), (j, y)) = (nearest(0), nearest(1));
        let first = ROWS * (j * (self.steps[0] + 1) + i);
        let wide = |n: usize, half: usize| {
            let [x, y, z] = [0, 1, 2].map(|k| f64::from(self.rows[first + n][half * HALF_ROW + k]));
            Vector3::new(x, y, z)
        };
        let (by_x, by_y, by_xy) = (wide(0, 1), wide(1, 0), wide(2, 0));
        let (there_x, there_y) = (by_x + wide(1, 1) * x + by_xy * y, by_y + by_xy * x + wide(2, 1) * y);
        let off = wide(0, 0) + ((by_x + there_x) * x + (by_y + there_y) * y) * 0.5;
        ShapePoint { place: Vector3::new(point.x, point.y, 0.0) + off, by_picture: [Vector3::x() + there_x, Vector3::y() + there_y] }
    }

    /// Returns the same for several points.
    #[inline(always)]
    pub fn at_lanes<L: Lanes>(&self, point: [L; 2]) -> TablePoint<L> {
        let ([i, x], [j, y]) = (self.nearest(0, point[0]), self.nearest(1, point[1]));
        let index = L::address(j.to_index(), whole::<L>(self.steps[0] + 1), i.to_index(), whole::<L>(0));
        let [sx, sy, h, _, sx_x, sy_x, h_x, _] = self.row::<L>(index, 0);
        let [sx_y, sy_y, h_y, _, sx_xx, sy_xx, h_xx, _] = self.row::<L>(index, 1);
        let [sx_xy, sy_xy, h_xy, _, sx_yy, sy_yy, h_yy, _] = self.row::<L>(index, 2);
        let sx = parabola_at([x, y], sx, [sx_x, sx_y], [sx_xx, sx_xy, sx_yy]);
        let sy = parabola_at([x, y], sy, [sy_x, sy_y], [sy_xx, sy_xy, sy_yy]);
        let h = parabola_at([x, y], h, [h_x, h_y], [h_xx, h_xy, h_yy]);
        TablePoint { off: [sx[0], sy[0], h[0]], off_by_x: [sx[1], sy[1], h[1]], off_by_y: [sx[2], sy[2], h[2]] }
    }

    /// Returns the index of the nearest grid point along an axis, and the coordinate relative to
    /// it, metres.
    #[inline(always)]
    fn nearest<L: Lanes>(&self, axis: usize, at: L) -> [L; 2] {
        let (steps, size_m) = (self.steps[axis] as f32, self.size_m[axis] as f32);
        let index = at.mul_add(L::splat(steps / size_m), L::splat(0.5 * steps + 0.5));
        // For a NaN `max` returns the limit.
        let index = index.max(L::splat(0.0)).min(L::splat(steps + 0.5)).floor();
        [index, at.sub(index.mul_add(L::splat(size_m / steps), L::splat(-0.5 * size_m)))]
    }

    /// Returns row `n` of the paraboloids at `index`, as columns.
    #[inline(always)]
    fn row<L: Lanes>(&self, index: L::Index, n: usize) -> [L; LANES] {
        L::gather_rows(&self.rows, L::address(index, whole::<L>(ROWS), whole::<L>(n), whole::<L>(0)))
    }
}

/// Returns a small whole number in all lanes.
#[inline(always)]
fn whole<L: Lanes>(n: usize) -> L::Index {
    L::splat(n as f32).to_index()
}

/// Returns the value of a paraboloid at (x, y), and its derivatives by x and y there.
#[inline(always)]
fn parabola_at<L: Lanes>([x, y]: [L; 2], value: L, [by_x, by_y]: [L; 2], [xx, xy, yy]: [L; 3]) -> [L; 3] {
    let (there_x, there_y) = (x.mul_add(xx, y.mul_add(xy, by_x)), x.mul_add(xy, y.mul_add(yy, by_y)));
    let grown = x.mul_add(by_x.add(there_x), y.mul(by_y.add(there_y)));
    [grown.mul_add(L::splat(0.5), value), there_x, there_y]
}

/// Computes the paraboloid at a point; `spacing` is that of the grid, metres.
fn parabola(shape: &SurfaceShape, point: [f64; 2], size_m: [f64; 2], spacing: [f64; 2]) -> Parabola {
    let at = shape.at(point);
    // The change of both derivatives along an axis. The step is clamped, because the shape is
    // undefined beyond the picture.
    let curvature = |axis: usize| {
        let side = |sign: f64| {
            let mut p = point;
            p[axis] = (p[axis] + sign * TUNING.slope_step_ratio * spacing[axis]).clamp(-0.5 * size_m[axis], 0.5 * size_m[axis]);
            (p[axis], shape.at(p).by_picture)
        };
        let ((low, before), (high, after)) = (side(-1.0), side(1.0));
        [0, 1].map(|k| (after[k] - before[k]) / (high - low))
    };
    let ([xx, xy], [yx, yy]) = (curvature(0), curvature(1));
    let [by_x, by_y] = at.by_picture;
    let row = |first: Vector3<f64>, last: Vector3<f64>| [first.x, first.y, first.z, 0.0, last.x, last.y, last.z, 0.0].map(|v| v as f32);
    let value = at.place - Vector3::new(point[0], point[1], 0.0);
    [row(value, by_x - Vector3::x()), row(by_y - Vector3::y(), xx), row((xy + yx) * 0.5, yy)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::track::scene::shape::tests::folds;

    #[test]
    fn the_plane_table_matches_the_shape_to_micrometres() {
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
