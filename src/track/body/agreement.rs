//! Robust mean of what many frames say about one quantity, when some of them are wrong. Used for
//! the readout time.

use crate::track::body::tuning::TUNING;
use nalgebra::Vector2;

/// What one frame says: a value, and its variance due to the frame's noise.
pub type FrameValue = Vector2<f64>;

/// What many frames agree on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Agreement {
    /// The robust mean.
    pub value: f64,
    /// One standard deviation, from the frames' disagreement.
    pub sigma: f64,
    /// Number of frames.
    pub frames: usize,
}

/// Buffers of the computation.
#[derive(Debug, Clone, Default)]
pub struct AgreementBuffers {
    sorted: Vec<(f64, f64)>,
    weights: Vec<f64>,
}

impl AgreementBuffers {
    /// Creates buffers that hold this many frames without growing.
    pub fn with_capacity(frames: usize) -> Self {
        Self { sorted: Vec::with_capacity(frames), weights: Vec::with_capacity(frames) }
    }

    /// Returns the robust mean (Huber weights) of what frames say; `values`: in order, at least
    /// one. With fewer than two blocks, sigma is only a guess.
    pub fn agreement(&mut self, values: &[FrameValue]) -> Agreement {
        let mut value = self.weighted_median(values.iter().map(|t| (t.x, t.y.recip().sqrt())));
        let mut weights = std::mem::take(&mut self.weights);
        for _ in 0..6 {
            // Besides pixel noise, each frame errs where its motion differs from the model; that
            // scatter is common to all.
            let scatter = self.weighted_median(values.iter().map(|t| ((t.x - value).abs(), t.y.recip().sqrt())));
            let common = (1.4826 * scatter).powi(2);
            weights.clear();
            weights.extend(values.iter().map(|t| {
                let variance = t.y + common.max(1e-18);
                let huber = (1.5 * variance.sqrt() / (t.x - value).abs().max(1e-18)).min(1.0);
                huber / variance
            }));
            value = values.iter().zip(&weights).map(|(t, w)| t.x * w).sum::<f64>() / weights.iter().sum::<f64>();
        }
        let blocks = values.chunks(TUNING.agreement_block_frames).zip(weights.chunks(TUNING.agreement_block_frames));
        let squares: f64 = blocks.map(|(values, w)| values.iter().zip(w).map(|(t, w)| w * (t.x - value)).sum::<f64>().powi(2)).sum();
        let sigma = squares.sqrt() / weights.iter().sum::<f64>();
        self.weights = weights;
        Agreement { value, sigma, frames: values.len() }
    }

    /// Returns the weighted median of (value, weight) pairs; 0 if there are none.
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
