//! The files of a surveyed stage's folder.

use crate::camera::{Calibration, CalibrationForm};
use crate::config::Settings;
use crate::config::shape_file;
use crate::config::surveyed::{CALIBRATION, SurveyedSurface};
use crate::survey::walked::stage::Survey;
use crate::track::SurfaceShape;
use crate::utc;

/// Returns the files of a surveyed stage.
pub(super) fn files(settings: &Settings, made: &Survey) -> std::io::Result<Vec<(String, Vec<u8>)>> {
    let first = made.surfaces[0].pose;
    let surface = |(k, spec): (usize, &crate::track::SurfaceSpec)| SurveyedSurface {
        t_first_surface: (k > 0).then(|| first.inverse() * spec.pose),
        shape: match &spec.shape {
            SurfaceShape::Bent(shape) => shape_file::write(shape, &spec.artwork, spec.size_m),
            _ => String::new(),
        },
    };
    let surfaces: Vec<SurveyedSurface> = made.surfaces.iter().enumerate().map(surface).collect();
    let calibration = Calibration {
        model: made.camera,
        uncertainty: made.camera.doubt().map(|doubt| doubt.uncertainty),
        rms_px: None,
        images: None,
        date: Some(utc::date(utc::now_s())),
        form: CalibrationForm::Stagepose,
        notes: Vec::new(),
    };
    debug_assert_eq!(CALIBRATION, "camera.toml");
    let shutter = (made.shutter != settings.shutter.or_zero()).then_some(made.shutter);
    settings.source.surveyed(&settings.first_as_typed, &surfaces, calibration.to_toml(), shutter)
}
