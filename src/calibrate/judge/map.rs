//! Converts the lens's uncertainty, or the difference of two lenses, into pixels over the picture.
//!
//! An error of a few pixels in the principal point is mostly compensated by a small rotation of the
//! camera, which a tracker finds by itself. So the best-fitting rotation is removed first.

use nalgebra::{Matrix3, SMatrix, UnitQuaternion, Vector2, Vector3};

use super::super::solve::lens::{LENS_NUMBERS, Lens, LensMatrix};
use crate::camera::{CameraModel, Normalized, Pixel};
use crate::geometry::robust_kernel::median;

/// Number of columns of a map; odd, so that the middle is sampled, and about 4 to 3 with the rows.
/// Raised, maps are finer and take longer.
pub const MAP_COLUMNS: usize = 17;
/// Number of rows of a map; see [`MAP_COLUMNS`].
pub const MAP_ROWS: usize = 13;

/// Fraction of the places that counts as "most of the picture": the rest is the outermost rim,
/// where corners are rare. Raised, the rim decides the verdict; lowered, a lens known only in the
/// middle passes.
pub const MOST: f64 = 0.8;

/// One value for each place of a grid that spans the picture.
#[derive(Debug, Clone, PartialEq)]
pub struct PixelMap {
    /// Row by row, [`MAP_COLUMNS`] x [`MAP_ROWS`], pixels; `None` where the lens has no ray.
    pub values_px: Vec<Option<f64>>,
}

impl PixelMap {
    /// Returns the largest value.
    pub fn worst(&self) -> f64 {
        self.values_px.iter().flatten().fold(0.0, |a: f64, &b| a.max(b))
    }

    /// Returns the value below which a fraction `share` (0 to 1) of the places stays; infinite if
    /// no place has a value.
    pub fn quantile(&self, share: f64) -> f64 {
        let mut known: Vec<f64> = self.values_px.iter().flatten().copied().collect();
        known.sort_unstable_by(f64::total_cmp);
        let index = (share.clamp(0.0, 1.0) * known.len().saturating_sub(1) as f64).round() as usize;
        known.get(index).copied().unwrap_or(f64::INFINITY)
    }
}

/// Returns the grid's places, from the picture's corner to the opposite corner.
pub fn places((width, height): (u32, u32)) -> impl Iterator<Item = Vector2<f64>> {
    let step = |k: usize, count: usize, size: u32| f64::from(size - 1) * k as f64 / (count - 1) as f64;
    (0..MAP_ROWS).flat_map(move |r| (0..MAP_COLUMNS).map(move |c| Vector2::new(step(c, MAP_COLUMNS, width), step(r, MAP_ROWS, height))))
}

/// Returns how a pixel moves when the camera rotates: the derivative by a rotation vector in camera
/// axes.
fn by_rotation(by_point: [Vector2<f64>; 2], n: Vector2<f64>) -> SMatrix<f64, 2, 3> {
    // Derivative of (x/z, y/z) of a rotated ray (x, y, 1).
    let rotation = SMatrix::<f64, 2, 3>::new(-n.x * n.y, 1.0 + n.x * n.x, -n.y, -1.0 - n.y * n.y, n.x * n.y, n.x);
    SMatrix::<f64, 2, 2>::from_columns(&by_point) * rotation
}

/// Returns 3 sigma of a distant point's image position, from the lens's covariance, with the best
/// rotation removed.
pub fn uncertainty(model: &CameraModel, lens: &Lens, covariance: &LensMatrix) -> PixelMap {
    let size = (model.width(), model.height());
    let rows: Vec<Option<(SMatrix<f64, 2, LENS_NUMBERS>, SMatrix<f64, 2, 3>)>> = places(size)
        .map(|p| {
            let Normalized(n) = model.unproject(Pixel(p))?;
            let (_, by_point, by_lens) = lens.project_with_derivatives(n);
            Some((by_lens, by_rotation(by_point, n)))
        })
        .collect();
    let (mut tt, mut tl) = (Matrix3::zeros(), SMatrix::<f64, 3, LENS_NUMBERS>::zeros());
    for (by_lens, by_rotation) in rows.iter().flatten() {
        tt += by_rotation.transpose() * by_rotation;
        tl += by_rotation.transpose() * by_lens;
    }
    let Some(inverse) = tt.try_inverse() else { return PixelMap { values_px: vec![None; rows.len()] } };
    let rotation_by_lens = inverse * tl;
    let values = rows.iter().map(|row| {
        let (by_lens, by_rotation) = row.as_ref()?;
        let left = by_lens - by_rotation * rotation_by_lens;
        Some(3.0 * (left * covariance * left.transpose()).trace().max(0.0).sqrt())
    });
    PixelMap { values_px: values.collect() }
}

