//! Pose covariance from errors of the model, taken as one smooth field of shifts.
//!
//! Cloth hangs in folds, a print is stretched, a lens is slightly off: then the frame shows the
//! tiles where no pose puts them. The part of such an error that looks like another pose is
//! absorbed by the pose and invisible; the rest stays in the residuals. The error is therefore
//! modelled as a smooth field of shifts over the picture, a Gaussian process of fixed correlation
//! length. Its size follows from the residuals, and its effect on the pose follows from its size.
//! If the residuals are no more than noise, there is no field.
//!
//! This is the error of a pose that rests on its own frame alone. If few tiles are visible, a pose
//! rests on earlier frames instead and has their error: [`blended`] says how much of each.

use crate::track::model_error::tuning::TUNING;
use nalgebra::{Matrix2, Matrix2x6, Matrix6, Vector2, Vector6};

use super::smooth_field::SmoothField;
use super::tile_residuals::{TileResidual, TileResiduals};
use crate::geometry::covariance::covariance_of_inverse;
use crate::geometry::{Body, Camera, Pose};
use crate::simd::multiversion;

/// The part of the tiles' displacements that neither the pose nor the noise explains.
#[derive(Debug, Clone, Copy)]
pub struct ModelError {
    /// Covariance of [δp, δθ] of `T_body_camera`, body axes, per squared pixel of a smooth field of
    /// shifts.
    by_field: Matrix6<f64>,
    /// Variance of the field as estimated from neighbouring tiles, pixels²; below 0 by chance.
    by_pairs_px2: f64,
    /// Lower bound of that variance, because the residuals are too large for noise.
    at_least_px2: f64,
    /// The variance if all of the residual were such a field.
    at_most_px2: f64,
    /// Variance of the independent errors of the tiles, in variances of their noise; at least 1.
    pub noise: f64,
}

impl ModelError {
    /// Returns the covariance of [δp, δθ] of `T_body_camera`, body axes, for a field of the size
    /// that this frame shows.
    pub fn covariance(&self) -> Matrix6<f64> {
        self.covariance_of(self.by_pairs_px2)
    }

    /// Returns the same if all of the residual were such a field.
    pub fn at_most(&self) -> Matrix6<f64> {
        self.by_field * self.at_most_px2
    }

    fn covariance_of(&self, by_pairs_px2: f64) -> Matrix6<f64> {
        self.by_field * by_pairs_px2.max(self.at_least_px2).max(0.0)
    }
}

/// The size of a body's field, averaged over its recent frames from neighbouring tiles.
#[derive(Debug, Clone, Copy, Default)]
pub struct FieldSize {
    /// Mean over the frames, and mean of the squares.
    by_pairs_px2: f64,
    by_pairs_squared: f64,
    frames: f64,
}

impl FieldSize {
    /// Adds a frame and returns the covariance that the field causes in its pose: [δp, δθ] of
    /// `T_body_camera`, body axes.
    pub fn take(&mut self, error: &ModelError) -> Matrix6<f64> {
        self.frames = (self.frames + 1.0).min(TUNING.field_memory_frames);
        self.by_pairs_px2 += (error.by_pairs_px2 - self.by_pairs_px2) / self.frames;
        self.by_pairs_squared += (error.by_pairs_px2.powi(2) - self.by_pairs_squared) / self.frames;
        error.covariance_of(self.by_pairs_px2 - TUNING.field_standard_errors * self.standard_error())
    }

    /// Returns the standard error of the mean; 0 after a single frame.
    fn standard_error(&self) -> f64 {
        let variance = (self.by_pairs_squared - self.by_pairs_px2.powi(2)).max(0.0);
        if self.frames > 1.0 { (variance / (self.frames - 1.0)).sqrt() } else { 0.0 }
    }
}

/// Work buffers of the model error of one body.
#[derive(Debug, Default)]
pub struct ModelErrorBuffers {
    field: SmoothField,
    paired: Vec<PairedTile>,
}

