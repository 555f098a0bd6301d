use nalgebra::Vector3;

use super::*;
use crate::frame::Frame;
use crate::motion::Motion;
use crate::track::align::{CameraRays, FrameLevels, Start};
use crate::track::patches::verify::Refusal;
use crate::track::scene::surface::{ReferenceKind, SurfaceSpec};
use crate::track::synthetic::{cloth, facing, lens, view};

fn truth() -> Pose<Camera, Body> {
    facing(0.2, -0.3, Vector3::new(0.1, 0.05, 3.4))
}

/// Returns whether a body at rest is found if earlier frames seemed to show that its angular
/// velocity changes by `angular_acceleration`. `is_told`: whether enough frames were seen to trust
/// that.
fn is_followed(angular_acceleration: f64, is_told: bool) -> bool {
    let surface = cloth(1);
    let shutter = Shutter { readout_s: 0.0, exposure_s: 0.0 };
    let mut body = TrackedBody::new(&BodySpec::new("prop", vec![surface.clone()]), vec![AlignSurface::new(&surface)], 0, shutter);
    if is_told {
        (0..4).for_each(|_| body.process_noise.learn([None, None]));
    }
    let camera = lens(480, 360);
    let still = MotionEstimate::unseen(truth().inverse(), 3.4, 1e-3, 3e-4);
    let motion = Motion { angular_acceleration: Vector3::new(0.0, angular_acceleration, 0.0), ..still.motion };
    body.motion = Some((MotionEstimate { motion, ..still }, Timestamp::from_seconds(1.0)));
    let frame = Frame::new(view(&surface, &truth(), &camera), Timestamp::from_seconds(1.0 + 1.0 / 30.0), 1);
    let mut levels = FrameLevels::default();
    levels.update(&frame.image);
    let found = body.follow(&frame, &mut levels, &CameraRays::new(camera, None));
    assert!(found.as_ref().is_none_or(|verified| verified.pose.inverse().angle_to(&truth()) < 1e-3));
    found.is_some()
}

#[test]
fn an_uncertain_acceleration_does_not_lose_a_body() {
    assert!(is_followed(0.0, false) && is_followed(0.0, true));
    // Predicted a ninth of a radian off in the next frame, beyond the basin of alignment.
    assert!(is_followed(200.0, false));
    // Enough frames have shown how it moves: it is not searched for elsewhere.
    assert!(!is_followed(200.0, true));
}

/// Aligns a cloth from its true pose, with a fraction of it covered by another picture from the
/// right. Returns whether it is verified, and whether it is seen in part.
fn is_found(covered_share: f64) -> [bool; 2] {
    let surface = cloth(1);
    let shutter = Shutter { readout_s: 0.0, exposure_s: 0.0 };
    let mut body = TrackedBody::new(&BodySpec::new("prop", vec![surface.clone()]), vec![AlignSurface::new(&surface)], 0, shutter);
    let camera = lens(160, 120);
    let [mut picture, cover] = [1, 9].map(|seed| view(&cloth(seed), &truth(), &camera));
    let first_covered = (160.0 * (1.0 - covered_share)) as u32;
    picture.enumerate_pixels_mut().filter(|(x, ..)| *x >= first_covered).for_each(|(x, y, pixel)| *pixel = *cover.get_pixel(x, y));
    let frame = Frame::new(picture, Timestamp::from_seconds(1.0), 1);
    let mut levels = FrameLevels::default();
    levels.update(&frame.image);
    let expected = body.unseen(truth().inverse(), [0.01, 0.003], None);
    let found = body.align_found(&frame, &mut levels, &CameraRays::new(camera, None), &Start::found(&expected));
    [found.is_some(), body.attempt.is_seen_in_part]
}

#[test]
fn an_occluded_fit_is_distinguished_from_a_misfit() {
    assert_eq!(is_found(0.0), [true, false]);
    assert_eq!(is_found(0.68), [false, true]);
    assert_eq!(is_found(1.0), [false, false]);
}

