//! A map's report: what it was made from, the facets by their sigma with the walk, the verdict.

use std::fmt::Write as _;

use crate::cli::layout_figures::layout;
use crate::html_page::page;
use crate::html_page::svg::escaped;
use crate::survey::walked::judgement::Judgement;
use crate::survey::walked::mapping::map::Mapped;

/// Sigma at which a facet is drawn in red, millimetres; at 0 it is green. Raised, facets that are
/// known poorly look well known.
const RED_MM: f64 = 1.0;
/// Hue of the best known facet, degrees.
const GREEN_HUE: f64 = 130.0;

/// Returns the page.
pub(super) fn html(made: &Mapped, judgement: &Judgement, date: &str) -> String {
    let mut body = format!("<p><b>{}</b></p>\n<table>", escaped(&judgement.sentence()));
    for line in super::text::text(made, judgement).lines() {
        let (label, value) = line.split_once("  ").unwrap_or((line, ""));
        let _ = write!(body, "<tr><th>{}</th><td>{}</td></tr>", escaped(label), escaped(value.trim_start()));
    }
    body += "</table>\n";
    let described = made.survey.described();
    let facet = |k: &usize| {
        let sigma_mm = described.get(*k).map_or(RED_MM, |facet| facet.sigma_mm);
        (&made.survey.surfaces[*k], format!("hsl({:.0} 75% 42%)", GREEN_HUE * (1.0 - sigma_mm / RED_MM).clamp(0.0, 1.0)))
    };
    body += &layout(&made.kept.iter().map(facet).collect::<Vec<_>>(), &made.survey.cameras);
    let _ = writeln!(body, "<p>Facets are green where they are known best, red at a sigma of {RED_MM} mm and more.</p>");
    body += &facets(made);
    page("Map of a set", date, &body)
}

/// Returns a table of the facets.
fn facets(made: &Mapped) -> String {
    let described = made.survey.described();
    let mut rows = "<table><tr><th>facet</th><th>size, m</th><th>centre, m</th><th>sigma, mm</th><th>sigma, degrees</th></tr>".to_owned();
    for (k, facet) in made.kept.iter().zip(&made.map.facets) {
        let Some(description) = described.get(*k) else { continue };
        let ([width, height], centre) = (facet.size_m, facet.pose.translation);
        let _ = write!(
            rows,
            "<tr><th>{}</th><td>{width:.2} x {height:.2}</td><td>{:.2}, {:.2}, {:.2}</td><td>{:.2}</td><td>{:.3}</td></tr>",
            escaped(&facet.name),
            centre.x,
            centre.y,
            centre.z,
            description.sigma_mm,
            description.sigma_deg
        );
    }
    rows + "</table>\n"
}