impl ModelErrorBuffers {
    /// Creates buffers that hold this many tiles without growing.
    pub fn with_capacity(tiles: usize) -> Self {
        Self { field: SmoothField::with_capacity(tiles), paired: Vec::with_capacity(tiles) }
    }
}

/// Estimates the model error of a pose; `None` if the residuals are within the noise. `pose`:
/// `T_camera_body`; `width_px`: width in the frame of what may be off.
///
/// The residuals have two sources: a field of variance a², and noise of b times the stated
/// variance, as from webcams that sharpen and smooth their pictures. The sum of squares contains
/// both; in the products of neighbours a field keeps nearly all of its size and noise almost none.
/// These are two linear equations for a² and b, and b is bounded. The noise is in the pose's
/// covariance already, through the scatter of the tiles: only the field is to be added.
pub fn model_error(
    pose: &Pose<Camera, Body>,
    width_px: f64,
    residuals: &TileResiduals,
    buffers: &mut ModelErrorBuffers,
) -> Option<ModelError> {
    let ModelErrorBuffers { field, paired } = buffers;
    let freedom = 2.0 * residuals.weight() - 6.0;
    let factor = residuals.normal().cholesky()?;
    let change = factor.solve(&residuals.right_side());
    let squared: f64 = residuals.tiles().iter().map(|t| t.squared_left_by_pose(&change)).sum();
    if freedom < TUNING.min_field_freedom || squared <= freedom {
        return None;
    }
    let normal_inverse = factor.inverse();
    field.work_out(residuals.tiles(), &factor, TUNING.field_correlation_length * width_px);
    paired.clear();
    paired.extend(residuals.tiles().iter().map(|tile| PairedTile::alone(tile, &change)));
    add_neighbours(paired, width_px);
    let PairSums { left, pairs, pairs_by_field, pairs_by_noise } = sum_pairs(paired, field, &normal_inverse);
    // squared = freedom b + left a², pairs = pairs_by_noise b + pairs_by_field a².
    let determinant = freedom * pairs_by_field - pairs_by_noise * left;
    let of_both = (freedom * pairs - pairs_by_noise * squared) / determinant;
    let of_field_alone = (squared - freedom) / left;
    // By chance as far below 0 as above; cut off at 0, the mean of several frames would be biased.
    let most = of_field_alone.max(0.0);
    let by_pairs_px2 = if determinant > 0.0 { of_both.clamp(-most, most) } else { most };
    let at_least_px2 = TUNING.unknown_length_variance_factor * (squared - TUNING.max_independent_variance * freedom) / left;
    let noise = ((squared - left * by_pairs_px2.max(at_least_px2).max(0.0)) / freedom).max(1.0);
    let by_field = covariance_of_inverse(pose, field.of_pose());
    let error = ModelError { by_field, by_pairs_px2, at_least_px2, at_most_px2: of_field_alone, noise };
    (left > 0.0 && by_pairs_px2.is_finite() && error.covariance().iter().all(|v| v.is_finite())).then_some(error)
}

/// Sums of squares of the residuals and of products of neighbours.
#[derive(Debug, Default)]
struct PairSums {
    /// Contribution of a field of one pixel to the squares.
    left: f64,
    /// Products of neighbouring residuals.
    pairs: f64,
    /// Contribution of a field of one pixel to these products.
    pairs_by_field: f64,
    /// Contribution of the noise to them, which arises because one pose is subtracted from all
    /// tiles.
    pairs_by_noise: f64,
}

