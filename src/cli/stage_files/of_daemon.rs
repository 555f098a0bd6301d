//! The running daemon's stage as files of `GET /api/v1/scene?format=…`, by the writers of `export`.

use std::io::{self, Cursor, Write};
use std::sync::{Arc, Mutex, PoisonError};

use zip::ZipWriter;
use zip::write::SimpleFileOptions;

use super::scenery_with_artwork;
use crate::config::{ConfigSource, Settings};
use crate::daemon::Supervisor;
use crate::export::scenery::Scenery;
use crate::export::{gltf, obj, usd};
use crate::web::StageSource;

/// What the names of files begin with.
const STEM: &str = "stage";

/// The stage of the config in force.
pub(in crate::cli) struct StageOfDaemon {
    supervisor: Arc<Supervisor>,
    /// The last seen config, and how many came before it.
    seen: Mutex<(Option<ConfigSource>, u64)>,
}

impl StageOfDaemon {
    pub fn new(supervisor: Arc<Supervisor>) -> Self {
        Self { supervisor, seen: Mutex::default() }
    }
}

impl StageSource for StageOfDaemon {
    fn version(&self) -> Option<u64> {
        let now = self.supervisor.settings()?.source.clone();
        let mut seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        if !seen.0.as_ref().is_some_and(|before| before.is_same_reading(&now)) {
            *seen = (Some(now), seen.1 + 1);
        }
        Some(seen.1)
    }

    fn formats(&self) -> &'static [(&'static str, &'static str, &'static str)] {
        &[
            ("gltf", "model/gltf+json", "stage.gltf"),
            ("obj", "application/zip", "stage-obj.zip"),
            ("usd", "application/zip", "stage-usd.zip"),
        ]
    }

    fn make(&self, format: &str) -> Result<Vec<u8>, String> {
        let settings = self.supervisor.settings().ok_or("there is no config")?;
        file(&settings, format).map_err(|e| e.to_string())
    }
}

/// Makes a file of a config's stage; OBJ and USD are a zip with their pictures.
fn file(settings: &Settings, format: &str) -> io::Result<Vec<u8>> {
    let scenery = scenery_with_artwork(settings, STEM).map_err(io::Error::other)?;
    match format {
        "gltf" => Ok(gltf::write(None, &scenery).into_bytes()),
        "usd" => zipped(vec![(format!("{STEM}.usda"), usd::write(None, &scenery))], &scenery),
        _ => {
            let materials = format!("{STEM}.mtl");
            let [text, mtl] = obj::write(&scenery, &materials);
            zipped(vec![(format!("{STEM}.obj"), text), (materials, mtl)], &scenery)
        }
    }
}

fn zipped(texts: Vec<(String, String)>, scenery: &Scenery) -> io::Result<Vec<u8>> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    let texts = texts.iter().map(|(name, text)| (name.as_str(), text.as_bytes()));
    let pictures = scenery.stage.iter().map(|sheet| (sheet.picture.as_str(), sheet.png.as_slice()));
    for (name, bytes) in texts.chain(pictures) {
        zip.start_file(name, SimpleFileOptions::default()).map_err(io::Error::other)?;
        zip.write_all(bytes)?;
    }
    Ok(zip.finish().map_err(io::Error::other)?.into_inner())
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use image::{Rgb, RgbImage};
    use zip::ZipArchive;

    use super::*;
    use crate::daemon::live::LiveLink;

    /// A supervisor of a config with a picture in colour.
    fn supervised(folder: &std::path::Path) -> Arc<Supervisor> {
        let level = |x: u32, y: u32| ((x / 7 * 37 + y / 5 * 91) % 251) as u8;
        RgbImage::from_fn(128, 96, |x, y| Rgb([level(x, y), 20, 255 - level(x, y)])).save(folder.join("backdrop.png")).unwrap();
        let text = "[camera]\nfov_deg = 60\n[[stage.surface]]\nimage = \"backdrop.png\"\nsize_m = [4.0, 3.0]\n";
        std::fs::write(folder.join("stage.toml"), text).unwrap();
        let supervisor = Arc::new(Supervisor::new(&folder.join("stage.toml"), LiveLink::default()));
        supervisor.use_settings(Some(Settings::load(&folder.join("stage.toml")).unwrap()));
        supervisor
    }

    #[test]
    fn files_are_those_of_export() {
        let folder = tempfile::tempdir().unwrap();
        let source = StageOfDaemon::new(supervised(folder.path()));
        let whole: serde_json::Value = serde_json::from_slice(&source.make("gltf").unwrap()).unwrap();
        assert_eq!((&whole["asset"]["version"], &whole["meshes"][0]["name"]), (&"2.0".into(), &"backdrop".into()));
        for (format, names) in
            [("obj", vec!["stage.obj", "stage.mtl", "stage-backdrop.png"]), ("usd", vec!["stage.usda", "stage-backdrop.png"])]
        {
            let mut zip = ZipArchive::new(Cursor::new(source.make(format).unwrap())).unwrap();
            assert_eq!(zip.file_names().collect::<Vec<_>>(), names);
            let mut picture = Vec::new();
            zip.by_name("stage-backdrop.png").unwrap().read_to_end(&mut picture).unwrap();
            let picture = image::load_from_memory(&picture).unwrap();
            assert!((picture.width(), picture.height()) == (128, 96) && picture.color().has_color());
            let mut text = String::new();
            zip.by_name(names[0]).unwrap().read_to_string(&mut text).unwrap();
            assert!(text.contains("backdrop"), "{text}");
        }
    }

    #[test]
    fn a_reload_is_another_version() {
        let folder = tempfile::tempdir().unwrap();
        let supervisor = supervised(folder.path());
        let source = StageOfDaemon::new(supervisor.clone());
        let first = source.version();
        assert!(first.is_some() && source.version() == first);
        supervisor.use_settings(Some(Settings::load(&folder.path().join("stage.toml")).unwrap()));
        assert_ne!(source.version(), first);
        supervisor.use_settings(None);
        assert_eq!(source.version(), None);
    }
}
