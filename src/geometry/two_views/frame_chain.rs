//! From an object to the camera over two views (the source's equations 12 to 15), as rigid
//! transforms whose types name their frames.
//!
//! The source multiplies rotations on the right and appends a column at the end; its x and z
//! rotations are transposed and its y rotation is not. Here each step changes the frame in which a
//! point is expressed, so each multiplies from the left:
//!
//! ```text
//! T_camera_object = T_camera_first · T_first_second · T_second_object
//! ```
//!
//! `docs/frame-chain.md` works through an example and the source's errors.

use nalgebra::{UnitQuaternion, Vector3};

use crate::geometry::pose::{Body, Camera, Pose};
use crate::geometry::relative_pose::TwoViewMotion;

/// The camera's optical frame when it took the first picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FirstView {}
/// The camera's optical frame when it took the second picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SecondView {}

/// Returns Rx(α) Ry(β) Rz(γ): rotation by `gamma` about z, then `beta` about y, then `alpha` about
/// x, radians. Each rotates points counter-clockwise when looking against its axis (equation 13
/// with one sign for all three).
pub fn rotation_xyz(alpha: f64, beta: f64, gamma: f64) -> UnitQuaternion<f64> {
    let about = |axis, angle| UnitQuaternion::from_axis_angle(&axis, angle);
    about(Vector3::x_axis(), alpha) * about(Vector3::y_axis(), beta) * about(Vector3::z_axis(), gamma)
}

/// Returns the second view's pose in the first, `T_first_second`, metres, from the known distance
/// between the two.
///
/// Two pictures alone do not determine that distance (the source never says where it comes from).
/// `motion` maps the first view's points into the second, so this inverts it.
pub fn first_from_second(motion: &TwoViewMotion, baseline_m: f64) -> Pose<FirstView, SecondView> {
    Pose::<SecondView, FirstView>::new(motion.rotation, motion.direction * baseline_m).inverse()
}

