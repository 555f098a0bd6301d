//! The report: one HTML file that needs nothing else, with the source thesis' figures as SVG and the numbers as Bouguet
//! prints them.

mod figures;
mod svg;

use nalgebra::Vector2;

use super::judge::map::{PixelMap, lengths};
use super::judge::{Judgement, Verdict};
use super::session::{CalibrationView, CameraCalibration};
use super::table::bouguet;
use svg::escaped;

/// How far another calibration puts the same points apart; see [`super::judge::map::difference`].
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// The other calibration's name.
    pub name: String,
    /// Width and height of the picture, pixels.
    pub size: (u32, u32),
    /// From here to there, pixels, over the places of the map.
    pub field: Vec<Option<Vector2<f64>>>,
}

impl Comparison {
    /// The differences' lengths.
    pub fn lengths(&self) -> PixelMap {
        lengths(&self.field)
    }
}

const STYLE: &str = "body{font:15px/1.45 system-ui,sans-serif;color:#222;max-width:1080px;margin:1.5em auto;padding:0 1em}\
h1{font-size:1.5em}h2{font-size:1.15em;margin-top:2em;border-bottom:1px solid #ddd}pre{background:#f5f5f3;padding:.8em;overflow-x:auto;font-size:.84em}\
.verdict{padding:.7em 1em;border-left:6px solid;background:#f7f7f5}.good{border-color:#2a9d3a}.usable{border-color:#d99a00}.bad{border-color:#cc2b2b}\
.grid{display:grid;grid-template-columns:repeat(auto-fill,minmax(235px,1fr));gap:12px}.two{display:grid;grid-template-columns:1fr 1fr;gap:18px}\
figure{margin:0}figcaption{font-size:.82em;color:#555;overflow-wrap:anywhere}svg{width:100%;height:auto;display:block}.off{opacity:.6}\
table{border-collapse:collapse;font-size:.85em;display:block;overflow-x:auto}td,th{padding:.2em .6em;border-bottom:1px solid #e5e5e5;text-align:right;white-space:nowrap}\
td:first-child,th:first-child{text-align:left}@media(max-width:700px){.two{grid-template-columns:1fr}}";

fn page(title: &str, body: &str) -> String {
    let title = escaped(title);
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">\
         <title>{title}</title><style>{STYLE}</style></head><body><h1>{title}</h1>\n{body}</body></html>\n"
    )
}

fn figure(svg: &str, caption: &str) -> String {
    format!("<figure>{svg}<figcaption>{caption}</figcaption></figure>\n")
}

/// The report of a calibration.
pub fn html(made: &CameraCalibration, comparison: Option<&Comparison>) -> String {
    let mut body = verdict(&made.judgement);
    body += "<h2>Numbers</h2>\n<pre>";
    body += &escaped(&bouguet(made));
    body += "</pre>\n";
    body += &format!(
        "<p>What follows +/- is 3 sigma. Reprojection error per point {:.4} px over {} corners. Corners were measured again with the lens {} \
         time(s); the last time none moved by more than {:.4} px.</p>\n",
        made.estimate.rms_px,
        made.estimate.used.iter().flatten().filter(|u| **u).count(),
        made.rounds.0,
        made.rounds.1
    );
    body += "<h2>Errors, boards in space, lens, uncertainty</h2>\n<div class=\"two\">";
    body +=
        &figure(&figures::errors(made), "Reprojection errors, one colour a picture: corner as seen minus corner as predicted (fig. 20)");
    body += &figure(&figures::space(made), "The camera and the boards as it saw them; numbers as in the table below (fig. 21)");
    if let Ok(model) = made.estimate.bundle.lens.model(made.size.0, made.size.1) {
        body += &figure(&figures::distortion(&model), "How the lens moves points; the red cross is the principal point (fig. 15)");
    }
    let caption = "3 sigma of where a distant point appears, pixels; the turn of the camera that a tracker finds by itself is taken out";
    body += &figure(&figures::map(&made.judgement.uncertainty, made.size, "Projection uncertainty"), caption);
    body += "</div>\n";
    if let Some(comparison) = comparison {
        body += &comparison_part(comparison);
    }
    body += "<h2>Pictures</h2>\n<p>Green crosses: corners found. Red: left out. The circle is the board's origin, red its x axis, yellow its y axis \
             (fig. 16-19).</p>\n<div class=\"grid\">";
    for view in &made.views {
        body += &picture(view, made);
    }
    body += "</div>\n";
    body += &poses(made);
    page("Camera calibration", &body)
}

