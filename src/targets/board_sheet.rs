//! The printable board: the chessboard on a page, with a ruler.

use thiserror::Error;

use super::page::{Item, Page, RULER_MM, Style, fitting_size, ruler};
use super::paper::{MARGIN_MM, Paper};
use crate::calibrate::board::Board;

/// White around the board if no paper is named, millimetres. The finder needs some, and a printer
/// only reaches to 5 mm of the edge. Raised, the sheet grows.
const OWN_MARGIN_MM: f64 = 12.0;
/// Space below the board and its margin if no paper is named, millimetres: the ruler, the label of
/// 3 mm type, and 4 mm of white.
const OWN_FOOT_MM: f64 = 16.0;
/// Space below the board on a named paper, millimetres: a gap, the ruler, the label of 3 mm type.
/// Raised, the largest square that fits shrinks.
const FOOT_MM: f64 = 4.0 + RULER_MM + 4.0;
/// Tolerance in what fits, millimetres: far below what a printer resolves, far above the rounding
/// of binary fractions. Anything between would do.
const ROUNDING_MM: f64 = 1e-6;
/// Width of a letter of the label, ems: above Helvetica's mean of about 0.5, since the font is not
/// measured. Raised, the label is printed smaller; lowered, it may run beyond the margin.
const LETTER_EM: f64 = 0.55;

/// The board does not fit on the paper.
#[derive(Debug, Clone, PartialEq, Error)]
#[error(
    "--board {columns}x{rows} with squares of {square_mm} mm does not fit on this paper at 100 %; the largest square that does is {largest_mm} mm, give --square-mm {largest_mm} or a larger --paper"
)]
pub struct DoesNotFit {
    columns: u32,
    rows: u32,
    square_mm: f64,
    largest_mm: f64,
}

/// Returns the board on a page of exactly the size that it needs.
pub fn page(board: &Board) -> Page {
    let [across, down] = sides_mm(board);
    let size_mm = [across + 2.0 * OWN_MARGIN_MM, down + 2.0 * OWN_MARGIN_MM + OWN_FOOT_MM];
    let ruler_top = size_mm[1] - OWN_FOOT_MM;
    drawn(board, size_mm, [OWN_MARGIN_MM; 2], [OWN_MARGIN_MM, ruler_top, size_mm[0] - 2.0 * OWN_MARGIN_MM])
}

/// Returns the board on a paper in the orientation that fits; everything, including the ruler, lies
/// within the printable area.
///
/// # Errors
/// When it fits in neither orientation.
pub fn page_on(board: &Board, paper: Paper) -> Result<Page, DoesNotFit> {
    let [across, down] = sides_mm(board);
    let room = |paper: Paper| {
        let [width, height] = paper.printable_mm();
        [width, height - FOOT_MM]
    };
    // Converting metres to millimetres rounds: a board that just fits must fit.
    let fits = |paper: &Paper| across <= room(*paper)[0] + ROUNDING_MM && down <= room(*paper)[1] + ROUNDING_MM;
    let ways = [paper, paper.turned()];
    let Some(paper) = ways.into_iter().find(fits) else {
        let largest = |paper: Paper| (room(paper)[0] / f64::from(board.columns() + 1)).min(room(paper)[1] / f64::from(board.rows() + 1));
        let largest_mm = ways.map(largest).into_iter().fold(0.0, f64::max);
        // Rounded down to half a millimetre, which can be typed and measured; for tiny squares to a
        // tenth.
        let step = if largest_mm < 5.0 { 0.1 } else { 0.5 };
        let largest_mm = ((largest_mm / step + 1e-9).floor() * step * 10.0).round() / 10.0;
        return Err(DoesNotFit { columns: board.columns(), rows: board.rows(), square_mm: square_mm(board), largest_mm });
    };
    let [width, height] = room(paper);
    let at = [MARGIN_MM + 0.5 * (width - across), MARGIN_MM + 0.5 * (height - down)];
    Ok(drawn(board, paper.size_mm, at, [MARGIN_MM, paper.size_mm[1] - MARGIN_MM - FOOT_MM + 4.0, width]))
}

/// Returns width and height of the board, millimetres.
fn sides_mm(board: &Board) -> [f64; 2] {
    [board.columns(), board.rows()].map(|corners| f64::from(corners + 1) * square_mm(board))
}

