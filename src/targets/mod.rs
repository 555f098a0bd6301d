//! Printable targets: the poster that a camera tracks, and the chessboard that calibrates it.
//!
//! [`poster`] paints the picture. [`poster_sheet`] and [`board_sheet`] lay out a [`page::Page`] in
//! millimetres on a [`paper::Paper`], with a ruler to check the printer's scale. [`svg`] and
//! [`pdf`] write it.

pub mod board_sheet;
pub mod page;
pub mod paper;
pub mod pdf;
pub mod poster;
pub mod poster_sheet;
pub mod svg;
