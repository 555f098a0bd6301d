//! The files that a config names (calibrations, the mask, the surfaces' pictures and shapes, the
//! map), and a copy of the config with all of them, so that a recording can be replayed anywhere
//! and at any time.

use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};

use toml::Spanned;
use toml::de::DeTable;

use super::ConfigSource;
use super::as_typed::{Config, Surface};

/// The kind of file that a name refers to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FileKind {
    /// A calibration.
    Calibration,
    /// The mask, artwork or a photograph.
    Picture,
    /// A surface's shape.
    Shape,
    /// The map of the stage.
    Map,
}

/// Returns every file name in a config, in the order of its tables.
pub(super) fn named_files(typed: &Config) -> Vec<(&Spanned<String>, FileKind)> {
    use FileKind::{Calibration, Map, Picture, Shape};
    let mut named: Vec<(Option<&Spanned<String>>, FileKind)> = Vec::new();
    if let Some(camera) = &typed.camera {
        let camera = camera.get_ref();
        named.extend([(camera.calibration.as_ref(), Calibration), (camera.mask.as_ref(), Picture)]);
    }
    named.extend(typed.mount.iter().map(|mount| (mount.get_ref().calibration.as_ref(), Calibration)));
    let maps = typed.stage.iter().filter_map(|stage| stage.get_ref().map.as_ref());
    named.extend(maps.map(|map| (map.get_ref().file.as_ref(), Map)));
    let of_stage = typed.stage.iter().flat_map(|stage| &stage.get_ref().surface);
    let of_objects = typed.object.iter().flat_map(|object| &object.get_ref().surface);
    for surface in of_stage.chain(of_objects) {
        let Surface { image, photo, photo_calibration, shape, .. } = surface.get_ref();
        named.extend([
            (image.as_ref(), Picture),
            (photo.as_ref(), Picture),
            (photo_calibration.as_ref(), Calibration),
            (shape.as_ref(), Shape),
        ]);
    }
    named.into_iter().filter_map(|(name, kind)| Some((name?, kind))).collect()
}

/// Returns the paths of the files that a config names, whether they exist or not; none if the text
/// is not a config.
pub fn files_named_in(text: &str, file: &Path) -> Vec<(PathBuf, FileKind)> {
    let folder = file.parent().unwrap_or(Path::new(""));
    let Ok(typed) = Config::parse(text, file) else { return Vec::new() };
    named_files(&typed).into_iter().map(|(name, kind)| (folder.join(name.get_ref()), kind)).collect()
}

/// Returns a config's text with every file name that it has relative to its own folder named below
/// `folder` instead; `None` if the text is not a config.
pub fn named_below(text: &str, folder: &Path) -> Option<String> {
    let typed = Config::parse(text, Path::new("stage.toml")).ok()?;
    let below = |name: &str| toml::Value::String(folder.join(name).to_string_lossy().into_owned()).to_string();
    let changes = named_files(&typed).into_iter().map(|(named, _)| (named.span(), below(named.get_ref()))).collect();
    Some(with_changes(text, changes))
}

/// Returns a text after changes at places that do not overlap.
fn with_changes(text: &str, mut changes: Vec<Change>) -> String {
    // Apply changes from the end, so that earlier spans stay valid.
    changes.sort_by_key(|(span, _)| std::cmp::Reverse((span.start, span.end)));
    let mut changed = text.to_owned();
    for (span, new) in changes {
        changed.replace_range(span, &new);
    }
    changed
}

/// A file of a copy: its name in the copy's folder, and its bytes.
pub type CopiedFile = (String, Vec<u8>);
/// A change of a config's text: the range to replace, and its replacement.
pub(super) type Change = (Range<usize>, String);

impl ConfigSource {
    /// Returns the config as it was read, named `stage.toml`, and the files it names, renamed in
    /// it, to be written into one folder.
    ///
    /// `exposure_s` is the camera's own exposure, which the tracker used if the config leaves it
    /// open. The copy must state it, so that a replay gives the same poses.
    ///
    /// # Errors
    /// Only if the program has a defect: the text was read as a config before.
    pub fn copy(&self, exposure_s: Option<f64>) -> io::Result<Vec<CopiedFile>> {
        let typed = Config::parse(&self.text, &self.file).map_err(io::Error::other)?;
        let (mut files, mut changes) = self.named_anew(&typed, |_| false)?;
        changes.extend(exposure_s.and_then(|exposure_s| self.exposure(&typed, exposure_s)));
        files.push(self.changed(changes));
        Ok(files)
    }

    /// Returns copies of the files that the config names, except at spans that `is_spared` accepts,
    /// and the changes that name the copies.
    pub(super) fn named_anew(
        &self,
        typed: &Config,
        is_spared: impl Fn(&Range<usize>) -> bool,
    ) -> io::Result<(Vec<CopiedFile>, Vec<Change>)> {
        let (mut files, mut changes) = (Vec::new(), Vec::new());
        for (number, (named, _)) in named_files(typed).into_iter().enumerate() {
            let (name, span) = (named.get_ref(), named.span());
            if is_spared(&span) {
                continue;
            }
            let base = name.rsplit('/').next().filter(|base| !base.is_empty()).unwrap_or("file");
            let new = format!("{number}-{base}");
            files.push((new.clone(), self.bytes(name)?.to_vec()));
            changes.push((span, toml::Value::String(new).to_string()));
        }
        Ok((files, changes))
    }