/// Returns the side of a square, millimetres, as it was typed.
fn square_mm(board: &Board) -> f64 {
    (board.square_m() * 1e9).round() / 1e6
}

/// Draws the board; the square beyond the origin (top left) is dark. `foot_left` and `foot_top` are
/// the ruler's top left end, `room` is the space along it.
fn drawn(board: &Board, size_mm: [f64; 2], [left, top]: [f64; 2], [foot_left, foot_top, room]: [f64; 3]) -> Page {
    let side = square_mm(board);
    let dark = |row: u32| (0..=board.columns()).filter(move |column| (row + column).is_multiple_of(2)).map(move |column| (row, column));
    let at =
        (0..=board.rows()).flat_map(dark).map(|(row, column)| [left + f64::from(column) * side, top + f64::from(row) * side]).collect();
    let mut items = vec![Item::Squares { at, side }];
    items.extend(ruler([foot_left, foot_top], room));
    let text = format!("stagepose board {board}, squares of {side} mm. Print at 100 %, check the ruler, glue it on something flat.");
    let size = fitting_size(&text, room, 3.0, LETTER_EM);
    items.push(Item::Text { at: [foot_left, foot_top + RULER_MM + 3.5], size, text, style: Style::Plain });
    Page { size_mm, items }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::targets::svg;

    #[test]
    fn the_sheet_has_every_dark_square_and_a_ruler_in_millimetres() {
        let board = Board::new(9, 6, 0.025).unwrap();
        let text = svg::write(&page(&board), "");
        assert_eq!(text.matches("h25.0000v25.0000").count(), 35); // half of 10 x 7
        assert!(text.contains("M12.0000 12.0000h25")); // the origin's outer square is dark
        assert!(text.contains("width=\"274mm\"") && text.contains("height=\"215mm\"") && text.contains(">200</text>"));
    }

    /// Returns the minimum and maximum x and y of what is printed, except for the width of text.
    fn extent(page: &Page) -> [f64; 4] {
        let mut points = Vec::new();
        for item in &page.items {
            match item {
                Item::Squares { at, side } => points.extend(at.iter().flat_map(|[x, y]| [[*x, *y], [x + side, y + side]])),
                Item::Lines(lines) => points.extend(lines.iter().flat_map(|[x, y, u, v]| [[*x, *y], [*u, *v]])),
                Item::Text { at, size, .. } => points.extend([*at, [at[0], at[1] - size]]),
                Item::Picture { at, size } => points.extend([*at, [at[0] + size[0], at[1] + size[1]]]),
            }
        }
        let fold = |k: usize, f: fn(f64, f64) -> f64| points.iter().map(|p: &[f64; 2]| p[k]).reduce(f).unwrap();
        [fold(0, f64::min), fold(1, f64::min), fold(0, f64::max), fold(1, f64::max)]
    }

    #[test]
    fn a_board_too_big_is_refused_with_the_largest_square() {
        for name in ["a4", "letter", "a3", "tabloid"] {
            let paper = Paper::parse(name).unwrap();
            for (columns, rows) in [(9, 6), (6, 9), (8, 5), (14, 3), (30, 21)] {
                let refusal = page_on(&Board::new(columns, rows, 0.2).unwrap(), paper).unwrap_err();
                // The largest square does fit, and half a millimetre more does not.
                let page = page_on(&Board::new(columns, rows, refusal.largest_mm * 1e-3).unwrap(), paper).unwrap();
                assert!(page_on(&Board::new(columns, rows, (refusal.largest_mm + 0.51) * 1e-3).unwrap(), paper).is_err());
                let [left, top, right, bottom] = extent(&page);
                let is_inside = left >= MARGIN_MM - ROUNDING_MM && top >= MARGIN_MM - ROUNDING_MM;
                assert!(
                    is_inside && right <= page.size_mm[0] - MARGIN_MM + ROUNDING_MM && bottom <= page.size_mm[1] - MARGIN_MM + ROUNDING_MM,
                    "{name}"
                );
                assert!(page.size_mm == paper.size_mm || page.size_mm == paper.turned().size_mm);
            }
        }
        let a4 = Paper::parse("a4").unwrap();
        let refusal = page_on(&Board::new(9, 6, 0.03).unwrap(), a4).unwrap_err();
        assert!(refusal.to_string().contains("9x6 with squares of 30 mm") && refusal.to_string().contains("--square-mm 24.5"), "{refusal}");
    }
}
