//! When a sample was made, from when it arrived.
//!
//! Samples arrive in pieces, late by the time that they waited in buffers. The piece that waited
//! least tells most: the mapping from sample numbers to the clock is the earliest that the last
//! seconds allow.

use std::collections::VecDeque;

use crate::frame::Timestamp;

/// Time over which the earliest mapping is sought, seconds. Two clocks differ by up to 100 ppm, so
/// it is off by up to 1 ms at its end. Raised, the clocks' difference shows; lowered, the buffers'.
const WINDOW_S: f64 = 10.0;
/// Time over which samples may be late before they count as lost, seconds. Raised, lost samples
/// shift the timecode for longer.
const SETTLED_S: f64 = 1.0;
/// How much later the mapping of the last second may lie than that of the window, nanoseconds:
/// more than buffers are late. Beyond, samples were lost.
const MAX_LATE_NS: i64 = 20_000_000;
/// How much earlier the mapping may become, nanoseconds, before samples come faster than they can
/// be made: more than a pipe holds (65536 bytes of one channel at 44.1 kHz).
const MAX_EARLY_NS: i64 = 1_000_000_000;

/// Maps sample numbers to the clock of arrivals.
#[derive(Debug)]
pub(super) struct Arrival {
    sample_s: f64,
    /// When each piece arrived, and when its sample 0 would have been made at the latest.
    pieces: VecDeque<(Timestamp, Timestamp)>,
    first: Option<Timestamp>,
    is_too_fast: bool,
}

impl Arrival {
    /// Starts at sample 0 of this many per second.
    pub fn new(sample_rate: u32) -> Self {
        Self { sample_s: 1.0 / f64::from(sample_rate), pieces: VecDeque::new(), first: None, is_too_fast: false }
    }

    /// Notes that `count` samples in all have arrived. Returns true once if they come faster than
    /// their rate.
    pub fn arrived(&mut self, count: u64, now: Timestamp) -> bool {
        let zero = now.after_s(-(count as f64) * self.sample_s);
        while self.pieces.front().is_some_and(|(arrived, _)| now.seconds_since(*arrived) > WINDOW_S) {
            self.pieces.pop_front();
        }
        self.pieces.push_back((now, zero));
        let recent = self.pieces.iter().rev().take_while(|(arrived, _)| now.seconds_since(*arrived) <= SETTLED_S);
        let (recent, has_settled) = (recent.map(|(_, zero)| *zero).min(), self.pieces.front().map(|(at, _)| now.seconds_since(*at)));
        if has_settled.is_some_and(|s| s > SETTLED_S) && recent.is_some_and(|recent| recent.ns_since(self.zero()) > MAX_LATE_NS) {
            self.pieces.retain(|(arrived, _)| now.seconds_since(*arrived) <= SETTLED_S);
        }
        let first = *self.first.get_or_insert(zero);
        let is_too_fast = first.ns_since(zero) > MAX_EARLY_NS;
        is_too_fast && !std::mem::replace(&mut self.is_too_fast, true)
    }

    fn zero(&self) -> Timestamp {
        self.pieces.iter().map(|(_, zero)| *zero).min().unwrap_or_default()
    }

    /// Returns when a sample was made, counted from 0.
    pub fn at(&self, sample: f64) -> Timestamp {
        self.zero().after_s(sample * self.sample_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at_s(s: f64) -> Timestamp {
        Timestamp::from_seconds(s)
    }

    #[test]
    fn buffers_that_are_late_at_random_shift_nothing() {
        let mut arrival = Arrival::new(48_000);
        // A piece every 20 ms, up to 15 ms late; the sound card runs 80 ppm fast.
        for k in 1..2_000_u64 {
            let late_s = 0.001 * (k * 7 % 16) as f64;
            assert!(!arrival.arrived(k * 960, at_s(5.0 + k as f64 * 0.02 * (1.0 - 80e-6) + late_s)));
            let error_s = arrival.at(k as f64 * 960.0).seconds_since(at_s(5.0 + k as f64 * 0.02 * (1.0 - 80e-6)));
            assert!(k < 16 || error_s.abs() < 0.001, "{k}: {error_s}");
        }
    }

    #[test]
    fn lost_samples_are_noticed_within_a_second() {
        let mut arrival = Arrival::new(48_000);
        let lost_s = |k: u64| if k > 1_000 { 0.3 } else { 0.0 };
        for k in 1..1_200_u64 {
            arrival.arrived(k * 960, at_s(k as f64 * 0.02 + lost_s(k)));
        }
        assert!((arrival.at(1_199.0 * 960.0).seconds_since(at_s(1_199.0 * 0.02 + 0.3))).abs() < 1e-6);
    }

    #[test]
    fn a_file_that_is_poured_into_a_pipe_is_noticed_once() {
        let mut arrival = Arrival::new(48_000);
        let noticed = (1..200_u64).filter(|k| arrival.arrived(k * 4_096, at_s(*k as f64 * 1e-4))).count();
        assert_eq!(noticed, 1);
    }
}
