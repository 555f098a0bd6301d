//! A frame: one grey picture from a camera, with its time stamp and its sequence number.

use std::fmt;
use std::time::Duration;

use image::GrayImage;
use serde::{Deserialize, Serialize};

/// One picture to track.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Frame {
    /// Grey levels 0..=255, row-major, raw (distorted) pixels; pixel centres at integers.
    pub image: GrayImage,
    /// When the middle row was at mid-exposure.
    pub timestamp: Timestamp,
    /// Row number in the clip, or frame number of the device, from 0.
    pub sequence: u64,
}

impl Frame {
    /// Creates a frame from a picture, its stamp and its number.
    pub fn new(image: GrayImage, timestamp: Timestamp, sequence: u64) -> Self {
        Self { image, timestamp, sequence }
    }
}

/// An instant in whole nanoseconds on some clock: a camera's, a clip's, or one of the machine's.
/// Only instants of the same clock are comparable. Stamps come from outside and may be any number,
/// so all arithmetic saturates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Timestamp(i64);

impl Timestamp {
    /// The earliest representable instant.
    pub const MIN: Self = Self(i64::MIN);

    /// Creates the instant `ns` nanoseconds after the clock's zero.
    pub const fn from_ns(ns: i64) -> Self {
        Self(ns)
    }

    /// Creates the instant `seconds` after the clock's zero, rounded to the nearest nanosecond.
    pub fn from_seconds(seconds: f64) -> Self {
        Self::default().after_s(seconds)
    }

    /// Returns nanoseconds since the clock's zero.
    pub const fn ns(self) -> i64 {
        self.0
    }

    /// Returns seconds since the clock's zero.
    pub fn seconds(self) -> f64 {
        self.0 as f64 * 1e-9
    }

    /// Formats seconds with nine decimals, as in TUM trajectories. Uses integer arithmetic, so that
    /// large stamps keep their nanoseconds.
    pub fn decimal_seconds(self) -> String {
        let ns = self.0.unsigned_abs();
        format!("{}{}.{:09}", if self.0 < 0 { "-" } else { "" }, ns / 1_000_000_000, ns % 1_000_000_000)
    }

    /// Returns nanoseconds from an earlier instant to this one; negative if `earlier` is later.
    pub const fn ns_since(self, earlier: Self) -> i64 {
        self.0.saturating_sub(earlier.0)
    }

    /// Returns seconds from an earlier instant to this one; negative if `earlier` is later.
    pub fn seconds_since(self, earlier: Self) -> f64 {
        self.ns_since(earlier) as f64 * 1e-9
    }

    /// Returns milliseconds from an earlier instant to this one; negative if `earlier` is later.
    pub fn ms_since(self, earlier: Self) -> f64 {
        self.ns_since(earlier) as f64 * 1e-6
    }

    /// Returns the time from an earlier instant to this one; zero if `earlier` is later.
    pub fn duration_since(self, earlier: Self) -> Duration {
        Duration::from_nanos(self.ns_since(earlier).max(0).unsigned_abs())
    }

    /// Returns the instant `ns` nanoseconds later.
    pub const fn after_ns(self, ns: i64) -> Self {
        Self(self.0.saturating_add(ns))
    }

    /// Returns the instant `duration` later.
    pub fn after(self, duration: Duration) -> Self {
        self.after_ns(i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX))
    }

    /// Returns the instant `duration` earlier.
    pub fn before(self, duration: Duration) -> Self {
        self.after_ns(-i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX))
    }

    /// Returns the instant `seconds` later, rounded to the nearest nanosecond.
    pub fn after_s(self, seconds: f64) -> Self {
        self.after_ns((seconds * 1e9).round() as i64)
    }
}

/// Writes whole nanoseconds.
impl fmt::Display for Timestamp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MAX: Timestamp = Timestamp::from_ns(i64::MAX);
    const INSTANT: Duration = Duration::from_nanos(1);

    #[test]
    fn arithmetic_saturates() {
        assert_eq!(MAX.ns_since(Timestamp::MIN), i64::MAX);
        assert_eq!(Timestamp::MIN.ns_since(MAX), i64::MIN);
        assert_eq!(Timestamp::MIN.seconds_since(MAX), i64::MIN as f64 * 1e-9);
        assert_eq!(MAX.duration_since(Timestamp::MIN), Duration::from_nanos(i64::MAX.unsigned_abs()));
        assert_eq!(Timestamp::MIN.duration_since(MAX), Duration::ZERO);
        assert_eq!((MAX.after_ns(1), Timestamp::MIN.after_ns(-1)), (MAX, Timestamp::MIN));
        assert_eq!((MAX.after(INSTANT), Timestamp::MIN.before(INSTANT)), (MAX, Timestamp::MIN));
        assert_eq!((Timestamp::MIN.after(Duration::MAX), MAX.before(Duration::MAX)), (Timestamp::from_ns(-1), Timestamp::default()));
        assert_eq!([f64::INFINITY, f64::NEG_INFINITY, f64::NAN].map(Timestamp::from_seconds), [MAX, Timestamp::MIN, Timestamp::default()]);
    }

    #[test]
    fn seconds_are_rounded_to_the_nanosecond() {
        assert_eq!(Timestamp::from_seconds(4.1), Timestamp::from_ns(4_100_000_000));
        assert_eq!(Timestamp::from_ns(5).after_s(-3.6e-9), Timestamp::from_ns(1));
        assert_eq!(Timestamp::from_ns(2_500_000_000).seconds(), 2.5);
        assert_eq!(
            [5, -5, i64::MIN].map(|ns| Timestamp::from_ns(ns).decimal_seconds()),
            ["0.000000005", "-0.000000005", "-9223372036.854775808"]
        );
    }

    #[test]
    fn timestamps_are_written_as_whole_nanoseconds() {
        for stamp in [MAX, Timestamp::MIN, Timestamp::default(), Timestamp::from_ns(-33_333_333)] {
            assert_eq!(stamp.to_string(), stamp.ns().to_string());
            assert_eq!(serde_json::to_string(&stamp).unwrap(), stamp.ns().to_string());
        }
    }
}
