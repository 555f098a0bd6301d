//! A lattice of corners: whole-number coordinates, positions in the picture, and what they foretell of their neighbours.
//!
//! Coordinates (i, j) turn clockwise in the picture from +i to +j, and the square between +i and +j of corner (0, 0)
//! is dark, so the one of (i, j) is dark where i + j is even.

use std::collections::BTreeMap;

use nalgebra::Vector2;

use super::fit::{CornerFit, Surroundings, fit_corner};
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
    cells: BTreeMap<(i32, i32), Cell>,
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

    /// The larger number first.
    pub fn sorted_size(&self) -> (u32, u32) {
        let (a, b) = self.size();
        (a.max(b), a.min(b))
    }
}

/// A corner this share of a square away from where its neighbours foretell it is none.
const STRAY: f64 = 0.25;
/// More than this times the noise and this share of the contrast left unexplained is no clean corner.
const DISTURBED_NOISE: f64 = 2.0;
const DISTURBED_SHARE: f64 = 0.08;
/// Blur that a fit starts from at most, level pixels.
const WIDEST_START: f64 = 2.0;
/// Larger boards are not looked for.
const MOST_CORNERS: usize = 10_000;

impl Lattice {
    pub fn new(cells: BTreeMap<(i32, i32), Cell>) -> Self {
        Self { cells, blur: 0.7 }
    }

    pub fn len(&self) -> usize {
        self.cells.len()
    }

    pub fn get(&self, at: (i32, i32)) -> Option<&Cell> {
        self.cells.get(&at)
    }

    pub fn cells(&self) -> impl Iterator<Item = (&(i32, i32), &Cell)> {
        self.cells.iter()
    }

    /// `None` where there is not one corner.
    pub fn extent(&self) -> Option<Extent> {
        let (&first, _) = self.cells.iter().next()?;
        Some(self.cells.keys().fold(Extent { low: first, high: first }, |e, &(i, j)| Extent {
            low: (e.low.0.min(i), e.low.1.min(j)),
            high: (e.high.0.max(i), e.high.1.max(j)),
        }))
    }

    pub fn at(&self, i: i32, j: i32) -> Option<Vector2<f64>> {
        self.cells.get(&(i, j)).map(|cell| cell.position)
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
        let mut window = Window::default();
        let mut tried: BTreeMap<(i32, i32), usize> = BTreeMap::new();
        loop {
            let around = self.cells.keys().flat_map(|&(i, j)| [(i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)]);
            let mut missing: Vec<(i32, i32)> = around.filter(|at| !self.cells.contains_key(at)).collect();
            missing.sort_unstable();
            missing.dedup();
            let mut added = false;
            for (i, j) in missing {
                // A place is tried again only when it has more neighbours than the last time.
                let neighbours = self.neighbours(i, j);
                if tried.insert((i, j), neighbours).is_some_and(|before| before >= neighbours) {
                    continue;
                }
                let found = self.foretold(i, j).and_then(|start| {
                    let around = self.surroundings((i, j), start, None);
                    self.fit_at(level, i, j, start, &around, &mut window)
                });
                if let Some(fit) = found {
                    self.cells.insert((i, j), fit.into());
                    added = true;
                }
            }
            if !added || self.cells.len() > MOST_CORNERS {
                return;
            }
        }
    }

    fn neighbours(&self, i: i32, j: i32) -> usize {
        let around = (-1..=1).flat_map(|a| (-1..=1).map(move |b| (a, b)));
        around.filter(|&(a, b)| self.cells.contains_key(&(i + a, j + b))).count()
    }

    /// Fits every corner on `level` where its position is known to about a pixel, and drops those that are none. With `margin`
    /// the lattice is the whole board, and what lies around it is known.
    pub fn refit(&mut self, level: &Level, margin: Option<&Margin>) {
        let mut fits = BTreeMap::new();
        let mut window = Window::default();
        let mut blurs = Vec::with_capacity(self.cells.len());
        for (&(i, j), cell) in &self.cells {
            let around = self.surroundings((i, j), cell.position, margin);
            if let Some(fit) = self.fit_at(level, i, j, cell.position, &around, &mut window) {
                blurs.push(fit.blur);
                fits.insert((i, j), fit.into());
            }
        }
        self.cells = fits;
        if let Some(blur) = median(&mut blurs) {
            self.blur = blur;
        }
    }

