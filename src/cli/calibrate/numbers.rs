//! `--fix`, `--skew`, `--k3`, `--profile`: which parameters are estimated.

use super::{CalibrateArguments, Profile};
use crate::calibrate::session::CalibrationOptions;
use crate::calibrate::solve::SolveOptions;
use crate::calibrate::solve::lens::{FreeNumbers, LENS_NAMES};
use crate::cli::failure::Failure;

/// Returns the options that the arguments ask for.
pub(super) fn options(arguments: &CalibrateArguments) -> Result<CalibrationOptions, Failure> {
    let bouguet = arguments.profile == Some(Profile::Bouguet);
    let mut solve = SolveOptions { free: FreeNumbers::default(), bouguet, ..SolveOptions::default() };
    solve.free.free[4] = arguments.skew;
    solve.free.free[9] = arguments.k3;
    for word in &arguments.fix {
        fix(&mut solve, word.trim())?;
    }
    Ok(CalibrationOptions { solve, keep_all_views: bouguet })
}

/// Applies one word of `--fix`.
fn fix(solve: &mut SolveOptions, word: &str) -> Result<(), Failure> {
    let (name, value) = match word.split_once('=') {
        Some((name, value)) => (name.trim(), Some(value.trim())),
        None => (word, None),
    };
    if name == "aspect" && value.is_none() {
        solve.free.square_pixels = true;
        return Ok(());
    }
    let Some(number) = LENS_NAMES.iter().position(|known| *known == name) else {
        let known = LENS_NAMES.join(", ");
        return Err(Failure::Usage(format!("--fix {word}: there is no number of that name; give one of {known} or aspect")));
    };
    let value = match value.map(str::parse::<f64>) {
        None => None,
        Some(Ok(value)) if value.is_finite() && (number > 1 || value > 0.0) => Some(value),
        Some(_) => return Err(Failure::Usage(format!("--fix {word}: the value after = is not valid for it; write --fix {name}=500"))),
    };
    if number < 2 && value.is_none() {
        return Err(Failure::Usage(format!("--fix {word}: a focal length has no default; write --fix {name}=VALUE in pixels")));
    }
    solve.free.free[number] = false;
    solve.held[number] = value;
    Ok(())
}
