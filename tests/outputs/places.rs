//! The receivers of a test's outputs, and what arrived there.

use std::io::{ErrorKind, Read};
use std::net::{TcpListener, TcpStream, UdpSocket};
use std::path::PathBuf;
use std::time::Duration;

use stagepose::diagnostics::publish::{
    BodyChoice, FreedSettings, JsonSettings, OnLoss, OpenTrackIoSettings, OscMessageKind, OscSettings, OtpSettings, OutputSettings,
    Placement, Protocol, PsnSettings, Rate, Spare, StreamSettings, UdpSettings,
};
use stagepose::protocols::opentrackio::Encoding;
use stagepose::protocols::opentrackio_lens::PrincipalPoint;

use super::decoders::{self, Said};

/// How one column of the table is sent and decoded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Way {
    Freed(Spare),
    OpenTrackIo(Encoding),
    Psn,
    Otp,
    Osc { has_status: bool },
    JsonByUdp,
    JsonByTcp,
    JsonInFile,
}

/// The columns, by their titles in docs/protocols.md. JSON has one column there, because it says
/// the same over every transport.
pub const WAYS: [(&str, Way); 13] = [
    ("FreeD `quality`", Way::Freed(Spare::Quality)),
    ("FreeD `frame`", Way::Freed(Spare::Frame)),
    ("FreeD `sony`", Way::Freed(Spare::Sony)),
    ("FreeD `zero`", Way::Freed(Spare::Zero)),
    ("OpenTrackIO `json`", Way::OpenTrackIo(Encoding::Json)),
    ("OpenTrackIO `cbor`", Way::OpenTrackIo(Encoding::Cbor)),
    ("PSN", Way::Psn),
    ("OTP", Way::Otp),
    ("OSC", Way::Osc { has_status: true }),
    ("OSC, no `status`", Way::Osc { has_status: false }),
    ("JSON", Way::JsonByUdp),
    ("JSON", Way::JsonByTcp),
    ("JSON", Way::JsonInFile),
];

impl Way {
    pub fn can_flag(self) -> bool {
        !matches!(self, Self::Freed(Spare::Frame | Spare::Sony | Spare::Zero) | Self::Otp | Self::Osc { has_status: false })
    }

    fn protocol(self, stream: StreamSettings, asked_at: std::net::SocketAddr) -> Protocol {
        let (sensor_width_mm, principal_point) = (4.8, PrincipalPoint::Projection);
        match self {
            Self::Freed(spare) => Protocol::Freed(FreedSettings { camera_id: 1, spare, zoom: None, sensor_width_mm, focus: 0 }),
            Self::OpenTrackIo(encoding) => {
                Protocol::OpenTrackIo(OpenTrackIoSettings { encoding, source_number: 1, sensor_width_mm, principal_point })
            }
            Self::Psn => Protocol::Psn(PsnSettings { system: "test".to_owned(), first_tracker: 1 }),
            Self::Otp => Protocol::Otp(OtpSettings {
                component: "test".to_owned(),
                system: 1,
                group: 1,
                first_point: 1,
                priority: 100,
                reference: None,
                listen: asked_at,
            }),
            Self::Osc { has_status } => {
                let mut messages = vec![OscMessageKind::Pose];
                messages.extend(has_status.then_some(OscMessageKind::Status));
                Protocol::Osc(OscSettings { prefix: "/s".to_owned(), messages, values: Vec::new() })
            }
            Self::JsonByUdp | Self::JsonByTcp | Self::JsonInFile => Protocol::Json(JsonSettings { stream }),
        }
    }
}

/// A receiver of one output, and what arrived.
pub struct Place {
    pub title: &'static str,
    pub way: Way,
    of_object: bool,
    udp: UdpSocket,
    /// Where the output hears receivers, if it does.
    asked_at: std::net::SocketAddr,
    /// Whether it has answered.
    is_answered: bool,
    listen: Option<std::net::SocketAddr>,
    client: Option<TcpStream>,
    /// Bytes received by TCP that are not a whole line yet.
    begun: Vec<u8>,
    file: Option<PathBuf>,
    lines_read: usize,
    pub said: Vec<Said>,
    /// OpenTrackIO's sequence numbers.
    pub sequences: Vec<u16>,
}

