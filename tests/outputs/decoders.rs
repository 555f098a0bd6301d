//! Small decoders written from the protocols' documents: free-d manual A.3.2, OpenTrackIO 1.0.1,
//! RFC 8949, PosiStageNet 2.03, ANSI E1.59 (by way of its public implementations), OSC 1.0, RFC
//! 6455. Any deviation from the document fails the test.

use serde_json::{Map, Value};

/// What one packet says about the main body.
#[derive(Debug, Clone, PartialEq)]
pub struct Said {
    /// Metres to the right, if there is a pose.
    pub x: Option<f64>,
    /// The mark, in the words of docs/protocols.md.
    pub mark: String,
}

/// Decodes free-d D1; with `has_quality`, the mark is the low spare byte.
pub fn freed(packet: &[u8], has_quality: bool) -> Said {
    assert_eq!((packet.len(), packet[0]), (29, 0xD1));
    let sum = packet[..28].iter().map(|b| u32::from(*b)).sum::<u32>();
    assert_eq!((0x40_u32.wrapping_sub(sum) & 0xFF) as u8, packet[28], "checksum");
    let raw = i32::from(packet[11]) << 16 | i32::from(packet[12]) << 8 | i32::from(packet[13]);
    let units = if raw >= 1 << 23 { raw - (1 << 24) } else { raw };
    let mark = if has_quality { packet[27].to_string() } else { String::new() };
    Said { x: Some(f64::from(units) / 64.0 / 1000.0), mark }
}

/// Decodes OpenTrackIO; the mark is the status, with the notes in brackets.
pub fn opentrackio(packet: &[u8]) -> (u16, Said) {
    assert_eq!((&packet[..4], packet[4]), (&b"OTrk"[..], 0));
    let sequence = u16::from_be_bytes([packet[6], packet[7]]);
    assert_eq!(packet[8..12], [0; 4], "one segment");
    let length = u16::from_be_bytes([packet[12], packet[13]]);
    assert_eq!(usize::from(length & 0x7FFF) + 16, packet.len());
    assert_eq!(length >> 15, 1, "the last segment");
    let (mut one, mut two) = (0_u32, 0_u32);
    for byte in packet[..14].iter().chain(&packet[16..]) {
        one = (one + u32::from(*byte)) % 256;
        two = (two + one) % 256;
    }
    assert_eq!([two as u8, one as u8], packet[14..16], "Fletcher's sums");
    let sample = match packet[5] {
        1 => serde_json::from_slice(&packet[16..]).unwrap(),
        2 => {
            let mut rest = &packet[16..];
            let sample = cbor(&mut rest);
            assert!(rest.is_empty());
            sample
        }
        other => panic!("encoding {other}"),
    };
    assert_eq!(sample["protocol"]["version"], serde_json::json!([1, 0, 1]));
    let status = sample["tracker"]["status"].as_str().unwrap();
    let notes = sample["tracker"]["notes"].as_str().map_or(String::new(), |notes| format!(" ({notes})"));
    (sequence, Said { x: sample["transforms"][0]["translation"]["x"].as_f64(), mark: format!("{status}{notes}") })
}

/// Decodes one CBOR item.
fn cbor(rest: &mut &[u8]) -> Value {
    let take = |rest: &mut &[u8], n: usize| -> Vec<u8> {
        let (head, tail) = rest.split_at(n);
        *rest = tail;
        head.to_vec()
    };
    let first = take(rest, 1)[0];
    let (major, info) = (first >> 5, first & 31);
    if major == 7 {
        return match info {
            20 => false.into(),
            21 => true.into(),
            22 => Value::Null,
            25 => half(u16::from_be_bytes(take(rest, 2).try_into().unwrap())).into(),
            26 => f64::from(f32::from_be_bytes(take(rest, 4).try_into().unwrap())).into(),
            27 => f64::from_be_bytes(take(rest, 8).try_into().unwrap()).into(),
            other => panic!("simple value {other}"),
        };
    }
    let argument = match info {
        0..=23 => u64::from(info),
        24..=27 => take(rest, 1 << (info - 24)).iter().fold(0, |n, b| n << 8 | u64::from(*b)),
        other => panic!("length {other}"),
    };
    match major {
        0 => argument.into(),
        1 => (-1 - argument as i64).into(),
        3 => String::from_utf8(take(rest, argument as usize)).unwrap().into(),
        4 => (0..argument).map(|_| cbor(rest)).collect::<Vec<_>>().into(),
        5 => {
            let mut map = Map::new();
            for _ in 0..argument {
                let key = cbor(rest);
                map.insert(key.as_str().unwrap().to_owned(), cbor(rest));
            }
            map.into()
        }
        other => panic!("major type {other}"),
    }
}

