//! The unknowns of the model that are estimated beside the pose: the lens, and for each surface its
//! side ratio, the skew of its corners, its place and its shape.
//!
//! Heights are a sum of cosines over the picture, from the lowest frequency up: few unknowns, and
//! smooth. Planes are left out, because a tilt of the surface is part of its place.

use crate::track::model_error::tuning::TUNING;
use std::f64::consts::PI;
use std::ops::Range;

use nalgebra::{Matrix2x3, Matrix2xX, Vector2, Vector3};

use super::tile_residuals::TileResidual;
use crate::geometry::{Body, Camera, Pose, skew};
use crate::track::patches::fitted_anchor::FittedAnchor;
use crate::track::scene::reference::PreparedBody;
use crate::track::scene::surface::SurfaceSpec;

/// Unknowns of the lens: logarithm of the focal length, centre in pixels, first radial coefficient.
pub const LENS_UNKNOWNS: usize = 4;
/// Unknowns of a surface: the logarithm of its side ratio, then its shear and two keystones
/// (`PLACE_UNKNOWNS`: position and direction).
const RATIO_UNKNOWNS: usize = 1;
const SKEW_UNKNOWNS: usize = 3;
/// Unknowns of a surface's corners: ratio, shear and keystones.
pub const CORNER_UNKNOWNS: usize = RATIO_UNKNOWNS + SKEW_UNKNOWNS;
const PLACE_UNKNOWNS: usize = 6;
/// Maximum and minimum number of half waves of the heights (across plus up), and maximum number of
/// heights of all surfaces together. Raised, finer folds are told from other causes, in more time.
pub const MAX_WAVES: usize = 14;
/// Half waves of the shapes that are tried in turn. Few unknowns, if they suffice, are the likelier
/// cause.
const COARSE_TO_FINE: [usize; 3] = [4, 8, MAX_WAVES];

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
    /// its heights; fewer are used if `max_shape_heights` would be exceeded.
    pub fn new(surfaces: usize, most_waves: usize) -> Self {
        let waves_up_to =
            |most: usize| -> Vec<[usize; 2]> { (2..=most).flat_map(|sum| (0..=sum).map(move |across| [across, sum - across])).collect() };
        let most = (TUNING.min_shape_waves..=most_waves.max(TUNING.min_shape_waves))
            .rev()
            .find(|most| waves_up_to(*most).len() * surfaces <= TUNING.max_shape_heights);
        Self { surfaces, waves: waves_up_to(most.unwrap_or(TUNING.min_shape_waves)) }
    }

    /// Returns the number of unknowns of one surface.
    fn of_surface(&self) -> usize {
        CORNER_UNKNOWNS + PLACE_UNKNOWNS + self.waves.len()
    }

    /// Returns the number of all unknowns.
    pub fn count(&self) -> usize {
        LENS_UNKNOWNS + self.surfaces * self.of_surface()
    }

    /// Returns the columns of the lens.
    pub fn lens(&self) -> Range<usize> {
        0..LENS_UNKNOWNS
    }

    /// Returns the columns of a surface.
    pub fn surface(&self, k: usize) -> Range<usize> {
        let first = LENS_UNKNOWNS + k * self.of_surface();
        first..first + self.of_surface()
    }

    /// Returns the column of a surface's ratio.
    pub fn ratio(&self, k: usize) -> Range<usize> {
        let first = self.surface(k).start;
        first..first + RATIO_UNKNOWNS
    }

    /// Returns the columns of a surface's corners: ratio, shear, and a keystone along each side.
    pub fn corners(&self, k: usize) -> Range<usize> {
        let first = self.surface(k).start;
        first..first + CORNER_UNKNOWNS
    }

    /// Returns the columns of a surface's place.
    pub fn place(&self, k: usize) -> Range<usize> {
        let first = self.corners(k).end;
        first..first + PLACE_UNKNOWNS
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
        let Some(k) = column.checked_sub(LENS_UNKNOWNS) else {
            return [TUNING.study_focal_sigma, TUNING.study_centre_sigma_px, TUNING.study_centre_sigma_px, TUNING.study_radial_sigma]
                [column];
        };
        match k % self.of_surface() {
            0 => TUNING.study_ratio_sigma,
            k if k < CORNER_UNKNOWNS => TUNING.study_skew_sigma,
            k if k < CORNER_UNKNOWNS + 3 => TUNING.study_place_sigma_m,
            k if k < CORNER_UNKNOWNS + PLACE_UNKNOWNS => TUNING.study_direction_sigma,
            k => {
                let [across, up] = self.waves[k - CORNER_UNKNOWNS - PLACE_UNKNOWNS];
                TUNING.study_height_sigma_m / (across + up) as f64
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
        fill_corners(row, LENS_UNKNOWNS, &by_surface, spec.size_m, at);
        let from_centre = anchor.observation.point.coords - spec.pose.translation;
        let by_place = by_point * to_camera;
        fill_place(row, LENS_UNKNOWNS + CORNER_UNKNOWNS, &by_place, &from_centre);
        let by_height = by_surface.column(2).into_owned();
        for (k, wave) in self.heights_at(spec, at).enumerate() {
            row.set_column(LENS_UNKNOWNS + CORNER_UNKNOWNS + PLACE_UNKNOWNS + k, &(by_height * wave));
        }
    }

    /// Creates a row of zeros with the columns that [`fill`](Self::fill) writes.
    pub fn row(&self) -> Matrix2xX<f64> {
        Matrix2xX::zeros(LENS_UNKNOWNS + self.of_surface())
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
pub fn moved_by_corners([width, height]: [f64; 2], at: Vector2<f64>) -> [Vector2<f64>; CORNER_UNKNOWNS] {
    [Vector2::new(at.x, 0.0), Vector2::new(at.y, 0.0), at * (2.0 * at.x / width), at * (2.0 * at.y / height)]
}
