//! Determines when a picture was taken: converts the driver's stamp to mid-exposure of the middle
//! row.
//!
//! Drivers stamp the start of the exposure or the end of the frame; the pipeline uses mid-exposure
//! of the middle row (rows are read out from top to bottom over `readout_s`). The arrival time can
//! be hundreds of milliseconds late, so it is used only if the driver gives no usable stamp.

use std::time::Duration;

use nix::time::{ClockId, clock_gettime};

use crate::camera::Shutter;
use crate::frame::Timestamp;

/// A driver's stamp, on the monotonic clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DriverStamp {
    /// Start of the first row's exposure.
    StartOfExposure(Timestamp),
    /// Time at which the last row had been received.
    EndOfFrame(Timestamp),
    /// Mid-exposure of the middle row: a recorded stamp.
    MidExposure(Timestamp),
    /// The driver gave none.
    None,
}

/// Returns the current time on the monotonic clock, which drivers use for their stamps.
pub fn monotonic_now() -> Timestamp {
    // CLOCK_MONOTONIC cannot fail on Linux. A 0 would make every stamp implausible, which is
    // reported.
    clock_gettime(ClockId::CLOCK_MONOTONIC).map(|t| Timestamp::from_ns(t.tv_sec() * 1_000_000_000 + t.tv_nsec())).unwrap_or_default()
}

/// Maximum age of a delivered picture; an older stamp is taken to be on another clock (chosen: a
/// queue of a few pictures is never that old). Raised, stamps of clocks that differ by seconds are
/// accepted; lowered, those of slow exposures are rejected.
const OLDEST: Duration = Duration::from_secs(5);

/// Returns the time of mid-exposure of the middle row, and whether it comes from the driver's stamp
/// (otherwise it is estimated from the arrival).
///
/// Judges the driver by this one stamp; `StampTrust` also uses earlier ones.
pub fn mid_exposure(stamp: DriverStamp, arrival: Timestamp, shutter: &Shutter) -> (Timestamp, bool) {
    reckoned(stamp, arrival, shutter, OLDEST)
}

/// What earlier stamps have shown about a driver's clock. A process that was stopped receives
/// pictures as old as the stop was long. If the driver's stamps were monotonic before, such old
/// stamps are still accepted, so that the picture does not count as taken when it was read.
#[derive(Debug, Clone, Copy, Default)]
pub struct StampTrust {
    /// How late the driver's stamps and arrivals are, beyond what they say.
    latency: Duration,
    is_monotonic: bool,
    /// Number of consecutive pictures older than the maximum age.
    old: u32,
}

/// Maximum number of consecutive old stamps that are accepted. A driver's queue holds a few
/// pictures; more old stamps mean another clock. Chosen: twice V4L2's maximum of 32 buffers.
/// Raised, a driver that changes its clock is trusted longer.
const MAX_OLD: u32 = 64;

impl StampTrust {
    /// Creates one for a camera whose pictures are stamped late, as behind a capture device. A
    /// recorded stamp is not corrected again.
    pub fn late_by(latency: Duration) -> Self {
        Self { latency, ..Self::default() }
    }

    /// Converts a stamp like [`mid_exposure`], taking earlier stamps and the latency into account.
    pub fn mid_exposure(&mut self, stamp: DriverStamp, arrival: Timestamp, shutter: &Shutter) -> (Timestamp, bool) {
        let (at, is_stamped) = self.as_stamped(stamp, arrival, shutter);
        let is_recorded = matches!(stamp, DriverStamp::MidExposure(_));
        (if is_recorded { at } else { at.before(self.latency) }, is_stamped)
    }

    fn as_stamped(&mut self, stamp: DriverStamp, arrival: Timestamp, shutter: &Shutter) -> (Timestamp, bool) {
        let (DriverStamp::StartOfExposure(at) | DriverStamp::EndOfFrame(at)) = stamp else {
            return mid_exposure(stamp, arrival, shutter);
        };
        let is_young = is_plausible(at, arrival, OLDEST);
        self.is_monotonic = is_young || self.is_monotonic && self.old < MAX_OLD;
        self.old = if is_young { 0 } else { self.old.saturating_add(1) };
        let oldest = if self.is_monotonic { Duration::MAX } else { OLDEST };
        reckoned(stamp, arrival, shutter, oldest)
    }
}

fn reckoned(stamp: DriverStamp, arrival: Timestamp, shutter: &Shutter, oldest: Duration) -> (Timestamp, bool) {
    let half_s = (shutter.exposure_s + shutter.readout_s) * 0.5;
    match stamp {
        DriverStamp::StartOfExposure(at) if is_plausible(at, arrival, oldest) => (at.after_s(half_s), true),
        DriverStamp::EndOfFrame(at) if is_plausible(at, arrival, oldest) => (at.after_s(-half_s), true),
        DriverStamp::MidExposure(at) => (at, true),
        _ => (arrival.after_s(-half_s), false),
    }
}

