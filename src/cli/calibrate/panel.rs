//! The live mode's display while the board is moved: parts of the picture and tilts that are
//! missing, and what to do next.

use std::fmt::Write as _;
use std::io::{self, IsTerminal, Write};

use crate::calibrate::guide::{GOOD_VIEWS, PART_COLUMNS, PART_ROWS, TiltSide, ViewSet};
use crate::calibrate::pick::Look;

/// On a terminal a few lines that are redrawn with every frame, otherwise one line per picture
/// taken.
#[derive(Debug)]
pub(super) struct Panel {
    is_terminal: bool,
    drawn_lines: usize,
}

impl Panel {
    pub fn new() -> Self {
        Self { is_terminal: io::stderr().is_terminal(), drawn_lines: 0 }
    }

    /// Shows the current state.
    pub fn show(&mut self, taken: &ViewSet, look: &Look, most: usize) {
        if !self.is_terminal {
            if *look == Look::Taken {
                // A closed terminal is no reason to stop.
                let _ = writeln!(io::stderr(), "{}", line(taken));
            }
            return;
        }
        let text = lines(taken, look, most);
        // Move up to the first line and clear from there. Line wrapping is off, or a long line
        // would make the next move too short.
        let up = if self.drawn_lines > 0 { format!("\x1b[{}A\x1b[J", self.drawn_lines) } else { String::new() };
        // A closed terminal is no reason to stop.
        let _ = write!(io::stderr(), "\x1b[?7l{up}{text}\x1b[?7h");
        self.drawn_lines = text.lines().count();
    }
}

/// Returns the line for a picture taken.
fn line(taken: &ViewSet) -> String {
    let missing = taken.missing();
    let sides: Vec<&str> = missing.sides.iter().map(|side| side.name()).collect();
    let tilts = if sides.is_empty() { "none".to_owned() } else { sides.join(", ") };
    let next = taken.next_picture().map_or(String::new(), |next| format!("; {next}"));
    format!("picture {}: {} parts of the picture and these tilts are missing: {tilts}{next}", taken.len(), missing.parts.len())
}

/// Returns the lines for a terminal.
fn lines(taken: &ViewSet, look: &Look, most: usize) -> String {
    let missing = taken.missing();
    let mut text = String::new();
    for row in 0..PART_ROWS {
        let parts = (0..PART_COLUMNS).map(|column| if missing.parts.contains(&(column, row)) { " ." } else { " #" });
        let beside = match row {
            0 => format!("{} pictures taken; {GOOD_VIEWS} at least, {most} at most", taken.len()),
            1 => format!("tilted away: {}", tilts(&missing.sides)),
            _ => format!("now: {}", advice(look)),
        };
        // Writing to a String cannot fail.
        let _ = writeln!(text, "{}   {beside}", parts.collect::<String>());
    }
    let next = taken.next_picture().unwrap_or_else(|| "more views that differ from the earlier ones".to_owned());
    // Where to hold the board, and below that how: both fit a narrow terminal.
    let (place, tilt) = next.split_once(", with ").unwrap_or((&next, ""));
    let margin = "  ".repeat(PART_COLUMNS);
    let _ = writeln!(text, "{margin}   next: {place}");
    let _ = writeln!(text, "{margin}         {}{tilt}", if tilt.is_empty() { "" } else { "with " });
    text
}

fn tilts(missing: &[TiltSide]) -> String {
    let one = |side: &TiltSide| format!("{} {}", side.name(), if missing.contains(side) { "not yet" } else { "yes" });
    TiltSide::ALL.iter().map(one).collect::<Vec<_>>().join(", ")
}

fn advice(look: &Look) -> String {
    match look {
        Look::NoBoard(reason) => reason.to_string(),
        Look::Moving => "hold the board still".to_owned(),
        Look::Blurred => "the board is blurred; more light, or hold it stiller".to_owned(),
        Look::Known => "this view was already taken; move or tilt the board".to_owned(),
        Look::Taken => "taken".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Vector2, Vector3};

    use crate::calibrate::guide::ViewShape;

    #[test]
    fn the_panel_shows_which_views_are_missing() {
        let mut taken = ViewSet::default();
        let normal = Vector3::new(0.5, 0.0, 0.866);
        taken.add(ViewShape { corners: vec![Vector2::new(0.1, 0.1), Vector2::new(0.9, 0.4)], normal });
        let text = lines(&taken, &Look::Moving, 25);
        let rows: Vec<&str> = text.lines().collect();
        assert_eq!(rows.len(), 5);
        assert!(rows[0].starts_with(" # . . .   1 pictures taken; 12 at least, 25 at most"), "{text}");
        assert!(rows[1].starts_with(" . . . #   tilted away: left yes, right not yet"), "{text}");
        assert!(rows[2].starts_with(" . . . .   now: hold the board still"), "{text}");
        assert!(rows[3].contains("next: hold the board in the ") && rows[4].contains("with its right side about 35 degrees"), "{text}");
        assert!(rows.iter().all(|row| row.len() < 80), "{text}");
        assert!(
            line(&taken).starts_with("picture 1: 10 parts of the picture and these tilts are missing: right, upper, lower; hold"),
            "{}",
            line(&taken)
        );
    }
}
