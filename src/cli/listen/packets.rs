//! Formats one packet of each protocol as a line of text.

use rosc::{OscMessage, OscPacket, OscTime, OscType, decoder};

use super::Spoken;
use crate::protocols::freed::FreedPacket;
use crate::protocols::opentrackio;
use crate::protocols::otp::{OtpAddress, OtpHeader, OtpMessage, OtpPoint};
use crate::protocols::psn::{PsnPacket, PsnTracker};
use crate::publish::osc::FROM_1900_TO_1970_S;
use crate::utc;

/// Maximum bytes of a blob that are shown; the rest is counted. Chosen: 64 hexadecimal digits fit a
/// terminal's line. Raised, lines wrap.
const SHOWN_OF_A_BLOB: usize = 32;
/// Maximum nesting of OSC bundles and arrays. Decoding, printing and dropping them recurse once per
/// level, and a datagram has room for 30,000 levels. Chosen: far more than senders use. Raised to
/// thousands, a forged datagram overflows the stack.
const MAX_LEVELS: usize = 16;

/// Returns one packet as a line; names in it are not escaped.
pub(super) fn line(protocol: Spoken, bytes: &[u8]) -> String {
    let decoded = match protocol {
        Spoken::Freed => FreedPacket::decode(bytes).map(|p| freed(&p)).map_err(|e| e.to_string()),
        Spoken::Psn => PsnPacket::decode(bytes).map(|p| psn(&p)).map_err(|e| e.to_string()),
        Spoken::Otp => OtpMessage::decode(bytes).map(|(header, message)| otp(&header, &message)).map_err(|e| e.to_string()),
        Spoken::OpenTrackIo => {
            opentrackio::decode(bytes).map(|(sequence, sample)| format!("#{sequence} {sample}")).map_err(|e| e.to_string())
        }
        Spoken::Osc if nests_too_deep(bytes) => {
            Err(format!("its bundles or arrays are nested more than {MAX_LEVELS} levels deep; check the sender"))
        }
        Spoken::Json => json(bytes),
        Spoken::Osc => osc_packet(bytes).ok_or_else(|| "it is not an OSC packet; check the sender's port".to_owned()),
    };
    decoded.unwrap_or_else(|reason| format!("{} bytes: {reason}", bytes.len()))
}

/// Returns the line as it came, or the place where it is not a JSON object.
fn json(bytes: &[u8]) -> Result<String, String> {
    let text = std::str::from_utf8(bytes).map_err(|_| "it is not UTF-8; check the sender's port".to_owned())?;
    let line = text.trim_end_matches(['\r', '\n']);
    let checked: Result<serde_json::Map<String, serde_json::Value>, _> = serde_json::from_str(line);
    checked.map(|_| line.to_owned()).map_err(|e| format!("it is not a JSON object ({e}); check the sender's port"))
}

fn freed(p: &FreedPacket) -> String {
    let [x, y, z] = p.position_mm;
    format!(
        "camera {} pan {:.4} tilt {:.4} roll {:.4} deg, x {x:.2} y {y:.2} z {z:.2} mm, zoom {} focus {} spare {:#06x}",
        p.camera_id, p.pan_deg, p.tilt_deg, p.roll_deg, p.zoom, p.focus, p.spare
    )
}

fn psn(packet: &PsnPacket) -> String {
    match packet {
        PsnPacket::Info(header, system, names) => {
            let names: Vec<String> = names.iter().map(|(id, name)| format!("{id} {name}")).collect();
            format!("info frame {}: {system}: {}", header.frame_id, names.join(", "))
        }
        PsnPacket::Data(header, trackers) => {
            let trackers: Vec<String> = trackers.iter().map(psn_tracker).collect();
            format!("data frame {}: {}", header.frame_id, trackers.join("; "))
        }
    }
}

fn psn_tracker(tracker: &PsnTracker) -> String {
    let mut text = format!("tracker {}", tracker.id);
    for (what, vector, unit) in [("position", tracker.position_m, "m"), ("orientation", tracker.orientation_rad, "rad")] {
        if let Some([a, b, c]) = vector {
            text += &format!(" {what} {a:.4} {b:.4} {c:.4} {unit}");
        }
    }
    text + &tracker.validity.map_or(String::new(), |v| format!(" validity {v}"))
}

