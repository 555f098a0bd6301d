use nalgebra::{UnitQuaternion, Vector3};

use super::*;
use crate::protocols::otp_pose::from_otp;
use crate::publish::golden::golden_report;
use crate::record::State;

const CONSOLE: &str = "192.0.2.7:5568";

fn settings() -> OtpSettings {
    OtpSettings {
        component: "stagepose".to_owned(),
        system: 3,
        group: 7,
        first_point: 100,
        priority: 120,
        reference: None,
        listen: "239.159.2.1:5568".parse().unwrap(),
    }
}

/// Returns an encoder that started long ago.
fn encoder(settings: &OtpSettings, names: &[&str]) -> OtpEncoder {
    let names: Vec<Arc<str>> = names.iter().map(|n| Arc::from(*n)).collect();
    OtpEncoder::new(settings, &names, "desk", Timestamp::from_ns(-60_000_000_000))
}

fn ask(encoder: &mut OtpEncoder, now: Timestamp, modules: &[OtpModule]) {
    let packet = OtpMessage::Modules(modules.to_vec()).encode(&OtpHeader::default()).unwrap();
    encoder.hear(now, CONSOLE.parse().unwrap(), &packet);
}

fn sent(encoder: &mut OtpEncoder, report: &Report) -> Vec<(OtpHeader, OtpTransform)> {
    let mut sent = Vec::new();
    encoder.encode(report, &mut |packet| {
        assert!(packet.len() <= MAX_PACKET, "{} bytes", packet.len());
        let Ok((header, OtpMessage::Transform(transform))) = OtpMessage::decode(packet) else { panic!("no transform") };
        sent.push((header, transform));
    });
    sent
}

#[test]
fn it_speaks_only_to_those_who_ask() {
    let mut report = golden_report(State::Tracking);
    let now = report.sent_monotonic;
    let mut encoder = encoder(&settings(), &["camera"]);
    assert!(sent(&mut encoder, &report).is_empty(), "nobody asked");
    ask(&mut encoder, now, &[OtpModule::SCALE]);
    assert!(sent(&mut encoder, &report).is_empty(), "nobody asked for what there is");
    ask(&mut encoder, now, &[OtpModule::POSITION]);
    let [(header, transform)] = &sent(&mut encoder, &report)[..] else { panic!("one page") };
    assert_eq!((header.folio, header.page, header.last_page, header.component.as_str()), (0, 0, 0, "stagepose"));
    assert_eq!((transform.system, transform.is_full, transform.timestamp_us), (3, true, 5_052_500));
    let wanted = OtpPoint {
        priority: 120,
        group: 7,
        point: 100,
        timestamp_us: 5_040_000,
        position_um: Some([0, -4_000_000, 0]),
        ..OtpPoint::default()
    };
    assert_eq!(transform.points, [wanted]);
    ask(&mut encoder, now, &[OtpModule::ROTATION]);
    let again = sent(&mut encoder, &report);
    assert_eq!((again[0].0.folio, again[0].1.points[0].rotation_udeg), (1, Some([0; 3])));
    // Half a minute after the last question it is silent again.
    report.sent_monotonic = now.after(Duration::from_secs(31));
    assert!(sent(&mut encoder, &report).is_empty());
}

#[test]
fn nothing_is_sent_before_all_consumers_could_ask() {
    let report = golden_report(State::Tracking);
    let mut encoder = encoder(&settings(), &["camera"]);
    encoder.begun = report.sent_monotonic.before(Duration::from_millis(11_900));
    ask(&mut encoder, report.sent_monotonic, &[OtpModule::POSITION]);
    assert!(sent(&mut encoder, &report).is_empty());
    encoder.begun = report.sent_monotonic.before(STARTUP);
    assert_eq!(sent(&mut encoder, &report).len(), 1);
}

