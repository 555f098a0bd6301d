//! The report: one self-contained HTML file for whoever took the pictures.
//!
//! It states in plain words what the calibration is worth and what to do next, and shows where the
//! board has been and what the lens does. The parameters as calibration programs use them are
//! folded away at the end of their part. It follows the reader's light or dark scheme.

mod figures;
mod numbers;
mod scale;

use nalgebra::Vector2;

use super::judge::map::{PixelMap, lengths};
use super::judge::{Judgement, Verdict};
use super::session::{CalibrationView, CameraCalibration};
use crate::html_page::svg::escaped;
use crate::html_page::{figure, page};

/// Colours of lines and text, which follow the reader's scheme.
const INK: &str = "var(--ink)";
const PALE: &str = "var(--faint)";

/// The difference to another calibration; see [`super::judge::map::difference`].
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// The other calibration's name.
    pub name: String,
    /// Width and height of the picture, pixels.
    pub size: (u32, u32),
    /// Displacement from this calibration to the other, pixels, at the places of the map.
    pub field: Vec<Option<Vector2<f64>>>,
}

impl Comparison {
    /// Returns the lengths of the differences.
    pub fn lengths(&self) -> PixelMap {
        lengths(&self.field)
    }
}

/// Returns the report of a calibration; `date` is when it was made.
pub fn html(made: &CameraCalibration, comparison: Option<&Comparison>, date: &str) -> String {
    let views = by_name(&made.views);
    let number = |index: usize| 1 + views.iter().position(|view| view.index == Some(index)).unwrap_or(index);
    let mut body = facts(made, date);
    body += &verdict(&made.judgement);
    body += &numbers::part(made);
    body += "<h2>Where the board has been, and how well it fits</h2>\n<div class=\"figures\">";
    body += &figure(
        &figures::coverage(made),
        "<b>Coverage.</b> Every corner of every picture used. The lens is known best where there are many corners, and only extrapolated \
         where there are none. Colours: how far a corner lies from where the calibration expects it.",
    );
    body += &figure(
        &figures::errors(made),
        "<b>Residuals.</b> Each dot is a corner: the middle is where the calibration expects it, the dot where the picture shows it. A \
         round cloud is good; a lopsided one suggests a bent board or a lens that changed.",
    );
    let caption = "<b>How far to trust a place in the picture.</b> The colour says within how many pixels a point lies of where the \
                   calibration puts it, in 997 of 1000 cases (3 sigma). Errors that a small rotation of the camera compensates are left \
                   out, because tracking finds that rotation by itself.";
    body += &figure(&figures::map(&made.judgement.uncertainty, made.size, "Uncertainty over the picture"), caption);
    if let Ok(model) = made.estimate.bundle.lens.model(made.size.0, made.size.1) {
        let caption = "<b>What the lens does.</b> Lines lead from where a lens without distortion would show a point to where this one does. The red \
                       cross is where the lens looks straight ahead.";
        body += &figure(&figures::distortion(&model), caption);
    }
    let caption = "<b>The camera and the boards</b>, as they stood when the pictures were taken; numbers as below.";
    body += &figure(&figures::space(made, number), caption);
    body += "</div>\n";
    if let Some(comparison) = comparison {
        body += &comparison_part(comparison);
    }
    body += "<h2>Pictures</h2>\n<p>Green crosses: corners found. Red crosses: left out, because they do not fit. The circle is the \
             board's first corner; the red line runs along its rows, the yellow one along its columns.</p>\n<div class=\"pictures\">";
    for (k, view) in views.iter().enumerate() {
        body += &picture(k + 1, view, made);
    }
    body += "</div>\n";
    body += &numbers::poses(made, &views);
    page("Camera calibration", date, &body)
}

/// Returns the report of a comparison of two calibration files; `date` is when it was made.
pub fn comparison_html(own: &str, comparison: &Comparison, date: &str) -> String {
    page(&format!("{own} and {}", comparison.name), date, &comparison_part(comparison))
}