fn otp(header: &OtpHeader, message: &OtpMessage) -> String {
    let what = match message {
        OtpMessage::Transform(transform) => {
            let points: Vec<String> = transform.points.iter().map(|point| otp_point(transform.system, point)).collect();
            format!("{}: {}", if transform.is_full { "all points" } else { "changed points" }, points.join("; "))
        }
        OtpMessage::Modules(modules) => {
            let modules: Vec<String> = modules.iter().map(|module| format!("{:04x}:{}", module.0, module.1)).collect();
            format!("asks for the modules {}", modules.join(", "))
        }
        OtpMessage::Names { is_answer: false, .. } => "asks for names".to_owned(),
        OtpMessage::Names { names, .. } => {
            let names: Vec<String> = names.iter().map(|(address, name)| format!("{} {name}", otp_address(*address))).collect();
            format!("names {}", names.join(", "))
        }
        OtpMessage::Systems { is_answer: false, .. } => "asks for systems".to_owned(),
        OtpMessage::Systems { systems, .. } => format!("systems {systems:?}"),
    };
    format!("{} folio {} page {} of {}: {what}", header.component, header.folio, header.page, header.last_page)
}

fn otp_address(OtpAddress { system, group, point }: OtpAddress) -> String {
    format!("{system}/{group}/{point}")
}

fn otp_point(system: u8, point: &OtpPoint) -> String {
    let address = OtpAddress { system, group: point.group, point: point.point };
    let mut text = format!("point {} priority {} at {} us", otp_address(address), point.priority, point.timestamp_us);
    let mut add = |what: &str, vector: Option<[f64; 3]>, per_unit: f64, unit: &str| {
        if let Some([x, y, z]) = vector.map(|v| v.map(|v| v / per_unit)) {
            text += &format!(" {what} {x:.6} {y:.6} {z:.6}{unit}");
        }
    };
    add("position", point.position_um.map(|v| v.map(|v| v as f64)), 1e6, " m");
    add("velocity", point.velocity.map(|[v, _]| v.map(f64::from)), 1e6, " m/s");
    add("rotation", point.rotation_udeg.map(|v| v.map(f64::from)), 1e6, " deg");
    add("rates", point.rotation_velocity.map(|[v, _]| v.map(f64::from)), 1e3, " deg/s");
    add("scale", point.scale.map(|v| v.map(f64::from)), 1e6, "");
    text + &point.reference.map_or_else(String::new, |address| format!(" in the frame of {}", otp_address(address)))
}

/// Formats a message or bundle; `None` if there is neither an address nor a bundle marker. The
/// nesting has been checked before.
fn osc_packet(bytes: &[u8]) -> Option<String> {
    if !bytes.starts_with(b"#bundle\0") {
        return osc_message(bytes);
    }
    let mut elements = Vec::new();
    let mut rest = bytes.get(16..).unwrap_or_default();
    while let Some((length, behind)) = rest.split_first_chunk::<4>() {
        let length = u32::from_be_bytes(*length) as usize;
        let element = &behind[..length.min(behind.len())];
        let is_whole = element.len() == length;
        // A truncated bundle is not descended into: its levels have not been counted.
        let line = if is_whole { osc_packet(element) } else { osc_message(element) };
        let cut = if is_whole { String::new() } else { format!(" (cut off, {} of {length} bytes)", element.len()) };
        elements.push(line.unwrap_or_else(|| format!("({} bytes that are not a message)", element.len())) + &cut);
        rest = &behind[element.len()..];
    }
    Some(if elements.is_empty() { "#bundle (empty)".to_owned() } else { elements.join(" | ") })
}

/// Formats a message as decoded, or as far as possible without the decoder: senders omit type tags,
/// or use types and letters that the decoder does not know.
fn osc_message(bytes: &[u8]) -> Option<String> {
    if let Ok((_, OscPacket::Message(message))) = decoder::decode_udp(bytes) {
        return Some(format!("{} {}", message.addr, osc_arguments(&message.args)));
    }
    let (address, at) = osc_string(bytes, 0).filter(|(address, _)| address.starts_with(b"/"))?;
    let address = text_of(address);
    match osc_string(bytes, at).filter(|(types, _)| types.starts_with(b",")) {
        Some((types, at)) => Some(address + &loose_arguments(&types[1..], bytes.get(at..).unwrap_or_default())),
        None => Some(format!("{address} (no type tags, {} bytes)", bytes.len().saturating_sub(at))),
    }
}

