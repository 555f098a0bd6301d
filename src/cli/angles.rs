//! Formats poses and rotations for people on a stage: metres and degrees.

use nalgebra::UnitQuaternion;

use crate::geometry::{Body, Camera, Pose, Stage, SurfaceFrame};
use crate::protocols::{PanTiltRoll, to_body_axes};

/// Returns the pose of the camera's body as text. A level camera that looks upstage gives
/// "at +0.0000 -4.0000 +1.6000 m, pan +0.00 tilt +0.00 roll +0.00 degrees".
pub(super) fn camera_words(t_stage_camera: &Pose<Stage, Camera>) -> String {
    let p = t_stage_camera.translation;
    format!("at {:+.4} {:+.4} {:+.4} m, {}", p.x, p.y, p.z, angle_words(t_stage_camera))
}

/// Returns the angles alone as text.
pub(super) fn angle_words(t_stage_camera: &Pose<Stage, Camera>) -> String {
    let [pan, tilt, roll] = camera_angles(t_stage_camera);
    format!("pan {pan:+.2} tilt {tilt:+.2} roll {roll:+.2} degrees")
}

/// Returns pan, tilt and roll of the camera's body, in degrees.
pub(super) fn camera_angles(t_stage_camera: &Pose<Stage, Camera>) -> [f64; 3] {
    angles(&to_body_axes(t_stage_camera).rotation)
}

/// Returns a surface's `rotation_deg`: turn, tilt and roll.
pub(super) fn surface_angles(t_body_surface: &Pose<Body, SurfaceFrame>) -> [f64; 3] {
    // An upright surface that faces the audience has all angles zero; its normal is the frame's -y.
    let upright = UnitQuaternion::from_axis_angle(&nalgebra::Vector3::x_axis(), std::f64::consts::FRAC_PI_2);
    let [turn, tilt, roll] = angles(&(t_body_surface.rotation * upright.inverse()));
    [turn, tilt, 0.0 - roll]
}

/// Returns pan, tilt and roll of a rotation in degrees, rounded to hundredths, never as -0.
pub(super) fn angles(rotation: &UnitQuaternion<f64>) -> [f64; 3] {
    let PanTiltRoll { pan_deg, tilt_deg, roll_deg } = PanTiltRoll::of_rotation(rotation, 0.0);
    // `+ 0.0` keeps a rounded zero from being printed as -0.00.
    [pan_deg, tilt_deg, roll_deg].map(|degrees| (degrees * 100.0).round() / 100.0 + 0.0)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use nalgebra::{Quaternion, Vector3};

    use super::*;
    use crate::config::Settings;

    #[test]
    fn the_golden_pose_is_level() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(half, -half, 0.0, 0.0));
        let golden = Pose::new(rotation, Vector3::new(0.0, -4.0, 0.0));
        assert_eq!(camera_words(&golden), "at +0.0000 -4.0000 +0.0000 m, pan +0.00 tilt +0.00 roll +0.00 degrees");
    }

    #[test]
    fn a_surface_has_the_angles_that_its_config_gives() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/dolly/stage.toml");
        for angles in [[0.0, 0.0, 0.0], [20.0, 0.0, 0.0], [0.0, -90.0, 0.0], [-35.5, 12.25, 60.0], [150.0, 80.0, -170.0]] {
            let text = format!(
                "[camera]\ncalibration = \"camera.toml\"\n[[stage.surface]]\nimage = \"flat.png\"\nsize_m = [1.1, 1.7]\nrotation_deg = {angles:?}\n"
            );
            let settings = Settings::from_text(&text, &file).unwrap();
            assert_eq!(surface_angles(&settings.stage.surfaces[0].pose), angles);
        }
    }
}
