//! OTP, the Object Transform Protocol (ANSI E1.59-2021): transforms of points, and the
//! advertisements with which consumers ask for them.
//!
//! Big-endian layers, each with a vector (what is inside) and a length: OTP layer, then a transform
//! layer with points with modules, or an advertisement layer with a list. A sender ("producer")
//! sends only the modules that receivers ("consumers") have asked for. A snapshot of all points (a
//! "folio") may take several packets ("pages", from 0).
//!
//! Source: the layers, numbers and times of two public implementations (OTPLib, OTPKit) and of
//! Wireshark's dissector, which agree, and the standard's Appendix B; its text was not at hand.

use std::net::{Ipv4Addr, Ipv6Addr};

use thiserror::Error;

/// UDP port of OTP.
pub const PORT: u16 = 5568;
/// Groups on which consumers ask (tables 15-2 and 15-3).
pub const ADVERTISEMENTS: Ipv4Addr = Ipv4Addr::new(239, 159, 2, 1);
/// The same for IPv6.
pub const ADVERTISEMENTS_V6: Ipv6Addr = Ipv6Addr::new(0xff18, 0, 0, 0, 0x9f, 0, 2, 1);
/// Maximum bytes of a packet (section 6.3): what crosses an Ethernet in one piece.
pub const MAX_PACKET: usize = 1472;
/// Maximum bytes of a component's or a point's name.
pub const MAX_NAME: usize = 32;

/// What every packet begins with.
const IDENTIFIER: &[u8; 12] = b"OTP-E1.59\0\0\0";
/// Vectors of the OTP layer.
const TRANSFORM: u16 = 1;
const ADVERTISEMENT: u16 = 2;
/// Vectors of the advertisement layer.
const MODULES: u16 = 1;
const NAMES: u16 = 2;
const SYSTEMS: u16 = 3;
/// The one vector of every innermost layer: a point, a module, a list.
const ONLY: u16 = 1;
/// Bit of the options: a full set of points in a transform, an answer in an advertisement, and
/// millimetres in a position.
const TOP_BIT: u8 = 0x80;
/// Bytes of the OTP layer that its length counts, before what it wraps.
const OTP_FIELDS: usize = 63;

/// Address of a point: what it belongs to, and its number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct OtpAddress {
    /// System, 1 to 200; also the last byte of the multicast group.
    pub system: u8,
    /// Group, 1 to 60000.
    pub group: u16,
    /// Point, 1 to 4000000000.
    pub point: u32,
}

/// A kind of data of a point: its manufacturer (0 = ESTA, the standard's own) and its number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct OtpModule(pub u16, pub u16);

impl OtpModule {
    /// Position.
    pub const POSITION: Self = Self(0, 1);
    /// Velocity and acceleration.
    pub const VELOCITY: Self = Self(0, 2);
    /// Rotation.
    pub const ROTATION: Self = Self(0, 3);
    /// Velocity and acceleration of the rotation.
    pub const ROTATION_VELOCITY: Self = Self(0, 4);
    /// Scale.
    pub const SCALE: Self = Self(0, 5);
    /// Reference frame.
    pub const REFERENCE: Self = Self(0, 6);
    /// All modules of the standard.
    pub const STANDARD: [Self; 6] = [Self::POSITION, Self::VELOCITY, Self::ROTATION, Self::ROTATION_VELOCITY, Self::SCALE, Self::REFERENCE];
}

/// The header of every packet.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct OtpHeader {
    /// The sender's identifier, a UUID.
    pub cid: [u8; 16],
    /// Number of the snapshot, which wraps.
    pub folio: u32,
    /// This packet's place in it, from 0.
    pub page: u16,
    /// Place of its last packet.
    pub last_page: u16,
    /// The sender's name, at most 32 bytes.
    pub component: String,
}

/// What a packet says.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum OtpMessage {
    /// Transforms of points.
    Transform(OtpTransform),
    /// A consumer asks for these modules.
    Modules(Vec<OtpModule>),
    /// A consumer asks for names (empty), or a producer answers with them.
    Names {
        /// Whether it is an answer.
        is_answer: bool,
        /// The points and their names.
        names: Vec<(OtpAddress, String)>,
    },
    /// A consumer asks which systems there are (empty), or a producer answers.
    Systems {
        /// Whether it is an answer.
        is_answer: bool,
        /// The systems' numbers.
        systems: Vec<u8>,
    },
}

/// A snapshot of a system's points, or a part of it.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct OtpTransform {
    /// The system.
    pub system: u8,
    /// When it was made, microseconds on the sender's clock.
    pub timestamp_us: u64,
    /// Whether the folio has every point of the sender, not only changed ones.
    pub is_full: bool,
    /// The points.
    pub points: Vec<OtpPoint>,
}

