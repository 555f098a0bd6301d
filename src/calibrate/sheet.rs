//! The board to print: an SVG in millimetres, with a ruler that shows whether the printer kept the scale.

use std::fmt::Write;

use super::board::Board;

/// White around the board, millimetres; a finder needs some, and so does a printer.
const MARGIN_MM: f64 = 12.0;
/// Room for the ruler and the label below the board, millimetres.
const FOOT_MM: f64 = 16.0;

/// Width and height of the sheet, millimetres.
pub fn size_mm(board: &Board) -> [f64; 2] {
    let square = board.square_m() * 1e3;
    let side = |corners: u32| f64::from(corners + 1) * square + 2.0 * MARGIN_MM;
    [side(board.columns()), side(board.rows()) + FOOT_MM]
}

/// The board as an SVG text. The square beyond the origin (top left) is dark.
pub fn svg(board: &Board) -> String {
    let square = board.square_m() * 1e3;
    let [width, height] = size_mm(board);
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}mm\" height=\"{height}mm\" viewBox=\"0 0 {width} {height}\">\n\
         <rect width=\"{width}\" height=\"{height}\" fill=\"white\"/>\n<path fill=\"black\" d=\""
    );
    for row in 0..=board.rows() {
        for column in (0..=board.columns()).filter(|column| (row + column) % 2 == 0) {
            let (x, y) = (MARGIN_MM + f64::from(column) * square, MARGIN_MM + f64::from(row) * square);
            // Writing to a String cannot fail.
            let _ = write!(text, "M{x:.4} {y:.4}h{square:.4}v{square:.4}h-{square:.4}z");
        }
    }
    text += "\"/>\n";
    text += &ruler(width, height - FOOT_MM);
    let label = format!("stagepose board {board}, squares of {square} mm. Print at 100 %, check the ruler, glue it on something flat.");
    let font = (width / label.len() as f64 * 1.6).clamp(1.2, 3.0);
    let y = height - 2.5;
    let _ = write!(text, "<text x=\"{MARGIN_MM}\" y=\"{y}\" font-family=\"sans-serif\" font-size=\"{font:.2}\">{label}</text>\n</svg>\n");
    text
}

/// A ruler as long as fits, in steps of 10 mm, with a tick a millimetre.
fn ruler(width: f64, top: f64) -> String {
    let length = ((width - 2.0 * MARGIN_MM) / 10.0).floor().clamp(1.0, 20.0) as u32 * 10;
    let mut text =
        "<g stroke=\"black\" stroke-width=\"0.15\" font-family=\"sans-serif\" font-size=\"2.4\">\n<path fill=\"none\" d=\"".to_owned();
    let _ = write!(text, "M{MARGIN_MM} {top}h{length}");
    for mm in 0..=length {
        let tick = if mm % 10 == 0 {
            4.0
        } else if mm % 5 == 0 {
            2.8
        } else {
            1.8
        };
        let _ = write!(text, "M{} {top}v{tick}", MARGIN_MM + f64::from(mm));
    }
    text += "\"/>\n";
    for mm in (0..=length).step_by(10) {
        let _ = writeln!(
            text,
            "<text x=\"{}\" y=\"{}\" text-anchor=\"middle\" stroke=\"none\">{mm}</text>",
            MARGIN_MM + f64::from(mm),
            top + 7.0
        );
    }
    text + "</g>\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sheet_has_every_dark_square_and_a_ruler_in_millimetres() {
        let board = Board::new(9, 6, 0.025).unwrap();
        let text = svg(&board);
        assert_eq!(text.matches("h25.0000v25.0000").count(), 35); // half of 10 x 7
        assert!(text.contains("M12.0000 12.0000h25")); // the origin's outer square is dark
        assert!(text.contains("width=\"274mm\"") && text.contains(">200</text>"));
        assert_eq!(size_mm(&board), [274.0, 215.0]);
    }
}
