//! Writes a page as SVG, in millimetres.

use std::fmt::Write;

use super::page::{Item, LINE_MM, Page, Style};

/// Returns the page as SVG; `picture` is the file with its picture, next to the SVG.
pub fn write(page: &Page, picture: &str) -> String {
    let [width, height] = page.size_mm;
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}mm\" height=\"{height}mm\" viewBox=\"0 0 {width} {height}\">\n\
         <rect width=\"{width}\" height=\"{height}\" fill=\"white\"/>\n"
    );
    for item in &page.items {
        // Writing to a String cannot fail.
        let _ = match item {
            Item::Squares { at, side } => {
                let path: String = at.iter().map(|[x, y]| format!("M{x:.4} {y:.4}h{side:.4}v{side:.4}h-{side:.4}z")).collect();
                writeln!(text, "<path fill=\"black\" d=\"{path}\"/>")
            }
            Item::Lines(lines) => {
                let path: String = lines.iter().map(|[x, y, u, v]| format!("M{x:.3} {y:.3}L{u:.3} {v:.3}")).collect();
                writeln!(text, "<path fill=\"none\" stroke=\"black\" stroke-width=\"{LINE_MM}\" d=\"{path}\"/>")
            }
            Item::Text { at: [x, y], size, text: words, style } => {
                let form = match style {
                    Style::Plain => "font-family=\"sans-serif\"",
                    Style::Centred => "font-family=\"sans-serif\" text-anchor=\"middle\"",
                    Style::Typewriter => "font-family=\"monospace\" xml:space=\"preserve\"",
                };
                writeln!(text, "<text x=\"{x:.3}\" y=\"{y:.3}\" {form} font-size=\"{size:.2}\">{}</text>", escaped(words))
            }
            Item::Picture { at: [x, y], size: [w, h] } => writeln!(
                text,
                "<image x=\"{x}\" y=\"{y}\" width=\"{w}\" height=\"{h}\" preserveAspectRatio=\"none\" href=\"{}\"/>",
                escaped(picture)
            ),
        };
    }
    text + "</svg>\n"
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;")
}
