//! How well each picture can be tracked: printed by `check` and drawn by `--ratings`.

use std::io::{self, Cursor};
use std::path::{Path, PathBuf};

use image::ImageFormat;

use super::super::calibrate::write_whole;
use super::super::failure::Failure;
use super::super::spared::Spared;
use crate::camera::CameraModel;
use crate::config::Settings;
use crate::diagnose::Finding;
use crate::diagnose::trackability::{self, BEST, POOR, Rating};

/// The ratings of a config's pictures.
pub(super) struct Ratings {
    /// In the order of the surfaces: the stage's, then the objects'.
    all: Vec<Rating>,
    /// Whether the maps are printed.
    has_maps: bool,
}

impl Ratings {
    /// Rates every picture as this camera sees it. With a folder, one map per picture is written
    /// there and printed.
    ///
    /// # Errors
    /// When a map would overwrite a file of the config, and the system's error.
    pub(super) fn of(settings: &Settings, camera: &CameraModel, folder: Option<&Path>) -> Result<Self, Failure> {
        let all = trackability::rate(&settings.stage, &settings.objects, camera);
        if let Some(folder) = folder {
            write_maps(settings, &all, folder)?;
        }
        Ok(Self { all, has_maps: folder.is_some() })
    }

    /// Returns weaknesses to fix before the show. A body is as good as its best surface.
    pub(super) fn findings(&self) -> Vec<Finding> {
        let mut findings = Vec::new();
        for body in self.all.chunk_by(|a, b| a.body == b.body) {
            for rating in body {
                let twins = rating.weaknesses.iter().filter_map(|w| w.same_as());
                // Report each pair once.
                findings.extend(twins.filter(|[other, _]| *other > rating.body).map(|[other, surface]| {
                    Finding::doubt(format!(
                        "{} of {} and {surface} of {other} show the same picture: they cannot be told apart, and neither is found; give \
                         each its own",
                        rating.surface, rating.body
                    ))
                }));
            }
            findings.extend(alike(body));
            let best = body.iter().max_by_key(|rating| rating.stars).filter(|rating| rating.stars <= POOR);
            findings.extend(best.map(|rating| {
                let why = rating.weaknesses.first().map_or_else(String::new, |weakness| format!(": {weakness}"));
                Finding::warning(format!("{} of {} is rated {} of {BEST} for tracking{why}", rating.surface, rating.body, rating.stars))
            }));
        }
        findings
    }

    /// Returns the lines below one surface, by its number over all bodies.
    pub(super) fn lines(&self, number: usize) -> Vec<String> {
        let Some(rating) = self.all.get(number) else { return Vec::new() };
        let [across, down] = rating.seen_px;
        let mut lines = vec![format!(
            "rated {} of {BEST} for tracking, at {across} x {down} pixels in the frame when the whole stage fills it",
            rating.stars
        )];
        lines.extend(rating.weaknesses.iter().map(|weakness| format!("  {weakness}")));
        if self.has_maps {
            lines.push("  where there is detail to track (# plenty, . none):".to_owned());
            lines.extend(rating.map.lines().into_iter().map(|line| format!("  {line}")));
        }
        lines
    }
}

/// Returns a finding for a body all of whose surfaces repeat a picture of the same body, such as a
/// sign with one picture on both sides: no feature tells which surface is seen.
fn alike(body: &[Rating]) -> Option<Finding> {
    let is_alike = |rating: &Rating| rating.weaknesses.iter().filter_map(|w| w.same_as()).any(|[other, _]| *other == rating.body);
    let first = body.first().filter(|_| body.iter().all(is_alike))?;
    Some(Finding::doubt(format!(
        "every surface of {} shows the picture of another one of them ({}): they cannot be told apart, and it is not found; give each its \
         own",
        first.body, first.surface
    )))
}

/// Writes `rating-BODY-N.png` for every surface; N counts from 1 in each body.
fn write_maps(settings: &Settings, ratings: &[Rating], folder: &Path) -> Result<(), Failure> {
    std::fs::create_dir_all(folder).map_err(Failure::output(folder))?;
    let mut spared = Spared::default().with_files(&settings.files, "a file of the config");
    let surfaces = std::iter::once(&settings.stage).chain(&settings.objects).flat_map(|body| body.surfaces.iter().zip(1..));
    for ((surface, number), rating) in surfaces.zip(ratings) {
        let file: PathBuf = folder.join(format!("rating-{}-{number}.png", as_file_name(&rating.body)));
        spared.claim("--ratings", &file)?;
        let mut png = Cursor::new(Vec::new());
        let drawn = rating.map.drawn_on(&surface.artwork);
        drawn.write_to(&mut png, ImageFormat::Png).map_err(io::Error::other).map_err(Failure::output(&file))?;
        write_whole(&file, png.get_ref())?;
    }
    Ok(())
}

/// Replaces characters that a file name cannot have or that lead to another folder.
fn as_file_name(name: &str) -> String {
    name.chars().map(|c| if c.is_alphanumeric() || c == '-' || c == '_' { c } else { '_' }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_become_safe_file_names() {
        assert_eq!(as_file_name("../a b/c.png"), "___a_b_c_png");
        assert_eq!(as_file_name("Wägen-2"), "Wägen-2");
    }
}