/// Sums over all tiles and all pairs of neighbours. `normal_inverse`: inverse of the pose's normal
/// matrix.
fn sum_pairs(paired: &[PairedTile], field: &SmoothField, normal_inverse: &Matrix6<f64>) -> PairSums {
    let (mut sums, mut both) = (PairSums::default(), Matrix6::zeros());
    for (k, PairedTile { own, beside, .. }) in paired.iter().enumerate() {
        let together = field.pose_with_shift(k);
        // A tile's own square, less what the pose absorbs of it.
        sums.left += own.information.trace() - (own.by_pose * together).trace();
        sums.pairs += own.shift.dot(&beside.shift);
        sums.pairs_by_noise -= (beside.by_pose * normal_inverse * own.by_pose.transpose()).trace();
        sums.pairs_by_field += (own.information * (beside.information - beside.by_pose * together * 2.0)).trace();
        both += own.by_pose.transpose() * beside.by_pose;
    }
    sums.pairs_by_field += (both * field.of_pose()).trace();
    sums
}

/// A tile and the sums over its neighbours, weighted by proximity.
#[derive(Debug)]
struct PairedTile {
    place_px: Vector2<f64>,
    own: Weighted,
    beside: Weighted,
}

/// The summands of tiles.
#[derive(Debug, Default)]
struct Weighted {
    /// Information times the residual at the solved pose.
    shift: Vector2<f64>,
    /// Information times the derivative by the pose.
    by_pose: Matrix2x6<f64>,
    /// Information; in sums also weighted by the field's correlation.
    information: Matrix2<f64>,
}

impl PairedTile {
    /// Creates a tile without neighbours. `change`: the change of the pose that best explains all
    /// tiles.
    fn alone(tile: &TileResidual, change: &Vector6<f64>) -> Self {
        let own = Weighted {
            shift: tile.information * tile.left_by_pose(change),
            by_pose: tile.information * tile.by_pose,
            information: tile.information,
        };
        Self { place_px: tile.place_px, own, beside: Weighted::default() }
    }
}

impl Weighted {
    #[inline(always)]
    fn add(&mut self, other: &Self, weight: f64, alike: f64) {
        self.shift += other.shift * weight;
        self.by_pose += other.by_pose * weight;
        self.information += other.information * (weight * alike);
    }
}

multiversion! {
    /// Adds each of two neighbouring tiles to the other's sums. `width_px`: width of what may be
    /// off.
    fn add_neighbours(paired: &mut [PairedTile], width_px: f64); ["avx2"] => add_neighbours_plain, else add_neighbours_plain
}

#[inline(always)]
fn add_neighbours_plain(paired: &mut [PairedTile], width_px: f64) {
    let per_squared_length = -0.5 / (TUNING.field_correlation_length * width_px).powi(2);
    let farthest = TUNING.min_pair_weight.ln() / (per_squared_length * f64::from(TUNING.pair_weight_power));
    let beside_px2 = (TUNING.min_pair_distance * width_px).powi(2)..farthest;
    for k in 1..paired.len() {
        let (before, rest) = paired.split_at_mut(k);
        let tile = &mut rest[0];
        for other in before {
            let squared_length = (other.place_px - tile.place_px).norm_squared();
            if beside_px2.contains(&squared_length) {
                let alike = (squared_length * per_squared_length).exp();
                let weight = alike.powi(TUNING.pair_weight_power);
                tile.beside.add(&other.own, weight, alike);
                other.beside.add(&tile.own, weight, alike);
            }
        }
    }
}

