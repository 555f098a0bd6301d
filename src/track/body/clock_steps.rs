//! The tracker's own time, which never runs backwards even if the clock of a clip or a camera is
//! set back.

use crate::frame::Timestamp;
use crate::track::body::tuning::TUNING;

/// The offset between timestamps and the tracker's own time.
#[derive(Debug, Default)]
pub(in crate::track) struct ClockSteps {
    shift_ns: i64,
    last: Option<Timestamp>,
}

impl ClockSteps {
    /// Converts a timestamp to the own time; unchanged until the clock was set back.
    pub fn own(&mut self, stamp: Timestamp) -> Timestamp {
        let own = stamp.after_ns(self.shift_ns);
        let own = match self.last {
            Some(last) if own <= last => {
                let anew = last.after_ns(TUNING.clock_restart_pause_ns);
                self.shift_ns = anew.ns_since(stamp);
                anew
            }
            _ => own,
        };
        self.last = Some(own);
        own
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_set_back_counts_as_a_pause() {
        let mut steps = ClockSteps::default();
        let own = [5, 7, 1, 3, 9, 2].map(|t| steps.own(Timestamp::from_ns(t)).ns());
        assert_eq!(
            own,
            [
                5,
                7,
                7 + TUNING.clock_restart_pause_ns,
                9 + TUNING.clock_restart_pause_ns,
                15 + TUNING.clock_restart_pause_ns,
                15 + 2 * TUNING.clock_restart_pause_ns
            ]
        );
    }
}
