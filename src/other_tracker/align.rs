//! The two rigid transforms between trackers: `ours = world * others * sensor` (AX = YB in
//! robotics), in closed form: first the rotations, then the positions, which are then linear.

use nalgebra::{DMatrix, DVector, Matrix3, UnitQuaternion, Vector3};
use thiserror::Error;

use super::pairs::Pair;
use crate::geometry::{Body, Pose, Stage};

/// Minimum number of pairs. Chosen: a second at 30 per second. Lowered, the twelve unknowns fit
/// noise.
const MIN_PAIRS: usize = 30;
/// Minimum motion of our camera over the pairs, metres (root mean square about the middle) and
/// radians (of the rotation from the first pair). Chosen: far above what trackers scatter. Lowered,
/// an alignment is made of noise.
const MIN_SHIFT_M: f64 = 0.05;
const MIN_ROTATION: f64 = 0.05;
/// Singular values below this share of the largest are not determined by the motion; the solution
/// is then the shortest. Raised, weakly determined offsets are taken to be zero.
const UNDETERMINED: f64 = 1e-4;
/// Minimum second moment of the rotations about other axes than the main one, as a share of its
/// own: 3 % of its angles. Lowered, the sensor's rotation about that axis is made of noise.
const MIN_OTHER_AXES: f64 = 1e-3;

/// What leads from the other tracker's poses to ours.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Alignment {
    /// The other's fixed axes in ours.
    pub world: Pose<Stage, Stage>,
    /// Our camera in the other's sensor.
    pub sensor: Pose<Body, Body>,
}

impl Alignment {
    /// Returns what the other tracker says of our camera.
    pub fn apply(&self, others: &Pose<Stage, Body>) -> Pose<Stage, Body> {
        self.world * *others * self.sensor
    }
}

/// Why two logs cannot be aligned.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum Unalignable {
    /// Too few pairs.
    #[error(
        "the logs have {0} instants in common, {MIN_PAIRS} are needed; check that both are of the same take, and their stamps of one clock"
    )]
    Few(usize),
    /// The camera did not move enough.
    #[error(
        "the camera moves by {0:.3} m and turns by {1:.1} degrees only, so the trackers' frames cannot be told from their differences; move \
         it by half a metre and pan, tilt and roll it"
    )]
    Still(f64, f64),
    /// It turned about one axis only.
    #[error(
        "the camera turns about one axis only, so how the trackers are turned to each other about it is not determined; pan, tilt and roll \
         the rig"
    )]
    OneAxis,
}

/// Finds the alignment with the smallest differences.
///
/// # Errors
/// When there are too few pairs, or too little motion.
pub fn aligned(pairs: &[Pair]) -> Result<Alignment, Unalignable> {
    let Some(first) = pairs.first().filter(|_| pairs.len() >= MIN_PAIRS) else { return Err(Unalignable::Few(pairs.len())) };
    let n = pairs.len() as f64;
    let middle = pairs.iter().map(|pair| pair.ours.translation).sum::<Vector3<f64>>() / n;
    let shift = (pairs.iter().map(|pair| (pair.ours.translation - middle).norm_squared()).sum::<f64>() / n).sqrt();
    let rotation = (pairs.iter().map(|pair| pair.ours.angle_to(&first.ours).powi(2)).sum::<f64>() / n).sqrt();
    if shift < MIN_SHIFT_M || rotation < MIN_ROTATION {
        return Err(Unalignable::Still(shift, rotation.to_degrees()));
    }
    let r_sensor = sensor_rotation(pairs, first).ok_or(Unalignable::OneAxis)?;
    let r_world = mean_rotation(pairs.iter().map(|pair| pair.ours.rotation * (pair.others.rotation * r_sensor).inverse()));
    let [p_world, p_sensor] = positions(pairs, &r_world);
    Ok(Alignment { world: Pose::new(r_world, p_world), sensor: Pose::new(r_sensor, p_sensor) })
}

