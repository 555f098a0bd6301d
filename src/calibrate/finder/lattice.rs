//! A lattice of corners: integer coordinates, positions in the picture, and predictions of
//! neighbours.
//!
//! From +i to +j is clockwise in the picture. The square between +i and +j of corner (0, 0) is
//! dark, so that of (i, j) is dark if i + j is even.

use nalgebra::Vector2;

use super::grid::{Grid, Place};
use super::level::rescaled;
use crate::geometry::robust_kernel::median;

/// One corner of a lattice.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cell {
    /// Position, level pixels.
    pub position: Vector2<f64>,
    /// The grey level halfway between dark and light.
    pub middle: f64,
    /// Half the difference between light and dark, grey levels.
    pub contrast: f64,
    /// Residual of the fit, grey levels; 0 before there was one.
    pub residual: f64,
}

/// Corners by their coordinates.
#[derive(Debug, Clone, Default)]
pub(crate) struct Lattice {
    pub(super) cells: Grid<Cell>,
    /// Standard deviation of the blur, level pixels: the median of the fits.
    pub blur: f64,
}

/// Minimum and maximum coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Extent {
    pub low: (i32, i32),
    pub high: (i32, i32),
}

impl Extent {
    /// Returns the number of corners along i and j.
    pub fn size(&self) -> (u32, u32) {
        ((self.high.0 - self.low.0 + 1) as u32, (self.high.1 - self.low.1 + 1) as u32)
    }

    pub fn contains(&self, (i, j): Place) -> bool {
        (self.low.0..=self.high.0).contains(&i) && (self.low.1..=self.high.1).contains(&j)
    }

    /// Returns the size with the larger number first.
    pub fn sorted_size(&self) -> (u32, u32) {
        let (a, b) = self.size();
        (a.max(b), a.min(b))
    }
}

/// Maximum distance, in squares, between a corner and its neighbours' prediction: half as far as
/// the border to the next place. Raised, corners of shadows and reflections stay; lowered, true
/// ones of bent boards and near the rim of wide lenses are dropped.
const MAX_CORNER_OFFSET: f64 = 0.25;
/// Distance in squares up to which corners contribute to a prediction: follows from
/// [`Lattice::predicted`], and must grow with it.
const PREDICTION_REACH: i32 = 3;
/// Maximum residual of a clean corner: this multiple of the noise and this fraction of the
/// contrast, added in quadrature. Chosen, not tuned: twice the median residual, and a fraction for
/// boards with almost no residuals. Raised, corners under a shadow's edge or a reflection stay;
/// lowered, good ones in noisy pictures are dropped.
const DISTURBED_NOISE: f64 = 2.0;
const DISTURBED_SHARE: f64 = 0.08;

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

    /// Returns the corners at most `reach` places away.
    pub fn around(&self, at: Place, reach: i32) -> impl Iterator<Item = &Cell> {
        self.cells.around(at, reach)
    }

    pub fn cells(&self) -> impl Iterator<Item = (Place, &Cell)> {
        self.cells.iter()
    }

    /// Returns the range of coordinates; `None` if there are no corners.
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

    /// Returns the steps from each corner to the next along one axis.
    pub fn differences(&self, along: Place) -> Grid<Vector2<f64>> {
        self.cells.filter_map(|(i, j), cell| Some(self.at(i + along.0, j + along.1)? - cell.position))
    }

    /// Returns one square's step along +i and +j at a corner, from its neighbours or theirs.
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

    /// Predicts a corner's position from those around it.
    pub fn predicted(&self, i: i32, j: i32) -> Option<Vector2<f64>> {
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

    /// Drops corners whose residual is too large, as when a shadow's edge or a reflection runs
    /// through them. The median residual serves as the picture's noise.
    pub fn drop_disturbed(&mut self) {
        let mut residuals: Vec<f64> = self.cells.iter().map(|(_, cell)| cell.residual).collect();
        let Some(noise) = median(&mut residuals) else { return };
        self.cells.retain(|_, cell| cell.residual < (DISTURBED_NOISE * noise).hypot(DISTURBED_SHARE * cell.contrast));
    }

    /// Drops corners that do not lie where their neighbours predict them, the worst first.
    pub fn drop_outliers(&mut self) {
        let mut off: Grid<f64> = self.cells.filter_map(|at, cell| Some(self.share_off(at, cell)));
        loop {
            let outliers = off.iter().filter(|(_, share)| **share > MAX_CORNER_OFFSET);
            let Some((worst, _)) = outliers.max_by(|a, b| a.1.total_cmp(b.1)) else { return };
            self.cells.remove(worst);
            off.remove(worst);
            // Only the corners around it were predicted from it.
            for at in (-PREDICTION_REACH..=PREDICTION_REACH)
                .flat_map(|a| (-PREDICTION_REACH..=PREDICTION_REACH).map(move |b| (worst.0 + a, worst.1 + b)))
            {
                if let Some(cell) = self.cells.get(at) {
                    off.insert(at, self.share_off(at, cell));
                }
            }
        }
    }

    /// Returns the distance between a corner and its neighbours' prediction, squares; infinite if
    /// there is no prediction.
    fn share_off(&self, (i, j): Place, cell: &Cell) -> f64 {
        let share = |[u, v]: [Vector2<f64>; 2]| Some((cell.position - self.predicted(i, j)?).norm() / u.norm().min(v.norm()));
        self.steps(i, j).and_then(share).unwrap_or(f64::INFINITY)
    }

    /// Keeps the corners for which `keep` is true.
    pub fn retain(&mut self, mut keep: impl FnMut(Place) -> bool) {
        self.cells.retain(|at, _| keep(at));
    }

    /// Returns the same corners on a level `steps` levels coarser (negative: finer).
    pub fn rescaled(&self, steps: i32) -> Self {
        let cells = self.cells.filter_map(|_, cell| Some(Cell { position: rescaled(cell.position, steps), ..*cell }));
        // The blur includes the pixel's own width, which differs between levels.
        let own = 1.0 / 12.0;
        let lens = (self.blur * self.blur - own).max(0.01) * 0.25_f64.powi(steps);
        Self { cells, blur: (lens + own).sqrt() }
    }

    /// Drops outermost rows and columns that are mostly empty: isolated corners there are chance.
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
