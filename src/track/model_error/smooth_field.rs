//! The effect of a smooth field of shifts over the picture on a pose.
//!
//! The field is a Gaussian process: the shifts of two tiles correlate by exp(-d² / 2 l²), where d
//! is their distance and l the field's correlation length. The pose is a weighted sum of the tiles'
//! shifts, so its covariance is a sum over all pairs of tiles. Tiles cannot be merged into cells to
//! save time: a stage that appears small has nearly the same shift everywhere, and only the small
//! differences between tiles show in the residuals.
//!
//! The correlation, however, is a sum of products: exp(-d² / 2 l²) = exp(-x² / 2) exp(-y² / 2)
//! exp(x·y), with the places x and y in units of l, and exp(x·y) is the sum of all x₁ⁱ x₂ʲ y₁ⁱ y₂ʲ
//! / (i! j!). Each tile thus has a few numbers, its features, whose products are the correlations
//! (the fast Gauss transform, Greengard and Strain 1991). Sums over all pairs become sums over all
//! tiles.

use crate::track::model_error::tuning::TUNING;
use nalgebra::{Cholesky, Const, Matrix6, Matrix6x2, Vector2};

use super::tile_residuals::TileResidual;
use crate::simd::multiversion;

/// Maximum number of powers. Raised, buffers grow.
const MAX_ORDER: usize = 32;

/// The covariance that a field of one pixel root mean square causes in a pose, and the pose's
/// covariance with that field; keeps its buffers.
#[derive(Debug, Default)]
pub struct SmoothField {
    pose_with_shift: Vec<Matrix6x2<f64>>,
    /// Per feature: the sum over all tiles of the feature times the derivative of the pose by the
    /// tile's shift.
    pose_by_feature: Vec<Matrix6x2<f64>>,
    of_pose: Matrix6<f64>,
}

impl SmoothField {
    /// Creates buffers that hold this many tiles without growing.
    pub fn with_capacity(tiles: usize) -> Self {
        let pose_by_feature = Vec::with_capacity(MAX_ORDER * (MAX_ORDER + 1) / 2);
        Self { pose_with_shift: Vec::with_capacity(tiles), pose_by_feature, of_pose: Matrix6::zeros() }
    }

    /// Computes both covariances for the tiles from which a pose was solved. `normal`: the pose's
    /// normal equations; `length_px`: the field's correlation length.
    pub fn work_out(&mut self, residuals: &[TileResidual], normal: &Cholesky<f64, Const<6>>, length_px: f64) {
        let Self { pose_with_shift, pose_by_feature, of_pose } = self;
        let expansion = Expansion::of(residuals, length_px);
        pose_by_feature.clear();
        pose_by_feature.resize(expansion.order * (expansion.order + 1) / 2, Matrix6x2::zeros());
        for residual in residuals {
            let pose_by_shift = normal.solve(&(residual.by_pose.transpose() * residual.information));
            add_features(pose_by_feature, &pose_by_shift, &expansion.powers(&residual.place_px), expansion.order);
        }
        pose_with_shift.clear();
        let with_shift = |r: &TileResidual| sum_of_features(pose_by_feature, &expansion.powers(&r.place_px), expansion.order);
        pose_with_shift.extend(residuals.iter().map(with_shift));
        *of_pose = pose_by_feature.iter().map(|by_feature| by_feature * by_feature.transpose()).sum();
    }

    /// Returns the covariance of the pose, [δt, δθ] of `T_camera_body`, camera axes, per squared
    /// pixel.
    pub fn of_pose(&self) -> &Matrix6<f64> {
        &self.of_pose
    }

    /// Returns the covariance of the pose with the field's shift at a tile, per squared pixel.
    pub fn pose_with_shift(&self, tile: usize) -> &Matrix6x2<f64> {
        &self.pose_with_shift[tile]
    }
}

/// The features of tiles: products of powers of their coordinates.
struct Expansion {
    centre_px: Vector2<f64>,
    length_px: f64,
    /// Number of powers of a coordinate, from 0 on; the powers of both coordinates together stay
    /// below it as well.
    order: usize,
    /// sqrt(1 / n) for each power n.
    scales: [f64; MAX_ORDER],
}

impl Expansion {
    /// Creates the expansion for tiles at these places: the farther apart they are, the more powers
    /// it has.
    fn of(residuals: &[TileResidual], length_px: f64) -> Self {
        let places = || residuals.iter().map(|r| r.place_px);
        let least = places().reduce(|a, b| a.inf(&b)).unwrap_or_default();
        let most = places().reduce(|a, b| a.sup(&b)).unwrap_or_default();
        let centre_px = 0.5 * (least + most);
        let reach = places().map(|p| (p - centre_px).norm_squared()).fold(0.0, f64::max) / length_px.powi(2);
        // The power n adds at most exp(-reach) reachⁿ / n! to a correlation.
        let (mut order, mut left_out) = (0, (-reach).exp());
        while order < TUNING.min_correlation_powers || (left_out > TUNING.max_correlation_error && order < MAX_ORDER) {
            order += 1;
            left_out *= reach / order as f64;
        }
        Self { centre_px, length_px, order, scales: std::array::from_fn(|n| (1.0 / n as f64).sqrt()) }
    }

