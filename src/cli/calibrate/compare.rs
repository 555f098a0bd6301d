//! `--compare`: how far apart two calibrations project the same points, pixels over the picture.

use std::fmt::Write;
use std::path::Path;

use super::{CalibrateArguments, output};
use crate::calibrate::judge::map::{self, MAP_COLUMNS, MAP_ROWS};
use crate::calibrate::report::{self, Comparison};
use crate::camera::{Calibration, CameraModel};
use crate::cli::failure::Failure;
use crate::cli::output_file::print;
use crate::config::read_calibration;
use crate::printable::printable_lines;
use crate::utc;

/// Another calibration with its file's name.
pub(super) type Other<'a> = (&'a Path, Calibration);

/// Reads the other calibration.
pub(super) fn read(file: &Path) -> Result<Other<'_>, Failure> {
    Ok((file, read_calibration(file).map_err(|e| Failure::Usage(e.to_string()))?))
}

/// Returns the calibration file given in place of pictures, if two files are to be compared.
pub(super) fn two_files(arguments: &CalibrateArguments) -> Option<&Path> {
    arguments.compare.as_ref()?;
    match arguments.images.as_slice() {
        [file] if arguments.board.is_none() && file.is_file() && arguments.clip.is_none() => Some(file),
        _ => None,
    }
}

/// Compares two calibration files.
pub(super) fn run(own: &Path, arguments: &CalibrateArguments) -> Result<(), Failure> {
    let Some(other) = &arguments.compare else { return Ok(()) };
    if arguments.output.is_some() || arguments.json.is_some() {
        let why = "--output and --json need pictures to calibrate from; with two calibration files give --report only";
        return Err(Failure::Usage(why.to_owned()));
    }
    output::refuse_unwritable(arguments)?;
    let comparison = between(&read(own)?.1.model, &read(other)?)?;
    print(printable_lines(&table(&comparison)).as_bytes())?;
    match &arguments.report {
        Some(file) => output::write(file, report::comparison_html(&own.display().to_string(), &comparison, &utc::report_date())),
        None => Ok(()),
    }
}

/// Computes the difference from a model to another calibration, which may be for another size of
/// the same aspect ratio.
pub(super) fn between(model: &CameraModel, (name, other): &Other<'_>) -> Result<Comparison, Failure> {
    let scaled = other.model.scaled_to(model.width(), model.height());
    let scaled = scaled.map_err(|e| Failure::Usage(format!("{}: {e}", name.display())))?;
    let field = map::difference(model, &scaled);
    Ok(Comparison { name: name.display().to_string(), size: (model.width(), model.height()), field })
}

/// Returns the difference as a grid of numbers.
pub(super) fn table(comparison: &Comparison) -> String {
    let lengths = comparison.lengths();
    let mut text = String::new();
    // Writing to a String cannot fail.
    let _ = writeln!(text, "\nDifference to {}, pixels over the picture (the camera turned so that they fit best):\n", comparison.name);
    for row in lengths.values_px.chunks(MAP_COLUMNS).step_by(2).take(MAP_ROWS) {
        let cells: Vec<String> = row.iter().step_by(2).map(|v| v.map_or("      -".to_owned(), |v| format!("{v:7.3}"))).collect();
        let _ = writeln!(text, "  {}", cells.join(" "));
    }
    let _ = writeln!(text, "\n  median {:.3} px, worst {:.3} px", lengths.quantile(0.5), lengths.worst());
    text
}
