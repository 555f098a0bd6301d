//! Fits corners at a lattice's places: refits existing ones, and finds missing ones beside them.

use nalgebra::Vector2;

use super::fit::{CornerFit, fit_corner};
use super::grid::{Grid, Place};
use super::lattice::{Cell, Extent, Lattice};
use super::level::Level;
use super::neighbours::Margin;
use super::surroundings::Surroundings;
use super::window::Window;
use crate::geometry::robust_kernel::median;

/// Maximum blur, level pixels, for which a fit's first window is made; the fit widens it if
/// necessary. Raised, windows in blurred pictures are larger from the start; lowered, more of them
/// are drawn twice.
const WIDEST_START: f64 = 2.0;
/// Number of corners above which a lattice stops growing: the largest board has 100 x 100. Raised,
/// patterns that are no board take longer.
const MAX_CORNERS: usize = 10_000;

impl From<CornerFit> for Cell {
    fn from(fit: CornerFit) -> Self {
        Self { position: fit.position, middle: fit.middle, contrast: fit.contrast.abs(), residual: fit.residual }
    }
}

impl Lattice {
    /// Fits every corner on `level`, drops those that fail, and searches for missing ones: inside,
    /// and outwards while corners appear.
    pub fn complete(&mut self, level: &Level) {
        self.refit(level, None);
        self.grow(level, None);
    }

    /// Searches for missing corners next to existing ones while any appear, only `within` an extent
    /// if one is given.
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
                // A place is tried again only if it has more neighbours than last time.
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
            if self.cells.len() == before || self.cells.len() > MAX_CORNERS {
                return;
            }
        }
    }

    fn neighbours(&self, i: i32, j: i32) -> usize {
        self.cells.around((i, j), 1).count()
    }

    /// Fits every corner on `level`, given positions within about a pixel, and drops those that
    /// fail. `margin` states that the lattice is the whole board, and what surrounds it.
    pub fn refit(&mut self, level: &Level, margin: Option<&Margin>) {
        let (mut window, mut guess) = (Window::default(), self.blur);
        let mut blurs = Vec::with_capacity(self.cells.len());
        let fits = self.cells.filter_map(|(i, j), cell| {
            let around = self.surroundings((i, j), cell.position, margin);
            let fit = self.fit_at(level, (i, j), cell.position, guess, &around, &mut window)?;
            // The next corner's blur is most likely similar.
            guess = fit.blur;
            blurs.push(fit.blur);
            Some(fit.into())
        });
        self.cells = fits;
        if let Some(blur) = median(&mut blurs) {
            self.blur = blur;
        }
    }

    /// Fits a corner with this lattice's steps and colours, from a `guess` of the blur.
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
        // A narrow start keeps the window small; the fit widens it if necessary.
        let fit = fit_corner(level, start, steps, [self.blur, guess].map(|blur| blur.min(WIDEST_START)), around, window)?;
        let dark_first = (i + j).rem_euclid(2) == 0;
        ((fit.contrast < 0.0) == dark_first).then_some(fit)
    }
}
