//! `[camera.pose]`: a camera that stands still.

use nalgebra::{Matrix6, Vector3};
use toml::Spanned;

use super::as_typed;
use super::rotation::Turned;
use super::values::Section;
use super::{ConfigError, Problem};
use crate::geometry::Pose;
use crate::pose::FixedCamera;

/// The section's name in messages.
const POSE: &str = "[camera.pose]";

/// Reads the pose and its doubt.
pub(super) fn fixed(section: &Section<'_>, typed: &Spanned<as_typed::CameraPose>) -> Result<FixedCamera, ConfigError> {
    let (section, pose) = (Section { origin: section.origin, name: POSE }, typed.get_ref());
    let missing = |key, hint| section.origin.missing(section.origin.section_at(POSE, &typed.span()), key, hint);
    if pose.position_m.is_none() {
        return Err(missing("position_m", "the camera's place in the stage, such as position_m = [0.0, -4.0, 1.6]"));
    }
    let position: Vector3<f64> = section.position("position_m", pose.position_m.as_ref())?;
    let rotation = Turned::Camera.typed(&section, pose.orientation_xyzw.as_ref(), pose.rotation_deg.as_ref())?;
    let covariance = match (&pose.covariance, &pose.position_sigma_m, &pose.rotation_sigma_deg) {
        (Some(typed), None, None) => covariance(&section, typed)?,
        (Some(typed), ..) => {
            let problem = "a pose has either `covariance` or the two sigmas, this one has both; remove one";
            return Err(section.conflict("covariance", typed, problem));
        }
        (None, Some(_), Some(_)) => by_sigmas(&section, pose)?,
        _ => {
            let hint = "how far the pose may be off, one sigma: position_sigma_m and rotation_sigma_deg, or `covariance` as \
                        `stagepose freeze` prints it";
            return Err(missing(if pose.position_sigma_m.is_none() { "position_sigma_m" } else { "rotation_sigma_deg" }, hint));
        }
    };
    Ok(FixedCamera { pose: Pose::new(rotation, position), covariance })
}

fn by_sigmas(section: &Section<'_>, pose: &as_typed::CameraPose) -> Result<Matrix6<f64>, ConfigError> {
    let sigma = |key, typed, most: f64, wanted| section.number(key, typed, 0.0, |v| v > 0.0 && v <= most, wanted);
    let shift = sigma("position_sigma_m", pose.position_sigma_m.as_ref(), 1.0, "metres above 0, at most 1")?;
    let rotation = sigma("rotation_sigma_deg", pose.rotation_sigma_deg.as_ref(), 10.0, "degrees above 0, at most 10")?.to_radians();
    let variance = |k: usize| if k < 3 { shift * shift } else { rotation * rotation };
    Ok(Matrix6::from_fn(|row, column| if row == column { variance(row) } else { 0.0 }))
}