#[test]
fn a_pose_and_its_velocity_arrive_within_the_numbers_steps() {
    let mut report = golden_report(State::Tracking);
    let pose = Pose::new(UnitQuaternion::from_euler_angles(0.3, -0.2, 2.5), Vector3::new(1.234_567_8, -4.1, 0.000_001_4));
    report.bodies[0].pose = Some(pose);
    report.bodies[0].velocity = Some([Vector3::new(0.5, -0.25, 0.0), Vector3::zeros()]);
    let mut encoder = encoder(&OtpSettings { reference: Some(OtpAddress { system: 1, group: 2, point: 3 }), ..settings() }, &["camera"]);
    ask(&mut encoder, report.sent_monotonic, &OtpModule::STANDARD);
    let point = sent(&mut encoder, &report).remove(0).1.points.remove(0);
    let back = from_otp(point.position_um.unwrap(), point.rotation_udeg.unwrap());
    assert!((back.translation - pose.translation).amax() <= 0.5e-6 + 1e-12);
    assert!(back.rotation.angle_to(&pose.rotation).to_degrees() < 2e-6);
    assert_eq!(point.velocity, Some([[500_000, -250_000, 0], [0; 3]]));
    assert_eq!(point.rotation_velocity, Some([[0; 3]; 2]));
    assert_eq!((point.reference, point.scale), (Some(OtpAddress { system: 1, group: 2, point: 3 }), None));
}

#[test]
fn a_lost_body_is_left_out_and_a_held_one_keeps_its_time() {
    let mut report = golden_report(State::Lost);
    report.bodies = vec![report.bodies[0].clone(); 2];
    report.bodies[0].pose = None;
    report.bodies[1].held = Some(Duration::from_millis(40));
    let mut encoder = encoder(&settings(), &["camera", "cart"]);
    ask(&mut encoder, report.sent_monotonic, &[OtpModule::POSITION]);
    let transform = &sent(&mut encoder, &report)[0].1;
    assert_eq!(transform.points.iter().map(|p| (p.point, p.timestamp_us)).collect::<Vec<_>>(), [(101, 5_000_000)]);
    report.bodies[1].pose = None;
    assert!(sent(&mut encoder, &report).is_empty());
    let too_far = Pose::new(UnitQuaternion::identity(), Vector3::new(0.0, 2148.0, 0.0));
    assert!(!encoder.holds(&too_far));
}

#[test]
fn many_bodies_are_pages_of_one_folio() {
    let mut report = golden_report(State::Tracking);
    report.bodies[0].velocity = Some([Vector3::zeros(); 2]);
    report.bodies = vec![report.bodies[0].clone(); 50];
    let mut encoder =
        encoder(&OtpSettings { reference: Some(OtpAddress { system: 1, group: 2, point: 3 }), ..settings() }, &["camera"; 50]);
    ask(&mut encoder, report.sent_monotonic, &OtpModule::STANDARD);
    let pages = sent(&mut encoder, &report);
    assert_eq!(pages.len(), 5);
    let places: Vec<_> = pages.iter().map(|(header, _)| (header.folio, header.page, header.last_page)).collect();
    assert_eq!(places, [0, 1, 2, 3, 4].map(|page| (0, page, 4)));
    let points: Vec<u32> = pages.iter().flat_map(|(_, transform)| transform.points.iter().map(|p| p.point)).collect();
    assert_eq!(points, (100..150).collect::<Vec<u32>>());
}

#[test]
fn questions_are_answered_to_those_who_asked() {
    let mut encoder = encoder(&settings(), &["camera", "Bühnenwagen"]);
    let console: SocketAddr = CONSOLE.parse().unwrap();
    let now = Timestamp::from_seconds(100.0);
    for question in
        [OtpMessage::Names { is_answer: false, names: Vec::new() }, OtpMessage::Systems { is_answer: false, systems: Vec::new() }]
    {
        encoder.hear(now, console, &question.encode(&OtpHeader::default()).unwrap());
    }
    encoder.hear(now, console, b"anything else");
    let answers = encoder.answers(now.after(Duration::from_secs(5)));
    let decoded: Vec<OtpMessage> = answers.iter().map(|(_, packet)| OtpMessage::decode(packet).unwrap().1).collect();
    assert!(answers.iter().all(|(to, _)| *to == console));
    let address = |point| OtpAddress { system: 3, group: 7, point };
    let names = vec![(address(100), "camera".to_owned()), (address(101), "Bühnenwagen".to_owned())];
    assert_eq!(decoded, [OtpMessage::Names { is_answer: true, names }, OtpMessage::Systems { is_answer: true, systems: vec![3] }]);
}
