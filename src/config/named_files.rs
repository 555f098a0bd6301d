//! The files that a config names: the calibrations, the mask, the surfaces' pictures.

use std::path::{Path, PathBuf};

use toml::Spanned;

use super::as_typed::{Config, Surface};

/// What a config means by a file name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FileKind {
    /// A calibration.
    Calibration,
    /// The mask, artwork or a photograph.
    Picture,
}

/// Every file name in a config, in the order of its tables.
pub(super) fn named_files(typed: &Config) -> Vec<(&Spanned<String>, FileKind)> {
    use FileKind::{Calibration, Picture};
    let mut named: Vec<(Option<&Spanned<String>>, FileKind)> = Vec::new();
    if let Some(camera) = &typed.camera {
        let camera = camera.get_ref();
        named.extend([(camera.calibration.as_ref(), Calibration), (camera.mask.as_ref(), Picture)]);
    }
    named.extend(typed.mount.iter().map(|mount| (mount.get_ref().calibration.as_ref(), Calibration)));
    let of_stage = typed.stage.iter().flat_map(|stage| &stage.get_ref().surface);
    let of_objects = typed.object.iter().flat_map(|object| &object.get_ref().surface);
    for surface in of_stage.chain(of_objects) {
        let Surface { image, photo, photo_calibration, .. } = surface.get_ref();
        named.extend([(image.as_ref(), Picture), (photo.as_ref(), Picture), (photo_calibration.as_ref(), Calibration)]);
    }
    named.into_iter().filter_map(|(name, kind)| Some((name?, kind))).collect()
}

/// The paths of the files that a config names, whether they are there or not; none where the text is no config.
pub fn files_named_in(text: &str, file: &Path) -> Vec<(PathBuf, FileKind)> {
    let folder = file.parent().unwrap_or(Path::new(""));
    let Ok(typed) = Config::parse(text, file) else { return Vec::new() };
    named_files(&typed).into_iter().map(|(name, kind)| (folder.join(name.get_ref()), kind)).collect()
}
