//! Finds which part of the model contradicts the frames: fits small models to the residual tile
//! displacements of many frames and compares them.
//!
//! A wrong lens, a surface that stands elsewhere, a stretched print and folded cloth each leave a
//! pattern in the tiles. Within one frame these patterns look alike, and the pose absorbs a part of
//! each. Over the frames of a moving camera they separate: a fold stays on the cloth, a lens error
//! stays on the sensor.
//!
//! The normal equations of all unknowns are therefore summed over frames. Each frame has a free
//! pose of its own, and a free motion during readout if the shutter is not described. Each part is
//! then solved for alone, and the likeliest is named by Schwarz's criterion (BIC): the logarithm of
//! its residual plus a penalty for its number of unknowns. If much remains, the next part is added
//! to it.

use crate::track::model_error::tuning::TUNING;
use std::ops::Range;

use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Matrix2xX, OMatrix, SMatrix, SVector, U12, Vector2};

use super::focal_clue::RowDisplacement;
use super::misfit::{Misfit, Part};
use super::model_unknowns::{ModelUnknowns, moved_by_corners};
use super::tile_residuals::{MEDIAN_LENGTH, TileResidual, TileResiduals};
use crate::camera::CameraModel;
use crate::geometry::robust_kernel::tukey_weight;
use crate::geometry::{Body, Camera, Pose};
use crate::track::patches::fitted_anchor::FittedAnchor;
use crate::track::scene::reference::PreparedBody;
use crate::track::scene::surface::SurfaceSpec;

/// Nuisance unknowns of a frame: its pose, and its motion during readout.
const NUISANCES: usize = 12;

/// One frame of a study.
#[derive(Clone, Copy)]
pub struct StudiedFrame<'a> {
    /// Residuals of the anchors' displacements at the pose.
    pub residuals: &'a TileResiduals,
    /// The pose that they belong to, `T_camera_body`.
    pub pose: &'a Pose<Camera, Body>,
    /// Where the frame shows the body.
    pub anchors: &'a [FittedAnchor],
    /// How a motion during readout displaces the rows.
    pub rows: &'a RowDisplacement,
}

/// Accumulates the evidence of frames about one body.
#[derive(Debug)]
pub struct ModelStudy {
    unknowns: ModelUnknowns,
    /// Normal equations of the unknowns, each frame's nuisances eliminated.
    normal: DMatrix<f64>,
    right: DVector<f64>,
    /// Sum of squared displacements at the solved poses, in variances of noise, and the number of
    /// measurements beyond the poses' unknowns.
    squared: f64,
    numbers: f64,
    /// Sum of squared displacements with free poses but no motion during readout.
    squared_by_poses: f64,
    frames: f64,
    /// Sum of the tiles' information in both directions, pixels⁻².
    information: f64,
    /// Errors of the camera's position per unknown, as a fraction of its distance: products, summed
    /// over frames. Then the sum of the distances, metres.
    shift_products: DMatrix<f64>,
    distances_m: f64,
    shared: OMatrix<f64, U12, Dyn>,
    row: Matrix2xX<f64>,
    squares: Vec<f64>,
    /// Whether the first surface is a facet of a map, which defines no frame.
    is_first_a_facet: bool,
}

/// A set of parts, solved for.
struct Solved {
    columns: Vec<usize>,
    numbers: DVector<f64>,
    left: f64,
    /// Number of unknowns determined by the frames rather than by the prior.
    freedom: f64,
}

impl ModelStudy {
    /// Creates a study of a body with this many surfaces. `most_waves`: the finest folds that are
    /// modelled, half waves over the picture.
    pub fn new(surfaces: usize, most_waves: usize) -> Self {
        let unknowns = ModelUnknowns::new(surfaces, most_waves);
        let n = unknowns.count();
        Self {
            normal: DMatrix::zeros(n, n),
            right: DVector::zeros(n),
            squared: 0.0,
            numbers: 0.0,
            squared_by_poses: 0.0,
            frames: 0.0,
            information: 0.0,
            shift_products: DMatrix::zeros(n, n),
            distances_m: 0.0,
            shared: OMatrix::<f64, U12, Dyn>::zeros(n),
            row: unknowns.row(),
            squares: Vec::new(),
            is_first_a_facet: false,
            unknowns,
        }
    }