/// A point with its known modules.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct OtpPoint {
    /// 0 to 200; of several senders of a point the highest counts.
    pub priority: u8,
    /// Its group.
    pub group: u16,
    /// Its number.
    pub point: u32,
    /// When it was sampled, microseconds on the sender's clock.
    pub timestamp_us: u64,
    /// Micrometres: x right, y away from the audience, z up. Read also from millimetres, which
    /// reach farther than those 2147 m that can be sent.
    pub position_um: Option<[i64; 3]>,
    /// Velocity, µm/s, and acceleration, µm/s².
    pub velocity: Option<[[i32; 3]; 2]>,
    /// Rotations about x, y and z, millionths of a degree from 0 to 359999999: R = Rz Ry Rx.
    pub rotation_udeg: Option<[u32; 3]>,
    /// Rates of the three rotations, thousandths of a degree per second, and their changes, per
    /// second squared.
    pub rotation_velocity: Option<[[i32; 3]; 2]>,
    /// Scale, millionths.
    pub scale: Option<[i32; 3]>,
    /// The point to which all of this is relative; absent: the system's own origin.
    pub reference: Option<OtpAddress>,
}

/// Why bytes are not an OTP packet, or cannot become one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum OtpError {
    /// Another protocol (sACN has the same port).
    #[error("it is not an OTP packet; sACN has the same port, check the sender")]
    Kind,
    /// A layer is longer than what contains it, or too short for its content.
    #[error("a layer does not fit into its packet; the packet is damaged")]
    Length,
    /// More than a packet holds.
    #[error("the packet is longer than 1472 bytes; split it into pages")]
    TooLong,
    /// A position beyond the numbers' range.
    #[error("a position is farther than 2147 m; move the origin nearer")]
    Far,
}

/// Returns the IPv4 group for the transforms of a system (table 15-2).
pub fn transforms(system: u8) -> Ipv4Addr {
    Ipv4Addr::new(239, 159, 1, system)
}

/// Writes a layer: its vector, the length of what follows, and that.
fn layer(vector: u16, content: &[u8]) -> Vec<u8> {
    // Longer content is refused before the packet is sent.
    let length = u16::try_from(content.len()).unwrap_or(u16::MAX);
    [&vector.to_be_bytes()[..], &length.to_be_bytes(), content].concat()
}

/// Returns a name in its field; a longer one is cut between characters.
fn name_field(name: &str) -> [u8; MAX_NAME] {
    let end = (0..=MAX_NAME.min(name.len())).rev().find(|end| name.is_char_boundary(*end)).unwrap_or(0);
    let mut field = [0; MAX_NAME];
    field[..end].copy_from_slice(&name.as_bytes()[..end]);
    field
}

impl OtpAddress {
    fn encode(self) -> [u8; 7] {
        let ([g, h], [p, q, r, s]) = (self.group.to_be_bytes(), self.point.to_be_bytes());
        [self.system, g, h, p, q, r, s]
    }
}

fn integers(values: &[i32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_be_bytes()).collect()
}

fn module(OtpModule(manufacturer, number): OtpModule, data: &[u8]) -> Vec<u8> {
    layer(manufacturer, &[&number.to_be_bytes()[..], data].concat())
}

impl OtpPoint {
    /// Bytes of a point with all modules but the scale: what a sender of poses needs at most.
    pub const MAX_BYTES: usize = 24 + 19 + 30 + 18 + 30 + 13;

    fn encode(&self) -> Result<Vec<u8>, OtpError> {
        let mut content = vec![self.priority];
        content.extend(self.group.to_be_bytes());
        content.extend(self.point.to_be_bytes());
        content.extend(self.timestamp_us.to_be_bytes());
        // Options and reserved bytes.
        content.extend([0; 5]);
        if let Some(position) = self.position_um {
            let mut data = vec![0];
            for v in position {
                data.extend(i32::try_from(v).map_err(|_| OtpError::Far)?.to_be_bytes());
            }
            content.extend(module(OtpModule::POSITION, &data));
        }
        let rotation = self.rotation_udeg.map(|angles| angles.iter().flat_map(|v| v.to_be_bytes()).collect());
        let others = [
            (OtpModule::VELOCITY, self.velocity.map(|v| integers(&v.concat()))),
            (OtpModule::ROTATION, rotation),
            (OtpModule::ROTATION_VELOCITY, self.rotation_velocity.map(|v| integers(&v.concat()))),
            (OtpModule::SCALE, self.scale.map(|v| integers(&v))),
            (OtpModule::REFERENCE, self.reference.map(|address| address.encode().to_vec())),
        ];
        content.extend(others.into_iter().filter_map(|(kind, data)| Some(module(kind, &data?))).flatten());
        Ok(layer(ONLY, &content))
    }
}

