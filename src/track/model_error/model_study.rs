//! Which part of the model frames speak against: small models are fitted to what many of them leave displaced, and compared.
//!
//! A wrong lens, a surface that stands elsewhere, a stretched print and cloth in folds each leave a pattern in the tiles. In one frame the patterns
//! resemble each other, and the pose takes a share of each. Over the frames of a camera that moves they part: a fold stays on the cloth, a lens
//! stays on the sensor. So the equations of all these unknowns together are summed up over frames, each with a pose of its own that is free (and with a motion
//! while rows are read, where nobody described the shutter). Then each part alone is solved for from them, and the likeliest is named: the logarithm of what it leaves,
//! against the count of its numbers (Schwarz's criterion). Where it leaves much, the next part joins it.

use std::ops::Range;

use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Matrix2xX, OMatrix, SMatrix, SVector, U12, Vector2};

use super::focal_clue::RowDisplacement;
use super::misfit::{Misfit, Part};
use super::model_unknowns::{ModelUnknowns, moved_by_corners};
use super::tile_residuals::{MIN_MISFIT, TileResidual, TileResiduals};
use crate::camera::CameraModel;
use crate::geometry::robust_kernel::tukey_weight;
use crate::geometry::{Body, Camera, Pose};
use crate::track::patches::fitted_anchor::FittedAnchor;
use crate::track::scene::reference::PreparedBody;
use crate::track::scene::surface::SurfaceSpec;

/// Nuisances of a frame: its pose, and the motion while its rows were read.
const NUISANCES: usize = 12;
/// Tiles count by Tukey's biweight at so many times the median of their own surface: those of a surface that stands elsewhere are no outliers. Raised, people
/// and shadows count; lowered, the ends of a pattern do not.
const SPREAD: f64 = 2.0;
/// Median of the length of a plane vector of unit normal noise: sqrt(2 ln 2).
const MEDIAN_LENGTH: f64 = 1.177_410_022_515_474_6;
/// Frames that differ, of however many: the count of tiles grows with their square root. Chosen, not tuned: a camera that is walked past shows each place from here
/// and there. Raised, finer folds are believed of a camera that stands; lowered, those that a walk shows are not.
const FRAMES_THAT_DIFFER: f64 = 16.0;
/// By how much the criterion must fall for a part to be named (each number costs the logarithm of the count of tiles), and which share of all squared
/// displacements it must explain, the first part and each later one. Chosen, not tuned. Raised, fewer parts are named; lowered, parts that only
/// resemble the true one.
const MIN_GAIN: f64 = 30.0;
const MIN_SHARE: [f64; 2] = [0.4, 0.1];
/// And what is left must fall to this share by each later part. Raised, parts are named that only resemble what the first one leaves.
const LATER_LEAVES: f64 = 0.5;
/// A place is named as another surface's only where that leaves this share less: of two surfaces, either may have moved. Lowered, the first surface, which
/// is the stage's frame, is more often said to stand elsewhere.
const FIRST_LEAVES: f64 = 0.8;
/// Parts that are named at most. Chosen: more are hardly mended one by one.
const MAX_PARTS: usize = 3;
/// What a part must cost to be named: how far poses are off for it, as a share of the camera's distance, and for a place how far the surface is from where it should be. A
/// pixel is a thousandth at a focal length of 1000 pixels, so that this is half of one in what follows the camera. Chosen: nobody sees less, and nobody should walk the stage for it.
/// Raised, faults go unnamed; lowered, stages that are as told to the millimetre are to be surveyed.
pub const MIN_COST: f64 = 0.0005;
/// Points along each side at which a shape's heights are asked. Any dozen would do.
const ASKED: u32 = 24;

/// A frame as it is studied.
#[derive(Clone, Copy)]
pub struct StudiedFrame<'a> {
    /// What the pose leaves of the anchors' displacements.
    pub residuals: &'a TileResiduals,
    /// `T_camera_body` that they are of.
    pub pose: &'a Pose<Camera, Body>,
    /// Where the frame shows the body.
    pub anchors: &'a [FittedAnchor],
    /// How a motion while rows are read displaces them.
    pub rows: &'a RowDisplacement,
}

