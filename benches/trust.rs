//! How right poses differ from wrong ones. The stage is aligned from many starts, near and far, on
//! frames that show it and on frames that show another stage, with people in front and in dim
//! light. The ratio of agreeing tiles and the size of the residuals are then counted separately for
//! right and wrong poses. The verdict's thresholds lie where these counts leave room.
//!
//! `cargo bench --bench trust`; `-- 10` takes ten stages instead of forty.

use nalgebra::{Point3, UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use stagepose::diagnostics::simulate::{artwork_surface, grey, paint, upright};
use stagepose::diagnostics::track::{Alignment, BodyTracker};
use stagepose::{
    Body, BodySpec, Camera, CameraModel, CameraPath, ComputeClock, Frame, Intrinsics, LightKey, Occluder, Pose, Renderer, SensorNoise,
    TrackerSettings, VirtualStage,
};

const STAGES: u64 = 40;
/// Starts per stage at each distance.
const STARTS: usize = 8;
/// How far off the starts are: fraction of the distance, and radians.
const FAR: [f64; 6] = [0.001, 0.005, 0.02, 0.05, 0.1, 0.2];
/// Errors above which a pose is wrong: fraction of the distance, and radians (the tight bounds of
/// contract C5).
const WRONG_SHIFT: f64 = 0.01;
const WRONG_ROTATION: f64 = 0.3 * std::f64::consts::PI / 180.0;
/// Bins of ten percent of agreeing tiles.
const BINS: usize = 10;

/// Counts of one kind of poses.
#[derive(Default)]
struct Counts {
    by_inlier_ratio: [usize; BINS + 1],
    residual_sigmas: Vec<f64>,
    new: usize,
    continued: usize,
    nothing: usize,
}

impl Counts {
    fn add(&mut self, found: &Alignment) {
        self.by_inlier_ratio[(found.inlier_ratio() * BINS as f64) as usize] += 1;
        self.residual_sigmas.push(found.residual_sigma);
        self.new += usize::from(found.is_credible(false));
        self.continued += usize::from(found.is_credible(true));
    }

    fn print(&mut self, name: &str) {
        let n = self.residual_sigmas.len();
        self.residual_sigmas.sort_by(f64::total_cmp);
        let scale = |share: f64| self.residual_sigmas.get(((n as f64 - 1.0) * share) as usize).copied().unwrap_or(f64::NAN);
        println!("\n{name}: {n} poses; from {} more starts nothing converged", self.nothing);
        println!("  given where new: {}, where a track would continue: {}", self.new, self.continued);
        println!("  residuals, sigmas: 5 % below {:.2}, half below {:.2}, 95 % below {:.2}", scale(0.05), scale(0.5), scale(0.95));
        for (k, count) in self.by_inlier_ratio.iter().enumerate().filter(|(_, count)| **count > 0) {
            println!("  {:>3} % of the tiles agree: {count}", 100 / BINS * k);
        }
    }
}

fn main() {
    let stages = std::env::args().filter_map(|a| a.parse().ok()).next().unwrap_or(STAGES);
    let [mut right, mut wrong, mut other] = [Counts::default(), Counts::default(), Counts::default()];
    for seed in 0..stages {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let scene = scene(seed, &mut random);
        let truth: Pose<Camera, Body> = scene.truth(0.0).inverse().renamed();
        let (camera, stage) = (scene.camera, scene.stage.clone());
        let frame = Frame::new(Renderer::new(scene).render(0.0, 0), Default::default(), 0);
        let other_stage = BodySpec::new("stage", vec![surface(seed + 1000, stage.surfaces[0].size_m)]);
        for (is_shown, stage) in [(true, &stage), (false, &other_stage)] {
            let mut matcher = BodyTracker::new(
                camera,
                stagepose::Shutter::default().into(),
                None,
                &[stage],
                TrackerSettings::default(),
                ComputeClock::default(),
                None,
            );
            for (start, off) in FAR.iter().flat_map(|off| (0..STARTS).map(move |_| *off)).map(|off| (moved(&truth, off, &mut random), off))
            {
                let found = matcher.study().try_start(&frame, &start.inverse(), off * truth.translation.norm(), off);
                let is_right = found.is_some_and(|f| is_right(&f.pose.inverse(), &truth));
                let counts = match (is_shown, is_right) {
                    (false, _) => &mut other,
                    (true, true) => &mut right,
                    (true, false) => &mut wrong,
                };
                match &found {
                    Some(found) => counts.add(found),
                    None => counts.nothing += 1,
                }
            }
        }
    }
    right.print("right poses");
    wrong.print("wrong poses of the stage that is shown");
    other.print("poses of a stage that is not shown");
}

fn surface(seed: u64, size_m: [f64; 2]) -> stagepose::SurfaceSpec {
    let picture = grey(&paint(1200, (1200.0 * size_m[1] / size_m[0]) as u32, seed));
    artwork_surface("backdrop", picture, size_m, upright(Vector3::zeros(), 0.0))
}

/// A backdrop seen from anywhere in front of it. Half of the stages have people in front, and a
/// third are dim.
fn scene(seed: u64, random: &mut Pcg64Mcg) -> VirtualStage {
    let size_m = [random.random_range(1.5..6.0), random.random_range(1.2..4.0)];
    let focal = random.random_range(500.0..1100.0);
    let distortion = [random.random_range(-0.15..0.02), 0.03, 0.0005, -0.0004, 0.0];
    let intrinsics = Intrinsics { width: 960, height: 540, fx: focal, fy: focal, cx: 481.0, cy: 268.0, skew: 0.0, distortion };
    let camera = CameraModel::new(intrinsics).expect("a camera");
    let (tilt, around) = (random.random_range(0.0..1.1_f64), random.random_range(0.0..std::f64::consts::TAU));
    let distance = size_m[0] * focal / 960.0 / random.random_range(0.3..1.5);
    let towards = Vector3::new(tilt.sin() * around.cos(), -tilt.cos(), 0.8 * tilt.sin() * around.sin());
    let path = CameraPath::fixed(Point3::from(towards.normalize() * distance), Point3::origin());
    let stage = BodySpec::new("stage", vec![surface(seed, size_m)]);
    let mut scene = VirtualStage::new(camera, path, stage);
    scene.noise = SensorNoise::webcam();
    scene.samples = 8;
    scene.seed = seed;
    scene.background = random.random_range(5.0..120.0);
    let gain = if seed.is_multiple_of(3) { random.random_range(0.15..0.4) } else { 1.0 };
    scene.light = vec![LightKey { time_s: 0.0, gain }];
    for _ in 0..if seed.is_multiple_of(2) { random.random_range(1..6) } else { 0 } {
        let beside = Vector3::new(random.random_range(-0.5..0.5) * size_m[0], -0.3 * distance, random.random_range(-0.4..0.4) * size_m[1]);
        let half_size_m = [random.random_range(0.05..0.2) * size_m[0], random.random_range(0.1..0.4) * size_m[1]];
        let grey = random.random_range(20.0..160.0);
        scene.occluders.push(Occluder { centre: Point3::from(beside), swing: Vector3::zeros(), period_s: 1.0, half_size_m, grey });
    }
    scene
}

/// Returns the pose after a random step of at most this size, in rotation and translation.
fn moved(truth: &Pose<Camera, Body>, off: f64, random: &mut Pcg64Mcg) -> Pose<Camera, Body> {
    let mut step = |size: f64| Vector3::from_fn(|_, _| random.random_range(-size..=size));
    let (shift, turn) = (step(off * truth.translation.norm()), UnitQuaternion::from_scaled_axis(step(off)));
    Pose::new(turn * truth.rotation, truth.translation + shift)
}

fn is_right(pose: &Pose<Camera, Body>, truth: &Pose<Camera, Body>) -> bool {
    let centre = |p: &Pose<Camera, Body>| p.inverse().translation;
    (centre(pose) - centre(truth)).norm() < WRONG_SHIFT * truth.translation.norm() && pose.angle_to(truth) < WRONG_ROTATION
}
