//! The scene of the demo and of the fixture: a dolly ride past a backdrop with a flat in front of
//! it.

use nalgebra::{UnitQuaternion, Vector3};
use thiserror::Error;

use super::backdrop::{grey, paint, paint_boards};
use super::path::{CameraPath, PathError, Shake, Spline};
use super::sensor::SensorNoise;
use super::stage::{LightKey, VirtualStage, artwork_surface};
use super::upright::upright;
use crate::camera::{CameraError, CameraModel, Intrinsics};
use crate::geometry::Pose;
use crate::track::BodySpec;

/// The options of the dolly scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dolly {
    /// Picture width in pixels.
    pub width: u32,
    /// Picture height in pixels.
    pub height: u32,
    /// Seed of the pictures, the shake and the noise.
    pub seed: u64,
    /// Duration of the camera's motion, seconds.
    pub duration_s: f64,
    /// Width of the backdrop's artwork in pixels, which spans 4 m.
    pub artwork_width: u32,
}

/// Why the scene cannot be made.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum DollyError {
    /// The picture size is not valid for a camera.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// The duration is not a finite number.
    #[error(transparent)]
    Path(#[from] PathError),
}

/// Makes the scene: a backdrop of 4 x 3 m around the stage's origin, and a flat of 1.1 x 1.7 m that
/// stands 0.8 m in front of it and is turned aside. A camera with some barrel distortion and a
/// rolling shutter moves back and forth 3 to 4 m away, with a slight shake, while the light changes
/// slowly.
pub fn dolly(choice: Dolly) -> Result<VirtualStage, DollyError> {
    let artwork = |across: f64, metres: [f64; 2], seed: u64| {
        let [w, h] = metres.map(|m| (f64::from(choice.artwork_width) * across * m / metres[0]).round().max(1.0) as u32);
        grey(&paint(w, h, seed))
    };
    let (backdrop_m, flat_m, floor_m) = ([4.0, 3.0], [1.1, 1.7], [9.0, 6.0]);
    let backdrop = artwork_surface("backdrop", artwork(1.0, backdrop_m, choice.seed), backdrop_m, upright(Vector3::zeros(), 0.0));
    let flat_pose = upright(Vector3::new(0.95, -0.8, -0.65), -0.35);
    let flat = artwork_surface("flat", artwork(0.35, flat_m, choice.seed ^ 0xf1a7), flat_m, flat_pose);
    // The floor lies face up; the top of its picture points upstage.
    let floor_pose = Pose::new(UnitQuaternion::identity(), Vector3::new(0.0, -2.7, -1.52));
    let floor = artwork_surface("floor", grey(&paint_boards(900, 600, choice.seed)), floor_m, floor_pose);

    let stage = BodySpec::new("stage", vec![backdrop, flat]);
    let mut scene = VirtualStage::new(camera(choice.width, choice.height)?, ride(choice.duration_s, choice.seed)?, stage);
    scene.scenery = vec![floor];
    scene.light = [0.0, 2.0, 5.0, 9.0].into_iter().zip([0.9, 1.0, 0.8, 0.95]).map(|(time_s, gain)| LightKey { time_s, gain }).collect();
    scene.shutter.exposure_s = 1.0 / 120.0;
    scene.shutter.readout_s = 0.01;
    scene.noise = SensorNoise::webcam();
    scene.background = 9.0;
    scene.seed = choice.seed;
    Ok(scene)
}

/// Returns a lens with a horizontal field of view of 58 degrees and a webcam's barrel distortion.
fn camera(width: u32, height: u32) -> Result<CameraModel, CameraError> {
    let focal = 0.9 * f64::from(width);
    CameraModel::new(Intrinsics {
        width,
        height,
        fx: focal,
        fy: focal,
        cx: 0.503 * f64::from(width),
        cy: 0.494 * f64::from(height),
        skew: 0.0,
        distortion: [-0.11, 0.06, 0.0006, -0.0004, 0.0],
    })
}

/// Returns the camera's path: it oscillates sideways in ten seconds, and in distance and height
/// with other periods, so that it never repeats.
fn ride(duration_s: f64, seed: u64) -> Result<CameraPath, PathError> {
    // Interval between keys, seconds: a tenth of the shortest period, so that the spline follows
    // the waves. Raised, their crests are cut off.
    const KEY_EVERY_S: f64 = 0.5;
    // One key beyond the end: exposure and readout extend past the last stamp.
    let keys = (duration_s / KEY_EVERY_S).ceil() as i64 + 1;
    let wave = |t: f64, period_s: f64| (std::f64::consts::TAU * t / period_s).cos();
    let key = |k: i64| {
        let t = k as f64 * KEY_EVERY_S;
        let position = Vector3::new(-1.2 * wave(t, 10.0), -3.5 - 0.45 * wave(t, 7.3), 0.1 - 0.2 * wave(t, 6.1));
        let target = Vector3::new(-0.25 * wave(t, 8.7), 0.0, -0.05 + 0.1 * wave(t, 5.3));
        ((t, position), (t, target))
    };
    let (positions, targets): (Vec<_>, Vec<_>) = (-1..=keys).map(key).unzip();
    let shake = Shake::new(0.0015, 0.0008, 4.0, seed);
    Ok(CameraPath { position: Spline::new(&positions)?, target: Spline::new(&targets)?, roll_rad: 0.02, shake: Some(shake) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ride_is_as_smooth_as_a_dolly_and_stays_in_front() {
        let choice = Dolly { width: 64, height: 48, seed: 2, duration_s: 12.0, artwork_width: 80 };
        let scene = dolly(choice).unwrap();
        let mut last = scene.truth(0.0);
        for k in 1..=360 {
            let pose = scene.truth(f64::from(k) / 30.0);
            assert!((pose.translation - last.translation).norm() < 0.05, "jumps at frame {k}");
            assert!(pose.angle_to(&last) < 0.02, "turns at frame {k}");
            assert!((-4.2..-2.8).contains(&pose.translation.y));
            last = pose;
        }
    }

    #[test]
    fn a_picture_without_pixels_is_refused() {
        let choice = Dolly { width: 0, height: 48, seed: 2, duration_s: 1.0, artwork_width: 80 };
        assert!(matches!(dolly(choice), Err(DollyError::Camera(CameraError::Size { .. }))));
    }
}
