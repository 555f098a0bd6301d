//! What of the model may be other than told, as unknowns beside the pose: the lens, and of each surface its ratio of sides, its place and its shape.
//!
//! Heights are a sum of cosines over the picture, from the slowest on: few numbers, and smooth. A plane among them would be a tilt of the surface, which is
//! in its place.

use std::f64::consts::PI;
use std::ops::Range;

use nalgebra::{Matrix2x3, Matrix2xX, Vector2, Vector3};

use super::tile_residuals::TileResidual;
use crate::geometry::{Body, Camera, Pose, skew};
use crate::track::patches::fitted_anchor::FittedAnchor;
use crate::track::scene::reference::PreparedBody;
use crate::track::scene::surface::SurfaceSpec;

/// Numbers of the lens: logarithm of the focal length, centre in pixels, first radial coefficient.
pub const LENS: usize = 4;
/// Numbers of a surface before its heights: the logarithm of its ratio, its shear and two keystones, and its place and direction.
const RATIO: usize = 1;
const ASKEW: usize = 3;
/// Numbers of a surface's corners.
pub const CORNERS: usize = RATIO + ASKEW;
const PLACE: usize = 6;
/// Half waves of the heights together, across and up, at most and at least, and numbers that all surfaces' heights have together. Raised, finer folds are
/// told from other causes, in more time.
pub const MAX_WAVES: usize = 14;
const MIN_WAVES: usize = 3;
const MAX_HEIGHTS: usize = 240;
/// Half waves of the shapes that are tried, coarse to fine: a few numbers, where they do, are the likelier cause. Chosen, not tuned.
const COARSE_TO_FINE: [usize; 3] = [4, 8, MAX_WAVES];
/// How far each may be off, one sigma: logarithm of the focal length, centre (px), radial coefficient, logarithm of the ratio, shear and keystones, place (m), direction (rad), and
/// heights (m) of the slowest wave, finer ones in proportion less. Chosen wide: they only keep the equations regular. Lowered, large faults are passed over.
const FOCAL_SIGMA: f64 = 0.2;
const CENTRE_SIGMA_PX: f64 = 60.0;
const RADIAL_SIGMA: f64 = 0.5;
const RATIO_SIGMA: f64 = 0.1;
const ASKEW_SIGMA: f64 = 0.05;
const PLACE_SIGMA_M: f64 = 0.3;
const DIRECTION_SIGMA: f64 = 0.2;
const HEIGHT_SIGMA_M: f64 = 0.1;

/// The unknowns of a body, in the order of their columns: the lens, then surface by surface ratio, shear, keystones, place and heights.
#[derive(Debug)]
pub struct ModelUnknowns {
    surfaces: usize,
    /// Half waves across and up of each height.
    waves: Vec<[usize; 2]>,
}

impl ModelUnknowns {
    /// Of a body with so many surfaces, whose heights have so many half waves at most.
    pub fn new(surfaces: usize, most_waves: usize) -> Self {
        let waves_up_to =
            |most: usize| -> Vec<[usize; 2]> { (2..=most).flat_map(|sum| (0..=sum).map(move |across| [across, sum - across])).collect() };
        let most = (MIN_WAVES..=most_waves.max(MIN_WAVES)).rev().find(|most| waves_up_to(*most).len() * surfaces <= MAX_HEIGHTS);
        Self { surfaces, waves: waves_up_to(most.unwrap_or(MIN_WAVES)) }
    }

    /// Numbers of one surface.
    fn of_surface(&self) -> usize {
        CORNERS + PLACE + self.waves.len()
    }

    /// All numbers.
    pub fn count(&self) -> usize {
        LENS + self.surfaces * self.of_surface()
    }

    /// Columns of the lens.
    pub fn lens(&self) -> Range<usize> {
        0..LENS
    }

    /// Columns of a surface.
    pub fn surface(&self, k: usize) -> Range<usize> {
        let first = LENS + k * self.of_surface();
        first..first + self.of_surface()
    }

    /// Column of a surface's ratio.
    pub fn ratio(&self, k: usize) -> Range<usize> {
        let first = self.surface(k).start;
        first..first + RATIO
    }

    /// Columns of a surface's corners: ratio, shear, and keystone along each side.
    pub fn corners(&self, k: usize) -> Range<usize> {
        let first = self.surface(k).start;
        first..first + CORNERS
    }

    /// Columns of a surface's place.
    pub fn place(&self, k: usize) -> Range<usize> {
        let first = self.corners(k).end;
        first..first + PLACE
    }

    /// Columns of a surface's heights: those of the slowest waves, more and more of them.
    pub fn heights(&self, k: usize) -> impl Iterator<Item = Range<usize>> {
        let first = self.place(k).end;
        let up_to = |most: usize| self.waves.iter().filter(|[across, up]| across + up <= most).count();
        COARSE_TO_FINE.map(up_to).into_iter().map(move |count| first..first + count)
    }

