//! The evidence of one cell for a second moment: how much of "both moments", "alternating rows" and
//! plain softness its picture contains beside the single moment that fits best. A cell is a small
//! block of pixels, compared with the reference picture drawn at several moments.

use crate::track::model_error::tuning::TUNING;
use nalgebra::{Matrix3, SMatrix, Vector3};

/// Columns and rows of a cell, pixels. Raised, folds and light vary within a cell; lowered, a cell
/// has little detail.
pub const CELL_COLUMNS: usize = 24;
pub const CELL_ROWS: usize = 16;
/// Number of pixels with neighbours on all sides.
const INSIDE: usize = (CELL_COLUMNS - 2) * (CELL_ROWS - 2);

/// The greys of a cell, by row and column.
pub type Greys = [[f32; CELL_COLUMNS]; CELL_ROWS];

/// The moments that are drawn, in frame intervals from the frame's own. Not tuned; more cost more.
pub const MOMENTS: [f64; 5] = [-1.0, -0.5, 0.0, 0.5, 1.0];
/// Indices in [`MOMENTS`] of the middles of two moments a frame interval apart: the pose may be
/// that of either moment, or between them.
pub const MIDDLES: [usize; 3] = [1, 2, 3];

/// A cell as the frame shows it, and as it should look at the [`MOMENTS`].
#[derive(Debug)]
pub struct Cell {
    /// Greys in the frame.
    pub seen: Greys,
    /// Greys of the reference picture, drawn at each of the moments.
    pub drawn: [Greys; MOMENTS.len()],
    /// Whether the first row is an even one of the frame.
    pub begins_even: bool,
}

/// Normal equations of [both moments, alternating rows, softness], summed over cells.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Evidence {
    /// Normal matrix.
    pub normal: Matrix3<f64>,
    /// Right side.
    pub right: Vector3<f64>,
}

/// Shares of a second moment. `both` is 1 where the whole picture is the mean of the two ends of a
/// frame interval; an exposure as long as the interval has a third. `alternating` is 1 or -1 where
/// rows alternate between the two ends, and 0 for an exposure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shares {
    /// Share of the mean of both moments.
    pub both: f64,
    /// Share of alternating rows; positive where even rows show the later moment.
    pub alternating: f64,
}

/// Numbers and indices of the regression's columns: what one moment explains, the unknowns, and the
/// observed greys.
const MOMENT_COLUMNS: usize = 3;
const UNKNOWNS: usize = 3;
const SEEN: usize = MOMENT_COLUMNS + UNKNOWNS;
const REGRESSION_COLUMNS: usize = SEEN + 1;

impl Evidence {
    /// Scales the earlier evidence by this factor.
    pub fn fade(&mut self, share: f64) {
        self.normal *= share;
        self.right *= share;
    }

    /// Adds other evidence.
    pub fn add(&mut self, other: &Self) {
        self.normal += other.normal;
        self.right += other.right;
    }

    /// Returns the shares; `None` where too little is known.
    pub fn shares(&self) -> Option<Shares> {
        // Alternating rows are not visible in smaller copies of a frame.
        let mut normal = self.normal;
        normal[(1, 1)] += 1e-6 * normal[(0, 0)] + f64::MIN_POSITIVE;
        let x = normal.cholesky()?.solve(&self.right);
        Some(Shares { both: x[0], alternating: x[1] })
    }
}

/// A cell's evidence if its two moments lie about one of the [`MIDDLES`].
#[derive(Debug, Clone, Copy, Default)]
pub struct OfCell {
    /// Its normal equations.
    pub evidence: Evidence,
    /// Fraction of the variance that the regression leaves.
    pub left: f64,
}

impl Cell {
    /// Returns the evidence for each of the [`MIDDLES`]; `None` where the cell has no detail, or
    /// shows something else.
    pub fn evidence(&self) -> Option<[OfCell; MIDDLES.len()]> {
        let mut cells = [OfCell { left: 1.0, ..OfCell::default() }; MIDDLES.len()];
        for (cell, middle) in cells.iter_mut().zip(MIDDLES) {
            *cell = self.evidence_about(middle).unwrap_or(*cell);
        }
        cells.iter().any(|cell| cell.left < TUNING.max_cell_residual_ratio).then_some(cells)
    }

