//! What a smooth field of shifts over the picture does to a pose.
//!
//! The field is a Gaussian process: the shifts of two tiles correlate by exp(-d² / 2 l²), with their distance d and the field's correlation length l. The pose
//! is a weighted sum of the tiles' shifts, so that its covariance is a sum over all pairs of tiles. Tiles cannot be merged into
//! cells to save time: a stage that is seen small has nearly the same shift everywhere, and only the small differences between tiles show in the residuals.

use nalgebra::{Cholesky, Const, Matrix6, Matrix6x2};

use super::tile_residuals::TileResidual;
use crate::simd::multiversion;

/// The covariance that a field of one pixel, root mean square, gives a pose, and the pose's with the field; keeps its buffers.
#[derive(Debug, Default)]
pub struct SmoothField {
    tiles: Vec<TileInField>,
    of_pose: Matrix6<f64>,
}

#[derive(Debug)]
struct TileInField {
    /// How the pose changes with its shift, per pixel.
    pose_by_shift: Matrix6x2<f64>,
    /// Covariance of the pose with the field's shift here, per squared pixel.
    pose_with_shift: Matrix6x2<f64>,
}

impl SmoothField {
    /// Buffers that hold this many tiles without growing.
    pub fn with_capacity(tiles: usize) -> Self {
        Self { tiles: Vec::with_capacity(tiles), of_pose: Matrix6::zeros() }
    }

    /// Works it out for the tiles that a pose was solved from. `normal`: the pose's normal equations; `length_px`: the field's correlation length.
    pub fn work_out(&mut self, residuals: &[TileResidual], normal: &Cholesky<f64, Const<6>>, length_px: f64) {
        let Self { tiles, of_pose } = self;
        let per_squared_length = -0.5 / length_px.powi(2);
        tiles.clear();
        for residual in residuals {
            let pose_by_shift = normal.solve(&(residual.by_pose.transpose() * residual.information));
            let mut tile = TileInField { pose_by_shift, pose_with_shift: pose_by_shift };
            add_pairs(&mut tile, residual, tiles, residuals, per_squared_length);
            tiles.push(tile);
        }
        *of_pose = tiles.iter().map(|tile| tile.pose_with_shift * tile.pose_by_shift.transpose()).sum();
    }

    /// Covariance of the pose, [δt, δθ] of `T_camera_body`, camera axes, per squared pixel.
    pub fn of_pose(&self) -> &Matrix6<f64> {
        &self.of_pose
    }

    /// Covariance of the pose with the field's shift at a tile, per squared pixel.
    pub fn pose_with_shift(&self, tile: usize) -> &Matrix6x2<f64> {
        &self.tiles[tile].pose_with_shift
    }
}

multiversion! {
    /// Adds what a tile's shift and those of the tiles before it have in common, to both. A tile with itself is as alike as can be.
    fn add_pairs(
        tile: &mut TileInField,
        residual: &TileResidual,
        before: &mut [TileInField],
        residuals: &[TileResidual],
        per_squared_length: f64
    ); ["avx2"] => add_pairs_plain, else add_pairs_plain
}

#[inline(always)]
fn add_pairs_plain(
    tile: &mut TileInField,
    residual: &TileResidual,
    before: &mut [TileInField],
    residuals: &[TileResidual],
    per_squared_length: f64,
) {
    for (other, seen) in before.iter_mut().zip(residuals) {
        let alike = ((seen.place_px - residual.place_px).norm_squared() * per_squared_length).exp();
        tile.pose_with_shift += other.pose_by_shift * alike;
        other.pose_with_shift += tile.pose_by_shift * alike;
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, Vector2, Vector3};

    use super::super::synthetic::{cloth, facing, lens, prepared, seen_anchors};
    use super::super::tile_residuals::TileResiduals;
    use super::*;

    #[test]
    fn the_covariance_is_that_of_all_shifts_carried_to_the_pose() {
        let (body, camera, pose) = (prepared(vec![cloth(1)]), lens(640, 480), facing(0.1, -0.3, Vector3::new(0.4, 0.05, 5.0)));
        let mut residuals = TileResiduals::default();
        residuals.take(&pose, &camera, &seen_anchors(&body, &pose, &camera, 8, |_, _| Vector2::zeros())).expect("tiles enough");
        let (tiles, length_px) = (residuals.tiles(), 0.3 * 640.0);
        let normal = residuals.normal().cholesky().expect("positive definite");
        let mut field = SmoothField::default();
        field.work_out(tiles, &normal, length_px);

        // The pose by all shifts, and their covariance, as whole matrices.
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
