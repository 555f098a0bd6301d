//! The scenes: short cuts of the kinds that `../shared/bench` has, on painted pictures. Metres and
//! seconds, in the stage frame. All of them are in linear light.

mod cloth;

use nalgebra::{Point3, Vector3};
use stagepose::diagnostics::simulate::{artwork_surface, grey, paint, upright};
use stagepose::{
    BodySpec, CameraModel, CameraPath, Intrinsics, LightKey, LightModel, MovingObject, ObjectPath, Person, Roll, SensorNoise, Shake,
    Spline, Spot, SurfaceSpec, ToneCurve, VirtualStage,
};

use crate::film::Film;

/// A scene by its name.
pub struct Scene {
    pub name: &'static str,
    /// What happens, for the README.
    pub what: &'static str,
    pub film: fn() -> Film,
}

/// All scenes in the order of the table.
pub const SCENES: [Scene; 10] = [
    Scene { name: "dolly", what: "past the backdrop and nearer, 4.7 to 3.4 m away", film: dolly },
    Scene { name: "still", what: "nothing moves but the sensor's noise, 3 m", film: still },
    Scene { name: "handheld", what: "a shaking hand, rolling shutter (12 ms), motion blur", film: handheld },
    Scene { name: "whip", what: "pans so fast that the blur is a dozen pixels, with rests between them", film: whip },
    Scene { name: "steep", what: "around to the side, up to 76 degrees, while the camera rolls by 140", film: steep },
    Scene { name: "actors", what: "three people in front, two moving spots, light down to 30 %", film: actors },
    Scene { name: "blackout", what: "the lens is covered twice, for 9 frames each, while the camera goes elsewhere", film: blackout },
    Scene { name: "relief", what: "three flats in front of the backdrop, all configured", film: relief },
    Scene { name: "props", what: "three moving objects, and a person who walks in front", film: props },
    Scene { name: "cloth", what: "a backdrop of folded cloth, its folds configured", film: cloth::cloth },
];

/// Frame width and height, pixels. Larger frames cost more time to render than they add.
const SIZE: (u32, u32) = (960, 540);
/// Texels a metre of the pictures on the cloth: about as many as pixels from the nearest place.
/// Raised, painting takes longer.
const TEXELS_A_METRE: f64 = 400.0;

pub fn names() -> String {
    SCENES.map(|scene| scene.name).join(", ")
}

/// A key of a camera's path: when, where, and what it looks at.
type Key = (f64, [f64; 3], [f64; 3]);

fn spline(keys: impl Iterator<Item = (f64, [f64; 3])>) -> Spline {
    let keys: Vec<_> = keys.map(|(time_s, point)| (time_s, Vector3::from(point))).collect();
    Spline::new(&keys).expect("keys in order of time")
}

fn path(keys: &[Key]) -> CameraPath {
    let position = spline(keys.iter().map(|(time_s, at, _)| (*time_s, *at)));
    let target = spline(keys.iter().map(|(time_s, _, target)| (*time_s, *target)));
    CameraPath { position, target, roll_rad: 0.0, shake: None }
}

/// A webcam of 70 degrees across, with its barrel distortion.
fn wide() -> CameraModel {
    camera(0.707, [-0.19, 0.07, -0.0008, 0.0011, 0.0])
}

/// One of 65 degrees across.
fn normal() -> CameraModel {
    camera(0.79, [-0.11, 0.13, 0.0006, -0.0004, -0.02])
}

fn camera(focal_of_width: f64, distortion: [f64; 5]) -> CameraModel {
    let (width, height) = SIZE;
    let focal = focal_of_width * f64::from(width);
    let (cx, cy) = (0.508 * f64::from(width), 0.49 * f64::from(height));
    let intrinsics = Intrinsics { width, height, fx: focal, fy: 0.998 * focal, cx, cy, skew: 0.0, distortion };
    CameraModel::new(intrinsics).expect("a camera")
}