/// Returns the rotation of our camera in the other's sensor: it maps the rotation vectors since the
/// first pair in our axes to those in the sensor's (Kabsch). `None` for rotations about one axis.
fn sensor_rotation(pairs: &[Pair], first: &Pair) -> Option<UnitQuaternion<f64>> {
    let mut moments = Matrix3::zeros();
    for pair in pairs {
        let ours = (first.ours.rotation.inverse() * pair.ours.rotation).scaled_axis();
        let others = (first.others.rotation.inverse() * pair.others.rotation).scaled_axis();
        moments += others * ours.transpose();
    }
    let sizes = moments.singular_values();
    (sizes[1] > MIN_OTHER_AXES * sizes[0]).then(|| nearest_rotation(&moments))
}

/// Returns the rotation nearest to a matrix.
fn nearest_rotation(matrix: &Matrix3<f64>) -> UnitQuaternion<f64> {
    let svd = matrix.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else { return UnitQuaternion::identity() };
    let sign = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
    crate::geometry::pose::quaternion(&(u * sign * v_t))
}

fn mean_rotation(rotations: impl Iterator<Item = UnitQuaternion<f64>>) -> UnitQuaternion<f64> {
    nearest_rotation(&rotations.map(|rotation| rotation.to_rotation_matrix().into_inner()).sum())
}

/// Returns the positions of world and sensor: p_ours = p_world + R_world (p_others + R_others
/// p_sensor).
fn positions(pairs: &[Pair], r_world: &UnitQuaternion<f64>) -> [Vector3<f64>; 2] {
    let (mut system, mut right) = (DMatrix::zeros(3 * pairs.len(), 6), DVector::zeros(3 * pairs.len()));
    for (k, pair) in pairs.iter().enumerate() {
        let lever = (r_world * pair.others.rotation).to_rotation_matrix().into_inner();
        system.fixed_view_mut::<3, 3>(3 * k, 0).copy_from(&Matrix3::identity());
        system.fixed_view_mut::<3, 3>(3 * k, 3).copy_from(&lever);
        right.fixed_rows_mut::<3>(3 * k).copy_from(&(pair.ours.translation - r_world * pair.others.translation));
    }
    let svd = system.svd(true, true);
    let least = svd.singular_values.max() * UNDETERMINED;
    // Both factors were asked for.
    let solution = svd.solve(&right, least).unwrap_or_else(|_| DVector::zeros(6));
    [solution.fixed_rows::<3>(0).into_owned(), solution.fixed_rows::<3>(3).into_owned()]
}

#[cfg(test)]
mod tests {
    use super::super::synthetic::moving;
    use super::*;
    use crate::frame::Timestamp;

    fn made(motion: impl Fn(f64) -> Pose<Stage, Body>, alignment: &Alignment) -> Vec<Pair> {
        let pair = |k: i32| {
            let ours = motion(f64::from(k) / 30.0);
            let others = alignment.world.inverse() * ours * alignment.sensor.inverse();
            Pair { at: Timestamp::from_seconds(f64::from(k) / 30.0), ours, others }
        };
        (0..120).map(pair).collect()
    }

    fn truth() -> Alignment {
        Alignment {
            world: Pose::new(UnitQuaternion::from_euler_angles(0.1, -0.4, 2.0), Vector3::new(3.0, -1.0, 0.5)),
            sensor: Pose::new(UnitQuaternion::from_euler_angles(1.5, 0.2, -0.3), Vector3::new(0.1, 0.05, -0.2)),
        }
    }

    #[test]
    fn world_and_sensor_are_found() {
        let found = aligned(&made(moving, &truth())).unwrap();
        assert!(found.world.angle_to(&truth().world) < 1e-7 && found.sensor.angle_to(&truth().sensor) < 1e-7);
        assert!((found.world.translation - truth().world.translation).norm() < 1e-7);
        assert!((found.sensor.translation - truth().sensor.translation).norm() < 1e-7);
    }

    #[test]
    fn a_motion_about_one_axis_is_refused() {
        let pan = |t: f64| Pose::new(UnitQuaternion::from_scaled_axis(Vector3::z() * 0.5 * t.sin()), moving(t).translation);
        assert_eq!(aligned(&made(pan, &truth())), Err(Unalignable::OneAxis));
    }

    #[test]
    fn too_little_is_refused() {
        let pairs = made(moving, &truth());
        assert_eq!(aligned(&pairs[..29]), Err(Unalignable::Few(29)));
        assert!(matches!(aligned(&made(|_| moving(0.0), &truth())), Err(Unalignable::Still(..))));
    }
}
