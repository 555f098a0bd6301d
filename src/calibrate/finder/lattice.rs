//! A lattice of corners: whole-number coordinates, positions in the picture, and what they foretell of their neighbours.
//!
//! Coordinates (i, j) turn clockwise in the picture from +i to +j, and the square between +i and +j of corner (0, 0)
//! is dark, so the one of (i, j) is dark where i + j is even.

use nalgebra::Vector2;

use super::fit::{CornerFit, Surroundings, fit_corner};
use super::grid::{Grid, Place};
use super::level::Level;
use super::surroundings::Margin;
use super::window::Window;

/// One corner of a lattice.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cell {
    /// Level pixels.
    pub position: Vector2<f64>,
    /// The level half way between dark and light.
    pub middle: f64,
    /// Half the difference between light and dark, grey levels.
    pub contrast: f64,
    /// What the fit left unexplained, grey levels; 0 before there was one.
    pub residual: f64,
}

impl From<CornerFit> for Cell {
    fn from(fit: CornerFit) -> Self {
        Self { position: fit.position, middle: fit.middle, contrast: fit.contrast.abs(), residual: fit.residual }
    }
}

/// Corners by their coordinates.
#[derive(Debug, Clone, Default)]
pub(crate) struct Lattice {
    cells: Grid<Cell>,
    /// Standard deviation of the blur, level pixels: the median of the fits.
    pub blur: f64,
}

/// Lowest and highest coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Extent {
    pub low: (i32, i32),
    pub high: (i32, i32),
}

impl Extent {
    /// Corners along i and j.
    pub fn size(&self) -> (u32, u32) {
        ((self.high.0 - self.low.0 + 1) as u32, (self.high.1 - self.low.1 + 1) as u32)
    }

    pub fn contains(&self, (i, j): Place) -> bool {
        (self.low.0..=self.high.0).contains(&i) && (self.low.1..=self.high.1).contains(&j)
    }

    /// The larger number first.
    pub fn sorted_size(&self) -> (u32, u32) {
        let (a, b) = self.size();
        (a.max(b), a.min(b))
    }
}

/// A corner this share of a square away from where its neighbours foretell it is none.
const STRAY: f64 = 0.25;
/// Corners up to so many squares away foretell one.
const FORETELLS: i32 = 3;
/// More than this times the noise and this share of the contrast left unexplained is no clean corner.
const DISTURBED_NOISE: f64 = 2.0;
const DISTURBED_SHARE: f64 = 0.08;
/// Blur that a fit starts from at most, level pixels.
const WIDEST_START: f64 = 2.0;
/// Larger boards are not looked for.
const MOST_CORNERS: usize = 10_000;

impl Lattice {
    pub fn new(cells: Grid<Cell>) -> Self {
        Self { cells, blur: 0.7 }
    }

    pub fn len(&self) -> usize {
        self.cells.len()
    }

    pub fn get(&self, at: Place) -> Option<&Cell> {
        self.cells.get(at)
    }

    /// The corners at most `reach` places away.
    pub fn around(&self, at: Place, reach: i32) -> impl Iterator<Item = &Cell> {
        self.cells.around(at, reach)
    }

    pub fn cells(&self) -> impl Iterator<Item = (Place, &Cell)> {
        self.cells.iter()
    }

    /// `None` where there is not one corner.
    pub fn extent(&self) -> Option<Extent> {
        let (first, _) = self.cells.iter().next()?;
        Some(self.cells.iter().fold(Extent { low: first, high: first }, |e, ((i, j), _)| Extent {
            low: (e.low.0.min(i), e.low.1.min(j)),
            high: (e.high.0.max(i), e.high.1.max(j)),
        }))
    }

    pub fn at(&self, i: i32, j: i32) -> Option<Vector2<f64>> {
        self.cells.get((i, j)).map(|cell| cell.position)
    }

    /// The steps from each corner to the next along one axis.
    pub fn differences(&self, along: Place) -> Grid<Vector2<f64>> {
        self.cells.filter_map(|(i, j), cell| Some(self.at(i + along.0, j + along.1)? - cell.position))
    }

    /// One square's step along +i and +j at a corner, from its neighbours or theirs.
    pub fn steps(&self, i: i32, j: i32) -> Option<[Vector2<f64>; 2]> {
        let step = |i: i32, j: i32, di: i32, dj: i32| {
            let (before, here, after) = (self.at(i - di, j - dj), self.at(i, j), self.at(i + di, j + dj));
            match (before, here, after) {
                (Some(b), _, Some(a)) => Some((a - b) * 0.5),
                (_, Some(h), Some(a)) => Some(a - h),
                (Some(b), Some(h), _) => Some(h - b),
                _ => None,
            }
        };
        let around = [(0, 0), (0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, -1), (1, -1), (-1, 1)];
        let find = |di: i32, dj: i32| around.iter().find_map(|(a, b)| step(i + a, j + b, di, dj));
        Some([find(1, 0)?, find(0, 1)?])
    }

