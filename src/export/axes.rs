//! Other programs' axes, and rotations as their angles.
//!
//! The stage has z up; our camera looks along +z with y down. USD, Blender, Nuke and glTF cameras
//! look along -z with y up. Nuke, glTF and OBJ have y up, After Effects has y down.

use std::f64::consts::{FRAC_1_SQRT_2, TAU};

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

use crate::geometry::{Camera, Pose, Stage};

/// Returns the rotation of a camera that looks along -z with y up, from the stage's axes.
pub fn looking_back(t_stage_camera: &Pose<Stage, Camera>) -> UnitQuaternion<f64> {
    // Half a turn about x.
    t_stage_camera.rotation * UnitQuaternion::from_quaternion(Quaternion::new(0.0, 1.0, 0.0, 0.0))
}

/// The rotation from the stage's axes, z up, to axes with y up: (x, z, -y).
pub fn y_up() -> UnitQuaternion<f64> {
    UnitQuaternion::from_quaternion(Quaternion::new(FRAC_1_SQRT_2, -FRAC_1_SQRT_2, 0.0, 0.0))
}

/// Converts a point of the stage to axes with y up.
pub fn point_y_up(p: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(p.x, p.z, -p.y)
}

/// The rotation from the stage's axes to those of After Effects, y down and z away: (x, -z, y).
pub fn y_down() -> UnitQuaternion<f64> {
    y_up().inverse()
}

/// Converts a point of the stage to the axes of After Effects.
pub fn point_y_down(p: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(p.x, -p.z, p.y)
}

/// Below this cosine of the middle angle, the outer two turn about the same axis and only their sum
/// is known. Raised, angles near there lose digits.
const ALIGNED: f64 = 1e-9;

/// Returns the angles x, y, z of `R = Ry Rx Rz`, radians: rotation order ZXY, z first. Of all
/// angles that give this rotation, those next to `before` are chosen.
pub fn angles_zxy(rotation: &UnitQuaternion<f64>, before: &Vector3<f64>) -> Vector3<f64> {
    let m = rotation.to_rotation_matrix().into_inner();
    let x = (-m[(1, 2)]).clamp(-1.0, 1.0).asin();
    let angles = if x.cos() < ALIGNED {
        Vector3::new(x, (-m[(2, 0)]).atan2(m[(0, 0)]), 0.0)
    } else {
        Vector3::new(x, m[(0, 2)].atan2(m[(2, 2)]), m[(1, 0)].atan2(m[(1, 1)]))
    };
    let half = 0.5 * TAU;
    let other = Vector3::new(half - angles.x, angles.y + half, angles.z + half);
    let near = |angles: Vector3<f64>| angles.zip_map(before, |angle, before| angle + TAU * ((before - angle) / TAU).round());
    let (angles, other) = (near(angles), near(other));
    if (other - before).norm() < (angles - before).norm() { other } else { angles }
}

/// Returns the angles x, y, z of `R = Rx Ry Rz`, radians: z first, as After Effects' orientation.
pub fn angles_zyx(rotation: &UnitQuaternion<f64>) -> Vector3<f64> {
    let m: Matrix3<f64> = rotation.to_rotation_matrix().into_inner();
    let y = m[(0, 2)].clamp(-1.0, 1.0).asin();
    if y.cos() < ALIGNED {
        return Vector3::new(m[(2, 1)].atan2(m[(1, 1)]), y, 0.0);
    }
    Vector3::new((-m[(1, 2)]).atan2(m[(2, 2)]), y, (-m[(0, 1)]).atan2(m[(0, 0)]))
}

/// Returns the quaternions with signs such that each is next to the one before: programs that
/// interpolate the numbers then take the short way.
pub fn continuous(rotations: impl IntoIterator<Item = UnitQuaternion<f64>>) -> Vec<UnitQuaternion<f64>> {
    let mut all: Vec<UnitQuaternion<f64>> = Vec::new();
    for rotation in rotations {
        let turned = all.last().is_some_and(|last| last.coords.dot(&rotation.coords) < 0.0);
        all.push(if turned { UnitQuaternion::new_unchecked(-rotation.into_inner()) } else { rotation });
    }
    all
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;

    fn about(axis: Vector3<f64>, angle: f64) -> UnitQuaternion<f64> {
        UnitQuaternion::from_scaled_axis(axis * angle)
    }

    fn all_turns() -> impl Iterator<Item = UnitQuaternion<f64>> {
        let quarters =
            (0..64).map(|k| about(Vector3::y(), f64::from(k % 4) * 0.25 * TAU) * about(Vector3::x(), f64::from(k / 4 % 4) * 0.25 * TAU));
        let odd = (0..200).map(|k| UnitQuaternion::from_euler_angles(f64::from(k) * 0.37, f64::from(k) * 0.11, f64::from(k) * 0.23));
        quarters.chain(odd)
    }

    #[test]
    fn angles_give_back_their_rotation() {
        let mut before = Vector3::zeros();
        for rotation in all_turns() {
            let a = angles_zxy(&rotation, &before);
            let back = about(Vector3::y(), a.y) * about(Vector3::x(), a.x) * about(Vector3::z(), a.z);
            assert!(back.angle_to(&rotation) < 1e-7, "{rotation} {a}");
            before = a;
            let a = angles_zyx(&rotation);
            let back = about(Vector3::x(), a.x) * about(Vector3::y(), a.y) * about(Vector3::z(), a.z);
            assert!(back.angle_to(&rotation) < 1e-7, "{rotation} {a}");
        }
    }

    #[test]
    fn angles_of_a_turning_camera_do_not_jump() {
        let mut before = Vector3::zeros();
        for k in 0..400 {
            // Two turns to the left while the camera tilts through the zenith.
            let (pan, tilt) = (f64::from(k) * TAU / 200.0, f64::from(k) * 0.008);
            let a = angles_zxy(&(about(Vector3::y(), pan) * about(Vector3::x(), tilt)), &before);
            assert!((a - before).norm() < 0.05, "{k}: {a}");
            before = a;
        }
    }

    #[test]
    fn a_level_camera_that_looks_upstage_is_not_rotated_elsewhere() {
        let s = FRAC_1_SQRT_2;
        let pose = Pose::new(UnitQuaternion::from_quaternion(Quaternion::new(s, -s, 0.0, 0.0)), Vector3::new(0.0, -4.0, 1.5));
        assert!((y_up() * looking_back(&pose)).angle() < 1e-12, "Nuke, glTF");
        assert!((y_down() * pose.rotation).angle() < 1e-12, "After Effects");
        let p = Vector3::new(1.0, 2.0, 3.0);
        assert!((y_up().transform_point(&Point3::from(p)).coords - point_y_up(&p)).norm() < 1e-12);
        assert!((y_down().transform_point(&Point3::from(p)).coords - point_y_down(&p)).norm() < 1e-12);
    }
}
