//! A printable page: black squares, lines, text and one picture, placed in millimetres.
//!
//! x points right and y down from the paper's top left corner. The content is the same in every
//! file format.

/// A page.
#[derive(Debug, Clone)]
pub struct Page {
    /// Width and height of the paper, millimetres.
    pub size_mm: [f64; 2],
    /// The items on it.
    pub items: Vec<Item>,
}

/// One item on a page; lengths in millimetres.
#[derive(Debug, Clone)]
pub enum Item {
    /// Black squares of one size.
    Squares {
        /// Top left corners.
        at: Vec<[f64; 2]>,
        /// Side of each square.
        side: f64,
    },
    /// Thin black lines from (x, y) to (x, y).
    Lines(Vec<[f64; 4]>),
    /// A line of text.
    Text {
        /// The start of its base line, or the middle if centred.
        at: [f64; 2],
        /// Type size.
        size: f64,
        /// The text, ASCII.
        text: String,
        /// Typeface and alignment.
        style: Style,
    },
    /// The picture.
    Picture {
        /// Top left corner.
        at: [f64; 2],
        /// Width and height between its outer edges.
        size: [f64; 2],
    },
}

/// Typeface and alignment of a text.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Style {
    /// Sans serif, left-aligned.
    Plain,
    /// Sans serif, centred; digits only.
    Centred,
    /// Monospaced, left-aligned.
    Typewriter,
}

/// Thickness of a line, millimetres: as thin as every printer can print. Raised, the ruler's
/// millimetre ticks are read less exactly.
pub const LINE_MM: f64 = 0.15;
/// Height of a ruler with its numbers, millimetres: what [`ruler`] draws, and 1 mm of white.
pub const RULER_MM: f64 = 8.0;
/// Maximum length of a ruler, millimetres: that of a desk ruler, to compare with. Lowered, an error
/// of the printer's scale is read less exactly.
const MAX_RULER_MM: f64 = 200.0;

/// Draws a ruler in whole centimetres, at most `room` long, with a tick per millimetre.
pub fn ruler([left, top]: [f64; 2], room: f64) -> Vec<Item> {
    let length = ((room.min(MAX_RULER_MM) / 10.0).floor().max(1.0) * 10.0) as u32;
    let x = |mm: u32| left + f64::from(mm);
    let tick = |mm: u32| {
        if mm.is_multiple_of(10) {
            4.0
        } else if mm.is_multiple_of(5) {
            2.8
        } else {
            1.8
        }
    };
    let mut lines = vec![[left, top, x(length), top]];
    lines.extend((0..=length).map(|mm| [x(mm), top, x(mm), top + tick(mm)]));
    let number = |mm: u32| Item::Text { at: [x(mm), top + 7.0], size: 2.4, text: mm.to_string(), style: Style::Centred };
    std::iter::once(Item::Lines(lines)).chain((0..=length).step_by(10).map(number)).collect()
}

/// Returns the type size, at most `largest`, at which a text is no wider than `room`.
pub fn fitting_size(text: &str, room: f64, largest: f64, em_a_letter: f64) -> f64 {
    (room / (text.len().max(1) as f64 * em_a_letter)).min(largest)
}
