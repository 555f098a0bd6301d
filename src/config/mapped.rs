//! A config after a mapping: the map in place of the surfaces that gave it frame and scale, and
//! every other section unchanged, complete in its own folder.

use std::io;
use std::sync::Arc;

use toml::Spanned;
use toml::de::DeTable;

use super::ConfigSource;
use super::as_typed::Config;
use super::named_files::CopiedFile;
use super::surveyed::{CALIBRATION, with};

/// The map's name in the folder.
pub const MAP: &str = "stage.map";
/// Sections that describe the stage before it had a map.
const REPLACED: [&str; 10] = [
    "stage.surface",
    "stage.origin",
    "stage.map",
    "survey",
    "survey.distance",
    "survey.point",
    "map",
    "map.point",
    "map.point.seen",
    "map.distance",
];

impl ConfigSource {
    /// Returns the files of a mapped stage: `stage.toml`, `camera.toml`, `stage.map`, and copies of
    /// the other files that the config names.
    ///
    /// # Errors
    /// If the config has its surfaces in another form than sections, or has no `[camera]`.
    pub fn mapped(&self, calibration: String, map: Vec<u8>) -> io::Result<Vec<CopiedFile>> {
        let text = without_sections(&self.text);
        let typed = Config::parse(&text, &self.file).map_err(io::Error::other)?;
        if typed.stage.as_ref().is_some_and(|stage| !stage.get_ref().surface.is_empty() || stage.get_ref().origin.is_some()) {
            let problem = "write the stage's surfaces as sections, [[stage.surface]], and `origin` as [stage.origin]; then map again";
            return Err(io::Error::other(problem));
        }
        let document = DeTable::parse(&text).map_err(io::Error::other)?;
        let camera = document.get_ref().get("camera").and_then(|camera| camera.get_ref().as_table());
        let mut changes: Vec<_> =
            camera.and_then(|camera| with(&text, camera, "calibration", &format!("{CALIBRATION:?}"))).into_iter().collect();
        let of_camera = typed.camera.as_ref().and_then(|camera| camera.get_ref().calibration.as_ref()).map(Spanned::span);
        let source = Self { text: Arc::from(text.as_str()), ..self.clone() };
        let (mut files, names) = source.named_anew(&typed, |span| of_camera.as_ref() == Some(span))?;
        changes.extend(names);
        let (name, mut changed) = source.changed(changes);
        changed.extend(format!("\n[stage.map]\nfile = {MAP:?}\n").bytes());
        files.extend([(CALIBRATION.to_owned(), calibration.into_bytes()), (MAP.to_owned(), map), (name, changed)]);
        Ok(files)
    }
}

/// Returns a config's text with the replaced sections as comments.
fn without_sections(text: &str) -> String {
    let mut is_replaced = false;
    let line = |line: &str| {
        if let Some(section) = header(line) {
            is_replaced = REPLACED.contains(&section.as_str());
        }
        if is_replaced && !line.trim().is_empty() { format!("# {line}\n") } else { format!("{line}\n") }
    };
    text.lines().map(line).collect()
}

/// Returns the name of the section that a line begins.
fn header(line: &str) -> Option<String> {
    let inside = line.split('#').next()?.trim().strip_prefix('[')?.strip_suffix(']')?;
    let inside = inside.strip_prefix('[').and_then(|inside| inside.strip_suffix(']')).unwrap_or(inside);
    let is_name = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.' | ' ');
    let starts_as_name = inside.trim().starts_with(|c: char| c.is_ascii_alphabetic());
    (starts_as_name && inside.chars().all(is_name)).then(|| inside.replace(' ', ""))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use crate::config::Settings;
    use crate::geometry::Pose;
    use crate::track::{Facet, FacetTexture, ReferenceKind, StageMap, SurfaceShape};

    const FIXTURE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/dolly/stage.toml");

    fn map() -> StageMap {
        let light = (0..80u32 * 64).map(|n| (n.wrapping_mul(2_654_435_761) >> 16) as u16).collect();
        let texture = FacetTexture { width: 80, height: 64, light };
        let facet = Facet { name: "facet 1".to_owned(), size_m: [0.8, 0.64], pose: Pose::identity(), shape: SurfaceShape::Flat, texture };
        StageMap { bend: [0.0; 7], keyframes: vec![Pose::identity()], facets: vec![facet] }
    }

    #[test]
    fn a_mapped_config_has_the_map_and_everything_but_the_surfaces() {
        let text = "[camera]\ncalibration = \"camera.toml\" # ours\nreadout_s = 0.01\n\n[[stage.surface]] # the poster\nimage = \"backdrop.png\"\n\
                    size_m = [\n  4.0,\n  3.0,\n]\n\n[stage.origin]\n\"bottom left\" = [0, 1, 2]\n\n[filter]\nkind = \"one_euro\"\n";
        let was = Settings::from_text(text, Path::new(FIXTURE)).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let calibration = std::fs::read_to_string(Path::new(FIXTURE).with_file_name("camera.toml")).unwrap();
        for (name, bytes) in was.source.mapped(calibration, map().to_bytes()).unwrap() {
            std::fs::write(folder.path().join(name), bytes).unwrap();
        }
        let is = Settings::load(&folder.path().join("stage.toml")).unwrap();
        assert_eq!((was.camera, was.shutter), (is.camera, is.shutter));
        assert_eq!(is.stage.surfaces.len(), 1);
        assert!(matches!(is.stage.surfaces[0].kind, ReferenceKind::Facet { .. }));
        assert_eq!(format!("{:?}", was.filter), format!("{:?}", is.filter));
        // It maps again to the same.
        let again = is.source.mapped(String::new(), Vec::new()).unwrap();
        assert_eq!(again.len(), 3);
    }

    #[test]
    fn surfaces_in_another_form_are_refused() {
        let text = "camera.calibration = \"camera.toml\"\nstage.surface = [{ image = \"backdrop.png\", size_m = [4.0, 3.0] }]\n";
        let was = Settings::from_text(text, Path::new(FIXTURE)).unwrap();
        assert!(was.source.mapped(String::new(), Vec::new()).unwrap_err().to_string().contains("[[stage.surface]]"));
    }

    #[test]
    fn a_damaged_or_missing_map_is_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("stage.toml");
        let load = |text: &str| Settings::from_text(&format!("[camera]\nfov_deg = 60\n{text}"), &file).unwrap_err().to_string();
        assert!(load("[stage.map]\nfile = \"gone.map\"\n").contains("gone.map"));
        assert!(load("[stage.map]\n").contains("file"));
        std::fs::write(folder.path().join("cut.map"), &map().to_bytes()[..999]).unwrap();
        let refusal = load("[stage.map]\nfile = \"cut.map\"\n");
        assert!(refusal.contains("cut.map") && refusal.contains("it is cut"), "{refusal}");
        std::fs::write(folder.path().join("a.map"), map().to_bytes()).unwrap();
        assert!(load("[stage.map]\nfile = \"a.map\"\n[stage.origin]\ncentre = [0, 0, 0]\n").contains("map"));
        assert!(load("[stage.map]\nfiles = \"a.map\"\n").contains("did you mean `file`"));
    }
}
