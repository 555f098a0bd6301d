//! A rendered stage as a folder: a backdrop with a flat in front of it, a clip of a camera that
//! moves past, and a correct config.

use std::path::PathBuf;
use std::sync::OnceLock;

use image::{GrayImage, Luma, imageops};
use nalgebra::{Point3, Vector3};
use stagepose::diagnostics::simulate::{artwork_surface, grey, paint, upright};
use stagepose::{BodySpec, CameraModel, CameraPath, Intrinsics, Normalized, Renderer, SensorNoise, Spline, VirtualStage};

pub const FRAMES: usize = 16;
const FPS: f64 = 15.0;
const SIZE_PX: (u32, u32) = (480, 360);
const FOCAL_PX: f64 = 432.0;
const DISTORTION: [f64; 5] = [-0.11, 0.06, 0.0006, -0.0004, 0.0];

/// The correct config.
pub const CONFIG: &str = "[camera]\ncalibration = \"camera.toml\"\nshutter = \"global\"\n\
    [[stage.surface]]\nimage = \"backdrop.png\"\nsize_m = [4.0, 3.0]\n\
    [[stage.surface]]\nimage = \"flat.png\"\nsize_m = [1.1, 1.7]\nposition_m = [0.95, -0.8, -0.65]\n";
/// The same without the flat, with frame 0 as a photograph. CORNERS stands for the four corners.
pub const PHOTO: &str = "[camera]\ncalibration = \"camera.toml\"\nshutter = \"global\"\n[[stage.surface]]\nphoto = \"photo.png\"\ncorners_px = CORNERS\nsize_m = [4.0, 3.0]\n";

/// The pictures, rendered once for all tests.
struct Pictures {
    backdrop: GrayImage,
    flat: GrayImage,
    frames: Vec<GrayImage>,
    corners: [[f64; 2]; 4],
}

fn camera() -> CameraModel {
    let (width, height) = SIZE_PX;
    let (fx, fy, cx, cy) = (FOCAL_PX, FOCAL_PX, 241.0, 178.0);
    CameraModel::new(Intrinsics { width, height, fx, fy, cx, cy, skew: 0.0, distortion: DISTORTION }).unwrap()
}

fn pictures() -> &'static Pictures {
    static PICTURES: OnceLock<Pictures> = OnceLock::new();
    PICTURES.get_or_init(|| {
        let (backdrop, flat) = (grey(&paint(800, 600, 5)), grey(&paint(220, 340, 6)));
        let first = artwork_surface("backdrop", backdrop.clone(), [4.0, 3.0], upright(Vector3::zeros(), 0.0));
        let second = artwork_surface("flat", flat.clone(), [1.1, 1.7], upright(Vector3::new(0.95, -0.8, -0.65), 0.0));
        let end_s = FRAMES as f64 / FPS;
        let keys = [(-0.2, [-2.2, -5.2, 0.9]), (0.5 * end_s, [0.1, -5.4, 0.3]), (end_s + 0.2, [2.0, -5.0, -0.3])];
        let position = Spline::new(&keys.map(|(t, p)| (t, Vector3::from(p)))).unwrap();
        let path = CameraPath { position, target: Spline::fixed(Vector3::new(0.0, 0.0, 0.0)), roll_rad: 0.03, shake: None };
        let mut scene = VirtualStage::new(camera(), path, BodySpec::new("stage", vec![first, second]));
        scene.noise = SensorNoise { read: 0.2, shot: 0.005 };
        scene.background = 40.0;
        let truth = scene.truth(0.0).inverse();
        let corners = [(-2.0, 1.5), (2.0, 1.5), (2.0, -1.5), (-2.0, -1.5)].map(|(x, z)| {
            let c = truth.transform(&Point3::new(x, 0.0, z));
            let p = camera().project(Normalized(c.coords.xy() / c.z)).0;
            [(p.x * 10.0).round() / 10.0, (p.y * 10.0).round() / 10.0]
        });
        let renderer = Renderer::new(scene);
        let frames = (0..FRAMES).map(|k| renderer.render(k as f64 / FPS, k as u64)).collect();
        Pictures { backdrop, flat, frames, corners }
    })
}

/// A folder with a whole stage, for a test to break.
pub struct Stage {
    folder: tempfile::TempDir,
}

/// The result of a check.
pub struct Said {
    pub code: i32,
    /// Stdout and stderr.
    pub text: String,
}

