//! Cross-validation: calibrates two halves of the views separately and compares the results.

use super::super::solve::adjust::{Bundle, Observation};
use super::super::solve::lens::{LENS_NAMES, LENS_NUMBERS};
use super::super::solve::{self, Estimate, MIN_VIEWS, SolveOptions};
use super::map;

/// How the two halves compare.
#[derive(Debug, Clone, PartialEq)]
pub struct Halves {
    /// Difference of each parameter in units of its joint sigma; 0 if it is not estimated.
    pub sigmas: [f64; LENS_NUMBERS],
    /// How far the halves' cameras differ at most over most (80 %) of the picture, pixels.
    pub most_px: f64,
}

impl Halves {
    /// Returns the parameter that differs most, and by how many joint sigma.
    pub fn worst_number(&self) -> (&'static str, f64) {
        let most = (0..LENS_NUMBERS).max_by(|&a, &b| self.sigmas[a].total_cmp(&self.sigmas[b])).unwrap_or(0);
        (LENS_NAMES[most], self.sigmas[most])
    }

    /// Whether every parameter agrees within 3 joint sigma.
    pub fn agree(&self) -> bool {
        self.worst_number().1 <= 3.0
    }
}

/// Calibrates the even and the odd views; `None` if a half has too few views or is undetermined.
pub fn compare(views: &[Vec<Observation>], whole: &Estimate, size: (u32, u32), options: &SolveOptions) -> Option<Halves> {
    if views.len() < 2 * MIN_VIEWS {
        return None;
    }
    let half = |first: usize| {
        let pick = (first..views.len()).step_by(2);
        let chosen: Vec<Vec<Observation>> = pick.clone().map(|v| views[v].clone()).collect();
        let bundle = Bundle { lens: whole.bundle.lens, poses: pick.map(|v| whole.bundle.poses[v]).collect() };
        solve::refine(bundle, &chosen, options)
    };
    let (a, b) = (half(0)?, half(1)?);
    let sigmas = std::array::from_fn(|k| {
        let joint = (a.lens_covariance[(k, k)] + b.lens_covariance[(k, k)]).sqrt();
        if joint > 0.0 { (a.bundle.lens.0[k] - b.bundle.lens.0[k]).abs() / joint } else { 0.0 }
    });
    let (one, two) = (a.bundle.lens.model(size.0, size.1).ok()?, b.bundle.lens.model(size.0, size.1).ok()?);
    Some(Halves { sigmas, most_px: map::lengths(&map::difference(&one, &two)).quantile(map::MOST) })
}
