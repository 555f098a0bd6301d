//! The sections about what happens to a pose after tracking, as they stand in the file: `[filter]`, `[safety]`, `[[output]]`, `[http]`.

use std::ops::Range;

use serde::Deserialize;
use toml::Spanned;

use super::typed_values::{Count, Exactly, Number, Texts};
use crate::publish::TransportError;

/// `[filter]`
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Filter {
    /// off, one-euro, kalman.
    pub kind: Option<Spanned<String>>,
    /// The pose is told for this long after the frame, seconds.
    pub predict_s: Option<Spanned<Number>>,
    /// One-Euro: cutoff at rest, Hz.
    pub min_cutoff_hz: Option<Spanned<Number>>,
    /// One-Euro: how the cutoff rises with speed, Hz per m/s.
    pub beta: Option<Spanned<Number>>,
    /// Kalman: accelerations expected while moving, m/s².
    pub acceleration_m_s2: Option<Spanned<Number>>,
    /// Kalman: angular accelerations expected while moving, degrees/s².
    pub turn_acceleration_deg_s2: Option<Spanned<Number>>,
}

/// `[safety]`
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Safety {
    /// Greatest speed, m/s.
    pub max_speed_m_s: Option<Spanned<Number>>,
    /// Greatest turn rate, degrees/s.
    pub max_turn_deg_s: Option<Spanned<Number>>,
    /// Two corners, stage frame.
    pub permitted_box_m: Option<Spanned<Exactly<Exactly<Number, 3>, 2>>>,
    /// Speed of the return after a loss, m/s.
    pub blend_speed_m_s: Option<Spanned<Number>>,
    /// Turn rate of the return after a loss, degrees/s.
    pub blend_turn_deg_s: Option<Spanned<Number>>,
    /// No frame for this long is told, seconds.
    pub stale_after_s: Option<Spanned<Number>>,
}

/// `[http]`
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Http {
    /// Whether the server runs.
    pub enabled: Option<Spanned<bool>>,
    /// IP address and port.
    pub listen: Option<Spanned<String>>,
    /// Hosts that are answered for beside this machine's own.
    pub hosts: Option<Vec<Spanned<String>>>,
}

/// `[[output]]`: what all protocols share, then each one's own.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Output {
    /// freed, opentrackio, psn, osc, json.
    pub kind: Option<Spanned<String>>,
    /// For messages and metrics.
    pub name: Option<Spanned<String>>,
    /// Whether it sends.
    pub enabled: Option<Spanned<bool>>,
    /// One UDP address or several.
    pub to: Option<Spanned<Texts>>,
    /// This machine's address on the multicast network.
    pub interface: Option<Spanned<String>>,
    /// Routers a datagram may cross.
    pub ttl: Option<Spanned<Count>>,
    /// Camera and objects by name.
    pub bodies: Option<Spanned<Texts>>,
    /// Every n-th sample.
    pub rate_divider: Option<Spanned<Count>>,
    /// Ticks of its own per second.
    pub rate_hz: Option<Spanned<Number>>,
    /// How far the ticks' poses lie back, seconds.
    pub delay_s: Option<Spanned<Number>>,
    /// stop, hold, flag.
    pub on_loss: Option<Spanned<String>>,
    /// Whose axes and units: unreal, disguise, touchdesigner, lighting.
    pub receiver: Option<Spanned<String>>,
    /// The stage's origin in the receiver's world, metres.
    pub offset_m: Option<Spanned<Exactly<Number, 3>>>,
    /// The stage's axes in the receiver's world.
    pub rotation_xyzw: Option<Spanned<Exactly<Number, 4>>>,
    /// The same as turn, tilt and roll, degrees.
    pub rotation_deg: Option<Spanned<Exactly<Number, 3>>>,
    /// x, y, z, pan, tilt, roll.
    pub invert: Option<Spanned<Texts>>,
    /// Receiver's units per metre.
    pub scale: Option<Spanned<Number>>,
    /// Whether `[safety]` holds.
    pub safety: Option<Spanned<bool>>,
    /// freed, opentrackio: width of the sensor, mm.
    pub sensor_width_mm: Option<Spanned<Number>>,
    /// freed: camera number.
    pub camera_id: Option<Spanned<Count>>,
    /// freed: quality, frame, sony, zero.
    pub spare: Option<Spanned<String>>,
    /// freed: raw zoom.
    pub zoom: Option<Spanned<Count>>,
    /// freed: raw focus.
    pub focus: Option<Spanned<Count>>,
    /// opentrackio: json, cbor.
    pub encoding: Option<Spanned<String>>,
    /// opentrackio: 1 to 200.
    pub source_number: Option<Spanned<Count>>,
    /// opentrackio: projection, both.
    pub principal_point: Option<Spanned<String>>,
    /// psn: the system's name.
    pub system: Option<Spanned<String>>,
    /// psn: tracker number of the first body.
    pub first_tracker: Option<Spanned<Count>>,
    /// osc: first part of the addresses.
    pub prefix: Option<Spanned<String>>,
    /// osc: pose, quat, status.
    pub messages: Option<Spanned<Texts>>,
    /// osc: `[[output.value]]`.
    #[serde(default)]
    pub value: Vec<Spanned<OutputValue>>,
    /// json: IP address and port for TCP clients.
    pub tcp_listen: Option<Spanned<String>>,
    /// json: a file, or `-`.
    pub file: Option<Spanned<String>>,
}

/// `[[output.value]]`: a single number for an OSC address of the receiver's.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OutputValue {
    /// Address, with `{body}` and `{output}`.
    pub address: Option<Spanned<String>>,
    /// x, y, z, pan, tilt, roll.
    pub quantity: Option<Spanned<String>>,
    /// Factor.
    pub factor: Option<Spanned<Number>>,
    /// Added after the factor.
    pub plus: Option<Spanned<Number>>,
    /// Least and greatest.
    pub clamp: Option<Spanned<Exactly<Number, 2>>>,
    /// Every n-th report.
    pub every: Option<Spanned<Count>>,
}

impl Output {
    /// The key that asked for what this machine does not give, and where it stands.
    pub(super) fn place_of(&self, error: &TransportError, section: Range<usize>) -> (&'static str, Range<usize>) {
        let (key, span) = match error {
            TransportError::Udp(_) => ("interface", self.interface.as_ref().map(Spanned::span)),
            TransportError::Listen { .. } => ("tcp_listen", self.tcp_listen.as_ref().map(Spanned::span)),
            TransportError::File { .. } => ("file", self.file.as_ref().map(Spanned::span)),
        };
        (key, span.unwrap_or(section))
    }
}
