//! The colour scale of reports: a colour means the same number of pixels in every figure and in
//! every report.
//!
//! It has eight steps from blue to red, which colour-blind readers can distinguish too; each step
//! is about twice the previous one.

use crate::html_page::svg::Drawing;

/// Upper ends of the steps, pixels; the last step is open. They range from well below a corner's
/// accuracy to what anyone sees; steps of 1, 2 and 5 read easily. They are the same in every
/// report, so that reports can be compared.
const ENDS_PX: [f64; 7] = [0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0];
/// A colour for each step (ColorBrewer's RdYlBu, reversed) …
const COLOURS: [&str; 8] = ["#4575b4", "#74add1", "#abd9e9", "#e0f3f8", "#fee090", "#fdae61", "#f46d43", "#d73027"];
/// … and the colour of text on it.
const TEXT: [&str; 8] = ["#fff", "#111", "#111", "#111", "#111", "#111", "#111", "#fff"];

/// Height of the bar below a figure, in the figure's units: what [`bar`] draws, and a little more.
/// Lowered, its numbers are cut off.
pub(super) const BAR_HEIGHT: f64 = 46.0;

fn step(pixels: f64) -> usize {
    ENDS_PX.iter().filter(|end| pixels > **end).count()
}

/// Returns the colour of a number of pixels.
pub(super) fn colour(pixels: f64) -> &'static str {
    COLOURS[step(pixels)]
}

/// Returns the text colour that is readable on [`colour`].
pub(super) fn text_colour(pixels: f64) -> &'static str {
    TEXT[step(pixels)]
}

/// Draws the bar below a figure of this width, from `top` downwards.
pub(super) fn bar(drawing: &mut Drawing, width: f64, top: f64) {
    let (left, cell) = (0.06 * width, 0.82 * width / COLOURS.len() as f64);
    for (k, colour) in COLOURS.iter().enumerate() {
        drawing.rect([left + cell * k as f64, top + 12.0], [cell + 0.4, 13.0], "none", colour);
    }
    drawing.rect([left, top + 12.0], [cell * COLOURS.len() as f64, 13.0], "var(--faint)", "none");
    for (k, end) in ENDS_PX.iter().enumerate() {
        drawing.text([left + cell * (k + 1) as f64, top + 40.0], 13.0, "middle", "var(--ink)", &format!("{end}"));
    }
    drawing.text([left + cell * COLOURS.len() as f64 + 8.0, top + 24.0], 13.0, "start", "var(--ink)", "pixels");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colour_scale_rises_with_the_error_and_ends_in_red() {
        assert_eq!([0.0, 0.05, 0.051, 0.7, 5.0, 5.1, f64::INFINITY].map(step), [0, 0, 1, 4, 6, 7, 7]);
        assert_eq!((colour(0.0), colour(100.0)), ("#4575b4", "#d73027"));
    }
}
