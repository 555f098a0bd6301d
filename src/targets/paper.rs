//! Paper: names and sizes.

use thiserror::Error;

/// White margin around everything, millimetres. Most printers reach to 5 mm of the edge; below 5 mm
/// the ruler may be cut off. Raised, boards and posters are smaller.
pub const MARGIN_MM: f64 = 10.0;
/// Names and sizes, millimetres, portrait: ISO 216, and ANSI's Letter, Legal and Tabloid.
const NAMED: [(&str, [f64; 2]); 9] = [
    ("a0", [841.0, 1189.0]),
    ("a1", [594.0, 841.0]),
    ("a2", [420.0, 594.0]),
    ("a3", [297.0, 420.0]),
    ("a4", [210.0, 297.0]),
    ("a5", [148.0, 210.0]),
    ("letter", [215.9, 279.4]),
    ("legal", [215.9, 355.6]),
    ("tabloid", [279.4, 431.8]),
];
/// Minimum and maximum side of a paper, millimetres: smaller leaves no room for a ruler, larger is
/// probably a mistyped unit. The error message states them.
const SIDES_MM: [f64; 2] = [100.0, 5000.0];
/// Maximum ratio of the longer to the shorter side: a longer strip constrains a camera poorly
/// across it. Chosen, not tuned. The error message states it.
const MAX_RATIO: f64 = 4.0;

/// A sheet of paper.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Paper {
    /// Width and height, millimetres.
    pub size_mm: [f64; 2],
}

/// Why a text does not name a paper.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum PaperError {
    /// Neither a known name nor a size.
    #[error("--paper is \"{0}\"; give a0 to a5, letter, legal, tabloid, or a size in millimetres such as \"500x700 mm\"")]
    Unknown(String),
    /// The size is out of range.
    #[error("--paper is {}x{} mm; both sides must be from 100 to 5000 mm, the longer at most four times the shorter", .0[0], .0[1])]
    Size([f64; 2]),
}

impl Paper {
    /// Parses "a3", "Letter" or "500x700 mm".
    ///
    /// # Errors
    /// When the text is neither a known name nor a size within the limits.
    pub fn parse(text: &str) -> Result<Self, PaperError> {
        let plain = text.trim().to_ascii_lowercase();
        if let Some((_, size_mm)) = NAMED.iter().find(|(name, _)| *name == plain) {
            return Ok(Self { size_mm: *size_mm });
        }
        let numbers = plain.strip_suffix("mm").unwrap_or(&plain).split_once('x');
        let side = |text: &str| text.trim().parse::<f64>().ok();
        let size_mm = numbers.and_then(|(a, b)| Some([side(a)?, side(b)?])).ok_or_else(|| PaperError::Unknown(text.to_owned()))?;
        let in_range = size_mm.iter().all(|side| (SIDES_MM[0]..=SIDES_MM[1]).contains(side));
        if !in_range || size_mm[0].max(size_mm[1]) > MAX_RATIO * size_mm[0].min(size_mm[1]) {
            return Err(PaperError::Size(size_mm));
        }
        Ok(Self { size_mm })
    }

    /// Returns the same sheet in the other orientation.
    pub fn turned(self) -> Self {
        Self { size_mm: [self.size_mm[1], self.size_mm[0]] }
    }

    /// Returns width and height within the margins, millimetres.
    pub fn printable_mm(self) -> [f64; 2] {
        self.size_mm.map(|side| side - 2.0 * MARGIN_MM)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paper_sizes_parse_or_are_refused() {
        let size = |text: &str| Paper::parse(text).map(|paper| paper.size_mm);
        assert_eq!(size("A3"), Ok([297.0, 420.0]));
        assert_eq!(size("letter"), Ok([215.9, 279.4]));
        assert_eq!(size("500x700 mm"), Ok([500.0, 700.0]));
        assert_eq!(size("700 x 500"), Ok([700.0, 500.0]));
        for text in ["", "a9", "500", "x", "500xmm"] {
            assert!(matches!(size(text), Err(PaperError::Unknown(_))), "{text}");
        }
        for text in ["50x700", "0.5x0.7", "NaNx300", "infx300", "100x500", "-300x300"] {
            assert!(matches!(size(text), Err(PaperError::Size(_))), "{text}");
        }
    }
}
