//! Frames that mix two moments, and frames that resemble such a mixture: long exposures, rolling
//! shutters, fine stripes, flickering light, lossy pictures.

use image::GrayImage;
use image::codecs::jpeg::JpegEncoder;
use nalgebra::Vector3;
use stagepose::diagnostics::capture::VirtualCamera;
use stagepose::diagnostics::track::BodyTracker;
use stagepose::{CameraPath, ClipEntry, ComputeClock, EntryContent, FrameSource, PoseSample, Reason, Shake, Spline, State, VirtualStage};

use super::scene::{FPS, aside, backdrop, backdrop_art, body, camera, errors, quiet, rows, setup, surface, track_rows};

/// A pan at about 40 degrees a second, or 13 pixels a frame.
fn panning() -> CameraPath {
    panning_by(1.0)
}

fn panning_by(share: f64) -> CameraPath {
    let targets = [(-0.5, -2.2), (1.5, 2.2)].map(|(t, x)| (t, Vector3::new(share * x, 0.0, 0.0)));
    let keys = [(-0.5, -0.3), (1.5, 0.3)].map(|(t, x)| (t, Vector3::new(x, -3.3, 0.1)));
    CameraPath { position: Spline::new(&keys).unwrap(), target: Spline::new(&targets).unwrap(), roll_rad: 0.02, shake: None }
}

fn picture(row: &ClipEntry) -> &GrayImage {
    let EntryContent::Frame(frame) = &row.content else { panic!("rendered rows are frames") };
    &frame.image
}

/// Makes each frame from itself and the previous one.
fn mixed(rows: &[ClipEntry], mix: impl Fn(u32, u8, u8) -> u8) -> Vec<ClipEntry> {
    let mut out = rows.to_vec();
    for (k, row) in out.iter_mut().enumerate().skip(1) {
        let (before, own) = (picture(&rows[k - 1]), picture(&rows[k]));
        let image =
            GrayImage::from_fn(own.width(), own.height(), |x, y| image::Luma([mix(y, before.get_pixel(x, y)[0], own.get_pixel(x, y)[0])]));
        let EntryContent::Frame(frame) = &mut row.content else { panic!("rendered rows are frames") };
        frame.image = image;
    }
    out
}

fn blend(_: u32, before: u8, own: u8) -> u8 {
    ((u16::from(before) + u16::from(own)) / 2) as u8
}

fn weave(y: u32, before: u8, own: u8) -> u8 {
    if y % 2 == 1 { before } else { own }
}

fn tear(y: u32, before: u8, own: u8) -> u8 {
    if y >= 180 { before } else { own }
}

fn is_wrong(scene: &VirtualStage, sample: &PoseSample) -> bool {
    sample.state == State::Tracking && {
        let (shift, degrees) = errors(scene, sample);
        shift > 0.01 || degrees > 0.3
    }
}

fn count(samples: &[PoseSample], reason: Reason) -> usize {
    samples.iter().filter(|s| s.reason == Some(reason)).count()
}

#[test]
fn mixtures_are_withheld_while_the_camera_moves() {
    let mixtures = [("blended", blend as fn(u32, u8, u8) -> u8), ("woven", weave), ("torn", tear)];
    for (share, (name, mix)) in [0.4, 1.0].into_iter().flat_map(|share| mixtures.map(|mixture| (share, mixture))) {
        let scene = quiet(camera(640, 360), panning_by(share), backdrop());
        let samples = track_rows(setup(&scene), &mixed(&rows(&scene, 20), mix));
        let wrong = samples.iter().filter(|s| is_wrong(&scene, s)).count();
        let refused = count(&samples, Reason::Mixed);
        println!(
            "{name}, {share} of the pan: {wrong} wrong, {refused} refused: {:?}",
            samples.iter().map(|s| s.reason).collect::<Vec<_>>()
        );
        assert!(wrong <= 3, "{name}, {share}");
        // A clear double picture fits no pose, and is refused as occluded.
        let is_refused_otherwise = || samples[2..].iter().all(|s| s.state != State::Tracking);
        assert!(refused >= 5 || is_refused_otherwise(), "{name}, {share}");
    }
}

