use nalgebra::Matrix3;
use proptest::prelude::*;

use super::*;
use crate::publish::PanTiltRoll;
use crate::publish::golden::{bytes_of, golden_report};
use crate::publish::report::Standing;

const GOLDEN_INFO: &str = "56672e8000000c00e8030000000000000203050101000800737461676563616d02000e8001000a800000060063616d657261";
const GOLDEN_DATA: &str = "55676c8000000c00d00700000000000002030601010058800100548000000c000000803f000000400000404001000c00cdcccc3dcdcc4c3e9a99993e02000c00000000000000c03f000000000300040052b85e3f04000c0000000000000000000000000006000800cf07000000000000";

#[test]
fn golden_packets() {
    let header = PsnHeader { timestamp_us: 1000, frame_id: 5, packets: 1 };
    let info = PsnPacket::Info(header, "stagecam".to_owned(), vec![(1, "camera".to_owned())]);
    assert_eq!(info.encode(), bytes_of(GOLDEN_INFO));
    assert_eq!(PsnPacket::decode(&info.encode()), Ok(info));
    let header = PsnHeader { timestamp_us: 2000, frame_id: 6, packets: 1 };
    let tracker = PsnTracker {
        id: 1,
        position_m: Some([1.0, 2.0, 3.0]),
        speed_m_s: Some([0.1, 0.2, 0.3]),
        orientation_rad: Some([0.0, 1.5, 0.0]),
        validity: Some(0.87),
        acceleration_m_s2: Some([0.0; 3]),
        target_m: None,
        timestamp_us: Some(1999),
    };
    let data = PsnPacket::Data(header, vec![tracker]);
    assert_eq!(data.encode(), bytes_of(GOLDEN_DATA));
    assert_eq!(PsnPacket::decode(&data.encode()), Ok(data));
}

fn packets(encoder: &mut PsnEncoder, report: &Report) -> Vec<Vec<u8>> {
    let mut sent = Vec::new();
    encoder.encode(report, &mut |packet| sent.push(packet.to_vec()));
    sent
}

fn encoder(names: &[&str]) -> PsnEncoder {
    let names: Vec<Arc<str>> = names.iter().map(|n| Arc::from(*n)).collect();
    PsnEncoder::new(&PsnSettings { system: "stagepose".to_owned(), first_tracker: 7 }, &names, 0)
}

#[test]
fn the_golden_pose_is_not_turned_and_four_metres_in_front() {
    let sent = packets(&mut encoder(&["camera"]), &golden_report(Standing::Tracking));
    let PsnPacket::Data(header, trackers) = PsnPacket::decode(&sent[0]).unwrap() else { panic!("no data packet") };
    assert_eq!((header.frame_id, header.packets, trackers.len(), trackers[0].id), (0, 1, 1, 7));
    assert_eq!((trackers[0].position_m, trackers[0].validity), (Some([0.0, 0.0, -4.0]), Some(1.0)));
    assert!(trackers[0].orientation_rad.unwrap().iter().all(|v| v.abs() < 1e-7));
}

#[test]
fn a_lost_body_is_told_without_a_pose() {
    let mut report = golden_report(Standing::Lost);
    report.bodies[0].pose = None;
    let sent = packets(&mut encoder(&["camera"]), &report);
    let PsnPacket::Data(_, trackers) = PsnPacket::decode(&sent[0]).unwrap() else { panic!("no data packet") };
    assert_eq!((trackers[0].position_m, trackers[0].orientation_rad, trackers[0].validity), (None, None, Some(0.0)));
}

#[test]
fn many_bodies_are_split_over_packets_of_one_frame() {
    let mut report = golden_report(Standing::Tracking);
    report.bodies = vec![report.bodies[0].clone(); 50];
    let sent = packets(&mut encoder(&["camera"; 50]), &report);
    assert!(sent.len() == 3 && sent.iter().all(|p| p.len() <= 1500));
    let mut ids = Vec::new();
    for packet in &sent {
        let PsnPacket::Data(header, trackers) = PsnPacket::decode(packet).unwrap() else { panic!("no data packet") };
        assert_eq!((header.frame_id, header.packets), (0, 3));
        ids.extend(trackers.iter().map(|t| t.id));
    }
    assert_eq!(ids, (7..57).collect::<Vec<u16>>());
}

