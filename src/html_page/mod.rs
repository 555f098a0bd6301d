//! Reports: one self-contained HTML file, in the reader's light or dark scheme, with figures as
//! SVG.

pub mod svg;

use svg::escaped;

/// The style sheet of every report.
const STYLE: &str = include_str!("page.css");

/// Returns a whole page around an HTML body; `date` is when it was made.
pub fn page(title: &str, date: &str, body: &str) -> String {
    let (title, date) = (escaped(title), escaped(date));
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
         <title>{title}</title>\n<style>\n{STYLE}</style></head><body><h1>{title}</h1>\n{body}<footer>stagepose {}, {date}</footer>\n</body></html>\n",
        env!("CARGO_PKG_VERSION")
    )
}

/// Returns a figure with its caption, which is HTML.
pub fn figure(svg: &str, caption: &str) -> String {
    format!("<figure>{svg}<figcaption>{caption}</figcaption></figure>\n")
}