/// Formats arguments one by one, up to the first whose length is unknown.
fn loose_arguments(types: &[u8], mut data: &[u8]) -> String {
    let mut line = String::new();
    for tag in types {
        let length = match tag {
            b'i' | b'f' | b'c' | b'r' | b'm' => 4,
            b'h' | b't' | b'd' => 8,
            b's' | b'S' => osc_string(data, 0).map_or(usize::MAX, |(_, end)| end.min(data.len())),
            b'b' => data.first_chunk::<4>().map_or(usize::MAX, |n| (u32::from_be_bytes(*n) as usize).saturating_add(4).next_multiple_of(4)),
            b'T' | b'F' | b'N' | b'I' | b'[' | b']' => 0,
            _ => usize::MAX,
        };
        let Some((own, rest)) = data.split_at_checked(length) else {
            return line + &format!(" ({}) and {} bytes that cannot be read", char::from(*tag).escape_default(), data.len());
        };
        line += &match tag {
            b'S' => format!(" (S) {}", own_text(own)),
            b's' => format!(" {}", own_text(own)),
            b'[' | b']' => char::from(*tag).to_string(),
            _ => match decoder::decode_udp(&[b"/\0\0\0,".as_slice(), &[*tag], b"\0\0", own].concat()) {
                Ok((_, OscPacket::Message(OscMessage { args, .. }))) => format!(" {}", osc_arguments(&args)),
                _ => format!(" ({})", char::from(*tag)),
            },
        };
        data = rest;
    }
    line
}

/// Returns the text of a padded string.
fn own_text(bytes: &[u8]) -> String {
    text_of(osc_string(bytes, 0).map_or(bytes, |(text, _)| text))
}

/// Returns a text as it came, or with escapes if it is not UTF-8.
fn text_of(bytes: &[u8]) -> String {
    std::str::from_utf8(bytes).map_or_else(|_| bytes.escape_ascii().to_string(), str::to_owned)
}

fn osc_arguments(arguments: &[OscType]) -> String {
    arguments.iter().map(osc_argument).collect::<Vec<_>>().join(" ")
}

fn osc_argument(argument: &OscType) -> String {
    match argument {
        OscType::Int(v) => v.to_string(),
        OscType::Float(v) => format!("{v:.4}"),
        OscType::String(v) => v.clone(),
        OscType::Array(array) => format!("[{}]", osc_arguments(&array.content)),
        OscType::Blob(bytes) => blob(bytes),
        // The library's formatting of a time panics before 1970, and "immediately" is such a time.
        OscType::Time(tag) => format!("(t) {}", time(*tag)),
        other => other.to_string(),
    }
}

fn blob(bytes: &[u8]) -> String {
    let shown: String = bytes.iter().take(SHOWN_OF_A_BLOB).map(|b| format!("{b:02X}")).collect();
    match bytes.len() {
        0 => "(b)".to_owned(),
        1..=SHOWN_OF_A_BLOB => format!("(b) 0x{shown}"),
        all => format!("(b) 0x{shown}… of {all} bytes"),
    }
}

/// Formats a time tag in UTC. Its seconds count from 1900 and wrap in 2036, so a time before 1970
/// means one after 2036.
fn time(tag: OscTime) -> String {
    if (tag.seconds, tag.fractional) == (0, 1) {
        return "immediately".to_owned();
    }
    let after_1970 = u64::from(tag.seconds.wrapping_sub(FROM_1900_TO_1970_S));
    let us = (u64::from(tag.fractional) * 1_000_000) >> 32;
    let to_the_second = utc::date_and_time(after_1970);
    format!("{}.{us:06}Z", to_the_second.trim_end_matches('Z'))
}

/// Whether bundles or arrays nest deeper than [`MAX_LEVELS`], without recursion. Damaged packets
/// are left to the decoder.
fn nests_too_deep(datagram: &[u8]) -> bool {
    let mut open = vec![(0, datagram.len(), 1)];
    while let Some((begin, end, level)) = open.pop() {
        let packet = &datagram[..end];
        if level > MAX_LEVELS {
            return true;
        }
        let Some((address, mut at)) = osc_string(packet, begin) else { continue };
        if address == b"#bundle" {
            // After the time tag: a length and that many bytes, repeated.
            at += 8;
            while let Some(length) = packet.get(at..).and_then(|rest| rest.first_chunk::<4>()) {
                let element = at + 4;
                at = element.saturating_add(u32::from_be_bytes(*length) as usize);
                if at > end {
                    break;
                }
                open.push((element, at, level + 1));
            }
        } else if let Some((types, _)) = osc_string(packet, at) {
            let mut depth = 0_usize;
            for tag in types {
                match tag {
                    b'[' => depth += 1,
                    b']' => depth = depth.saturating_sub(1),
                    _ => {}
                }
                if depth > MAX_LEVELS {
                    return true;
                }
            }
        }
    }
    false
}

/// Returns the bytes up to the next zero byte and the offset after the padding: OSC pads to a
/// multiple of four.
fn osc_string(packet: &[u8], at: usize) -> Option<(&[u8], usize)> {
    let rest = packet.get(at..)?;
    let length = memchr::memchr(0, rest)?;
    Some((&rest[..length], (at + length + 1).next_multiple_of(4)))
}

#[cfg(test)]
#[path = "packets_tests.rs"]
mod tests;
