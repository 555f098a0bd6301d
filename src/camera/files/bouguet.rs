//! Calib_Results.m of Bouguet's calibration toolbox.
//!
//! A list of assignments: `fc = [ 657.46 ; 657.94 ];`. Only the intrinsic ones are read; board
//! poses (`omc_1`, `Tc_1` ...) are skipped. `%` starts a comment. Its pixels count from 0, like
//! stagepose's.

use std::collections::HashMap;

use super::problem::{CalibrationProblem, Fault, missing};
use super::{Calibration, CalibrationForm, IntrinsicsUncertainty, POSSIBLE_ERRORS, model};
use crate::camera::Intrinsics;

/// Every assignment that is read, its possible number of values, and that number in words for
/// messages. Names are the toolbox's.
const KEYS: [(&str, std::ops::RangeInclusive<usize>, &str); 11] = [
    ("fc", 2..=2, "2 numbers"),
    ("cc", 2..=2, "2 numbers"),
    ("alpha_c", 1..=1, "1 number"),
    ("kc", 4..=5, "4 or 5 numbers k1, k2, p1, p2, k3"),
    ("nx", 1..=1, "1 whole number"),
    ("ny", 1..=1, "1 whole number"),
    ("n_ima", 1..=1, "1 whole number"),
    ("fc_error", 2..=2, "2 numbers"),
    ("cc_error", 2..=2, "2 numbers"),
    ("alpha_c_error", 1..=1, "1 number"),
    ("kc_error", 4..=5, "4 or 5 numbers"),
];

/// The values of each assignment and its line.
type Assigned = HashMap<&'static str, (Vec<f64>, usize)>;

pub(super) fn parse(text: &str) -> Result<Calibration, Fault> {
    let assigned = assignments(text)?;
    let get = |key: &str| assigned.get(key).map(|(v, _)| v.as_slice());
    let need = |key: &str, hint| get(key).ok_or_else(|| missing(key, hint));
    let [fc, cc, kc] =
        [need("fc", "fc = [ fx ; fy ];")?, need("cc", "cc = [ cx ; cy ];")?, need("kc", "kc = [ k1 ; k2 ; p1 ; p2 ; k3 ];")?];
    let intrinsics = Intrinsics {
        width: whole(&assigned, "nx")?.ok_or_else(|| missing("nx", "the picture's width, nx = 640;"))?,
        height: whole(&assigned, "ny")?.ok_or_else(|| missing("ny", "the picture's height, ny = 480;"))?,
        fx: fc[0],
        fy: fc[1],
        cx: cc[0],
        cy: cc[1],
        skew: get("alpha_c").map_or(0.0, |v| v[0]),
        distortion: five(kc),
    };
    let line_of = |key: &str| {
        let own = match key {
            "fx" | "fy" => "fc",
            "cx" | "cy" => "cc",
            "skew" => "alpha_c",
            "width" => "nx",
            "height" => "ny",
            _ => "kc",
        };
        assigned.get(own).map(|(_, line)| *line)
    };
    Ok(Calibration {
        model: model(intrinsics, line_of)?,
        uncertainty: uncertainty(&assigned)?,
        rms_px: None,
        images: whole(&assigned, "n_ima")?,
        date: None,
        form: CalibrationForm::Bouguet,
        notes: Vec::new(),
    })
}

fn uncertainty(assigned: &Assigned) -> Result<Option<IntrinsicsUncertainty>, Fault> {
    for key in ["fc_error", "cc_error", "alpha_c_error", "kc_error"] {
        let Some((values, line)) = assigned.get(key) else { continue };
        if let Some(&value) = values.iter().find(|v| !POSSIBLE_ERRORS.contains(v)) {
            let problem = CalibrationProblem::OutOfRange { key: key.to_owned(), value, expected: "numbers from 0 to 100000" };
            return Err(Fault { line: Some(*line), problem });
        }
    }
    let get = |key: &str| assigned.get(key).map(|(v, _)| v.as_slice());
    let (Some(fc), Some(cc)) = (get("fc_error"), get("cc_error")) else { return Ok(None) };
    Ok(Some(IntrinsicsUncertainty {
        focal_px: [fc[0], fc[1]],
        centre_px: [cc[0], cc[1]],
        skew: get("alpha_c_error").map_or(0.0, |v| v[0]),
        distortion: get("kc_error").map_or([0.0; 5], five),
    }))
}

/// Old files have four coefficients; the fifth is then zero.
fn five(kc: &[f64]) -> [f64; 5] {
    std::array::from_fn(|i| kc.get(i).copied().unwrap_or(0.0))
}

fn whole(assigned: &Assigned, key: &str) -> Result<Option<u32>, Fault> {
    let Some((values, line)) = assigned.get(key) else { return Ok(None) };
    let value = values[0];
    if value.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&value) {
        return Ok(Some(value as u32));
    }
    let problem = CalibrationProblem::OutOfRange { key: key.to_owned(), value, expected: "a whole number" };
    Err(Fault { line: Some(*line), problem })
}

/// Collects all assignments of [`KEYS`] with their lengths checked, so that indexing them is safe.
fn assignments(text: &str) -> Result<Assigned, Fault> {
    let mut assigned = Assigned::new();
    for (line, statement) in statements(text) {
        let Some((name, value)) = statement.split_once('=') else { continue };
        let Some((key, length, expected)) = KEYS.iter().find(|(k, ..)| *k == name.trim()) else { continue };
        let at = |problem| Fault { line: Some(line), problem };
        let words = value.split(|c: char| c.is_whitespace() || "[];,".contains(c)).filter(|w| !w.is_empty());
        let parse = |word: &str| {
            word.parse::<f64>().map_err(|_| {
                let found = format!("\"{}\"", word.chars().take(40).collect::<String>());
                at(CalibrationProblem::WrongType { key: (*key).to_owned(), found, expected: "numbers only" })
            })
        };
        let numbers = words.map(parse).collect::<Result<Vec<_>, _>>()?;
        if !length.contains(&numbers.len()) {
            return Err(at(CalibrationProblem::WrongLength { key: (*key).to_owned(), found: numbers.len(), expected }));
        }
        assigned.insert(key, (numbers, line));
    }
    Ok(assigned)
}

/// Splits an m-file into statements with the line each starts on. Removes comments; a statement
/// ends at `;` or a line end outside brackets.
fn statements(text: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    let (mut current, mut start, mut depth) = (String::new(), 1, 0u32);
    for (number, line) in text.lines().enumerate() {
        for c in line.split('%').next().unwrap_or("").chars().chain(['\n']) {
            match c {
                '[' => depth += 1,
                ']' => depth = depth.saturating_sub(1),
                _ => {}
            }
            if (c == ';' || c == '\n') && depth == 0 {
                if !current.trim().is_empty() {
                    found.push((start, std::mem::take(&mut current)));
                }
                current.clear();
            } else {
                if current.trim().is_empty() {
                    start = number + 1;
                }
                current.push(c);
            }
        }
    }
    // A bracket that is never closed: the rest is one statement, checked like any other.
    found.push((start, current));
    found
}