/// A painted surface that stands at a place, turned about the vertical.
fn painted(name: &str, seed: u64, size_m: [f64; 2], at: [f64; 3], rotation_rad: f64) -> SurfaceSpec {
    let [width, height] = size_m.map(|side| (side * TEXELS_A_METRE) as u32);
    artwork_surface(name, grey(&paint(width, height, seed)), size_m, upright(Vector3::from(at), rotation_rad))
}

fn backdrop(seed: u64, size_m: [f64; 2]) -> BodySpec {
    BodySpec::new("stage", vec![painted("backdrop", seed, size_m, [0.0; 3], 0.0)])
}

/// Linear light and a noisy sensor, with nothing else that is hard.
fn staged(camera: CameraModel, path: CameraPath, stage: BodySpec) -> VirtualStage {
    let mut scene = VirtualStage::new(camera, path, stage);
    scene.light_model = LightModel::Linear(ToneCurve::default());
    scene.noise = SensorNoise::linear_webcam();
    scene.background = 25.0;
    scene.samples = 8;
    scene.shutter.exposure_s = 0.004;
    scene
}

/// Accuracy: past the backdrop and nearer.
fn dolly() -> Film {
    let path = path(&[
        (0.0, [1.6, -4.4, 0.2], [0.2, 0.0, 0.0]),
        (0.5, [1.1, -4.1, 0.35], [0.1, 0.0, 0.1]),
        (1.0, [0.5, -3.8, 0.3], [0.0, 0.0, 0.1]),
        (1.7, [-0.4, -3.4, 0.1], [-0.1, 0.0, 0.0]),
    ]);
    Film { stage: staged(wide(), path, backdrop(10, [4.2, 3.15])), fps: 30.0, frames: 50, jpeg: None }
}

/// Scatter and bias: nothing moves but the noise.
fn still() -> Film {
    let path = CameraPath { roll_rad: 0.05, ..path(&[(0.0, [-0.7, -2.9, 0.25], [0.1, 0.0, 0.0])]) };
    let mut stage = staged(wide(), path, backdrop(11, [3.2, 2.2]));
    stage.shutter.exposure_s = 0.0;
    stage.samples = 16;
    Film { stage, fps: 60.0, frames: 40, jpeg: None }
}

/// A shaking hand, a rolling shutter, blur.
fn handheld() -> Film {
    let mut path = path(&[
        (0.0, [-0.6, -2.6, 0.1], [0.0, 0.0, 0.0]),
        (0.8, [-0.1, -2.1, 0.3], [-0.2, 0.0, 0.1]),
        (1.7, [0.7, -2.4, 0.0], [0.1, 0.0, 0.0]),
    ]);
    path.shake = Some(Shake::new(0.01, 0.012, 7.0, 12));
    let mut stage = staged(normal(), path, backdrop(12, [3.0, 2.2]));
    (stage.shutter.exposure_s, stage.shutter.readout_s, stage.samples) = (0.012, 0.012, 16);
    Film { stage, fps: 30.0, frames: 50, jpeg: Some(85) }
}

/// Pans so fast that the blur is a dozen pixels, with rests between them.
fn whip() -> Film {
    let (at, to) = ([0.0, -3.2, 0.0], |x: f64, z: f64| [x, 0.0, z]);
    let path = path(&[
        (0.0, at, to(1.0, 0.0)),
        (0.4, at, to(1.0, 0.0)),
        (0.7, [0.02, -3.2, 0.0], to(-0.9, 0.1)),
        (0.95, at, to(-0.9, 0.1)),
        (1.2, [0.0, -3.2, 0.02], to(0.6, -0.3)),
        (1.5, at, to(0.6, -0.3)),
        (1.75, [0.05, -3.2, 0.0], to(-0.7, 0.2)),
        (2.0, at, to(-0.7, 0.2)),
    ]);
    let mut stage = staged(wide(), path, backdrop(16, [5.0, 3.4]));
    (stage.shutter.exposure_s, stage.shutter.readout_s, stage.samples) = (0.006, 0.008, 24);
    Film { stage, fps: 30.0, frames: 60, jpeg: None }
}