/// Returns the displacement between two cameras' images of the same distant points, from the first
/// to the second, in pixels of the first, with the best rotation removed; `None` where either has
/// no ray.
pub fn difference(first: &CameraModel, second: &CameraModel) -> Vec<Option<Vector2<f64>>> {
    let size = (first.width(), first.height());
    let lens = Lens::of_model(second);
    let rays: Vec<Option<(Vector2<f64>, Vector3<f64>)>> = places(size).map(|p| Some((p, first.unproject(Pixel(p))?.0.push(1.0)))).collect();
    let rotation = best_rotation(&lens, &rays);
    let apart = |(place, ray): (Vector2<f64>, Vector3<f64>)| {
        let rotated = rotation * ray;
        let n = rotated.xy() / rotated.z;
        (rotated.z > 0.0 && n.norm() <= second.valid_radius()).then(|| lens.project(n) - place)
    };
    rays.into_iter().map(|ray| ray.and_then(apart)).collect()
}

/// Returns the rotation of the camera with which a lens images the rays nearest to their places.
/// Places with large deviations (a lens that was never shown its rim) have little weight.
fn best_rotation(lens: &Lens, rays: &[Option<(Vector2<f64>, Vector3<f64>)>]) -> UnitQuaternion<f64> {
    let mut rotation = UnitQuaternion::identity();
    for _ in 0..15 {
        let seen = rays.iter().flatten().map(|(place, ray)| {
            let rotated = rotation * ray;
            let n = rotated.xy() / rotated.z;
            let (pixel, by_point, _) = lens.project_with_derivatives(n);
            (place - pixel, by_rotation(by_point, n))
        });
        let rows: Vec<(Vector2<f64>, SMatrix<f64, 2, 3>)> = seen.collect();
        let mut lengths: Vec<f64> = rows.iter().map(|(r, _)| r.norm_squared()).collect();
        let Some(middle) = median(&mut lengths) else { break };
        let (mut a, mut b) = (Matrix3::zeros(), Vector3::zeros());
        for (residual, by_rotation) in &rows {
            let weight = 1.0 / (1.0 + residual.norm_squared() / (middle + 1e-12));
            a += by_rotation.transpose() * by_rotation * weight;
            b += by_rotation.transpose() * residual * weight;
        }
        let Some(step) = a.try_inverse().map(|inverse| inverse * b) else { break };
        rotation = UnitQuaternion::from_scaled_axis(step) * rotation;
        if step.norm() < 1e-12 {
            break;
        }
    }
    rotation
}

/// Returns the lengths of a field of differences.
pub fn lengths(field: &[Option<Vector2<f64>>]) -> PixelMap {
    PixelMap { values_px: field.iter().map(|v| v.map(|v| v.norm())).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(fx: f64, cx: f64) -> CameraModel {
        CameraModel::pinhole(640, 480, fx, fx, cx, 239.5).unwrap()
    }

    #[test]
    fn a_moved_principal_point_mostly_acts_as_rotation() {
        let field = lengths(&difference(&camera(600.0, 319.5), &camera(600.0, 329.5)));
        assert!(field.worst() < 3.5, "{}", field.worst());
        assert!(lengths(&difference(&camera(600.0, 319.5), &camera(600.0, 319.5))).worst() < 1e-9);
    }

    #[test]
    fn a_focal_length_error_does_not_act_as_rotation() {
        let field = lengths(&difference(&camera(600.0, 319.5), &camera(606.0, 319.5)));
        assert!((field.worst() - 4.0).abs() < 0.1, "{}", field.worst()); // 1 % of 400 px, the distance to a corner
    }

    #[test]
    fn the_uncertainty_of_a_focal_length_grows_to_the_corners() {
        let model = camera(600.0, 319.5);
        let mut covariance = LensMatrix::zeros();
        for (r, c) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            covariance[(r, c)] = 4.0;
        }
        let map = uncertainty(&model, &Lens::of_model(&model), &covariance);
        assert!((map.worst() - 3.0 * 2.0 * 400.0 / 600.0).abs() < 0.05, "{}", map.worst());
        assert!(map.values_px[MAP_ROWS / 2 * MAP_COLUMNS + MAP_COLUMNS / 2].unwrap() < 0.01);
    }
}