/// Chains the transforms: returns an object's pose in the camera's frame from its pose in the
/// second view's.
pub fn object_in_camera(
    t_camera_first: &Pose<Camera, FirstView>,
    t_first_second: &Pose<FirstView, SecondView>,
    t_second_object: &Pose<SecondView, Body>,
) -> Pose<Camera, Body> {
    *t_camera_first * (*t_first_second * *t_second_object)
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Point3};

    use super::*;

    fn example() -> (Pose<Camera, FirstView>, Pose<FirstView, SecondView>, Pose<SecondView, Body>) {
        (
            Pose::new(rotation_xyz(0.02, -0.1, 0.05), Vector3::new(0.1, 0.0, -0.2)),
            Pose::new(rotation_xyz(-0.05, 0.4, 0.1), Vector3::new(1.5, -0.1, 0.3)),
            Pose::new(rotation_xyz(0.3, -0.2, 0.7), Vector3::new(-0.4, 0.2, 5.0)),
        )
    }

    /// The source's rotations of equation 13 as printed.
    fn printed(alpha: f64, beta: f64, gamma: f64) -> Matrix3<f64> {
        let rx = Matrix3::new(1.0, 0.0, 0.0, 0.0, alpha.cos(), alpha.sin(), 0.0, -alpha.sin(), alpha.cos());
        let ry = Matrix3::new(beta.cos(), 0.0, beta.sin(), 0.0, 1.0, 0.0, -beta.sin(), 0.0, beta.cos());
        let rz = Matrix3::new(gamma.cos(), gamma.sin(), 0.0, -gamma.sin(), gamma.cos(), 0.0, 0.0, 0.0, 1.0);
        rx * ry * rz
    }

    #[test]
    fn e14_all_three_rotations_turn_the_same_way() {
        let angle = 10.0_f64.to_radians();
        let right = rotation_xyz(angle, angle, angle);
        // Each axis alone: x to y to z to x.
        let quarter = std::f64::consts::FRAC_PI_2;
        assert!((rotation_xyz(quarter, 0.0, 0.0) * Vector3::y() - Vector3::z()).norm() < 1e-12);
        assert!((rotation_xyz(0.0, quarter, 0.0) * Vector3::z() - Vector3::x()).norm() < 1e-12);
        assert!((rotation_xyz(0.0, 0.0, quarter) * Vector3::x() - Vector3::y()).norm() < 1e-12);
        // The printed rotation is 30.6 degrees away.
        let wrong = UnitQuaternion::from_matrix(&printed(angle, angle, angle));
        assert!((right.angle_to(&wrong).to_degrees() - 30.6).abs() < 0.1, "{}", right.angle_to(&wrong).to_degrees());
    }

    #[test]
    fn e15_e16_object_position_is_the_translation_of_its_pose() {
        let (_, _, t_second_object) = example();
        let origin = t_second_object.transform(&Point3::origin());
        assert_eq!(origin.coords, t_second_object.translation);
    }

    #[test]
    fn e17_e18_the_chain_equals_its_steps_applied_in_turn() {
        let (t_camera_first, t_first_second, t_second_object) = example();
        let chain = object_in_camera(&t_camera_first, &t_first_second, &t_second_object);
        for p in [Point3::new(0.0, 0.0, 0.0), Point3::new(0.3, -0.1, 0.2)] {
            let by_steps = t_camera_first.transform(&t_first_second.transform(&t_second_object.transform(&p)));
            assert!((chain.transform(&p) - by_steps).norm() < 1e-12);
        }
        // Without the translation between the views, the object would be off by exactly that much.
        let still = Pose::new(t_first_second.rotation, Vector3::zeros());
        let off = object_in_camera(&t_camera_first, &still, &t_second_object).translation - chain.translation;
        assert!((off.norm() - t_first_second.translation.norm()).abs() < 1e-12);
    }

    #[test]
    fn the_documented_chain_example_is_right() {
        let t_second_object = Pose::<SecondView, Body>::new(UnitQuaternion::identity(), Vector3::new(-0.4, 0.2, 5.0));
        let t_first_second = Pose::<FirstView, SecondView>::new(rotation_xyz(0.0, 0.4, 0.0), Vector3::new(1.5, -0.1, 0.3));
        let found = object_in_camera(&Pose::identity(), &t_first_second, &t_second_object).translation;
        assert!((found - Vector3::new(3.079, 0.1, 5.061)).norm() < 1e-3, "{found}");
    }

    #[test]
    fn e19_the_chain_is_rigid() {
        let (t_camera_first, t_first_second, t_second_object) = example();
        let matrix = object_in_camera(&t_camera_first, &t_first_second, &t_second_object).matrix();
        let rotation = matrix.fixed_view::<3, 3>(0, 0).into_owned();
        assert!((rotation.transpose() * rotation - Matrix3::identity()).amax() < 1e-12 && (rotation.determinant() - 1.0).abs() < 1e-12);
        assert_eq!(matrix.row(3).iter().copied().collect::<Vec<_>>(), [0.0, 0.0, 0.0, 1.0]);
    }

    #[test]
    fn e20_camera_position_enters_through_the_inverse_pose() {
        // The camera stands 2 m right of the first view and looks the same way: a point straight
        // ahead of that view is 2 m to the camera's left.
        let t_first_camera = Pose::<FirstView, Camera>::new(UnitQuaternion::identity(), Vector3::new(2.0, 0.0, 0.0));
        let seen = t_first_camera.inverse().transform(&Point3::new(0.0, 0.0, 4.0));
        assert!((seen - Point3::new(-2.0, 0.0, 4.0)).norm() < 1e-12);
    }

    #[test]
    fn e32_the_view_distance_is_the_stated_baseline() {
        let motion = TwoViewMotion { rotation: rotation_xyz(0.1, 0.2, -0.1), direction: Vector3::new(0.6, 0.0, 0.8) };
        let pose = first_from_second(&motion, 0.25);
        assert!((pose.translation.norm() - 0.25).abs() < 1e-12);
        let p = Point3::new(0.2, 0.1, 3.0);
        let second = motion.rotation * p + motion.direction * 0.25;
        assert!((pose.transform(&second) - p).norm() < 1e-12);
    }
}
