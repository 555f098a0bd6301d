//! Corners fitted at a lattice's places: those that it has, again, and those that are missing beside them.

use nalgebra::Vector2;

use super::fit::{CornerFit, fit_corner};
use super::grid::{Grid, Place};
use super::lattice::{Cell, Extent, Lattice};
use super::level::Level;
use super::neighbours::Margin;
use super::surroundings::Surroundings;
use super::window::Window;
use crate::geometry::robust_kernel::median;

/// Blur, level pixels, that a fit's first window is made for at most; the fit widens it where the picture asks for it.
/// Raised, windows in blurred pictures are larger from the start; lowered, more of them are drawn twice.
const WIDEST_START: f64 = 2.0;
/// A lattice that has more corners than the largest board, 100 x 100, stops growing.
/// Raised, it only takes longer over patterns that are no board.
const MOST_CORNERS: usize = 10_000;

impl From<CornerFit> for Cell {
    fn from(fit: CornerFit) -> Self {
        Self { position: fit.position, middle: fit.middle, contrast: fit.contrast.abs(), residual: fit.residual }
    }
}

impl Lattice {
    /// Fits every corner on `level`, drops those that are none, and looks for the missing ones: inside, and outwards while
    /// corners appear.
    pub fn complete(&mut self, level: &Level) {
        self.refit(level, None);
        self.grow(level, None);
    }

    /// Looks for the corners that are missing beside those there are, while some appear; all of them `within` an extent, if
    /// there is one.
    pub fn grow(&mut self, level: &Level, within: Option<Extent>) {
        let (mut window, mut guess) = (Window::default(), self.blur);
        let mut tried: Grid<usize> = Grid::default();
        loop {
            let around = self.cells.iter().flat_map(|((i, j), _)| [(i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)]);
            let mut missing: Vec<Place> = around.filter(|at| !self.cells.contains(*at) && within.is_none_or(|w| w.contains(*at))).collect();
            missing.sort_unstable();
            missing.dedup();
            let before = self.cells.len();
            for (i, j) in missing {
                // A place is tried again only when it has more neighbours than the last time.
                let neighbours = self.neighbours(i, j);
                if tried.insert((i, j), neighbours).is_some_and(|before| before >= neighbours) {
                    continue;
                }
                let found = self.predicted(i, j).and_then(|start| {
                    let around = self.surroundings((i, j), start, None);
                    self.fit_at(level, (i, j), start, guess, &around, &mut window)
                });
                if let Some(fit) = found {
                    guess = fit.blur;
                    self.cells.insert((i, j), fit.into());
                }
            }
            if self.cells.len() == before || self.cells.len() > MOST_CORNERS {
                return;
            }
        }
    }

    fn neighbours(&self, i: i32, j: i32) -> usize {
        self.cells.around((i, j), 1).count()
    }

    /// Fits every corner on `level` where its position is known to about a pixel, and drops those that are none. With `margin`
    /// the lattice is the whole board, and what lies around it is known.
    pub fn refit(&mut self, level: &Level, margin: Option<&Margin>) {
        let (mut window, mut guess) = (Window::default(), self.blur);
        let mut blurs = Vec::with_capacity(self.cells.len());
        let fits = self.cells.filter_map(|(i, j), cell| {
            let around = self.surroundings((i, j), cell.position, margin);
            let fit = self.fit_at(level, (i, j), cell.position, guess, &around, &mut window)?;
            // The next one is most likely as blurred as this one.
            guess = fit.blur;
            blurs.push(fit.blur);
            Some(fit.into())
        });
        self.cells = fits;
        if let Some(blur) = median(&mut blurs) {
            self.blur = blur;
        }
    }

    /// A corner fit with the steps and colours of this lattice, from a `guess` of the blur.
    fn fit_at(
        &self,
        level: &Level,
        (i, j): Place,
        start: Vector2<f64>,
        guess: f64,
        around: &Surroundings,
        window: &mut Window,
    ) -> Option<CornerFit> {
        let steps = self.steps(i, j)?;
        // A narrow start keeps the window small; it widens where the fit asks for it.
        let fit = fit_corner(level, start, steps, [self.blur, guess].map(|blur| blur.min(WIDEST_START)), around, window)?;
        let dark_first = (i + j).rem_euclid(2) == 0;
        ((fit.contrast < 0.0) == dark_first).then_some(fit)
    }
}
