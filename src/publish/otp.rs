//! An OTP output: the modules that consumers have asked for, of all bodies with a pose, in one
//! folio per report; answers to consumers' questions.
//!
//! OTP cannot mark a pose as predicted or lost: a point without a pose is left out, a held one
//! keeps the time at which it was valid.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use rand::{RngCore, SeedableRng};
use rand_pcg::Pcg64;

use super::encoder::Encoder;
use super::otp_demand::{Demand, Question};
use super::report::{BodyReport, Report};
use crate::fingerprint::{START, fnv1a};
use crate::frame::Timestamp;
use crate::geometry::{Body, Pose, Stage};
use crate::protocols::otp::{MAX_NAME, MAX_PACKET, OtpAddress, OtpHeader, OtpMessage, OtpModule, OtpPoint, OtpTransform};
use crate::protocols::otp_pose::{rates_to_otp, to_otp, velocity_to_otp};

/// Time after the start before the first transforms, in which all consumers ask once (table A-2 of
/// the standard).
const STARTUP: Duration = Duration::from_secs(12);
/// Points in one packet, and names in one (39 bytes each, beside 96 of headers).
const POINTS_PER_PAGE: usize = (MAX_PACKET - OtpTransform::EMPTY_BYTES) / OtpPoint::MAX_BYTES;
const NAMES_PER_PAGE: usize = (MAX_PACKET - 96) / (7 + MAX_NAME);

/// Settings of an OTP output.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OtpSettings {
    /// The sender's name, at most 32 bytes.
    pub component: String,
    /// System, 1 to 200.
    pub system: u8,
    /// Group of all bodies, 1 to 60000.
    pub group: u16,
    /// Point number of the first body; the others follow.
    pub first_point: u32,
    /// 0 to 200; of several senders of a point the highest counts.
    pub priority: u8,
    /// The point in whose frame the stage is, such as a revolve; `None`: the system's own origin.
    pub reference: Option<OtpAddress>,
    /// Where consumers' advertisements arrive: a multicast group or an address of this machine.
    pub listen: SocketAddr,
}

/// Turns reports into folios.
pub(super) struct OtpEncoder {
    settings: OtpSettings,
    names: Vec<(OtpAddress, String)>,
    cid: [u8; 16],
    begun: Timestamp,
    demand: Demand,
    random: Pcg64,
    transform_folio: u32,
    answer_folio: u32,
}

/// Returns a time on OTP's clock, microseconds: any origin will do, so it is the monotonic clock's.
fn otp_time(at: Timestamp) -> u64 {
    u64::try_from(at.ns() / 1000).unwrap_or(0)
}

impl OtpEncoder {
    /// Creates an encoder. `begun` is the current monotonic time.
    pub fn new(settings: &OtpSettings, names: &[Arc<str>], output: &str, begun: Timestamp) -> Self {
        let address = |point| OtpAddress { system: settings.system, group: settings.group, point };
        let names = names.iter().zip(settings.first_point..).map(|(name, point)| (address(point), name.to_string())).collect();
        // The component's identifier is the same at every start, given the machine and output.
        let machine = std::fs::read_to_string("/etc/machine-id").unwrap_or_default();
        let identity = [machine.trim().as_bytes(), output.as_bytes(), b"otp"].concat();
        let mut cid = [0; 16];
        Pcg64::seed_from_u64(fnv1a(START, &identity)).fill_bytes(&mut cid);
        let cid = uuid::Builder::from_random_bytes(cid).into_uuid().into_bytes();
        let random = Pcg64::seed_from_u64(fnv1a(START, &identity) ^ begun.ns() as u64);
        Self { settings: settings.clone(), names, cid, begun, demand: Demand::default(), random, transform_folio: 0, answer_folio: 0 }
    }

    fn header(&self, folio: u32, page: usize, pages: usize) -> OtpHeader {
        let place = |page: usize| u16::try_from(page).unwrap_or(u16::MAX);
        OtpHeader {
            cid: self.cid,
            folio,
            page: place(page),
            last_page: place(pages.saturating_sub(1)),
            component: self.settings.component.clone(),
        }
    }

