//! Determines which corner of a lattice is the board's origin.
//!
//! A lattice may be rotated by quarter turns until its numbers of corners match the board's. Among
//! the matching rotations, those with a dark square beyond the origin are preferred if there are
//! any; for a pattern without symmetry that leaves one. If two are left, half a turn apart, the x
//! axis that points right and down wins: boards are held upright or sideways, seldom at 45 degrees,
//! where this choice flips. If four are left, the x axis that points right wins.

use nalgebra::Vector2;

use super::FoundBoard;
use super::lattice::{Extent, Lattice};
use crate::calibrate::board::{Board, Symmetry};
use crate::geometry::robust_kernel::median;

/// Whether the lattice spans exactly the board in either orientation.
pub(super) fn fits(lattice: &Lattice, board: &Board) -> bool {
    lattice.extent().is_some_and(|extent| extent.sorted_size() == sorted_size(board))
}

/// Returns the board's corners along its sides, the larger number first.
pub(super) fn sorted_size(board: &Board) -> (u32, u32) {
    (board.columns().max(board.rows()), board.columns().min(board.rows()))
}

/// Puts the corners in the board's order; the lattice spans `extent`, hidden corners included.
/// Returns `None` if that is not the board.
pub(super) fn placed(lattice: &Lattice, extent: Extent, board: &Board, margin: f64) -> Option<FoundBoard> {
    let orientations: Vec<BoardOrientation> = (0..4).filter_map(|quarter| BoardOrientation::new(lattice, extent, board, quarter)).collect();
    let dark = orientations.iter().any(|orientation| orientation.dark_origin);
    let preferred = if board.symmetry() == Symmetry::Quarter { Vector2::x() } else { Vector2::new(1.0, 1.0) };
    let left = orientations.into_iter().filter(|orientation| orientation.dark_origin == dark);
    let chosen = left.max_by(|a, b| a.x_axis.dot(&preferred).total_cmp(&b.x_axis.dot(&preferred)))?;
    let mut contrasts: Vec<f64> = lattice.cells().map(|(_, cell)| cell.contrast).collect();
    let contrast = median(&mut contrasts)?;
    let light =
        chosen.places.iter().map(|&at| lattice.get(at).and_then(|cell| lattice.light(at, cell.position)).unwrap_or_default()).collect();
    Some(FoundBoard {
        corners: chosen.corners,
        blur_px: lattice.blur,
        contrast,
        light,
        margin,
        dark_origin: chosen.dark_origin,
        square_px: lattice.square(),
    })
}

/// A lattice rotated by quarter turns so that it matches the board.
struct BoardOrientation {
    corners: Vec<Option<Vector2<f64>>>,
    /// The corners' coordinates in the lattice.
    places: Vec<(i32, i32)>,
    /// Whether the square beyond the origin is dark.
    dark_origin: bool,
    /// Direction of the board's x axis in the picture, a unit vector.
    x_axis: Vector2<f64>,
}

impl BoardOrientation {
    fn new(lattice: &Lattice, extent: Extent, board: &Board, quarter: usize) -> Option<Self> {
        let (w, h) = extent.size();
        let (low, high) = (extent.low, extent.high);
        // The origin, and the lattice directions of x and y; y follows x clockwise, as j follows i.
        let (origin, x, y) = match quarter {
            0 => ((low.0, low.1), (1, 0), (0, 1)),
            1 => ((high.0, low.1), (0, 1), (-1, 0)),
            2 => ((high.0, high.1), (-1, 0), (0, -1)),
            _ => ((low.0, high.1), (0, -1), (1, 0)),
        };
        let size = if quarter.is_multiple_of(2) { (w, h) } else { (h, w) };
        if size != (board.columns(), board.rows()) {
            return None;
        }
        let at = |c: i32, r: i32| (origin.0 + c * x.0 + r * y.0, origin.1 + c * x.1 + r * y.1);
        let (columns, rows) = (board.columns() as i32, board.rows() as i32);
        let all = (0..rows).flat_map(|r| (0..columns).map(move |c| (c, r)));
        let places: Vec<_> = all.map(|(c, r)| at(c, r)).collect();
        let corners: Vec<_> = places.iter().map(|&at| lattice.get(at).map(|cell| cell.position)).collect();
        // The quadrant between x and y has the colour of (i, j)'s own after a half turn, otherwise
        // the opposite one.
        let dark_origin = ((origin.0 + origin.1).rem_euclid(2) == 0) == quarter.is_multiple_of(2);
        Some(Self { dark_origin, x_axis: x_axis(&corners, board.columns() as usize), corners, places })
    }
}

/// Returns the direction of the rows of corners: the normalised mean step along x.
fn x_axis(corners: &[Option<Vector2<f64>>], columns: usize) -> Vector2<f64> {
    let rows = corners.chunks(columns).flat_map(|row| row.windows(2));
    let sum: Vector2<f64> = rows.filter_map(|pair| Some(pair[1]? - pair[0]?)).sum();
    sum / sum.norm().max(1e-9)
}
