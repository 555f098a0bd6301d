//! `[camera]`: the lens, from its calibration or from a guess, and for which picture size.

use std::path::{Path, PathBuf};

use toml::Spanned;

use super::as_typed;
use super::values::Section;
use super::{ConfigError, Problem};
use crate::camera::{CameraModel, LensDoubt, LensGuess};

/// The source of the camera's parameters.
#[derive(Debug, Clone, PartialEq)]
pub enum LensSource {
    /// A calibration file, with relative names resolved.
    Calibration(PathBuf),
    /// A guess, with the pictures' size if `width` and `height` state it.
    Guess(LensGuess, Option<(u32, u32)>),
}

impl LensSource {
    /// Returns the calibration file, if there is one.
    pub fn calibration_file(&self) -> Option<&Path> {
        match self {
            Self::Calibration(file) => Some(file),
            Self::Guess(..) => None,
        }
    }

    /// Returns the picture size for which the lens is known.
    pub fn size(&self, camera: &CameraModel) -> Option<(u32, u32)> {
        match self {
            Self::Calibration(_) => Some((camera.width(), camera.height())),
            Self::Guess(_, size) => *size,
        }
    }
}

/// Picture size for a guessed lens until a clip or camera states its own, pixels. Any size would
/// do: the guess is an angle.
const ANY_SIZE: (u32, u32) = (1280, 720);

/// What to write if the config has no lens.
const HINT: &str = "calibration = \"camera.toml\" (width, height, fx, fy, cx, cy, skew, distortion), or for a first look fov_deg = 60 (degrees across the picture)";

/// Reads the lens and builds its camera.
pub(super) fn lens(section: &Section<'_>, typed: Option<&Spanned<as_typed::Camera>>) -> Result<(LensSource, CameraModel), ConfigError> {
    let Some(camera) = typed else {
        return Err(section.origin.missing("the config".to_owned(), "camera.calibration", HINT));
    };
    match found(section, camera.get_ref())? {
        Some(lens) => Ok(lens),
        None => Err(section.origin.missing(section.origin.section_at("[camera]", &camera.span()), "calibration", HINT)),
    }
}

/// As [`lens`], but the lens may be absent.
pub(super) fn found(section: &Section<'_>, camera: &as_typed::Camera) -> Result<Option<(LensSource, CameraModel)>, ConfigError> {
    let guess = guess(section, camera)?;
    let Some(calibration) = &camera.calibration else {
        let Some((guess, key, span)) = guess else { return Ok(None) };
        let size = section.side("width", camera.width.as_ref())?.zip(section.side("height", camera.height.as_ref())?);
        let (width, height) = size.unwrap_or(ANY_SIZE);
        let model = guess.camera(width, height).map_err(|e| section.refuse(key, &span, Problem::Camera(e)))?;
        return Ok(Some((LensSource::Guess(guess, size), model)));
    };
    if let Some((_, key, span)) = guess {
        let problem = Problem::Combination("[camera] has a `calibration` too, which is better; remove this one");
        return Err(section.refuse(key, &span, problem));
    }
    let read = section.calibration("calibration", calibration)?;
    let model = read.model.with_doubt(LensDoubt::of_calibration(read.uncertainty));
    Ok(Some((LensSource::Calibration(section.origin.beside(calibration.get_ref())), model)))
}

type TypedGuess = (LensGuess, &'static str, std::ops::Range<usize>);

fn guess(section: &Section<'_>, camera: &as_typed::Camera) -> Result<Option<TypedGuess>, ConfigError> {
    let degrees = |v: f64| (1.0..=170.0).contains(&v);
    let fov = section.number("fov_deg", camera.fov_deg.as_ref(), 0.0, degrees, "the degrees across the picture's width, from 1 to 170")?;
    let millimetres = |v: f64| (4.0..=2000.0).contains(&v);
    let wanted = "the focal length as of 35 mm film, from 4 to 2000 millimetres";
    let film = section.number("focal_35mm_mm", camera.focal_35mm_mm.as_ref(), 0.0, millimetres, wanted)?;
    match (&camera.fov_deg, &camera.focal_35mm_mm) {
        (None, None) => Ok(None),
        (Some(typed), None) => Ok(Some((LensGuess::FieldOfView(fov), "fov_deg", typed.span()))),
        (None, Some(typed)) => Ok(Some((LensGuess::FilmFocalLength(film), "focal_35mm_mm", typed.span()))),
        (Some(_), Some(typed)) => Err(section.conflict("focal_35mm_mm", typed, "[camera] has `fov_deg` too; remove one of them")),
    }
}