    /// Returns a body's point with the modules that are asked for and known; `None` without any.
    fn point(&self, report: &Report, body: &BodyReport, point: u32) -> Option<OtpPoint> {
        let (pose, wanted) = (body.pose?, |module| self.demand.has(module, report.sent_monotonic));
        let (position, rotation) = to_otp(&pose);
        let [linear, angular] =
            body.velocity.map_or([None; 2], |[linear, angular]| [velocity_to_otp(&linear), rates_to_otp(&pose.rotation, &angular)]);
        // Accelerations are not known; the modules have no way to say so but 0.
        let with_zero = |velocity: [i32; 3]| [velocity, [0; 3]];
        let sent = OtpPoint {
            priority: self.settings.priority,
            group: self.settings.group,
            point,
            // The time of the pose: a held pose keeps its time.
            timestamp_us: otp_time(report.monotonic.before(body.held.unwrap_or_default())),
            position_um: wanted(OtpModule::POSITION).then_some(position),
            velocity: linear.filter(|_| wanted(OtpModule::VELOCITY)).map(with_zero),
            rotation_udeg: wanted(OtpModule::ROTATION).then_some(rotation),
            rotation_velocity: angular.filter(|_| wanted(OtpModule::ROTATION_VELOCITY)).map(with_zero),
            scale: None,
            reference: self.settings.reference.filter(|_| wanted(OtpModule::REFERENCE)),
        };
        let is_something = sent.position_um.is_some() || sent.rotation_udeg.is_some() || sent.reference.is_some();
        is_something.then_some(sent)
    }

    fn answer(&mut self, question: Question) -> Vec<Vec<u8>> {
        let messages: Vec<OtpMessage> = match question {
            Question::Systems => vec![OtpMessage::Systems { is_answer: true, systems: vec![self.settings.system] }],
            Question::Names => {
                let page = |names: &[_]| OtpMessage::Names { is_answer: true, names: names.to_vec() };
                self.names.chunks(NAMES_PER_PAGE).map(page).collect()
            }
        };
        let (folio, pages) = (self.answer_folio, messages.len());
        self.answer_folio = folio.wrapping_add(1);
        let packet = |(page, message): (usize, &OtpMessage)| message.encode(&self.header(folio, page, pages)).ok();
        messages.iter().enumerate().filter_map(packet).collect()
    }
}

impl Encoder for OtpEncoder {
    fn encode(&mut self, report: &Report, send: &mut dyn FnMut(&[u8])) {
        if report.sent_monotonic < self.begun.after(STARTUP) {
            return;
        }
        let numbered = report.bodies.iter().zip(self.settings.first_point..);
        let points: Vec<OtpPoint> = numbered.filter_map(|(body, point)| self.point(report, body, point)).collect();
        let folio = self.transform_folio;
        let (system, timestamp_us) = (self.settings.system, otp_time(report.sent_monotonic));
        let pages: Vec<&[OtpPoint]> = points.chunks(POINTS_PER_PAGE).collect();
        for (page, points) in pages.iter().enumerate() {
            let transform = OtpTransform { system, timestamp_us, is_full: true, points: points.to_vec() };
            // `holds` has refused what the numbers cannot express.
            let _ = OtpMessage::Transform(transform).encode(&self.header(folio, page, pages.len())).map(|bytes| send(&bytes));
        }
        if !pages.is_empty() {
            self.transform_folio = folio.wrapping_add(1);
        }
    }

    fn holds(&self, pose: &Pose<Stage, Body>) -> bool {
        to_otp(pose).0.iter().all(|um| i32::try_from(*um).is_ok())
    }

    fn marks_coasting(&self) -> bool {
        false
    }

    fn marks_loss(&self) -> bool {
        false
    }

    fn announces_loss(&self) -> bool {
        false
    }

    fn hear(&mut self, now: Timestamp, from: SocketAddr, packet: &[u8]) {
        if let Ok((_, message)) = OtpMessage::decode(packet) {
            self.demand.hear(now, from, &message, &mut self.random);
        }
    }

    fn answers(&mut self, now: Timestamp) -> Vec<(SocketAddr, Vec<u8>)> {
        let due = self.demand.due(now);
        due.into_iter().flat_map(|(to, question)| self.answer(question).into_iter().map(move |packet| (to, packet))).collect()
    }
}

#[cfg(test)]
#[path = "otp_tests.rs"]
mod tests;
