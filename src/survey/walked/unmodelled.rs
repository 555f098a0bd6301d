//! Estimates the heights that a shape's spline cannot show: wrinkles narrower than its knots.
//!
//! They stay in the residuals. Noise differs from frame to frame, but a wrinkle moves the same
//! detail by the same height in all of them. So each surface is divided into cells much narrower
//! than the knots, and two halves of the keyframes each determine the mean height of every cell
//! above the spline, from its pixels. The noise of the halves is independent, so the mean product
//! of both heights is the variance of what they share, and no noise level enters it.
//!
//! A displacement within the surface is eliminated per cell and half: a flaw of the picture or of
//! the predicted light moves detail alike in all views, and is no height.

use std::collections::BTreeMap;

use nalgebra::{Matrix2x3, Matrix3, Vector2, Vector3};

use super::stage_model::{StageModel, bent};
use crate::geometry::bspline::BicubicSpline;
use crate::geometry::robust_kernel::median;
use crate::track::{ObservedPixels, PixelShift, SurfaceSpec};

/// Cells per knot interval, along each axis. Raised, few pixels are in each cell; lowered, cells
/// average narrow wrinkles away.
const CELLS_PER_INTERVAL: usize = 4;
/// Length of the narrowest wrinkle that a spline follows, in knot intervals: one interval up and
/// one down.
const INTERVALS_PER_WRINKLE: f64 = 2.0;

/// Returns the length of the narrowest wrinkle that a surface's spline follows, from crest to
/// crest, metres.
pub fn narrowest_wrinkle_m(surface: &SurfaceSpec) -> f64 {
    bent(surface).map_or(0.0, |shape| INTERVALS_PER_WRINKLE * shape.height.spacing().into_iter().fold(0.0, f64::max))
}

/// Sums over pixels of a cell: the normal equations of its displacement along the surface's axes.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    matrix: Matrix3<f64>,
    right: Vector3<f64>,
}

impl Sums {
    fn add(&mut self, other: &Self) {
        self.matrix += other.matrix;
        self.right += other.right;
    }

    /// Returns the height and its variance, in the units of the pixels' information. `None` if the
    /// views do not separate it from a displacement within the surface.
    fn height(&self) -> Option<[f64; 2]> {
        let factor = self.matrix.cholesky()?;
        let by_height = factor.solve(&Vector3::z());
        let found = [by_height.dot(&self.right), by_height.z];
        (found.iter().all(|v| v.is_finite()) && found[1] > 0.0).then_some(found)
    }
}

/// What a keyframe says about the cells of each surface that it shows.
#[derive(Debug, Clone, Default)]
pub struct FrameCells(BTreeMap<[usize; 2], Sums>);

impl FrameCells {
    /// Sums up a keyframe's pixels, whose displacements are relative to the model.
    pub fn of(frame: &ObservedPixels, model: &StageModel) -> Self {
        let mut cells = BTreeMap::<_, Sums>::new();
        for pixel in &frame.pixels {
            let surface = &model.surfaces[pixel.surface as usize];
            let (Some(shape), Some(by_place)) = (bent(surface), by_place(pixel, frame, surface, model)) else { continue };
            let sums = Sums { matrix: by_place.transpose() * pixel.information * by_place, right: by_place.transpose() * pixel.weighted };
            let cell = cell_of(&shape.height, pixel.on_surface_m);
            cells.entry([pixel.surface as usize, cell]).or_default().add(&sums);
        }
        Self(cells)
    }
}

/// Returns the index of the cell of a surface at a point.
fn cell_of(height: &BicubicSpline<1>, point: Vector2<f64>) -> usize {
    let (intervals, spacing) = (height.intervals(), height.spacing());
    let [column, row] = [0, 1].map(|axis| {
        let (cells, intervals) = (intervals[axis] * CELLS_PER_INTERVAL, intervals[axis] as f64);
        // A negative or invalid number becomes 0.
        let at = (point[axis] / spacing[axis] + 0.5 * intervals) * CELLS_PER_INTERVAL as f64;
        (at as usize).min(cells - 1)
    });
    row * intervals[0] * CELLS_PER_INTERVAL + column
}