    /// Drops corners that do not look like one where it counts: a shadow's edge or a reflection runs through them. The picture's
    /// own noise is what the better half leaves unexplained.
    pub fn drop_disturbed(&mut self) {
        let mut residuals: Vec<f64> = self.cells.values().map(|cell| cell.residual).collect();
        let Some(noise) = median(&mut residuals) else { return };
        self.cells.retain(|_, cell| cell.residual < (DISTURBED_NOISE * noise).hypot(DISTURBED_SHARE * cell.contrast));
    }

    /// Drops corners that lie where their neighbours do not foretell them, the worst first.
    pub fn drop_strays(&mut self) {
        loop {
            let share = |(i, j): (i32, i32), cell: &Cell| {
                let [u, v] = self.steps(i, j)?;
                Some((cell.position - self.foretold(i, j)?).norm() / u.norm().min(v.norm()))
            };
            // A corner without neighbours that foretell it is one that nothing speaks for.
            let off = self.cells.iter().map(|(&at, cell)| (share(at, cell).unwrap_or(f64::INFINITY), at));
            let off = off.filter(|(share, _)| *share > STRAY);
            let Some((_, worst)) = off.max_by(|a, b| a.0.total_cmp(&b.0)) else { return };
            self.cells.remove(&worst);
        }
    }

    /// Keeps the corners of which this is true.
    pub fn retain(&mut self, mut keep: impl FnMut((i32, i32)) -> bool) {
        self.cells.retain(|&at, _| keep(at));
    }

    /// A corner fit with the steps and colours of this lattice.
    fn fit_at(&self, level: &Level, i: i32, j: i32, start: Vector2<f64>, around: &Surroundings, window: &mut Window) -> Option<CornerFit> {
        let steps = self.steps(i, j)?;
        // A narrow start keeps the window small; it widens where the fit asks for it.
        let fit = fit_corner(level, start, steps, self.blur.min(WIDEST_START), around, window)?;
        let dark_first = (i + j).rem_euclid(2) == 0;
        ((fit.contrast < 0.0) == dark_first).then_some(fit)
    }

    /// The same corners on a level `steps` levels coarser (negative: finer).
    pub fn rescaled(&self, steps: i32) -> Self {
        let cells = self.cells.iter().map(|(&at, cell)| (at, Cell { position: super::level::rescaled(cell.position, steps), ..*cell }));
        // A pixel's own width is part of the blur, and it is another pixel there.
        let own = 1.0 / 12.0;
        let lens = (self.blur * self.blur - own).max(0.01) * 0.25_f64.powi(steps);
        Self { cells: cells.collect(), blur: (lens + own).sqrt() }
    }

    /// Drops outermost rows and columns that are mostly empty: single corners out there are chance.
    pub fn trim(&mut self) {
        while let Some(extent) = self.extent() {
            let (w, h) = extent.size();
            let on = |side: usize, &(i, j): &(i32, i32)| match side {
                0 => i == extent.low.0,
                1 => i == extent.high.0,
                2 => j == extent.low.1,
                _ => j == extent.high.1,
            };
            let length = |side: usize| if side < 2 { h as usize } else { w as usize };
            let sparse = (0..4).find(|&side| 2 * self.cells.keys().filter(|at| on(side, at)).count() < length(side));
            let Some(side) = sparse else { return };
            self.cells.retain(|at, _| !on(side, at));
        }
    }
}

/// The median, or `None` of nothing; sorts in place.
pub(crate) fn median(values: &mut [f64]) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    values.sort_unstable_by(f64::total_cmp);
    Some(values[values.len() / 2])
}