/// The report of two calibration files.
pub fn comparison_html(own: &str, comparison: &Comparison) -> String {
    page(&format!("{own} and {}", comparison.name), &comparison_part(comparison))
}

fn verdict(judgement: &Judgement) -> String {
    let class = match judgement.verdict {
        Verdict::Good => "good",
        Verdict::Usable => "usable",
        Verdict::DoNotUse => "bad",
    };
    let others = judgement.findings.iter().filter(|f| f.weight != judgement.verdict);
    let list: String = others.map(|f| format!("<li>{}</li>", escaped(&f.text))).collect();
    format!(
        "<div class=\"verdict {class}\"><b>Verdict: {}.</b><ul>{list}</ul>Take next: {}.</div>\n",
        escaped(&judgement.sentence()),
        escaped(&judgement.next_picture)
    )
}

fn comparison_part(comparison: &Comparison) -> String {
    let lengths = comparison.lengths();
    let map = figures::map(&lengths, comparison.size, "Difference in pixels");
    let arrows = figures::arrows(&comparison.field, comparison.size);
    format!(
        "<h2>Difference to {}</h2>\n<p>Median {:.3} px, worst {:.3} px, the camera turned so that they fit best.</p><div class=\"two\">{}{}</div>\n",
        escaped(&comparison.name),
        lengths.quantile(0.5),
        lengths.worst(),
        figure(&map, "Pixels over the picture"),
        figure(&arrows, "The same as arrows, enlarged")
    )
}

fn picture(view: &CalibrationView, made: &CameraCalibration) -> String {
    let drawn = figures::picture(view, made.size, &made.board).unwrap_or_default();
    let name = short_name(view);
    let number = view.index.map_or(String::new(), |k| format!("{}: ", k + 1));
    let state = match (&view.reason, view.used) {
        (Some(reason), false) => format!("rejected: {}", escaped(reason)),
        (_, false) => "rejected".to_owned(),
        (reason, true) => {
            let remark = reason.as_ref().map_or(String::new(), |r| format!("; {}", escaped(r)));
            format!("used, {:.3} px{}{remark}", view.rms_px.unwrap_or(0.0), left_out(view))
        }
    };
    let class = if view.used { "" } else { " class=\"off\"" };
    format!("<figure{class}>{drawn}<figcaption>{number}{name}<br>{state}</figcaption></figure>\n")
}

/// The picture's file name, its whole path where the pointer rests on it.
fn short_name(view: &CalibrationView) -> String {
    let name = view.file.file_name().map_or(view.file.as_os_str(), |name| name).to_string_lossy();
    format!("<span title=\"{}\">{}</span>", escaped(&view.file.display().to_string()), escaped(&name))
}

fn left_out(view: &CalibrationView) -> String {
    if view.outliers.is_empty() { String::new() } else { format!(", {} corners left out", view.outliers.len()) }
}

/// Every board's pose with 3 sigma.
fn poses(made: &CameraCalibration) -> String {
    let mut rows = String::new();
    for view in &made.views {
        let (Some(index), Some(pose)) = (view.index, &view.extrinsics) else { continue };
        let three = |v: &nalgebra::Vector3<f64>, s: f64| format!("{:.4} {:.4} {:.4}", s * v.x, s * v.y, s * v.z);
        rows += &format!(
            "<tr><td>{}: {}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>\n",
            index + 1,
            short_name(view),
            three(&pose.rotation_vector, 1.0),
            three(&pose.rotation_uncertainty, 1.0),
            three(&pose.translation_m, 1e3),
            three(&pose.translation_uncertainty_m, 1e3)
        );
    }
    format!(
        "<h2>Poses of the board</h2>\n<table><tr><th>picture</th><th>omc, rad</th><th>&plusmn;</th><th>Tc, mm</th><th>&plusmn;</th></tr>\n{rows}</table>\n"
    )
}