#[test]
fn names_come_once_a_second() {
    let mut encoder = encoder(&["camera", "cart"]);
    let mut sent = Vec::new();
    for ms in (0..=2000_i64).step_by(100) {
        encoder.repeat(ms * 1_000_000, &mut |packet| sent.push(packet.to_vec()));
    }
    assert_eq!(sent.len(), 3);
    let PsnPacket::Info(_, system, names) = PsnPacket::decode(&sent[0]).unwrap() else { panic!("no info packet") };
    assert_eq!((system.as_str(), names), ("stagepose", vec![(7, "camera".to_owned()), (8, "cart".to_owned())]));
}

#[test]
fn many_and_long_names_are_split_over_packets_of_one_frame() {
    // Two bytes a letter: a name may only be cut between letters.
    let names: Vec<String> = (0..40).map(|k| format!("{k} {}", "ä".repeat(10 * k))).collect();
    let names: Vec<Arc<str>> = names.iter().map(|n| Arc::from(n.as_str())).collect();
    let settings = PsnSettings { system: "s".repeat(3000), first_tracker: 7 };
    let mut encoder = PsnEncoder::new(&settings, &names, 0);
    let mut sent = Vec::new();
    encoder.repeat(0, &mut |packet| sent.push(packet.to_vec()));
    let mut told = Vec::new();
    for packet in &sent {
        assert!(packet.len() <= 1472, "{} bytes", packet.len());
        let PsnPacket::Info(header, system, names) = PsnPacket::decode(packet).unwrap() else { panic!("no info packet") };
        assert_eq!((header.frame_id, usize::from(header.packets), system.len()), (0, sent.len(), 255));
        told.extend(names);
    }
    assert!(sent.len() > 1);
    assert_eq!(told.iter().map(|(id, _)| *id).collect::<Vec<_>>(), (7..47).collect::<Vec<u16>>());
    assert!(told.iter().zip(&names).all(|((_, told), name)| name.starts_with(told.as_str()) && told.len() >= name.len().min(254)));
}

#[test]
fn a_held_pose_keeps_its_time() {
    let mut report = golden_report(Standing::Lost);
    report.bodies[0].held_ns = Some(40_000_000);
    let sent = packets(&mut encoder(&["camera"]), &report);
    let PsnPacket::Data(header, trackers) = PsnPacket::decode(&sent[0]).unwrap() else { panic!("no data packet") };
    assert_eq!((header.timestamp_us, trackers[0].timestamp_us, trackers[0].validity), (5_052_500, Some(5_000_000), Some(0.0)));
}

#[test]
fn the_rotation_vector_is_the_mirrored_rotation() {
    // A receiver in PSN's axes that uses Rodrigues' formula must turn PSN vectors as the stage turns its own.
    let pose = Pose::<Stage, Body>::new(PanTiltRoll { pan_deg: 30.0, tilt_deg: 20.0, roll_deg: -10.0 }.rotation(), Vector3::zeros());
    let (_, w) = to_psn(&pose);
    let by_receiver = UnitQuaternion::from_scaled_axis(Vector3::from(w.map(f64::from))).to_rotation_matrix().into_inner();
    let mirror = Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0);
    assert!((by_receiver - mirror * pose.rotation_matrix() * mirror).norm() < 1e-6);
}

proptest! {
    #[test]
    fn poses_come_back_in_single_precision(
        pan_deg in -180.0..180.0, tilt_deg in -90.0..=90.0, roll_deg in -180.0..180.0, x in -1e4..1e4, y in -1e4..1e4, z in -1e4..1e4,
    ) {
        let pose = Pose::new(PanTiltRoll { pan_deg, tilt_deg, roll_deg }.rotation(), Vector3::new(x, y, z));
        let (p, w) = to_psn(&pose);
        let tracker = PsnTracker { id: 3, position_m: Some(p), orientation_rad: Some(w), ..PsnTracker::default() };
        let bytes = PsnPacket::Data(PsnHeader::default(), vec![tracker]).encode();
        let PsnPacket::Data(_, trackers) = PsnPacket::decode(&bytes).unwrap() else { panic!("no data packet") };
        let back = from_psn(trackers[0].position_m.unwrap(), trackers[0].orientation_rad.unwrap());
        for (found, given) in back.translation.iter().zip(pose.translation.iter()) {
            prop_assert!((found - given).abs() <= given.abs() * 6e-8);
        }
        prop_assert!(back.angle_to(&pose) < 1e-6);
    }

    #[test]
    fn any_bytes_are_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..80), at in 0_usize..112, flip in any::<u8>()) {
        let _ = PsnPacket::decode(&bytes);
        let mut nearly = bytes_of(GOLDEN_DATA);
        let at = at % nearly.len();
        nearly[at] ^= flip;
        let _ = PsnPacket::decode(&nearly);
    }
}
