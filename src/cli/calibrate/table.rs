//! The command's output: the pictures that were not used, Bouguet's table, the verdict.

use std::fmt::Write;
use std::path::Path;

use crate::calibrate::session::{CalibrationView, CameraCalibration};
use crate::calibrate::table::bouguet;
use crate::printable::printable;

/// Returns the whole text.
pub(super) fn table(made: &CameraCalibration) -> String {
    let used = made.views.iter().filter(|v| v.used).count();
    let corners: usize = made.estimate.used.iter().flatten().filter(|used| **used).count();
    let mut text = String::new();
    // Writing to a String cannot fail.
    let _ = writeln!(text, "{used} of {} pictures used, {corners} corners; board {}", made.views.len(), made.board);
    let mut views: Vec<&CalibrationView> = made.views.iter().collect();
    views.sort_by(|a, b| alphanumeric_sort::compare_path(&a.file, &b.file));
    for view in views.iter().filter(|view| !view.used) {
        let _ = writeln!(text, "  not used: {}: {}", name(&view.file), view.reason.as_deref().unwrap_or("no board"));
    }
    for view in views.iter().filter(|view| !view.outliers.is_empty()) {
        let _ = writeln!(text, "  {}: {} of its corners do not fit and are left out", name(&view.file), view.outliers.len());
    }
    for view in views.iter().filter(|view| view.used) {
        if let Some(reason) = &view.reason {
            let _ = writeln!(text, "  {}: {reason}", name(&view.file));
        }
    }
    let _ = writeln!(text, "\nCalibration results (with uncertainties):\n");
    text += &bouguet(made);
    let _ = writeln!(text, "\nThe numbers after +/- are 3 sigma. Reprojection error per point: {:.4} px.", made.estimate.rms_px);
    match &made.lateral_colour {
        Ok(colours) => {
            let _ = writeln!(text, "Lateral colour: {}.\n  {}", colours.sizes(), colours.meaning());
        }
        Err(reason) => {
            let _ = writeln!(text, "Lateral colour: not measured; {reason}.");
        }
    }
    let judgement = &made.judgement;
    let _ = writeln!(text, "\nVerdict: {}.", judgement.sentence());
    for finding in judgement.findings.iter().filter(|f| f.weight != judgement.verdict) {
        let _ = writeln!(text, "  {}", finding.text);
    }
    for remark in &judgement.remarks {
        let _ = writeln!(text, "  note: {remark}");
    }
    let _ = writeln!(text, "Take next: {}.", judgement.next_picture);
    text
}

/// Returns a picture's name on one line, whatever characters it has.
fn name(file: &Path) -> String {
    printable(&file.display().to_string()).into_owned()
}
