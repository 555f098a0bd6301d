//! Poses of things that stand upright on the stage and face the audience.

use nalgebra::{UnitQuaternion, Vector3};

use crate::geometry::{Body, Pose, SurfaceFrame};

/// Returns `T_body_surface` of a surface that stands upright with its centre at `position` (metres)
/// and faces the audience, turned by `rotation_rad` about the vertical (positive: the face turns
/// towards stage x).
pub fn upright(position: Vector3<f64>, rotation_rad: f64) -> Pose<Body, SurfaceFrame> {
    let stand = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::FRAC_PI_2);
    Pose::new(UnitQuaternion::from_axis_angle(&Vector3::z_axis(), rotation_rad) * stand, position)
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;

    #[test]
    fn an_upright_surface_faces_the_audience() {
        let pose = upright(Vector3::new(0.0, 0.0, 1.0), 0.0);
        assert!((pose.rotation * Vector3::z() + Vector3::y()).norm() < 1e-12);
        assert!((pose.transform(&Point3::new(0.0, 2.0, 0.0)) - Point3::new(0.0, 0.0, 3.0)).norm() < 1e-12);
        let s = std::f64::consts::FRAC_1_SQRT_2;
        assert!(pose.orientation_xyzw().iter().zip([s, 0.0, 0.0, s]).all(|(a, b)| (a - b).abs() < 1e-12));
        assert!((upright(Vector3::zeros(), 0.3).rotation * Vector3::z()).x > 0.0);
    }
}
