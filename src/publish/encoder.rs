//! The interface of all protocols: takes a report, returns datagrams or lines.

use std::net::SocketAddr;

use super::report::Report;
use crate::frame::Timestamp;
use crate::geometry::{Body, Pose, Stage};

/// Turns reports into packets of one protocol, and keeps its counters.
pub(super) trait Encoder: Send {
    /// Makes the packets of a report and passes them to `send` one by one.
    fn encode(&mut self, report: &Report, send: &mut dyn FnMut(&[u8]));

    /// Whether the format can represent this pose; a pose that does not fit is withheld, never
    /// clamped.
    fn holds(&self, _pose: &Pose<Stage, Body>) -> bool {
        true
    }

    /// Whether the format can mark a pose as predicted.
    fn marks_coasting(&self) -> bool {
        true
    }

    /// Whether the format can mark that no pose is known (`on_loss = "flag"`).
    fn marks_loss(&self) -> bool {
        true
    }

    /// Whether it can do so without a pose, so that a receiver is told even if `on_loss` is "stop".
    fn announces_loss(&self) -> bool {
        true
    }

    /// Sends what the protocol repeats once a second regardless of frames; called about ten times a
    /// second. `now` is on the monotonic clock.
    fn repeat(&mut self, _now: Timestamp, _send: &mut dyn FnMut(&[u8])) {}

    /// Takes a datagram that a receiver has sent to this output. `now` is on the monotonic clock.
    fn hear(&mut self, _now: Timestamp, _from: SocketAddr, _packet: &[u8]) {}

    /// Returns the answers that are due, and to whom; called about ten times a second.
    fn answers(&mut self, _now: Timestamp) -> Vec<(SocketAddr, Vec<u8>)> {
        Vec::new()
    }
}
