//! A lock-free histogram of times, written by many threads and read by one.

use std::sync::atomic::{AtomicU64, Ordering};

/// Upper edges of the buckets, seconds: from a kernel's time to a lost camera's, densest around a
/// frame time. Chosen; more edges resolve times better and make the metrics longer.
pub(super) const EDGES_S: [f64; 14] = [0.001, 0.002, 0.005, 0.01, 0.015, 0.02, 0.03, 0.04, 0.06, 0.1, 0.2, 0.5, 1.0, 2.0];

/// Counts of times by bucket; the last bucket has no upper edge.
#[derive(Debug, Default)]
pub struct Histogram {
    counts: [AtomicU64; EDGES_S.len() + 1],
    sum_us: AtomicU64,
}

impl Histogram {
    /// Counts a time, milliseconds; a non-finite or negative one counts as 0.
    pub fn observe_ms(&self, ms: f64) {
        let s = if ms.is_finite() { ms.max(0.0) * 1e-3 } else { 0.0 };
        let bucket = EDGES_S.iter().position(|edge| s <= *edge).unwrap_or(EDGES_S.len());
        self.counts[bucket].fetch_add(1, Ordering::Relaxed);
        self.sum_us.fetch_add((s * 1e6).round() as u64, Ordering::Relaxed);
    }

    /// Returns how many times are at most each edge, then the total.
    pub(super) fn cumulative(&self) -> [u64; EDGES_S.len() + 1] {
        let mut total = 0;
        self.counts.each_ref().map(|count| {
            total += count.load(Ordering::Relaxed);
            total
        })
    }

    /// Returns the sum of all times, seconds.
    pub fn sum_s(&self) -> f64 {
        self.sum_us.load(Ordering::Relaxed) as f64 / 1e6
    }

    /// Returns the mean of all times, seconds; `None` before the first.
    pub fn mean_s(&self) -> Option<f64> {
        let count = self.count();
        (count > 0).then(|| self.sum_s() / count as f64)
    }

    /// Returns how many times were counted.
    pub fn count(&self) -> u64 {
        self.cumulative()[EDGES_S.len()]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_fall_into_their_buckets() {
        let histogram = Histogram::default();
        [0.5, 1.0, 1.001, 33.0, 99_999.0, f64::NAN].iter().for_each(|ms| histogram.observe_ms(*ms));
        let counts = histogram.cumulative();
        assert_eq!((counts[0], counts[1], counts[6], counts[7], counts[13], counts[14]), (3, 4, 4, 5, 5, 6));
        assert_eq!((histogram.count(), Histogram::default().mean_s()), (6, None));
        assert!((histogram.mean_s().unwrap() - 100.034_501 / 6.0).abs() < 1e-6);
        assert!((histogram.sum_s() - 100.034_501).abs() < 1e-6);
    }
}