impl OtpMessage {
    /// Encodes a packet.
    ///
    /// # Errors
    /// More than fits into one packet, or a position beyond the numbers' range.
    pub fn encode(&self, header: &OtpHeader) -> Result<Vec<u8>, OtpError> {
        let advertisement = |vector, options: &[u8], list: Vec<u8>| {
            let list = layer(ONLY, &[options, &[0; 4], &list].concat());
            (ADVERTISEMENT, layer(vector, &[&[0; 4], &list[..]].concat()))
        };
        let answer = |is_answer| [if is_answer { TOP_BIT } else { 0 }];
        let (vector, inner) = match self {
            Self::Transform(transform) => (TRANSFORM, transform.encode()?),
            Self::Modules(modules) => {
                let list = modules.iter().flat_map(|OtpModule(m, n)| [m.to_be_bytes(), n.to_be_bytes()].concat()).collect();
                advertisement(MODULES, &[], list)
            }
            Self::Names { is_answer, names } => {
                let list = names.iter().flat_map(|(address, name)| [&address.encode()[..], &name_field(name)].concat()).collect();
                advertisement(NAMES, &answer(*is_answer), list)
            }
            Self::Systems { is_answer, systems } => advertisement(SYSTEMS, &answer(*is_answer), systems.clone()),
        };
        let mut content = vec![0, 0];
        content.extend(header.cid);
        content.extend(header.folio.to_be_bytes());
        content.extend(header.page.to_be_bytes());
        content.extend(header.last_page.to_be_bytes());
        content.extend([0; 5]);
        content.extend(name_field(&header.component));
        content.extend(inner);
        let packet = [&IDENTIFIER[..], &layer(vector, &content)].concat();
        if packet.len() > MAX_PACKET { Err(OtpError::TooLong) } else { Ok(packet) }
    }

    /// Decodes the bytes of a packet; ignores modules of other manufacturers, and layers of kinds
    /// that the standard does not have yet.
    ///
    /// # Errors
    /// Another protocol, or layers that do not fit into each other.
    pub fn decode(bytes: &[u8]) -> Result<(OtpHeader, Self), OtpError> {
        let rest = bytes.strip_prefix(IDENTIFIER).ok_or(OtpError::Kind)?;
        // A footer may follow.
        let (vector, content, _) = split_layer(rest)?;
        let (fields, inner) = content.split_at_checked(OTP_FIELDS).ok_or(OtpError::Length)?;
        let mut fields = Fields(fields);
        let _footer: [u8; 2] = fields.array()?;
        let (cid, folio, page, last_page) = (fields.array()?, fields.u32()?, fields.u16()?, fields.u16()?);
        let _options: [u8; 5] = fields.array()?;
        let header = OtpHeader { cid, folio, page, last_page, component: fields.name()? };
        let (inner_vector, content, _) = split_layer(inner)?;
        let message = match vector {
            TRANSFORM if inner_vector == ONLY => Self::Transform(OtpTransform::decode(content)?),
            ADVERTISEMENT => advertisement(inner_vector, content)?,
            _ => return Err(OtpError::Kind),
        };
        Ok((header, message))
    }
}

impl OtpTransform {
    /// Bytes of a transform packet without points.
    pub const EMPTY_BYTES: usize = 16 + OTP_FIELDS + 18;

    fn encode(&self) -> Result<Vec<u8>, OtpError> {
        let mut content = vec![self.system];
        content.extend(self.timestamp_us.to_be_bytes());
        content.extend([if self.is_full { TOP_BIT } else { 0 }, 0, 0, 0, 0]);
        for point in &self.points {
            content.extend(point.encode()?);
        }
        Ok(layer(ONLY, &content))
    }

    fn decode(content: &[u8]) -> Result<Self, OtpError> {
        let mut fields = Fields(content);
        let (system, timestamp_us, [options, ..]) = (fields.u8()?, fields.u64()?, fields.array::<5>()?);
        let points = layers(fields.0)?.into_iter().filter(|(vector, _)| *vector == ONLY).map(|(_, content)| point(content));
        Ok(Self { system, timestamp_us, is_full: options & TOP_BIT != 0, points: points.collect::<Result<_, _>>()? })
    }
}

/// Bytes in order; a field that is not there is an error.
struct Fields<'a>(&'a [u8]);