/// Reads 36 numbers, row by row.
fn covariance(section: &Section<'_>, typed: &Spanned<as_typed::Exactly<as_typed::Number, 36>>) -> Result<Matrix6<f64>, ConfigError> {
    let matrix = Matrix6::from_row_slice(&typed.get_ref().values());
    let scale = matrix.amax();
    let is_symmetric = (matrix - matrix.transpose()).amax() <= 1e-6 * scale;
    let symmetric = (matrix + matrix.transpose()) * 0.5;
    if scale.is_finite() && is_symmetric && symmetric.cholesky().is_some() {
        return Ok(symmetric);
    }
    let wanted = "36 numbers of a symmetric, positive definite matrix, row by row, as `stagepose freeze` prints it";
    Err(section.refuse("covariance", &typed.span(), Problem::Range { value: "this matrix".to_owned(), wanted }))
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::super::tests::fill;
    use super::*;
    use crate::config::Settings;

    const OBJECT: &str = "[[object]]\nname = \"cart\"\n[[object.surface]]\nimage = \"art.png\"\nsize_m = [1, 1]\n";

    fn load(pose: &str) -> Result<Settings, String> {
        let folder = tempfile::tempdir().unwrap();
        fill(folder.path());
        let file = folder.path().join("stage.toml");
        std::fs::write(&file, format!("[camera]\ncalibration = \"camera.toml\"\n[camera.pose]\n{pose}\n{OBJECT}")).unwrap();
        Settings::load(&file).map_err(|e| e.to_string().split_once("stage.toml: ").unwrap().1.to_owned())
    }

    const SIGMAS: &str = "position_sigma_m = 0.002\nrotation_sigma_deg = 0.1\n";

    #[test]
    fn a_fixed_camera_needs_no_stage() {
        let settings = load(&format!("position_m = [0, -4, 0]\n{SIGMAS}")).unwrap();
        let fixed = settings.fixed.unwrap();
        assert!(settings.stage.surfaces.is_empty() && settings.tracker_setup(64, 48).unwrap().0.fixed == Some(fixed));
        assert!((fixed.covariance[(0, 0)] - 4e-6).abs() < 1e-15 && (fixed.covariance[(5, 5)].sqrt().to_degrees() - 0.1).abs() < 1e-12);
        // The default is the golden orientation; angles are pan (to the left), tilt and roll.
        let level = fixed.pose.rotation;
        assert!((level * Vector3::z() - Vector3::y()).norm() < 1e-12 && (level * Vector3::y() + Vector3::z()).norm() < 1e-12);
        let panned = load(&format!("position_m = [0, -4, 0]\nrotation_deg = [90, 0, 0]\n{SIGMAS}")).unwrap().fixed.unwrap().pose.rotation;
        assert!((panned * Vector3::z() + Vector3::x()).norm() < 1e-12);
        let quaternion = load(&format!("position_m = [0, -4, 0]\norientation_xyzw = [0, 0, 0, 1]\n{SIGMAS}")).unwrap().fixed.unwrap();
        assert!(quaternion.pose.rotation.angle_to(&UnitQuaternion::identity()) < 1e-12);
        let diagonal: Vec<String> = (0..36).map(|k| if k % 7 == 0 { "1e-6" } else { "0" }.to_owned()).collect();
        let whole = load(&format!("position_m = [0, -4, 0]\ncovariance = [{}]\n", diagonal.join(", "))).unwrap().fixed.unwrap();
        assert_eq!(whole.covariance, Matrix6::identity() * 1e-6);
    }

    #[test]
    fn mistakes_are_named_with_their_line() {
        let zeros = vec!["0"; 36].join(", ");
        for (pose, wanted) in [
            (SIGMAS.to_owned(), "[camera.pose], line 3, has no `position_m`"),
            ("position_m = [0, 0, 0]".to_owned(), "[camera.pose], line 3, has no `position_sigma_m`"),
            ("position_m = [0, 0, 0]\nposition_sigma_m = 0.01".to_owned(), "[camera.pose], line 3, has no `rotation_sigma_deg`"),
            (format!("position_m = [0, 0, 0]\n{SIGMAS}covariance = [{zeros}]"), "`covariance` in [camera.pose], line 7: a pose has either"),
            (
                format!("position_m = [0, 0, 0]\ncovariance = [{zeros}]"),
                "`covariance` in [camera.pose], line 5: this matrix cannot be used",
            ),
            (
                "position_m = [0, 0, 0]\nposition_sigma_m = 0\nrotation_sigma_deg = 0.1".to_owned(),
                "`position_sigma_m` in [camera.pose], line 5: 0 cannot be used; give metres above 0",
            ),
            (
                format!("position_m = [0, 0, 0]\nrotation_deg = [0, 0, 0]\norientation_xyzw = [0, 0, 0, 1]\n{SIGMAS}"),
                "`rotation_deg` in [camera.pose], line 5: a camera has either",
            ),
            ("position = [0, 0, 0]".to_owned(), "unknown key `position` in [camera.pose], line 4; did you mean `position_m`?"),
        ] {
            let said = load(&pose).map(|_| ()).unwrap_err();
            assert!(said.starts_with(wanted), "{pose}\n{said}");
        }
    }
}
