//! The figures of a clip. What is wrong, and what is good, is as
//! `../shared/bench/evaluate.py --tight` has it.

use std::fmt;

use nalgebra::{Matrix6, Vector6};
use serde::{Deserialize, Serialize};
use stagepose::Pose;

/// A pose is wrong that is further off than this share of the distance. Raised, fewer poses are
/// wrong.
const WRONG_SHIFT: f64 = 0.01;
/// A pose is wrong that is turned by more than this, degrees. Raised, fewer poses are wrong.
const WRONG_TURN_DEG: f64 = 0.3;

/// What is compared with the baseline. Errors are of the poses that are not wrong; `None` where
/// there are none.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    pub frames: usize,
    /// Frames with a pose.
    pub given: usize,
    /// Frames with a wrong pose.
    pub wrong: usize,
    pub median_mm: Option<f64>,
    pub p95_mm: Option<f64>,
    pub median_mdeg: Option<f64>,
    pub p95_mdeg: Option<f64>,
    /// Mean squared error over the covariance that was told, over 6, of all given poses: 1 is
    /// honest.
    pub nees6: Option<f64>,
}

/// One given pose.
pub struct Found {
    shift_m: f64,
    turn_deg: f64,
    nees6: Option<f64>,
    is_wrong: bool,
}

impl Found {
    /// The distance is that of the camera from what is seen: of the stage's origin, or of an
    /// object.
    pub fn new<To, From>(truth: &Pose<To, From>, pose: &Pose<To, From>, covariance: Option<&Matrix6<f64>>, distance_m: f64) -> Self {
        let shift = truth.translation - pose.translation;
        let turn = (truth.rotation * pose.rotation.inverse()).scaled_axis();
        let error = Vector6::from_iterator(shift.iter().chain(turn.iter()).copied());
        let nees6 = covariance.and_then(|c| Some(error.dot(&c.cholesky()?.solve(&error)) / 6.0));
        let (shift_m, turn_deg) = (shift.norm(), turn.norm().to_degrees());
        Self { shift_m, turn_deg, nees6, is_wrong: shift_m > WRONG_SHIFT * distance_m || turn_deg > WRONG_TURN_DEG }
    }
}

/// The figures of a clip of so many frames.
pub fn figures(frames: usize, found: Vec<Found>) -> Figures {
    let right = || found.iter().filter(|f| !f.is_wrong);
    let shifts = sorted(right().map(|f| 1e3 * f.shift_m));
    let turns = sorted(right().map(|f| 1e3 * f.turn_deg));
    let nees: Vec<f64> = found.iter().filter_map(|f| f.nees6).collect();
    Figures {
        frames,
        given: found.len(),
        wrong: found.len() - shifts.len(),
        median_mm: percentile(&shifts, 0.5),
        p95_mm: percentile(&shifts, 0.95),
        median_mdeg: percentile(&turns, 0.5),
        p95_mdeg: percentile(&turns, 0.95),
        nees6: (!nees.is_empty()).then(|| rounded(nees.iter().sum::<f64>() / nees.len() as f64)),
    }
}

fn sorted(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values
}

/// Between the two nearest ranks, as numpy has it.
fn percentile(sorted: &[f64], share: f64) -> Option<f64> {
    let rank = share * (sorted.len().checked_sub(1)?) as f64;
    let (below, above) = (sorted[rank.floor() as usize], sorted[rank.ceil() as usize]);
    Some(rounded(below + (above - below) * rank.fract()))
}

/// Four decimals: what is beyond says nothing, and the baseline is easier to read.
fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}

/// A line of the table.
pub struct Row {
    pub name: String,
    pub figures: Figures,
    /// Of tracking a frame, mean; an object has none of its own.
    pub ms: Option<f64>,
}

impl Row {
    /// Above the lines.
    pub const HEAD: &str = "scene        frames  given %  good %  wrong  median mm   p95 mm  median mdeg  p95 mdeg  NEES/6  ms a frame";
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Figures { frames, given, wrong, median_mm, p95_mm, median_mdeg, p95_mdeg, nees6 } = &self.figures;
        let percent = |count: usize| 100.0 * count as f64 / *frames as f64;
        let number = |value: &Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.2}"));
        write!(
            f,
            "{:<12} {frames:>6} {:>8.1} {:>7.1} {wrong:>6} {:>10} {:>8} {:>12} {:>9} {:>7} {:>11}",
            self.name,
            percent(*given),
            percent(given - wrong),
            number(median_mm),
            number(p95_mm),
            number(median_mdeg),
            number(p95_mdeg),
            number(nees6),
            number(&self.ms),
        )
    }
}