impl Fields<'_> {
    fn array<const N: usize>(&mut self) -> Result<[u8; N], OtpError> {
        let (head, rest) = self.0.split_first_chunk::<N>().ok_or(OtpError::Length)?;
        self.0 = rest;
        Ok(*head)
    }

    fn u8(&mut self) -> Result<u8, OtpError> {
        self.array().map(|[byte]| byte)
    }

    fn u16(&mut self) -> Result<u16, OtpError> {
        self.array().map(u16::from_be_bytes)
    }

    fn u32(&mut self) -> Result<u32, OtpError> {
        self.array().map(u32::from_be_bytes)
    }

    fn u64(&mut self) -> Result<u64, OtpError> {
        self.array().map(u64::from_be_bytes)
    }

    fn vector(&mut self) -> Result<[i32; 3], OtpError> {
        let mut next = || self.array().map(i32::from_be_bytes);
        Ok([next()?, next()?, next()?])
    }

    fn name(&mut self) -> Result<String, OtpError> {
        let field: [u8; MAX_NAME] = self.array()?;
        let end = field.iter().position(|byte| *byte == 0).unwrap_or(MAX_NAME);
        Ok(String::from_utf8_lossy(&field[..end]).into_owned())
    }

    fn address(&mut self) -> Result<OtpAddress, OtpError> {
        Ok(OtpAddress { system: self.u8()?, group: self.u16()?, point: self.u32()? })
    }

    /// Reads entries up to the end.
    fn list<T>(mut self, mut read: impl FnMut(&mut Self) -> Result<T, OtpError>) -> Result<Vec<T>, OtpError> {
        let mut entries = Vec::new();
        while !self.0.is_empty() {
            entries.push(read(&mut self)?);
        }
        Ok(entries)
    }
}

/// Returns the first layer's vector and content, and what follows it.
fn split_layer(bytes: &[u8]) -> Result<(u16, &[u8], &[u8]), OtpError> {
    let mut fields = Fields(bytes);
    let (vector, length) = (fields.u16()?, fields.u16()?);
    let (content, rest) = fields.0.split_at_checked(usize::from(length)).ok_or(OtpError::Length)?;
    Ok((vector, content, rest))
}

/// Returns consecutive layers: vector and content.
fn layers(mut bytes: &[u8]) -> Result<Vec<(u16, &[u8])>, OtpError> {
    let mut found = Vec::new();
    while !bytes.is_empty() {
        let (vector, content, rest) = split_layer(bytes)?;
        found.push((vector, content));
        bytes = rest;
    }
    Ok(found)
}

fn point(content: &[u8]) -> Result<OtpPoint, OtpError> {
    let mut fields = Fields(content);
    let (priority, group, number, timestamp_us) = (fields.u8()?, fields.u16()?, fields.u32()?, fields.u64()?);
    let _options: [u8; 5] = fields.array()?;
    let mut point = OtpPoint { priority, group, point: number, timestamp_us, ..OtpPoint::default() };
    for (manufacturer, content) in layers(fields.0)? {
        let mut data = Fields(content);
        let number = data.u16()?;
        match OtpModule(manufacturer, number) {
            OtpModule::POSITION => {
                let per_unit = if data.u8()? & TOP_BIT == 0 { 1 } else { 1000 };
                point.position_um = Some(data.vector()?.map(|v| i64::from(v) * per_unit));
            }
            OtpModule::VELOCITY => point.velocity = Some([data.vector()?, data.vector()?]),
            OtpModule::ROTATION => point.rotation_udeg = Some([data.u32()?, data.u32()?, data.u32()?]),
            OtpModule::ROTATION_VELOCITY => point.rotation_velocity = Some([data.vector()?, data.vector()?]),
            OtpModule::SCALE => point.scale = Some(data.vector()?),
            OtpModule::REFERENCE => point.reference = Some(data.address()?),
            _ => {}
        }
    }
    Ok(point)
}

fn advertisement(vector: u16, content: &[u8]) -> Result<OtpMessage, OtpError> {
    let mut fields = Fields(content);
    let _reserved: [u8; 4] = fields.array()?;
    let (list_vector, content, _) = split_layer(fields.0)?;
    if list_vector != ONLY {
        return Err(OtpError::Kind);
    }
    let mut fields = Fields(content);
    let is_answer = vector != MODULES && fields.u8()? & TOP_BIT != 0;
    let _reserved: [u8; 4] = fields.array()?;
    match vector {
        MODULES => fields.list(|fields| Ok(OtpModule(fields.u16()?, fields.u16()?))).map(OtpMessage::Modules),
        NAMES => Ok(OtpMessage::Names { is_answer, names: fields.list(|fields| Ok((fields.address()?, fields.name()?)))? }),
        SYSTEMS => Ok(OtpMessage::Systems { is_answer, systems: fields.0.to_vec() }),
        _ => Err(OtpError::Kind),
    }
}

#[cfg(test)]
#[path = "otp_tests.rs"]
mod tests;
