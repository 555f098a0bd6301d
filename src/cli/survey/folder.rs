//! Writes a surveyed stage's folder as a whole, or leaves it as it was.

use std::fs;
use std::path::Path;

use super::super::failure::Failure;
use crate::camera::{Calibration, CalibrationForm};
use crate::config::Settings;
use crate::config::shape_file;
use crate::config::surveyed::{CALIBRATION, SurveyedSurface};
use crate::safe_file;
use crate::survey::walked::stage::Survey;
use crate::track::SurfaceShape;
use crate::utc;

/// Name of the marker file of a survey's folder.
const MARK: &str = ".stagepose-survey";

/// Refuses a folder that holds anything but an earlier survey.
pub(super) fn refuse_unusable(folder: &Path) -> Result<(), Failure> {
    match fs::read_dir(folder) {
        Ok(mut entries) => match folder.join(MARK).exists() || entries.next().is_none() {
            true => Ok(()),
            false => Err(Failure::Usage(format!("{}: holds files that no earlier survey wrote; give a new folder", folder.display()))),
        },
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(()),
        Err(e) => Err(Failure::Output { file: folder.to_owned(), source: e }),
    }
}

/// Writes a surveyed stage; an earlier one is replaced as a whole.
pub(super) fn write(folder: &Path, settings: &Settings, made: &Survey) -> Result<(), Failure> {
    let files = files(settings, made).map_err(Failure::output(folder))?;
    let name = folder.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let [beside, old] = ["new", "old"].map(|word| folder.with_file_name(format!(".{name}.{word}")));
    let written = (|| {
        put_back(&old, folder)?;
        // Leftovers of a killed run would mix with this run's files.
        remove(&beside)?;
        remove(&old)?;
        fs::create_dir_all(&beside)?;
        for (name, bytes) in files {
            safe_file::write_whole(&beside.join(name), &bytes)?;
        }
        safe_file::write_whole(&beside.join(MARK), b"")?;
        replace(folder, &beside, &old)
    })();
    if written.is_err() {
        // The leftovers are useless. If even this fails, the first error is the one to report.
        let _ = fs::remove_dir_all(&beside);
    }
    written.map_err(Failure::output(folder))
}

/// Moves the new folder to the place of the earlier one, which is removed only after that has
/// succeeded.
fn replace(folder: &Path, new: &Path, old: &Path) -> std::io::Result<()> {
    if folder.exists() {
        fs::rename(folder, old)?;
    }
    if let Err(e) = fs::rename(new, folder) {
        put_back(old, folder)?;
        return Err(e);
    }
    remove(old)
}

/// Restores an earlier survey that was moved aside if nothing took its place: a run may have been
/// killed in between.
fn put_back(old: &Path, folder: &Path) -> std::io::Result<()> {
    if old.exists() && !folder.exists() { fs::rename(old, folder) } else { Ok(()) }
}

/// Removes a folder if it exists.
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
        notes: Vec::new(),
    };
    debug_assert_eq!(CALIBRATION, "camera.toml");
    let shutter = (made.shutter != settings.shutter.or_zero()).then_some(made.shutter);
    settings.source.surveyed(&settings.first_as_typed, &surfaces, calibration.to_toml(), shutter)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_replacement_restores_the_earlier_survey() {
        let room = tempfile::tempdir().unwrap();
        let [folder, new, old] = ["stage", ".stage.new", ".stage.old"].map(|name| room.path().join(name));
        fs::create_dir(&folder).unwrap();
        fs::write(folder.join("stage.toml"), "earlier").unwrap();
        // There is no new folder.
        assert!(replace(&folder, &new, &old).is_err());
        assert_eq!(fs::read_to_string(folder.join("stage.toml")).unwrap(), "earlier");
        // A run was killed between the two steps.
        fs::rename(&folder, &old).unwrap();
        put_back(&old, &folder).unwrap();
        assert_eq!(fs::read_to_string(folder.join("stage.toml")).unwrap(), "earlier");
        fs::create_dir(&new).unwrap();
        fs::write(new.join("stage.toml"), "new").unwrap();
        replace(&folder, &new, &old).unwrap();
        assert_eq!(fs::read_to_string(folder.join("stage.toml")).unwrap(), "new");
        assert!(!old.exists() && !new.exists());
    }
}
