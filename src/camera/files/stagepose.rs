//! stagepose's own calibration file: flat TOML, one key per parameter; unknown keys are refused.

use std::fmt::Write;
use std::ops::Range;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::problem::{CalibrationProblem, Fault, missing};
use super::{Calibration, CalibrationForm, IntrinsicsUncertainty, POSSIBLE_ERRORS, model, slips};
use crate::camera::Intrinsics;

/// All keys of the file and of its `[uncertainty]`, and the required coefficients, for messages.
const KEYS: [&str; 12] = ["width", "height", "fx", "fy", "cx", "cy", "skew", "distortion", "rms_px", "images", "date", "uncertainty"];
const UNCERTAINTY_KEYS: [&str; 6] = ["fx", "fy", "cx", "cy", "skew", "distortion"];
const DISTORTION: &str = "5 numbers [k1, k2, p1, p2, k3]";

pub(super) fn parse(text: &str) -> Result<Calibration, Fault> {
    let root = DeTable::parse(text).map_err(|e| Fault {
        line: e.span().map(|s| line_at(text, s)),
        problem: CalibrationProblem::Syntax { reason: reason(text, &e) },
    })?;
    let table = Section { text, name: "", table: root.get_ref() };
    table.refuse_unknown(&KEYS)?;
    let intrinsics = Intrinsics {
        width: table.pixels("width")?,
        height: table.pixels("height")?,
        fx: table.number("fx")?,
        fy: table.number("fy")?,
        cx: table.number("cx")?,
        cy: table.number("cy")?,
        skew: table.optional_number("skew")?.unwrap_or(0.0),
        distortion: table.distortion()?.ok_or_else(|| missing("distortion", "distortion = [k1, k2, p1, p2, k3], zeros for none"))?,
    };
    Ok(Calibration {
        model: model(intrinsics, |key| table.line(key))?,
        uncertainty: uncertainty(&table)?,
        rms_px: table.at_least_zero("rms_px")?,
        images: table.get("images").map(|v| table.count("images", v)).transpose()?,
        date: table.date()?,
        form: CalibrationForm::Stagepose,
        notes: Vec::new(),
    })
}

/// The parser's message, with a suggestion of what to type.
fn reason(text: &str, error: &toml::de::Error) -> String {
    let words = error.message().trim().replace('\n', ", ");
    let hint = error.span().and_then(|span| slips::what_to_type(text, span.start));
    hint.map_or(words.clone(), |hint| format!("{words}: {hint}"))
}

fn uncertainty(root: &Section) -> Result<Option<IntrinsicsUncertainty>, Fault> {
    let Some(value) = root.get("uncertainty") else { return Ok(None) };
    let DeValue::Table(table) = value.get_ref() else {
        return Err(root.wrong_type("uncertainty", value, "a table [uncertainty] with the 3 sigma of each number"));
    };
    let section = Section { text: root.text, name: "uncertainty.", table };
    section.refuse_unknown(&UNCERTAINTY_KEYS)?;
    let sigma = |key: &str| {
        let value = section.at_least_zero(key)?;
        value.ok_or_else(|| Fault { line: root.line("uncertainty"), ..missing(&section.full(key), "its 3 sigma") })
    };
    let distortion = section.distortion()?.unwrap_or_default();
    if let Some(&value) = distortion.iter().find(|v| !POSSIBLE_ERRORS.contains(v)) {
        return Err(section.out_of_range("distortion", value));
    }
    let skew = section.at_least_zero("skew")?.unwrap_or(0.0);
    let (focal_px, centre_px) = ([sigma("fx")?, sigma("fy")?], [sigma("cx")?, sigma("cy")?]);
    Ok(Some(IntrinsicsUncertainty { focal_px, centre_px, skew, distortion }))
}

/// One table of the file, with what is needed to locate its values.
struct Section<'a> {
    text: &'a str,
    name: &'static str,
    table: &'a DeTable<'a>,
}

impl<'a> Section<'a> {
    fn get(&self, key: &str) -> Option<&'a Spanned<DeValue<'a>>> {
        self.table.get(key)
    }

    fn full(&self, key: &str) -> String {
        format!("{}{key}", self.name)
    }

    fn line(&self, key: &str) -> Option<usize> {
        self.get(key).map(|v| line_at(self.text, v.span()))
    }