/// Round to the side until the backdrop is seen at 76 degrees, while the camera rolls by 140.
fn steep() -> Film {
    let centre = [0.0; 3];
    let path = path(&[
        (0.0, [0.0, -2.6, 0.0], centre),
        (0.75, [-1.5, -2.2, 0.2], centre),
        (1.5, [-2.2, -1.2, 0.3], centre),
        (2.25, [-2.5, -0.75, 0.2], centre),
        (3.0, [-2.45, -0.62, 0.1], centre),
    ]);
    let mut stage = staged(wide(), path, backdrop(13, [2.4, 2.4]));
    let roll = [0.0, 20.0, 60.0, 100.0, 140.0_f64].iter().enumerate().map(|(k, degrees)| (0.75 * k as f64, degrees.to_radians()));
    stage.roll = Some(Roll::new(&roll.collect::<Vec<_>>()).expect("keys in order of time"));
    Film { stage, fps: 20.0, frames: 60, jpeg: None }
}

/// Someone who walks along x from a place, in clothes as full of detail as the backdrop.
fn person(seed: u64, at: [f64; 3], swing_m: f64, period_s: f64, phase: f64) -> Person {
    let (centre, half_size_m) = (Point3::from(at), [0.32, 0.95]);
    let [width, height] = half_size_m.map(|half| (2.0 * half * TEXELS_A_METRE) as u32);
    let swing = Vector3::new(swing_m, 0.0, 0.0);
    Person { centre, swing, period_s, phase, half_size_m, clothes: grey(&paint(width, height, seed)) }
}

/// Three people in front, two spots that swing, the light down to 30 % and back.
fn actors() -> Film {
    let mut path = path(&[
        (0.0, [0.8, -3.6, 0.1], [0.0, 0.0, 0.0]),
        (1.25, [0.2, -3.1, 0.2], [-0.1, 0.0, 0.0]),
        (2.5, [-0.5, -3.5, 0.0], [0.0, 0.0, 0.1]),
    ]);
    path.shake = Some(Shake::new(0.002, 0.0015, 6.0, 14));
    let mut stage = staged(normal(), path, backdrop(14, [4.2, 2.8]));
    stage.people = vec![
        person(41, [-0.4, -1.4, -0.2], 1.1, 3.1, 0.0),
        person(42, [0.5, -1.9, -0.2], 0.9, 2.3, 0.4),
        person(43, [0.0, -0.8, -0.2], 1.4, 4.3, 0.2),
    ];
    let spot = |lamp: [f64; 3], aim: [f64; 3], swing_m: f64, period_s: f64, gain: f32| {
        let (lamp, aim, swing) = (Point3::from(lamp), Point3::from(aim), Vector3::new(swing_m, 0.0, 0.0));
        Spot { lamp, aim, swing, period_s, width_rad: 0.09, gain }
    };
    stage.spots = vec![spot([-2.0, -4.5, 3.0], [-0.5, 0.0, 0.0], 0.9, 3.0, 1.2), spot([2.0, -4.5, 3.0], [0.8, 0.0, 0.3], -0.7, 2.2, 0.8)];
    let keys = [(0.0, 1.0), (0.7, 1.0), (1.0, 0.3), (1.6, 0.3), (1.8, 1.1), (2.5, 0.8)];
    stage.light = keys.map(|(time_s, gain)| LightKey { time_s, gain }).to_vec();
    stage.shutter.exposure_s = 0.01;
    Film { stage, fps: 20.0, frames: 50, jpeg: Some(88) }
}

