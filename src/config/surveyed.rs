//! A config after a survey: the same in every other section, with the surfaces' places and shapes and the lens as they were found, complete in a folder
//! of its own.

use std::io;
use std::ops::Range;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::ConfigSource;
use super::as_typed::Config;
use super::named_files::{CopiedFile, named_files};
use crate::geometry::{Body, Pose, SurfaceFrame};

/// The calibration's name in the folder.
pub const CALIBRATION: &str = "camera.toml";
/// Keys that stand for a calibration where there is none.
const GUESSES: [&str; 2] = ["fov_deg", "focal_35mm_mm"];

/// A surface as it was surveyed.
#[derive(Debug, Clone)]
pub struct SurveyedSurface {
    /// Where it stands, in the first surface's frame; none of the first, which stays.
    pub t_first_surface: Option<Pose<SurfaceFrame, SurfaceFrame>>,
    /// The text of its shape file.
    pub shape: String,
}

/// A change of the text.
type Change = (Range<usize>, String);

impl ConfigSource {
    /// The files of a surveyed stage: `stage.toml`, `camera.toml`, the shapes, and copies of what else the config names. `first_typed`: where the config
    /// itself has the first surface.
    ///
    /// # Errors
    /// Only by a defect of the program: the text was read as a config before.
    pub fn surveyed(
        &self,
        first_typed: &Pose<Body, SurfaceFrame>,
        surfaces: &[SurveyedSurface],
        calibration: String,
    ) -> io::Result<Vec<CopiedFile>> {
        let typed = Config::parse(&self.text, &self.file).map_err(io::Error::other)?;
        let document = DeTable::parse(&self.text).map_err(io::Error::other)?;
        let mut files = vec![(CALIBRATION.to_owned(), calibration.into_bytes())];
        let mut changes: Vec<Change> = Vec::new();
        let camera = document.get_ref().get("camera").and_then(|camera| camera.get_ref().as_table());
        if let Some(camera) = camera {
            changes.extend(GUESSES.iter().filter_map(|key| without(camera, key)));
            changes.push(with(&self.text, camera, "calibration", format!("{CALIBRATION:?}")));
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
            changes.extend(values.into_iter().map(|(key, value)| with(&self.text, table, key, value)));
        }
        for (number, (named, _)) in named_files(&typed).into_iter().enumerate() {
            let (name, span) = (named.get_ref(), named.span());
            if of_camera == Some(span.clone()) || shapes.contains(&span) {
                continue;
            }
            let base = name.rsplit('/').next().filter(|base| !base.is_empty()).unwrap_or("file");
            let new = format!("{number}-{base}");
            files.push((new.clone(), self.bytes(name)?.to_vec()));
            changes.push((span, toml::Value::String(new).to_string()));
        }
        // From the end, so that the spans in front stay where they are.
        changes.sort_by_key(|(span, _)| std::cmp::Reverse((span.start, span.end)));
        let mut text = self.text.to_string();
        for (span, new) in changes {
            text.replace_range(span, &new);
        }
        files.push(("stage.toml".to_owned(), text.into_bytes()));
        Ok(files)
    }
}

/// The change that gives a key of a table a value.
fn with(text: &str, table: &DeTable, key: &str, value: String) -> Change {
    if let Some(old) = table.get(key) {
        return (old.span(), value);
    }
    let first = table.keys().map(|key| key.span().start).min().unwrap_or(0);
    let before = &text[..first];
    let line = &before[before.rfind('\n').map_or(0, |end| end + 1)..];
    // What stands before the first key says how keys are joined: in a table of its own, in braces, or by dots.
    let has_own_line = line.trim().is_empty() || line.trim_end().ends_with('.');
    let join = if has_own_line { format!("\n{line}") } else { ", ".to_owned() };
    (first..first, format!("{key} = {value}{join}"))
}

/// The change that takes a key out of a table; a harmless comment stays in its place where it has a line of its own.
fn without(table: &DeTable, key: &str) -> Option<Change> {
    let (name, value): (&Spanned<_>, &Spanned<DeValue>) = table.iter().find(|(name, _)| name.get_ref() == key)?;
    Some((name.span().start..value.span().end, format!("# {key}: see the survey")))
}
