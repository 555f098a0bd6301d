//! What every protocol has in common: a report goes in, datagrams or lines come out.

use super::report::Report;
use crate::frame::Timestamp;
use crate::geometry::{Body, Pose, Stage};

/// Turns reports into packets of one protocol; keeps what the protocol numbers and counts.
pub(super) trait Encoder: Send {
    /// Makes the packets of a report and hands them to `send` one by one.
    fn encode(&mut self, report: &Report, send: &mut dyn FnMut(&[u8]));

    /// The format's numbers reach as far as this pose; one that does not fit is never cut, but withheld.
    fn holds(&self, _pose: &Pose<Stage, Body>) -> bool {
        true
    }

    /// The format can say of a pose that it is only predicted.
    fn marks_coasting(&self) -> bool {
        true
    }

    /// The format can say that no pose is known (`on_loss = "flag"`).
    fn marks_loss(&self) -> bool {
        true
    }

    /// The format can say so without a pose, so that a receiver gets it even where `on_loss` is "stop".
    fn announces_loss(&self) -> bool {
        true
    }

    /// Sends what the protocol repeats once a second whatever happens; called about ten times a second. `now` is on the monotonic clock.
    fn repeat(&mut self, _now: Timestamp, _send: &mut dyn FnMut(&[u8])) {}
}
