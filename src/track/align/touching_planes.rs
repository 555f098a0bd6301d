//! The planes that touch a bent surface where the pixels of a level see it.
//!
//! The kernel knows planes alone. A bent surface is near each pixel as flat as a plane that touches it there, up to a part of a millimetre
//! within centimetres; and no pixel moves that far before it is chosen anew. So each pixel of a bent surface brings its own map from the surface's frame to
//! the frame of its plane, whose x and y are those of the picture and whose points have z = 0. In it the surface is flat again: rays are mapped, and the rest stays.

use nalgebra::{Vector2, Vector3};

use super::AlignSurface;
use super::lanes::{LANES, Lanes, load_at};
use super::level_spec::LevelSpec;
use super::plane_table::PlaneTable;
use crate::motion::Motion;
use crate::track::shape::ShapePoint;

/// Steps by which a ray's meeting point is found: each squares what is left. Raised, nothing is gained; lowered to 1, steep views of deep folds are off by a part of a millimetre.
const MEETING_STEPS: usize = 3;
/// A plane that touches the surface within this of where the ray meets it is the one that touches it there, metres: in between, folds part from it by a micrometre.
/// Raised, steep views of sharp folds are off by more; lowered, each pixel of a bent surface costs another look at its shape.
const SAME_PLANE_M: f64 = 2e-3;
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
            let AlignSurface { rectangle, planes: Some(table), .. } = &spec.surfaces[surface as usize] else { continue };
            let to_surface = rectangle.rotation.transpose();
            let rotations = rotations.map(|r| to_surface * r);
            let [c0, c1, c2] = centres;
            let centres = [to_surface * (c0 - rectangle.centre), to_surface * c1, to_surface * c2];
            let (mut delay_s, mut rotation, mut from) = (0.0, rotations[0], centres[0]);
            // The folds put a pixel as far from where a flat picture would be seen as the one before it, which is mostly beside it.
            // Taken anew for every few pixels, so that these wait for the table together.
            let (mut off, mut found) = (Vector2::zeros(), Vector2::zeros());
            for k in start as usize..end as usize {
                if pixels.delay_s[k] != delay_s {
                    delay_s = pixels.delay_s[k];
                    let t = f64::from(delay_s);
                    rotation = rotations[0] + rotations[1] * t + rotations[2] * (t * t);
                    from = centres[0] + centres[1] * t + centres[2] * (t * t);
                }
                let direction = rotation * Vector3::new(f64::from(pixels.x[k]), f64::from(pixels.y[k]), 1.0);
                let on_plane = (from - direction * (from.z / direction.z)).xy();
                let map = touching(table, on_plane + off, &from, &direction).map(|(map, met)| {
                    found = met - on_plane;
                    map
                });
                if k % LANES == LANES - 1 {
                    off = found;
                }
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

/// The map to the plane that touches a surface where a ray meets it, and that point of the picture, found from a point nearby; `None` where the ray runs along the surface.
#[inline(always)]
fn touching(
    table: &PlaneTable,
    start: Vector2<f64>,
    from: &Vector3<f64>,
    direction: &Vector3<f64>,
) -> Option<([f64; NUMBERS], Vector2<f64>)> {
    let mut point = start;
    let mut found = None;
    for _ in 0..MEETING_STEPS {
        let map = map_to_plane(&table.at(point), point)?;
        let met = meet(&map, from, direction);
        if !(met.x.is_finite() && met.y.is_finite()) {
            return None;
        }
        found = Some((map, met));
        if (met - point).norm_squared() < SAME_PLANE_M * SAME_PLANE_M {
            break;
        }
        point = met;
    }
    found
}

/// The map to the plane that touches a surface at a point of its picture; `None` where the picture is folded to a line there.
#[inline(always)]
fn map_to_plane(at: &ShapePoint, point: Vector2<f64>) -> Option<[f64; NUMBERS]> {
    let (place, [a, b]) = (&at.place, &at.by_picture);
    let determinant = a.x * b.y - b.x * a.y;
    if determinant == 0.0 {
        return None;
    }
    let inverse = 1.0 / determinant;
    let (xx, xy, yx, yy) = (b.y * inverse, -b.x * inverse, -a.y * inverse, a.x * inverse);
    let (zx, zy) = (-(a.z * xx + b.z * yx), -(a.z * xy + b.z * yy));
    let shift =
        [point.x - (xx * place.x + xy * place.y), point.y - (yx * place.x + yy * place.y), -(zx * place.x + zy * place.y + place.z)];
    Some([xx, xy, yx, yy, zx, zy, shift[0], shift[1], shift[2]])
}

/// Where a ray meets the plane of a map, a point of the picture.
#[inline(always)]
fn meet(map: &[f64; NUMBERS], from: &Vector3<f64>, direction: &Vector3<f64>) -> Vector2<f64> {
    let [xx, xy, yx, yy, zx, zy, sx, sy, sz] = map;
    let towards = |v: &Vector3<f64>| Vector3::new(xx * v.x + xy * v.y, yx * v.x + yy * v.y, zx * v.x + zy * v.y + v.z);
    let (from, direction) = (towards(from) + Vector3::new(*sx, *sy, *sz), towards(direction));
    from.xy() - direction.xy() * (from.z / direction.z)
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
    use super::*;
    use crate::track::shape::tests::folds;

    #[test]
    fn a_ray_meets_the_mapped_plane_where_it_meets_the_surface() {
        let shape = folds();
        let point = [0.4, -0.7];
        let at = shape.at(point);
        let map = map_to_plane(&at, point.into()).unwrap();
        let linear = nalgebra::Matrix3::new(map[0], map[1], 0.0, map[2], map[3], 0.0, map[4], map[5], 1.0);
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

    #[test]
    fn a_pixels_plane_is_the_one_where_its_ray_meets_the_surface() {
        let shape = folds();
        let table = PlaneTable::of(&shape, [4.0, 3.0]).unwrap();
        for k in 0..200 {
            let from = Vector3::new(-2.0 + 0.02 * f64::from(k), 0.3, 2.0);
            let direction = Vector3::new(f64::from(k % 20) * 0.19 - 1.8, f64::from(k / 20) * 0.28 - 1.3, 0.0) - from;
            let plain = Vector2::from(shape.meet(&from, &direction).unwrap());
            let on_plane = (from - direction * (from.z / direction.z)).xy();
            // From the plane, from a neighbour, and from far away.
            for start in [on_plane, plain + Vector2::new(5e-4, -4e-4), plain + Vector2::new(-0.04, 0.03)] {
                let (map, met) = touching(&table, start, &from, &direction).unwrap();
                assert!((met - plain).norm() < 1e-5, "{met} {plain}");
                assert!((meet(&map, &from, &direction) - met).norm() < 1e-9);
            }
        }
        assert!(touching(&table, Vector2::zeros(), &Vector3::new(0.0, 0.0, f64::NAN), &Vector3::x()).is_none());
    }
}