/// Sums up what frames show of one body.
#[derive(Debug)]
pub struct ModelStudy {
    unknowns: ModelUnknowns,
    /// Equations of the unknowns, each frame's nuisances eliminated.
    normal: DMatrix<f64>,
    right: DVector<f64>,
    /// Squared displacements that the poses leave, in sigmas of noise, and how many numbers they are beyond the poses'.
    squared: f64,
    numbers: f64,
    /// Squared displacements that the poses alone leave, without any motion while rows were read.
    squared_by_poses: f64,
    frames: f64,
    /// Sum of the tiles' information, of both their directions, pixels⁻².
    information: f64,
    /// How far the camera's place goes astray with the unknowns, as a share of its distance: squares, summed up over frames. And the sum of the distances, metres.
    strayed: DMatrix<f64>,
    distances_m: f64,
    shared: OMatrix<f64, U12, Dyn>,
    row: Matrix2xX<f64>,
    squares: Vec<f64>,
}

/// A set of parts, solved for.
struct Solved {
    columns: Vec<usize>,
    numbers: DVector<f64>,
    left: f64,
    /// Numbers that the frames decide, not the prior.
    freedom: f64,
}

impl ModelStudy {
    /// Of a body with so many surfaces; `most_waves`: how fine their folds may be, half waves over the picture.
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
            strayed: DMatrix::zeros(n, n),
            distances_m: 0.0,
            shared: OMatrix::<f64, U12, Dyn>::zeros(n),
            row: unknowns.row(),
            squares: Vec::new(),
            unknowns,
        }
    }

    /// Lets earlier frames count less, to this share.
    pub fn forget(&mut self, share: f64) {
        self.normal *= share;
        self.right *= share;
        self.strayed *= share;
        let Self { squared, numbers, squared_by_poses, frames, information, distances_m, .. } = self;
        for sum in [squared, numbers, squared_by_poses, frames, information, distances_m] {
            *sum *= share;
        }
    }

    /// Takes a frame.
    pub fn add(&mut self, frame: &StudiedFrame, body: &PreparedBody) {
        let StudiedFrame { residuals, pose, anchors, rows } = *frame;
        let scales: Vec<f64> = (0..body.surfaces.len()).map(|k| self.scale_of(k, residuals, anchors)).collect();
        let Self { unknowns, normal, right, shared, row, strayed, .. } = self;
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
        strayed.gemm_tr(1.0, &shifts, &shifts, 1.0);
        let pose_right = own_right.fixed_rows::<6>(0).into_owned();
        let by_pose = own.fixed_view::<6, 6>(0, 0).into_owned().cholesky();
        self.squared_by_poses += squared - by_pose.map_or(0.0, |factor| pose_right.dot(&factor.solve(&pose_right)));
        self.squared += squared - own_right.dot(&factor.solve(&own_right));
        self.numbers += 2.0 * weights - 6.0;
        self.frames += 1.0;
        self.information += all_information;
        self.distances_m += distance_m;
    }

    /// The scale of a surface's tiles, sigmas of noise, times [`SPREAD`].
    fn scale_of(&mut self, surface: usize, residuals: &TileResiduals, anchors: &[FittedAnchor]) -> f64 {
        self.squares.clear();
        let own = residuals.tiles().iter().filter(|t| anchors[t.anchor].surface as usize == surface);
        self.squares.extend(own.map(|t| residuals.squared_left(t)));
        if self.squares.is_empty() {
            return SPREAD;
        }
        let middle = self.squares.len() / 2;
        let median = *self.squares.select_nth_unstable_by(middle, f64::total_cmp).1;
        SPREAD * (median.sqrt() / MEDIAN_LENGTH).max(1.0)
    }

    /// Root mean square of what the poses, and motions while rows were read, leave of the tiles' displacements, pixels, each tile counting by its information.
    pub fn left_px(&self) -> f64 {
        if self.information > 0.0 { (2.0 * self.squared / self.information).sqrt() } else { 0.0 }
    }

    /// Share of what poses alone leave that motions while rows were read leave, too, beyond the noise. What of it is gone needs no error of the model.
    pub fn share_left(&self) -> f64 {
        let excess = |squared: f64| (squared - self.numbers).max(0.0);
        (excess(self.squared) / excess(self.squared_by_poses).max(f64::MIN_POSITIVE)).min(1.0)
    }

    /// How far poses are off where some unknowns are other than told, root mean square over the frames, as a share of the distance.
    fn cost(&self, columns: &[usize], numbers: &[f64]) -> f64 {
        let pairs = columns.iter().zip(numbers);
        let squared: f64 = pairs.clone().map(|(i, x)| x * pairs.clone().map(|(k, y)| self.strayed[(*i, *k)] * y).sum::<f64>()).sum();
        (squared.max(0.0) / self.frames.max(1.0)).sqrt()
    }

    /// Mean distance from the camera, metres.
    fn distance_m(&self) -> f64 {
        self.distances_m / self.frames.max(1.0)
    }

    /// What the poses leave, squared, over the noise; 0 where nothing was taken.
    pub fn misfit(&self) -> f64 {
        if self.numbers > 0.0 { self.squared / self.numbers } else { 0.0 }
    }

    /// The parts that frames speak against, the likeliest first; none where all fits, or where two parts explain them alike.
    pub fn misfits(&self, body: &PreparedBody, camera: &CameraModel) -> Vec<Misfit> {
        let mut named: Vec<(Candidate, Solved)> = Vec::new();
        if self.frames < 1.0 || self.misfit() < MIN_MISFIT {
            return Vec::new();
        }
        let mut before = Solved { columns: Vec::new(), numbers: DVector::zeros(0), left: self.squared, freedom: 0.0 };
        let all = self.candidates(body);
        while named.len() < MAX_PARTS {
            let rest = all.iter().filter(|c| named.iter().all(|(n, _)| !n.is_alike(c)));
            let Some((candidate, solved)) = self.likeliest(rest, &before) else { break };
            let rivals = all.iter().filter(|c| named.is_empty() && !c.is_alike(&candidate));
            if let Some((_, rival)) = self.likeliest(rivals, &before)
                && self.criterion(&rival) - self.criterion(&solved) < MIN_GAIN
            {
                break;
            }
            let gain = self.criterion(&before) - self.criterion(&solved);
            let share = (before.left - solved.left) / self.squared;
            let is_later = usize::from(!named.is_empty());
            tracing::debug!(?candidate, gain, share, left = solved.left / self.squared, "likeliest");
            let leaves = if named.is_empty() { 1.0 } else { LATER_LEAVES };
            if gain < MIN_GAIN || share < MIN_SHARE[is_later] || solved.left > leaves * before.left {
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
            let is_worth_a_word = cost.max(part.size_m(body) / self.distance_m()) >= MIN_COST;
            is_worth_a_word.then(|| Misfit { part, share, cost_mm: 1e3 * cost * self.distance_m() })
        };
        named.iter().filter_map(misfit).collect()
    }

    fn candidates(&self, body: &PreparedBody) -> Vec<Candidate> {
        let surfaces = body.surfaces.len();
        let mut all = vec![Candidate { kind: Kind::Lens, columns: self.unknowns.lens() }];
        for k in 0..surfaces {
            all.push(Candidate { kind: Kind::Ratio(k), columns: self.unknowns.ratio(k) });
            all.push(Candidate { kind: Kind::Corners(k), columns: self.unknowns.corners(k) });
            if surfaces > 1 {
                all.push(Candidate { kind: Kind::Place(k), columns: self.unknowns.place(k) });
            }
            all.extend(self.unknowns.heights(k).map(|columns| Candidate { kind: Kind::Shape(k), columns }));
        }
        all
    }

    /// Of some parts the one that is likeliest beside those that were named.
    fn likeliest<'a>(&self, candidates: impl Iterator<Item = &'a Candidate>, before: &Solved) -> Option<(Candidate, Solved)> {
        let solved = candidates.filter_map(|c| {
            let columns = before.columns.iter().copied().chain(c.columns.clone()).collect();
            let mut solved = self.solved(columns)?;
            if c.kind == Kind::Place(0) {
                solved.left /= FIRST_LEAVES;
            }
            Some((c.clone(), solved))
        });
        solved.min_by(|a, b| self.criterion(&a.1).total_cmp(&self.criterion(&b.1)))
    }

    /// Schwarz's criterion: tiles of many frames count no more than those of a few, for those of the next frame show much the same.
    fn criterion(&self, solved: &Solved) -> f64 {
        let count = self.numbers / self.frames * self.frames.clamp(1.0, FRAMES_THAT_DIFFER).sqrt();
        count * (solved.left / self.squared).max(f64::MIN_POSITIVE).ln() + solved.freedom * count.max(1.0).ln()
    }

    /// The numbers of some columns that leave least.
    fn solved(&self, columns: Vec<usize>) -> Option<Solved> {
        let n = columns.len();
        let data = DMatrix::from_fn(n, n, |i, k| self.normal[(columns[i], columns[k])]);
        let right = DVector::from_fn(n, |k, _| self.right[columns[k]]);
        // The prior counts as one frame's worth, at the scale of what is left.
        let scale = self.misfit().max(1.0);
        let prior = DVector::from_fn(n, |k, _| scale * self.unknowns.sigma(columns[k]).powi(-2));
        let factor = Cholesky::<f64, Dyn>::new(&data + DMatrix::from_diagonal(&prior))?;
        let numbers = factor.solve(&right);
        let left = self.squared - 2.0 * right.dot(&numbers) + numbers.dot(&(&data * &numbers));
        let freedom = factor.solve(&data).trace();
        (left.is_finite() && numbers.iter().all(|v| v.is_finite())).then(|| Solved { columns, numbers, left: left.max(0.0), freedom })
    }
}

