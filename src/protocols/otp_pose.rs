//! Poses and velocities in OTP's numbers.
//!
//! OTP's axes seen from the auditorium (x right, y away, z up) are the stage's. A rotation is three
//! angles, R = Rz(z) Ry(y) Rx(x) (intrinsic z-y-x, Tait-Bryan). The velocity of a rotation is read
//! as the rates of these three angles, so that angle + rate * time is the angle later.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use crate::geometry::{Body, Pose, Stage};

/// Micrometres per metre, and millionths of a degree per degree.
const MICRO: f64 = 1e6;
/// Millionths of a degree in a full turn.
const TURN_UDEG: i64 = 360_000_000;
/// Maximum rate of a rotation, thousandths of a degree per second: 1000 turns per second.
const MAX_MDEG_S: f64 = 360e6;

/// Returns the angles about x, y and z, radians, of R = Rz Ry Rx.
fn angles(rotation: &UnitQuaternion<f64>) -> [f64; 3] {
    let m: Matrix3<f64> = rotation.to_rotation_matrix().into_inner();
    let x = m[(2, 1)].atan2(m[(2, 2)]);
    // With x removed, the other two are well determined even where x is not (y near 90 degrees).
    let rest = rotation * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -x);
    let m: Matrix3<f64> = rest.to_rotation_matrix().into_inner();
    [x, (-m[(2, 0)]).atan2(m[(2, 2)]), (-m[(0, 1)]).atan2(m[(1, 1)])]
}

/// Returns position in micrometres and rotations in millionths of a degree.
pub fn to_otp(pose: &Pose<Stage, Body>) -> ([i64; 3], [u32; 3]) {
    let position: [f64; 3] = pose.translation.into();
    let rotation = angles(&pose.rotation).map(|angle| {
        let udeg = (angle.to_degrees() * MICRO).round() as i64;
        udeg.rem_euclid(TURN_UDEG) as u32
    });
    (position.map(|v| (v * MICRO).round() as i64), rotation)
}

/// Converts position and rotations to a pose.
pub fn from_otp(position_um: [i64; 3], rotation_udeg: [u32; 3]) -> Pose<Stage, Body> {
    let [x, y, z] = rotation_udeg.map(|udeg| (f64::from(udeg) / MICRO).to_radians());
    Pose::new(UnitQuaternion::from_euler_angles(x, y, z), Vector3::from(position_um.map(|v| v as f64 / MICRO)))
}

/// Returns a velocity in m/s as µm/s, if it is in the numbers' range.
pub fn velocity_to_otp(velocity: &Vector3<f64>) -> Option<[i32; 3]> {
    in_range((*velocity * MICRO).into(), f64::from(i32::MAX))
}

/// Returns the rates of the three angles, thousandths of a degree per second, of a body that turns
/// with this angular velocity, rad/s about its own axes. `None` beyond the numbers' range, also
/// where y is near 90 degrees: there x and z are one rotation, and their rates have no bound.
pub fn rates_to_otp(rotation: &UnitQuaternion<f64>, angular_velocity: &Vector3<f64>) -> Option<[i32; 3]> {
    let ([x, y, _], w) = (angles(rotation), angular_velocity);
    let about_z = w.y * x.sin() + w.z * x.cos();
    let rates = [w.x + about_z * y.tan(), w.y * x.cos() - w.z * x.sin(), about_z / y.cos()];
    in_range(rates.map(|rate| rate.to_degrees() * 1e3), MAX_MDEG_S)
}

fn in_range(values: [f64; 3], most: f64) -> Option<[i32; 3]> {
    values.iter().all(|v| v.abs() <= most).then(|| values.map(|v| v.round() as i32))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::protocols::golden::golden_camera;
    use crate::protocols::to_body_axes;

    #[test]
    fn the_golden_pose_has_no_rotation() {
        assert_eq!(to_otp(&to_body_axes(&golden_camera())), ([0, -4_000_000, 0], [0, 0, 0]));
    }

    #[test]
    fn signs_are_those_of_right_handed_rotations() {
        let about = |axis: Vector3<f64>, degrees: f64| {
            let axis = nalgebra::Unit::new_normalize(axis);
            to_otp(&Pose::new(UnitQuaternion::from_axis_angle(&axis, degrees.to_radians()), Vector3::zeros())).1
        };
        // A camera that pans to the left turns about z, one that tilts up about x.
        assert_eq!(about(Vector3::z(), 30.0), [0, 0, 30_000_000]);
        assert_eq!(about(Vector3::x(), 20.0), [20_000_000, 0, 0]);
        assert_eq!(about(Vector3::y(), -10.0), [0, 350_000_000, 0]);
    }

    fn rotations() -> impl Strategy<Value = UnitQuaternion<f64>> {
        // Near y = 90 degrees too, where x and z are one rotation.
        let y = prop_oneof![-90.0..90.0, 89.999_999_9..90.0, Just(90.0), Just(-90.0)];
        (-180.0..180.0, y, -180.0..180.0)
            .prop_map(|(x, y, z): (f64, f64, f64)| UnitQuaternion::from_euler_angles(x.to_radians(), y.to_radians(), z.to_radians()))
    }

    proptest! {
        #[test]
        fn poses_round_trip_within_a_micrometre_and_microdegree(rotation in rotations(), p in prop::array::uniform3(-2000.0..2000.0)) {
            let pose = Pose::<Stage, Body>::new(rotation, Vector3::from(p));
            let (position, angles) = to_otp(&pose);
            let back = from_otp(position, angles);
            prop_assert!(angles.iter().all(|a| *a < 360_000_000));
            prop_assert!((back.translation - pose.translation).amax() <= 0.5001e-6);
            // Half a unit in each of three angles.
            prop_assert!(pose.rotation.angle_to(&back.rotation).to_degrees() <= 1.51e-6 || pose.rotation.angle_to(&back.rotation) < 3e-8);
        }

        #[test]
        fn rates_are_those_of_the_angles(x in -170.0..170.0, y in -80.0..80.0, z in -170.0..170.0, w in prop::array::uniform3(-2.0..2.0)) {
            let (rotation, w) = (UnitQuaternion::from_euler_angles(f64::to_radians(x), f64::to_radians(y), f64::to_radians(z)), Vector3::from(w));
            let dt = 1e-6;
            let later = rotation * UnitQuaternion::from_scaled_axis(w * dt);
            let (before, after) = (angles(&rotation), angles(&later));
            let rates = rates_to_otp(&rotation, &w).unwrap();
            for k in 0..3 {
                let numeric = ((after[k] - before[k]) / dt).to_degrees() * 1e3;
                prop_assert!((numeric - f64::from(rates[k])).abs() < 1.0 + 1e-4 * numeric.abs(), "{k}: {numeric} {rates:?}");
            }
        }
    }

    #[test]
    fn rates_without_bound_are_not_sent() {
        let straight_up = UnitQuaternion::from_euler_angles(0.0, std::f64::consts::FRAC_PI_2, 0.0);
        assert_eq!(rates_to_otp(&straight_up, &Vector3::new(0.0, 0.0, 1.0)), None);
        assert_eq!(velocity_to_otp(&Vector3::new(3000.0, 0.0, 0.0)), None);
        assert_eq!(velocity_to_otp(&Vector3::new(-1.5, 0.0, 2e-6)), Some([-1_500_000, 0, 2]));
    }
}
