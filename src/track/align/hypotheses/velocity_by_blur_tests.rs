//! The velocity by blur, on rendered frames of moving cameras, under global and rolling shutters.

use image::GrayImage;
use nalgebra::{Vector2, Vector3, Vector6};

use super::angular_velocity_by_twist;
use crate::camera::Shutter;
use crate::motion::{Motion, MotionEstimate, MotionMatrix};
use crate::track::align::{AlignRequest, Start};
use crate::track::align::{Aligner, Alignment, CameraRays};
use crate::track::frame::frame_levels::FrameLevels;
use crate::track::synthetic::{cloth, facing, lens, moving_view, prepared};

const SIZE: [u32; 2] = [480, 360];
const NEAR_M: f64 = 3.4;
/// From here the picture is too small for the coarsest level.
const FAR_M: f64 = 15.0;
const GLOBAL: Shutter = Shutter { readout_s: 0.0, exposure_s: 0.012 };
const ROLLING: Shutter = Shutter { readout_s: 0.02, exposure_s: 0.012 };

fn motion(distance_m: f64, velocity: [f64; 3], angular_velocity: [f64; 3]) -> Motion {
    let pose = facing(0.02, -0.03, Vector3::new(0.1, 0.05, distance_m)).inverse();
    let axes = pose.rotation_matrix();
    // Given in camera axes.
    Motion { velocity: axes * Vector3::from(velocity), angular_velocity: Vector3::from(angular_velocity), ..Motion::still(pose) }
}

fn blurred(motion: &Motion, shutter: &Shutter) -> GrayImage {
    moving_view(&cloth(1), motion, shutter, &lens(SIZE[0], SIZE[1]))
}

/// Aligns a frame from the true pose, with an unknown motion. `exposure_s`: the exposure that the
/// aligner assumes.
fn found(frame: &GrayImage, truth: &Motion, shutter: &Shutter, exposure_s: f64) -> Alignment {
    let expected = MotionEstimate::unseen(truth.pose, truth.pose.translation.norm(), 0.02, 0.006);
    found_from(frame, &expected, shutter, exposure_s)
}

fn found_from(frame: &GrayImage, expected: &MotionEstimate, shutter: &Shutter, exposure_s: f64) -> Alignment {
    let mut levels = FrameLevels::default();
    levels.update(frame);
    let mut aligner = Aligner::new(&prepared(vec![cloth(1)]), Shutter { exposure_s, ..*shutter });
    aligner
        .align(&mut levels, &CameraRays::new(lens(SIZE[0], SIZE[1]), None), &AlignRequest::new(Start::found(expected), false))
        .expect("the picture agrees")
        .alignment
}

/// Returns how fast the middle of the picture moves, rad/s: across and down the frame.
fn image_velocity(motion: &Motion) -> Vector2<f64> {
    let v = motion.pose.rotation.inverse() * motion.velocity / FAR_M;
    Vector2::new(-motion.angular_velocity.y - v.x, motion.angular_velocity.x - v.y)
}

#[test]
fn blur_reveals_image_velocity_up_to_its_sign() {
    for (velocity, angular_velocity) in [([2.0, 0.5, 0.0], [0.2, -0.7, 0.0]), ([-1.0, 1.5, 0.5], [-0.5, 0.3, 0.1])] {
        let truth = motion(FAR_M, velocity, angular_velocity);
        let frame = blurred(&truth, &GLOBAL);
        let seen = found(&frame, &truth, &GLOBAL, GLOBAL.exposure_s);
        let [is, should] = [image_velocity(&seen.estimate.motion), image_velocity(&truth)];
        let off = (is - should).norm().min((is + should).norm()) / should.norm();
        println!("{is} {should}, off by {off:.3}");
        assert!(seen.has_opposite && off < 0.2, "{is} {should}");
        // Without exposure time there is no blur. Nor is blur estimated for a picture that is seen
        // large, which can be followed without it.
        let large = motion(NEAR_M, [0.0; 3], angular_velocity);
        assert!(!found(&blurred(&large, &GLOBAL), &large, &GLOBAL, GLOBAL.exposure_s).has_opposite);
        assert!(!found(&frame, &truth, &GLOBAL, 1e-6).has_opposite);
    }
}

