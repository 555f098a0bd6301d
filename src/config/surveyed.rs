//! A config after a survey: the surveyed poses, shapes and lens, and every other section unchanged,
//! complete in its own folder.

use std::io;
use std::ops::Range;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::ConfigSource;
use super::as_typed::Config;
use super::named_files::{Change, CopiedFile, added};
use crate::camera::Shutter;
use crate::geometry::{Body, Pose, SurfaceFrame};

/// The calibration's name in the folder.
pub const CALIBRATION: &str = "camera.toml";
/// Keys that replace a calibration if there is none.
const GUESSES: [&str; 2] = ["fov_deg", "focal_35mm_mm"];

/// A surveyed surface.
#[derive(Debug, Clone)]
pub struct SurveyedSurface {
    /// Its pose in the first surface's frame; `None` for the first surface, which stays.
    pub t_first_surface: Option<Pose<SurfaceFrame, SurfaceFrame>>,
    /// The text of its shape file.
    pub shape: String,
}

impl ConfigSource {
    /// Returns the files of a surveyed stage: `stage.toml`, `camera.toml`, the shapes, and copies
    /// of the other files that the config names.
    ///
    /// `first_typed` is the first surface's pose in the config. `shutter` is the one to write, if
    /// it differs from the config's.
    ///
    /// # Errors
    /// Only if the program has a defect: the text was read as a config before.
    pub fn surveyed(
        &self,
        first_typed: &Pose<Body, SurfaceFrame>,
        surfaces: &[SurveyedSurface],
        calibration: String,
        shutter: Option<Shutter>,
    ) -> io::Result<Vec<CopiedFile>> {
        let typed = Config::parse(&self.text, &self.file).map_err(io::Error::other)?;
        let document = DeTable::parse(&self.text).map_err(io::Error::other)?;
        let mut files = vec![(CALIBRATION.to_owned(), calibration.into_bytes())];
        let mut changes: Vec<Change> = Vec::new();
        let camera = document.get_ref().get("camera").and_then(|camera| camera.get_ref().as_table());
        if let Some(camera) = camera {
            changes.extend(GUESSES.iter().filter_map(|key| without(camera, key)));
            changes.extend(with(&self.text, camera, "calibration", &format!("{CALIBRATION:?}")));
            let times = shutter.iter().flat_map(|s| [("readout_s", s.readout_s), ("exposure_s", s.exposure_s)]);
            changes
                .extend(times.filter_map(|(key, seconds)| with(&self.text, camera, key, &format!("{:?}", (1e6 * seconds).round() / 1e6))));
        }
        let of_camera = typed.camera.as_ref().and_then(|camera| camera.get_ref().calibration.as_ref()).map(Spanned::span);
        let tables = document.get_ref().get("stage").and_then(|stage| stage.get_ref().as_table()?.get("surface")?.get_ref().as_array());
        let tables = tables.into_iter().flatten().filter_map(|surface| surface.get_ref().as_table());
        let mut shapes = Vec::new();
        for (number, (surface, table)) in surfaces.iter().zip(tables).enumerate() {
            let name = format!("shape-{}.toml", number + 1);
            files.push((name.clone(), surface.shape.clone().into_bytes()));
            let mut values = vec![("shape", format!("{name:?}"))];
            if let Some(t_first_surface) = &surface.t_first_surface {
                let pose = *first_typed * *t_first_surface;
                changes.extend(without(table, "rotation_deg"));
                values.push(("position_m", format!("{:?}", pose.translation.as_slice())));
                values.push(("orientation_xyzw", format!("{:?}", pose.orientation_xyzw())));
            }
            shapes.extend(table.get("shape").map(Spanned::span));
            changes.extend(values.into_iter().filter_map(|(key, value)| with(&self.text, table, key, &value)));
        }
        let is_written_anew = |span: &Range<usize>| of_camera.as_ref() == Some(span) || shapes.contains(span);
        let (copies, names) = self.named_anew(&typed, is_written_anew)?;
        files.extend(copies);
        changes.extend(names);
        files.push(self.changed(changes));
        Ok(files)
    }
}

/// Returns the change that sets a key of a table; `None` if the table is empty.
pub(super) fn with(text: &str, table: &DeTable, key: &str, value: &str) -> Option<Change> {
    table.get(key).map(|old| (old.span(), value.to_owned())).or_else(|| added(text, table, key, value))
}

/// Returns the change that removes a key from a table, leaving a comment in its place.
fn without(table: &DeTable, key: &str) -> Option<Change> {
    let (name, value): (&Spanned<_>, &Spanned<DeValue>) = table.iter().find(|(name, _)| name.get_ref() == key)?;
    Some((name.span().start..value.span().end, format!("# {key}: see the survey")))
}
