use proptest::prelude::*;
use serde_json::json;

use super::super::golden::bytes_of;
use super::*;

#[test]
fn golden_header() {
    let payload = br#"{"protocol":{"name":"OpenTrackIO","version":[1,0,1]},"sourceNumber":1,"transforms":[{"id":"Camera","translation":{"x":1.0,"y":-4.0,"z":1.6},"rotation":{"pan":10.0,"tilt":-3.0,"roll":0.5}}]}"#;
    let bytes = datagram(Encoding::Json, 17, payload).unwrap();
    assert_eq!(bytes[..HEADER], bytes_of("4f54726b000100110000000080bd7af3"));
    let (sequence, sample) = decode(&bytes).unwrap();
    assert_eq!((sequence, &sample["transforms"][0]["rotation"]["pan"]), (17, &json!(10.0)));
}

#[test]
fn fletcher_vectors() {
    for (text, sum) in [("abcde", 0xC3EF), ("abcdef", 0x1855), ("abcdefgh", 0xF824)] {
        assert_eq!(fletcher_16(&[text.as_bytes()]), sum);
        assert_eq!(fletcher_16(&[&text.as_bytes()[..2], &text.as_bytes()[2..]]), sum);
    }
}

#[test]
fn damaged_datagrams_are_refused() {
    let whole = datagram(Encoding::Json, 3, br#"{"protocol":{"name":"OpenTrackIO","version":[1,0,1]}}"#).unwrap();
    assert!(matches!(decode(&whole[..10]), Err(OpenTrackIoError::Identifier)));
    assert!(matches!(decode(&whole[..whole.len() - 1]), Err(OpenTrackIoError::Length { .. })));
    let mut bytes = whole.clone();
    bytes[40] ^= 4;
    assert!(matches!(decode(&bytes), Err(OpenTrackIoError::Checksum { .. })));
    let mut bytes = whole.clone();
    bytes[12] &= 0x7F;
    assert!(matches!(decode(&bytes), Err(OpenTrackIoError::Segment)));
    assert!(datagram(Encoding::Json, 0, &[b' '; 40_000]).is_none());
}

proptest! {
    #[test]
    fn arbitrary_bytes_are_decoded_or_refused(payload in prop::collection::vec(any::<u8>(), 0..200), encoding in 0_u8..4) {
        let mut bytes = datagram(Encoding::Json, 1, &payload).unwrap();
        bytes[5] = encoding;
        let sum = fletcher_16(&[&bytes[..14], &payload]);
        bytes[14..16].copy_from_slice(&sum.to_be_bytes());
        let _ = decode(&bytes);
        let _ = decode(&payload);
    }
}
