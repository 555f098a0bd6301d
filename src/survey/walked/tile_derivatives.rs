//! The derivatives of a tile's position in a frame by all unknowns.

use nalgebra::{SMatrix, Vector2};

use super::stage_model::{LENS_COLUMNS, StageModel};
use crate::camera::Shutter;
use crate::geometry::skew;
use crate::motion::Motion;
use crate::track::ObservedTile;

/// Number of unknowns of a frame: [δp, δθ] of the pose in camera axes and, with a rolling shutter,
/// their rates and accelerations.
pub const FRAME_UNKNOWNS: usize = 18;

/// A tile's derivatives, pixels.
#[derive(Debug, Clone)]
pub struct TileDerivatives {
    /// By the frame's unknowns.
    pub by_frame: SMatrix<f64, 2, FRAME_UNKNOWNS>,
    /// By the model's: index of the unknown, and derivative.
    pub by_model: Vec<(usize, Vector2<f64>)>,
}

/// Returns how pose, rates and accelerations contribute to the pose after some time.
fn powers(delay_s: f64) -> [f64; FRAME_UNKNOWNS / 6] {
    [1.0, delay_s, 0.5 * delay_s * delay_s]
}

impl TileDerivatives {
    /// Computes the derivatives for a visible tile; `None` if it is behind the camera.
    pub fn of(tile: &ObservedTile, motion: &Motion, model: &StageModel) -> Option<Self> {
        let then = motion.after(tile.delay_s);
        let t_camera_body = then.pose.inverse();
        let point = model.point(tile.surface, tile.on_picture_m);
        let seen = t_camera_body.transform(&point.place.into()).coords;
        if seen.z < 1e-6 {
            return None;
        }
        let (pixel, by_point) = model.camera.project_point_with_jacobian(&seen);
        let mut by_pose = SMatrix::<f64, 2, 6>::zeros();
        by_pose.fixed_columns_mut::<3>(0).copy_from(&by_point);
        by_pose.fixed_columns_mut::<3>(3).copy_from(&(-by_point * skew(&seen)));
        let mut by_frame = SMatrix::<f64, 2, FRAME_UNKNOWNS>::zeros();
        for (power, factor) in powers(tile.delay_s).into_iter().enumerate() {
            by_frame.fixed_columns_mut::<6>(6 * power).copy_from(&(by_pose * factor));
        }

        let by_body = by_point * t_camera_body.rotation_matrix();
        let mut by_model: Vec<(usize, Vector2<f64>)> = point.by_model.iter().map(|(k, d)| (*k, by_body * d)).collect();
        if let Some(at) = model.places().readout {
            // The later a row is read, the farther the camera has moved.
            let height = model.camera.height();
            let share = Shutter { readout_s: 1.0, exposure_s: 0.0 }.delay_s(pixel.0.y + 0.5, height);
            let passes = -(t_camera_body.rotation * then.velocity) - then.angular_velocity.cross(&seen);
            by_model.push((at, by_point * passes * share));
        }
        if let Some(at) = model.places().lens {
            let (lens, n) = (model.camera.intrinsics(), seen.xy() / seen.z);
            let by_numbers = lens.by_numbers(n, lens.distort(n).0);
            by_model.extend(LENS_COLUMNS.iter().enumerate().map(|(k, column)| (at + k, by_numbers.column(*column).into_owned())));
        }
        Some(Self { by_frame, by_model })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Normalized;
    use crate::geometry::Pose;
    use crate::survey::walked::synthetic::{LENS, camera_poses, stage};
    use nalgebra::{DVector, Matrix2, UnitQuaternion, Vector3};

    /// Returns where a model puts a tile in a frame.
    fn seen(tile: &ObservedTile, motion: &Motion, model: &StageModel) -> Vector2<f64> {
        let surface = &model.surfaces[tile.surface];
        let in_body = surface.pose.transform(&surface.shape.at(tile.on_picture_m).place.into());
        let at = |delay_s: f64| {
            let c = motion.after(delay_s).pose.inverse().transform(&in_body).coords;
            model.camera.project(Normalized(Vector2::new(c.x / c.z, c.y / c.z))).0
        };
        let later = Shutter { readout_s: model.readout_change_s(), exposure_s: 0.0 };
        at(tile.delay_s + later.delay_s(at(tile.delay_s).y + 0.5, model.camera.height()))
    }

    #[test]
    fn derivatives_by_all_unknowns_agree_with_differences() {
        let mut model = StageModel::new(crate::camera::CameraModel::new(LENS).unwrap(), &stage(), true, true);
        // Not flat, so that no slope is zero.
        let bend = DVector::from_fn(model.places().count, |k, _| if k < 400 { 2e-3 * (k as f64).sin() } else { 0.0 });
        model = model.stepped(&bend).unwrap();
        let motion = Motion {
            velocity: Vector3::new(0.3, -0.2, 0.1),
            angular_velocity: Vector3::new(0.2, 0.1, -0.3),
            ..Motion::still(camera_poses(5)[3])
        };
        let h = 1e-6;
        for (surface, on_picture_m) in [(0, [0.7, -0.4]), (0, [-1.9, 1.3]), (1, [0.2, 0.1])] {
            let tile = ObservedTile {
                surface,
                on_picture_m,
                shift_px: Vector2::zeros(),
                information: Matrix2::identity(),
                delay_s: 0.004,
                number: 0,
            };
            let found = TileDerivatives::of(&tile, &motion, &model).unwrap();
            for (k, d) in &found.by_model {
                let mut step = DVector::zeros(model.places().count);
                step[*k] = h;
                let (plus, minus) = (model.stepped(&step).unwrap(), model.stepped(&-step).unwrap());
                let difference = (seen(&tile, &motion, &plus) - seen(&tile, &motion, &minus)) / (2.0 * h);
                assert!((difference - d).norm() < 1e-4 * d.norm().max(1.0), "{k}: {difference} {d}");
            }
            for k in 0..FRAME_UNKNOWNS {
                // A left perturbation of T_camera_body, at the tile's own time.
                let of = |sign: f64| {
                    let size = sign * h * powers(tile.delay_s)[k / 6];
                    let mut step = nalgebra::Vector6::zeros();
                    step[k % 6] = size;
                    let at = motion.after(tile.delay_s).pose.inverse();
                    let rotation = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(3).into_owned());
                    let moved = Pose::new(rotation * at.rotation, rotation * at.translation + step.fixed_rows::<3>(0)).inverse();
                    seen(&ObservedTile { delay_s: 0.0, ..tile }, &Motion::still(moved), &model)
                };
                let difference = (of(1.0) - of(-1.0)) / (2.0 * h);
                let d = found.by_frame.column(k);
                assert!((difference - d).norm() < 1e-4 * d.norm().max(1.0), "{k}: {difference} {d}");
            }
        }
    }
}
