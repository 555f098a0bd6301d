//! A folder of rendered chessboard pictures, and a way to run the program in it.

use std::path::PathBuf;
use std::process::Command;
use std::sync::OnceLock;

use image::{GrayImage, Rgb, RgbImage};
use nalgebra::{UnitQuaternion, Vector2, Vector3};
use stagepose::diagnostics::calibrate::Board;
use stagepose::{CameraModel, Intrinsics, Pose};

use super::rendered::{BoardPhotographer, Photograph};

pub const FX: f64 = 300.0;

pub struct Scene {
    folder: tempfile::TempDir,
}

pub struct Run {
    pub code: i32,
    pub stdout: String,
    pub stderr: String,
}

/// A camera whose picture is `scale` times as large.
fn photographer_of(scale: f64) -> BoardPhotographer {
    let (distortion, f) = ([-0.2, 0.05, 0.0, 0.0, 0.0], FX * scale);
    let intrinsics = Intrinsics { width: 320, height: 240, fx: f, fy: f, cx: 161.0, cy: 118.0, skew: 0.0, distortion };
    BoardPhotographer::new(CameraModel::new(intrinsics).expect("a possible camera"))
}

fn photographer() -> &'static BoardPhotographer {
    static CAMERA: OnceLock<BoardPhotographer> = OnceLock::new();
    CAMERA.get_or_init(|| photographer_of(1.0))
}

/// Renders view `k` of a 7x5 board, tilted by `tilt` rad in a direction that changes with `k`.
pub fn view(k: usize, tilt: f64) -> GrayImage {
    view_by(photographer(), k, tilt, k as u64)
}

/// Renders view `k` in colour, with red `scale` times as large as green and blue.
pub fn view_with_large_red(k: usize, tilt: f64, scale: f64) -> RgbImage {
    let others = [1, 2].map(|c| view_by(photographer(), k, tilt, (100 * c + k) as u64));
    let red = view_by(&photographer_of(scale), k, tilt, k as u64);
    let level = |plane: &GrayImage, x, y| plane.get_pixel(x, y).0[0];
    RgbImage::from_fn(320, 240, |x, y| Rgb([level(&red, x, y), level(&others[0], x, y), level(&others[1], x, y)]))
}

fn view_by(camera: &BoardPhotographer, k: usize, tilt: f64, seed: u64) -> GrayImage {
    let board = Board::new(7, 5, 0.025).expect("a possible board");
    let azimuth = 1.57 * k as f64 + 0.4;
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(azimuth.cos(), azimuth.sin(), 0.0) * tilt);
    let aside = Vector3::new(0.07 * ((k % 3) as f64 - 1.0), 0.05 * ((k / 3 % 3) as f64 - 1.0), 0.33 + 0.03 * (k % 2) as f64);
    let pose = Pose::new(rotation, aside - rotation * Vector3::new(0.075, 0.05, 0.0));
    let is_in_view = |p: &Vector2<f64>| (0.0..320.0).contains(&p.x) && (0.0..240.0).contains(&p.y);
    assert!(camera.corners(&board, &pose).iter().any(is_in_view), "view {k} shows no corner of the board");
    camera.photograph(&board, &pose, &Photograph { blur_px: 0.6, noise: 1.0, seed, ..Photograph::default() })
}

impl Scene {
    /// Creates a folder `pictures` with `count` views.
    pub fn new(count: usize, tilt: f64) -> Self {
        let scene = Self { folder: tempfile::tempdir().expect("a temporary folder") };
        std::fs::create_dir(scene.path("pictures")).expect("it is new");
        for k in 0..count {
            view(k, tilt).save(scene.path(&format!("pictures/{k:02}.png"))).expect("it can be written");
        }
        scene
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn read(&self, name: &str) -> String {
        std::fs::read_to_string(self.path(name)).expect("it was written")
    }

    pub fn json(&self, name: &str) -> serde_json::Value {
        serde_json::from_str(&self.read(name)).expect("it is JSON")
    }

    /// Runs the program in the folder.
    pub fn run(&self, arguments: &[&str]) -> Run {
        let mut command = Command::new(env!("CARGO_BIN_EXE_stagepose"));
        let output = command.args(arguments).current_dir(self.folder.path()).env_remove("RUST_LOG").output().expect("it starts");
        let text = |bytes| String::from_utf8(bytes).expect("it prints UTF-8");
        Run { code: output.status.code().expect("it was not killed"), stdout: text(output.stdout), stderr: text(output.stderr) }
    }

    /// Runs `calibrate pictures --board 7x5 --square-mm 25` with further arguments.
    pub fn calibrate(&self, more: &[&str]) -> Run {
        self.run(&[&["calibrate", "pictures", "--board", "7x5", "--square-mm", "25"], more].concat())
    }
}

impl Run {
    #[track_caller]
    pub fn assert_success(&self) {
        assert_eq!(self.code, 0, "{}{}", self.stdout, self.stderr);
    }

    /// Asserts that the run failed with this code and one sentence that contains all of these
    /// parts.
    #[track_caller]
    pub fn assert_refused(&self, code: i32, parts: &[&str]) {
        assert_eq!(self.code, code, "{}{}", self.stdout, self.stderr);
        assert_eq!(self.stderr.lines().count(), 1, "{}", self.stderr);
        for part in parts {
            assert!(self.stderr.contains(part), "`{part}` is not in: {}", self.stderr);
        }
    }
}