    /// Returns exp(-x² / 2) xⁿ / sqrt(n!) for both coordinates of a place, in units of the
    /// correlation length.
    fn powers(&self, place_px: &Vector2<f64>) -> [[f64; MAX_ORDER]; 2] {
        let place = (place_px - self.centre_px) / self.length_px;
        [place.x, place.y].map(|x| {
            let mut powers = [0.0; MAX_ORDER];
            powers[0] = (-0.5 * x * x).exp();
            for n in 1..self.order {
                powers[n] = powers[n - 1] * x * self.scales[n];
            }
            powers
        })
    }
}

multiversion! {
    /// Adds one tile to the sums per feature.
    fn add_features(
        sums: &mut [Matrix6x2<f64>],
        pose_by_shift: &Matrix6x2<f64>,
        powers: &[[f64; MAX_ORDER]; 2],
        order: usize
    ); ["avx2"] => add_features_plain, else add_features_plain
}

#[inline(always)]
fn add_features_plain(sums: &mut [Matrix6x2<f64>], pose_by_shift: &Matrix6x2<f64>, [across, down]: &[[f64; MAX_ORDER]; 2], order: usize) {
    let mut rest = sums;
    for (n, x) in across[..order].iter().enumerate() {
        let (of_power, others) = rest.split_at_mut(order - n);
        let by_power = pose_by_shift * *x;
        for (sum, y) in of_power.iter_mut().zip(down) {
            *sum += by_power * *y;
        }
        rest = others;
    }
}

multiversion! {
    /// Returns the sum over all features of their values, weighted by the place's features.
    fn sum_of_features(
        by_feature: &[Matrix6x2<f64>],
        powers: &[[f64; MAX_ORDER]; 2],
        order: usize
    ) -> Matrix6x2<f64>; ["avx2"] => sum_of_features_plain, else sum_of_features_plain
}

#[inline(always)]
fn sum_of_features_plain(by_feature: &[Matrix6x2<f64>], [across, down]: &[[f64; MAX_ORDER]; 2], order: usize) -> Matrix6x2<f64> {
    let (mut sum, mut rest) = (Matrix6x2::zeros(), by_feature);
    for (n, x) in across[..order].iter().enumerate() {
        let (of_power, others) = rest.split_at(order - n);
        let mut by_power = Matrix6x2::zeros();
        for (of_one, y) in of_power.iter().zip(down) {
            by_power += of_one * *y;
        }
        sum += by_power * *x;
        rest = others;
    }
    sum
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, Vector3};

    use super::super::tile_residuals::TileResiduals;
    use super::*;
    use crate::track::synthetic::{cloth, facing, lens, prepared, seen_anchors};

    #[test]
    fn the_field_covariance_propagates_all_shifts_to_the_pose() {
        let (body, camera, pose) = (prepared(vec![cloth(1)]), lens(640, 480), facing(0.1, -0.3, Vector3::new(0.4, 0.05, 5.0)));
        let mut residuals = TileResiduals::default();
        residuals.take(&pose, &camera, &seen_anchors(&body, &pose, &camera, 8, |_, _| Vector2::zeros())).expect("tiles enough");
        let (tiles, length_px) = (residuals.tiles(), 0.3 * 640.0);
        let normal = residuals.normal().cholesky().expect("positive definite");
        let mut field = SmoothField::default();
        field.work_out(tiles, &normal, length_px);

        // The pose by all shifts, and their covariance, as full matrices.
        let n = tiles.len();
        let by_shifts = DMatrix::from_fn(6, 2 * n, |row, column| {
            let tile = &tiles[column / 2];
            normal.solve(&(tile.by_pose.transpose() * tile.information))[(row, column % 2)]
        });
        let shifts = DMatrix::from_fn(2 * n, 2 * n, |a, b| {
            let apart = tiles[a / 2].place_px - tiles[b / 2].place_px;
            if a % 2 == b % 2 { (-0.5 * apart.norm_squared() / length_px.powi(2)).exp() } else { 0.0 }
        });
        let with_shifts = &by_shifts * &shifts;
        let of_pose = &with_shifts * by_shifts.transpose();
        let is_close = |a: f64, b: f64, scale: f64| (a - b).abs() < 1e-9 * scale;
        for row in 0..6 {
            for column in 0..6 {
                let scale = (of_pose[(row, row)] * of_pose[(column, column)]).sqrt();
                assert!(is_close(field.of_pose()[(row, column)], of_pose[(row, column)], scale), "{row}, {column}");
            }
            let scale = with_shifts.row(row).amax();
            let all = (0..n).flat_map(|k| [0, 1].map(|axis| (k, axis)));
            let mut off =
                all.filter(|&(k, axis)| !is_close(field.pose_with_shift(k)[(row, axis)], with_shifts[(row, 2 * k + axis)], scale));
            assert_eq!(off.next(), None, "{row}");
        }
    }
}
