use rosc::{OscBundle, OscMessage, encoder};

use super::*;
use crate::protocols::psn::PsnHeader;

#[test]
fn packets_become_lines() {
    let packet = FreedPacket {
        camera_id: 7,
        pan_deg: -12.5,
        tilt_deg: 3.25,
        roll_deg: 0.0,
        position_mm: [1.0, -2.5, 1600.0],
        zoom: 4800,
        focus: 0,
        spare: 1,
    };
    let wanted = "camera 7 pan -12.5000 tilt 3.2500 roll 0.0000 deg, x 1.00 y -2.50 z 1600.00 mm, zoom 4800 focus 0 spare 0x0001";
    assert_eq!(line(Spoken::Freed, &packet.encode().0), wanted);
    let info = PsnPacket::Info(PsnHeader::default(), "s".to_owned(), vec![(1, "camera".to_owned())]);
    assert_eq!(line(Spoken::Psn, &info.encode().unwrap()), "info frame 0: s: 1 camera");
    let sample = opentrackio::datagram(opentrackio::Encoding::Json, 4, br#"{"a":1}"#).unwrap();
    assert_eq!(line(Spoken::OpenTrackIo, &sample), r##"#4 {"a":1}"##);
    assert!(line(Spoken::Freed, b"hello").starts_with("5 bytes: 5 bytes are not a FreeD"));
    assert!(line(Spoken::Osc, b"hello").contains("not an OSC packet"));
    assert_eq!(line(Spoken::Json, b"{\"state\":\"lost\", \"x\": 1.50}\n"), "{\"state\":\"lost\", \"x\": 1.50}");
    assert_eq!(line(Spoken::Json, b"[1]").split_once(" (").unwrap().0, "3 bytes: it is not a JSON object");
    assert_eq!(line(Spoken::Json, b"\xff"), "1 bytes: it is not UTF-8; check the sender's port");
    let deep = [b"{\"a\":".as_slice(), &[b'['; 30_000]].concat();
    assert!(line(Spoken::Json, &deep).starts_with("30005 bytes: it is not a JSON object"), "nesting ends, with a sentence");
}

fn message(args: Vec<OscType>) -> Vec<u8> {
    encoder::encode(&OscPacket::Message(OscMessage { addr: "/a".to_owned(), args })).unwrap()
}

#[test]
fn every_time_tag_has_a_line() {
    let tag = |seconds, fractional| OscType::Time(OscTime { seconds, fractional });
    for (time, wanted) in [
        (tag(0, 1), "/a (t) immediately"),
        (tag(0, 0), "/a (t) 2036-02-07T06:28:16.000000Z"),
        (tag(2_208_988_799, u32::MAX), "/a (t) 2106-02-07T06:28:15.999999Z"),
        (tag(2_208_988_800, 1 << 31), "/a (t) 1970-01-01T00:00:00.500000Z"),
        (tag(u32::MAX, u32::MAX), "/a (t) 2036-02-07T06:28:15.999999Z"),
        (OscType::Array(rosc::OscArray { content: vec![tag(0, 1), OscType::Nil] }), "/a [(t) immediately (N)]"),
    ] {
        assert_eq!(line(Spoken::Osc, &message(vec![time.clone()])), wanted, "{time:?}");
    }
}

#[test]
fn a_long_blob_is_counted_not_shown() {
    assert_eq!(line(Spoken::Osc, &message(vec![OscType::Blob(vec![0x1b, 7])])), "/a (b) 0x1B07");
    let long = line(Spoken::Osc, &message(vec![OscType::Blob(vec![0xAB; 60_000])]));
    assert!(long.len() < 120 && long.ends_with("… of 60000 bytes"), "{long}");
}

/// Returns a string with its padding.
fn filled(text: &[u8]) -> Vec<u8> {
    let mut bytes = [text, b"\0"].concat();
    bytes.resize(bytes.len().next_multiple_of(4), 0);
    bytes
}

fn bundle(messages: &[Vec<u8>]) -> Vec<u8> {
    let elements = messages.iter().flat_map(|m| [&u32::try_from(m.len()).unwrap().to_be_bytes(), m.as_slice()].concat());
    b"#bundle\0\0\0\0\0\0\0\0\x01".iter().copied().chain(elements).collect()
}

#[test]
fn packets_unknown_to_the_decoder_are_still_shown() {
    let of = |parts: &[&[u8]]| parts.concat();
    let symbol = of(&[&filled(b"/b"), &filled(b",S"), &filled(b"symbol")]);
    let untagged = filled(b"/info");
    for (packet, wanted) in [
        (untagged.clone(), "/info (no type tags, 0 bytes)"),
        (of(&[&filled(b"/go"), &1.5_f32.to_be_bytes()]), "/go (no type tags, 4 bytes)"),
        (symbol.clone(), "/b (S) symbol"),
        (of(&[&filled(b"/cue"), &filled(b",s"), &filled(b"B\xFChne")]), "/cue B\\xfchne"),
        (of(&[&filled(b"/c\xFC"), &filled(b",i"), &[0, 0, 0, 9]]), "/c\\xfc 9"),
        (
            of(&[&filled(b"/m"), &filled(b",iSfT[i]"), &[0, 0, 0, 9], &filled(b"x"), &2.5_f32.to_be_bytes(), &[0, 0, 0, 1]]),
            "/m 9 (S) x 2.5000 (T)[ 1]",
        ),
        (of(&[&filled(b"/u"), &filled(b",iQ"), &[0, 0, 0, 9, 1, 2, 3, 4]]), "/u 9 (Q) and 4 bytes that cannot be read"),
        (of(&[&filled(b"/cut"), &filled(b",h"), &[0, 0, 0, 9]]), "/cut (h) and 4 bytes that cannot be read"),
        (bundle(&[message(vec![OscType::Int(4)]), symbol]), "/a 4 | /b (S) symbol"),
        (
            bundle(&[message(vec![OscType::Int(4)]), untagged, b"junk".to_vec()]),
            "/a 4 | /info (no type tags, 0 bytes) | (4 bytes that are not a message)",
        ),
        (bundle(&[]), "#bundle (empty)"),
    ] {
        assert_eq!(line(Spoken::Osc, &packet), wanted);
    }
    let mut cut = bundle(&[message(vec![OscType::Int(4)])]);
    cut.truncate(cut.len() - 4);
    assert_eq!(line(Spoken::Osc, &cut), "/a (i) and 0 bytes that cannot be read (cut off, 8 of 12 bytes)");
}

/// Returns bundles nested this deep.
fn nested_bundles(levels: usize) -> Vec<u8> {
    let mut packet = message(vec![OscType::Int(5)]);
    for _ in 0..levels {
        let length = u32::try_from(packet.len()).unwrap().to_be_bytes();
        packet = [b"#bundle\0\0\0\0\0\0\0\0\x01".as_slice(), &length, &packet].concat();
    }
    packet
}

fn nested_arrays(levels: usize) -> Vec<u8> {
    let mut packet = [b"/a\0\0,".as_slice(), &b"[".repeat(levels), b"T", &b"]".repeat(levels), b"\0"].concat();
    packet.resize(packet.len().next_multiple_of(4), 0);
    packet
}

#[test]
fn deeply_nested_packets_are_refused() {
    assert_eq!(line(Spoken::Osc, &nested_bundles(MAX_LEVELS - 1)), "/a 5");
    assert!(line(Spoken::Osc, &nested_arrays(MAX_LEVELS)).starts_with("/a [[["));
    for packet in [nested_bundles(MAX_LEVELS), nested_bundles(3000), nested_arrays(MAX_LEVELS + 1), nested_arrays(32_000)] {
        assert!(line(Spoken::Osc, &packet).contains("nested more than 16 levels deep"));
    }
    // Siblings do not nest.
    let element = OscPacket::Message(OscMessage { addr: "/b".to_owned(), args: vec![OscType::Bool(true)] });
    let bundle = OscBundle { timetag: OscTime { seconds: 0, fractional: 1 }, content: vec![element; 1000] };
    let siblings = encoder::encode(&OscPacket::Bundle(bundle)).unwrap();
    assert_eq!(line(Spoken::Osc, &siblings).split(" | ").count(), 1000);
}

#[test]
fn false_lengths_allocate_nothing() {
    for (announced, payload) in [(b"\x9b\xff\xff\xff\xff\xff\xff\xff\xff", 9), (b"\x7b\xff\xff\xff\xff\xff\xff\xff\xff", 9)] {
        let datagram = opentrackio::datagram(opentrackio::Encoding::Cbor, 1, &announced[..payload]).unwrap();
        assert!(line(Spoken::OpenTrackIo, &datagram).contains("cannot be read"));
    }
    let deep = opentrackio::datagram(opentrackio::Encoding::Cbor, 1, &[0x81; 30_000]).unwrap();
    assert!(line(Spoken::OpenTrackIo, &deep).contains("cannot be read"));
    let deep = opentrackio::datagram(opentrackio::Encoding::Json, 1, &b"[".repeat(30_000)).unwrap();
    assert!(line(Spoken::OpenTrackIo, &deep).contains("cannot be read"));
}
