//! The planes that touch a bent surface where the pixels of a level see it.
//!
//! The prediction kernel only handles planes. Near each pixel a bent surface equals its tangent
//! plane, up to a fraction of a millimetre within centimetres, and no pixel moves further before it
//! is chosen anew. So each pixel of a bent surface has its own affine map from the surface's frame
//! to the frame of its plane, whose x and y are those of the picture and whose points have z = 0.
//! There the surface is flat: rays are mapped, and all else stays the same.
//!
//! Everything is `f32`, as the kernel takes the maps. A place metres away is then known to half a
//! micrometre, a thousandth of what a pixel covers.

use super::level_spec::LevelSpec;
use crate::motion::Motion;
use crate::track::align::lanes::{LANES, Lanes, dispatch, load_at, resize_with_room, store_at, total};
use crate::track::align::picture::plane_table::{PlaneTable, TablePoint};
use crate::track::align::picture::sight::{Sight, SightPath};
use crate::track::align::picture::surface::AlignSurface;
use crate::track::align::tuning::TUNING;

/// Numbers of a map: the linear part's first two columns, row by row, and the shift. (Its third
/// column is 0, 0, 1.)
const MAP_NUMBERS: usize = 9;
/// The map for a ray that meets nothing: the surface's own plane.
const NO_MAP: [f32; MAP_NUMBERS] = [1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0];

/// A map for each pixel; empty where all surfaces are flat.
#[derive(Debug, Default)]
pub struct TouchingPlanes {
    maps: [Vec<f32>; MAP_NUMBERS],
}

/// The pixels of a level, as far as their planes need them: lists in the same order.
#[derive(Debug, Clone, Copy)]
pub struct Rays<'a> {
    /// Ray at depth 1: x.
    pub x: &'a [f32],
    /// Ray at depth 1: y.
    pub y: &'a [f32],
    /// Seconds from the frame's stamp to the middle of the row's exposure.
    pub delay_s: &'a [f32],
    /// Ranges of the surfaces: (surface, start, end).
    pub groups: &'a [(u32, u32, u32)],
}

/// The maps of several pixels.
#[derive(Clone, Copy)]
pub struct MapLanes<L> {
    numbers: [L; MAP_NUMBERS],
}

impl TouchingPlanes {
    /// Finds the planes for arranged pixels, as seen from a motion.
    pub fn find(&mut self, pixels: &Rays, spec: &LevelSpec, motion: &Motion) {
        let is_bent = |surface: u32| !spec.surfaces[surface as usize].rectangle.shape.is_flat();
        let n = if pixels.groups.iter().any(|(surface, ..)| is_bent(*surface)) { pixels.x.len() } else { 0 };
        self.maps.iter_mut().for_each(|numbers| resize_with_room(numbers, n, 0.0));
        for &(surface, start, end) in pixels.groups {
            let AlignSurface { rectangle, planes: Some(table), .. } = &spec.surfaces[surface as usize] else { continue };
            let path = SightPath::new(rectangle, motion);
            find_planes(&Touched { table, path, pixels, range: [start as usize, end as usize] }, &mut self.maps);
        }
    }

    /// Whether there are no maps.
    pub fn is_empty(&self) -> bool {
        self.maps[0].is_empty()
    }

    /// Returns the maps from pixel `k` on.
    #[inline(always)]
    pub fn load<L: Lanes>(&self, k: usize) -> MapLanes<L> {
        debug_assert!(k + LANES <= self.maps[0].len());
        let mut numbers = [L::splat(0.0); MAP_NUMBERS];
        for n in 0..MAP_NUMBERS {
            numbers[n] = load_at(&self.maps[n], k);
        }
        MapLanes { numbers }
    }
}

/// The pixels of one surface whose planes are computed.
pub struct Touched<'a> {
    /// Tangent planes of the surface.
    table: &'a PlaneTable,
    path: SightPath,
    pixels: &'a Rays<'a>,
    /// First of its pixels, and one past the last: whole lanes.
    range: [usize; 2],
}

dispatch! {
    /// Finds the planes of one surface's pixels.
    find_planes, find_planes_lanes, (what: &Touched, maps: &mut [Vec<f32>; MAP_NUMBERS])
}