/// Returns the covariance of [δp, δθ] of `T_body_camera`, body axes, from the model error of a pose
/// that rests on its own frame and on earlier ones.
///
/// In directions where the frame contributes the fraction g of the pose's information, the error is
/// g times that of the frame alone plus 1 - g times that of the earlier frames. A misfit persists
/// from frame to frame, so the two add linearly, not in squares.
///
/// `noise`: covariance of the pose from noise, including its prior, body axes. `of_frame`:
/// covariance from the model error of a pose from this frame alone ([`model_error`]). `before`: the
/// same of the earlier frames.
pub fn blended(
    pose: &Pose<Camera, Body>,
    residuals: &TileResiduals,
    noise: &Matrix6<f64>,
    of_frame: &Matrix6<f64>,
    before: &Matrix6<f64>,
) -> Option<Matrix6<f64>> {
    let none = Matrix6::zeros();
    if *of_frame == none && *before == none {
        return Some(none);
    }
    // In these axes the noise of the frame alone is one unit in each direction; they are rotated so
    // that nothing in them is correlated.
    let root = residuals.normal().cholesky()?.l();
    let mut rotation = Matrix6::zeros();
    rotation.fixed_view_mut::<3, 3>(0, 0).copy_from(&pose.rotation_matrix());
    rotation.fixed_view_mut::<3, 3>(3, 3).copy_from(&pose.rotation_matrix());
    let in_camera = |covariance: &Matrix6<f64>| rotation * covariance * rotation.transpose();
    let axes = (root.transpose() * in_camera(noise) * root).symmetric_eigen();
    let shares = axes.eigenvalues.map(|known| known.clamp(0.0, 1.0));
    let to_axes = axes.eigenvectors.transpose() * root.transpose();
    let from_axes = to_axes.try_inverse()?;
    let scaled = |covariance: &Matrix6<f64>, by: &dyn Fn(f64) -> f64| {
        let by = Matrix6::from_diagonal(&shares.map(by));
        by * to_axes * in_camera(covariance) * to_axes.transpose() * by
    };
    let (own, others) = (scaled(of_frame, &|share| share), scaled(before, &|share| 1.0 - share));
    let independent = own + others;
    let sigma = |covariance: &Matrix6<f64>, k: usize| covariance[(k, k)].max(0.0).sqrt();
    let grow = Vector6::from_fn(|k, _| {
        let all = sigma(&independent, k);
        if all > 0.0 { (sigma(&own, k) + sigma(&others, k)) / all } else { 1.0 }
    });
    let together = independent.component_mul(&(grow * grow.transpose()));
    let covariance = covariance_of_inverse(pose, &(from_axes * together * from_axes.transpose()));
    covariance.iter().all(|v| v.is_finite()).then_some(covariance)
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector, Vector3};
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::geometry::resection::{MovingCamera, Observation, resect};
    use crate::track::synthetic::{cloth, facing, lens, prepared, seen_anchors};

    const NOISE_PX: f64 = 0.02;
    const WIDTH: u32 = 640;
    const RUNS: usize = 200;

    fn normal(random: &mut Pcg64Mcg) -> f64 {
        (0..12).map(|_| random.random_range(-0.5..0.5)).sum()
    }

    /// Result of the runs.
    struct Found {
        /// Mean of NEES / 6.
        nees: f64,
        /// Number of frames, of 200, in which a model error was found.
        off: usize,
        /// Mean variance of the tiles' noise, in units of the stated one.
        noise: f64,
        /// Mean sigma of the rotation from the field, radians.
        rotation: f64,
    }

    /// Runs frames whose tiles are displaced by a smooth field of `field_px` and `length_px`, plus
    /// noise that is `noisier` times as large as stated.
    fn found(field_px: f64, length_px: f64, noisier: f64) -> Found {
        let (body, camera, pose) = (prepared(vec![cloth(1)]), lens(WIDTH, 480), facing(0.1, -0.3, Vector3::new(0.4, 0.05, 5.0)));
        let places: Vec<Vector2<f64>> =
            seen_anchors(&body, &pose, &camera, 9, |_, _| Vector2::zeros()).iter().map(|a| a.corrected_px).collect();
        let together = |i: usize, k: usize| {
            (-0.5 * (places[i] - places[k]).norm_squared() / length_px.powi(2)).exp() + if i == k { 1e-9 } else { 0.0 }
        };
        let factor = DMatrix::from_fn(places.len(), places.len(), together).cholesky().expect("positive definite").l();
        let mut random = Pcg64Mcg::seed_from_u64(3);
        let mut sums = Found { nees: 0.0, off: 0, noise: 0.0, rotation: 0.0 };
        for _ in 0..RUNS {
            let field: [DVector<f64>; 2] = [0, 1].map(|_| &factor * DVector::from_fn(places.len(), |_, _| field_px * normal(&mut random)));
            let shift = |k: u32, _| Vector2::from_fn(|axis, _| field[axis][k as usize] + noisier * NOISE_PX * normal(&mut random));
            let mut anchors = seen_anchors(&body, &pose, &camera, 9, shift);
            anchors.iter_mut().for_each(|a| a.observation.information /= NOISE_PX.powi(2));
            let observations: Vec<Observation> = anchors.iter().map(|a| a.observation).collect();
            let found = resect(&pose, &MovingCamera::still(&camera), &observations, 30).expect("a pose");
            let mut residuals = TileResiduals::default();
            residuals.take(&found.pose, &camera, &anchors).expect("tiles enough");
            let by_noise = covariance_of_inverse(&found.pose, &found.normal.try_inverse().expect("positive definite"));
            let error = model_error(&found.pose, f64::from(WIDTH), &residuals, &mut ModelErrorBuffers::default());
            let (covariance, noise) = error.map_or((Matrix6::zeros(), 1.0), |e| (e.covariance(), e.noise));
            let (truth, found) = (pose.inverse(), found.pose.inverse());
            let (moved, rotated) = (truth.translation - found.translation, (truth.rotation * found.rotation.inverse()).scaled_axis());
            let e = Vector6::new(moved.x, moved.y, moved.z, rotated.x, rotated.y, rotated.z);
            let squared = e.dot(&((by_noise * noise + covariance).try_inverse().expect("positive definite") * e));
            sums.nees += squared / 6.0 / RUNS as f64;
            sums.noise += noise / RUNS as f64;
            sums.rotation += covariance.fixed_view::<3, 3>(3, 3).trace().sqrt() / RUNS as f64;
            sums.off += usize::from(error.is_some());
        }
        sums
    }

    #[test]
    fn a_smooth_error_of_the_model_is_in_the_covariance() {
        let wide = found(0.5, TUNING.field_correlation_length * f64::from(WIDTH), 1.0);
        assert!((0.5..2.5).contains(&wide.nees) && wide.off == RUNS, "{}, {} of {RUNS}", wide.nees, wide.off);
        // Folds are shorter than the assumed field: their covariance is wider than their error.
        let folds = found(0.5, 0.1 * f64::from(WIDTH), 1.0);
        assert!((0.05..2.5).contains(&folds.nees) && folds.off == RUNS, "{}, {} of {RUNS}", folds.nees, folds.off);
    }

    #[test]
    fn an_error_field_too_large_for_noise_counts_at_once() {
        let of = |by_pairs_px2: f64, at_least_px2: f64| ModelError {
            by_field: Matrix6::identity(),
            by_pairs_px2,
            at_least_px2,
            at_most_px2: 9.0,
            noise: 1.0,
        };
        let mut size = FieldSize::default();
        let mut take = |by_pairs_px2, at_least_px2| size.take(&of(by_pairs_px2, at_least_px2))[(0, 0)];
        assert_eq!(take(6.0, -1.0), 6.0);
        // The mean is 5, its standard error 1.
        assert!((take(4.0, -1.0) - 4.0).abs() < 1e-12);
        // A negative mean counts as no field, and so does one that chance explains.
        assert_eq!(take(-13.0, -1.0), 0.0);
        assert_eq!(take(9.0, -1.0), 0.0);
        assert_eq!(take(1.0, 4.0), 4.0);
        // It follows a lasting value within ten times its memory: the standard error takes twice as
        // long as the mean.
        let last = (0..10 * TUNING.field_memory_frames as usize).map(|_| take(2.0, -1.0)).last();
        assert!(last.is_some_and(|last| (last - 2.0).abs() < 0.01), "{last:?}");
    }

    #[test]
    fn noise_alone_adds_little() {
        let exact = found(0.0, 100.0, 1.0);
        assert!((0.6..1.3).contains(&exact.nees), "{}", exact.nees);
    }

    #[test]
    fn underestimated_noise_is_not_taken_for_a_model_error() {
        let field = found(2.0 * NOISE_PX, TUNING.field_correlation_length * f64::from(WIDTH), 1.0);
        let noise = found(0.0, 100.0, 1.7);
        assert!((2.3..3.5).contains(&noise.noise) && (0.6..1.4).contains(&noise.nees), "{} {}", noise.noise, noise.nees);
        assert!(field.noise < 2.0 && field.rotation > 2.0 * noise.rotation, "{}, {} and {}", field.noise, field.rotation, noise.rotation);
    }

    #[test]
    fn a_pose_based_on_earlier_frames_inherits_their_error() {
        let (body, camera, pose) = (prepared(vec![cloth(1)]), lens(WIDTH, 480), facing(0.1, -0.3, Vector3::new(0.4, 0.05, 5.0)));
        let mut anchors = seen_anchors(&body, &pose, &camera, 9, |_, _| Vector2::zeros());
        anchors.iter_mut().for_each(|a| a.observation.information /= NOISE_PX.powi(2));
        let mut residuals = TileResiduals::default();
        residuals.take(&pose, &camera, &anchors).expect("tiles enough");
        let of_frame_alone = covariance_of_inverse(&pose, &residuals.normal().try_inverse().expect("positive definite"));
        let (own, before) = (of_frame_alone * 400.0, of_frame_alone);
        let error = |share: f64| blended(&pose, &residuals, &(of_frame_alone * share), &own, &before).expect("positive definite");
        let off = |a: Matrix6<f64>, b: Matrix6<f64>| (a - b).norm() / b.norm();
        // From its frame alone; from earlier frames alone; a tenth of 20 plus nine tenths of 1,
        // sigmas.
        assert!(off(error(1.0), own) < 1e-6 && off(error(3.0), own) < 1e-6);
        assert!(off(error(1e-9), before) < 1e-6);
        assert!(off(error(0.1), before * 2.9_f64.powi(2)) < 1e-6);
        // What persists from frame to frame is not averaged away.
        assert!(off(blended(&pose, &residuals, &(of_frame_alone * 0.1), &own, &own).expect("positive definite"), own) < 1e-6);
    }

    #[test]
    fn the_model_error_of_an_object_is_bounded_by_its_size() {
        let (body, camera, pose) = (prepared(vec![cloth(1)]), lens(WIDTH, 480), facing(0.1, -0.3, Vector3::new(0.4, 0.05, 30.0)));
        let mut random = Pcg64Mcg::seed_from_u64(4);
        // Independent noise in every tile, of twice the stated standard deviation.
        let mut anchors = seen_anchors(&body, &pose, &camera, 9, |_, _| Vector2::from_fn(|_, _| 2.0 * NOISE_PX * normal(&mut random)));
        anchors.iter_mut().for_each(|a| a.observation.information /= NOISE_PX.powi(2));
        let observations: Vec<Observation> = anchors.iter().map(|a| a.observation).collect();
        let found = resect(&pose, &MovingCamera::still(&camera), &observations, 30).expect("a pose");
        let mut residuals = TileResiduals::default();
        residuals.take(&found.pose, &camera, &anchors).expect("tiles enough");
        assert!(residuals.extent_px() < 100.0, "{}", residuals.extent_px());
        let rotation = |width_px: f64| {
            let error = model_error(&found.pose, width_px, &residuals, &mut ModelErrorBuffers::default()).expect("more than noise");
            error.at_most().fixed_view::<3, 3>(3, 3).trace().sqrt()
        };
        let (of_object, of_picture) = (rotation(residuals.extent_px()), rotation(f64::from(WIDTH)));
        let by_noise = covariance_of_inverse(&found.pose, &found.normal.try_inverse().expect("positive definite"));
        let by_noise = by_noise.fixed_view::<3, 3>(3, 3).trace().sqrt();
        assert!((1.0..15.0).contains(&(of_object / by_noise)) && of_picture > 3.0 * of_object, "{of_object} {of_picture} {by_noise}");
    }
}
