//! A stage, a walk around it, and the tiles that its frames would show, for this module's tests; no
//! picture is rendered.

use image::GrayImage;
use nalgebra::{Matrix2, UnitQuaternion, Vector2, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::stage_model::StageModel;
use crate::camera::{Intrinsics, Normalized, Shutter};
use crate::geometry::{Body, Camera, Pose};
use crate::motion::Motion;
use crate::track::{KnownRates, ObservedFrame, ObservedTile, ReferenceKind, SurfaceShape, SurfaceSpec};

pub const LENS: Intrinsics = Intrinsics {
    width: 1280,
    height: 720,
    fx: 900.0,
    fy: 905.0,
    cx: 645.0,
    cy: 352.0,
    skew: 0.0,
    distortion: [-0.15, 0.06, 0.0004, -0.0007, 0.0],
};

/// A backdrop of 4 x 3 m, its face towards +z, and a flat before it.
pub fn stage() -> Vec<SurfaceSpec> {
    let surface = |name: &str, size_m, pose| SurfaceSpec {
        name: name.to_owned(),
        artwork: GrayImage::new(64, 64),
        size_m,
        pose,
        kind: ReferenceKind::Artwork,
        shape: SurfaceShape::Flat,
        doubt: crate::track::SurfaceDoubt::default(),
        transfer: crate::light::Transfer::default(),
    };
    let stand = Pose::new(UnitQuaternion::from_euler_angles(0.1, -0.3, 0.02), Vector3::new(0.9, -0.4, 0.7));
    vec![surface("backdrop", [4.0, 3.0], Pose::identity()), surface("flat", [1.0, 1.2], stand)]
}

/// Cameras on an arc of 70 degrees in front of the stage, at different heights and distances,
/// looking at its centre.
pub fn camera_poses(n: usize) -> Vec<Pose<Body, Camera>> {
    let pose = |k: usize| {
        let t = k as f64 / (n - 1).max(1) as f64;
        let (angle, distance) = ((t - 0.5) * 1.2, 3.2 + 0.6 * (9.0 * t).sin());
        let place = Vector3::new(distance * angle.sin(), 0.5 * (7.0 * t).cos(), distance * angle.cos());
        let target = Vector3::new(0.4 * (5.0 * t).sin(), 0.2 * (3.0 * t).cos(), 0.0);
        let forward = (target - place).normalize();
        let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.3 * (11.0 * t).sin());
        let right = forward.cross(&Vector3::y()).normalize();
        let rotation = nalgebra::Matrix3::from_columns(&[right, forward.cross(&right), forward]);
        let looking = Pose::<Body, Camera>::from_matrix(&rotation, place);
        Pose::new(looking.rotation * roll, place)
    };
    (0..n).map(pose).collect()
}

/// The tiles that frames with these motions show of the true stage, each as its shift from a
/// model's prediction, with noise (one sigma, pixels).
pub fn observed(truth: &StageModel, model: &StageModel, motions: &[Motion], noise_px: f64, seed: u64) -> Vec<ObservedFrame> {
    observed_on([10, 8], truth, model, motions, noise_px, seed)
}

/// Like [`observed`], with this number of tiles across and down each surface.
pub fn observed_on(
    [across, down]: [i32; 2],
    truth: &StageModel,
    model: &StageModel,
    motions: &[Motion],
    noise_px: f64,
    seed: u64,
) -> Vec<ObservedFrame> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut gauss = move || (0..12).map(|_| random.random_range(-0.5..0.5)).sum::<f64>();
    // Where a model shows a point, and when its row is exposed.
    let seen = |model: &StageModel, motion: &Motion, surface: usize, on_picture_m: [f64; 2]| {
        let spec = &model.surfaces[surface];
        let place = spec.pose.transform(&spec.shape.at(on_picture_m).place.into());
        let shutter = Shutter { readout_s: model.readout_s(), exposure_s: 0.0 };
        let mut delay_s = 0.0;
        for _ in 0..8 {
            let c = motion.after(delay_s).pose.inverse().transform(&place).coords;
            let pixel = model.camera.project(Normalized(Vector2::new(c.x / c.z, c.y / c.z))).0;
            let is_inside = c.z > 0.1 && (0.0..1280.0).contains(&pixel.x) && (0.0..720.0).contains(&pixel.y);
            let later_s = is_inside.then(|| shutter.delay_s(pixel.y + 0.5, 720))?;
            if later_s == delay_s {
                return Some((pixel, delay_s));
            }
            delay_s = later_s;
        }
        let c = motion.after(delay_s).pose.inverse().transform(&place).coords;
        Some((model.camera.project(Normalized(Vector2::new(c.x / c.z, c.y / c.z))).0, delay_s))
    };
    let mut frame = |motion: &Motion| {
        let mut tiles = Vec::new();
        for (surface, spec) in model.surfaces.iter().enumerate() {
            for k in 0..across * down {
                let share = |n: i32, of: i32| (f64::from(n) + 0.5) / f64::from(of) - 0.5;
                let on_picture_m = [
                    share(k % across, across) * spec.size_m[0] + 0.03 * gauss(),
                    share(k / across, down) * spec.size_m[1] + 0.03 * gauss(),
                ];
                let (Some((real, _)), Some((expected, delay_s))) =
                    (seen(truth, motion, surface, on_picture_m), seen(model, motion, surface, on_picture_m))
                else {
                    continue;
                };
                tiles.push(ObservedTile {
                    surface,
                    on_picture_m,
                    shift_px: real - expected + Vector2::new(gauss(), gauss()) * noise_px,
                    information: Matrix2::identity() / noise_px.max(1e-3).powi(2),
                    delay_s,
                    number: k as u32,
                });
            }
        }
        let means = [motion.velocity, motion.angular_velocity, motion.acceleration, motion.angular_acceleration];
        let rates = (means != [Vector3::zeros(); 4]).then_some(KnownRates { means, sigmas: [0.01, 0.005, 1.0, 0.3] });
        ObservedFrame { motion: *motion, rates, tiles }
    };
    motions.iter().map(&mut frame).collect()
}
