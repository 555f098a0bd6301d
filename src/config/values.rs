//! Checks single values: is the number in range, is the word known, can the picture be read?

use std::cell::RefCell;
use std::ops::Range;

use image::GrayImage;
use image::metadata::Orientation;
use nalgebra::Vector3;
use toml::Spanned;

use super::origin::Origin;
use super::source::calibration_bytes;
use super::typed_values::{Count, Exactly, Number};
use super::{ConfigError, Problem, shape_file};
use crate::camera::{Calibration, parse_calibration};
use crate::capture::{MAX_PICTURE_FILE, decode_on_white, orientation_words};
use crate::safe_file;
use crate::track::{StageMap, SurfaceShape, SurfaceSpec};

/// Maximum size of a shape file, bytes. A round figure above any. Raised, an endless file takes
/// more memory.
const MAX_SHAPE_FILE: u64 = 64 << 20;
/// Maximum size of a map file, bytes: ten times that of a rich set. Raised, a foreign file takes
/// more memory.
const MAX_MAP_FILE: u64 = 300 << 20;

/// The current section, for messages.
pub(super) struct Section<'a> {
    pub origin: &'a Origin<'a>,
    /// Its name in brackets, as in the file.
    pub name: &'static str,
}

impl Section<'_> {
    pub fn refuse(&self, key: &str, span: &Range<usize>, problem: Problem) -> ConfigError {
        self.origin.value(self.name, key, span, problem)
    }

    /// Refuses a value that conflicts with another one.
    pub fn conflict<T>(&self, key: &str, typed: &Spanned<T>, sentence: &'static str) -> ConfigError {
        self.refuse(key, &typed.span(), Problem::Combination(sentence))
    }

    /// Refuses an invalid name or address.
    pub fn unusable(&self, key: &str, typed: &Spanned<String>, wanted: &'static str) -> ConfigError {
        self.refuse(key, &typed.span(), Problem::Range { value: format!("`{}`", typed.get_ref()), wanted })
    }

    /// Returns a number that satisfies `allowed`, or the default if the key is absent.
    pub fn number(
        &self,
        key: &str,
        typed: Option<&Spanned<Number>>,
        default: f64,
        allowed: impl Fn(f64) -> bool,
        wanted: &'static str,
    ) -> Result<f64, ConfigError> {
        let Some(typed) = typed else { return Ok(default) };
        let value = typed.get_ref().0;
        if value.is_finite() && allowed(value) {
            return Ok(value);
        }
        Err(self.refuse(key, &typed.span(), Problem::Range { value: value.to_string(), wanted }))
    }

    /// Returns a whole number within a range, or the default if the key is absent.
    pub fn count(
        &self,
        key: &str,
        typed: Option<&Spanned<Count>>,
        default: u64,
        allowed: std::ops::RangeInclusive<u64>,
        wanted: &'static str,
    ) -> Result<u64, ConfigError> {
        let Some(typed) = typed else { return Ok(default) };
        let value = typed.get_ref().0;
        if allowed.contains(&value) {
            return Ok(value);
        }
        Err(self.refuse(key, &typed.span(), Problem::Range { value: value.to_string(), wanted }))
    }

    /// Returns a picture's side in pixels.
    pub fn side(&self, key: &str, typed: Option<&Spanned<Count>>) -> Result<Option<u32>, ConfigError> {
        let side = self.count(key, typed, 0, 1..=16384, "a number of pixels from 1 to 16384")?;
        Ok(typed.and(u32::try_from(side).ok()))
    }

    /// Returns one of several words, in any case, or the default if the key is absent.
    pub fn word<T: Copy>(
        &self,
        key: &str,
        typed: Option<&Spanned<String>>,
        default: T,
        words: &[(&str, T)],
        wanted: &'static str,
    ) -> Result<T, ConfigError> {
        let Some(typed) = typed else { return Ok(default) };
        let typed_word = plain(typed.get_ref());
        if let Some((_, value)) = words.iter().find(|(word, _)| plain(word) == typed_word) {
            return Ok(*value);
        }
        let nearest = words.iter().map(|(word, _)| (strsim::jaro_winkler(&typed_word, word), *word)).max_by(|a, b| a.0.total_cmp(&b.0));
        let nearest = nearest.filter(|(likeness, _)| *likeness > 0.8).map(|(_, word)| word.to_owned());
        Err(self.refuse(key, &typed.span(), Problem::Word { value: typed.get_ref().clone(), wanted, nearest }))
    }

    /// Returns a text that is not empty.
    pub fn text(&self, key: &str, typed: &Spanned<String>, wanted: &'static str) -> Result<String, ConfigError> {
        if typed.get_ref().trim().is_empty() {
            return Err(self.refuse(key, &typed.span(), Problem::Range { value: "an empty text".to_owned(), wanted }));
        }
        Ok(typed.get_ref().clone())
    }

    /// Returns a position in metres; the origin if the key is absent.
    pub fn position(&self, key: &str, typed: Option<&Spanned<Exactly<Number, 3>>>) -> Result<Vector3<f64>, ConfigError> {
        let Some(typed) = typed else { return Ok(Vector3::zeros()) };
        let position = typed.get_ref().values();
        if position.iter().all(|v| v.is_finite() && v.abs() <= 10_000.0) {
            return Ok(Vector3::from(position));
        }
        let wanted = "three numbers of metres between -10000 and 10000";
        Err(self.refuse(key, &typed.span(), Problem::Range { value: format!("{position:?}"), wanted }))
    }

    /// Reads a picture as grey levels, with its EXIF orientation; its name is relative to the
    /// config's folder.
    pub fn picture(&self, key: &str, typed: &Spanned<String>) -> Result<(GrayImage, Orientation), ConfigError> {
        let file = self.origin.beside(typed.get_ref());
        let refuse = |problem| self.refuse(key, &typed.span(), problem);
        let bytes = self.origin.files.get(&file, |file| safe_file::read(file, MAX_PICTURE_FILE));
        let bytes = bytes.map_err(|e| refuse(Problem::PictureFile { file: file.clone(), reason: e.to_string() }))?;
        let (picture, orientation, unseen) = decode_on_white(&bytes).map_err(|reason| refuse(Problem::PictureContent { file, reason }))?;
        if unseen > 0.0 {
            let note = format!(
                "{:.1} % of it is transparent, which is treated as white paper; if it is printed on another colour, fill it with that \
                 colour first",
                100.0 * unseen
            );
            remark(&self.origin.warnings, typed.get_ref(), &note);
        }
        Ok((picture, orientation))
    }

    /// Reads a picture whose raw pixels are used. An EXIF rotation is refused: whoever measured in
    /// the picture saw it rotated.
    pub fn raw_picture(&self, key: &str, typed: &Spanned<String>, pixels: &'static str) -> Result<GrayImage, ConfigError> {
        let (picture, orientation) = self.picture(key, typed)?;
        match orientation_words(orientation) {
            None => Ok(picture),
            Some(words) => {
                Err(self.refuse(key, &typed.span(), Problem::PictureTurned { file: self.origin.beside(typed.get_ref()), words, pixels }))
            }
        }
    }

    /// Reads a surface's shape; its file's name is relative to the config's folder.
    pub fn shape(&self, key: &str, typed: &Spanned<String>, surface: &SurfaceSpec) -> Result<SurfaceShape, ConfigError> {
        let file = self.origin.beside(typed.get_ref());
        let refuse = |problem| self.refuse(key, &typed.span(), problem);
        let bytes = self.origin.files.get(&file, |file| safe_file::read(file, MAX_SHAPE_FILE));
        let bytes = bytes.map_err(|e| refuse(Problem::ShapeFile { file: file.clone(), reason: e.to_string() }))?;
        let not_text = |_| Problem::ShapeFile { file: file.clone(), reason: "it is not UTF-8".to_owned() };
        let text = std::str::from_utf8(&bytes).map_err(|e| refuse(not_text(e)))?;
        let shape = shape_file::parse(text, &surface.artwork, surface.size_m);
        shape.map_err(|reason| refuse(Problem::ShapeContent { file: file.clone(), reason }))
    }

    /// Reads a map file and returns its facets; its name is relative to the config's folder.
    pub fn map(&self, key: &str, typed: &Spanned<String>) -> Result<Vec<SurfaceSpec>, ConfigError> {
        let file = self.origin.beside(typed.get_ref());
        let refuse = |problem| self.refuse(key, &typed.span(), problem);
        let bytes = self.origin.files.get(&file, |file| safe_file::read(file, MAX_MAP_FILE));
        let bytes = bytes.map_err(|e| refuse(Problem::MapFile { file: file.clone(), reason: e.to_string() }))?;
        let facets = StageMap::from_bytes(&bytes).and_then(|map| map.surfaces());
        facets.map_err(|reason| refuse(Problem::MapContent { file: file.clone(), reason }))
    }

    /// Reads a calibration file; its name is relative to the config's folder.
    pub fn calibration(&self, key: &str, typed: &Spanned<String>) -> Result<Calibration, ConfigError> {
        let file = self.origin.beside(typed.get_ref());
        let bytes = self.origin.files.get(&file, calibration_bytes);
        let calibration = bytes.and_then(|bytes| parse_calibration(&bytes, &file));
        let calibration = calibration.map_err(|e| self.refuse(key, &typed.span(), Problem::Calibration(Box::new(e))))?;
        calibration.notes.iter().for_each(|note| remark(&self.origin.remarks, typed.get_ref(), note));
        Ok(calibration)
    }
}

/// Stores a remark about a file that the config names, once.
fn remark(kept: &RefCell<Vec<String>>, name: &str, sentence: &str) {
    let remark = format!("{name}: {sentence}");
    let mut kept = kept.borrow_mut();
    if !kept.contains(&remark) {
        kept.push(remark);
    }
}

/// Normalises a word's spelling: "One_Euro" and "one-euro" are the same.
fn plain(word: &str) -> String {
    word.trim().to_ascii_lowercase().replace(['_', ' '], "-")
}
