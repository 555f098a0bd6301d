use proptest::prelude::*;

use super::super::golden::bytes_of;
use super::*;

/// The header of the consumer in the standard's Appendix B.
fn consumer_header(folio: u32) -> OtpHeader {
    let mut cid = [0; 16];
    cid.copy_from_slice(&bytes_of("54696c7473204035b0206c6967687473"));
    OtpHeader { cid, folio, page: 1, last_page: 1, component: "Lighting-Console-Primary".to_owned() }
}

/// The header of its producer.
fn producer_header(folio: u32) -> OtpHeader {
    let mut cid = [0; 16];
    cid.copy_from_slice(&bytes_of("4d6f766573204039b0206f626a656374"));
    OtpHeader { cid, folio, page: 1, last_page: 1, component: "Automation-Server-Primary".to_owned() }
}

/// Worked by hand, field by field in the standard's order: the head of every packet, and what it
/// wraps.
fn by_hand(vector: &str, length: &str, header: &OtpHeader, inner: &str) -> Vec<u8> {
    let mut name = header.component.as_bytes().to_vec();
    name.resize(32, 0);
    let cid: Vec<u8> = header.cid.to_vec();
    [
        b"OTP-E1.59\0\0\0".to_vec(),
        bytes_of(&format!("{vector}{length}0000")),
        cid,
        bytes_of(&format!("{:08x}{:04x}{:04x}0000000000", header.folio, header.page, header.last_page)),
        name,
        bytes_of(inner),
    ]
    .concat()
}

#[test]
fn advertisements_are_those_of_appendix_b() {
    // Tables B-2 and B-3: a console asks which systems there are, a server answers 1 and 5.
    let (asked, header) = (OtpMessage::Systems { is_answer: false, systems: Vec::new() }, consumer_header(6292));
    let bytes = by_hand("0002", "0050", &header, "0003000d00000000000100050000000000");
    assert_eq!(asked.encode(&header).unwrap(), bytes);
    assert_eq!(OtpMessage::decode(&bytes), Ok((header, asked)));
    let (answered, header) = (OtpMessage::Systems { is_answer: true, systems: vec![1, 5] }, producer_header(100));
    let bytes = by_hand("0002", "0052", &header, "0003000f000000000001000780000000000105");
    assert_eq!(answered.encode(&header).unwrap(), bytes);
    assert_eq!(OtpMessage::decode(&bytes), Ok((header, answered)));
    // Table B-4: it asks for names.
    let (asked, header) = (OtpMessage::Names { is_answer: false, names: Vec::new() }, consumer_header(400));
    let bytes = by_hand("0002", "0050", &header, "0002000d00000000000100050000000000");
    assert_eq!(asked.encode(&header).unwrap(), bytes);
    assert_eq!(OtpMessage::decode(&bytes), Ok((header, asked)));
}

#[test]
fn names_have_fields_of_32_bytes() {
    let address = |point| OtpAddress { system: 1, group: 1000, point };
    let long = format!("{}ü and more", "x".repeat(31));
    let names = vec![(address(1), "Slider B".to_owned()), (address(201), long)];
    let header = producer_header(3000);
    let bytes = OtpMessage::Names { is_answer: true, names }.encode(&header).unwrap();
    // 79 of the OTP layer, 8 and 9 of the two below, 39 for each name.
    assert_eq!(bytes.len(), 79 + 8 + 9 + 2 * 39);
    let Ok((_, OtpMessage::Names { is_answer: true, names })) = OtpMessage::decode(&bytes) else { panic!("no names") };
    assert_eq!(names, [(address(1), "Slider B".to_owned()), (address(201), "x".repeat(31))], "cut between characters");
    assert_eq!(bytes[79 + 17..][..15], bytes_of("0103e800000001536c696465722042")[..]);
}

