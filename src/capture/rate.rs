//! Frame rates as exact ratios, and the stamps derived from them.

use crate::frame::Timestamp;

/// Frames per second, as a ratio.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameRate {
    frames: f64,
    seconds: f64,
}

impl FrameRate {
    /// Creates a rate of `frames` in `seconds`; `None` unless it is above 0 and at most a million
    /// per second.
    pub fn new(frames: f64, seconds: f64) -> Option<Self> {
        let fps = frames / seconds;
        (frames > 0.0 && seconds > 0.0 && fps > 0.0 && fps <= 1e6).then_some(Self { frames, seconds })
    }

    /// Parses a ratio: "30000:1001".
    pub fn from_ratio(text: &str) -> Option<Self> {
        let (frames, seconds) = text.split_once([':', '/'])?;
        Self::new(f64::from(frames.parse::<u32>().ok()?), f64::from(seconds.parse::<u32>().ok()?))
    }

    /// Returns the time of frame `n`, rounded to nanoseconds, if frame 0 is at 0.
    pub fn stamp(&self, n: u64) -> Timestamp {
        Timestamp::from_ns((n as f64 * 1e9 * self.seconds / self.frames).round() as i64)
    }
}

impl std::fmt::Display for FrameRate {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.frames / self.seconds)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_are_rounded_and_do_not_drift() {
        let ntsc = FrameRate::from_ratio("30000:1001").unwrap();
        assert_eq!([0, 1, 2, 30_000].map(|n| ntsc.stamp(n).ns()), [0, 33_366_667, 66_733_333, 1_001_000_000_000]);
        assert_eq!(FrameRate::new(30.0, 1.0).unwrap().stamp(12), Timestamp::from_seconds(0.4));
    }

    #[test]
    fn invalid_rates_return_none() {
        assert!(["0:0", "0:1", "30", "a:b", "-1:1"].iter().all(|r| FrameRate::from_ratio(r).is_none()));
        assert!([f64::NAN, 0.0, -30.0, f64::INFINITY, 2e6].iter().all(|fps| FrameRate::new(*fps, 1.0).is_none()));
    }
}
