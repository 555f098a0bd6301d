use super::*;
use crate::protocols::camera_packet::Ring;
use crate::protocols::opentrackio::decode;
use crate::publish::golden::golden_report;
use crate::publish::report::Withheld;
use crate::timecode::TimecodeRate;

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
fn the_golden_pose_has_no_angles_in_either_encoding() {
    for encoding in [Encoding::Json, Encoding::Cbor] {
        let sent = datagrams(&mut encoder(encoding), &golden_report(State::Tracking));
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
        // 22:13:20 UTC; 40 ms are one frame at 30 per second.
        let timecode = &sample["timing"]["timecode"];
        assert_eq!([&timecode["hours"], &timecode["minutes"], &timecode["seconds"], &timecode["frames"]], [22, 13, 20, 1]);
        assert_eq!(sample["static"]["camera"]["activeSensorResolution"], json!({"width": 640, "height": 480}));
    }
}

#[test]
fn samples_are_numbered_unique_and_static_is_sent_once() {
    let mut encoder = encoder(Encoding::Json);
    let samples: Vec<_> = (0..3).map(|_| decode(&datagrams(&mut encoder, &golden_report(State::Tracking))[0]).unwrap()).collect();
    assert_eq!(samples.iter().map(|(n, _)| *n).collect::<Vec<_>>(), [1, 2, 3]);
    assert_ne!(samples[0].1["sampleId"], samples[1].1["sampleId"]);
    assert_eq!(samples[0].1["sourceId"], samples[1].1["sourceId"]);
    assert!(samples[0].1["static"].is_object() && samples[1].1["static"].is_null());
}

#[test]
fn a_loss_has_a_status_and_no_pose() {
    for (state, withheld, word) in [
        (State::Lost, None, "Optical Lost"),
        (State::Searching, None, "Location Searching"),
        (State::Stale, None, "I/O Error"),
        (State::Lost, Some(Withheld::TooFast), "Optical Unstable"),
    ] {
        let mut report = golden_report(state);
        (report.bodies[0].withheld, report.bodies[0].pose) = (withheld, None);
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
    let timecode = time_of_day(Timestamp::from_ns(999_999_999), 240.0);
    assert!(timecode["frames"].as_u64().unwrap() < 120 && timecode["frameRate"] == json!({"num": 240, "denom": 2}));
}

#[test]
fn the_timecode_is_the_productions_and_absent_while_unknown() {
    let stamped = |state| StampedTimecode { code: "01:02:03;04".parse().unwrap(), fraction: 0.5, rate: TimecodeRate::Fps29_97Drop, state };
    let wanted =
        json!({"hours": 1, "minutes": 2, "seconds": 3, "frames": 4, "frameRate": {"num": 30_000, "denom": 1001}, "dropFrame": true});
    for (timecode, wanted, notes) in [
        (ReportedTimecode::Known(stamped(TimecodeState::Locked)), &wanted, Value::Null),
        (ReportedTimecode::Known(stamped(TimecodeState::FreeWheeling { for_s: 2.0 })), &wanted, json!("timecode free-wheeling")),
        (ReportedTimecode::Unknown, &Value::Null, json!("no timecode")),
    ] {
        let report = Report { timecode, ..golden_report(State::Tracking) };
        let (_, sample) = decode(&datagrams(&mut encoder(Encoding::Json), &report)[0]).unwrap();
        assert_eq!((&sample["timing"]["timecode"], &sample["tracker"]["notes"]), (wanted, &notes));
    }
    // At twice its rate, the second half of a frame is its sub-frame 1.
    let timecode = ReportedTimecode::Known(stamped(TimecodeState::Locked));
    let report = Report { timecode, rate_hz: 59.94, ..golden_report(State::Tracking) };
    let (_, sample) = decode(&datagrams(&mut encoder(Encoding::Json), &report)[0]).unwrap();
    assert_eq!(sample["timing"]["timecode"]["subFrame"], 1);
}

#[test]
fn the_clock_is_locked_or_not_and_has_a_frequency_only_on_its_frames() {
    let quality = ClockQuality { is_synchronised: true, max_error_s: 0.002, frequency_ppm: -3.0, tai_offset_s: None };
    let of = |clock, is_on_clock| {
        let report = Report { clock, is_on_clock, rate_hz: 59.94, ..golden_report(State::Tracking) };
        decode(&datagrams(&mut encoder(Encoding::Json), &report)[0]).unwrap().1["timing"]["synchronization"].clone()
    };
    assert_eq!(of(None, false), Value::Null);
    assert_eq!(of(Some(quality), false), json!({"locked": true, "source": "ntp"}));
    let frequency = json!({"num": 60_000, "denom": 1001});
    let free = ClockQuality { is_synchronised: false, ..quality };
    assert_eq!(of(Some(free), true), json!({"locked": false, "source": "ntp", "frequency": frequency}));
}

#[test]
fn zoom_and_focus_of_another_device_are_encoders() {
    let mut encoder = OpenTrackIoEncoder::new(&settings(Encoding::Json), None, "studio");
    let mut report = golden_report(State::Tracking);
    let lens = |encoder: &mut OpenTrackIoEncoder, report: &Report| encoder.sample(report, &report.bodies[0])["lens"].clone();
    assert_eq!(lens(&mut encoder, &report), Value::Null);
    report.rings = Rings { zoom: Some(Ring::Normalised(0.25)), focus: Some(Ring::Raw(9.0)) };
    assert_eq!(lens(&mut encoder, &report), json!({"encoders": {"zoom": 0.25}, "rawEncoders": {"focus": 9}}));
}