    /// Scales the weight of all earlier frames by `share`.
    pub fn forget(&mut self, share: f64) {
        self.normal *= share;
        self.right *= share;
        self.shift_products *= share;
        let Self { squared, numbers, squared_by_poses, frames, information, distances_m, .. } = self;
        for sum in [squared, numbers, squared_by_poses, frames, information, distances_m] {
            *sum *= share;
        }
    }

    /// Adds a frame.
    pub fn add(&mut self, frame: &StudiedFrame, body: &PreparedBody) {
        let StudiedFrame { residuals, pose, anchors, rows } = *frame;
        self.is_first_a_facet = body.surfaces.first().is_some_and(|surface| surface.spec.is_facet());
        let scales: Vec<f64> = (0..body.surfaces.len()).map(|k| self.scale_of(k, residuals, anchors)).collect();
        let Self { unknowns, normal, right, shared, row, shift_products, .. } = self;
        let mut own = nuisance_normal(rows);
        let mut own_right = SVector::<f64, NUISANCES>::zeros();
        let (mut squared, mut weights, mut all_information, mut depths_m) = (0.0, 0.0, 0.0, 0.0);
        shared.fill(0.0);
        for t in residuals.tiles() {
            let anchor = &anchors[t.anchor];
            let weight = tukey_weight(residuals.squared_left(t), scales[anchor.surface as usize]);
            if weight <= 0.0 {
                continue;
            }
            unknowns.fill(row, t, anchor, pose, body);
            let by_nuisance = nuisances(t, rows);
            let information = t.noise_information * weight;
            let weighted = information * &*row;
            let weighted_shift = information * t.shift_px;
            own += by_nuisance.transpose() * information * by_nuisance;
            own_right += by_nuisance.transpose() * weighted_shift;
            squared += t.shift_px.dot(&weighted_shift);
            weights += weight;
            all_information += information.trace();
            depths_m += weight * pose.transform(&anchor.observation.point).z;
            let columns = unknowns.columns_of(anchor.surface as usize);
            for (j, column) in columns.clone().enumerate() {
                let w = weighted.column(j);
                right[column] += row.column(j).dot(&weighted_shift);
                let mut s = shared.column_mut(column);
                s += by_nuisance.transpose() * w;
                for (i, other) in columns.clone().enumerate() {
                    normal[(other, column)] += row.column(i).dot(&w);
                }
            }
        }
        let Some(factor) = own.cholesky() else { return };
        let by_shared = factor.solve(&*shared);
        normal.gemm_tr(-1.0, &*shared, &by_shared, 1.0);
        right.gemv_tr(-1.0, &by_shared, &own_right, 1.0);
        let distance_m = depths_m / weights;
        let shifts = by_shared.fixed_rows::<3>(0) / distance_m;
        shift_products.gemm_tr(1.0, &shifts, &shifts, 1.0);
        let pose_right = own_right.fixed_rows::<6>(0).into_owned();
        let by_pose = own.fixed_view::<6, 6>(0, 0).into_owned().cholesky();
        self.squared_by_poses += squared - by_pose.map_or(0.0, |factor| pose_right.dot(&factor.solve(&pose_right)));
        self.squared += squared - own_right.dot(&factor.solve(&own_right));
        self.numbers += 2.0 * weights - 6.0;
        self.frames += 1.0;
        self.information += all_information;
        self.distances_m += distance_m;
    }

    /// Returns the Tukey scale of a surface's tiles, sigmas of noise, including the factor
    /// `study_tukey_sigmas`.
    fn scale_of(&mut self, surface: usize, residuals: &TileResiduals, anchors: &[FittedAnchor]) -> f64 {
        self.squares.clear();
        let own = residuals.tiles().iter().filter(|t| anchors[t.anchor].surface as usize == surface);
        self.squares.extend(own.map(|t| residuals.squared_left(t)));
        if self.squares.is_empty() {
            return TUNING.study_tukey_sigmas;
        }
        let middle = self.squares.len() / 2;
        let median = *self.squares.select_nth_unstable_by(middle, f64::total_cmp).1;
        TUNING.study_tukey_sigmas * (median.sqrt() / MEDIAN_LENGTH).max(1.0)
    }

    /// Returns the root mean square residual of the tiles after poses and motions during readout,
    /// pixels, weighted by information.
    pub fn left_px(&self) -> f64 {
        if self.information > 0.0 { (2.0 * self.squared / self.information).sqrt() } else { 0.0 }
    }

