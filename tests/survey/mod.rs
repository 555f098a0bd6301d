//! `stagepose survey` as a user runs it: on a rendered walk past a stage that differs from its
//! config, and on inputs that are not a walk.

mod bad;
mod mapped;
mod rendered;
mod unkind;

use std::path::Path;
use std::process::Command;
use std::sync::OnceLock;

use image::GrayImage;
use nalgebra::Vector3;
use serde_json::Value;
use stagepose::diagnostics::capture::VirtualCamera;
use stagepose::diagnostics::simulate::upright;
use stagepose::{BodySpec, CameraModel, CameraPath, EntryContent, FrameSource, Intrinsics, Spline, SurfaceSpec, VirtualStage};

use crate::cli::scene::Run;
use crate::pipeline::scene::{backdrop_art, other_art, quiet};

/// The lens that films the walk.
const LENS: Intrinsics = Intrinsics {
    width: 480,
    height: 270,
    fx: 400.0,
    fy: 401.0,
    cx: 243.0,
    cy: 133.0,
    skew: 0.0,
    distortion: [-0.1, 0.05, 0.0004, -0.0003, 0.0],
};
const FPS: f64 = 12.0;
const FRAMES: u64 = 36;

/// A folder with a walk and its stage as measured by hand, and a way to run the program on it.
pub struct Walk {
    folder: tempfile::TempDir,
}

/// The true stage: a backdrop with a flat in front of it.
fn stage() -> BodySpec {
    let surface = |name: &str, art: &GrayImage, size_m, position, rotation| {
        SurfaceSpec::from_artwork(name.to_owned(), art.clone(), size_m, upright(position, rotation)).expect("texture enough")
    };
    BodySpec::new(
        "stage",
        vec![
            surface("backdrop", backdrop_art(), [4.0, 3.0], Vector3::zeros(), 0.0),
            surface("flat", other_art(), [1.2, 0.9], Vector3::new(0.9, -0.6, -0.3), 0.2),
        ],
    )
}

/// A walk of three seconds from one side to the other, nearer and farther, with the camera rolled
/// slightly.
fn path() -> CameraPath {
    let keys = [(-0.5, [-2.2, -2.6, 0.3]), (0.8, [-0.8, -2.4, 0.8]), (1.8, [0.7, -3.4, -0.2]), (3.5, [2.1, -2.5, 0.4])];
    let targets = [(-0.5, [-0.3, 0.0, 0.1]), (1.0, [0.3, 0.0, -0.2]), (2.0, [-0.4, 0.0, 0.2]), (3.5, [0.4, 0.0, 0.0])];
    let spline = |keys: &[(f64, [f64; 3])]| {
        Spline::new(&keys.iter().map(|(t, p)| (*t, Vector3::from(*p))).collect::<Vec<_>>()).expect("keys in order")
    };
    CameraPath { position: spline(&keys), target: spline(&targets), roll_rad: 0.1, shake: None }
}

/// Returns the frames of the walk, rendered once.
fn frames() -> &'static [GrayImage] {
    static FRAMES_OF_WALK: OnceLock<Vec<GrayImage>> = OnceLock::new();
    FRAMES_OF_WALK.get_or_init(|| filmed(path(), stage()))
}

/// Renders what the lens shows of a stage along a path.
fn filmed(path: CameraPath, stage: BodySpec) -> Vec<GrayImage> {
    let mut scene: VirtualStage = quiet(CameraModel::new(LENS).expect("a camera"), path, stage);
    scene.samples = 9;
    let mut source = VirtualCamera::new(scene, FPS, FRAMES);
    let entries = std::iter::from_fn(|| source.next_entry());
    entries
        .filter_map(|row| match row.content {
            EntryContent::Frame(frame) => Some(frame.image),
            _ => None,
        })
        .collect()
}

fn calibration(lens: &Intrinsics) -> String {
    format!(
        "width = {}\nheight = {}\nfx = {:?}\nfy = {:?}\ncx = {:?}\ncy = {:?}\nskew = 0.0\ndistortion = {:?}\n",
        lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy, lens.distortion
    )
}

impl Walk {
    /// Creates the walk with a config whose lens is right and whose flat is off by 20 mm and a
    /// degree.
    pub fn new() -> Self {
        let walk = Self { folder: tempfile::tempdir().expect("a folder") };
        backdrop_art().save(walk.path("backdrop.png")).expect("it can be written");
        other_art().save(walk.path("flat.png")).expect("it can be written");
        walk.write("camera.toml", &calibration(&LENS));
        walk.write(
            "stage.toml",
            "# As measured by tape.\n[camera]\ncalibration = \"camera.toml\"\n\n[[stage.surface]]\nimage = \"backdrop.png\"\nsize_m = [4.0, 3.0]\n\n\
             [[stage.surface]]\nimage = \"flat.png\"\nsize_m = [1.2, 0.9]\nposition_m = [0.915, -0.588, -0.305]\nrotation_deg = [0.0, 0.5, 12.4]\n",
        );
        walk.save("walk", frames());
        walk
    }

    /// Writes pictures as a clip.
    pub fn save(&self, name: &str, frames: &[GrayImage]) {
        std::fs::create_dir_all(self.path(name).join("frames")).expect("it can be made");
        let mut stamps = "#timestamp [ns],filename\n".to_owned();
        for (k, frame) in frames.iter().enumerate() {
            frame.save(self.path(name).join(format!("frames/{k:06}.png"))).expect("it can be written");
            stamps += &format!("{},{k:06}.png\n", (1e9 / FPS) as u64 * k as u64);
        }
        self.write(&format!("{name}/timestamps.csv"), &stamps);
    }

    /// Writes every third frame as the clip `short`: enough for a survey that succeeds, where its
    /// accuracy is not the question.
    pub fn shorten(&self) {
        self.save("short", &frames().iter().step_by(3).cloned().collect::<Vec<_>>());
    }

    pub fn path(&self, name: &str) -> std::path::PathBuf {
        self.folder.path().join(name)
    }

    pub fn write(&self, name: &str, text: &str) {
        std::fs::write(self.path(name), text).expect("it can be written");
    }

    pub fn read(&self, name: &str) -> String {
        std::fs::read_to_string(self.path(name)).expect("it is there")
    }

    pub fn json(&self, name: &str) -> Value {
        serde_json::from_str(&self.read(name)).expect("JSON")
    }

    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = crate::program();
        command.args(arguments).current_dir(self.folder.path()).env_remove("RUST_LOG");
        command
    }

    pub fn run(&self, arguments: &[&str]) -> Run {
        Run::from(self.command(arguments).output().expect("the program runs"))
    }

    /// Returns all files in a folder, with their bytes.
    pub fn files(&self, name: &str) -> Vec<(String, Vec<u8>)> {
        let entry =
            |path: &Path| (path.file_name().expect("a name").to_string_lossy().into_owned(), std::fs::read(path).expect("it can be read"));
        let mut files: Vec<_> =
            std::fs::read_dir(self.path(name)).expect("a folder").map(|e| entry(&e.expect("an entry").path())).collect();
        files.sort();
        files
    }
}