    /// Returns the moment that the frame shows the cell at, in frame intervals from its own: the
    /// drawn moment that it resembles most, refined by the picture's change about that. `None`
    /// where it resembles none of them.
    pub fn moment(&self) -> Option<f64> {
        let inside = |greys: &Greys| {
            let mut out = [0.0; INSIDE];
            for (k, out) in out.iter_mut().enumerate() {
                *out = greys[1 + k / (CELL_COLUMNS - 2)][1 + k % (CELL_COLUMNS - 2)];
            }
            let mean = out.iter().sum::<f32>() / INSIDE as f32;
            out.map(|grey| grey - mean)
        };
        let product = |a: &[f32; INSIDE], b: &[f32; INSIDE]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>();
        let (seen, drawn) = (inside(&self.seen), self.drawn.each_ref().map(inside));
        let variance = product(&seen, &seen);
        if variance < TUNING.min_cell_contrast.powi(2) * INSIDE as f32 {
            return None;
        }
        let left = drawn.each_ref().map(|drawn| {
            let (both, own) = (product(&seen, drawn), product(drawn, drawn));
            if both > 0.0 && own > 0.0 { 1.0 - both * both / (own * variance) } else { 1.0 }
        });
        let best = (0..MOMENTS.len()).min_by(|a, b| left[*a].total_cmp(&left[*b]))?;
        let own = &drawn[best];
        let (from, to) = (best.saturating_sub(1), (best + 1).min(MOMENTS.len() - 1));
        let mut change: [f32; INSIDE] = std::array::from_fn(|k| drawn[to][k] - drawn[from][k]);
        let gain = product(&seen, own) / product(own, own);
        // The part of the change that looks like a gain of the light is not motion.
        let lit = product(&change, own) / product(own, own);
        change.iter_mut().zip(own).for_each(|(change, own)| *change -= lit * own);
        let moved = product(&seen, &change) / (gain * product(&change, &change)).max(f32::MIN_POSITIVE);
        let explained = moved * product(&seen, &change) * gain;
        let has_moment = variance * left[best] - explained < TUNING.max_cell_residual_ratio as f32 * variance && moved.abs() <= 0.5;
        has_moment.then(|| MOMENTS[best] + f64::from(moved) * (MOMENTS[to] - MOMENTS[from]))
    }

    fn evidence_about(&self, middle: usize) -> Option<OfCell> {
        let columns = self.columns(middle);
        let product = |a: usize, b: usize| columns[a].iter().zip(&columns[b]).map(|(a, b)| a * b).sum::<f32>();
        let mut gram = SMatrix::<f64, REGRESSION_COLUMNS, REGRESSION_COLUMNS>::zeros();
        for a in 0..REGRESSION_COLUMNS {
            for b in 0..=a {
                gram[(a, b)] = f64::from(product(a, b));
                gram[(b, a)] = gram[(a, b)];
            }
        }
        let variance = gram[(SEEN, SEEN)];
        if variance < f64::from(TUNING.min_cell_contrast.powi(2)) * INSIDE as f64 {
            return None;
        }
        // The light's gain and the cell's position are free for a single moment.
        let explained = gram.fixed_view::<MOMENT_COLUMNS, MOMENT_COLUMNS>(0, 0).into_owned().cholesky()?;
        let gain = explained.solve(&gram.fixed_view::<MOMENT_COLUMNS, 1>(0, SEEN))[0];
        let across = gram.fixed_view::<MOMENT_COLUMNS, { REGRESSION_COLUMNS - MOMENT_COLUMNS }>(0, MOMENT_COLUMNS).into_owned();
        let rest = gram
            .fixed_view::<{ REGRESSION_COLUMNS - MOMENT_COLUMNS }, { REGRESSION_COLUMNS - MOMENT_COLUMNS }>(MOMENT_COLUMNS, MOMENT_COLUMNS)
            - across.transpose() * explained.solve(&across);
        let mut normal = rest.fixed_view::<UNKNOWNS, UNKNOWNS>(0, 0).into_owned();
        let right = rest.fixed_view::<UNKNOWNS, 1>(0, UNKNOWNS).into_owned();
        let left = rest[(UNKNOWNS, UNKNOWNS)] - {
            let ridge = 1e-6 * normal.trace() + f64::MIN_POSITIVE;
            (normal + Matrix3::identity() * ridge).cholesky()?.solve(&right).dot(&right)
        };
        normal *= gain * gain;
        (gain > 0.0).then(|| OfCell { evidence: Evidence { normal, right: right * gain }, left: (left / variance).max(0.0) })
    }

