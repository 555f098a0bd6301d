//! A copy of a config with everything that it names, so that a recording can be replayed anywhere and at any time.

use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};

use toml::Spanned;

use super::as_typed::{Config, Surface};

/// Copies a config as `stage.toml` into a folder, with the files that it names beside it and named anew in it.
///
/// # Errors
/// When something cannot be read or written, or when the config is none.
pub fn copy_config(file: &Path, into: &Path) -> io::Result<PathBuf> {
    let text = std::fs::read_to_string(file)?;
    let typed = Config::parse(&text, file).map_err(io::Error::other)?;
    std::fs::create_dir_all(into)?;
    let mut named = named_files(&typed);
    // From the end, so that the spans in front stay where they are.
    named.sort_by_key(|(_, span)| std::cmp::Reverse(span.start));
    let mut copy = text.clone();
    for (number, (name, span)) in named.iter().enumerate() {
        let from = file.parent().unwrap_or(Path::new("")).join(name);
        let base = from.file_name().and_then(|n| n.to_str()).unwrap_or("file");
        let new = format!("{number}-{base}");
        std::fs::copy(&from, into.join(&new))?;
        copy.replace_range(span.clone(), &toml::Value::String(new).to_string());
    }
    let target = into.join("stage.toml");
    std::fs::write(&target, copy)?;
    Ok(target)
}

/// Every file that a config names, with the place of its name in the text.
fn named_files(typed: &Config) -> Vec<(String, Range<usize>)> {
    let mut named: Vec<Option<&Spanned<String>>> = Vec::new();
    if let Some(camera) = &typed.camera {
        named.extend([camera.get_ref().calibration.as_ref(), camera.get_ref().mask.as_ref()]);
    }
    let of_stage = typed.stage.iter().flat_map(|stage| &stage.get_ref().surface);
    let of_objects = typed.object.iter().flat_map(|object| &object.get_ref().surface);
    for surface in of_stage.chain(of_objects) {
        let Surface { image, photo, photo_calibration, .. } = surface.get_ref();
        named.extend([image.as_ref(), photo.as_ref(), photo_calibration.as_ref()]);
    }
    named.into_iter().flatten().map(|name| (name.get_ref().clone(), name.span())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Settings;

    #[test]
    fn a_copy_of_the_fixture_loads_alone_and_means_the_same() {
        let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/dolly/stage.toml");
        let folder = tempfile::tempdir().unwrap();
        let copy = copy_config(&fixture, folder.path()).unwrap();
        let (was, is) = (Settings::load(&fixture).unwrap(), Settings::load(&copy).unwrap());
        assert_eq!((was.camera, was.exposure_s, was.readout_s), (is.camera, is.exposure_s, is.readout_s));
        assert_eq!(was.stage.surfaces.len(), is.stage.surfaces.len());
        for (a, b) in was.stage.surfaces.iter().zip(&is.stage.surfaces) {
            assert_eq!((a.artwork.as_raw(), a.size_m), (b.artwork.as_raw(), b.size_m));
        }
        assert!(copy_config(Path::new("no such file"), folder.path()).is_err());
    }
}