/// Sorts the views in natural order: view2 before view10.
fn by_name(views: &[CalibrationView]) -> Vec<&CalibrationView> {
    let mut sorted: Vec<&CalibrationView> = views.iter().collect();
    sorted.sort_by(|a, b| alphanumeric_sort::compare_path(&a.file, &b.file));
    sorted
}

/// States what was calibrated, with what, and when.
fn facts(made: &CameraCalibration, date: &str) -> String {
    let used = made.views.iter().filter(|view| view.used).count();
    let ((width, height), all, version) = (made.size, made.views.len(), env!("CARGO_PKG_VERSION"));
    let (columns, rows, mm) = (made.board.columns(), made.board.rows(), (1e3 * made.board.square_m() * 1e3).round() / 1e3);
    let camera = made.camera.as_ref().map_or(String::new(), |camera| format!("{} &middot; ", escaped(camera)));
    format!(
        "<p class=\"facts\">{camera}pictures of {width} &times; {height} pixels &middot; {used} of {all} used &middot; board of {columns} &times; {rows} \
         inner corners, squares of {mm} mm &middot; {} &middot; stagepose {version}</p>\n",
        escaped(date)
    )
}

fn verdict(judgement: &Judgement) -> String {
    let class = match judgement.verdict {
        Verdict::Good => "good",
        Verdict::Usable => "usable",
        Verdict::DoNotUse => "bad",
    };
    let others = judgement.findings.iter().filter(|f| f.weight != judgement.verdict);
    let texts = others.map(|f| &f.text).chain(&judgement.remarks);
    let list: String = texts.map(|text| format!("<li>{}</li>", escaped(text))).collect();
    format!(
        "<div class=\"verdict {class}\"><b>Verdict: {}</b>{}.<ul>{list}</ul>Take next: {}.</div>\n",
        judgement.verdict,
        escaped(judgement.sentence().strip_prefix(&judgement.verdict.to_string()).unwrap_or_default()),
        escaped(&judgement.next_picture)
    )
}

fn comparison_part(comparison: &Comparison) -> String {
    let lengths = comparison.lengths();
    let map = figures::map(&lengths, comparison.size, "Difference in pixels");
    let arrows = figures::arrows(&comparison.field, comparison.size);
    format!(
        "<h2>Difference to {}</h2>\n<p>Median {:.3} px, worst {:.3} px, the camera turned so that they fit best.</p><div class=\"figures\">{}{}</div>\n",
        escaped(&comparison.name),
        lengths.quantile(0.5),
        lengths.worst(),
        figure(&map, "How far the two put the same point apart"),
        figure(&arrows, "The same as lines, enlarged")
    )
}

fn picture(number: usize, view: &CalibrationView, made: &CameraCalibration) -> String {
    let drawn = figures::picture(view, made.size, &made.board).unwrap_or_default();
    let name = short_name(view);
    let state = match (&view.reason, view.used) {
        (Some(reason), false) => format!("not used: {}", escaped(reason)),
        (_, false) => "not used".to_owned(),
        (reason, true) => {
            let remark = reason.as_ref().map_or(String::new(), |r| format!("; {}", escaped(r)));
            format!("fits to {:.2} px{}{remark}", view.rms_px.unwrap_or(0.0), left_out(view))
        }
    };
    let class = if view.used { "" } else { " class=\"off\"" };
    format!("<figure{class}>{drawn}<figcaption><b>{number}: {name}</b><br>{state}</figcaption></figure>\n")
}

/// Returns the picture's file name, with the whole path as a tooltip.
fn short_name(view: &CalibrationView) -> String {
    let name = view.file.file_name().map_or(view.file.as_os_str(), |name| name).to_string_lossy();
    format!("<span title=\"{}\">{}</span>", escaped(&view.file.display().to_string()), escaped(&name))
}

fn left_out(view: &CalibrationView) -> String {
    if view.outliers.is_empty() { String::new() } else { format!(", {} corners left out", view.outliers.len()) }
}