    /// Returns the fraction (0 to 1) of the excess over noise at free poses that remains once
    /// motion during readout is free too. What that motion explains needs no model error.
    pub fn share_left(&self) -> f64 {
        let excess = |squared: f64| (squared - self.numbers).max(0.0);
        (excess(self.squared) / excess(self.squared_by_poses).max(f64::MIN_POSITIVE)).min(1.0)
    }

    /// Returns the pose error that deviations of some unknowns cause: root mean square over the
    /// frames, as a fraction of the distance.
    fn cost(&self, columns: &[usize], numbers: &[f64]) -> f64 {
        let pairs = columns.iter().zip(numbers);
        let squared: f64 = pairs.clone().map(|(i, x)| x * pairs.clone().map(|(k, y)| self.shift_products[(*i, *k)] * y).sum::<f64>()).sum();
        (squared.max(0.0) / self.frames.max(1.0)).sqrt()
    }

    /// Returns the mean distance from the camera, metres.
    fn distance_m(&self) -> f64 {
        self.distances_m / self.frames.max(1.0)
    }

    /// Returns the mean square residual at the solved poses, in variances of noise; 0 without
    /// frames.
    pub fn misfit(&self) -> f64 {
        if self.numbers > 0.0 { self.squared / self.numbers } else { 0.0 }
    }

    /// Returns the parts that contradict the frames, the likeliest first. Empty if everything fits,
    /// or if two parts explain the frames equally well.
    pub fn misfits(&self, body: &PreparedBody, camera: &CameraModel) -> Vec<Misfit> {
        let mut named: Vec<(Candidate, Solved)> = Vec::new();
        if self.frames < 1.0 || self.misfit() < TUNING.min_model_misfit {
            return Vec::new();
        }
        let mut before = Solved { columns: Vec::new(), numbers: DVector::zeros(0), left: self.squared, freedom: 0.0 };
        let all = self.candidates(body);
        let is_mapped = body.surfaces.iter().any(|surface| surface.spec.is_facet());
        while named.len() < if is_mapped { TUNING.max_pieces } else { TUNING.max_parts } {
            let rest = all.iter().filter(|c| named.iter().all(|(n, _)| !n.is_alike(c)));
            let Some((candidate, solved)) = self.likeliest(rest, &before) else { break };
            let rivals = all.iter().filter(|c| named.is_empty() && !c.is_alike(&candidate));
            if let Some((_, rival)) = self.likeliest(rivals, &before)
                && self.criterion(&rival) - self.criterion(&solved) < TUNING.min_part_gain
            {
                break;
            }
            let gain = self.criterion(&before) - self.criterion(&solved);
            let share = (before.left - solved.left) / self.squared;
            let is_later = usize::from(!named.is_empty());
            tracing::debug!(?candidate, gain, share, left = solved.left / self.squared, "likeliest");
            // Pieces of a map are many and small, and a moved crate has several of them.
            let is_piece = matches!(candidate.kind, Kind::Place(k) if body.surfaces[k].spec.is_facet());
            let max_left = if named.is_empty() || is_piece { 1.0 } else { TUNING.max_later_residual_ratio };
            let min_share = if is_piece { TUNING.min_piece_gain_ratio } else { TUNING.min_part_gain_ratio[is_later] };
            if gain < TUNING.min_part_gain || share < min_share || solved.left > max_left * before.left {
                break;
            }
            before = Solved { columns: solved.columns.clone(), numbers: solved.numbers.clone(), ..solved };
            named.push((candidate, solved));
        }
        let mut left = self.squared;
        let last = &before;
        let misfit = |(candidate, solved): &(Candidate, Solved)| {
            let share = (left - solved.left) / self.squared;
            left = solved.left;
            let first = last.columns.iter().position(|c| *c == candidate.columns.start)?;
            let range = first..first + candidate.columns.len();
            let numbers = &last.numbers.as_slice()[range.clone()];
            let part = candidate.part(numbers, &self.unknowns, body, camera);
            let cost = self.cost(&last.columns[range], numbers);
            tracing::debug!(?part, share, cost, "does not fit");
            let is_worth_a_word = cost.max(part.size_m(body) / self.distance_m()) >= TUNING.min_part_pose_error;
            is_worth_a_word.then(|| Misfit { part, share, cost_mm: 1e3 * cost * self.distance_m() })
        };
        named.iter().filter_map(misfit).collect()
    }