/// Returns the derivative of a pixel by the position of its detail along the surface's axes; `None`
/// if it is behind the camera.
fn by_place(pixel: &PixelShift, frame: &ObservedPixels, surface: &SurfaceSpec, model: &StageModel) -> Option<Matrix2x3<f64>> {
    let to_camera = frame.motion.after(pixel.delay_s).pose.inverse();
    let place = surface.pose.transform(&surface.shape.at(pixel.on_surface_m.into()).place.into());
    let seen = to_camera.transform(&place).coords;
    if seen.z < 1e-6 {
        return None;
    }
    let (_, by_seen) = model.camera.project_point_with_jacobian(&seen);
    Some(by_seen * to_camera.rotation_matrix() * surface.pose.rotation_matrix())
}

/// Returns the root mean square height of each surface that its spline does not show, metres; 0
/// where the keyframes show none.
pub fn unmodelled_m<'a>(frames: impl IntoIterator<Item = &'a FrameCells>, surfaces: usize) -> Vec<f64> {
    let mut halves = [BTreeMap::<[usize; 2], Sums>::new(), BTreeMap::new()];
    for (k, FrameCells(cells)) in frames.into_iter().enumerate() {
        cells.iter().for_each(|(cell, sums)| halves[k % 2].entry(*cell).or_default().add(sums));
    }
    let [first, second] = halves;
    let mut heights = vec![Vec::new(); surfaces];
    for (cell, sums) in first {
        if let (Some(a), Some(b)) = (sums.height(), second.get(&cell).and_then(Sums::height)) {
            heights[cell[0]].push([a, b]);
        }
    }
    heights.iter().map(|cells| shared_variance(cells).max(0.0).sqrt()).collect()
}