/// A camera that rotates sees an object that is carried. The blur is by both motions, shorter than
/// by the camera alone or longer.
#[test]
fn known_camera_motion_is_included_in_the_blur() {
    for (velocity, angular_velocity) in [([7.0, 0.5, 0.0], [0.2, -0.8, 0.0]), ([-6.0, 1.5, 0.0], [0.1, -0.4, 0.1])] {
        let truth = motion(FAR_M, velocity, angular_velocity);
        // In the axes of a stage that is aligned with the cloth.
        let camera = MotionEstimate {
            motion: Motion { angular_velocity: truth.angular_velocity, ..Motion::still(truth.pose) },
            covariance: MotionMatrix::identity() * 1e-6,
        };
        let expected = MotionEstimate::unseen_object(truth.pose, FAR_M, [0.02, 0.006], &camera);
        let seen = found_from(&blurred(&truth, &GLOBAL), &expected, &GLOBAL, GLOBAL.exposure_s).estimate.motion;
        let [is, should] = [image_velocity(&seen), image_velocity(&truth)];
        let off = (is - should).norm().min((is + should).norm()) / should.norm();
        println!("{is} {should}, off by {off:.3}; turns {}", seen.angular_velocity);
        assert!(off < 0.2, "{is} {should}");
    }
}

#[test]
fn rotation_and_velocity_with_equal_image_motion_are_one() {
    let pose = motion(NEAR_M, [0.0; 3], [0.0; 3]).pose;
    for point in [Vector3::new(0.1, -0.2, 3.0), Vector3::new(-1.8, 0.4, 2.5)] {
        let by_twist = angular_velocity_by_twist(&pose.rotation_matrix(), &point).expect("before the camera");
        let in_frame = |motion: &Motion, dt_s: f64| {
            let seen = motion.after(dt_s).pose.inverse().transform(&motion.pose.transform(&point.into()));
            Vector2::new(seen.x / seen.z, seen.y / seen.z)
        };
        let twist = Vector6::new(0.5, -0.3, 0.7, 0.2, -0.4, 0.3);
        let rotation = by_twist * twist;
        let speed = |twist: &Vector6<f64>| {
            let moving = Motion::still(pose).with_twist(twist);
            (in_frame(&moving, 1e-5) - in_frame(&moving, -1e-5)) / 2e-5
        };
        let [by_both, by_rotation] = [twist, Vector6::new(0.0, 0.0, 0.0, rotation.x, rotation.y, 0.0)].map(|twist| speed(&twist));
        assert!((by_both - by_rotation).norm() < 1e-6, "{by_both} {by_rotation}");
    }
    // Far to the side, the point is replaced by one straight ahead.
    assert_eq!(
        angular_velocity_by_twist(&pose.rotation_matrix(), &Vector3::new(2.0, 0.0, -1.0)),
        angular_velocity_by_twist(&pose.rotation_matrix(), &(Vector3::z() * 5f64.sqrt()))
    );
}

#[test]
fn a_still_picture_shows_no_velocity() {
    let truth = motion(FAR_M, [0.0; 3], [0.0; 3]);
    let seen = found(&blurred(&truth, &GLOBAL), &truth, &GLOBAL, GLOBAL.exposure_s);
    assert!(!seen.has_opposite && image_velocity(&seen.estimate.motion).norm() < 1e-9);
}

#[test]
fn rows_and_blur_together_separate_tilt_from_forward_motion() {
    for velocity in [[1.4, 0.0, 0.6], [0.9, 1.1, -0.6]] {
        let truth = motion(NEAR_M, velocity, [0.0; 3]);
        let frame = blurred(&truth, &ROLLING);
        let off = |seen: &Alignment| {
            let moved = seen.pose.inverse().angle_to(&truth.pose.inverse());
            let sigma = seen.covariance.fixed_view::<3, 3>(3, 3).trace().sqrt();
            (moved, sigma, ((seen.estimate.motion.pose.rotation.inverse() * seen.estimate.motion.velocity).z - velocity[2]).abs())
        };
        let [(rotated, sigma, ahead), (_, by_rows, _)] =
            [ROLLING.exposure_s, 1e-6].map(|exposure_s| off(&found(&frame, &truth, &ROLLING, exposure_s)));
        println!("{rotated:.5} rad of {sigma:.5}, by rows alone {by_rows:.5}; ahead off by {ahead:.3} m/s");
        assert!(sigma < 0.8 * by_rows && rotated < 3.0 * sigma && ahead < 0.5, "{rotated} {sigma} {by_rows} {ahead}");
    }
}