    fn candidates(&self, body: &PreparedBody) -> Vec<Candidate> {
        let surfaces = body.surfaces.len();
        let mut all = vec![Candidate { kind: Kind::Lens, columns: self.unknowns.lens() }];
        // A facet is flat and as large as it was seen: it can only stand elsewhere.
        let (facets, others): (Vec<usize>, Vec<usize>) = (0..surfaces).partition(|k| body.surfaces[*k].spec.is_facet());
        let is_left_out = |k: &usize| body.surfaces[*k].is_left_out;
        let moved = facets.into_iter().filter(|k| !is_left_out(k) && surfaces > 1);
        all.extend(moved.map(|k| Candidate { kind: Kind::Place(k), columns: self.unknowns.place(k) }));
        for k in others {
            all.push(Candidate { kind: Kind::Ratio(k), columns: self.unknowns.ratio(k) });
            all.push(Candidate { kind: Kind::Corners(k), columns: self.unknowns.corners(k) });
            if surfaces > 1 {
                all.push(Candidate { kind: Kind::Place(k), columns: self.unknowns.place(k) });
            }
            all.extend(self.unknowns.heights(k).map(|columns| Candidate { kind: Kind::Shape(k), columns }));
        }
        all
    }

    /// Returns the candidate that is likeliest in addition to those already named.
    fn likeliest<'a>(&self, candidates: impl Iterator<Item = &'a Candidate>, before: &Solved) -> Option<(Candidate, Solved)> {
        let solved = candidates.filter_map(|c| {
            let columns = before.columns.iter().copied().chain(c.columns.clone()).collect();
            let mut solved = self.solved(columns)?;
            if c.kind == Kind::Place(0) && !self.is_first_a_facet {
                solved.left /= TUNING.max_first_surface_residual_ratio;
            }
            Some((c.clone(), solved))
        });
        solved.min_by(|a, b| self.criterion(&a.1).total_cmp(&self.criterion(&b.1)))
    }

    /// Returns Schwarz's criterion (BIC). Tiles of many frames count no more than those of a few,
    /// because the next frame shows much the same.
    fn criterion(&self, solved: &Solved) -> f64 {
        let count = self.numbers / self.frames * self.frames.clamp(1.0, TUNING.max_differing_frames).sqrt();
        count * (solved.left / self.squared).max(f64::MIN_POSITIVE).ln() + solved.freedom * count.max(1.0).ln()
    }

    /// Solves for the values of some columns that minimise the residual.
    fn solved(&self, columns: Vec<usize>) -> Option<Solved> {
        let n = columns.len();
        let data = DMatrix::from_fn(n, n, |i, k| self.normal[(columns[i], columns[k])]);
        let right = DVector::from_fn(n, |k, _| self.right[columns[k]]);
        // The prior has the weight of one frame, at the scale of the residual.
        let scale = self.misfit().max(1.0);
        let prior = DVector::from_fn(n, |k, _| scale * self.unknowns.sigma(columns[k]).powi(-2));
        let factor = Cholesky::<f64, Dyn>::new(&data + DMatrix::from_diagonal(&prior))?;
        let numbers = factor.solve(&right);
        let left = self.squared - 2.0 * right.dot(&numbers) + numbers.dot(&(&data * &numbers));
        let freedom = factor.solve(&data).trace();
        (left.is_finite() && numbers.iter().all(|v| v.is_finite())).then(|| Solved { columns, numbers, left: left.max(0.0), freedom })
    }
}

/// Returns the normal matrix of a frame's nuisances before any tile: the prior of its motion.
pub fn nuisance_normal(rows: &RowDisplacement) -> SMatrix<f64, NUISANCES, NUISANCES> {
    let mut own = SMatrix::<f64, NUISANCES, NUISANCES>::zeros();
    own.fixed_view_mut::<6, 6>(6, 6).copy_from(rows.motion_information());
    own
}

/// Returns the derivatives of a tile's shift by the frame's nuisances.
pub fn nuisances(t: &TileResidual, rows: &RowDisplacement) -> SMatrix<f64, 2, NUISANCES> {
    let mut by = SMatrix::<f64, 2, NUISANCES>::zeros();
    by.fixed_columns_mut::<6>(0).copy_from(&t.by_pose);
    if !rows.is_described() {
        by.fixed_columns_mut::<6>(6).copy_from(&(t.by_pose * rows.delay_s(t)));
    }
    by
}