    /// Where a corner should be, judging by those around it.
    pub fn foretold(&self, i: i32, j: i32) -> Option<Vector2<f64>> {
        let (mut sum, mut weight) = (Vector2::zeros(), 0.0);
        let mut say = |p: Vector2<f64>, w: f64| {
            sum += p * w;
            weight += w;
        };
        for (di, dj) in [(1, 0), (0, 1)] {
            if let (Some(a), Some(b)) = (self.at(i - di, j - dj), self.at(i + di, j + dj)) {
                say((a + b) * 0.5, 8.0);
            }
        }
        for (di, dj) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
            let (one, two, three) = (self.at(i + di, j + dj), self.at(i + 2 * di, j + 2 * dj), self.at(i + 3 * di, j + 3 * dj));
            match (one, two, three) {
                (Some(a), Some(b), Some(c)) => say(a * 3.0 - b * 3.0 + c, 2.0),
                (Some(a), Some(b), None) => say(a * 2.0 - b, 1.0),
                _ => {}
            }
        }
        for (di, dj) in [(1, 1), (1, -1), (-1, 1), (-1, -1)] {
            if let (Some(a), Some(b), Some(c)) = (self.at(i + di, j), self.at(i, j + dj), self.at(i + di, j + dj)) {
                say(a + b - c, 1.0);
            }
        }
        (weight > 0.0).then(|| sum / weight)
    }

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
                let found = self.foretold(i, j).and_then(|start| {
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

    /// Drops corners that do not look like one where it counts: a shadow's edge or a reflection runs through them. The picture's
    /// own noise is what the better half leaves unexplained.
    pub fn drop_disturbed(&mut self) {
        let mut residuals: Vec<f64> = self.cells.iter().map(|(_, cell)| cell.residual).collect();
        let Some(noise) = median(&mut residuals) else { return };
        self.cells.retain(|_, cell| cell.residual < (DISTURBED_NOISE * noise).hypot(DISTURBED_SHARE * cell.contrast));
    }

    /// Drops corners that lie where their neighbours do not foretell them, the worst first.
    pub fn drop_strays(&mut self) {
        let mut off: Grid<f64> = self.cells.filter_map(|at, cell| Some(self.share_off(at, cell)));
        loop {
            let strays = off.iter().filter(|(_, share)| **share > STRAY);
            let Some((worst, _)) = strays.max_by(|a, b| a.1.total_cmp(b.1)) else { return };
            self.cells.remove(worst);
            off.remove(worst);
            // Only those around it were foretold by it.
            for at in (-FORETELLS..=FORETELLS).flat_map(|a| (-FORETELLS..=FORETELLS).map(move |b| (worst.0 + a, worst.1 + b))) {
                if let Some(cell) = self.cells.get(at) {
                    off.insert(at, self.share_off(at, cell));
                }
            }
        }
    }

    /// How far a corner lies from where its neighbours foretell it, squares; infinite where nothing speaks for it.
    fn share_off(&self, (i, j): Place, cell: &Cell) -> f64 {
        let share = |[u, v]: [Vector2<f64>; 2]| Some((cell.position - self.foretold(i, j)?).norm() / u.norm().min(v.norm()));
        self.steps(i, j).and_then(share).unwrap_or(f64::INFINITY)
    }

    /// Keeps the corners of which this is true.
    pub fn retain(&mut self, mut keep: impl FnMut(Place) -> bool) {
        self.cells.retain(|at, _| keep(at));
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

    /// The same corners on a level `steps` levels coarser (negative: finer).
    pub fn rescaled(&self, steps: i32) -> Self {
        let cells = self.cells.filter_map(|_, cell| Some(Cell { position: super::level::rescaled(cell.position, steps), ..*cell }));
        // A pixel's own width is part of the blur, and it is another pixel there.
        let own = 1.0 / 12.0;
        let lens = (self.blur * self.blur - own).max(0.01) * 0.25_f64.powi(steps);
        Self { cells, blur: (lens + own).sqrt() }
    }

    /// Drops outermost rows and columns that are mostly empty: single corners out there are chance.
    pub fn trim(&mut self) {
        while let Some(extent) = self.extent() {
            let (w, h) = extent.size();
            let on = |side: usize, (i, j): Place| match side {
                0 => i == extent.low.0,
                1 => i == extent.high.0,
                2 => j == extent.low.1,
                _ => j == extent.high.1,
            };
            let length = |side: usize| if side < 2 { h as usize } else { w as usize };
            let sparse = (0..4).find(|&side| 2 * self.cells.iter().filter(|(at, _)| on(side, *at)).count() < length(side));
            let Some(side) = sparse else { return };
            self.cells.retain(|at, _| !on(side, at));
        }
    }
}

/// The median, or `None` of nothing; reorders in place.
pub(crate) fn median(values: &mut [f64]) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    let (_, median, _) = values.select_nth_unstable_by(values.len() / 2, f64::total_cmp);
    Some(*median)
}
