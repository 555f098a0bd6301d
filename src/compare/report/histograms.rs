//! Two curves: the matches' descriptor distances, and their distances from the model (the source's
//! figure 23 has the first, and calls it an error).

use crate::compare::Comparison;
use crate::html_page::svg::Drawing;

/// Size of a curve's field in figure units, across and down, and the margin around it for its
/// numbers.
const FIELD: [f64; 2] = [400.0, 220.0];
const MARGIN: f64 = 34.0;
/// Right end of the error curve, pixels. A match farther off is not inaccurate but wrong.
const MAX_PX: f64 = 8.0;

pub(super) fn cumulative(made: &Comparison) -> String {
    let mut drawing = Drawing::new(2.0 * (FIELD[0] + MARGIN), FIELD[1] + 2.0 * MARGIN);
    let distances = sorted(made.matches.iter().map(|m| f64::from(m.distance)).collect());
    let most = distances.last().copied().unwrap_or(1.0).max(1e-9);
    curve(&mut drawing, MARGIN / 2.0, &distances, most, "distance of descriptors");
    let errors = sorted(made.errors_px());
    curve(&mut drawing, FIELD[0] + 1.5 * MARGIN, &errors, MAX_PX, "pixels from the model");
    drawing.finish("Shares of the matches below a distance of descriptors, and below an error in pixels")
}

fn sorted(mut values: Vec<f64>) -> Vec<f64> {
    values.retain(|v| v.is_finite());
    values.sort_by(f64::total_cmp);
    values
}

/// Draws the fraction of the sorted `values` below each number up to `most`.
fn curve(drawing: &mut Drawing, left: f64, values: &[f64], most: f64, words: &str) {
    let top = MARGIN / 2.0;
    drawing.rect([left, top], FIELD, "var(--faint)", "none");
    let count = values.len().max(1) as f64;
    let mut places = vec![[left, top + FIELD[1]]];
    for (k, value) in values.iter().enumerate().filter(|(_, v)| **v <= most) {
        places.push([left + FIELD[0] * value / most, top + FIELD[1] * (1.0 - (k + 1) as f64 / count)]);
    }
    drawing.path(&places, false, "var(--blue)", "none", 1.6);
    for part in 0..=4 {
        let share = f64::from(part) / 4.0;
        let number = format!("{:.3}", share * most);
        let number = number.trim_end_matches('0').trim_end_matches('.').to_owned();
        drawing.text([left + share * FIELD[0], top + FIELD[1] + 14.0], 11.0, "middle", "var(--ink)", &number);
        drawing.line([left, top + FIELD[1] * share], [left + FIELD[0], top + FIELD[1] * share], "var(--line)", 0.5);
    }
    drawing.text([left + FIELD[0] / 2.0, top + FIELD[1] + 30.0], 12.0, "middle", "var(--ink)", words);
}
