//! The figures of a clip: how many poses were reported, how many are wrong, and how accurate the
//! others are.

use std::fmt;

use nalgebra::{Matrix6, Vector6};
use serde::{Deserialize, Serialize};
use stagepose::Pose;
use stagepose::diagnostics::simulate::{PoseError, percentile};

/// The figures that are compared with the baseline. Errors exclude wrong poses; `None` if no pose
/// remains.
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
    /// Mean over all reported poses of the squared error, weighted by the inverse of the reported
    /// covariance and divided by 6. It is 1 if the covariance is right.
    pub nees6: Option<f64>,
    /// Linear systems that alignment solved per frame with a pose: the mean, and 95 % are at most
    /// this many. A frame in which the body was searched for has those of all starts.
    pub mean_rounds: Option<f64>,
    pub p95_rounds: Option<f64>,
}

/// One reported pose.
pub struct Found {
    error: PoseError,
    nees6: Option<f64>,
    rounds: u64,
}

impl Found {
    /// `distance_m`: of the camera from what it sees: the stage's origin, or an object. `rounds`:
    /// of its alignment in this frame.
    pub fn new<To, From>(
        truth: &Pose<To, From>,
        pose: &Pose<To, From>,
        covariance: Option<&Matrix6<f64>>,
        distance_m: f64,
        rounds: u64,
    ) -> Self {
        let shift = truth.translation - pose.translation;
        let rotation = (truth.rotation * pose.rotation.inverse()).scaled_axis();
        let error = Vector6::from_iterator(shift.iter().chain(rotation.iter()).copied());
        let nees6 = covariance.and_then(|c| Some(error.dot(&c.cholesky()?.solve(&error)) / 6.0));
        Self { error: PoseError::between(pose, truth, distance_m), nees6, rounds }
    }
}

/// Returns the figures of a clip that has this many frames.
pub fn figures(frames: usize, found: Vec<Found>) -> Figures {
    let right = || found.iter().map(|f| f.error).filter(|error| !error.is_wrong());
    let shifts = sorted(right().map(|error| 1e3 * error.position_m));
    let rotations = sorted(right().map(|error| 1e3 * error.rotation_deg));
    let nees: Vec<f64> = found.iter().filter_map(|f| f.nees6).collect();
    let rounds = sorted(found.iter().map(|f| f.rounds as f64));
    Figures {
        frames,
        given: found.len(),
        wrong: found.len() - shifts.len(),
        median_mm: percentile(&shifts, 0.5).map(rounded),
        p95_mm: percentile(&shifts, 0.95).map(rounded),
        median_mdeg: percentile(&rotations, 0.5).map(rounded),
        p95_mdeg: percentile(&rotations, 0.95).map(rounded),
        nees6: mean(&nees).map(rounded),
        mean_rounds: mean(&rounds).map(rounded),
        p95_rounds: percentile(&rounds, 0.95).map(rounded),
    }
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

fn sorted(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values
}

/// Rounds to four decimals: further ones are noise, and the baseline is easier to read.
fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}

/// A line of the table.
pub struct Row {
    pub name: String,
    pub figures: Figures,
    /// Mean time to track a frame, milliseconds; `None` for an object, which is tracked with the
    /// camera.
    pub ms: Option<f64>,
}

impl Row {
    /// Column headings.
    pub const HEAD: &str =
        "scene        frames  given %  good %  wrong  median mm   p95 mm  median mdeg  p95 mdeg  NEES/6  rounds  p95  ms a frame";
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Figures { frames, given, wrong, median_mm, p95_mm, median_mdeg, p95_mdeg, nees6, mean_rounds, p95_rounds } = &self.figures;
        let percent = |count: usize| 100.0 * count as f64 / *frames as f64;
        let number = |value: &Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.2}"));
        write!(
            f,
            "{:<12} {frames:>6} {:>8.1} {:>7.1} {wrong:>6} {:>10} {:>8} {:>12} {:>9} {:>7} {:>7} {:>4} {:>11}",
            self.name,
            percent(*given),
            percent(given - wrong),
            number(median_mm),
            number(p95_mm),
            number(median_mdeg),
            number(p95_mdeg),
            number(nees6),
            mean_rounds.map_or("-".to_owned(), |mean| format!("{mean:.1}")),
            p95_rounds.map_or("-".to_owned(), |p95| format!("{p95:.0}")),
            number(&self.ms),
        )
    }
}
