//! Single values: is the number in its range, is the word one of the known ones, can the picture be read?

use std::ops::Range;

use image::GrayImage;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use toml::Spanned;

use super::as_typed::{Count, Exactly, Number};
use super::origin::Origin;
use super::{ConfigError, Problem};
use crate::camera::{Calibration, calibration_bytes, parse_calibration};

/// The section at hand, for messages.
pub(super) struct Section<'a> {
    pub origin: &'a Origin<'a>,
    /// In its brackets, as the file writes it.
    pub name: &'static str,
}

impl Section<'_> {
    pub fn refuse(&self, key: &str, span: &Range<usize>, problem: Problem) -> ConfigError {
        self.origin.value(self.name, key, span, problem)
    }

    /// A number that satisfies `allowed`, or the default where the key is absent.
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

    /// A whole number within a range, or the default where the key is absent.
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

    /// One of a few words, or the default where the key is absent.
    pub fn word<T: Copy>(
        &self,
        key: &str,
        typed: Option<&Spanned<String>>,
        default: T,
        words: &[(&str, T)],
        wanted: &'static str,
    ) -> Result<T, ConfigError> {
        let Some(typed) = typed else { return Ok(default) };
        let found = words.iter().find(|(word, _)| word == typed.get_ref());
        let problem = || Problem::Range { value: format!("`{}`", typed.get_ref()), wanted };
        found.map(|(_, value)| *value).ok_or_else(|| self.refuse(key, &typed.span(), problem()))
    }

    /// A text that is not empty.
    pub fn text(&self, key: &str, typed: &Spanned<String>, wanted: &'static str) -> Result<String, ConfigError> {
        if typed.get_ref().trim().is_empty() {
            return Err(self.refuse(key, &typed.span(), Problem::Range { value: "an empty text".to_owned(), wanted }));
        }
        Ok(typed.get_ref().clone())
    }

    /// A position in metres; the origin where the key is absent.
    pub fn position(&self, key: &str, typed: Option<&Spanned<Exactly<Number, 3>>>) -> Result<Vector3<f64>, ConfigError> {
        let Some(typed) = typed else { return Ok(Vector3::zeros()) };
        let position = typed.get_ref().values();
        if position.iter().all(|v| v.is_finite() && v.abs() <= 10_000.0) {
            return Ok(Vector3::from(position));
        }
        let wanted = "three numbers of metres between -10000 and 10000";
        Err(self.refuse(key, &typed.span(), Problem::Range { value: format!("{position:?}"), wanted }))
    }

    /// A rotation; upright and facing the audience (DESIGN section 2) where the key is absent.
    pub fn orientation(&self, key: &str, typed: Option<&Spanned<Exactly<Number, 4>>>) -> Result<UnitQuaternion<f64>, ConfigError> {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let Some(typed) = typed else {
            return Ok(UnitQuaternion::from_quaternion(Quaternion::new(half, half, 0.0, 0.0)));
        };
        let [x, y, z, w] = typed.get_ref().values();
        let quaternion = Quaternion::new(w, x, y, z);
        let length = quaternion.norm();
        // A NaN length fails the comparison too.
        if (length - 1.0).abs() <= 1e-3 {
            return Ok(UnitQuaternion::from_quaternion(quaternion));
        }
        Err(self.refuse(key, &typed.span(), Problem::Quaternion(length)))
    }

    /// A picture as grey levels; its name is relative to the config's folder.
    pub fn picture(&self, key: &str, typed: &Spanned<String>) -> Result<GrayImage, ConfigError> {
        let file = self.origin.beside(typed.get_ref());
        let refuse = |problem| self.refuse(key, &typed.span(), problem);
        let bytes = self.origin.files.get(&file, |file| std::fs::read(file));
        let bytes = bytes.map_err(|e| refuse(Problem::PictureFile { file: file.clone(), reason: e.to_string() }))?;
        crate::capture::decode_grey(&bytes).map_err(|reason| refuse(Problem::PictureContent { file, reason }))
    }

    /// A calibration file; its name is relative to the config's folder.
    pub fn calibration(&self, key: &str, typed: &Spanned<String>) -> Result<Calibration, ConfigError> {
        let file = self.origin.beside(typed.get_ref());
        let bytes = self.origin.files.get(&file, calibration_bytes);
        let calibration = bytes.and_then(|bytes| parse_calibration(&bytes, &file));
        calibration.map_err(|e| self.refuse(key, &typed.span(), Problem::Calibration(Box::new(e))))
    }
}