fn half(bits: u16) -> f64 {
    let (sign, exponent, fraction) = (if bits >> 15 == 0 { 1.0 } else { -1.0 }, i32::from(bits >> 10 & 31), f64::from(bits & 1023));
    match exponent {
        0 => sign * fraction * 2_f64.powi(-24),
        31 => panic!("not finite"),
        e => sign * (1.0 + fraction / 1024.0) * 2_f64.powi(e - 15),
    }
}

/// Decodes PosiStageNet's first tracker, or `None` for a packet of names; the mark is its validity.
pub fn psn(packet: &[u8]) -> Option<Said> {
    let (kind, content) = chunks(packet).remove(0);
    if kind == 0x6756 {
        return None;
    }
    assert_eq!(kind, 0x6755);
    let parts = chunks(content);
    assert_eq!(parts[0].1.len(), 12, "the header");
    let (_, tracker) = chunks(parts.iter().find(|(id, _)| *id == 1).unwrap().1).remove(0);
    let fields = chunks(tracker);
    let float = |bytes: &[u8]| f64::from(f32::from_le_bytes(bytes[..4].try_into().unwrap()));
    let field = |wanted| fields.iter().find(|(id, _)| *id == wanted).map(|(_, bytes)| float(bytes));
    Some(Said { x: field(0), mark: field(3).unwrap().to_string() })
}

fn chunks(mut bytes: &[u8]) -> Vec<(u32, &[u8])> {
    let mut found = Vec::new();
    while !bytes.is_empty() {
        let head = u32::from_le_bytes(bytes[..4].try_into().unwrap());
        let (content, rest) = bytes[4..].split_at((head >> 16 & 0x7FFF) as usize);
        found.push((head & 0xFFFF, content));
        bytes = rest;
    }
    found
}

/// An OTP point: position in metres and the three angles in degrees, each if it is there.
pub struct OtpPoint {
    pub number: u32,
    pub time_us: u64,
    pub position_m: Option<[f64; 3]>,
    pub angles_deg: Option<[f64; 3]>,
}

/// Decodes OTP's transforms, or `None` for an advertisement (here: an answer).
pub fn otp(packet: &[u8]) -> Option<Vec<OtpPoint>> {
    let two = |at: usize| usize::from(u16::from_be_bytes([packet[at], packet[at + 1]]));
    let four = |at: usize| u32::from_be_bytes(packet[at..at + 4].try_into().unwrap());
    assert_eq!((&packet[..12], two(14) + 16), (&b"OTP-E1.59\0\0\0"[..], packet.len()));
    if two(12) == 2 {
        return None;
    }
    // The OTP layer has 79 bytes, the transform layer 18.
    assert_eq!((two(12), two(79), two(81) + 83, packet[92]), (1, 1, packet.len(), 0x80), "a full set of points");
    let (mut at, mut points) = (97, Vec::new());
    while at < packet.len() {
        assert_eq!(two(at), 1);
        let end = at + 4 + two(at + 2);
        let time_us = u64::from_be_bytes(packet[at + 11..at + 19].try_into().unwrap());
        let mut point = OtpPoint { number: four(at + 7), time_us, position_m: None, angles_deg: None };
        at += 24;
        while at < end {
            assert_eq!(two(at), 0, "ESTA's module");
            let (number, data, next) = (two(at + 4), at + 6, at + 4 + two(at + 2));
            let three = |from: usize| [0, 4, 8].map(|k| four(from + k));
            match number {
                1 => {
                    assert_eq!(packet[data], 0, "micrometres");
                    point.position_m = Some(three(data + 1).map(|v| f64::from(v as i32) / 1e6));
                }
                3 => point.angles_deg = Some(three(data).map(|v| f64::from(v) / 1e6)),
                2 | 4 => assert_eq!(next - data, 24),
                other => panic!("module {other}"),
            }
            at = next;
        }
        assert_eq!(at, end);
        points.push(point);
    }
    Some(points)
}

