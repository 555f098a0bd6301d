//! A PosiStageNet output: all bodies in every frame, their names once a second, both split into
//! packets that cross an Ethernet in one piece.

use std::sync::Arc;
use std::time::Duration;

use super::encoder::Encoder;
use super::report::{BodyReport, Report};
use crate::frame::Timestamp;
use crate::protocols::psn::{MAX_PACKET, PsnHeader, PsnPacket, PsnTracker, speed_to_psn, to_psn};

/// Maximum bytes of trackers in one data packet, counting 72 for each; with the headers it stays
/// below [`MAX_PACKET`]. Raised beyond that, packets are fragmented.
const MAX_TRACKER_BYTES: usize = 1400;
/// Maximum length of a name, bytes: a desk shows fewer letters, and a packet must have room for
/// one.
const MAX_NAME: usize = 255;
/// Interval between info packets with names (chosen: far slower than poses). Raised, a desk shows
/// names later.
const INFO_EVERY: Duration = Duration::from_secs(1);

/// Settings of a PSN output.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PsnSettings {
    /// The system's name in info packets.
    pub system: String,
    /// Tracker number of the first body; the others follow.
    pub first_tracker: u16,
}

/// Cuts a name to the maximum length, at a character boundary.
fn cut(name: &str) -> &str {
    let end = (0..=MAX_NAME.min(name.len())).rev().find(|end| name.is_char_boundary(*end)).unwrap_or(0);
    &name[..end]
}

/// Splits names, in order, into groups that fit into `most` bytes; returns at least one group,
/// which may be empty.
fn groups(names: &[(u16, String)], most: usize) -> Vec<&[(u16, String)]> {
    let (mut groups, mut begun, mut filled) = (Vec::new(), 0, 0);
    for (index, (_, name)) in names.iter().enumerate() {
        // The tracker's chunk header and its name's.
        let length = 4 + 4 + name.len();
        if filled + length > most && index > begun {
            groups.push(&names[begun..index]);
            (begun, filled) = (index, 0);
        }
        filled += length;
    }
    groups.push(&names[begun..]);
    groups
}

/// Turns reports into packets.
pub(super) struct PsnEncoder {
    settings: PsnSettings,
    names: Vec<(u16, String)>,
    begun: Timestamp,
    frame_id: u8,
    info_due: Timestamp,
}

impl PsnEncoder {
    /// Creates an encoder. `begun` is the current monotonic time, from which times in packets
    /// count.
    pub fn new(settings: &PsnSettings, names: &[Arc<str>], begun: Timestamp) -> Self {
        let names = names.iter().zip(settings.first_tracker..).map(|(name, id)| (id, cut(name).to_owned())).collect();
        let settings = PsnSettings { system: cut(&settings.system).to_owned(), ..settings.clone() };
        // Not 0: a widely used decoder takes frame 0 for an unnumbered frame and ignores it.
        Self { settings, names, begun, frame_id: 1, info_due: Timestamp::MIN }
    }

    fn since_start_us(&self, at: Timestamp) -> u64 {
        u64::try_from(at.duration_since(self.begun).as_micros()).unwrap_or(u64::MAX)
    }

    fn tracker(&self, report: &Report, body: &BodyReport, id: u16) -> PsnTracker {
        let pose = body.pose.as_ref().map(to_psn);
        PsnTracker {
            id,
            position_m: pose.map(|(p, _)| p),
            speed_m_s: body.velocity.map(|[velocity, _]| speed_to_psn(&velocity)),
            orientation_rad: pose.map(|(_, w)| w),
            validity: Some(body.confidence()),
            // The time of the pose: a held pose keeps its time.
            timestamp_us: Some(self.since_start_us(report.monotonic.before(body.held.unwrap_or_default()))),
            ..PsnTracker::default()
        }
    }
}

impl Encoder for PsnEncoder {
    fn encode(&mut self, report: &Report, send: &mut dyn FnMut(&[u8])) {
        // Bodies without a pose are included with validity 0: a report without any pose is only
        // made to announce that.
        let trackers: Vec<PsnTracker> =
            report.bodies.iter().zip(self.settings.first_tracker..).map(|(body, id)| self.tracker(report, body, id)).collect();
        // A tracker takes 4 bytes of chunk header and at most 68 of fields.
        let groups: Vec<&[PsnTracker]> = trackers.chunks(MAX_TRACKER_BYTES / 72).collect();
        let timestamp_us = self.since_start_us(report.sent_monotonic);
        // A frame has only a few packets, since a config names few objects.
        let header = PsnHeader { timestamp_us, frame_id: self.frame_id, packets: groups.len().min(255) as u8 };
        self.frame_id = self.frame_id.wrapping_add(1);
        for group in groups {
            let _ = PsnPacket::Data(header, group.to_vec()).encode().map(|bytes| send(&bytes));
        }
    }

    fn repeat(&mut self, now: Timestamp, send: &mut dyn FnMut(&[u8])) {
        if now < self.info_due {
            return;
        }
        self.info_due = now.after(INFO_EVERY);
        // Chunk headers of 4 bytes each: the packet, the header, the system and the list; the
        // header has 12 bytes of content.
        let groups = groups(&self.names, MAX_PACKET - 4 - 4 - 12 - 4 - self.settings.system.len() - 4);
        let packets = groups.len().min(255) as u8;
        let header = PsnHeader { timestamp_us: self.since_start_us(now), frame_id: self.frame_id, packets };
        for group in groups {
            let _ = PsnPacket::Info(header, self.settings.system.clone(), group.to_vec()).encode().map(|bytes| send(&bytes));
        }
    }
}

#[cfg(test)]
#[path = "psn_tests.rs"]
mod tests;
