//! Describes the lens' source and what its uncertainty means for the poses.

use crate::camera::{CameraModel, LensGuess};
use crate::config::LensSource;

/// Returns the name of the lens' source.
pub(super) fn source(lens: &LensSource) -> String {
    match lens {
        LensSource::Calibration(file) => file.display().to_string(),
        LensSource::Guess(guess, size) => {
            let from = match guess {
                LensGuess::FieldOfView(degrees) => format!("guessed from fov_deg = {degrees}"),
                LensGuess::FilmFocalLength(mm) => format!("guessed from focal_35mm_mm = {mm}"),
            };
            if size.is_some() { from } else { format!("{from}, for pictures of any size") }
        }
    }
}

/// Describes the lens' uncertainty and its effect at a distance.
pub(super) fn doubt(lens: &LensSource, camera: &CameraModel) -> Vec<String> {
    let Some(doubt) = camera.doubt() else { return Vec::new() };
    let (i, u) = (camera.intrinsics(), doubt.uncertainty);
    let share = (u.focal_px[0] / i.fx).max(u.focal_px[1] / i.fy) / 3.0;
    let (across, down) = (u.centre_px[0] / 3.0, u.centre_px[1] / 3.0);
    let uncertain = format!(
        "one sigma: focal length {:.2} %, principal point {across:.1} x {down:.1} px; distances are uncertain by {:.2} % ({:.1} cm at 4 \
         m), which covariances include",
        100.0 * share,
        100.0 * share,
        400.0 * share
    );
    match lens {
        LensSource::Calibration(_) => vec![uncertain],
        LensSource::Guess(guess, _) => {
            let hint = match guess {
                LensGuess::FieldOfView(_) => {
                    "a guess for a first look, without distortion (fov_deg is across the width; makers often give the diagonal); then: stagepose calibrate"
                }
                LensGuess::FilmFocalLength(_) => {
                    "a guess for a first look, without distortion (films are cropped from a phone's pictures, which makes it longer); then: stagepose calibrate"
                }
            };
            vec![uncertain, hint.to_owned()]
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_guessed_lens_reports_its_uncertainty() {
        let guess = LensGuess::FieldOfView(60.0);
        let lens = LensSource::Guess(guess, None);
        assert_eq!(source(&lens), "guessed from fov_deg = 60, for pictures of any size");
        let lines = doubt(&lens, &guess.camera(1280, 720).unwrap()).join("\n");
        for part in ["focal length 3.00 %", "principal point 25.6 x 25.6 px", "12.0 cm at 4 m", "the diagonal", "stagepose calibrate"] {
            assert!(lines.contains(part), "`{part}` is not in\n{lines}");
        }
        let sure = CameraModel::pinhole(640, 480, 600.0, 600.0, 319.5, 239.5).unwrap();
        assert_eq!(doubt(&LensSource::Calibration("c.toml".into()), &sure), Vec::<String>::new());
    }
}
