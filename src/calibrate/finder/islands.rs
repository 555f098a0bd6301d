//! Finds corners that only seem to belong to the lattice: pieces that are connected in themselves
//! but not with the rest.
//!
//! A piece that was linked at the wrong place predicts its own corners well, so checking each
//! corner against its neighbours does not reveal it. But the steps that lead to it differ from
//! those around them. The largest piece is the board. Another piece, beyond a reflection or a
//! finger, is kept if it lies where the board predicts it.

use nalgebra::{Matrix3, Matrix3x2, Vector2, Vector3};

use super::grid::{Grid, Place};
use super::lattice::Lattice;
use crate::geometry::robust_kernel::median;

/// Maximum relative difference between a step and the median of those around it for the step to
/// link two corners: perspective changes steps by less from one square to the next, a slip by one
/// square by far more. Raised, wrong pieces stay; lowered, steep boards fall apart.
const UNLIKE: f64 = 0.4;
/// Relative difference along both axes below which steps count as alike, so that their median need
/// not be computed. It changes no result while it is at most half of [`UNLIKE`]; lowered, it saves
/// less time.
const ALIKE: f64 = 0.2;
/// Maximum distance, in squares, between a piece's corners and the board's prediction for the piece
/// to be kept; beyond half a square the next place is nearer. Raised, pieces with wrong coordinates
/// stay; lowered, pieces of bent boards beyond a finger are lost.
const NEAR: f64 = 0.35;
/// Number of a piece's corners that are checked, the nearest to the board. Raised, farther ones
/// decide too, which the board predicts worse; lowered, one bad corner counts for more.
const CHECKED_CORNERS: usize = 6;
/// Number of board corners that predict one beyond it: the nearest, five times as many as the three
/// unknowns per axis. Raised, the fitted plane extends farther and perspective bends it; lowered,
/// their noise counts for more.
const PREDICTING_CORNERS: usize = 16;

impl Lattice {
    /// Drops corners that are not connected with the rest.
    pub(super) fn drop_islands(&mut self) {
        let mut pieces = self.pieces();
        pieces.sort_by_key(|piece| std::cmp::Reverse(piece.len()));
        let Some((board, others)) = pieces.split_first() else { return };
        let unconnected = others.iter().filter(|piece| !self.belongs(piece, board)).flatten();
        let unconnected: Grid<()> = unconnected.map(|at| (*at, ())).collect();
        self.retain(|at| !unconnected.contains(at));
    }

    /// Whether the piece's corners nearest to the board lie where the board predicts them; it
    /// cannot predict farther ones.
    fn belongs(&self, piece: &[Place], board: &[Place]) -> bool {
        let off = |a: &Place, b: &Place| (a.0 - b.0).pow(2) + (a.1 - b.1).pow(2);
        let mut nearest: Vec<(i32, Place)> = piece.iter().filter_map(|at| Some((board.iter().map(|b| off(at, b)).min()?, *at))).collect();
        nearest.sort_unstable();
        nearest.iter().take(CHECKED_CORNERS).all(|&(_, at)| self.is_predicted(at, board))
    }

    /// Returns the number of corners in the largest piece.
    pub(super) fn largest_piece(&self) -> usize {
        self.pieces().iter().map(Vec::len).max().unwrap_or(0)
    }

    /// Returns the pieces that are connected by steps like those around them.
    fn pieces(&self) -> Vec<Vec<Place>> {
        let typical = [(1, 0), (0, 1)].map(|along| self.typical_steps(along));
        let linked = |from: Place, to: Place| {
            let (low, axis) = (from.min(to), usize::from(from.0 == to.0));
            let step = self.at(from.0.max(to.0), from.1.max(to.1)).zip(self.at(low.0, low.1)).map(|(b, a)| b - a);
            step.zip(typical[axis].get(low)).is_some_and(|(step, typical)| (step - typical).norm() < UNLIKE * typical.norm())
        };
        let mut left: Grid<()> = self.cells().map(|(at, _)| (at, ())).collect();
        let mut pieces = Vec::new();
        for (first, _) in self.cells() {
            if left.remove(first).is_none() {
                continue;
            }
            let (mut piece, mut done) = (vec![first], 0);
            while let Some(&at) = piece.get(done) {
                done += 1;
                for next in [(at.0 + 1, at.1), (at.0 - 1, at.1), (at.0, at.1 + 1), (at.0, at.1 - 1)] {
                    if left.contains(next) && linked(at, next) {
                        left.remove(next);
                        piece.push(next);
                    }
                }
            }
            pieces.push(piece);
        }
        pieces
    }

