//! Reads a picture to compare, and the calibration of the camera that took it.

use std::path::Path;

use image::GrayImage;

use super::CompareArguments;
use crate::camera::CameraModel;
use crate::capture::{CaptureError, MAX_PICTURE_FILE, decode_on_white, orientation_words};
use crate::cli::failure::Failure;
use crate::compare::View;
use crate::config::read_calibration;
use crate::safe_file;

/// A picture with what is known about it.
pub(in crate::cli) struct NamedPicture {
    /// Grey levels, as they lie in the file.
    pub picture: GrayImage,
    /// The camera that took it.
    pub camera: Option<CameraModel>,
    /// A note to print with the result.
    pub note: Option<String>,
}

impl NamedPicture {
    /// Returns what is compared.
    pub fn view(&self) -> View<'_> {
        View { picture: &self.picture, camera: self.camera.as_ref() }
    }
}

/// Reads both pictures.
pub(super) fn views(arguments: &CompareArguments) -> Result<[NamedPicture; 2], Failure> {
    let camera_b = arguments.camera_b.as_ref().or(arguments.camera.as_ref());
    Ok([with_camera(&arguments.a, arguments.camera.as_deref())?, with_camera(&arguments.b, camera_b.map(|p| p.as_path()))?])
}

fn with_camera(file: &Path, calibration: Option<&Path>) -> Result<NamedPicture, Failure> {
    let mut named = read_picture(file)?;
    let Some(calibration) = calibration else { return Ok(named) };
    let camera = read_calibration(calibration).map_err(|e| Failure::Usage(e.to_string()))?.model;
    let size = named.picture.dimensions();
    if size != (camera.width(), camera.height()) {
        return Err(Failure::Usage(format!(
            "{}: is for pictures of {} x {} pixels, but {} has {} x {}; give the calibration of the camera that took it, at this size",
            calibration.display(),
            camera.width(),
            camera.height(),
            file.display(),
            size.0,
            size.1
        )));
    }
    named.camera = Some(camera);
    Ok(named)
}

/// Reads a picture as its pixels lie in the file, which is how a calibration counts them.
pub(in crate::cli) fn read_picture(file: &Path) -> Result<NamedPicture, Failure> {
    let bytes = safe_file::read(file, MAX_PICTURE_FILE).map_err(|source| CaptureError::NotReadable { path: file.to_owned(), source })?;
    let (picture, orientation, unseen) =
        decode_on_white(&bytes).map_err(|e| Failure::Picture { file: file.to_owned(), reason: e.to_string() })?;
    let turned = orientation_words(orientation)
        .map(|turned| format!("EXIF says to show {} {turned}; it is compared as stored in the file", file.display()));
    let see_through =
        (unseen > 0.0).then(|| format!("{:.1} % of {} is transparent, which is treated as white paper", 100.0 * unseen, file.display()));
    let notes: Vec<String> = turned.into_iter().chain(see_through).collect();
    let note = (!notes.is_empty()).then(|| notes.join("; "));
    Ok(NamedPicture { picture, camera: None, note })
}