/// Runs `ask` on a still prop, seen small under a rolling shutter with this readout time, in the
/// frame that finds it; passes the frame, its levels and the rays as well.
fn with_small_prop(
    readout_s: f64,
    is_continued: bool,
    ask: impl FnOnce(&mut TrackedBody, Option<Verified>, &Frame, &mut FrameLevels, &CameraRays),
) {
    let surface = cloth(1);
    let shutter = Shutter { readout_s, exposure_s: 0.0 };
    let mut body = TrackedBody::new(&BodySpec::new("prop", vec![surface.clone()]), vec![AlignSurface::new(&surface)], 0, shutter);
    let rays = CameraRays::new(lens(160, 120), None);
    if is_continued {
        (0..2).for_each(|k| {
            body.track.update(Timestamp::from_seconds(0.9 + 0.03 * f64::from(k)), Some(&truth().inverse()), 0.2, 2);
        });
    }
    let frame = Frame::new(view(&surface, &truth(), rays.camera()), Timestamp::from_seconds(1.0), 1);
    let mut levels = FrameLevels::default();
    levels.update(&frame.image);
    let off = MotionEstimate::off_by_readout(readout_s, 3.4);
    let expected = body.unseen(truth().inverse(), [0.01 + off[0], 0.003 + off[1]], None);
    let found = body.align_found(&frame, &mut levels, &rays, &Start::found(&expected));
    ask(&mut body, found, &frame, &mut levels, &rays);
}

#[test]
fn an_uncertain_pose_is_followed_until_the_next_frame() {
    with_small_prop(0.06, false, |body, found, frame, levels, rays| {
        assert!(found.is_none() && body.attempt.refusal == Some(Refusal::Uncertain), "{:?}", body.attempt.refusal);
        let open = body.motion_at(frame.timestamp).expect("followed from there").covariance.fixed_view::<3, 3>(0, 0).trace().sqrt();
        let next = Frame::new(frame.image.clone(), Timestamp::from_seconds(1.0 + 1.0 / 30.0), 2);
        let verified = body.follow(&next, levels, rays).expect("two frames tell the motion");
        let sigma = verified.covariance.fixed_view::<3, 3>(0, 0).trace().sqrt();
        let error = (verified.pose.translation - truth().inverse().translation).norm();
        assert!(sigma < 0.2 * open && error < 3.0 * sigma, "{error} of {sigma} m, before {open}");
    });
}

#[test]
fn rolling_shutter_tracks_resume_only_from_sharp_poses() {
    let is_given = |readout_s: f64, is_continued: bool| {
        let mut is_given = false;
        with_small_prop(readout_s, is_continued, |_, found, _, _, _| is_given = found.is_some());
        is_given
    };
    assert_eq!([is_given(0.0, true), is_given(0.002, true), is_given(0.02, true)], [true, true, false]);
    assert!(is_given(0.02, false));
}

/// Aligns a body of as many cloths as there are places, and returns which of them its anchors show.
fn shown_with(body: &mut TrackedBody, surfaces: &[SurfaceSpec]) -> Vec<bool> {
    let camera = lens(480, 360);
    let mut picture = view(&surfaces[0], &truth(), &camera);
    for surface in &surfaces[1..] {
        // Black beside the cloths.
        picture.iter_mut().zip(view(surface, &truth(), &camera).iter()).for_each(|(own, other)| *own = (*own).max(*other));
    }
    let frame = Frame::new(picture, Timestamp::from_seconds(1.0), 1);
    let mut levels = FrameLevels::default();
    levels.update(&frame.image);
    let expected = body.unseen(truth().inverse(), [0.002, 0.0005], None);
    let _ = body.align_found(&frame, &mut levels, &CameraRays::new(camera, None), &Start::found(&expected));
    (0..surfaces.len()).map(|k| body.anchors.fitting().iter().any(|anchor| anchor.surface as usize == k)).collect()
}

#[test]
fn a_facet_that_is_left_out_shows_no_anchor_and_most_of_a_map_stays() {
    let kind = ReferenceKind::Facet { pose: Pose::identity() };
    let facets: Vec<SurfaceSpec> = (0..5)
        .map(|k| {
            let mut facet = SurfaceSpec { kind: kind.clone(), size_m: [0.7, 0.6], ..cloth(k + 1) };
            facet.pose.translation = Vector3::new(0.75 * (k % 3) as f64 - 0.75, 0.7 * (k / 3) as f64 - 0.3, 0.0);
            facet
        })
        .collect();
    let shutter = Shutter { readout_s: 0.0, exposure_s: 0.0 };
    let new = |surfaces: &[SurfaceSpec]| {
        TrackedBody::new(&BodySpec::new("stage", surfaces.to_vec()), surfaces.iter().map(AlignSurface::new).collect(), 0, shutter)
    };
    let mut body = new(&facets);
    assert!(shown_with(&mut body, &facets).iter().all(|shown| *shown));
    assert!(body.leave_out(1) && body.leave_out(4));
    assert_eq!(shown_with(&mut body, &facets), [true, false, true, true, false]);
    // Three stay, whatever they seem to do.
    assert!(!body.leave_out(0));
    // Who configured a surface is asked about it.
    assert!(!new(&[cloth(1), cloth(2), cloth(3), cloth(4), cloth(5)]).leave_out(1));
}
