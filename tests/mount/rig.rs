//! A rig of two cameras in front of painted boards, and what each camera sees from a few places.

use std::path::{Path, PathBuf};

use image::GrayImage;
use nalgebra::{Point3, UnitQuaternion, Vector3};
use stagepose::diagnostics::geometry::FilmingCamera;
use stagepose::diagnostics::simulate::{artwork_surface, grey, look_at, paint, upright};
use stagepose::{BodySpec, Camera, CameraModel, CameraPath, Intrinsics, Pose, Renderer, SensorNoise, Stage, SurfaceSpec, VirtualStage};

/// A board of 4 x 3 m centred on its own origin, painted from a seed.
pub struct Board {
    pub art: GrayImage,
}

pub const SIZE_M: [f64; 2] = [4.0, 3.0];

impl Board {
    pub fn new(seed: u64) -> Self {
        Self { art: grey(&paint(1200, 900, seed)) }
    }

    fn surface(&self) -> SurfaceSpec {
        artwork_surface("board", self.art.clone(), SIZE_M, upright(Vector3::zeros(), 0.0))
    }

    /// Returns a renderer of what a camera sees of the board.
    fn renderer(&self, camera: CameraModel) -> Renderer {
        let stage = BodySpec::new("stage", vec![self.surface()]);
        let mut scene = VirtualStage::new(camera, CameraPath::fixed(Point3::new(0.0, -1.0, 0.0), Point3::origin()), stage);
        scene.noise = SensorNoise::webcam();
        scene.background = 60.0;
        scene.samples = 8;
        Renderer::new(scene)
    }
}

/// Returns the path of a still camera with this pose.
fn standing(pose: &Pose<Stage, Camera>) -> CameraPath {
    let at = Point3::from(pose.translation);
    let target = at + pose.rotation * Vector3::z();
    let level = look_at(at, target, 0.0);
    let roll_rad = (level.rotation.inverse() * pose.rotation).scaled_axis().z;
    CameraPath { roll_rad, ..CameraPath::fixed(at, target) }
}

pub fn tracking_camera() -> CameraModel {
    CameraModel::pinhole(640, 480, 540.0, 540.0, 319.5, 239.5).unwrap()
}

pub fn filming_camera() -> CameraModel {
    let distortion = [-0.08, 0.02, 0.0003, -0.0002, 0.0];
    CameraModel::new(Intrinsics { width: 960, height: 540, fx: 790.0, fy: 788.0, cx: 484.0, cy: 266.0, skew: 0.0, distortion }).unwrap()
}

/// Returns `T_tracking_filming`: the cameras are 0.4 m and 25 degrees apart.
pub fn mount() -> Pose<Camera, FilmingCamera> {
    let rotation = Vector3::new(0.25, 1.0, 0.2).normalize() * 25.0_f64.to_radians();
    Pose::new(UnitQuaternion::from_scaled_axis(rotation), Vector3::new(0.3, -0.2, 0.17).normalize() * 0.4)
}

/// Returns the tracking camera's pose for a rig at (x, y, z), panned, tilted and rolled (degrees,
/// like a tripod head) from the pose in which both cameras look equally far off upstage.
pub fn rig([x, y, z]: [f64; 3], [pan, tilt, roll]: [f64; 3]) -> Pose<Stage, Camera> {
    let level = look_at(Point3::origin(), Point3::new(0.0, 1.0, 0.0), 0.0).rotation;
    let half_back = UnitQuaternion::from_scaled_axis(mount().rotation.scaled_axis() * -0.5);
    let about = |axis, degrees: f64| UnitQuaternion::from_axis_angle(&axis, degrees.to_radians());
    let rotated = about(Vector3::z_axis(), pan) * about(Vector3::x_axis(), tilt) * about(Vector3::y_axis(), roll);
    Pose::new(rotated * level * half_back, Vector3::new(x, y, z))
}

/// Returns the filming camera's pose in the tracking camera's stage.
pub fn filming(tracking: &Pose<Stage, Camera>) -> Pose<Stage, Camera> {
    // The filming camera's optical frame is also a camera frame.
    (*tracking * mount()).renamed()
}

/// Writes what a camera sees from these places as a folder of pictures, with its config and
/// calibration beside it.
pub fn write(folder: &Path, name: &str, camera: CameraModel, board: &Board, poses: &[Pose<Stage, Camera>]) -> PathBuf {
    let clip = folder.join(name);
    std::fs::create_dir_all(&clip).unwrap();
    let mut renderer = board.renderer(camera);
    for (pose, seed) in poses.iter().zip(1..) {
        renderer = renderer.with_path(standing(pose), seed);
        renderer.render(0.0, seed).save(clip.join(format!("{:03}.png", seed - 1))).unwrap();
    }
    board.art.save(folder.join(format!("{name}-board.png"))).unwrap();
    let i = camera.intrinsics();
    let lens = format!(
        "width = {}\nheight = {}\nfx = {:?}\nfy = {:?}\ncx = {:?}\ncy = {:?}\nskew = 0.0\ndistortion = {:?}\n",
        i.width, i.height, i.fx, i.fy, i.cx, i.cy, i.distortion
    );
    std::fs::write(folder.join(format!("{name}-camera.toml")), lens).unwrap();
    let config =
        format!("[camera]\ncalibration = \"{name}-camera.toml\"\n[[stage.surface]]\nimage = \"{name}-board.png\"\nsize_m = {SIZE_M:?}\n");
    std::fs::write(folder.join(format!("{name}.toml")), config).unwrap();
    clip
}
