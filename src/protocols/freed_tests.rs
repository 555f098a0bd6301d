use nalgebra::{UnitQuaternion, Vector3};
use proptest::prelude::*;

use super::super::body_pose::to_body_axes;
use super::super::golden::{bytes_of, golden_camera};
use super::*;

#[test]
fn golden_packets() {
    let a = FreedPacket {
        camera_id: 1,
        pan_deg: 180.0,
        tilt_deg: 90.0,
        roll_deg: -180.0,
        position_mm: [131_069.0, 131_070.0, 131_071.0],
        zoom: 66_051,
        focus: 263_430,
        spare: 0,
    };
    assert_eq!(a.encode(), (bytes_of("d1015a00002d0000a600007fff407fff807fffc0010203040506000032").try_into().unwrap(), false));
    let b = FreedPacket {
        camera_id: 7,
        pan_deg: -12.345678,
        tilt_deg: 3.25,
        roll_deg: -0.5,
        position_mm: [1234.5, -2345.25, 1600.75],
        zoom: 1000,
        focus: 2000,
        spare: 0x1234,
    };
    assert_eq!(b.encode().0.to_vec(), bytes_of("d107f9d3c101a000ffc0000134a0fdb5b00190300003e80007d012347b"));
    assert_eq!(FreedPacket::decode(&a.encode().0), Ok(a));
}

#[test]
fn the_golden_pose_is_all_zeros_but_for_the_distance() {
    let packet = FreedPacket::of_pose(1, &to_body_axes(&golden_camera()), 0.0);
    let back = FreedPacket::decode(&packet.encode().0).unwrap();
    assert_eq!((back.pan_deg, back.tilt_deg, back.roll_deg, back.position_mm), (0.0, 0.0, 0.0, [0.0, -4000.0, 0.0]));
    let at_the_origin = Pose::new(UnitQuaternion::identity(), Vector3::zeros());
    assert!(FreedPacket::of_pose(1, &at_the_origin, 0.0).encode().0[2..28].iter().all(|b| *b == 0));
}

#[test]
fn bad_packets_are_refused() {
    let (mut bytes, _) = FreedPacket::of_pose(1, &to_body_axes(&golden_camera()), 0.0).encode();
    assert_eq!(FreedPacket::decode(&bytes[..28]), Err(FreedError::Length(28)));
    bytes[28] ^= 1;
    assert!(matches!(FreedPacket::decode(&bytes), Err(FreedError::Checksum { .. })));
    bytes[0] = 0xD0;
    assert_eq!(FreedPacket::decode(&bytes), Err(FreedError::Type(0xD0)));
}

#[test]
fn out_of_range_values_are_clamped_and_reported() {
    let far = Pose::new(UnitQuaternion::identity(), Vector3::new(140.0, -140.0, 0.0));
    let (bytes, is_cut) = FreedPacket::of_pose(1, &far, 0.0).encode();
    assert!(is_cut);
    assert_eq!(FreedPacket::decode(&bytes).unwrap().position_mm, [8_388_607.0 / 64.0, -131_072.0, 0.0]);
}

proptest! {
    #[test]
    fn poses_round_trip_within_the_quantisation(
        pan in -180.0..180.0, tilt in -90.0..=90.0, roll in -180.0..180.0, x in -131.07..131.07, y in -131.07..131.07, z in -131.07..131.07,
    ) {
        let given = PanTiltRoll { pan_deg: pan, tilt_deg: tilt, roll_deg: roll };
        let packet = FreedPacket::of_pose(9, &Pose::new(given.rotation(), Vector3::new(x, y, z)), roll);
        let (bytes, is_cut) = packet.encode();
        prop_assert!(!is_cut);
        let back = FreedPacket::decode(&bytes).unwrap();
        let angles = [back.pan_deg - packet.pan_deg, back.tilt_deg - packet.tilt_deg, back.roll_deg - packet.roll_deg];
        prop_assert!(angles.iter().all(|d| d.abs() <= 1.0 / 65536.0 + 1e-12), "{angles:?}");
        let lengths = [x, y, z].into_iter().zip(back.position_mm).map(|(m, mm)| m * 1e3 - mm);
        prop_assert!(lengths.into_iter().all(|d| d.abs() <= 1.0 / 128.0 + 1e-9));
        // The rotation itself, whatever the angles: three roundings of half a step each.
        let rotated = PanTiltRoll { pan_deg: -back.pan_deg, tilt_deg: back.tilt_deg, roll_deg: back.roll_deg }.rotation();
        prop_assert!(rotated.angle_to(&given.rotation()).to_degrees() <= 3.0 / 65536.0 + 2e-4 * f64::from(tilt.abs() > 89.999));
    }

    #[test]
    fn arbitrary_bytes_are_decoded_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..40)) {
        let _ = FreedPacket::decode(&bytes);
    }
}
