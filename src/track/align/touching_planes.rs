//! The planes that touch a bent surface where the pixels of a level see it.
//!
//! The kernel knows planes alone. A bent surface is near each pixel as flat as a plane that touches it there, up to a part of a millimetre
//! within centimetres; and no pixel moves that far before it is chosen anew. So each pixel of a bent surface brings its own map from the surface's frame to
//! the frame of its plane, whose x and y are those of the picture and whose points have z = 0. In it the surface is flat again: rays are mapped, and the rest stays.

use nalgebra::{Matrix2, Matrix3, Vector3};

use super::lanes::{LANES, Lanes, load_at};
use super::level_spec::LevelSpec;
use crate::motion::Motion;

/// Numbers of a map: two rows of the linear part by the surface's x and y, the third's, and the shift. (The linear part's third column is 0, 0, 1.)
const NUMBERS: usize = 9;

/// A map for each pixel; of no pixels where all surfaces are flat.
#[derive(Debug, Default)]
pub struct TouchingPlanes {
    maps: [Vec<f32>; NUMBERS],
}

/// The pixels of a level as their planes need them: in lists of the same order.
#[derive(Debug, Clone, Copy)]
pub struct Rays<'a> {
    /// Ray at depth 1.
    pub x: &'a [f32],
    /// See `x`.
    pub y: &'a [f32],
    /// Seconds from the frame's stamp to the middle of the row's exposure.
    pub delay_s: &'a [f32],
    /// Ranges of the surfaces: (surface, start, end).
    pub groups: &'a [(u32, u32, u32)],
}

/// The maps of a few pixels at a time.
#[derive(Clone, Copy)]
pub struct MapLanes<L> {
    numbers: [L; NUMBERS],
}

impl TouchingPlanes {
    /// Finds the planes for pixels that were arranged, seen from a motion.
    pub fn find(&mut self, pixels: &Rays, spec: &LevelSpec, motion: &Motion) {
        let is_bent = |surface: u32| !spec.surfaces[surface as usize].rectangle.shape.is_flat();
        let n = if pixels.groups.iter().any(|(surface, ..)| is_bent(*surface)) { pixels.x.len() } else { 0 };
        self.maps.iter_mut().for_each(|numbers| numbers.resize(n, 0.0));
        let (rotations, centres) = (motion.rotation_polynomial(), motion.centre_polynomial());
        for &(surface, start, end) in pixels.groups.iter().filter(|(surface, ..)| is_bent(*surface)) {
            let rectangle = &spec.surfaces[surface as usize].rectangle;
            let to_surface = rectangle.rotation.transpose();
            let rotations = rotations.map(|r| to_surface * r);
            let [c0, c1, c2] = centres;
            let centres = [to_surface * (c0 - rectangle.centre), to_surface * c1, to_surface * c2];
            for k in start as usize..end as usize {
                let t = f64::from(pixels.delay_s[k]);
                let ray = Vector3::new(f64::from(pixels.x[k]), f64::from(pixels.y[k]), 1.0);
                let direction = (rotations[0] + rotations[1] * t + rotations[2] * (t * t)) * ray;
                let from = centres[0] + centres[1] * t + centres[2] * (t * t);
                let map = rectangle.shape.meet(&from, &direction).and_then(|point| {
                    let at = rectangle.shape.at(point);
                    map_to_plane(&at.place, &at.by_picture, point)
                });
                let map = map.unwrap_or([1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
                self.maps.iter_mut().zip(map).for_each(|(numbers, value)| numbers[k] = value as f32);
            }
        }
    }

    /// Whether there are maps.
    pub fn is_empty(&self) -> bool {
        self.maps[0].is_empty()
    }

    /// The maps from pixel `k` on.
    #[inline(always)]
    pub fn load<L: Lanes>(&self, k: usize) -> MapLanes<L> {
        debug_assert!(k + LANES <= self.maps[0].len());
        let mut numbers = [L::splat(0.0); NUMBERS];
        for n in 0..NUMBERS {
            numbers[n] = load_at(&self.maps[n], k);
        }
        MapLanes { numbers }
    }
}

/// The map to the plane through `place` along `by_picture`, whose origin is the picture's; `None` where these are parallel.
fn map_to_plane(place: &Vector3<f64>, [a, b]: &[Vector3<f64>; 2], point: [f64; 2]) -> Option<[f64; NUMBERS]> {
    let within = Matrix2::new(a.x, b.x, a.y, b.y).try_inverse()?;
    let slope = -(nalgebra::RowVector2::new(a.z, b.z) * within);
    let linear = Matrix3::new(within.m11, within.m12, 0.0, within.m21, within.m22, 0.0, slope.x, slope.y, 1.0);
    let shift = Vector3::new(point[0], point[1], 0.0) - linear * place;
    Some([within.m11, within.m12, within.m21, within.m22, slope.x, slope.y, shift.x, shift.y, shift.z])
}

impl<L: Lanes> MapLanes<L> {
    /// A direction, or each column of a matrix of three rows of `W` entries.
    #[inline(always)]
    pub fn rows<const W: usize>(&self, rows: &[[L; W]; 3]) -> [[L; W]; 3] {
        let [xx, xy, yx, yy, zx, zy, ..] = self.numbers;
        let mut out = *rows;
        for c in 0..W {
            let [x, y, z] = [rows[0][c], rows[1][c], rows[2][c]];
            out[0][c] = xx.mul_add(x, xy.mul(y));
            out[1][c] = yx.mul_add(x, yy.mul(y));
            out[2][c] = zx.mul_add(x, zy.mul_add(y, z));
        }
        out
    }

    /// A point.
    #[inline(always)]
    pub fn point(&self, point: [L; 3]) -> [L; 3] {
        let [[x], [y], [z]] = self.rows(&point.map(|v| [v]));
        [x.add(self.numbers[6]), y.add(self.numbers[7]), z.add(self.numbers[8])]
    }

    /// A gradient by the plane's coordinates as one by the surface's.
    #[inline(always)]
    pub fn gradient(&self, [x, y, z]: [L; 3]) -> [L; 3] {
        let [xx, xy, yx, yy, zx, zy, ..] = self.numbers;
        [xx.mul_add(x, yx.mul_add(y, zx.mul(z))), xy.mul_add(x, yy.mul_add(y, zy.mul(z))), z]
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::*;
    use crate::track::shape::tests::folds;

    #[test]
    fn a_ray_meets_the_mapped_plane_where_it_meets_the_surface() {
        let shape = folds();
        let point = [0.4, -0.7];
        let at = shape.at(point);
        let map = map_to_plane(&at.place, &at.by_picture, point).unwrap();
        let linear = Matrix3::new(map[0], map[1], 0.0, map[2], map[3], 0.0, map[4], map[5], 1.0);
        let shift = Vector3::new(map[6], map[7], map[8]);
        let from = Vector3::new(1.2, 0.5, 2.4);
        for off in [Vector2::zeros(), Vector2::new(0.002, -0.001), Vector2::new(-0.01, 0.005)] {
            let near = [point[0] + off.x, point[1] + off.y];
            let direction = shape.at(near).place - from;
            let (from, direction) = (linear * from + shift, linear * direction);
            let met = from - direction * (from.z / direction.z);
            // What a plane misses within a centimetre of folds of 12 mm, a metre long.
            assert!((met.xy() - Vector2::from(near)).norm() < 1e-7 + 2.0 * off.norm_squared(), "{off}");
        }
    }
}