/// The part that a candidate stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Lens,
    Ratio(usize),
    Corners(usize),
    Place(usize),
    Shape(usize),
}

/// A part that may differ from the config.
#[derive(Debug, Clone, PartialEq)]
struct Candidate {
    kind: Kind,
    columns: Range<usize>,
}

impl Candidate {
    /// Whether both belong to the same part. The side ratio of a surface is one of the unknowns of
    /// its corners.
    fn is_alike(&self, other: &Self) -> bool {
        let kind = |candidate: &Self| match candidate.kind {
            Kind::Ratio(k) => Kind::Corners(k),
            kind => kind,
        };
        kind(self) == kind(other)
    }

    fn part(&self, numbers: &[f64], unknowns: &ModelUnknowns, body: &PreparedBody, camera: &CameraModel) -> Part {
        match self.kind {
            Kind::Lens => Part::Lens {
                focal_percent: 100.0 * (numbers[0].exp() - 1.0),
                centre_px: [numbers[1], numbers[2]],
                radial: numbers[3],
                farthest_px: farthest_px(numbers, camera),
            },
            Kind::Ratio(surface) => Part::Ratio { surface, wider_percent: 100.0 * (numbers[0].exp() - 1.0) },
            Kind::Corners(surface) => {
                let off = corners_off(&body.surfaces[surface].spec, numbers);
                Part::Corners { surface, most_px: off[0], most_mm: 1e3 * off[1] }
            }
            Kind::Place(surface) => {
                let rotation = SVector::<f64, 3>::new(numbers[3], numbers[4], numbers[5]);
                Part::Place { surface, moved_mm: [0, 1, 2].map(|k| 1e3 * numbers[k]), rotation_deg: rotation.norm().to_degrees() }
            }
            Kind::Shape(surface) => {
                let spec = &body.surfaces[surface].spec;
                let along = |k: u32, side: f64| ((f64::from(k) + 0.5) / f64::from(TUNING.shape_points_per_side) - 0.5) * side;
                let places = (0..TUNING.shape_points_per_side).flat_map(|i| {
                    (0..TUNING.shape_points_per_side).map(move |j| Vector2::new(along(i, spec.size_m[0]), along(j, spec.size_m[1])))
                });
                let heights = places.map(|at| unknowns.height_m(spec, numbers, at));
                let (squared, most) = heights.fold((0.0, 0.0_f64), |(sum, most), h| (sum + h * h, most.max(h.abs())));
                Part::Shape {
                    surface,
                    rms_mm: 1e3 * (squared / f64::from(TUNING.shape_points_per_side * TUNING.shape_points_per_side)).sqrt(),
                    most_mm: 1e3 * most,
                }
            }
        }
    }
}

/// Returns the largest displacement of a picture corner by the unknowns of a surface's corners: in
/// pixels of the picture file, and in metres.
fn corners_off(spec: &SurfaceSpec, numbers: &[f64]) -> [f64; 2] {
    let corners = [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]];
    let off = corners.map(|[x, y]| {
        let at = Vector2::new(x * spec.size_m[0], y * spec.size_m[1]);
        let moved: Vector2<f64> = moved_by_corners(spec.size_m, at).iter().zip(numbers).map(|(by, number)| by * *number).sum();
        let pixel = |at: Vector2<f64>| spec.raw_pixel(spec.to_artwork(at)).unwrap_or_default();
        [(pixel(at + moved) - pixel(at)).norm(), moved.norm()]
    });
    [0, 1].map(|k| off.iter().fold(0.0_f64, |most, off| most.max(off[k])))
}

/// Returns the largest displacement of a frame corner by the lens' unknowns, pixels.
fn farthest_px(numbers: &[f64], camera: &CameraModel) -> f64 {
    let i = camera.intrinsics();
    let corners = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]];
    let displaced = corners.map(|[x, y]| {
        let from_centre = Vector2::new(x * f64::from(i.width) - i.cx, y * f64::from(i.height) - i.cy);
        let squared = (from_centre.x / i.fx).powi(2) + (from_centre.y / i.fy).powi(2);
        (from_centre * (numbers[0] + numbers[3] * squared) + Vector2::new(numbers[1], numbers[2])).norm()
    });
    displaced.into_iter().fold(0.0, f64::max)
}

#[cfg(test)]
#[path = "model_study_tests.rs"]
mod tests;
