//! How right poses differ from wrong ones, and which of them the tracker reports.
//!
//! The stage is aligned from many starts, near and far, on frames that show it and on frames that
//! show another stage, with people in front and in dim light. The kinds of stages are those that
//! make wrong poses look right: planks, a picture that repeats itself, one that is seen small, one
//! that is covered by half, and another stage that shares a part of its picture. Further starts are
//! where wrong poses are known to lie: at the mirror solution, and periods aside.
//!
//! For each kind the table has the poses that converged, those that agree well enough in this frame
//! (`new`: of a body that was never seen, `track`: of one that is followed), and those that pass
//! all checks of the search (`found`). Then the rates of right and wrong poses above thresholds of
//! the ratio of agreeing tiles and of `strength`.
//!
//! `cargo bench --bench trust`; `-- 60` takes sixty stages instead of thirty-six; `-- --check` ends
//! with 1 if a wrong pose is found, or fewer right ones than before. A stage that shares a part of
//! its picture with the shown one is printed but not checked: what they share is really there, and
//! only the rest of its tiles pulls the pose.

use std::collections::BTreeMap;
use std::process::ExitCode;
use std::sync::{Arc, Mutex};

use image::{GrayImage, Luma};
use nalgebra::{Point3, Unit, UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use stagepose::diagnostics::simulate::{artwork_surface, grey, paint, paint_boards, upright};
use stagepose::diagnostics::track::{Alignment, BodyTracker};
use stagepose::{
    Body, BodySpec, Camera, CameraModel, CameraPath, ComputeClock, Frame, Intrinsics, LightKey, Occluder, Pose, Renderer, SensorNoise,
    TrackerSettings, ViewStore, VirtualStage,
};

const STAGES: u64 = 36;
/// Starts per stage at each distance.
const STARTS: usize = 6;
/// How far off the starts are: fraction of the distance, and radians.
const FAR: [f64; 5] = [0.001, 0.01, 0.03, 0.08, 0.2];
/// Starts at the mirror solution.
const MIRRORED: usize = 4;
/// Errors above which a pose is wrong: fraction of the distance, and radians (the tight bounds of
/// contract C5).
const WRONG_SHIFT: f64 = 0.01;
const WRONG_ROTATION: f64 = 0.3 * std::f64::consts::PI / 180.0;
/// Tiles of a repeating picture, across and down.
const REPEATS: [u32; 2] = [5, 4];
/// How much of a repeating picture differs from period to period.
const OWN_RATIO: f32 = 0.15;
/// Minimum percentage of the right poses that are found, for `--check`: what was measured, less
/// what another processor may change.
const MIN_FOUND_PERCENT: f64 = 80.0;

/// What is difficult about a stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Kind {
    Painted,
    Planks,
    Repeats,
    Small,
    Covered,
    /// The other stage shares a part of the picture that is shown.
    Shared,
}

const KINDS: [Kind; 6] = [Kind::Painted, Kind::Planks, Kind::Repeats, Kind::Small, Kind::Covered, Kind::Shared];

/// A stage in front of a camera, and another one of its kind.
struct Scene {
    kind: Kind,
    camera: CameraModel,
    truth: Pose<Camera, Body>,
    frame: Frame,
    size_m: [f64; 2],
    shown: BodySpec,
    other: BodySpec,
}

/// A pose that alignment converged to.
struct Converged {
    is_right: bool,
    found: Alignment,
    /// Whether it passes all checks of the search.
    is_found: bool,
    distance_m: f64,
}

/// The views of pictures, kept in memory so that trackers start quickly.
#[derive(Debug, Default)]
struct KeptViews(Mutex<BTreeMap<String, Vec<u8>>>);

impl ViewStore for KeptViews {
    fn load(&self, key: &str) -> Option<Vec<u8>> {
        self.0.lock().ok()?.get(key).cloned()
    }