    fn refuse_unknown(&self, known: &[&'static str]) -> Result<(), Fault> {
        let stranger = self.table.keys().filter(|k| !known.contains(&k.get_ref().as_ref())).min_by_key(|k| k.span().start);
        let Some(key) = stranger else { return Ok(()) };
        let typed = key.get_ref().as_ref();
        let likeness = |name: &&&str| (strsim::jaro_winkler(typed, name) * 1e9) as i64;
        let nearest = known.iter().max_by_key(likeness).map(|n| self.full(n)).unwrap_or_default();
        let problem = CalibrationProblem::UnknownKey { key: self.full(typed), nearest };
        Err(Fault { line: Some(line_at(self.text, key.span())), problem })
    }

    fn wrong_type(&self, key: &str, value: &Spanned<DeValue>, expected: &'static str) -> Fault {
        let found = format!("a {}", value.get_ref().type_str());
        let problem = CalibrationProblem::WrongType { key: self.full(key), found, expected };
        Fault { line: Some(line_at(self.text, value.span())), problem }
    }

    fn out_of_range(&self, key: &str, value: f64) -> Fault {
        let problem = CalibrationProblem::OutOfRange { key: self.full(key), value, expected: "a number from 0 to 100000" };
        Fault { line: self.line(key), problem }
    }

    fn number(&self, key: &str) -> Result<f64, Fault> {
        self.optional_number(key)?.ok_or_else(|| missing(&self.full(key), "a number, pixels"))
    }

    fn optional_number(&self, key: &str) -> Result<Option<f64>, Fault> {
        let Some(value) = self.get(key) else { return Ok(None) };
        as_number(value.get_ref()).map(Some).ok_or_else(|| self.wrong_type(key, value, "a number"))
    }

    fn at_least_zero(&self, key: &str) -> Result<Option<f64>, Fault> {
        match self.optional_number(key)? {
            Some(value) if !POSSIBLE_ERRORS.contains(&value) => Err(self.out_of_range(key, value)),
            value => Ok(value),
        }
    }

    fn pixels(&self, key: &str) -> Result<u32, Fault> {
        let value = self.get(key).ok_or_else(|| missing(key, "the picture's size in whole pixels"))?;
        self.count(key, value)
    }

    fn count(&self, key: &str, value: &Spanned<DeValue>) -> Result<u32, Fault> {
        let whole = value.get_ref().as_integer().and_then(|i| u32::from_str_radix(i.as_str(), i.radix()).ok());
        whole.ok_or_else(|| self.wrong_type(key, value, "a whole number, 0 or above"))
    }

    fn distortion(&self) -> Result<Option<[f64; 5]>, Fault> {
        let Some(value) = self.get("distortion") else { return Ok(None) };
        let array = value.get_ref().as_array().ok_or_else(|| self.wrong_type("distortion", value, DISTORTION))?;
        let numbers = array.iter().map(|v| as_number(v.get_ref()).ok_or_else(|| self.wrong_type("distortion", v, DISTORTION)));
        let numbers = numbers.collect::<Result<Vec<_>, _>>()?;
        let wrong_length = |v: Vec<f64>| {
            if let Some(hint) = slips::points_for_commas(self.text, value.span(), 5) {
                return Fault { line: self.line("distortion"), problem: CalibrationProblem::Syntax { reason: hint } };
            }
            let problem = CalibrationProblem::WrongLength { key: self.full("distortion"), found: v.len(), expected: DISTORTION };
            Fault { line: self.line("distortion"), problem }
        };
        numbers.try_into().map(Some).map_err(wrong_length)
    }

    fn date(&self) -> Result<Option<String>, Fault> {
        let Some(value) = self.get("date") else { return Ok(None) };
        match value.get_ref() {
            DeValue::String(s) => Ok(Some(s.to_string())),
            DeValue::Datetime(d) => Ok(Some(d.to_string())),
            _ => Err(self.wrong_type("date", value, "a date in quotes")),
        }
    }
}

fn as_number(value: &DeValue) -> Option<f64> {
    match value {
        DeValue::Float(f) => f.as_str().parse().ok(),
        DeValue::Integer(i) => i64::from_str_radix(i.as_str(), i.radix()).ok().map(|i| i as f64),
        _ => None,
    }
}

/// Returns the line, from 1, in which `span` starts.
fn line_at(text: &str, span: Range<usize>) -> usize {
    1 + text.as_bytes().iter().take(span.start).filter(|b| **b == b'\n').count()
}

/// Writes a stagepose calibration file. Rust's shortest float format is valid TOML and reads back
/// to the same bits.
pub(super) fn write(calibration: &Calibration) -> String {
    let i = calibration.model.intrinsics();
    let mut text = format!(
        "width = {}\nheight = {}\nfx = {:?}\nfy = {:?}\ncx = {:?}\ncy = {:?}\nskew = {:?}\ndistortion = {:?}\n",
        i.width, i.height, i.fx, i.fy, i.cx, i.cy, i.skew, i.distortion
    );
    let mut line = |key: &str, value: Option<String>| {
        if let Some(value) = value {
            let _ = writeln!(text, "{key} = {value}"); // writing to a String cannot fail
        }
    };
    line("rms_px", calibration.rms_px.map(|v| format!("{v:?}")));
    line("images", calibration.images.map(|v| v.to_string()));
    line("date", calibration.date.clone().map(|v| toml::Value::String(v).to_string()));
    if let Some(u) = &calibration.uncertainty {
        text += "\n[uncertainty] # 3 sigma\n";
        text += &format!(
            "fx = {:?}\nfy = {:?}\ncx = {:?}\ncy = {:?}\nskew = {:?}\ndistortion = {:?}\n",
            u.focal_px[0], u.focal_px[1], u.centre_px[0], u.centre_px[1], u.skew, u.distortion
        );
    }
    text
}