#[test]
fn a_transform_is_what_was_worked_out_by_hand() {
    let point = OtpPoint {
        priority: 100,
        group: 1000,
        point: 201,
        timestamp_us: 3_599_999_000,
        position_um: Some([1_000_000, -2_500_000, 1]),
        velocity: Some([[-1, 2, 3], [0; 3]]),
        rotation_udeg: Some([0, 359_999_999, 45_000_000]),
        rotation_velocity: Some([[-45_000, 0, 0], [0; 3]]),
        scale: None,
        reference: Some(OtpAddress { system: 1, group: 2, point: 3 }),
    };
    let transform = OtpTransform { system: 1, timestamp_us: 3_600_000_000, is_full: true, points: vec![point] };
    let inner = [
        // The transform: vector, length 148, system, time, full set, reserved.
        "0001 0094 01 00000000d693a400 80 00000000",
        // The point: vector, length 130, priority, group, number, time, options and reserved.
        "0001 0082 64 03e8 000000c9 00000000d693a018 00 00000000",
        // Each module: manufacturer, length, number, data.
        "0000 000f 0001 00 000f4240 ffd9da60 00000001",
        "0000 001a 0002 ffffffff 00000002 00000003 000000000000000000000000",
        "0000 000e 0003 00000000 157529ff 02aea540",
        "0000 001a 0004 ffff5038 00000000 00000000 000000000000000000000000",
        "0000 0009 0006 01 0002 00000003",
    ];
    let inner = inner.concat().replace(' ', "");
    let header = producer_header(326);
    let wanted = by_hand("0001", "00d7", &header, &inner);
    let message = OtpMessage::Transform(transform);
    assert_eq!(message.encode(&header).unwrap(), wanted);
    assert_eq!(OtpMessage::decode(&wanted), Ok((header, message)));
    assert_eq!((wanted.len(), OtpTransform::EMPTY_BYTES + OtpPoint::MAX_BYTES), (97 + 134, 97 + 134));
}

#[test]
fn millimetres_are_read() {
    let point = OtpPoint { position_um: Some([1, 2, 3]), ..OtpPoint::default() };
    let transform = |points| OtpMessage::Transform(OtpTransform { system: 1, points, ..OtpTransform::default() });
    let mut bytes = transform(vec![point.clone()]).encode(&OtpHeader::default()).unwrap();
    bytes[97 + 24 + 6] = 0x80;
    let far = OtpPoint { position_um: Some([1000, 2000, 3000]), ..point };
    assert_eq!(OtpMessage::decode(&bytes).unwrap().1, transform(vec![far]));
}

#[test]
fn what_does_not_fit_is_refused() {
    let far = OtpPoint { position_um: Some([0, 1 << 31, 0]), ..OtpPoint::default() };
    let transform = |points| OtpMessage::Transform(OtpTransform { points, ..OtpTransform::default() }).encode(&OtpHeader::default());
    assert_eq!(transform(vec![far]), Err(OtpError::Far));
    let near = OtpPoint { position_um: Some([0; 3]), ..OtpPoint::default() };
    // 43 bytes each.
    assert!(transform(vec![near.clone(); 31]).is_ok());
    assert_eq!(transform(vec![near; 32]), Err(OtpError::TooLong));
}

#[test]
fn other_protocols_and_damaged_layers_are_refused() {
    let asked = OtpMessage::Modules(OtpModule::STANDARD.to_vec());
    let bytes = asked.encode(&OtpHeader::default()).unwrap();
    assert_eq!(OtpMessage::decode(&bytes).unwrap().1, asked);
    assert_eq!(OtpMessage::decode(b"\0\x10\0\0ASC-E1.17\0\0\0"), Err(OtpError::Kind));
    for length in 12..bytes.len() {
        assert_eq!(OtpMessage::decode(&bytes[..length]), Err(OtpError::Length), "{length} bytes");
    }
    // A footer follows what the length counts.
    assert_eq!(OtpMessage::decode(&[&bytes[..], b"footer"].concat()).unwrap().1, asked);
    // A module of another manufacturer is skipped.
    let point = OtpPoint { scale: Some([1_000_000; 3]), ..OtpPoint::default() };
    let transform = |points| OtpMessage::Transform(OtpTransform { points, ..OtpTransform::default() });
    let mut bytes = transform(vec![point]).encode(&OtpHeader::default()).unwrap();
    bytes[97 + 24] = 0x12;
    assert_eq!(OtpMessage::decode(&bytes).unwrap().1, transform(vec![OtpPoint::default()]));
}

proptest! {
    #[test]
    fn arbitrary_bytes_are_decoded_or_refused(tail in proptest::collection::vec(any::<u8>(), 0..300)) {
        let _ = OtpMessage::decode(&tail);
        let _ = OtpMessage::decode(&[&IDENTIFIER[..], &tail].concat());
    }
}
