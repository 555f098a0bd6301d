//! Which instants stamps are: on this machine's monotonic clock, and in Unix time.

use std::sync::{Arc, OnceLock};

use nix::time::{ClockId, clock_gettime};

/// Where a source's stamps come from.
#[derive(Debug, Clone)]
pub enum Stamps {
    /// A camera on this machine: nanoseconds of CLOCK_MONOTONIC.
    Live,
    /// A clip: nanoseconds since anything. The clip is sent as if its first frame had been taken when the clip began.
    Recorded(ClipStart),
}

/// When a clip began to be played. Whoever plays it says so; failing that it is when the work on its first frame began.
#[derive(Debug, Clone, Default)]
pub struct ClipStart {
    /// Monotonic clock minus stamp, nanoseconds.
    offset_ns: Arc<OnceLock<i64>>,
}

impl ClipStart {
    /// The frame of this stamp is handed out now. Only the first call counts.
    pub fn begin(&self, stamp_ns: i64) {
        self.offset_ns.get_or_init(|| now().monotonic_ns.saturating_sub(stamp_ns));
    }
}

/// An instant on both clocks, nanoseconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Instants {
    pub monotonic_ns: i64,
    pub unix_ns: i64,
}

/// Now, on both clocks.
pub(super) fn now() -> Instants {
    Instants { monotonic_ns: read(ClockId::CLOCK_MONOTONIC), unix_ns: read(ClockId::CLOCK_REALTIME) }
}

fn read(clock: ClockId) -> i64 {
    // Linux has both clocks always; where one fails, 0 is a stamp like any other.
    clock_gettime(clock).map_or(0, |t| t.tv_sec() * 1_000_000_000 + t.tv_nsec())
}

/// Turns stamps into instants.
#[derive(Debug, Clone)]
pub(super) struct StampClock {
    stamps: Stamps,
    /// Monotonic clock minus stamp; of a clip known from the first stamp on.
    offset_ns: Option<i64>,
}

/// A live stamp further from now than this is not of this machine's monotonic clock.
const PLAUSIBLE_NS: i64 = 10_000_000_000;

impl StampClock {
    pub fn new(stamps: Stamps) -> Self {
        let offset_ns = matches!(stamps, Stamps::Live).then_some(0);
        Self { stamps, offset_ns }
    }

    /// The instant of a stamp; `work_ns` is how long this first sample has been worked on.
    pub fn instants(&mut self, stamp_ns: i64, work_ns: i64, now: Instants) -> Instants {
        let is_live = matches!(self.stamps, Stamps::Live);
        if is_live && (now.monotonic_ns.saturating_sub(stamp_ns)).abs() > PLAUSIBLE_NS && self.offset_ns == Some(0) {
            tracing::warn!(
                "the camera's stamps are not of the monotonic clock; ages and times of day count from the first frame's arrival"
            );
            self.offset_ns = None;
        }
        let begun = match &self.stamps {
            Stamps::Recorded(start) => start.offset_ns.get().copied(),
            Stamps::Live => None,
        };
        let at_first = now.monotonic_ns.saturating_sub(work_ns).saturating_sub(stamp_ns);
        let offset = *self.offset_ns.get_or_insert(begun.unwrap_or(at_first));
        let monotonic_ns = stamp_ns.saturating_add(offset);
        let age = now.monotonic_ns.saturating_sub(monotonic_ns);
        Instants { monotonic_ns, unix_ns: now.unix_ns.saturating_sub(age) }
    }

    /// The stamp as a clip has it, for formats that want both.
    pub fn recorded(&self, stamp_ns: i64) -> Option<i64> {
        matches!(self.stamps, Stamps::Recorded(_)).then_some(stamp_ns)
    }
}

/// Frames per second, from the stamps as they come.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Pace {
    last_ns: Option<i64>,
    mean_s: Option<f64>,
}

/// Rates that cameras have; a measured one near them is meant to be them.
const USUAL_HZ: [f64; 9] = [15.0, 24.0, 25.0, 30.0, 50.0, 60.0, 90.0, 120.0, 240.0];

impl Pace {
    /// Takes the next stamp and gives the frames per second so far.
    pub fn rate_hz(&mut self, stamp_ns: i64) -> Option<f64> {
        if let Some(last_ns) = self.last_ns.replace(stamp_ns)
            && stamp_ns > last_ns
        {
            let step_s = stamp_ns.saturating_sub(last_ns) as f64 * 1e-9;
            // A dropped frame makes one long step; it fades.
            self.mean_s = Some(self.mean_s.map_or(step_s, |mean| mean + 0.05 * (step_s - mean)));
        }
        let hz = 1.0 / self.mean_s?;
        let usual = USUAL_HZ.into_iter().find(|usual| (hz / usual - 1.0).abs() < 0.02);
        Some(usual.unwrap_or((hz * 10.0).round() / 10.0).clamp(0.1, 1e4))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_become_times_of_day() {
        let now = Instants { monotonic_ns: 50_000_000_000, unix_ns: 1_700_000_000_000_000_000 };
        let mut live = StampClock::new(Stamps::Live);
        let at = live.instants(49_960_000_000, 0, now);
        assert_eq!(at, Instants { monotonic_ns: 49_960_000_000, unix_ns: 1_699_999_999_960_000_000 });
        assert_eq!(live.recorded(5), None);

        let mut clip = StampClock::new(Stamps::Recorded(ClipStart::default()));
        assert_eq!(clip.instants(7_000, 1_000, now).monotonic_ns, 49_999_999_000);
        assert_eq!(clip.instants(8_000, 9_000, now).monotonic_ns, 50_000_000_000);
        assert_eq!(clip.recorded(8_000), Some(8_000));
    }

    #[test]
    fn a_played_clip_counts_from_when_its_first_frame_was_handed_out() {
        let start = ClipStart::default();
        let begun = now().monotonic_ns;
        start.begin(7_000);
        start.begin(1_000_000_000);
        let mut clip = StampClock::new(Stamps::Recorded(start));
        // The first sample comes two seconds later: it is that old.
        let late = Instants { monotonic_ns: begun + 2_000_000_000, unix_ns: 0 };
        let age = late.monotonic_ns - clip.instants(7_000, 0, late).monotonic_ns;
        assert!((1_900_000_000..=2_000_000_000).contains(&age), "{age}");
    }

    #[test]
    fn the_pace_is_that_of_the_stamps() {
        let mut pace = Pace::default();
        assert_eq!(pace.rate_hz(0), None);
        let mut last = None;
        for k in 1..50_i64 {
            last = pace.rate_hz(k * 16_683_350);
        }
        assert_eq!(last, Some(60.0));
        assert_eq!(pace.rate_hz(49 * 16_683_350), Some(60.0), "a stamp that does not rise says nothing");
    }

    #[test]
    fn a_camera_with_a_clock_of_its_own_is_noticed() {
        let now = Instants { monotonic_ns: 50_000_000_000, unix_ns: 1_700_000_000_000_000_000 };
        let mut live = StampClock::new(Stamps::Live);
        assert_eq!(live.instants(i64::MAX / 2, 0, now).monotonic_ns, now.monotonic_ns);
    }
}
