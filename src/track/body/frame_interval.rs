//! Estimates how often frames come, so that limits on gaps follow from the camera's own rate.
//!
//! Limits in seconds that suit a camera of 30 frames a second would cut off one of 5 between any
//! two of its frames. So where a limit says "the next frame", it uses this interval with some
//! slack.

use crate::frame::Timestamp;
use crate::track::body::tuning::TUNING;

/// Number of intervals remembered; their median is the camera's interval, despite dropped frames.
/// Raised, a change of the rate is noticed later; lowered, two dropped frames pass for one.
const REMEMBERED_INTERVALS: usize = 5;

/// The frame interval according to the last timestamps.
#[derive(Debug, Clone, Default)]
pub struct FrameInterval {
    last: Option<Timestamp>,
    /// Ring buffer of the last intervals, seconds; 0 where there was none yet.
    intervals: [f64; REMEMBERED_INTERVALS],
    next: usize,
}

impl FrameInterval {
    /// Takes the timestamp of the next frame.
    pub fn update(&mut self, timestamp: Timestamp) {
        let Some(before) = self.last.replace(timestamp) else { return };
        let interval = timestamp.seconds_since(before);
        if interval > 0.0 && interval <= TUNING.max_interval_s {
            self.intervals[self.next] = interval;
            self.next = (self.next + 1) % REMEMBERED_INTERVALS;
        }
    }

    /// Returns how long after a frame the next one comes at the latest, seconds; 0 while unknown.
    pub fn to_next_s(&self) -> f64 {
        let mut known = self.intervals;
        known.sort_by(f64::total_cmp);
        let first = known.partition_point(|interval| *interval == 0.0);
        known[first..].get((REMEMBERED_INTERVALS - first) / 2).map_or(0.0, |middle| TUNING.max_jitter_intervals * middle)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn after(stamps_ms: &[i64]) -> f64 {
        let mut interval = FrameInterval::default();
        stamps_ms.iter().for_each(|ms| interval.update(Timestamp::from_ns(ms * 1_000_000)));
        interval.to_next_s()
    }

    #[test]
    fn the_frame_interval_is_the_median() {
        assert_eq!(after(&[]), 0.0);
        assert_eq!(after(&[70]), 0.0);
        assert!((after(&[0, 200]) - 0.25).abs() < 1e-9);
        // One frame is missing, one is late, and the clip was interrupted.
        assert!((after(&[0, 20, 40, 80, 100, 121]) - 0.025).abs() < 1e-9);
        assert!((after(&[0, 200, 400, 9000, 9200]) - 0.25).abs() < 1e-9);
        // Repeated or decreasing timestamps are not intervals.
        assert!((after(&[0, 200, 200, 100, 300]) - 0.25).abs() < 1e-9);
    }
}
