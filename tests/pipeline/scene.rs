//! Small virtual stages, and a way to track what their camera sees.

use std::sync::OnceLock;

use image::GrayImage;
use nalgebra::{Point3, Vector3, Vector6};
use stagepose::diagnostics::capture::VirtualCamera;
use stagepose::diagnostics::simulate::{grey, paint, upright};
use stagepose::{
    BodySpec, Camera, CameraModel, CameraPath, ClipEntry, FrameSource, Intrinsics, Pose, PoseSample, SensorNoise, Spline, Stage, State,
    SurfaceSpec, Tracker, TrackerSetup, VirtualStage, track_entry,
};

use super::record_line::assert_record_holds;

pub const FPS: f64 = 30.0;

/// A webcam's lens with a horizontal angle of view of 58 degrees.
pub fn camera(width: u32, height: u32) -> CameraModel {
    let (w, h) = (f64::from(width), f64::from(height));
    let (fx, fy) = (0.9 * w, 0.902 * w);
    let distortion = [-0.11, 0.06, 0.0006, -0.0004, 0.0];
    CameraModel::new(Intrinsics { width, height, fx, fy, cx: 0.503 * w, cy: 0.494 * h, skew: 0.0, distortion }).unwrap()
}

/// Returns the painted backdrop that most tests use, 4 x 3 m.
pub fn backdrop_art() -> &'static GrayImage {
    static ART: OnceLock<GrayImage> = OnceLock::new();
    ART.get_or_init(|| grey(&paint(1000, 750, 11)))
}

/// Returns a picture like the backdrop, from another seed.
pub fn other_art() -> &'static GrayImage {
    static ART: OnceLock<GrayImage> = OnceLock::new();
    ART.get_or_init(|| grey(&paint(1000, 750, 12)))
}

pub fn surface(name: &str, art: &GrayImage, size_m: [f64; 2], position: Vector3<f64>, rotation_rad: f64) -> SurfaceSpec {
    SurfaceSpec::from_artwork(name.to_owned(), art.clone(), size_m, upright(position, rotation_rad)).unwrap()
}

pub fn backdrop() -> BodySpec {
    body(vec![surface("backdrop", backdrop_art(), [4.0, 3.0], Vector3::zeros(), 0.0)])
}

pub fn body(surfaces: Vec<SurfaceSpec>) -> BodySpec {
    BodySpec::new("stage", surfaces)
}

/// A camera that stands to the side and looks at the backdrop.
pub fn aside() -> CameraPath {
    let mut path = CameraPath::fixed(Point3::new(-0.9, -3.2, 0.3), Point3::new(-0.1, 0.0, 0.05));
    path.roll_rad = 0.03;
    path
}

/// A camera that moves past the backdrop at about 1 m/s.
pub fn past() -> CameraPath {
    let keys = [(-0.5, [-0.9, -3.3, 0.2]), (0.5, [0.0, -3.0, 0.35]), (1.5, [0.9, -3.2, 0.1])].map(|(t, p)| (t, Vector3::from(p)));
    let targets = [(-0.5, Vector3::new(-0.2, 0.0, 0.0)), (1.5, Vector3::new(0.3, 0.0, 0.1))];
    CameraPath { position: Spline::new(&keys).unwrap(), target: Spline::new(&targets).unwrap(), roll_rad: 0.02, shake: None }
}

/// A virtual stage with a low-noise sensor: 0.7 grey levels at level 64, in linear light.
pub fn quiet(camera: CameraModel, path: CameraPath, stage: BodySpec) -> VirtualStage {
    let mut scene = VirtualStage::new(camera, path, stage);
    scene.noise = SensorNoise { read: 0.2, shot: 0.005 };
    scene.background = 9.0;
    scene
}

/// Computes the normalised estimation error squared (NEES) over its six degrees of freedom (C3:
/// p_true = p + δp, R_true = Exp(δθ) R).
pub fn nees_per_freedom(scene: &VirtualStage, sample: &PoseSample) -> f64 {
    let m = sample.measurement.expect("it tracks");
    let truth = truth_of(scene, sample);
    let shift = truth.translation - m.pose.translation;
    let rotation = (truth.rotation * m.pose.rotation.inverse()).scaled_axis();
    let e = Vector6::new(shift.x, shift.y, shift.z, rotation.x, rotation.y, rotation.z);
    e.dot(&(m.covariance.try_inverse().expect("positive definite") * e)) / 6.0
}

/// Returns a setup that matches the virtual stage exactly.
pub fn setup(scene: &VirtualStage) -> TrackerSetup {
    TrackerSetup::from(scene)
}

pub fn rows(scene: &VirtualStage, frames: u64) -> Vec<ClipEntry> {
    let mut source = VirtualCamera::new(scene.clone(), FPS, frames);
    std::iter::from_fn(|| source.next_entry()).collect()
}

/// Tracks rows one by one and checks every record against the contract.
pub fn track_rows(setup: TrackerSetup, rows: &[ClipEntry]) -> Vec<PoseSample> {
    let mut tracker = Tracker::new(setup).expect("a setup that fits");
    let samples: Vec<PoseSample> = rows.iter().map(|row| track_entry(&mut tracker, row)).collect();
    samples.iter().for_each(assert_record_holds);
    samples
}

/// Renders and tracks a stage that is configured exactly.
pub fn track(scene: &VirtualStage, frames: u64) -> Vec<PoseSample> {
    track_rows(setup(scene), &rows(scene, frames))
}

pub fn truth_of(scene: &VirtualStage, sample: &PoseSample) -> Pose<Stage, Camera> {
    scene.truth(sample.timestamp.seconds())
}

/// Returns the position error as a fraction of the camera's distance from the origin, and the angle
/// error in degrees.
pub fn errors(scene: &VirtualStage, sample: &PoseSample) -> (f64, f64) {
    let truth = truth_of(scene, sample);
    let measured = sample.measurement.expect("a tracking sample").pose;
    let shift = (measured.translation - truth.translation).norm() / truth.translation.norm();
    (shift, measured.angle_to(&truth).to_degrees())
}

/// Asserts that every sample tracks, within a fraction of the distance and an angle in degrees. The
/// first sample may await confirmation.
pub fn assert_tracks_within(scene: &VirtualStage, samples: &[PoseSample], share: f64, degrees: f64) {
    let mut worst = (0.0_f64, 0.0_f64);
    for sample in &samples[usize::from(samples[0].state != State::Tracking)..] {
        assert_eq!(sample.state, State::Tracking, "frame {}", sample.sequence);
        let (shift, angle) = errors(scene, sample);
        worst = (worst.0.max(shift), worst.1.max(angle));
    }
    println!("worst of {}: {:.5} of the distance, {:.4} degrees", samples.len(), worst.0, worst.1);
    assert!(worst.0 < share && worst.1 < degrees, "{worst:?}");
}

pub fn states(samples: &[PoseSample]) -> Vec<State> {
    samples.iter().map(|s| s.state).collect()
}