    /// Returns all columns, each without its mean.
    #[allow(clippy::needless_range_loop)]
    fn columns(&self, middle: usize) -> [[f32; INSIDE]; REGRESSION_COLUMNS] {
        let mut columns = [[0.0; INSIDE]; REGRESSION_COLUMNS];
        let Self { seen, drawn, begins_even } = self;
        let [before, now, after] = [&drawn[middle - 1], &drawn[middle], &drawn[middle + 1]];
        let mut k = 0;
        for v in 1..CELL_ROWS - 1 {
            let sign = if (v % 2 == 0) == *begins_even { 0.5 } else { -0.5 };
            for u in 1..CELL_COLUMNS - 1 {
                let own = now[v][u];
                let values = [
                    own,
                    now[v][u + 1] - now[v][u - 1],
                    now[v + 1][u] - now[v - 1][u],
                    0.5 * (before[v][u] + after[v][u]) - own,
                    sign * (after[v][u] - before[v][u]),
                    now[v][u + 1] + now[v][u - 1] + now[v + 1][u] + now[v - 1][u] - 4.0 * own,
                    seen[v][u],
                ];
                for (column, value) in columns.iter_mut().zip(values) {
                    column[k] = value;
                }
                k += 1;
            }
        }
        for column in &mut columns {
            let mean = column.iter().sum::<f32>() / INSIDE as f32;
            column.iter_mut().for_each(|value| *value -= mean);
        }
        columns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A picture with detail of several sizes, moved along x.
    fn picture(moved_px: f32) -> Greys {
        std::array::from_fn(|v| {
            std::array::from_fn(|u| {
                let (x, y) = (u as f32 - moved_px, v as f32);
                110.0 + 30.0 * (0.6 * x + 0.3 * y).sin() + 25.0 * (0.25 * x - 0.5 * y).cos() + 12.0 * (1.1 * x + 0.2 * y).sin()
            })
        })
    }

    fn cell(seen: Greys, way_px: f32) -> Cell {
        Cell { seen, drawn: MOMENTS.map(|t| picture(t as f32 * way_px)), begins_even: true }
    }

    /// Returns the shares about the middle that explains most.
    fn shares(seen: Greys, way_px: f32) -> (usize, Shares) {
        let cells = cell(seen, way_px).evidence().unwrap();
        let best = (0..MIDDLES.len()).min_by(|a, b| cells[*a].left.total_cmp(&cells[*b].left)).unwrap();
        (MIDDLES[best], cells[best].evidence.shares().unwrap())
    }

    fn of_rows(grey: impl Fn(usize, usize) -> f32) -> Greys {
        std::array::from_fn(|v| std::array::from_fn(|u| grey(v, u)))
    }

    #[test]
    fn a_frame_of_one_moment_is_not_a_mixture_at_any_light() {
        for moved_px in [0.0, 0.3] {
            let seen = of_rows(|v, u| 20.0 + 0.6 * picture(moved_px)[v][u]);
            let (_, Shares { both, alternating }) = shares(seen, 3.0);
            assert!(both.abs() < 0.1 && alternating.abs() < 0.03, "{both} {alternating}");
        }
    }

    #[test]
    fn a_full_frame_exposure_has_a_mixture_share_of_a_third() {
        let moments: Vec<Greys> = (0..20).map(|k| picture(3.0 * ((k as f32 + 0.5) / 20.0 - 0.5))).collect();
        let seen = of_rows(|v, u| moments.iter().map(|m| m[v][u]).sum::<f32>() / 20.0);
        let (_, Shares { both, alternating }) = shares(seen, 3.0);
        assert!((both - 0.33).abs() < 0.1 && alternating.abs() < 0.03, "{both} {alternating}");
    }

    #[test]
    fn blended_and_interlaced_frames_are_detected_at_any_pose() {
        for (shift_px, middle) in [(-1.5, 1), (0.0, 2), (1.5, 3)] {
            let [before, after] = [shift_px - 1.5, shift_px + 1.5].map(picture);
            let (found, blended) = shares(of_rows(|v, u| 0.5 * (before[v][u] + after[v][u])), 3.0);
            assert!(blended.both > 0.8 && blended.alternating.abs() < 0.03 && found == middle, "{blended:?} {found}");
            let (found, woven) = shares(of_rows(|v, u| if v % 2 == 0 { after[v][u] } else { before[v][u] }), 3.0);
            assert!(woven.both > 0.8 && woven.alternating > 0.8 && found == middle, "{woven:?} {found}");
        }
    }

    #[test]
    fn the_moment_of_a_cell_is_estimated() {
        for way_px in [2.0, 5.0] {
            for t in [-1.1_f32, -0.7, -0.3, 0.0, 0.2, 0.5, 0.9] {
                let seen = of_rows(|v, u| 30.0 + 0.7 * picture(t * way_px)[v][u]);
                let moment = cell(seen, way_px).moment().unwrap();
                assert!((moment - f64::from(t)).abs() < 0.2, "{way_px} {t}: {moment}");
            }
        }
    }

    #[test]
    fn cells_of_another_picture_give_no_evidence() {
        let other = of_rows(|v, u| 100.0 + 40.0 * (0.9 * v as f32).sin() * (0.8 * u as f32 + 1.0).cos());
        for seen in [other, [[80.0; CELL_COLUMNS]; CELL_ROWS]] {
            assert!(cell(seen, 3.0).evidence().is_none() && cell(seen, 3.0).moment().is_none());
        }
    }
}
