//! The folder of a surveyed stage: whole, or as it was before.

use std::fs;
use std::path::Path;

use super::super::failure::Failure;
use crate::camera::{Calibration, CalibrationForm};
use crate::config::Settings;
use crate::config::shape_file;
use crate::config::surveyed::{CALIBRATION, SurveyedSurface};
use crate::safe_file;
use crate::survey::stage::Survey;
use crate::track::SurfaceShape;
use crate::utc;

/// What shows that a folder is an earlier survey's.
const MARK: &str = ".stagepose-survey";

/// Refuses a folder that holds anything but an earlier survey.
pub(super) fn refuse_unusable(folder: &Path) -> Result<(), Failure> {
    match fs::read_dir(folder) {
        Ok(mut entries) => match folder.join(MARK).exists() || entries.next().is_none() {
            true => Ok(()),
            false => Err(Failure::Usage(format!("{}: holds files that are not of an earlier survey; give a new folder", folder.display()))),
        },
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(()),
        Err(e) => Err(Failure::Output { file: folder.to_owned(), source: e }),
    }
}

/// Writes a surveyed stage; an earlier one is replaced as a whole.
pub(super) fn write(folder: &Path, settings: &Settings, made: &Survey) -> Result<(), Failure> {
    let files = files(settings, made).map_err(Failure::output(folder))?;
    let name = folder.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let [beside, aside] = ["new", "old"].map(|word| folder.with_file_name(format!(".{name}.{word}")));
    let written = (|| {
        // What a run that was killed has left would mix with this one's files.
        remove(&beside)?;
        remove(&aside)?;
        fs::create_dir_all(&beside)?;
        for (name, bytes) in files {
            safe_file::write_whole(&beside.join(name), &bytes)?;
        }
        safe_file::write_whole(&beside.join(MARK), b"")?;
        // The earlier one goes only when this one is in its place.
        if folder.exists() {
            fs::rename(folder, &aside)?;
        }
        fs::rename(&beside, folder)?;
        remove(&aside)
    })();
    if written.is_err() {
        // What is left of it is of no use; where even that fails, the first reason is the one to say.
        let _ = fs::remove_dir_all(&beside);
    }
    written.map_err(Failure::output(folder))
}

/// Removes a folder, if it is there.
fn remove(folder: &Path) -> std::io::Result<()> {
    fs::remove_dir_all(folder).or_else(|e| if e.kind() == std::io::ErrorKind::NotFound { Ok(()) } else { Err(e) })
}

fn files(settings: &Settings, made: &Survey) -> std::io::Result<Vec<(String, Vec<u8>)>> {
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
    };
    debug_assert_eq!(CALIBRATION, "camera.toml");
    settings.source.surveyed(&settings.first_as_typed, &surfaces, calibration.to_toml())
}