    /// Returns for each step along one axis, by its first corner, the median of the steps around
    /// it.
    fn typical_steps(&self, along: Place) -> Grid<Vector2<f64>> {
        let steps = self.differences(along);
        let (mut xs, mut ys) = (Vec::new(), Vec::new());
        steps.filter_map(|at, here| {
            let mut farthest = 0.0_f64;
            steps.around(at, 2).for_each(|step| {
                let off = (step - here).abs();
                let larger = if off.x > off.y { off.x } else { off.y };
                farthest = if larger > farthest { larger } else { farthest };
            });
            // If all steps are alike, the median is no farther off than they are.
            if farthest < ALIKE * here.norm() {
                return Some(*here);
            }
            xs.clear();
            ys.clear();
            steps.around(at, 2).for_each(|step| (xs.push(step.x), ys.push(step.y)).1);
            Some(Vector2::new(median(&mut xs)?, median(&mut ys)?))
        })
    }

    /// Whether a corner lies where an affine fit to the nearest corners of the board predicts it.
    fn is_predicted(&self, at: Place, board: &[Place]) -> bool {
        let mut nearest: Vec<(i32, Place)> = board.iter().map(|b| ((b.0 - at.0).pow(2) + (b.1 - at.1).pow(2), *b)).collect();
        nearest.sort_unstable();
        let (mut normal, mut right) = (Matrix3::zeros(), Matrix3x2::zeros());
        for (_, b) in nearest.iter().take(PREDICTING_CORNERS) {
            let Some(position) = self.at(b.0, b.1) else { continue };
            let row = Vector3::new(f64::from(b.0 - at.0), f64::from(b.1 - at.1), 1.0);
            normal += row * row.transpose();
            right += row * position.transpose();
        }
        let Some(plane) = normal.try_inverse().map(|inverse| inverse * right) else { return false };
        let (u, v, here) = (plane.row(0), plane.row(1), plane.row(2).transpose());
        self.at(at.0, at.1).is_some_and(|seen| (seen - here).norm() < NEAR * u.norm().min(v.norm()))
    }
}

#[cfg(test)]
mod tests {
    use super::super::lattice::Cell;
    use super::*;

    fn lattice(corners: impl Iterator<Item = (Place, Vector2<f64>)>) -> Lattice {
        let cell = |position| Cell { position, middle: 100.0, contrast: 50.0, residual: 0.0 };
        Lattice::new(corners.map(|(at, position)| (at, cell(position))).collect())
    }

    fn place((i, j): Place) -> Vector2<f64> {
        let (x, y) = (f64::from(i), f64::from(j));
        Vector2::new(100.0 + 12.0 * x + 2.0 * y, 50.0 - x + 10.0 * y) / (1.0 + 0.01 * x)
    }

    fn all() -> impl Iterator<Item = Place> {
        (0..12).flat_map(|i| (0..9).map(move |j| (i, j)))
    }

    #[test]
    fn a_misplaced_island_is_dropped() {
        let is_displaced = |at: Place| (5..8).contains(&at.0) && (4..6).contains(&at.1);
        let shifted = |at: Place| place(if is_displaced(at) { (at.0 + 2, at.1 - 3) } else { at });
        let mut folded = lattice(all().map(|at| (at, shifted(at))));
        folded.drop_islands();
        assert!(folded.cells().all(|(at, _)| !is_displaced(at)));
        assert_eq!(folded.len(), 12 * 9 - 6);
    }

    #[test]
    fn an_island_beyond_a_reflection_is_kept() {
        let mut split = lattice(all().filter(|at| !(6..8).contains(&at.0)).map(|at| (at, place(at))));
        let before = split.len();
        split.drop_islands();
        assert_eq!(split.len(), before);
    }
}
