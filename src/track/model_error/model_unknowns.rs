//! The unknowns of the model that are estimated beside the pose: the lens, and for each surface its
//! side ratio, the skew of its corners, its place and its shape.
//!
//! Heights are a sum of cosines over the picture, from the lowest frequency up: few unknowns, and
//! smooth. Planes are left out, because a tilt of the surface is part of its place.

use std::f64::consts::PI;
use std::ops::Range;

use nalgebra::{Matrix2x3, Matrix2xX, Vector2, Vector3};

use super::tile_residuals::TileResidual;
use crate::geometry::{Body, Camera, Pose, skew};
use crate::track::patches::fitted_anchor::FittedAnchor;
use crate::track::scene::reference::PreparedBody;
use crate::track::scene::surface::SurfaceSpec;

/// Unknowns of the lens: logarithm of the focal length, centre in pixels, first radial coefficient.
pub const LENS: usize = 4;
/// Unknowns of a surface: the logarithm of its side ratio, then its shear and two keystones
/// (`PLACE`: position and direction).
const RATIO: usize = 1;
const ASKEW: usize = 3;
/// Unknowns of a surface's corners: ratio, shear and keystones.
pub const CORNERS: usize = RATIO + ASKEW;
const PLACE: usize = 6;
/// Maximum and minimum number of half waves of the heights (across plus up), and maximum number of
/// heights of all surfaces together. Raised, finer folds are told from other causes, in more time.
pub const MAX_WAVES: usize = 14;
const MIN_WAVES: usize = 3;
const MAX_HEIGHTS: usize = 240;
/// Half waves of the shapes that are tried in turn. Few unknowns, if they suffice, are the likelier
/// cause.
const COARSE_TO_FINE: [usize; 3] = [4, 8, MAX_WAVES];
/// Prior sigmas: log focal length, centre (px), radial coefficient, log ratio, skew, place (m),
/// direction (rad), height (m, per half wave). Lowered, large faults are missed.
const FOCAL_SIGMA: f64 = 0.2;
const CENTRE_SIGMA_PX: f64 = 60.0;
const RADIAL_SIGMA: f64 = 0.5;
const RATIO_SIGMA: f64 = 0.1;
const ASKEW_SIGMA: f64 = 0.05;
const PLACE_SIGMA_M: f64 = 0.3;
const DIRECTION_SIGMA: f64 = 0.2;
const HEIGHT_SIGMA_M: f64 = 0.1;

/// The unknowns of a body in the order of their columns: the lens, then per surface its ratio,
/// shear, keystones, place and heights.
#[derive(Debug)]
pub struct ModelUnknowns {
    surfaces: usize,
    /// Half waves across and up of each height.
    waves: Vec<[usize; 2]>,
}

impl ModelUnknowns {
    /// Creates the unknowns of a body with this many surfaces. `most_waves`: maximum half waves of
    /// its heights; fewer are used if [`MAX_HEIGHTS`] would be exceeded.
    pub fn new(surfaces: usize, most_waves: usize) -> Self {
        let waves_up_to =
            |most: usize| -> Vec<[usize; 2]> { (2..=most).flat_map(|sum| (0..=sum).map(move |across| [across, sum - across])).collect() };
        let most = (MIN_WAVES..=most_waves.max(MIN_WAVES)).rev().find(|most| waves_up_to(*most).len() * surfaces <= MAX_HEIGHTS);
        Self { surfaces, waves: waves_up_to(most.unwrap_or(MIN_WAVES)) }
    }

    /// Returns the number of unknowns of one surface.
    fn of_surface(&self) -> usize {
        CORNERS + PLACE + self.waves.len()
    }

    /// Returns the number of all unknowns.
    pub fn count(&self) -> usize {
        LENS + self.surfaces * self.of_surface()
    }

    /// Returns the columns of the lens.
    pub fn lens(&self) -> Range<usize> {
        0..LENS
    }

    /// Returns the columns of a surface.
    pub fn surface(&self, k: usize) -> Range<usize> {
        let first = LENS + k * self.of_surface();
        first..first + self.of_surface()
    }

    /// Returns the column of a surface's ratio.
    pub fn ratio(&self, k: usize) -> Range<usize> {
        let first = self.surface(k).start;
        first..first + RATIO
    }

    /// Returns the columns of a surface's corners: ratio, shear, and a keystone along each side.
    pub fn corners(&self, k: usize) -> Range<usize> {
        let first = self.surface(k).start;
        first..first + CORNERS
    }

    /// Returns the columns of a surface's place.
    pub fn place(&self, k: usize) -> Range<usize> {
        let first = self.corners(k).end;
        first..first + PLACE
    }

    /// Returns the columns of a surface's heights: ranges from the lowest frequencies up to ever
    /// higher ones.
    pub fn heights(&self, k: usize) -> impl Iterator<Item = Range<usize>> {
        let first = self.place(k).end;
        let up_to = |most: usize| self.waves.iter().filter(|[across, up]| across + up <= most).count();
        COARSE_TO_FINE.map(up_to).into_iter().map(move |count| first..first + count)
    }

    /// Returns the prior sigma of a column.
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

    /// Returns the value of each wave at a point of a picture, metres from its centre.
    fn heights_at<'a>(&'a self, spec: &'a SurfaceSpec, at: Vector2<f64>) -> impl Iterator<Item = f64> + 'a {
        let [x, y] = [0, 1].map(|axis| PI * (at[axis] / spec.size_m[axis] + 0.5));
        self.waves.iter().map(move |[across, up]| (*across as f64 * x).cos() * (*up as f64 * y).cos())
    }

    /// Returns the height of a surface's waves with these coefficients at a point, metres.
    pub fn height_m(&self, spec: &SurfaceSpec, numbers: &[f64], at: Vector2<f64>) -> f64 {
        self.heights_at(spec, at).zip(numbers).map(|(wave, number)| wave * number).sum()
    }

    /// Writes the derivatives of a tile's shift by the lens and by its own surface, in the order of
    /// their columns.
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

    /// Creates a row of zeros with the columns that [`fill`](Self::fill) writes.
    pub fn row(&self) -> Matrix2xX<f64> {
        Matrix2xX::zeros(LENS + self.of_surface())
    }

    /// Returns the columns of the full system to which a surface's row belongs.
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
/// derivative of the pixel by the point; `from_centre`: the point from the surface's centre,
/// metres.
pub fn fill_place(row: &mut Matrix2xX<f64>, first: usize, by_point: &Matrix2x3<f64>, from_centre: &Vector3<f64>) {
    row.columns_mut(first, 3).copy_from(by_point);
    row.columns_mut(first + 3, 3).copy_from(&(-by_point * skew(from_centre)));
}

/// Returns how each unknown of a surface's corners moves a point of its picture, metres per unit:
/// ratio and shear linearly, a keystone quadratically. A keystone of 1 enlarges one half of the
/// picture and shrinks the other, in proportion to the distance from the middle in half sides.
pub fn moved_by_corners([width, height]: [f64; 2], at: Vector2<f64>) -> [Vector2<f64>; CORNERS] {
    [Vector2::new(at.x, 0.0), Vector2::new(at.y, 0.0), at * (2.0 * at.x / width), at * (2.0 * at.y / height)]
}
