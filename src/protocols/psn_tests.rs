use nalgebra::Matrix3;
use proptest::prelude::*;

use super::super::body_pose::PanTiltRoll;
use super::super::golden::bytes_of;
use super::*;

const GOLDEN_INFO: &str = "56672e8000000c00e8030000000000000203050101000800737461676563616d02000e8001000a800000060063616d657261";
const GOLDEN_DATA: &str = "55676c8000000c00d00700000000000002030601010058800100548000000c000000803f000000400000404001000c00cdcccc3dcdcc4c3e9a99993e02000c00000000000000c03f000000000300040052b85e3f04000c0000000000000000000000000006000800cf07000000000000";

#[test]
fn golden_packets() {
    let header = PsnHeader { timestamp_us: 1000, frame_id: 5, packets: 1 };
    let info = PsnPacket::Info(header, "stagecam".to_owned(), vec![(1, "camera".to_owned())]);
    assert_eq!(info.encode().unwrap(), bytes_of(GOLDEN_INFO));
    assert_eq!(PsnPacket::decode(&info.encode().unwrap()), Ok(info));
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
    assert_eq!(data.encode().unwrap(), bytes_of(GOLDEN_DATA));
    assert_eq!(PsnPacket::decode(&data.encode().unwrap()), Ok(data));
}

#[test]
fn oversized_chunks_are_refused() {
    let names = |bytes| PsnPacket::Info(PsnHeader::default(), String::new(), vec![(1, "x".repeat(bytes))]);
    // The header, the system, the list, a tracker and its name: 4 bytes each, and 12 of the header.
    assert_eq!(PsnPacket::decode(&names(32_767 - 32).encode().unwrap()), Ok(names(32_767 - 32)));
    assert_eq!(names(32_767 - 31).encode(), Err(PsnError::TooLong));
    assert_eq!(names(100_000).encode(), Err(PsnError::TooLong));
}

#[test]
fn the_rotation_vector_is_the_mirrored_rotation() {
    // A receiver in PSN's axes that uses Rodrigues' formula must rotate PSN vectors as the stage
    // rotates its own.
    let pose = Pose::<Stage, Body>::new(PanTiltRoll { pan_deg: 30.0, tilt_deg: 20.0, roll_deg: -10.0 }.rotation(), Vector3::zeros());
    let (_, w) = to_psn(&pose);
    let by_receiver = UnitQuaternion::from_scaled_axis(Vector3::from(w.map(f64::from))).to_rotation_matrix().into_inner();
    let mirror = Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0);
    assert!((by_receiver - mirror * pose.rotation_matrix() * mirror).norm() < 1e-6);
}

proptest! {
    #[test]
    fn poses_round_trip_in_single_precision(
        pan_deg in -180.0..180.0, tilt_deg in -90.0..=90.0, roll_deg in -180.0..180.0, x in -1e4..1e4, y in -1e4..1e4, z in -1e4..1e4,
    ) {
        let pose = Pose::new(PanTiltRoll { pan_deg, tilt_deg, roll_deg }.rotation(), Vector3::new(x, y, z));
        let (p, w) = to_psn(&pose);
        let tracker = PsnTracker { id: 3, position_m: Some(p), orientation_rad: Some(w), ..PsnTracker::default() };
        let bytes = PsnPacket::Data(PsnHeader::default(), vec![tracker]).encode().unwrap();
        let PsnPacket::Data(_, trackers) = PsnPacket::decode(&bytes).unwrap() else { panic!("no data packet") };
        let back = from_psn(trackers[0].position_m.unwrap(), trackers[0].orientation_rad.unwrap());
        for (found, given) in back.translation.iter().zip(pose.translation.iter()) {
            prop_assert!((found - given).abs() <= given.abs() * 6e-8);
        }
        prop_assert!(back.angle_to(&pose) < 1e-6);
    }

    #[test]
    fn arbitrary_bytes_are_decoded_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..80), at in 0_usize..112, flip in any::<u8>()) {
        let _ = PsnPacket::decode(&bytes);
        let mut nearly = bytes_of(GOLDEN_DATA);
        let at = at % nearly.len();
        nearly[at] ^= flip;
        let _ = PsnPacket::decode(&nearly);
    }
}