    /// How far each may be off, one sigma.
    pub fn sigma(&self, column: usize) -> f64 {
        let Some(k) = column.checked_sub(LENS) else { return [FOCAL_SIGMA, CENTRE_SIGMA_PX, CENTRE_SIGMA_PX, RADIAL_SIGMA][column] };
        match k % self.of_surface() {
            0 => RATIO_SIGMA,
            k if k < CORNERS => ASKEW_SIGMA,
            k if k < CORNERS + 3 => PLACE_SIGMA_M,
            k if k < CORNERS + PLACE => DIRECTION_SIGMA,
            k => {
                let [across, up] = self.waves[k - CORNERS - PLACE];
                HEIGHT_SIGMA_M / (across + up) as f64
            }
        }
    }

    /// The height of each wave at a point of a picture, metres from its centre.
    fn heights_at<'a>(&'a self, spec: &'a SurfaceSpec, at: Vector2<f64>) -> impl Iterator<Item = f64> + 'a {
        let [x, y] = [0, 1].map(|axis| PI * (at[axis] / spec.size_m[axis] + 0.5));
        self.waves.iter().map(move |[across, up]| (*across as f64 * x).cos() * (*up as f64 * y).cos())
    }

    /// The height that numbers of a surface's waves make at a point.
    pub fn height_m(&self, spec: &SurfaceSpec, numbers: &[f64], at: Vector2<f64>) -> f64 {
        self.heights_at(spec, at).zip(numbers).map(|(wave, number)| wave * number).sum()
    }

    /// The derivatives of a tile's shift by the lens and by its own surface, in the order of their columns.
    pub fn fill(&self, row: &mut Matrix2xX<f64>, t: &TileResidual, anchor: &FittedAnchor, pose: &Pose<Camera, Body>, body: &PreparedBody) {
        let spec = &body.surfaces[anchor.surface as usize].spec;
        let (to_camera, by_point) = (pose.rotation_matrix(), t.by_pose.fixed_columns::<3>(0));
        let by_surface = by_point * to_camera * spec.pose.rotation_matrix();
        let at = spec.to_metres(anchor.artwork);
        row.set_column(0, &t.by_focal);
        row.set_column(1, &Vector2::x());
        row.set_column(2, &Vector2::y());
        row.set_column(3, &t.by_radial);
        fill_corners(row, LENS, &by_surface, spec.size_m, at);
        let from_centre = anchor.observation.point.coords - spec.pose.translation;
        let by_place = by_point * to_camera;
        fill_place(row, LENS + CORNERS, &by_place, &from_centre);
        let by_height = by_surface.column(2).into_owned();
        for (k, wave) in self.heights_at(spec, at).enumerate() {
            row.set_column(LENS + CORNERS + PLACE + k, &(by_height * wave));
        }
    }

    /// Columns of a row that [`fill`](Self::fill) fills.
    pub fn row(&self) -> Matrix2xX<f64> {
        Matrix2xX::zeros(LENS + self.of_surface())
    }

    /// Which columns those of a row of a surface are.
    pub fn columns_of(&self, surface: usize) -> impl Iterator<Item = usize> + Clone + use<> {
        self.lens().chain(self.surface(surface))
    }
}

/// Writes the columns of a surface's corners from `first` on. `by_surface`: derivative of the pixel
/// by the point in the surface's axes; `at`: the point, metres from the picture's centre.
pub fn fill_corners(row: &mut Matrix2xX<f64>, first: usize, by_surface: &Matrix2x3<f64>, size_m: [f64; 2], at: Vector2<f64>) {
    for (k, moved) in moved_by_corners(size_m, at).into_iter().enumerate() {
        row.set_column(first + k, &(by_surface * moved.push(0.0)));
    }
}

/// Writes the columns of a surface's place and direction from `first` on, in any axes. `by_point`:
/// derivative of the pixel by the point; `from_centre`: the point from the surface's centre, metres.
pub fn fill_place(row: &mut Matrix2xX<f64>, first: usize, by_point: &Matrix2x3<f64>, from_centre: &Vector3<f64>) {
    row.columns_mut(first, 3).copy_from(by_point);
    row.columns_mut(first + 3, 3).copy_from(&(-by_point * skew(from_centre)));
}

/// How the numbers of a surface's corners move a point of its picture, metres: ratio and shear in proportion, a keystone by its square. A keystone of 1 makes the one half of the
/// picture larger, and the other smaller, in proportion to the distance from the middle in half sides.
pub fn moved_by_corners([width, height]: [f64; 2], at: Vector2<f64>) -> [Vector2<f64>; CORNERS] {
    [Vector2::new(at.x, 0.0), Vector2::new(at.y, 0.0), at * (2.0 * at.x / width), at * (2.0 * at.y / height)]
}