    fn store(&self, key: &str, bytes: &[u8]) {
        if let Ok(mut kept) = self.0.lock() {
            kept.insert(key.to_owned(), bytes.to_vec());
        }
    }
}

fn main() -> ExitCode {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let stages = words.iter().filter_map(|word| word.parse().ok()).next().unwrap_or(STAGES);
    let views: Arc<dyn ViewStore> = Arc::new(KeptViews::default());
    let mut poses: BTreeMap<Kind, Vec<Converged>> = BTreeMap::new();
    for seed in 0..stages {
        let kind = KINDS[seed as usize % KINDS.len()];
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let scene = scene(kind, seed, &mut random);
        for is_shown in [true, false] {
            poses.entry(kind).or_default().extend(converged(&scene, is_shown, &views, &mut random));
        }
    }
    println!("kind      pose   converged   new  track  found");
    for (kind, poses) in &poses {
        print_counts(*kind, poses);
    }
    let is_checked = |kind: Kind| kind != Kind::Shared;
    let checked = poses.iter().filter(|(kind, _)| is_checked(**kind)).flat_map(|(_, poses)| poses);
    let (right, wrong): (Vec<&Converged>, Vec<&Converged>) = checked.partition(|pose| pose.is_right);
    let found = |poses: &[&Converged]| poses.iter().filter(|pose| pose.is_found).count();
    let (found_right, found_wrong) = (found(&right), found(&wrong));
    let percent = 100.0 * found_right as f64 / right.len().max(1) as f64;
    println!(
        "found, without {:?}: {percent:.1} % of {} right poses, {found_wrong} of {} wrong ones",
        Kind::Shared,
        right.len(),
        wrong.len()
    );
    let all: Vec<Converged> = poses.into_values().flatten().collect();
    print_rates("ratio of agreeing tiles", &all, Alignment::inlier_ratio);
    print_rates("strength", &all, Alignment::strength);
    let is_good = found_wrong == 0 && percent >= MIN_FOUND_PERCENT;
    if words.iter().any(|word| word == "--check") && !is_good { ExitCode::FAILURE } else { ExitCode::SUCCESS }
}

fn print_counts(kind: Kind, poses: &[Converged]) {
    for is_right in [true, false] {
        let count = |passes: fn(&Converged) -> bool| poses.iter().filter(|pose| pose.is_right == is_right && passes(pose)).count();
        println!(
            "{:<9} {:<5} {:>10} {:>5} {:>6} {:>6}",
            format!("{kind:?}"),
            if is_right { "right" } else { "wrong" },
            count(|_| true),
            count(|pose| pose.found.may_be_reported(false, false, pose.distance_m)),
            count(|pose| pose.found.may_be_reported(true, true, pose.distance_m)),
            count(|pose| pose.is_found),
        );
    }
}

/// Prints how many right and wrong poses lie above thresholds of a score (an operating curve).
fn print_rates(name: &str, poses: &[Converged], score: fn(&Alignment) -> f64) {
    let rate = |is_right: bool, threshold: f64| {
        let own: Vec<f64> = poses.iter().filter(|pose| pose.is_right == is_right).map(|pose| score(&pose.found)).collect();
        100.0 * own.iter().filter(|score| **score > threshold).count() as f64 / own.len().max(1) as f64
    };
    println!("\n{name} above   right %  wrong %");
    for threshold in [0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.7, 0.9] {
        println!("{threshold:>29.2} {:>9.1} {:>8.1}", rate(true, threshold), rate(false, threshold));
    }
}

