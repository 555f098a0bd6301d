//! The chessboard: number of inner corners, size of its squares, and positions of its corners.
//!
//! The board's frame lies in its face: the origin is an inner corner, x runs along the columns, y
//! along the rows, and z points INTO the board. So a board that faces the camera upright has x to
//! the right and y down in the picture, like the camera frame. This is the frame of Bouguet's
//! `omc`, `Tc`, rotated so that it can be determined from the pattern alone; see [`Symmetry`].

use nalgebra::Vector2;
use thiserror::Error;

/// A chessboard, described by its INNER corners: a board of 10 x 7 squares has 9 x 6 of them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Board {
    columns: u32,
    rows: u32,
    square_m: f64,
}

/// Why numbers do not describe a board.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum BoardError {
    /// The text is not two numbers separated by an x.
    #[error("--board is \"{0}\"; give the number of INNER corners along both sides, such as 9x6")]
    Form(String),
    /// A number of corners is out of range.
    #[error("--board is {columns}x{rows}; both numbers count inner corners and must be from 3 to 100")]
    Size {
        /// Along x.
        columns: u32,
        /// Along y.
        rows: u32,
    },
    /// The size of the squares, millimetres, is out of range.
    #[error("--square-mm is {0}; give the side of one square in millimetres, above 0 and below 10000")]
    Square(f64),
    /// The squares are so small that metres were probably meant.
    #[error("--square-mm is {mm}, which looks like metres; it is in millimetres: for squares of {mm} m give {}", (.0 * 1e6).round() / 1e3, mm = .0)]
    Metres(f64),
}

/// Side of a square, millimetres, below which metres are assumed to be meant: no camera resolves
/// such a board. Raised, real boards for macro lenses are refused; lowered, squares of a fifth of a
/// metre, given in metres, pass for millimetres.
const MIN_SQUARE_MM: f64 = 0.5;

/// How far a board's pattern determines its pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Symmetry {
    /// One number of corners is odd and the other even: the origin is unique.
    None,
    /// The pattern looks the same when rotated by 180 degrees: the origin is chosen so that the x
    /// axis points right or down.
    Half,
    /// The pattern looks the same every 90 degrees (both numbers even and equal).
    Quarter,
}

impl Board {
    /// Creates a board of `columns` x `rows` inner corners with squares of `square_m` metres.
    ///
    /// # Errors
    /// When a number is out of range.
    pub fn new(columns: u32, rows: u32, square_m: f64) -> Result<Self, BoardError> {
        let in_range = |n: u32| (3..=100).contains(&n);
        if !in_range(columns) || !in_range(rows) {
            return Err(BoardError::Size { columns, rows });
        }
        if !(square_m > 0.0 && square_m < 10.0) {
            return Err(BoardError::Square(square_m * 1e3));
        }
        Ok(Self { columns, rows, square_m })
    }

    /// Parses "9x6" with squares of `square_mm` millimetres.
    ///
    /// # Errors
    /// As [`new`](Self::new), and when the text has another form.
    pub fn parse(text: &str, square_mm: f64) -> Result<Self, BoardError> {
        let numbers = text.trim().split_once(['x', 'X', '*', ',']);
        let parsed = numbers.and_then(|(a, b)| Some((a.trim().parse().ok()?, b.trim().parse().ok()?)));
        let (columns, rows) = parsed.ok_or_else(|| BoardError::Form(text.to_owned()))?;
        if !(square_mm > 0.0 && square_mm < 1e4) {
            return Err(BoardError::Square(square_mm));
        }
        if square_mm < MIN_SQUARE_MM {
            return Err(BoardError::Metres(square_mm));
        }
        Self::new(columns, rows, square_mm * 1e-3)
    }

    /// Returns the number of inner corners along x.
    pub fn columns(&self) -> u32 {
        self.columns
    }

    /// Returns the number of inner corners along y.
    pub fn rows(&self) -> u32 {
        self.rows
    }

    /// Returns the side of a square, metres.
    pub fn square_m(&self) -> f64 {
        self.square_m
    }

    /// Returns the number of inner corners.
    pub fn corner_count(&self) -> usize {
        self.columns as usize * self.rows as usize
    }

    /// Returns the position of corner `index` (row by row) in the board frame, metres.
    pub fn corner(&self, index: usize) -> Vector2<f64> {
        let columns = self.columns as usize;
        Vector2::new((index % columns) as f64, (index / columns) as f64) * self.square_m
    }

    /// Returns how far the pattern determines its own origin.
    pub fn symmetry(&self) -> Symmetry {
        if (self.columns + self.rows) % 2 == 1 {
            Symmetry::None
        } else if self.columns == self.rows && self.columns.is_multiple_of(2) {
            Symmetry::Quarter
        } else {
            Symmetry::Half
        }
    }
}

impl std::fmt::Display for Board {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}x{}", self.columns, self.rows)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boards_are_read_and_refused() {
        let board = Board::parse("9x6", 25.0).unwrap();
        assert_eq!((board.columns(), board.rows(), board.square_m()), (9, 6, 0.025));
        assert_eq!(board.corner(10), Vector2::new(0.025, 0.025));
        assert_eq!(board.to_string(), "9x6");
        for text in ["", "9", "9x", "ax6", "-3x6"] {
            assert!(matches!(Board::parse(text, 25.0), Err(BoardError::Form(_))), "{text}");
        }
        for text in ["2x6", "9x0", "9x101"] {
            assert!(matches!(Board::parse(text, 25.0), Err(BoardError::Size { .. })), "{text}");
        }
        for mm in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(Board::parse("9x6", mm), Err(BoardError::Square(_))), "{mm}");
        }
    }

    #[test]
    fn symmetry_follows_from_the_square_colours() {
        let of = |c, r| Board::new(c, r, 0.02).unwrap().symmetry();
        assert_eq!(of(9, 6), Symmetry::None);
        assert_eq!(of(24, 17), Symmetry::None);
        assert_eq!(of(6, 4), Symmetry::Half);
        assert_eq!(of(7, 7), Symmetry::Half);
        assert_eq!(of(10, 10), Symmetry::Quarter);
    }
}