    /// Returns the config's text after the changes, as `stage.toml`.
    pub(super) fn changed(&self, changes: Vec<Change>) -> CopiedFile {
        ("stage.toml".to_owned(), with_changes(&self.text, changes).into_bytes())
    }

    /// Returns the change that adds an exposure to a config that leaves it open.
    fn exposure(&self, typed: &Config, exposure_s: f64) -> Option<Change> {
        match typed.camera.as_ref().and_then(|camera| camera.get_ref().exposure_s.as_ref()) {
            Some(typed) if typed.get_ref().0 != 0.0 => None,
            Some(typed) => Some((typed.span(), format!("{exposure_s:?}"))),
            None => {
                let table = DeTable::parse(&self.text).ok()?;
                let camera = table.get_ref().get("camera")?.get_ref().as_table()?;
                added(&self.text, camera, "exposure_s", &format!("{exposure_s:?}"))
            }
        }
    }
}

/// Returns the change that adds a key to a table; `None` if the table is empty.
pub(super) fn added(text: &str, table: &DeTable, key: &str, value: &str) -> Option<Change> {
    let first = table.keys().map(|key| key.span().start).min()?;
    let before = &text[..first];
    let line = &before[before.rfind('\n').map_or(0, |end| end + 1)..];
    // The text before the first key shows the style: one key per line, in braces, or dotted.
    let has_own_line = line.trim().is_empty() || line.trim_end().ends_with('.');
    let join = if has_own_line { format!("\n{line}") } else { ", ".to_owned() };
    Some((first..first, format!("{key} = {value}{join}")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Settings;

    const FIXTURE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/dolly");

    fn write(files: Vec<CopiedFile>, folder: &Path) -> Settings {
        for (name, bytes) in files {
            std::fs::write(folder.join(name), bytes).unwrap();
        }
        Settings::load(&folder.join("stage.toml")).unwrap()
    }

    #[test]
    fn a_config_copy_is_as_loaded_and_self_contained() {
        let (home, copied) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        for name in ["backdrop.png", "flat.png", "camera.toml", "stage.toml"] {
            std::fs::copy(format!("{FIXTURE}/{name}"), home.path().join(name)).unwrap();
        }
        let was = Settings::load(&home.path().join("stage.toml")).unwrap();
        // The director edits everything while the show goes on.
        std::fs::write(home.path().join("stage.toml"), "[camera]\nx = 1\n").unwrap();
        std::fs::write(home.path().join("backdrop.png"), b"painted over").unwrap();
        std::fs::remove_file(home.path().join("camera.toml")).unwrap();
        let is = write(was.source.copy(None).unwrap(), copied.path());
        assert_eq!((was.camera, was.shutter), (is.camera, is.shutter));
        assert_eq!(was.stage.surfaces.len(), is.stage.surfaces.len());
        for (a, b) in was.stage.surfaces.iter().zip(&is.stage.surfaces) {
            assert_eq!((a.artwork.as_raw(), a.size_m), (b.artwork.as_raw(), b.size_m));
        }
    }

    #[test]
    fn a_config_that_moves_names_its_files_below_its_former_folder() {
        let text = "[camera]\ncalibration = 'camera.toml' # the lens\n[[stage.surface]]\nimage = \"/art/a.png\"\nshape = \"shape.toml\"\nsize_m = [4.0, 3.0]\n";
        let moved = "[camera]\ncalibration = \"walks/a/camera.toml\" # the lens\n[[stage.surface]]\nimage = \"/art/a.png\"\nshape = \"walks/a/shape.toml\"\nsize_m = [4.0, 3.0]\n";
        assert_eq!(named_below(text, Path::new("walks/a")).as_deref(), Some(moved));
        assert_eq!(named_below("[camera", Path::new("a")), None);
    }

    #[test]
    fn a_config_copy_states_an_exposure_left_unset() {
        let surface = "[[stage.surface]]\nimage = \"backdrop.png\"\nsize_m = [4.0, 3.0]\n";
        let ways = [
            ("[camera]\n# the lens\ncalibration = \"camera.toml\"\n", 0.008333333333333333),
            ("[camera]\n  readout_s = 0.01\n  calibration = \"camera.toml\" # the lens\n", 0.0083),
            ("[camera]\ncalibration = \"camera.toml\"\nexposure_s = 0 # unknown\n", 0.0083),
            ("camera = { calibration = \"camera.toml\", readout_s = 0.01 }\n", 0.0083),
            ("camera.calibration = \"camera.toml\"\ncamera.readout_s = 0.01\n", 0.0083),
            ("camera . calibration = \"camera.toml\"\r\n", 0.0083),
        ];
        for (camera, exposure_s) in ways {
            let folder = tempfile::tempdir().unwrap();
            let was = Settings::from_text(&format!("{camera}{surface}"), &Path::new(FIXTURE).join("stage.toml")).unwrap();
            let is = write(was.source.copy(Some(exposure_s)).unwrap(), folder.path());
            assert_eq!(
                (is.shutter.exposure_s.map(f64::to_bits), is.shutter.readout_s),
                (Some(f64::to_bits(exposure_s)), was.shutter.readout_s),
                "{camera}"
            );
        }
        // A configured exposure stays.
        let camera = "[camera]\ncalibration = \"camera.toml\"\nexposure_s = 0.01\n";
        let was = Settings::from_text(&format!("{camera}{surface}"), &Path::new(FIXTURE).join("stage.toml")).unwrap();
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(write(was.source.copy(Some(0.02)).unwrap(), folder.path()).shutter.exposure_s, Some(0.01));
    }
}