#[inline(always)]
fn find_planes_lanes<L: Lanes>(what: &Touched, maps: &mut [Vec<f32>; MAP_NUMBERS]) {
    let Touched { table, path, pixels, range } = what;
    // Start from the offset, from the flat picture to the folds, of the previous pixels, which are
    // mostly adjacent.
    let mut off = [L::splat(0.0); 2];
    let mut k = range[0];
    while k < range[1] {
        let sight = path.at(load_at::<L>(pixels.delay_s, k));
        let direction = sight.direction(load_at(pixels.x, k), load_at(pixels.y, k));
        let on_plane = meet(&sight.centre, &direction);
        let start = [on_plane[0].add(off[0]), on_plane[1].add(off[1])];
        let (map, met, is_met) = touching(table, start, &sight.centre, &direction);
        off = if is_met { [met[0].sub(on_plane[0]), met[1].sub(on_plane[1])] } else { [L::splat(0.0); 2] };
        for n in 0..MAP_NUMBERS {
            store_at(&mut maps[n], k, map.numbers[n]);
        }
        if !is_met {
            drop_unmet(maps, k);
        }
        k += LANES;
    }
}

/// Returns the maps to the planes that touch a surface where rays meet it, starting from points
/// nearby; these points of the picture; and whether all rays meet the surface.
#[inline(always)]
fn touching<L: Lanes>(table: &PlaneTable, start: [L; 2], from: &[L; 3], direction: &[L; 3]) -> (MapLanes<L>, [L; 2], bool) {
    let mut point = start;
    let mut map = MapLanes::touching(&table.at_lanes(point), point);
    let mut met = map.meet(from, direction);
    let mut moved = squared(met, point);
    for _ in 1..TUNING.max_intersection_steps {
        if moved < TUNING.tangent_plane_reach_m * TUNING.tangent_plane_reach_m {
            break;
        }
        point = met;
        map = MapLanes::touching(&table.at_lanes(point), point);
        met = map.meet(from, direction);
        moved = squared(met, point);
    }
    (map, met, moved.is_finite())
}

/// Returns the sum of the squared distances of all lanes.
#[inline(always)]
fn squared<L: Lanes>(a: [L; 2], b: [L; 2]) -> f32 {
    let (x, y) = (a[0].sub(b[0]), a[1].sub(b[1]));
    total(x.mul_add(x, y.mul(y)))
}

/// Returns where rays meet the plane z = 0.
#[inline(always)]
fn meet<L: Lanes>(from: &[L; 3], direction: &[L; 3]) -> [L; 2] {
    let depth = L::splat(0.0).sub(from[2].div(direction[2]));
    [depth.mul_add(direction[0], from[0]), depth.mul_add(direction[1], from[1])]
}

/// Replaces the maps of those pixels of a group that are not finite, because their ray runs along
/// the surface, by the surface's own plane.
#[cold]
fn drop_unmet(maps: &mut [Vec<f32>; MAP_NUMBERS], first: usize) {
    for k in first..first + LANES {
        if !maps.iter().all(|numbers| numbers[k].is_finite()) {
            maps.iter_mut().zip(NO_MAP).for_each(|(numbers, value)| numbers[k] = value);
        }
    }
}

impl<L: Lanes> MapLanes<L> {
    /// Returns the maps to the planes that touch a surface at points of its picture; not finite
    /// where the picture is folded to a line.
    #[inline(always)]
    fn touching(at: &TablePoint<L>, point: [L; 2]) -> Self {
        let one = L::splat(1.0);
        let ([ax, ay, az], [bx, by, bz]) = (at.off_by_x, at.off_by_y);
        let (ax, by) = (one.add(ax), one.add(by));
        let inverse = one.div(ax.mul(by).sub(bx.mul(ay)));
        let less = L::splat(0.0).sub(inverse);
        let (xx, xy, yx, yy) = (by.mul(inverse), bx.mul(less), ay.mul(less), ax.mul(inverse));
        let zero = L::splat(0.0);
        let (zx, zy) = (zero.sub(az.mul_add(xx, bz.mul(yx))), zero.sub(az.mul_add(xy, bz.mul(yy))));
        let [x, y, z] = [point[0].add(at.off[0]), point[1].add(at.off[1]), at.off[2]];
        let shift =
            [point[0].sub(xx.mul_add(x, xy.mul(y))), point[1].sub(yx.mul_add(x, yy.mul(y))), zero.sub(zx.mul_add(x, zy.mul_add(y, z)))];
        Self { numbers: [xx, xy, yx, yy, zx, zy, shift[0], shift[1], shift[2]] }
    }