/// Aligns the shown stage, or the other one, from all starts.
fn converged(scene: &Scene, is_shown: bool, views: &Arc<dyn ViewStore>, random: &mut Pcg64Mcg) -> Vec<Converged> {
    let Scene { camera, truth, frame, shown, other, .. } = scene;
    let stage = if is_shown { shown } else { other };
    let tracker = || {
        let (shutter, settings, clock) = (stagepose::Shutter::default().into(), TrackerSettings::default(), ComputeClock::default());
        BodyTracker::new(*camera, shutter, None, &[stage], settings, clock, Some(views.clone()))
    };
    let mut aligner = tracker();
    let distance_m = truth.translation.norm();
    let mut poses = Vec::new();
    for (start, off) in starts(scene, random) {
        let (start, shift_m) = (start.inverse(), off * distance_m);
        let Some(found) = aligner.study().try_start(frame, &start, shift_m, off) else { continue };
        // What the other stage shares with the shown one is there, too.
        let is_right = (is_shown || scene.kind == Kind::Shared) && is_right(&found.pose.inverse(), truth);
        // A tracker of its own, as it learns from what it finds.
        let may_be_found = found.may_be_reported(false, false, distance_m);
        let is_found = may_be_found && tracker().study().found_at(frame, &start, shift_m, off).is_some();
        poses.push(Converged { is_right, found, is_found, distance_m });
    }
    poses
}

/// The starts, `T_camera_body`, with their uncertainty: fraction of the distance, and radians.
fn starts(scene: &Scene, random: &mut Pcg64Mcg) -> Vec<(Pose<Camera, Body>, f64)> {
    let Scene { truth, size_m, .. } = scene;
    let mut starts = Vec::new();
    for off in FAR {
        starts.extend((0..STARTS).map(|_| (moved(truth, off, random), off)));
    }
    starts.extend((0..MIRRORED).map(|_| (moved(&mirrored(truth), 0.02, random), 0.05)));
    let [across, down] = [size_m[0] / f64::from(REPEATS[0]), size_m[1] / f64::from(REPEATS[1])];
    for (x, z) in [(across, 0.0), (-across, 0.0), (0.0, down), (0.0, -down), (0.5 * across, 0.0), (0.0, 0.5 * down)] {
        let aside = Pose::new(truth.rotation, truth.translation + truth.rotation * Vector3::new(x, 0.0, z));
        starts.push((moved(&aside, 0.005, random), 0.02));
    }
    starts
}

/// Paints a picture of this kind.
fn picture(kind: Kind, seed: u64, size_m: [f64; 2]) -> GrayImage {
    let (width, height) = (1200, (1200.0 * size_m[1] / size_m[0]) as u32);
    match kind {
        Kind::Planks => grey(&paint_boards(width, height, seed)),
        Kind::Repeats => {
            let [across, down] = [width / REPEATS[0], height / REPEATS[1]];
            let (tile, own) = (grey(&paint(across, down, seed)), grey(&paint(width, height, seed + 7)));
            GrayImage::from_fn(width, height, |x, y| {
                let [repeated, own] = [tile.get_pixel(x % across, y % down), own.get_pixel(x, y)].map(|pixel| f32::from(pixel.0[0]));
                Luma([((1.0 - OWN_RATIO) * repeated + OWN_RATIO * own) as u8])
            })
        }
        _ => grey(&paint(width, height, seed)),
    }
}

fn body(picture: GrayImage, size_m: [f64; 2]) -> BodySpec {
    BodySpec::new("stage", vec![artwork_surface("backdrop", picture, size_m, upright(Vector3::zeros(), 0.0))])
}

