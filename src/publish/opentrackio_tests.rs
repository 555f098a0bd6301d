use proptest::prelude::*;

use super::*;
use crate::publish::golden::{bytes_of, golden_report};
use crate::publish::report::Withheld;

fn settings(encoding: Encoding) -> OpenTrackIoSettings {
    OpenTrackIoSettings { encoding, source_number: 1, sensor_width_mm: 4.8, principal_point: PrincipalPoint::Projection }
}

fn encoder(encoding: Encoding) -> OpenTrackIoEncoder {
    let camera = CameraModel::pinhole(640, 480, 600.0, 600.0, 319.5, 239.5).unwrap();
    OpenTrackIoEncoder::new(&settings(encoding), Some(&camera), "studio")
}

fn datagrams(encoder: &mut OpenTrackIoEncoder, report: &Report) -> Vec<Vec<u8>> {
    let mut sent = Vec::new();
    encoder.encode(report, &mut |packet| sent.push(packet.to_vec()));
    sent
}

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
fn the_golden_pose_has_no_angles_in_either_encoding() {
    for encoding in [Encoding::Json, Encoding::Cbor] {
        let sent = datagrams(&mut encoder(encoding), &golden_report(Standing::Tracking));
        assert_eq!(sent.len(), 1);
        assert!(sent[0].len() <= ONE_FRAME, "{} bytes", sent[0].len());
        let (_, sample) = decode(&sent[0]).unwrap();
        let transform = &sample["transforms"][0];
        for angle in ["pan", "tilt", "roll"] {
            assert!(transform["rotation"][angle].as_f64().unwrap().abs() < 1e-12, "{sample}");
        }
        assert_eq!(transform["translation"], json!({"x": 0.0, "y": -4.0, "z": 0.0}));
        assert_eq!(sample["tracker"]["status"], "Optical Good");
        assert_eq!(sample["timing"]["sampleTimestamp"], json!({"seconds": 1_700_000_000, "nanoseconds": 40_000_000}));
        // 22:13:20 UTC; 40 ms are one frame of 30.
        let timecode = &sample["timing"]["timecode"];
        assert_eq!([&timecode["hours"], &timecode["minutes"], &timecode["seconds"], &timecode["frames"]], [22, 13, 20, 1]);
        assert_eq!(sample["static"]["camera"]["activeSensorResolution"], json!({"width": 640, "height": 480}));
    }
}

#[test]
fn numbers_rise_ids_differ_and_the_static_part_comes_once() {
    let mut encoder = encoder(Encoding::Json);
    let samples: Vec<_> = (0..3).map(|_| decode(&datagrams(&mut encoder, &golden_report(Standing::Tracking))[0]).unwrap()).collect();
    assert_eq!(samples.iter().map(|(n, _)| *n).collect::<Vec<_>>(), [1, 2, 3]);
    assert_ne!(samples[0].1["sampleId"], samples[1].1["sampleId"]);
    assert_eq!(samples[0].1["sourceId"], samples[1].1["sourceId"]);
    assert!(samples[0].1["static"].is_object() && samples[1].1["static"].is_null());
}

#[test]
fn a_loss_has_a_status_and_no_pose() {
    for (standing, word) in [
        (Standing::Lost, "Optical Lost"),
        (Standing::Searching, "Location Searching"),
        (Standing::Stale, "I/O Error"),
        (Standing::Withheld(Withheld::TooFast), "Optical Unstable"),
    ] {
        let mut report = golden_report(standing);
        report.bodies[0].pose = None;
        let (_, sample) = decode(&datagrams(&mut encoder(Encoding::Json), &report)[0]).unwrap();
        assert_eq!((&sample["tracker"]["status"], &sample["transforms"]), (&json!(word), &Value::Null));
    }
}

#[test]
fn rates_become_fractions() {
    assert_eq!(
        [29.97, 30.0, 59.94, 25.0, 23.976, 14.5].map(fraction_of),
        [(30_000, 1001), (30, 1), (60_000, 1001), (25, 1), (24_000, 1001), (14_500, 1000)]
    );
    let timecode = timecode(999_999_999, 240.0);
    assert!(timecode["frames"].as_u64().unwrap() < 120 && timecode["frameRate"] == json!({"num": 240, "denom": 2}));
}

#[test]
fn damaged_datagrams_are_refused() {
    let whole = datagrams(&mut encoder(Encoding::Cbor), &golden_report(Standing::Tracking)).remove(0);
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
    fn any_bytes_are_read_or_refused(payload in prop::collection::vec(any::<u8>(), 0..200), encoding in 0_u8..4) {
        let mut bytes = datagram(Encoding::Json, 1, &payload).unwrap();
        bytes[5] = encoding;
        let sum = fletcher_16(&[&bytes[..14], &payload]);
        bytes[14..16].copy_from_slice(&sum.to_be_bytes());
        let _ = decode(&bytes);
        let _ = decode(&payload);
    }
}