impl Stage {
    pub fn new() -> Self {
        let stage = Self { folder: tempfile::tempdir().unwrap() };
        let made = pictures();
        made.backdrop.save(stage.path("backdrop.png")).unwrap();
        made.flat.save(stage.path("flat.png")).unwrap();
        made.frames[0].save(stage.path("photo.png")).unwrap();
        std::fs::create_dir_all(stage.path("clip/frames")).unwrap();
        let mut stamps = "#timestamp [ns],filename\n".to_owned();
        for (k, frame) in made.frames.iter().enumerate() {
            frame.save(stage.path(&format!("clip/frames/{k:06}.pgm"))).unwrap();
            stamps += &format!("{},{k:06}.pgm\n", (k as f64 / FPS * 1e9) as u64);
        }
        stage.write("clip/timestamps.csv", &stamps);
        stage.lens(SIZE_PX, FOCAL_PX, DISTORTION);
        stage.write("stage.toml", CONFIG);
        stage
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn write(&self, name: &str, text: &str) {
        std::fs::write(self.path(name), text).unwrap();
    }

    /// Writes the correct config with one text replaced by another.
    pub fn config(&self, from: &str, to: &str) {
        assert!(CONFIG.contains(from), "the config has no `{from}`");
        self.write("stage.toml", &CONFIG.replacen(from, to, 1));
    }

    /// Writes the photograph's config with the true corners in this order, and one text replaced by
    /// another.
    pub fn photo(&self, order: [usize; 4], from: &str, to: &str) {
        let corners = order.map(|k| pictures().corners[k]);
        self.write("stage.toml", &PHOTO.replace("CORNERS", &format!("{corners:?}")).replace(from, to));
    }

    /// Does the same with corners as a person reads them in a viewer, each off by a pixel or two.
    pub fn photo_by_eye(&self, order: [usize; 4], from: &str, to: &str) {
        let off = [[1.2, -0.9], [-1.1, -1.3], [0.8, 1.4], [-1.5, 0.7]];
        let corners = order.map(|k| [0, 1].map(|axis| ((pictures().corners[k][axis] + off[k][axis]) * 10.0).round() / 10.0));
        self.write("stage.toml", &PHOTO.replace("CORNERS", &format!("{corners:?}")).replace(from, to));
    }

    /// Returns the beginning of `corners_px` as messages write it, starting at one of the true
    /// corners.
    pub fn corner(&self, first: usize) -> String {
        let corner = pictures().corners[first];
        format!("corners_px = [[{:?}, {:?}]", corner[0], corner[1])
    }

    /// Writes another calibration, with the principal point at the same relative place.
    pub fn lens(&self, (width, height): (u32, u32), focal: f64, distortion: [f64; 5]) {
        let (cx, cy) = (241.0 / 480.0 * f64::from(width), 178.0 / 360.0 * f64::from(height));
        let text = format!(
            "width = {width}\nheight = {height}\nfx = {focal:?}\nfy = {focal:?}\ncx = {cx:?}\ncy = {cy:?}\nskew = 0.0\ndistortion = {distortion:?}\n"
        );
        self.write("camera.toml", &text);
    }

    /// Changes a picture beside the config.
    pub fn picture(&self, name: &str, change: impl Fn(GrayImage) -> GrayImage) {
        let file = self.path(name);
        change(image::open(&file).unwrap().into_luma8()).save(&file).unwrap();
    }

    /// Changes every frame of the clip; `change` also gets the frame's row number.
    pub fn frames(&self, change: impl Fn(usize, GrayImage) -> GrayImage) {
        for k in 0..FRAMES {
            self.picture(&format!("clip/frames/{k:06}.pgm"), |frame| change(k, frame));
        }
    }

    /// Changes the levels of all frames.
    pub fn levels(&self, change: impl Fn(f32) -> f32) {
        self.frames(|_, mut frame| {
            frame.pixels_mut().for_each(|p| *p = Luma([change(f32::from(p[0])).clamp(0.0, 255.0) as u8]));
            frame
        });
    }

    pub fn frame(&self, k: usize) -> GrayImage {
        pictures().frames[k].clone()
    }

    pub fn check(&self) -> Said {
        let mut command = crate::program();
        command.args(["check", "--config", "stage.toml", "--clip", "clip"]).current_dir(self.folder.path()).env_remove("RUST_LOG");
        let output = command.output().unwrap();
        let text = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap()).concat();
        Said { code: output.status.code().expect("it was not killed"), text }
    }
}

/// Returns a picture centred in a grey frame of the clip's size.
pub fn placed(picture: &GrayImage) -> GrayImage {
    let mut frame = GrayImage::from_pixel(SIZE_PX.0, SIZE_PX.1, Luma([60]));
    let (x, y) = ((SIZE_PX.0 - picture.width()) / 2, (SIZE_PX.1 - picture.height()) / 2);
    imageops::replace(&mut frame, picture, i64::from(x), i64::from(y));
    frame
}
