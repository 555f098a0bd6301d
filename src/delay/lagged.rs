//! One camera's rotations beside the other's, shifted in time.

use super::regression::{Regression, Row};
use super::spline::AngleSpline;
use super::turns::Turns;

/// Shifts to compare: all within `margin_s` of `center_s`, on the same intervals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Window {
    pub center_s: f64,
    pub margin_s: f64,
}

/// Number of halvings, by the golden ratio, of a window when its minimum is searched: 40 leave a
/// nanosecond of the widest. Raised, the search takes longer.
const HALVINGS: usize = 40;
/// Shares of pose noise that are tried. Finer steps change sigma by less than a tenth.
const SHARES: [f64; 9] = [0.0, 0.1, 0.25, 0.5, 0.75, 0.9, 0.97, 0.99, 1.0];
/// Maximum number of times that share, shift and window are chosen in turn; two suffice mostly.
/// Raised, fits that do not settle take longer.
const ROUNDS: usize = 5;

/// A shift with the matrix fitted there.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Fit {
    /// How much later the rotations are than the spline's camera has them, seconds.
    pub lag_s: f64,
    /// The share of pose noise.
    pub of_poses: f64,
    /// The fit.
    pub regression: Regression,
}

/// Rotations of one camera, and the other's as a function of time.
#[derive(Debug, Clone)]
pub(super) struct Lagged<'a> {
    pub turns: &'a Turns,
    spline: AngleSpline,
    /// Which intervals take part.
    pub kept: Vec<bool>,
}

impl<'a> Lagged<'a> {
    pub fn new(turns: &'a Turns, other: &Turns) -> Self {
        Self { turns, spline: AngleSpline::of(other), kept: vec![true; turns.as_slice().len()] }
    }

    /// Returns the intervals that are known at all shifts of the window, compared at one of them.
    pub fn rows(&self, lag_s: f64, window: Window) -> Vec<Row> {
        let Window { center_s, margin_s } = window;
        let turns = self.turns.as_slice();
        let mut rows: Vec<Row> = Vec::new();
        for (index, turn) in turns.iter().enumerate().filter(|(index, _)| self.kept[*index]) {
            let known = self.spline.between(turn.from_s - center_s - margin_s, turn.to_s - center_s + margin_s);
            let Some(between) = known.and_then(|_| self.spline.between(turn.from_s - lag_s, turn.to_s - lag_s)) else { continue };
            let is_joined = rows.last().is_some_and(|row| row.index + 1 == index && turns[row.index].to_s == turn.from_s);
            rows.push(Row {
                index,
                middle_s: 0.5 * (turn.from_s + turn.to_s),
                share: turn.duration_s() / self.turns.typical_s(),
                is_joined,
                wanted: turn.angle,
                predicted: between.angle,
                change: between.rate_change,
            });
        }
        rows
    }

    /// Returns the fit at one shift.
    pub fn regression(&self, lag_s: f64, window: Window, of_poses: f64) -> Regression {
        Regression::of(&self.rows(lag_s, window), of_poses)
    }

    /// Returns the shift in the window at which least stays unexplained, and how much, without
    /// intervals that contradict the others.
    pub fn least_unexplained(&self, window: Window) -> (f64, f64) {
        let unexplained = |lag_s| Regression::trimmed(&self.rows(lag_s, window)).0.unexplained();
        let lag_s = minimum(window, unexplained);
        (lag_s, unexplained(lag_s))
    }

    /// Returns the most likely shift near the window's center.
    pub fn fit(&self, window: Window) -> Fit {
        let Window { mut center_s, margin_s } = window;
        let mut of_poses = 0.5;
        for _ in 0..ROUNDS {
            let window = Window { center_s, margin_s };
            let lag_s = minimum(window, |lag_s| self.regression(lag_s, window, of_poses).cost());
            let cost = |share: &f64| self.regression(lag_s, window, *share).cost();
            let share = SHARES.into_iter().min_by(|a, b| cost(a).total_cmp(&cost(b))).unwrap_or(of_poses);
            let is_settled = share == of_poses && (lag_s - center_s).abs() < 0.5 * margin_s;
            (center_s, of_poses) = (lag_s, share);
            if is_settled {
                break;
            }
        }
        let window = Window { center_s, margin_s };
        Fit { lag_s: center_s, of_poses, regression: self.regression(center_s, window, of_poses) }
    }

    /// The same comparison with a part of the intervals.
    pub fn only(&self, is_wanted: impl Fn(f64) -> bool) -> Self {
        let kept = self.turns.as_slice().iter().zip(&self.kept).map(|(turn, kept)| *kept && is_wanted(0.5 * (turn.from_s + turn.to_s)));
        Self { kept: kept.collect(), spline: self.spline.clone(), turns: self.turns }
    }
}

/// Returns where a function with one minimum in the window has it, by golden sections.
fn minimum(window: Window, cost: impl Fn(f64) -> f64) -> f64 {
    let share = 0.5 * (5.0_f64.sqrt() - 1.0);
    let (mut low, mut high) = (window.center_s - window.margin_s, window.center_s + window.margin_s);
    let (mut left, mut right) = (high - share * (high - low), low + share * (high - low));
    let (mut at_left, mut at_right) = (cost(left), cost(right));
    for _ in 0..HALVINGS {
        if at_left <= at_right {
            (high, right, at_right) = (right, left, at_left);
            left = high - share * (high - low);
            at_left = cost(left);
        } else {
            (low, left, at_left) = (left, right, at_right);
            right = low + share * (high - low);
            at_right = cost(right);
        }
    }
    0.5 * (low + high)
}