impl Place {
    pub fn new((title, way): (&'static str, Way), of_object: bool, folder: &std::path::Path) -> Self {
        let udp = UdpSocket::bind("127.0.0.1:0").unwrap();
        udp.set_nonblocking(true).unwrap();
        let asked_at = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let free = || TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let listen = (way == Way::JsonByTcp).then(free);
        let file = (way == Way::JsonInFile).then(|| folder.join("lines.jsonl"));
        let (client, begun, said, sequences) = (None, Vec::new(), Vec::new(), Vec::new());
        Self { title, way, of_object, udp, asked_at, is_answered: false, listen, client, begun, file, lines_read: 0, said, sequences }
    }

    pub fn output(&self, on_loss: OnLoss, rate: Rate) -> OutputSettings {
        let is_udp = self.listen.is_none() && self.file.is_none();
        let to = if is_udp { vec![self.udp.local_addr().unwrap()] } else { Vec::new() };
        OutputSettings {
            name: format!("{:?}", self.way),
            enabled: true,
            protocol: self.way.protocol(StreamSettings { tcp_listen: self.listen, file: self.file.clone() }, self.asked_at),
            udp: UdpSettings { to, ..UdpSettings::default() },
            bodies: vec![if self.of_object { BodyChoice::Object(0) } else { BodyChoice::Camera }],
            rate,
            delay: Duration::ZERO,
            on_loss,
            placement: Placement::default(),
            is_guarded: true,
            passes_rings: false,
        }
    }

    /// Connects a client if the output waits for one.
    pub fn connect(&mut self) {
        self.client = self.listen.map(|at| {
            let stream = TcpStream::connect(at).unwrap();
            stream.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
            stream
        });
    }

    /// Asks the output for poses, if it sends none unasked.
    pub fn ask(&self) {
        if self.way == Way::Otp {
            for question in decoders::otp_questions() {
                self.udp.send_to(&question, self.asked_at).unwrap();
            }
        }
    }

    /// Whether the output has heard what it was asked.
    pub fn is_heard(&self) -> bool {
        self.way != Way::Otp || self.is_answered
    }

    /// Reads everything that has arrived.
    pub fn hear(&mut self) {
        let mut buffer = [0; 4096];
        while let Ok(length) = self.udp.recv(&mut buffer) {
            self.packet(&buffer[..length]);
        }
        self.hear_client();
        if let Some(file) = &self.file {
            let text = std::fs::read_to_string(file).unwrap_or_default();
            let whole = &text[..text.rfind('\n').map_or(0, |end| end + 1)];
            self.said.extend(whole.lines().skip(self.lines_read).map(|line| decoders::json(line, self.of_object)));
            self.lines_read = whole.lines().count();
        }
    }

    fn hear_client(&mut self) {
        let Some(client) = &mut self.client else { return };
        let mut buffer = [0; 4096];
        loop {
            match client.read(&mut buffer) {
                Ok(0) => break,
                Ok(length) => self.begun.extend_from_slice(&buffer[..length]),
                Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => break,
                Err(e) => panic!("{e}"),
            }
        }
        while let Some(end) = self.begun.iter().position(|b| *b == b'\n') {
            let line: Vec<u8> = self.begun.drain(..=end).collect();
            self.said.push(decoders::json(std::str::from_utf8(&line).unwrap(), self.of_object));
        }
    }

    /// Whether the other side has closed the connection.
    pub fn is_closed(&mut self) -> bool {
        self.client.as_mut().is_none_or(|client| {
            client.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
            matches!(client.read(&mut [0; 16]), Ok(0))
        })
    }

    fn packet(&mut self, packet: &[u8]) {
        let said = match self.way {
            Way::Freed(spare) => Some(decoders::freed(packet, spare == Spare::Quality)),
            Way::OpenTrackIo(_) => {
                let (sequence, said) = decoders::opentrackio(packet);
                self.sequences.push(sequence);
                Some(said)
            }
            Way::Psn => decoders::psn(packet),
            Way::Otp => match decoders::otp(packet) {
                Some(points) => Some(Said { x: points[0].position_m.map(|[x, ..]| x), mark: String::new() }),
                None => {
                    self.is_answered = true;
                    None
                }
            },
            Way::Osc { .. } => Some(decoders::osc(packet)),
            _ => Some(decoders::json(std::str::from_utf8(packet).unwrap(), self.of_object)),
        };
        self.said.extend(said);
    }
}