/// Normal matrix of a frame's own nuisances before any tile.
pub fn nuisance_normal(rows: &RowDisplacement) -> SMatrix<f64, NUISANCES, NUISANCES> {
    let mut own = SMatrix::<f64, NUISANCES, NUISANCES>::zeros();
    own.fixed_view_mut::<6, 6>(6, 6).copy_from(rows.motion_information());
    own
}

/// Derivatives of a tile's shift by the frame's own nuisances.
pub fn nuisances(t: &TileResidual, rows: &RowDisplacement) -> SMatrix<f64, 2, NUISANCES> {
    let mut by = SMatrix::<f64, 2, NUISANCES>::zeros();
    by.fixed_columns_mut::<6>(0).copy_from(&t.by_pose);
    if !rows.is_described() {
        by.fixed_columns_mut::<6>(6).copy_from(&(t.by_pose * rows.delay_s(t)));
    }
    by
}

/// Which part a candidate is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Lens,
    Ratio(usize),
    Corners(usize),
    Place(usize),
    Shape(usize),
}

/// A part that may be other than told.
#[derive(Debug, Clone, PartialEq)]
struct Candidate {
    kind: Kind,
    columns: Range<usize>,
}

impl Candidate {
    /// Whether both have numbers of the same kind. The ratio of a surface's sides is one of the numbers of its corners.
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
                let turn = SVector::<f64, 3>::new(numbers[3], numbers[4], numbers[5]);
                Part::Place { surface, moved_mm: [0, 1, 2].map(|k| 1e3 * numbers[k]), turned_deg: turn.norm().to_degrees() }
            }
            Kind::Shape(surface) => {
                let spec = &body.surfaces[surface].spec;
                let along = |k: u32, side: f64| ((f64::from(k) + 0.5) / f64::from(ASKED) - 0.5) * side;
                let places =
                    (0..ASKED).flat_map(|i| (0..ASKED).map(move |j| Vector2::new(along(i, spec.size_m[0]), along(j, spec.size_m[1]))));
                let heights = places.map(|at| unknowns.height_m(spec, numbers, at));
                let (squared, most) = heights.fold((0.0, 0.0_f64), |(sum, most), h| (sum + h * h, most.max(h.abs())));
                Part::Shape { surface, rms_mm: 1e3 * (squared / f64::from(ASKED * ASKED)).sqrt(), most_mm: 1e3 * most }
            }
        }
    }
}

/// How far the corner that is off most is off by the numbers of a surface's corners: pixels of its picture, as its file has it, and metres.
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

/// How far the lens' numbers displace the corner of the picture where they do most.
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
