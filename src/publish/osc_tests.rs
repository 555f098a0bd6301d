use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use proptest::prelude::*;
use rosc::decoder;

use super::*;
use crate::geometry::{Body, Pose, Stage};
use crate::protocols::golden::bytes_of;
use crate::publish::golden::golden_report;
use crate::record::State;

fn settings() -> OscSettings {
    let messages = vec![OscMessageKind::Pose, OscMessageKind::Quaternion, OscMessageKind::Status];
    OscSettings { prefix: "/stagepose".to_owned(), messages, values: Vec::new() }
}

fn packets(settings: &OscSettings, reports: &[Report]) -> Vec<Vec<u8>> {
    let mut encoder = OscEncoder::new(settings, "desk 1");
    let mut sent = Vec::new();
    for report in reports {
        encoder.encode(report, &mut |packet| sent.push(packet.to_vec()));
    }
    sent
}

fn messages(packet: &[u8]) -> (OscTime, Vec<OscMessage>) {
    let (rest, OscPacket::Bundle(bundle)) = decoder::decode_udp(packet).unwrap() else { panic!("no bundle") };
    assert!(rest.is_empty());
    let message = |p| match p {
        OscPacket::Message(m) => m,
        OscPacket::Bundle(_) => panic!("a bundle in a bundle"),
    };
    (bundle.timetag, bundle.content.into_iter().map(message).collect())
}

#[test]
fn golden_bundle() {
    let mut report = golden_report(State::Tracking);
    report.bodies[0].pose = Some(Pose::new(UnitQuaternion::identity(), Vector3::new(0.0, -4.0, 0.0)));
    let sent = packets(&OscSettings { messages: vec![OscMessageKind::Status, OscMessageKind::Pose], ..settings() }, &[report]);
    let wanted = [
        "2362756e646c6500", // "#bundle"
        "e8fe6f800a3d70a3", // 1700000000.04 s
        "00000038",
        "2f7374616765706f73652f63616d6572612f73746174757300000000", // /stagepose/camera/status
        "2c73666900000000",
        "747261636b696e6700000000",
        "3f800000",
        "00000011",
        "00000038",
        "2f7374616765706f73652f63616d6572612f706f73650000", // /stagepose/camera/pose
        "2c66666666666600",
        "00000000",
        "c0800000",
        "00000000",
        "00000000",
        "00000000",
        "00000000",
    ]
    .concat();
    assert_eq!(hex(&sent[0]), hex(&bytes_of(&wanted)));
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

#[test]
fn the_golden_pose_has_no_angles() {
    let (_, found) = messages(&packets(&settings(), &[golden_report(State::Tracking)])[0]);
    let addresses: Vec<&str> = found.iter().map(|m| m.addr.as_str()).collect();
    assert_eq!(addresses, ["/stagepose/camera/status", "/stagepose/camera/pose", "/stagepose/camera/quat"]);
    let numbers: Vec<f32> = found[1].args.iter().map(|a| a.clone().float().unwrap()).collect();
    assert_eq!(numbers[..3], [0.0, -4.0, 0.0]);
    assert!(numbers[3..].iter().all(|v| v.abs() < 1e-6));
}

#[test]
fn a_loss_has_a_status_only() {
    let mut report = golden_report(State::Lost);
    report.bodies[0].pose = None;
    let (_, found) = messages(&packets(&settings(), &[report.clone()])[0]);
    assert_eq!(found.len(), 1);
    assert_eq!(found[0].args, [OscType::String("lost".to_owned()), OscType::Float(0.0), OscType::Int(17)]);
    assert!(packets(&OscSettings { messages: vec![OscMessageKind::Pose], ..settings() }, &[report]).is_empty());
}

#[test]
fn osc_values_are_scaled_clamped_and_decimated() {
    let value = |quantity, clamp, every| OscValue {
        address: AddressTemplate::parse("/axis/{body}/{output}").unwrap(),
        quantity,
        scale: -1000.0,
        offset: 50.0,
        clamp,
        every,
    };
    let values = vec![value(Quantity::Y, None, 1), value(Quantity::Y, Some([-10.0, 900.0]), 2)];
    let settings = OscSettings { messages: Vec::new(), values, ..settings() };
    let sent = packets(&settings, &[golden_report(State::Tracking), golden_report(State::Tracking)]);
    let found: Vec<Vec<OscMessage>> = sent.iter().map(|p| messages(p).1).collect();
    assert_eq!(found.iter().map(Vec::len).collect::<Vec<_>>(), [2, 1]);
    assert_eq!(found[0][0], OscMessage { addr: "/axis/camera/desk_1".to_owned(), args: vec![OscType::Float(4050.0)] });
    assert_eq!(found[0][1].args, [OscType::Float(900.0)]);
}

#[test]
fn templates_are_checked() {
    assert_eq!(AddressTemplate::parse("/a/{bodi}"), Err(TemplateError::Field("bodi".to_owned())));
    for bad in ["axis/1", "/", "/a b", "/a/*", "/a/{body", "/ä"] {
        assert_eq!(AddressTemplate::parse(bad), Err(TemplateError::Address(bad.to_owned())), "{bad}");
    }
}

proptest! {
    #[test]
    fn poses_round_trip_in_single_precision(
        a in -1.0..1.0, b in -1.0..1.0, c in -1.0..1.0, d in -1.0..1.0, x in -1e4..1e4, y in -1e4..1e4, z in -1e4..1e4,
    ) {
        prop_assume!(a * a + b * b + c * c + d * d > 1e-3);
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(a, b, c, d));
        let pose = Pose::<Stage, Body>::new(rotation, Vector3::new(x, y, z));
        let mut report = golden_report(State::Tracking);
        report.bodies[0].pose = Some(pose);
        let (_, found) = messages(&packets(&settings(), &[report])[0]);
        let pose_numbers: Vec<f64> = found[1].args.iter().map(|v| f64::from(v.clone().float().unwrap())).collect();
        for (found, given) in pose_numbers.iter().zip(pose.translation.iter()) {
            prop_assert!((found - given).abs() <= given.abs() * 6e-8);
        }
        let angles = PanTiltRoll { pan_deg: pose_numbers[3], tilt_deg: pose_numbers[4], roll_deg: pose_numbers[5] };
        prop_assert!(angles.rotation().angle_to(&rotation) < 1e-6);
        let q: Vec<f64> = found[2].args.iter().map(|v| f64::from(v.clone().float().unwrap())).collect();
        let back = UnitQuaternion::from_quaternion(Quaternion::new(q[3], q[0], q[1], q[2]));
        prop_assert!(back.angle_to(&rotation) < 1e-6);
    }

    #[test]
    fn arbitrary_templates_are_accepted_or_refused(text in ".{0,40}") {
        if let Ok(template) = AddressTemplate::parse(&text) {
            prop_assert!(template.fill("ä b", "/x").starts_with('/'));
        }
    }
}
