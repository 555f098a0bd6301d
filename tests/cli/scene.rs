//! A folder with a small clip, its config and its calibration, and a way to run the program on it.

use std::path::PathBuf;
use std::process::{Command, Output};

use image::{GrayImage, Luma, imageops};

pub const CAMERA: &str =
    "width = 320\nheight = 240\nfx = 300.0\nfy = 300.0\ncx = 159.5\ncy = 119.5\nskew = 0.0\ndistortion = [0.0, 0.0, 0.0, 0.0, 0.0]\n";
pub const CONFIG: &str = "[camera]\ncalibration = \"camera.toml\"\n[[stage.surface]]\nimage = \"art.png\"\nsize_m = [4.0, 3.0]\n";

pub struct Scene {
    folder: tempfile::TempDir,
}

/// The result of a run.
pub struct Run {
    pub code: i32,
    pub stdout: String,
    pub stderr: String,
}

impl Scene {
    /// Creates six frames that show the artwork from slightly different places, as a folder with
    /// `frames/` and `timestamps.csv`.
    pub fn new() -> Self {
        let scene = Self { folder: tempfile::tempdir().unwrap() };
        scene.write("camera.toml", CAMERA);
        scene.write("stage.toml", CONFIG);
        let art = texture(640, 480);
        art.save(scene.path("art.png")).unwrap();
        GrayImage::from_pixel(640, 480, Luma([120])).save(scene.path("flat.png")).unwrap();
        std::fs::create_dir_all(scene.path("clip/frames")).unwrap();
        let mut stamps = "#timestamp [ns],filename\n".to_owned();
        for k in 0..6_u32 {
            let view = imageops::resize(&art, 280 + 2 * k, 210 + k, imageops::FilterType::Triangle);
            let mut frame = GrayImage::from_pixel(320, 240, Luma([40]));
            imageops::replace(&mut frame, &view, 10 + i64::from(k), 12);
            frame.save(scene.path(&format!("clip/frames/{k:06}.png"))).unwrap();
            stamps += &format!("{},{k:06}.png\n", u64::from(k) * 33_333_333);
        }
        scene.write("clip/timestamps.csv", &stamps);
        scene
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn write(&self, name: &str, text: &str) {
        std::fs::write(self.path(name), text).unwrap();
    }

    pub fn read(&self, name: &str) -> String {
        std::fs::read_to_string(self.path(name)).unwrap()
    }

    /// Writes the config with one text replaced by another.
    pub fn config_with(&self, from: &str, to: &str) {
        assert!(CONFIG.contains(from), "the config has no `{from}`");
        self.write("stage.toml", &CONFIG.replace(from, to));
    }

    /// Changes every readable frame of the clip.
    pub fn change_frames(&self, change: impl Fn(&GrayImage) -> GrayImage) {
        for k in 0..6 {
            let file = self.path(&format!("clip/frames/{k:06}.png"));
            let Ok(frame) = image::open(&file) else { continue };
            change(&frame.into_luma8()).save(&file).unwrap();
        }
    }

    /// Truncates a file to its first `bytes`.
    pub fn truncate(&self, name: &str, bytes: usize) {
        let whole = std::fs::read(self.path(name)).unwrap();
        assert!(whole.len() > bytes);
        std::fs::write(self.path(name), &whole[..bytes]).unwrap();
    }

    /// Runs the program in the scene's folder.
    pub fn run(&self, arguments: &[&str]) -> Run {
        Run::from(self.command(arguments).output().unwrap())
    }

    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = crate::program();
        command.args(arguments).current_dir(self.folder.path()).env_remove("RUST_LOG");
        command
    }

    /// Runs `replay clip --config stage.toml` with further arguments.
    pub fn replay(&self, more: &[&str]) -> Run {
        self.run(&[&["replay", "clip", "--config", "stage.toml"], more].concat())
    }
}

impl From<Output> for Run {
    fn from(output: Output) -> Self {
        let text = |bytes| String::from_utf8(bytes).unwrap();
        Self { code: output.status.code().expect("it was not killed"), stdout: text(output.stdout), stderr: text(output.stderr) }
    }
}

impl Run {
    /// Asserts that the run failed with this code and one sentence that contains all of these
    /// parts. Long work reports its progress as well: "stagepose: 40 %, …".
    pub fn assert_refused(&self, code: i32, parts: &[&str]) {
        assert_eq!(self.code, code, "{}", self.stderr);
        let is_progress = |line: &str| {
            let share = line.strip_prefix("stagepose: ").and_then(|rest| rest.split_once(" %, "));
            share.is_some_and(|(percent, _)| percent.parse::<u32>().is_ok())
        };
        let sentences: Vec<&str> = self.stderr.lines().filter(|line| line.starts_with("stagepose: ") && !is_progress(line)).collect();
        assert_eq!(sentences.len(), 1, "{}", self.stderr);
        for part in parts {
            assert!(sentences[0].contains(part), "`{part}` is not in: {}", sentences[0]);
        }
        assert!(!self.stderr.contains("panicked"), "{}", self.stderr);
    }

    pub fn assert_success(&self) {
        assert_eq!(self.code, 0, "{}", self.stderr);
        assert!(!self.stderr.contains("panicked"), "{}", self.stderr);
    }
}

/// Returns the records in `poses.jsonl`.
pub fn records(scene: &Scene) -> Vec<serde_json::Value> {
    scene.read("poses.jsonl").lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// Returns random blocks of two sizes, which have corners from near and from far.
pub fn texture(width: u32, height: u32) -> GrayImage {
    let mut state = 7_u32;
    let mut level = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        state >> 24
    };
    let coarse: Vec<u32> = (0..1024).map(|_| level()).collect();
    let fine: Vec<u32> = (0..16384).map(|_| level()).collect();
    GrayImage::from_fn(width, height, |x, y| {
        let (c, f) = (coarse[(x / 37 % 32 + y / 31 % 32 * 32) as usize], fine[(x / 9 % 128 + y / 8 % 128 * 128) as usize]);
        Luma([((2 * c + f) / 3) as u8])
    })
}
