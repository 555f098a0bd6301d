//! How well a tile correlates with its prediction while its gain and bias are free. This separates
//! tiles that show the stage from those that show something else, before anything is solved.

use crate::track::align::kernel::normal::root_variance_ratio_of;
use crate::track::align::learned::noise::Noise;

/// A run compared with its prediction, gain and bias free.
#[derive(Debug, Clone, Copy, Default)]
pub struct TileCorrelation {
    /// Correlation, corrected for the attenuation by noise.
    pub correlation: f32,
    /// Mean predicted light.
    pub predicted: f32,
    /// Mean observed light.
    pub seen: f32,
    /// Intercept of the regression line of observed on predicted light.
    pub bias: f32,
    /// Whether the run takes part in the solution.
    pub is_open: bool,
}

impl TileCorrelation {
    /// Computes it from a run's [`moments`](crate::track::align::kernel::normal::moments).
    pub fn new(moments: &[f64; 10], noise: &Noise) -> Self {
        let n = moments[0].max(1.0);
        let [_, p, s, pp, ps, root_p, root_s, root_pp, root_ss, root_ps] = moments.map(|m| m / n);
        let (predicted, seen) = ((root_pp - root_p * root_p).max(1e-3), (root_ss - root_s * root_s).max(1e-3));
        let both = root_ps - root_p * root_s;
        let expected = f64::from(noise.dark + noise.per_intensity * s as f32) * root_variance_ratio_of(s);
        let clean = (seen - expected).max(0.25 * seen);
        let correlation = if moments[0] >= 8.0 { (both / (predicted * clean).sqrt()).clamp(-1.0, 1.0) } else { 0.0 };
        let bias = s - (ps - p * s) / (pp - p * p).max(1e-3) * p;
        Self { correlation: correlation as f32, predicted: p as f32, seen: s as f32, bias: bias as f32, is_open: true }
    }
}

/// Returns the upper median; `None` if there are no values. Reorders the values.
pub fn median(values: &mut [f32]) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| f64::from(*values.select_nth_unstable_by(middle, f32::total_cmp).1))
}
