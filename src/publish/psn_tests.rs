use super::*;
use crate::publish::golden::golden_report;
use crate::record::State;

fn packets(encoder: &mut PsnEncoder, report: &Report) -> Vec<Vec<u8>> {
    let mut sent = Vec::new();
    encoder.encode(report, &mut |packet| sent.push(packet.to_vec()));
    sent
}

fn encoder(names: &[&str]) -> PsnEncoder {
    let names: Vec<Arc<str>> = names.iter().map(|n| Arc::from(*n)).collect();
    PsnEncoder::new(&PsnSettings { system: "stagepose".to_owned(), first_tracker: 7 }, &names, Timestamp::default())
}

#[test]
fn the_golden_pose_is_unrotated_and_four_metres_in_front() {
    let sent = packets(&mut encoder(&["camera"]), &golden_report(State::Tracking));
    let PsnPacket::Data(header, trackers) = PsnPacket::decode(&sent[0]).unwrap() else { panic!("no data packet") };
    assert_eq!((header.frame_id, header.packets, trackers.len(), trackers[0].id), (1, 1, 1, 7));
    assert_eq!((trackers[0].position_m, trackers[0].validity), (Some([0.0, 0.0, -4.0]), Some(1.0)));
    assert!(trackers[0].orientation_rad.unwrap().iter().all(|v| v.abs() < 1e-7));
}

#[test]
fn a_lost_body_is_sent_without_a_pose() {
    let mut report = golden_report(State::Lost);
    report.bodies[0].pose = None;
    let sent = packets(&mut encoder(&["camera"]), &report);
    let PsnPacket::Data(_, trackers) = PsnPacket::decode(&sent[0]).unwrap() else { panic!("no data packet") };
    assert_eq!((trackers[0].position_m, trackers[0].orientation_rad, trackers[0].validity), (None, None, Some(0.0)));
}

#[test]
fn many_bodies_are_split_over_packets_of_one_frame() {
    let mut report = golden_report(State::Tracking);
    report.bodies = vec![report.bodies[0].clone(); 50];
    let sent = packets(&mut encoder(&["camera"; 50]), &report);
    assert!(sent.len() == 3 && sent.iter().all(|p| p.len() <= 1500));
    let mut ids = Vec::new();
    for packet in &sent {
        let PsnPacket::Data(header, trackers) = PsnPacket::decode(packet).unwrap() else { panic!("no data packet") };
        assert_eq!((header.frame_id, header.packets), (1, 3));
        ids.extend(trackers.iter().map(|t| t.id));
    }
    assert_eq!(ids, (7..57).collect::<Vec<u16>>());
}

#[test]
fn names_come_once_a_second() {
    let mut encoder = encoder(&["camera", "cart"]);
    let mut sent = Vec::new();
    for ms in (0..=2000_i64).step_by(100) {
        encoder.repeat(Timestamp::from_ns(ms * 1_000_000), &mut |packet| sent.push(packet.to_vec()));
    }
    assert_eq!(sent.len(), 3);
    let PsnPacket::Info(_, system, names) = PsnPacket::decode(&sent[0]).unwrap() else { panic!("no info packet") };
    assert_eq!((system.as_str(), names), ("stagepose", vec![(7, "camera".to_owned()), (8, "cart".to_owned())]));
}

#[test]
fn long_name_lists_are_split_into_packets_of_one_frame() {
    // Two bytes per letter: a name may only be cut between letters.
    let names: Vec<String> = (0..40).map(|k| format!("{k} {}", "ä".repeat(10 * k))).collect();
    let names: Vec<Arc<str>> = names.iter().map(|n| Arc::from(n.as_str())).collect();
    let settings = PsnSettings { system: "s".repeat(3000), first_tracker: 7 };
    let mut encoder = PsnEncoder::new(&settings, &names, Timestamp::default());
    let mut sent = Vec::new();
    encoder.repeat(Timestamp::default(), &mut |packet| sent.push(packet.to_vec()));
    let mut received = Vec::new();
    for packet in &sent {
        assert!(packet.len() <= 1472, "{} bytes", packet.len());
        let PsnPacket::Info(header, system, names) = PsnPacket::decode(packet).unwrap() else { panic!("no info packet") };
        assert_eq!((header.frame_id, usize::from(header.packets), system.len()), (1, sent.len(), 255));
        received.extend(names);
    }
    assert!(sent.len() > 1);
    assert_eq!(received.iter().map(|(id, _)| *id).collect::<Vec<_>>(), (7..47).collect::<Vec<u16>>());
    assert!(
        received
            .iter()
            .zip(&names)
            .all(|((_, received), name)| name.starts_with(received.as_str()) && received.len() >= name.len().min(254))
    );
}

#[test]
fn a_held_pose_keeps_its_time() {
    let mut report = golden_report(State::Lost);
    report.bodies[0].held = Some(Duration::from_millis(40));
    let sent = packets(&mut encoder(&["camera"]), &report);
    let PsnPacket::Data(header, trackers) = PsnPacket::decode(&sent[0]).unwrap() else { panic!("no data packet") };
    assert_eq!((header.timestamp_us, trackers[0].timestamp_us, trackers[0].validity), (5_052_500, Some(5_000_000), Some(0.0)));
}