/// The fields of an interlaced camera are half a frame interval apart.
#[test]
fn interlaced_frames_are_withheld_and_reported_once() {
    let scene = quiet(camera(640, 360), panning_by(0.3), backdrop());
    let mut camera = VirtualCamera::new(scene.clone(), 2.0 * FPS, 41);
    let fields: Vec<ClipEntry> = std::iter::from_fn(|| camera.next_entry()).collect();
    let mixed = mixed(&fields, weave);
    let mut matcher =
        BodyTracker::new(scene.camera, scene.shutter.into(), None, &[&scene.stage], Default::default(), ComputeClock::default(), None);
    let (mut news, mut refused) = (Vec::new(), 0);
    for entry in mixed.iter().step_by(2) {
        let EntryContent::Frame(frame) = &entry.content else { panic!("a virtual camera loses no frame") };
        let observation = matcher.track_frame(frame);
        refused += usize::from(observation.stage.reason == Some(Reason::Mixed));
        news.extend(observation.mixture);
    }
    let [one] = &news[..] else { panic!("{news:?}") };
    assert!(one.text().contains("interlaced"), "{}", one.text());
    assert!(refused >= 15, "{refused}");
}

#[test]
fn banded_light_flicker_is_not_a_mixed_frame() {
    let scene = quiet(camera(640, 360), panning_by(0.4), backdrop());
    let mut rows = rows(&scene, 14);
    for (k, row) in rows.iter_mut().enumerate() {
        let EntryContent::Frame(frame) = &mut row.content else { panic!("rendered rows are frames") };
        for (_, y, pixel) in frame.image.enumerate_pixels_mut() {
            let light = 0.75 + 0.25 * (std::f64::consts::TAU * (f64::from(y) / 150.0 + 0.37 * k as f64)).sin();
            pixel[0] = (f64::from(pixel[0]) * light) as u8;
        }
    }
    assert_unmixed(&scene, &rows, 12);
}

#[test]
fn mixed_frames_of_a_still_camera_are_tracked() {
    let scene = quiet(camera(640, 360), aside(), backdrop());
    let whole = rows(&scene, 6);
    for mix in [blend as fn(u32, u8, u8) -> u8, weave, tear] {
        assert!(track_rows(setup(&scene), &mixed(&whole, mix)).iter().all(|s| s.state == State::Tracking));
    }
}

fn assert_unmixed(scene: &VirtualStage, rows: &[ClipEntry], least: usize) {
    let samples = track_rows(setup(scene), rows);
    assert_eq!(count(&samples, Reason::Mixed), 0);
    let given = samples.iter().filter(|s| s.state == State::Tracking).count();
    assert!(given >= least, "{given} of {}: {:?}", rows.len(), samples.iter().map(|s| s.reason).collect::<Vec<_>>());
}

#[test]
fn a_full_frame_exposure_is_not_a_mixed_frame() {
    for exposure_s in [0.2 / FPS, 0.98 / FPS] {
        let mut scene = quiet(camera(640, 360), panning(), backdrop());
        scene.shutter.exposure_s = exposure_s;
        scene.samples = 32;
        assert_unmixed(&scene, &rows(&scene, 12), 10);
    }
}

#[test]
fn a_shaken_rolling_shutter_is_not_a_tear() {
    for (readout_s, is_known) in [(0.012, true), (0.03, true), (0.012, false)] {
        let mut path = panning();
        path.shake = Some(Shake::new(0.01, 0.02, 4.0, 5));
        let mut scene = quiet(camera(640, 360), path, backdrop());
        scene.shutter.readout_s = readout_s;
        let rows = rows(&scene, 16);
        let mut told = setup(&scene);
        told.shutter.readout_s = is_known.then_some(readout_s);
        let samples = track_rows(told, &rows);
        assert_eq!(count(&samples, Reason::Mixed), 0, "{readout_s}");
    }
}

#[test]
fn lossy_pictures_are_not_mixed_frames() {
    let scene = quiet(camera(640, 360), panning(), backdrop());
    let mut rows = rows(&scene, 10);
    for row in &mut rows {
        let EntryContent::Frame(frame) = &mut row.content else { panic!("rendered rows are frames") };
        let mut bytes = Vec::new();
        JpegEncoder::new_with_quality(&mut bytes, 45).encode_image(&frame.image).unwrap();
        frame.image = image::load_from_memory(&bytes).unwrap().into_luma8();
    }
    assert_unmixed(&scene, &rows, 9);
}

#[test]
fn fine_stripes_are_not_taken_for_interlacing() {
    let art = GrayImage::from_fn(1000, 750, |x, y| {
        let own = i32::from(backdrop_art().get_pixel(x, y)[0]);
        image::Luma([(own + if y % 4 < 2 { 40 } else { -40 }).clamp(0, 255) as u8])
    });
    let stage = body(vec![surface("backdrop", &art, [4.0, 3.0], Vector3::zeros(), 0.0)]);
    let mut scene = quiet(camera(640, 360), panning(), stage);
    scene.samples = 8;
    assert_unmixed(&scene, &rows(&scene, 10), 9);
}
