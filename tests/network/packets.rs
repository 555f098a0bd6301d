//! Good packets of every protocol that `listen` knows, and the checksums that let damaged packets
//! pass the first check.

use rosc::{OscArray, OscBundle, OscColor, OscMessage, OscMidiMessage, OscPacket, OscTime, OscType, encoder};
use stagepose::protocols::freed::FreedPacket;
use stagepose::protocols::opentrackio::{Encoding, HEADER, datagram};
use stagepose::protocols::otp::{OtpAddress, OtpHeader, OtpMessage, OtpModule, OtpPoint, OtpTransform};
use stagepose::protocols::psn::{PsnHeader, PsnPacket, PsnTracker};

/// The protocols' names on the command line.
pub const PROTOCOLS: [&str; 6] = ["freed", "psn", "otp", "opentrackio", "osc", "json"];

pub fn good(protocol: &str) -> Vec<Vec<u8>> {
    match protocol {
        "freed" => freed(),
        "psn" => psn(),
        "otp" => otp(),
        "opentrackio" => opentrackio(),
        "json" => {
            vec![br#"{"sequence":12,"state":"tracking","pose":{"position_m":[1.5,-2,1e-9]},"objects":[{"name":"B\u00fchne"}]}"#.to_vec()]
        }
        _ => osc(),
    }
}

/// Corrects the checksum if the protocol has one.
pub fn repaired(protocol: &str, bytes: Vec<u8>) -> Vec<u8> {
    match protocol {
        "freed" if bytes.len() == 29 => {
            let sum = bytes[..28].iter().fold(0x40_u8, |sum, b| sum.wrapping_sub(*b));
            [&bytes[..28], &[sum]].concat()
        }
        "opentrackio" if bytes.len() > HEADER => {
            let encoding = if bytes[5] == 1 { Encoding::Json } else { Encoding::Cbor };
            let sequence = u16::from_be_bytes([bytes[6], bytes[7]]);
            datagram(encoding, sequence, &bytes[HEADER..]).unwrap_or(bytes)
        }
        _ => bytes,
    }
}

fn freed() -> Vec<Vec<u8>> {
    let packet = FreedPacket { pan_deg: -170.5, position_mm: [1200.0, -3400.5, 1600.25], zoom: 4800, ..FreedPacket::default() };
    vec![packet.encode().0.to_vec()]
}

fn psn() -> Vec<Vec<u8>> {
    let header = PsnHeader { timestamp_us: 1_000_000, frame_id: 3, packets: 1 };
    let tracker = |id| PsnTracker {
        id,
        position_m: Some([1.0, 2.0, 3.0]),
        speed_m_s: Some([0.1; 3]),
        orientation_rad: Some([0.2; 3]),
        validity: Some(1.0),
        acceleration_m_s2: Some([0.3; 3]),
        target_m: Some([4.0; 3]),
        timestamp_us: Some(77),
    };
    let names = vec![(1, "camera".to_owned()), (2, "Bühne".to_owned())];
    let packets = [PsnPacket::Data(header, (1..4).map(tracker).collect()), PsnPacket::Info(header, "stage".to_owned(), names)];
    packets.iter().map(|packet| packet.encode().expect("it fits")).collect()
}

fn otp() -> Vec<Vec<u8>> {
    let address = OtpAddress { system: 1, group: 2, point: 3 };
    let point = OtpPoint {
        priority: 100,
        group: 1,
        point: 1,
        timestamp_us: 1_000_000,
        position_um: Some([1, -2, 3]),
        velocity: Some([[4; 3], [0; 3]]),
        rotation_udeg: Some([5; 3]),
        rotation_velocity: Some([[6; 3], [0; 3]]),
        scale: Some([1_000_000; 3]),
        reference: Some(address),
    };
    let header = OtpHeader { component: "Bühne".to_owned(), ..OtpHeader::default() };
    let messages = [
        OtpMessage::Transform(OtpTransform { system: 1, timestamp_us: 9, is_full: true, points: vec![point; 2] }),
        OtpMessage::Modules(OtpModule::STANDARD.to_vec()),
        OtpMessage::Names { is_answer: true, names: vec![(address, "Bühnenwagen".to_owned())] },
        OtpMessage::Systems { is_answer: true, systems: vec![1, 2] },
    ];
    messages.iter().map(|message| message.encode(&header).expect("it fits")).collect()
}

fn opentrackio() -> Vec<Vec<u8>> {
    let sample = serde_json::json!({
        "protocol": {"name": "OpenTrackIO", "version": [1, 0, 1]}, "sampleId": "urn:uuid:1", "tracker": {"status": "Optical Good"},
        "transforms": [{"id": "Camera", "translation": {"x": 1.5, "y": -2.5, "z": 1e-9}}], "lens": [null, true, 18446744073709551615_u64],
    });
    let mut cbor = Vec::new();
    ciborium::into_writer(&sample, &mut cbor).unwrap();
    let json = serde_json::to_vec(&sample).unwrap();
    [(Encoding::Json, json), (Encoding::Cbor, cbor)].map(|(encoding, payload)| datagram(encoding, 7, &payload).unwrap()).into()
}

fn osc() -> Vec<Vec<u8>> {
    let time = |seconds, fractional| OscTime { seconds, fractional };
    let args = vec![
        OscType::Int(-1),
        OscType::Float(1.5),
        OscType::String("tracking".to_owned()),
        OscType::Blob(vec![1, 2, 3, 4, 5]),
        OscType::Time(time(0, 1)),
        OscType::Time(time(2_208_988_799, u32::MAX)),
        OscType::Long(i64::MIN),
        OscType::Double(1e300),
        OscType::Char('\u{1b}'),
        OscType::Color(OscColor { red: 1, green: 2, blue: 3, alpha: 4 }),
        OscType::Midi(OscMidiMessage { port: 1, status: 2, data1: 3, data2: 4 }),
        OscType::Bool(true),
        OscType::Array(OscArray { content: vec![OscType::Int(5), OscType::Array(OscArray { content: vec![OscType::Time(time(5, 5))] })] }),
        OscType::Nil,
        OscType::Inf,
    ];
    let all = OscPacket::Message(OscMessage { addr: "/stagepose/camera/all".to_owned(), args });
    let plain = OscPacket::Message(OscMessage { addr: "/a".to_owned(), args: vec![] });
    let bundle = |content| OscPacket::Bundle(OscBundle { timetag: time(0, 1), content });
    let nested = bundle(vec![plain.clone(), bundle(vec![all.clone(), bundle(vec![plain.clone()])])]);
    [all, plain, nested].iter().map(|packet| encoder::encode(packet).unwrap()).collect()
}
