//! When a picture was taken: from the driver's stamp to the middle of the exposure of the middle row.
//!
//! Drivers stamp the start of the exposure or the end of the frame; the pipeline speaks of the middle row at
//! mid-exposure (rows are read out from top to bottom over `readout_s`). The time of reading is hundreds of
//! milliseconds late at worst, and taken only where a driver gives nothing else.

use nix::time::{ClockId, clock_gettime};

/// A driver's stamp, monotonic nanoseconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DriverStamp {
    /// When the exposure of the first row began.
    StartOfExposure(i64),
    /// When the last row had been received.
    EndOfFrame(i64),
    /// When the middle row was at mid-exposure: a recorded stamp.
    MidExposure(i64),
    /// The driver gave none.
    None,
}

/// Monotonic nanoseconds now, on the clock that drivers stamp with.
pub fn monotonic_ns() -> i64 {
    // CLOCK_MONOTONIC cannot fail on Linux; 0 would make every stamp implausible, which is said.
    clock_gettime(ClockId::CLOCK_MONOTONIC).map_or(0, |t| t.tv_sec() * 1_000_000_000 + t.tv_nsec())
}

/// Oldest picture that a driver may hand out, nanoseconds; a stamp beyond it is on another clock.
const OLDEST_NS: i64 = 5_000_000_000;

/// When the middle row was at mid-exposure, and whether the driver's stamp says it (else it is reckoned from the arrival).
///
/// `exposure_s` and `readout_s` are 0 where unknown. A driver that was never heard before is judged by this one stamp; see
/// `StampTrust` for one that was.
pub fn mid_exposure_ns(stamp: DriverStamp, arrival_ns: i64, exposure_s: f64, readout_s: f64) -> (i64, bool) {
    reckoned(stamp, arrival_ns, exposure_s, readout_s, OLDEST_NS)
}

/// What is known of a driver's stamps. A program that was stopped gets pictures that are as old as its stop was long: a driver whose stamps
/// were of the monotonic clock is believed that, and its picture does not count as taken when it was read.
#[derive(Debug, Clone, Copy, Default)]
pub struct StampTrust {
    is_monotonic: bool,
    /// Pictures in a row that were older than a driver may hand out.
    old: u32,
}

/// A driver's queue is a few pictures long; more that are too old in a row are of another clock after all.
const MOST_OLD: u32 = 64;

impl StampTrust {
    /// As [`mid_exposure_ns`], by what earlier stamps have shown.
    pub fn mid_exposure_ns(&mut self, stamp: DriverStamp, arrival_ns: i64, exposure_s: f64, readout_s: f64) -> (i64, bool) {
        let (DriverStamp::StartOfExposure(at) | DriverStamp::EndOfFrame(at)) = stamp else {
            return mid_exposure_ns(stamp, arrival_ns, exposure_s, readout_s);
        };
        let is_young = at > 0 && at <= arrival_ns && arrival_ns.saturating_sub(at) < OLDEST_NS;
        self.is_monotonic = is_young || self.is_monotonic && self.old < MOST_OLD;
        self.old = if is_young { 0 } else { self.old.saturating_add(1) };
        let oldest_ns = if self.is_monotonic { i64::MAX } else { OLDEST_NS };
        reckoned(stamp, arrival_ns, exposure_s, readout_s, oldest_ns)
    }
}

fn reckoned(stamp: DriverStamp, arrival_ns: i64, exposure_s: f64, readout_s: f64, oldest_ns: i64) -> (i64, bool) {
    let half_ns = ((exposure_s + readout_s) * 0.5e9).round() as i64;
    let plausible = |at: i64| at <= arrival_ns && arrival_ns.saturating_sub(at) < oldest_ns && at > 0;
    match stamp {
        DriverStamp::StartOfExposure(at) if plausible(at) => (at.saturating_add(half_ns), true),
        DriverStamp::EndOfFrame(at) if plausible(at) => (at.saturating_sub(half_ns), true),
        DriverStamp::MidExposure(at) => (at, true),
        _ => (arrival_ns.saturating_sub(half_ns), false),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_stamp_overflows() {
        let extremes = [i64::MIN, i64::MIN + 1, -1, 0, 1, i64::MAX - 1, i64::MAX];
        for (at, arrival_ns) in extremes.into_iter().flat_map(|at| extremes.map(|arrival| (at, arrival))) {
            for stamp in [DriverStamp::StartOfExposure(at), DriverStamp::EndOfFrame(at), DriverStamp::MidExposure(at), DriverStamp::None] {
                let _ = mid_exposure_ns(stamp, arrival_ns, 0.04, 0.03);
                let _ = StampTrust::default().mid_exposure_ns(stamp, arrival_ns, 0.04, 0.03);
            }
        }
    }

    #[test]
    fn both_kinds_of_stamp_lead_to_the_same_moment() {
        // Exposure 10 ms, readout 20 ms: the first row begins at 0, the last one ends at 30 ms, the middle of both is at 15 ms.
        let (now, exposure_s, readout_s) = (2_000_000_000, 0.01, 0.02);
        let start = mid_exposure_ns(DriverStamp::StartOfExposure(1_000_000_000), now, exposure_s, readout_s);
        let end = mid_exposure_ns(DriverStamp::EndOfFrame(1_030_000_000), now, exposure_s, readout_s);
        assert_eq!((start, end), ((1_015_000_000, true), (1_015_000_000, true)));
    }

    #[test]
    fn a_stamp_of_another_clock_is_no_stamp() {
        for stamp in [0, -5, 9_000_000_000, 20_000_000_000] {
            assert_eq!(mid_exposure_ns(DriverStamp::StartOfExposure(stamp), 15_000_000_000, 0.0, 0.0), (15_000_000_000, false), "{stamp}");
        }
        assert_eq!(mid_exposure_ns(DriverStamp::None, 15_000_000_000, 0.01, 0.03), (14_980_000_000, false));
    }

    #[test]
    fn a_trusted_driver_may_hand_out_what_was_taken_before_a_long_stop() {
        let mut trust = StampTrust::default();
        let mut at = |stamp, now| trust.mid_exposure_ns(DriverStamp::StartOfExposure(stamp), now, 0.0, 0.0);
        assert_eq!(at(99_000_000_000, 99_030_000_000), (99_000_000_000, true));
        // Stopped for a minute; the queue holds what was taken when it began.
        assert_eq!(at(99_033_000_000, 159_000_000_000), (99_033_000_000, true));
        assert_eq!(at(159_010_000_000, 159_040_000_000), (159_010_000_000, true));
        // A clock that is another one from now on is not believed for ever.
        let believed = (0..200).filter(|k| at(5_000_000_000 + k, 200_000_000_000).1).count();
        assert!((1..=64).contains(&believed), "{believed}");
        assert_eq!(at(5_000_000_500, 200_000_000_000), (200_000_000_000, false));
        // A stamp of the future never is.
        assert_eq!(StampTrust::default().mid_exposure_ns(DriverStamp::EndOfFrame(9), 5, 0.0, 0.0), (5, false));
    }

    #[test]
    fn the_clock_runs() {
        let first = monotonic_ns();
        assert!(first > 0 && monotonic_ns() >= first);
    }
}