/// Covered twice, and back elsewhere.
fn blackout() -> Film {
    let path = path(&[
        (0.0, [1.5, -3.5, 0.0], [0.0, 0.0, 0.0]),
        (0.5, [1.3, -3.5, 0.0], [0.0, 0.0, 0.0]),
        (0.8, [-1.4, -2.8, 0.4], [-0.2, 0.0, 0.1]),
        (1.3, [-1.2, -2.8, 0.4], [-0.2, 0.0, 0.1]),
        (1.6, [0.3, -4.6, -0.3], [0.0, 0.0, 0.0]),
        (2.0, [0.4, -4.4, -0.3], [0.0, 0.0, 0.0]),
    ]);
    let mut stage = staged(wide(), path, backdrop(15, [4.0, 3.0]));
    stage.blackouts = vec![0.5..0.8, 1.3..1.6];
    Film { stage, fps: 30.0, frames: 60, jpeg: None }
}

/// Flats before the backdrop, all of them known.
fn relief() -> Film {
    let surfaces = vec![
        painted("backdrop", 17, [4.4, 3.0], [0.0; 3], 0.0),
        painted("left", 171, [0.9, 1.6], [-1.3, -1.1, -0.5], 0.44),
        painted("right", 172, [1.0, 1.4], [1.2, -0.8, -0.6], -0.52),
        painted("front", 173, [0.8, 0.8], [0.2, -1.6, -0.9], 0.09),
    ];
    let path = path(&[
        (0.0, [1.2, -4.2, 0.2], [0.0, -0.4, 0.0]),
        (0.8, [-0.1, -3.6, 0.4], [0.0, -0.5, -0.1]),
        (1.6, [-1.3, -4.0, 0.1], [0.0, -0.4, 0.0]),
    ]);
    Film { stage: staged(wide(), path, BodySpec::new("stage", surfaces)), fps: 30.0, frames: 48, jpeg: None }
}

/// Objects that move before a moving camera, and a person before them: one object leaves and comes
/// back.
fn props() -> Film {
    let object = |name: &str, seed: u64, size_m: [f64; 2], rotation_rad: f64, angular_velocity_rad_s: f64, keys: &[(f64, [f64; 3])]| {
        let body = BodySpec::new(name, vec![painted(name, seed, size_m, [0.0; 3], 0.0)]);
        MovingObject { body, path: ObjectPath { position: spline(keys.iter().copied()), rotation_rad, angular_velocity_rad_s } }
    };
    let mut path = path(&[
        (0.0, [0.8, -4.0, 0.2], [0.0, -0.3, 0.0]),
        (1.0, [-0.1, -3.5, 0.3], [0.0, -0.4, -0.1]),
        (2.0, [-0.9, -3.8, 0.1], [0.0, -0.3, 0.0]),
    ]);
    path.shake = Some(Shake::new(0.002, 0.002, 6.0, 308));
    let mut stage = staged(wide(), path, backdrop(308, [4.2, 3.2]));
    stage.objects = vec![
        object("cart", 309, [0.9, 0.7], -0.26, 0.4, &[(0.0, [1.3, -0.9, -0.6]), (1.0, [0.2, -1.2, -0.55]), (2.0, [-0.9, -0.9, -0.6])]),
        object("tray", 310, [0.5, 0.5], 0.0, 0.3, &[(0.0, [-0.6, -1.0, 0.2]), (1.0, [-0.2, -1.3, 0.5]), (2.0, [0.5, -1.1, 0.3])]),
        object(
            "flag",
            311,
            [0.45, 0.6],
            0.17,
            -0.2,
            &[
                (0.0, [-1.0, -1.2, 0.3]),
                (0.5, [-3.4, -1.0, 0.3]),
                (1.0, [-3.4, -1.0, 0.3]),
                (1.5, [-0.9, -1.3, 0.35]),
                (2.0, [-0.8, -1.2, 0.1]),
            ],
        ),
    ];
    stage.people = vec![person(40, [0.0, -1.9, -0.5], 1.3, 3.7, 0.3)];
    stage.shutter.exposure_s = 0.006;
    Film { stage, fps: 30.0, frames: 60, jpeg: Some(90) }
}