/// Returns the packet with which an OTP consumer asks for position, rotation and their velocities,
/// and the one with which it asks for systems.
pub fn otp_questions() -> [Vec<u8>; 2] {
    let packet = |vector: u8, list: &[u8]| {
        let list = [&[0, 1, 0, list.len() as u8], list].concat();
        let inner = [&[0, vector, 0, (list.len() + 4) as u8, 0, 0, 0, 0], &list[..]].concat();
        let mut header = vec![0; 63];
        header[31..35].copy_from_slice(b"desk");
        [b"OTP-E1.59\0\0\0\0\x02\0", &[(63 + inner.len()) as u8][..], &header, &inner].concat()
    };
    [packet(1, &[0, 0, 0, 0, 0, 0, 0, 2, 0, 0, 0, 4]), packet(3, &[0; 5])]
}

/// Decodes an OSC bundle with /pose and possibly /status, whose word and confidence are the mark.
pub fn osc(packet: &[u8]) -> Said {
    assert_eq!(&packet[..8], b"#bundle\0");
    let (mut rest, mut said) = (&packet[16..], Said { x: None, mark: String::new() });
    while !rest.is_empty() {
        let length = u32::from_be_bytes(rest[..4].try_into().unwrap()) as usize;
        let (message, tail) = rest[4..].split_at(length);
        rest = tail;
        let (address, message) = text(message);
        let (types, arguments) = text(message);
        if address.ends_with("/pose") {
            assert_eq!(types, ",ffffff");
            said.x = Some(f64::from(f32::from_be_bytes(arguments[..4].try_into().unwrap())));
        } else if address.ends_with("/status") {
            assert_eq!(types, ",sfi");
            let (word, numbers) = text(arguments);
            said.mark = format!("{word} {}", f32::from_be_bytes(numbers[..4].try_into().unwrap()));
        } else {
            panic!("{address}");
        }
    }
    said
}

/// Decodes an OSC string, which is padded with zeros to four bytes.
fn text(bytes: &[u8]) -> (String, &[u8]) {
    let end = bytes.iter().position(|b| *b == 0).unwrap();
    (String::from_utf8(bytes[..end].to_vec()).unwrap(), &bytes[(end / 4 + 1) * 4..])
}

/// Decodes a JSON line, for the camera or the first object; the mark is the state, and what else
/// the line says about the pose.
pub fn json(line: &str, of_object: bool) -> Said {
    let line: Value = serde_json::from_str(line).unwrap();
    let body = if of_object { &line["objects"][0] } else { &line };
    let mut mark = body["state"].as_str().unwrap().to_owned();
    for key in ["predicted", "held", "blended"] {
        if body.get(key).is_some() {
            assert_eq!(body[key], true);
            mark += &format!(" {key}");
        }
    }
    if let Some(reason) = body.get("withheld") {
        assert!(reason.as_str().is_some_and(|reason| !reason.is_empty()));
        mark += " withheld";
    }
    Said { x: body["pose"]["position_m"][0].as_f64(), mark }
}

/// Returns the next WebSocket message, or `None` once the other side has closed.
#[cfg(feature = "http")]
pub fn web_socket_message(stream: &mut std::net::TcpStream) -> Option<String> {
    use std::io::{ErrorKind, Read};

    let mut head = [0; 2];
    match stream.read_exact(&mut head) {
        Ok(()) => {}
        Err(e) if e.kind() == ErrorKind::UnexpectedEof || e.kind() == ErrorKind::ConnectionReset => return None,
        Err(e) => panic!("{e}"),
    }
    assert_eq!(head[0] & 0x70, 0, "no extension");
    let length = match head[1] {
        126 => {
            let mut bytes = [0; 2];
            stream.read_exact(&mut bytes).unwrap();
            usize::from(u16::from_be_bytes(bytes))
        }
        short => usize::from(short),
    };
    let mut content = vec![0; length];
    stream.read_exact(&mut content).unwrap();
    match head[0] & 0x0F {
        1 => Some(String::from_utf8(content).unwrap()),
        8 => None,
        other => panic!("frame of kind {other}"),
    }
}
