//! What the clues of many frames agree on, where some of them err.

use nalgebra::Vector2;

/// Neighbouring frames share their errors: they are counted in blocks of this many, a fifth of a second at
/// 30 a second. Raised, sigma itself scatters; lowered, sigma comes out too small.
pub const BLOCK: usize = 6;
/// Fewest frames that tell of something: two blocks. Raised, clips with a short shake give no answer; lowered, sigma is a guess.
pub const MIN_FRAMES: usize = 12;

/// What a frame says: a value, and the variance that it has by the frame's noise.
pub type Said = Vector2<f64>;

/// What many frames agree on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Agreement {
    /// The robust mean.
    pub value: f64,
    /// One standard deviation, from the frames' disagreement.
    pub sigma: f64,
    /// How many frames.
    pub frames: usize,
}

/// What the mean is worked out in; keeps its memory.
#[derive(Debug, Clone, Default)]
pub struct AgreementBuffers {
    sorted: Vec<(f64, f64)>,
    weights: Vec<f64>,
}

impl AgreementBuffers {
    /// Buffers that hold so many frames without growing.
    pub fn with_capacity(frames: usize) -> Self {
        Self { sorted: Vec::with_capacity(frames), weights: Vec::with_capacity(frames) }
    }

    /// The robust mean of what frames say, in order, at least one; of fewer than two blocks the sigma is no more than a guess.
    pub fn agreement(&mut self, said: &[Said]) -> Agreement {
        let mut value = self.weighted_median(said.iter().map(|t| (t.x, t.y.recip().sqrt())));
        let mut weights = std::mem::take(&mut self.weights);
        for _ in 0..6 {
            // Beyond the noise of its pixels, each frame errs by what its motion differs from the model.
            let scatter = self.weighted_median(said.iter().map(|t| ((t.x - value).abs(), t.y.recip().sqrt())));
            let common = (1.4826 * scatter).powi(2);
            weights.clear();
            weights.extend(said.iter().map(|t| {
                let variance = t.y + common.max(1e-18);
                let huber = (1.5 * variance.sqrt() / (t.x - value).abs().max(1e-18)).min(1.0);
                huber / variance
            }));
            value = said.iter().zip(&weights).map(|(t, w)| t.x * w).sum::<f64>() / weights.iter().sum::<f64>();
        }
        let blocks = said.chunks(BLOCK).zip(weights.chunks(BLOCK));
        let squares: f64 = blocks.map(|(said, w)| said.iter().zip(w).map(|(t, w)| w * (t.x - value)).sum::<f64>().powi(2)).sum();
        let sigma = squares.sqrt() / weights.iter().sum::<f64>();
        self.weights = weights;
        Agreement { value, sigma, frames: said.len() }
    }

    /// The value below which half of the weight lies; 0 of nothing.
    pub fn weighted_median(&mut self, values: impl Iterator<Item = (f64, f64)>) -> f64 {
        let sorted = &mut self.sorted;
        sorted.clear();
        sorted.extend(values);
        sorted.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        let half = 0.5 * sorted.iter().map(|(_, w)| w).sum::<f64>();
        let mut sum = 0.0;
        let middle = sorted.iter().find(|(_, w)| {
            sum += w;
            sum >= half
        });
        middle.map_or(0.0, |(value, _)| *value)
    }
}

/// The robust mean of what frames say, in order; `None` where fewer than [`MIN_FRAMES`] say something.
pub fn agreement(said: &[Said]) -> Option<Agreement> {
    (said.len() >= MIN_FRAMES).then(|| AgreementBuffers::default().agreement(said))
}

/// The value below which half of the weight lies; 0 of nothing.
pub fn weighted_median(values: impl Iterator<Item = (f64, f64)>) -> f64 {
    AgreementBuffers::default().weighted_median(values)
}