    /// Returns where rays meet the planes, as points of the picture.
    #[inline(always)]
    fn meet(&self, from: &[L; 3], direction: &[L; 3]) -> [L; 2] {
        let [[x], [y], [z]] = self.rows(&direction.map(|v| [v]));
        meet(&self.point(*from), &[x, y, z])
    }

    /// Transforms the camera's pose to the frames of the planes.
    #[inline(always)]
    pub fn sight(&self, sight: &Sight<L>) -> Sight<L> {
        let [a, b, c, d, e, f, g, h, i] = sight.rotation;
        let [[a, b, c], [d, e, f], [g, h, i]] = self.rows(&[[a, b, c], [d, e, f], [g, h, i]]);
        Sight { centre: self.point(sight.centre), rotation: [a, b, c, d, e, f, g, h, i] }
    }

    /// Applies the linear part to a direction, or to each column of a matrix of three rows of `W`
    /// entries.
    #[inline(always)]
    fn rows<const W: usize>(&self, rows: &[[L; W]; 3]) -> [[L; W]; 3] {
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

    /// Transforms a point.
    #[inline(always)]
    fn point(&self, point: [L; 3]) -> [L; 3] {
        let [[x], [y], [z]] = self.rows(&point.map(|v| [v]));
        [x.add(self.numbers[6]), y.add(self.numbers[7]), z.add(self.numbers[8])]
    }

    /// Returns a gradient by the surface's coordinates from one by the plane's.
    #[inline(always)]
    pub fn gradient(&self, [x, y, z]: [L; 3]) -> [L; 3] {
        let [xx, xy, yx, yy, zx, zy, ..] = self.numbers;
        [xx.mul_add(x, yx.mul_add(y, zx.mul(z))), xy.mul_add(x, yy.mul_add(y, zy.mul(z))), z]
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Vector2, Vector3};

    use super::*;
    use crate::track::align::lanes::Plain;
    use crate::track::scene::rectangle::Rectangle;
    use crate::track::scene::shape::ShapePoint;
    use crate::track::scene::shape::tests::folds;
    use crate::track::scene::surface::SurfaceSpec;
    use crate::track::synthetic::{cloth, facing};

    /// Returns the map to the plane that touches a surface at a point of its picture: linear part
    /// and shift, in `f64`.
    fn plain_map(at: &ShapePoint, point: Vector2<f64>) -> (Matrix3<f64>, Vector3<f64>) {
        let [a, b] = at.by_picture;
        let linear = Matrix3::from_columns(&[a, b, Vector3::z()]).try_inverse().unwrap();
        (linear, point.push(0.0) - linear * at.place)
    }

    fn plain_meet((linear, shift): &(Matrix3<f64>, Vector3<f64>), from: &Vector3<f64>, direction: &Vector3<f64>) -> Vector2<f64> {
        let (from, direction) = (linear * from + shift, linear * direction);
        (from - direction * (from.z / direction.z)).xy()
    }

    /// Returns the map that was found for a pixel.
    fn found_map(maps: &[Vec<f32>; MAP_NUMBERS], k: usize) -> (Matrix3<f64>, Vector3<f64>) {
        let [xx, xy, yx, yy, zx, zy, x, y, z] = [0, 1, 2, 3, 4, 5, 6, 7, 8].map(|n| f64::from(maps[n][k]));
        (Matrix3::new(xx, xy, 0.0, yx, yy, 0.0, zx, zy, 1.0), Vector3::new(x, y, z))
    }

    #[test]
    fn a_ray_meets_the_mapped_plane_where_it_meets_the_surface() {
        let shape = folds();
        let point = [0.4, -0.7];
        let map = plain_map(&shape.at(point), point.into());
        let from = Vector3::new(1.2, 0.5, 2.4);
        for off in [Vector2::zeros(), Vector2::new(0.002, -0.001), Vector2::new(-0.01, 0.005)] {
            let near = [point[0] + off.x, point[1] + off.y];
            let met = plain_meet(&map, &from, &(shape.at(near).place - from));
            // What a plane misses within a centimetre, for folds of 12 mm, a metre long.
            assert!((met - Vector2::from(near)).norm() < 1e-7 + 2.0 * off.norm_squared(), "{off}");
        }
    }

    #[test]
    fn simd_tangent_planes_match_the_scalar_twin() {
        let surface = AlignSurface::new(&SurfaceSpec { shape: folds(), ..cloth(1) });
        let (AlignSurface { rectangle, planes: Some(table), .. }, shape) = (&surface, folds()) else { panic!("it is bent") };
        let motion = passing();
        // Rays through points all over the picture, in an order that jumps.
        let points = (0..800).map(|k| Vector2::new(f64::from(k * 37 % 80) * 0.047 - 1.85, f64::from(k / 10) * 0.036 - 1.4));
        let (mut x, mut y, mut delay_s) = (Vec::new(), Vec::new(), Vec::new());
        for (k, point) in points.enumerate() {
            let time_s = 1e-5 * (k % 700) as f64;
            let pose = motion.after(time_s).pose;
            let seen = pose.inverse().transform(&(rectangle.rotation * point.push(0.0) + rectangle.centre).into());
            x.push((seen.x / seen.z) as f32);
            y.push((seen.y / seen.z) as f32);
            delay_s.push(time_s as f32);
        }
        let pixels = Rays { x: &x, y: &y, delay_s: &delay_s, groups: &[] };
        let what = Touched { table, path: SightPath::new(rectangle, &motion), pixels: &pixels, range: [0, x.len()] };
        let [mut wide, mut plain]: [[Vec<f32>; MAP_NUMBERS]; 2] = std::array::from_fn(|_| std::array::from_fn(|_| vec![0.0; x.len()]));
        find_planes(&what, &mut wide);
        find_planes_lanes::<Plain>(&what, &mut plain);
        for (k, maps) in (0..x.len()).flat_map(|k| [(k, &wide), (k, &plain)]) {
            let pose = motion.after(f64::from(delay_s[k])).pose;
            let to_surface = rectangle.rotation.transpose();
            let from = to_surface * (pose.translation - rectangle.centre);
            let direction = to_surface * (pose.rotation * Vector3::new(f64::from(x[k]), f64::from(y[k]), 1.0));
            let found = found_map(maps, k);
            let met = plain_meet(&found, &from, &direction);
            let right = Vector2::from(shape.meet(&from, &direction).unwrap());
            assert!((met - right).norm() < 1e-5, "{k}: {met} {right}");
            // The map must be tangent where the ray meets the table's surface, computed in `f64`:
            // within what folds deviate over SAME_PLANE_M, seen aslant.
            let twin = plain_map(&table.at(met), met);
            assert!((plain_meet(&twin, &from, &direction) - met).norm() < 6e-6, "{k}");
            assert!((found.0 - twin.0).norm() < 6e-3, "{k}: {found:?} {twin:?}");
        }
    }

    /// Returns the motion of a camera that passes 3 m in front of the cloth.
    fn passing() -> Motion {
        Motion {
            velocity: Vector3::new(0.3, -0.2, 0.1),
            angular_velocity: Vector3::new(0.2, -0.4, 0.3),
            ..Motion::still(facing(0.5, -0.3, Vector3::new(0.3, 0.1, 3.0)).inverse())
        }
    }

    #[test]
    fn a_ray_along_the_surface_gets_the_surfaces_own_plane() {
        let table = PlaneTable::of(&folds(), [4.0, 3.0]).unwrap();
        let rectangle = Rectangle::of(&cloth(1));
        let (mut x, y, delay_s) = ([0.1; LANES], [0.05; LANES], [0.0; LANES]);
        x[5] = f32::NAN;
        let pixels = Rays { x: &x, y: &y, delay_s: &delay_s, groups: &[] };
        let path = SightPath::new(&rectangle, &passing());
        let mut maps: [Vec<f32>; MAP_NUMBERS] = std::array::from_fn(|_| vec![f32::NAN; LANES]);
        find_planes(&Touched { table: &table, path, pixels: &pixels, range: [0, LANES] }, &mut maps);
        for k in 0..LANES {
            let numbers: [f32; MAP_NUMBERS] = std::array::from_fn(|n| maps[n][k]);
            assert!(numbers.iter().all(|v| v.is_finite()) && (numbers == NO_MAP) == (k == 5), "{k}: {numbers:?}");
        }
    }
}
