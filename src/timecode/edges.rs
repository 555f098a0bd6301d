//! Where the sound of a timecode changes its sign.
//!
//! The signal is smoothed, and compared with the middle of its own range, so that a constant offset
//! does not matter. An edge counts once the signal has left the middle far enough; it lies where it
//! crossed the middle.

/// Time over which the range forgets, seconds. A bit lasts at most 1.04 ms (24 frames per second at
/// half speed). Raised, a signal that becomes weaker is found later; lowered, noise moves the
/// middle.
const FORGET_S: f64 = 0.02;
/// Fraction of the range's half by which the signal must leave the middle to count as an edge.
/// Measured on generated timecode with noise of 20 dB below it. Raised, weak edges are missed;
/// lowered, noise makes edges.
const HYSTERESIS: f32 = 0.3;
/// Minimum range of a signal, as a fraction of full scale: 54 dB below it. Lowered, the hiss of an
/// open input is searched for timecode.
const MIN_RANGE: f32 = 0.004;
/// Smoothing, as a fraction of the shortest half bit (30 frames per second at 1.5 times the speed).
/// Raised, edges lose their height; lowered, noise stays.
const SMOOTHING: f64 = 0.6;
/// Half bits per second at 30 frames per second and 1.5 times the speed.
const MAX_HALF_BITS_HZ: f64 = 30.0 * 1.5 * 160.0;

/// Finds edges in samples.
#[derive(Debug)]
pub(super) struct EdgeFinder {
    smoothing: Vec<f32>,
    next: usize,
    high: f32,
    low: f32,
    /// Fraction of the range that is forgotten per sample.
    forget: f32,
    is_high: bool,
    before: f32,
    samples: u64,
    crossing: f64,
}

impl EdgeFinder {
    /// Starts on samples of this rate, per second.
    pub fn new(sample_rate: f64) -> Self {
        let length = (SMOOTHING * sample_rate / MAX_HALF_BITS_HZ).round().max(1.0) as usize;
        let forget = (1.0 / (FORGET_S * sample_rate)) as f32;
        Self { smoothing: vec![0.0; length], next: 0, high: 0.0, low: 0.0, forget, is_high: false, before: 0.0, samples: 0, crossing: 0.0 }
    }

    /// Adds a sample; returns the place of an edge that it completes, in samples since the first.
    pub fn push(&mut self, sample: f32) -> Option<f64> {
        let length = self.smoothing.len();
        self.smoothing[self.next] = if sample.is_finite() { sample.clamp(-1.0, 1.0) } else { 0.0 };
        self.next = (self.next + 1) % length;
        let value = self.smoothing.iter().sum::<f32>() / length as f32;
        let range = self.high - self.low;
        self.high = (self.high - range * self.forget).max(value);
        self.low = (self.low + range * self.forget).min(value);
        let (middle, half) = (0.5 * (self.high + self.low), 0.5 * (self.high - self.low));
        // The smoothed value stands for the middle of its samples.
        let at = self.samples as f64 - 0.5 * (length - 1) as f64;
        let (left, right) = (self.before - middle, value - middle);
        if (left < 0.0) != (right < 0.0) {
            self.crossing = at - 1.0 + f64::from(left / (left - right));
        }
        self.before = value;
        self.samples += 1;
        let is_edge = half > MIN_RANGE && if self.is_high { right < -HYSTERESIS * half } else { right > HYSTERESIS * half };
        if is_edge {
            self.is_high = !self.is_high;
        }
        is_edge.then_some(self.crossing)
    }
}