/// Returns the variance that both halves' heights share. Each cell has the height and its variance
/// by either half; cells whose variance is small compared with the usual one count alike.
fn shared_variance(cells: &[[[f64; 2]; 2]]) -> f64 {
    let variance = |[[_, a], [_, b]]: &[[f64; 2]; 2]| (a * b).sqrt();
    let Some(usual) = median(&mut cells.iter().map(variance).collect::<Vec<_>>()) else { return 0.0 };
    let (mut sum, mut weights) = (0.0, 0.0);
    for [[a, a_variance], [b, b_variance]] in cells {
        let weight = 1.0 / ((usual + a_variance) * (usual + b_variance));
        sum += weight * a * b;
        weights += weight;
    }
    sum / weights
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;
    use std::sync::Arc;

    use nalgebra::{DMatrix, DVector, Matrix2, Vector1};

    use super::*;
    use crate::camera::CameraModel;
    use crate::motion::Motion;
    use crate::survey::walked::dense_system::Factor;
    use crate::survey::walked::normal_equations::{FrameRows, NormalEquations};
    use crate::survey::walked::prior::{self, Smoothness};
    use crate::survey::walked::stage_model::LENS_NUMBERS;
    use crate::survey::walked::synthetic::{LENS, camera_poses, observed_on, stage};
    use crate::track::{BentShape, ObservedFrame, SurfaceShape};

    /// Wave numbers of folds across and up the backdrop, per metre: whole ones, so that the mean
    /// plane stays, and the cameras with it.
    const FOLDS: [f64; 2] = [2.0 * TAU / 4.0, TAU / 3.0];
    /// Noise of a tile, one sigma along each axis, pixels.
    const NOISE_PX: f64 = 0.05;
    /// Tiles across and down: several in each cell in the whole walk.
    const TILES: [i32; 2] = [60, 45];

    /// Returns the stage whose backdrop has these heights on a grid with this number of intervals
    /// per interval of a survey.
    fn stage_with(finer: usize, height: impl Fn([f64; 2]) -> f64) -> StageModel {
        let mut model = StageModel::new(CameraModel::new(LENS).unwrap(), &stage(), false, false);
        let shape = model.shape(0).unwrap().clone();
        let mut field = BicubicSpline::<1>::zero(shape.height.intervals().map(|n| n * finer), model.surfaces[0].size_m);
        let middles = field.middles();
        field.coefficients_mut().iter_mut().enumerate().for_each(|(n, c)| *c = Vector1::new(height(middles(n))));
        model.surfaces[0].shape = SurfaceShape::Bent(Arc::new(BentShape { height: field, ..shape }));
        model
    }

    /// Surveys a stage; returns the model, its covariance, and what the frames show beside it.
    fn surveyed(truth: &StageModel, noise_px: f64) -> (StageModel, DMatrix<f64>, Vec<ObservedFrame>) {
        let motions: Vec<Motion> = camera_poses(24).into_iter().map(Motion::still).collect();
        let mut model = stage_with(1, |_| 0.0);
        let mut covariance = DMatrix::zeros(0, 0);
        for _ in 0..2 {
            let frames = observed_on(TILES, truth, &model, &motions, noise_px, 7);
            let rows: Vec<FrameRows> = frames.iter().map(|f| FrameRows::new(f, &model, 3.0, |_| false)).collect();
            // The large scale keeps all tiles in; undo its effect on the information.
            let mut equations = NormalEquations::new(&rows, model.places().count, &[1e3; 2], true).unwrap();
            equations.matrix *= 1e6;
            equations.right *= 1e6;
            let (matrix, right) = (&mut equations.matrix, &mut equations.right);
            prior::add(&model, &Smoothness::even(2, 3.0), &[1.0; LENS_NUMBERS], 1e-6, &[], matrix, right);
            let factor = Factor::of(&equations.matrix).unwrap();
            model = model.stepped(&factor.solve(&equations.right)).unwrap();
            covariance = factor.inverse();
        }
        // The same noise as the model was fitted to, as in a survey.
        let frames = observed_on(TILES, truth, &model, &motions, noise_px, 7);
        (model, covariance, frames)
    }

    /// Returns the frames as pixels: each tile shows its displacement along one direction only.
    fn cells(frames: &[ObservedFrame], model: &StageModel) -> Vec<FrameCells> {
        let of_frame = |frame: &ObservedFrame| {
            let pixels = frame.tiles.iter().map(|tile| {
                let along = Vector2::new((1.7 * f64::from(tile.number)).cos(), (1.7 * f64::from(tile.number)).sin());
                let information: Matrix2<f64> = along * along.transpose() * tile.information[(0, 0)];
                PixelShift {
                    surface: tile.surface as u32,
                    on_surface_m: tile.on_picture_m.into(),
                    information,
                    weighted: information * tile.shift_px,
                    delay_s: tile.delay_s,
                }
            });
            FrameCells::of(&ObservedPixels { motion: frame.motion, pixels: pixels.collect() }, model)
        };
        frames.iter().map(of_frame).collect()
    }

    /// The backdrop as surveyed, millimetres, where the walk sees it well.
    #[derive(Debug)]
    struct Compared {
        /// Root mean square error of its heights.
        error: f64,
        /// One sigma of the spline.
        of_spline: f64,
        /// The same with what the spline does not show.
        sigma: f64,
        /// What the splines of the flat, which is flat, do not show.
        of_flat: f64,
    }

    fn compared(truth: &StageModel, noise_px: f64) -> Compared {
        let (model, covariance, frames) = surveyed(truth, noise_px);
        let unmodelled = unmodelled_m(&cells(&frames, &model), 2);
        let shapes = [truth, &model].map(|model| &model.shape(0).unwrap().height);
        let points: Vec<[f64; 2]> =
            (-70..=70).flat_map(|i| (-50..=50).map(move |j| [0.0213 * f64::from(i), 0.0213 * f64::from(j)])).collect();
        let off: Vec<f64> = points.iter().map(|point| shapes[1].at(*point).value.x - shapes[0].at(*point).value.x).collect();
        let mean = off.iter().sum::<f64>() / off.len() as f64;
        let error = (off.iter().map(|off| (off - mean).powi(2)).sum::<f64>() / off.len() as f64).sqrt();
        let variance = |point: &[f64; 2]| {
            let mut weights = DVector::zeros(covariance.nrows());
            shapes[1].support(*point).weights().into_iter().for_each(|(n, w)| weights[model.places().heights[0] + n] += w);
            weights.dot(&(&covariance * &weights))
        };
        let some: Vec<f64> = points.iter().step_by(97).map(variance).collect();
        let of_spline = (some.iter().sum::<f64>() / some.len() as f64).sqrt();
        let [error, of_spline, sigma, of_flat] =
            [error, of_spline, of_spline.hypot(unmodelled[0]), unmodelled[1]].map(|metres| 1e3 * metres);
        Compared { error, of_spline, sigma, of_flat }
    }

    #[test]
    fn the_sigma_of_heights_contains_wrinkles_that_the_spline_cannot_show() {
        // Wrinkles on folds of a centimetre, narrower than the spline's narrowest of 0.31 m.
        for (length_m, noise_px) in [(0.2, NOISE_PX), (0.15, NOISE_PX), (0.2, 4.0 * NOISE_PX)] {
            let across = TAU / length_m;
            let wrinkled = stage_with(6, |[x, y]| 0.01 * (FOLDS[0] * x).cos() + 1.8e-3 * (across * (0.9 * x + 0.43 * y)).sin());
            let found = compared(&wrinkled, noise_px);
            println!("{length_m} m, {noise_px} px: {found:?}");
            assert!(found.error > 0.8 && found.of_spline < 0.3 * found.error, "{length_m} m: {found:?}");
            assert!((found.error / 1.5..1.5 * found.error).contains(&found.sigma), "{length_m} m: {found:?}");
            // The wrinkles are the backdrop's alone.
            assert!(found.of_flat < 0.1 * found.error, "{length_m} m: {found:?}");
        }
    }

    #[test]
    fn a_surface_that_the_spline_shows_keeps_its_sigma() {
        for (fold_m, noise_px) in [(0.0, NOISE_PX), (0.01, NOISE_PX), (0.01, 4.0 * NOISE_PX)] {
            let found = compared(&stage_with(1, |[x, y]| fold_m * (FOLDS[0] * x).cos() * (FOLDS[1] * y).cos()), noise_px);
            println!("{fold_m} m, {noise_px} px: {found:?}");
            assert!(found.sigma < 1.1 * found.of_spline, "{fold_m} m: {found:?}");
            assert!(found.error < 2.0 * found.sigma, "{fold_m} m: {found:?}");
        }
    }

    #[test]
    fn a_displacement_within_the_surface_is_no_height() {
        // A flaw of the picture: detail lies two millimetres beside where the artwork has it.
        let model = stage_with(1, |_| 0.0);
        let motions: Vec<Motion> = camera_poses(24).into_iter().map(Motion::still).collect();
        let mut flawed = model.clone();
        let mut shape = flawed.shape(0).unwrap().clone();
        shape.stretch = BicubicSpline::zero([100, 75], [4.0, 3.0]);
        let flaw = |n: usize| Vector2::new((1.3 * n as f64).sin(), (2.1 * n as f64).cos()) * 2e-3;
        shape.stretch.coefficients_mut().iter_mut().enumerate().for_each(|(n, c)| *c = flaw(n));
        flawed.surfaces[0].shape = SurfaceShape::Bent(Arc::new(shape));
        let frames = observed_on(TILES, &flawed, &model, &motions, NOISE_PX, 9);
        let found_mm = 1e3 * unmodelled_m(&cells(&frames, &model), 2)[0];
        assert!(found_mm < 0.2, "{found_mm}");
    }

    #[test]
    fn surfaces_that_no_keyframe_shows_add_nothing() {
        let model = stage_with(1, |_| 0.0);
        assert_eq!(unmodelled_m(&[], 2), [0.0; 2]);
        assert_eq!(unmodelled_m(&[FrameCells::default(), FrameCells::default()], 2), [0.0; 2]);
        // Of a single view, heights and displacements within the surface cannot be separated.
        let motions = vec![Motion::still(camera_poses(3)[1]); 2];
        let frames = observed_on(TILES, &model, &model, &motions, NOISE_PX, 9);
        assert!(unmodelled_m(&cells(&frames, &model), 2).iter().all(|metres| metres.is_finite()));
    }

    #[test]
    fn the_narrowest_wrinkle_is_two_knot_intervals_long() {
        let surface = &stage_with(1, |_| 0.0).surfaces[0];
        assert!((narrowest_wrinkle_m(surface) - 2.0 * 4.0 / 26.0).abs() < 0.01, "{}", narrowest_wrinkle_m(surface));
    }
}