fn is_plausible(stamp: Timestamp, arrival: Timestamp, oldest: Duration) -> bool {
    stamp > Timestamp::default() && stamp <= arrival && arrival.duration_since(stamp) < oldest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_stamp_overflows() {
        let extremes = [i64::MIN, i64::MIN + 1, -1, 0, 1, i64::MAX - 1, i64::MAX].map(Timestamp::from_ns);
        let shutter = Shutter { exposure_s: 0.04, readout_s: 0.03 };
        for (at, arrival) in extremes.into_iter().flat_map(|at| extremes.map(|arrival| (at, arrival))) {
            for stamp in [DriverStamp::StartOfExposure(at), DriverStamp::EndOfFrame(at), DriverStamp::MidExposure(at), DriverStamp::None] {
                let _ = mid_exposure(stamp, arrival, &shutter);
                let _ = StampTrust::default().mid_exposure(stamp, arrival, &shutter);
            }
        }
    }

    #[test]
    fn both_kinds_of_stamp_yield_the_same_instant() {
        // Exposure 10 ms, readout 20 ms: the first row begins at 0, the last one ends at 30 ms, so
        // mid-exposure of the middle row is at 15 ms.
        let (now, shutter) = (Timestamp::from_seconds(2.0), Shutter { exposure_s: 0.01, readout_s: 0.02 });
        let start = mid_exposure(DriverStamp::StartOfExposure(Timestamp::from_seconds(1.0)), now, &shutter);
        let end = mid_exposure(DriverStamp::EndOfFrame(Timestamp::from_seconds(1.03)), now, &shutter);
        assert_eq!([start, end], [(Timestamp::from_ns(1_015_000_000), true); 2]);
    }

    #[test]
    fn late_stamps_are_corrected_and_recorded_ones_are_not() {
        let (at, now, shutter) = (Timestamp::from_seconds(1.0), Timestamp::from_seconds(2.0), Shutter::default());
        let mut late = StampTrust::late_by(Duration::from_millis(120));
        for (stamp, wanted) in [
            (DriverStamp::StartOfExposure(at), (at.after_s(-0.12), true)),
            (DriverStamp::EndOfFrame(at), (at.after_s(-0.12), true)),
            (DriverStamp::None, (now.after_s(-0.12), false)),
            (DriverStamp::MidExposure(at), (at, true)),
        ] {
            assert_eq!(late.mid_exposure(stamp, now, &shutter), wanted, "{stamp:?}");
        }
    }

    #[test]
    fn a_stamp_from_another_clock_is_not_trusted() {
        let now = Timestamp::from_seconds(15.0);
        for stamp in [0, -5, 9_000_000_000, 20_000_000_000].map(Timestamp::from_ns) {
            assert_eq!(mid_exposure(DriverStamp::StartOfExposure(stamp), now, &Shutter::default()), (now, false), "{stamp}");
        }
        assert_eq!(
            mid_exposure(DriverStamp::None, now, &Shutter { exposure_s: 0.01, readout_s: 0.03 }),
            (now.after_ns(-20_000_000), false)
        );
    }

    #[test]
    fn a_trusted_driver_may_deliver_old_frames_after_a_pause() {
        let mut trust = StampTrust::default();
        let mut at = |stamp, now| {
            let stamp = DriverStamp::StartOfExposure(Timestamp::from_ns(stamp));
            let (at, is_stamped) = trust.mid_exposure(stamp, Timestamp::from_ns(now), &Shutter::default());
            (at.ns(), is_stamped)
        };
        assert_eq!(at(99_000_000_000, 99_030_000_000), (99_000_000_000, true));
        // Stopped for a minute: the queue holds what was taken when the stop began.
        assert_eq!(at(99_033_000_000, 159_000_000_000), (99_033_000_000, true));
        assert_eq!(at(159_010_000_000, 159_040_000_000), (159_010_000_000, true));
        // A clock that has changed for good is not trusted for ever.
        let believed = (0..200).filter(|k| at(5_000_000_000 + k, 200_000_000_000).1).count();
        assert!((1..=64).contains(&believed), "{believed}");
        assert_eq!(at(5_000_000_500, 200_000_000_000), (200_000_000_000, false));
        // A stamp in the future is never trusted.
        let [now, future] = [5, 9].map(Timestamp::from_ns);
        assert_eq!(StampTrust::default().mid_exposure(DriverStamp::EndOfFrame(future), now, &Shutter::default()), (now, false));
    }

    #[test]
    fn the_monotonic_clock_never_goes_back() {
        let first = monotonic_now();
        assert!(first > Timestamp::default() && monotonic_now() >= first);
    }
}
