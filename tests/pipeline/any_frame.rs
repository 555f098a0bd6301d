//! Whatever a camera shows, and however the tracker was configured, it returns a record and goes
//! on.
//!
//! Stages, lenses, shutters, frame rates and motions are random from a seed. Pictures have 64 to
//! 1920 pixels a side and any aspect ratio; surfaces come into view and leave it; there are jumps,
//! blackouts, frames of noise or of another size, and timestamps that repeat or go back. Assertions
//! and overflow checks are on in this profile. `STAGEPOSE_RANDOM_FRAMES=100000` asks for more
//! frames than a normal run has, and `STAGEPOSE_RANDOM_SEED` for another first scene.

use std::panic::{AssertUnwindSafe, catch_unwind};

use image::{GrayImage, Luma};
use nalgebra::{UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use stagepose::diagnostics::simulate::{artwork_surface, upright};
use stagepose::{
    BodySpec, CameraModel, CameraPath, ClipEntry, EntryContent, Frame, Intrinsics, MovingObject, ObjectPath, Pose, Renderer, SensorNoise,
    Shake, Spline, SurfaceSpec, Timestamp, Tracker, TrackerSetup, VirtualStage, track_entry,
};

use super::record_line::assert_record_holds;
use super::scene::{backdrop_art, other_art};

/// Frames per scene. Each scene needs a new tracker, which costs as much as many frames.
const FRAMES_A_SCENE: u64 = 60;
/// Frames of a normal run.
const USUAL_FRAMES: u64 = 480;
/// Maximum pixels of a picture; one scene in `LARGE_EVERY` has up to [`LARGE_PIXELS`].
const SMALL_PIXELS: f64 = 40_000.0;
const LARGE_EVERY: u64 = 40;
const LARGE_PIXELS: f64 = 1_000_000.0;

fn setting(name: &str, usual: u64) -> u64 {
    std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(usual)
}

#[test]
fn no_frame_or_setup_crashes_the_tracker() {
    let (frames, first) = (setting("STAGEPOSE_RANDOM_FRAMES", USUAL_FRAMES), setting("STAGEPOSE_RANDOM_SEED", 1));
    let (mut tracked, mut all) = (0, 0);
    for seed in first..first + frames.div_ceil(FRAMES_A_SCENE) {
        let outcome = catch_unwind(AssertUnwindSafe(|| track_scene(seed)));
        let Ok([of_scene, of_all]) = outcome else { panic!("scene {seed} ended the tracker: STAGEPOSE_RANDOM_SEED={seed} shows it again") };
        (tracked, all) = (tracked + of_scene, all + of_all);
        if frames > USUAL_FRAMES {
            println!("scene {seed}: {of_scene} of {of_all} tracked; {all} frames so far");
        }
    }
    println!("{all} frames, of which {tracked} were tracked");
    // Frames that show nothing would not exercise the aligner.
    assert!(8 * tracked > all, "{tracked} of {all}");
}

/// Tracks one random scene; returns the number of tracked frames, and of all frames.
fn track_scene(seed: u64) -> [u64; 2] {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let scene = random_scene(&mut random, if seed.is_multiple_of(LARGE_EVERY) { LARGE_PIXELS } else { SMALL_PIXELS });
    let mut setup = TrackerSetup::from(&scene);
    if random.random_bool(0.4) {
        // The shutter is configured wrongly or not at all.
        setup.shutter.readout_s = random.random_bool(0.5).then(|| random.random_range(0.0..0.05));
        setup.shutter.exposure_s = random.random_bool(0.5).then(|| random.random_range(1e-6..0.05));
    }
    setup.settings.features = random.random_range(50..600);
    if random.random_bool(0.1) {
        // A mask whose size may differ from the frames' must do no harm.
        let (w, h) = (random.random_range(1..200), random.random_range(1..200));
        setup.mask = Some(GrayImage::from_fn(w, h, |x, y| Luma([if (x + y) % 7 == 0 { 0 } else { 255 }])));
    }
    let mut tracker = Tracker::new(setup).expect("a setup that fits");
    let fps = [5.0, 15.0, 30.0, 60.0, 240.0][random.random_range(0..5)];
    let renderer = Renderer::new(scene);
    let (mut tracked, mut time_s) = (0, 0.0);
    for sequence in 0..FRAMES_A_SCENE {
        time_s += if random.random_bool(0.03) { random.random_range(-0.1..1.5) } else { 1.0 / fps };
        let image = match random.random_range(0..60) {
            0 => GrayImage::from_fn(renderer.stage().camera.width(), renderer.stage().camera.height(), |_, _| Luma([random.random()])),
            1 => GrayImage::from_pixel(random.random_range(1..100), random.random_range(1..100), Luma([90])),
            _ => renderer.render(time_s, sequence),
        };
        let timestamp = Timestamp::from_seconds(time_s);
        let content = EntryContent::Frame(Frame::new(image, timestamp, sequence));
        let sample = track_entry(&mut tracker, &ClipEntry::new(sequence, timestamp, content));
        assert_record_holds(&sample);
        tracked += u64::from(sample.measurement.is_some());
    }
    [tracked, FRAMES_A_SCENE]
}

fn random_scene(random: &mut Pcg64Mcg, most_pixels: f64) -> VirtualStage {
    let side = |random: &mut Pcg64Mcg, most: f64| (random.random_range(64f64.ln()..most.clamp(64.5, 1920.0).ln()).exp()) as u32;
    let width = side(random, most_pixels / 64.0);
    let height = side(random, most_pixels / f64::from(width));
    let [width, height] = if random.random_bool(0.5) { [width, height] } else { [height, width] };
    let mut surfaces = vec![random_surface(random, "first", 1.0)];
    for _ in 0..random.random_range(0..3) {
        surfaces.push(random_surface(random, "more", 0.5));
    }
    let stage = BodySpec::new("stage", surfaces);
    let mut scene = VirtualStage::new(random_camera(random, width, height), random_path(random), stage);
    if random.random_bool(0.2) {
        let body = BodySpec::new("prop", vec![random_surface(random, "side", 0.3)]);
        let mut key =
            |t: f64| (t, Vector3::new(random.random_range(-1.0..1.0), random.random_range(-1.5..-0.3), random.random_range(-0.6..0.6)));
        let keys = [key(0.0), key(2.0), key(5.0)];
        let path = ObjectPath {
            position: Spline::new(&keys).expect("keys in order"),
            rotation_rad: 0.2,
            angular_velocity_rad_s: random.random_range(-2.0..2.0),
        };
        scene.objects = vec![MovingObject { body, path }];
    }
    scene.shutter.exposure_s = if random.random_bool(0.3) { 0.0 } else { random.random_range(0.0..0.04) };
    scene.shutter.readout_s = if random.random_bool(0.4) { 0.0 } else { random.random_range(0.0..0.03) };
    if random.random_bool(0.3) {
        let from = random.random_range(0.0..3.0);
        scene.blackouts = vec![from..from + random.random_range(0.02..0.5)];
    }
    scene.noise = SensorNoise { read: random.random_range(0.0..3.0), shot: 0.02 };
    scene.background = random.random_range(0.0..255.0);
    scene.samples = random.random_range(1..4);
    scene
}

fn random_camera(random: &mut Pcg64Mcg, width: u32, height: u32) -> CameraModel {
    let (w, h) = (f64::from(width), f64::from(height));
    let fx = w.max(h) * random.random_range(0.4f64..2.5);
    let strong = if random.random_bool(0.2) { 3.0 } else { 1.0 };
    let mut bend = |most: f64| random.random_range(-most..most) * strong;
    let distortion = [bend(0.12), bend(0.06), bend(0.001), bend(0.001), bend(0.01)];
    let (cx, cy) = (random.random_range(0.3..0.7) * w, random.random_range(0.3..0.7) * h);
    let fy = fx * random.random_range(0.9..1.1);
    let camera = |distortion| CameraModel::new(Intrinsics { width, height, fx, fy, cx, cy, skew: 0.0, distortion });
    // A lens whose distortion folds the picture is refused.
    camera(distortion).or_else(|_| camera([0.0; 5])).expect("a pinhole")
}

fn random_surface(random: &mut Pcg64Mcg, name: &str, scale: f64) -> SurfaceSpec {
    let art = if random.random_bool(0.5) { backdrop_art() } else { other_art() };
    // The first surface is large enough to be found; the others may be anything.
    let least = if name == "first" { 400 } else { 16 };
    let (w, h) = (random.random_range(least..=art.width()), random.random_range(least..=art.height()));
    let (x, y) = (random.random_range(0..=art.width() - w), random.random_range(0..=art.height() - h));
    let artwork = image::imageops::crop_imm(art, x, y, w, h).to_image();
    let width_m = scale * random.random_range(if name == "first" { 2.0..4.0 } else { 0.5..4.0 });
    let mut near = |most: f64| random.random_range(-most..most);
    let pose = upright(Vector3::new(near(1.0), near(0.8), near(0.6)) * if name == "first" { 0.0 } else { 1.0 }, near(0.7));
    let tilt = Pose::new(UnitQuaternion::from_euler_angles(near(0.3), near(0.3), near(3.1)), Vector3::zeros());
    artwork_surface(name, artwork, [width_m, width_m * f64::from(h) / f64::from(w) * random.random_range(0.7..1.4)], pose * tilt)
}

/// Near and far, aside and behind, with the stage in the middle, at the edge or out of view;
/// sometimes faster than any real camera.
fn random_path(random: &mut Pcg64Mcg) -> CameraPath {
    let hurry = [0.3, 0.6, 1.0, 6.0][random.random_range(0..4)];
    let mut t = 0.0;
    let (mut positions, mut targets) = (Vec::new(), Vec::new());
    let (x, z) = (random.random_range(-1.0..1.0), random.random_range(-0.5..0.5));
    for _ in 0..8 {
        let mut near = |most: f64| random.random_range(-most..most);
        positions.push((t, Vector3::new(x + near(0.4) * hurry, -2.5 + near(0.9) * hurry, z + near(0.3) * hurry)));
        targets.push((t, Vector3::new(near(0.5) * hurry, near(0.2), near(0.4) * hurry)));
        t += random.random_range(0.3..1.5);
    }
    let shake = random.random_bool(0.4).then(|| Shake::new(0.01 * hurry, 0.01 * hurry, 7.0, random.random()));
    let spline = |keys: &[(f64, Vector3<f64>)]| Spline::new(keys).expect("keys in order");
    CameraPath { position: spline(&positions), target: spline(&targets), roll_rad: random.random_range(-3.1..3.1), shake }
}