/// A backdrop seen from anywhere in front of it. Half of the stages have people in front, and a
/// third are dim.
fn scene(kind: Kind, seed: u64, random: &mut Pcg64Mcg) -> Scene {
    let size_m = [random.random_range(1.5..6.0), random.random_range(1.2..4.0)];
    let focal = random.random_range(500.0..1100.0);
    let distortion = [random.random_range(-0.15..0.02), 0.03, 0.0005, -0.0004, 0.0];
    let intrinsics = Intrinsics { width: 960, height: 540, fx: focal, fy: focal, cx: 481.0, cy: 268.0, skew: 0.0, distortion };
    let camera = CameraModel::new(intrinsics).expect("a camera");
    let (tilt, around) = (random.random_range(0.0..1.1_f64), random.random_range(0.0..std::f64::consts::TAU));
    let filled = if kind == Kind::Small { random.random_range(0.05..0.15) } else { random.random_range(0.3..1.5) };
    let distance = size_m[0] * focal / 960.0 / filled;
    let towards = Vector3::new(tilt.sin() * around.cos(), -tilt.cos(), 0.8 * tilt.sin() * around.sin());
    let path = CameraPath::fixed(Point3::from(towards.normalize() * distance), Point3::origin());
    let shown = picture(kind, seed, size_m);
    let mut stage = VirtualStage::new(camera, path, body(shown.clone(), size_m));
    stage.noise = SensorNoise::webcam();
    stage.samples = 8;
    stage.seed = seed;
    stage.background = random.random_range(5.0..120.0);
    let gain = if random.random_bool(0.33) { random.random_range(0.15..0.4) } else { 1.0 };
    stage.light = vec![LightKey { time_s: 0.0, gain }];
    let people = match kind {
        Kind::Covered => random.random_range(4..9),
        _ if random.random_bool(0.5) => random.random_range(1..5),
        _ => 0,
    };
    for _ in 0..people {
        let beside = Vector3::new(random.random_range(-0.5..0.5) * size_m[0], -0.3 * distance, random.random_range(-0.4..0.4) * size_m[1]);
        let half_size_m = [random.random_range(0.05..0.2) * size_m[0], random.random_range(0.1..0.4) * size_m[1]];
        let grey = random.random_range(20.0..160.0);
        stage.occluders.push(Occluder { centre: Point3::from(beside), swing: Vector3::zeros(), period_s: 1.0, half_size_m, grey });
    }
    let mut other = picture(kind, seed + 1000, size_m);
    if kind == Kind::Shared {
        let band = (random.random_range(0.15..0.35) * f64::from(shown.height())) as u32;
        let shared = |x: u32, y: u32| if y < band { *shown.get_pixel(x, y) } else { *other.get_pixel(x, y) };
        other = GrayImage::from_fn(shown.width(), shown.height(), shared);
    }
    let truth = stage.truth(0.0).inverse().renamed();
    let frame = Frame::new(Renderer::new(stage).render(0.0, 0), Default::default(), 0);
    Scene { kind, camera, truth, frame, size_m, shown: body(shown, size_m), other: body(other, size_m) }
}

/// Returns the pose after a random step of at most this size, in rotation and translation.
fn moved(truth: &Pose<Camera, Body>, off: f64, random: &mut Pcg64Mcg) -> Pose<Camera, Body> {
    let mut step = |size: f64| Vector3::from_fn(|_, _| random.random_range(-size..=size));
    let (shift, turn) = (step(off * truth.translation.norm()), UnitQuaternion::from_scaled_axis(step(off)));
    Pose::new(turn * truth.rotation, truth.translation + shift)
}

/// Returns the pose with the backdrop tilted the other way about the line of sight.
fn mirrored(truth: &Pose<Camera, Body>) -> Pose<Camera, Body> {
    let sight = truth.translation.normalize();
    let normal = truth.rotation * Vector3::y();
    let normal = if normal.dot(&sight) < 0.0 { -normal } else { normal };
    let axis = normal.cross(&sight);
    let Some(direction) = Unit::try_new(axis, 1e-9) else { return *truth };
    Pose::new(UnitQuaternion::from_axis_angle(&direction, 2.0 * axis.norm().asin()) * truth.rotation, truth.translation)
}

fn is_right(pose: &Pose<Camera, Body>, truth: &Pose<Camera, Body>) -> bool {
    let centre = |p: &Pose<Camera, Body>| p.inverse().translation;
    (centre(pose) - centre(truth)).norm() < WRONG_SHIFT * truth.translation.norm() && pose.angle_to(truth) < WRONG_ROTATION
}
