//! A rig that is panned by hand, and what cameras on it measure, for the tests.

use nalgebra::{UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::turns::{Turn, Turns};
use crate::frame::Timestamp;

/// A rotation over time: a sum of sways.
pub struct Path(Vec<(Vector3<f64>, f64, f64)>);

impl Path {
    /// Pans by tens of degrees about mostly one axis, with shake; another one for each seed.
    pub fn panned(seed: u64) -> Self {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let mut near = |size: f64| random.random_range(-size..=size);
        let sway = |k: u32| {
            let frequency_hz = 0.2 + 0.25 * f64::from(k) + near(0.1);
            let degrees = Vector3::new(near(2.0), near(14.0), near(1.0)) / f64::from(k + 1).sqrt();
            (degrees.map(f64::to_radians), frequency_hz, near(std::f64::consts::PI))
        };
        Self((0..8).map(sway).collect())
    }

    /// One sway about the vertical.
    pub fn swaying(degrees: f64, frequency_hz: f64) -> Self {
        Self(vec![(Vector3::new(0.0, degrees.to_radians(), 0.0), frequency_hz, 0.3)])
    }

    /// The same, `share` as far.
    pub fn smaller(mut self, share: f64) -> Self {
        self.0.iter_mut().for_each(|(amplitude, ..)| *amplitude *= share);
        self
    }

    pub fn at(&self, time_s: f64) -> UnitQuaternion<f64> {
        let vector = |(amplitude, frequency_hz, phase): &(Vector3<f64>, f64, f64)| {
            amplitude * (std::f64::consts::TAU * frequency_hz * time_s + phase).sin()
        };
        UnitQuaternion::from_scaled_axis(self.0.iter().map(vector).sum::<Vector3<f64>>())
    }
}

/// A camera on the rig.
#[derive(Clone)]
pub struct Filming {
    pub fps: f64,
    /// From the first frame to the last, seconds.
    pub span_s: [f64; 2],
    /// How much later its stamps are than the frames, seconds.
    pub delay_s: f64,
    /// Noise of its poses about each axis, and of its stamps.
    pub noise_rad: f64,
    pub jitter_s: f64,
    /// Rotation from its axes to the rig's.
    pub mount: UnitQuaternion<f64>,
    /// Share of frames without a pose, at random.
    pub lost: f64,
    pub seed: u64,
}

impl Filming {
    pub fn new(fps: f64, delay_s: f64, noise_rad: f64, seed: u64) -> Self {
        let mount = UnitQuaternion::identity();
        Self { fps, span_s: [0.0, 6.0], delay_s, noise_rad, jitter_s: 0.0, mount, lost: 0.0, seed }
    }

    /// Returns the stamped orientations.
    pub fn orientations(&self, path: &Path) -> Vec<(Timestamp, UnitQuaternion<f64>)> {
        let mut random = Pcg64Mcg::seed_from_u64(self.seed);
        // The sum of twelve uniform numbers is normal to good approximation.
        let mut normal = |sigma: f64| (0..12).map(|_| random.random_range(-0.5..0.5)).sum::<f64>() * sigma;
        let frames = (self.span_s[0] * self.fps).ceil() as u32..=(self.span_s[1] * self.fps).floor() as u32;
        let mut rows = Vec::new();
        for k in frames {
            // Free-running: no frames of two cameras coincide.
            let time_s = (f64::from(k) + 0.37) / self.fps;
            let error = Vector3::from_fn(|_, _| normal(self.noise_rad));
            let stamp_s = time_s + self.delay_s + normal(self.jitter_s);
            let is_lost = normal(1.0 / 12_f64.sqrt()).abs() < 0.36 * self.lost;
            let pose = path.at(time_s) * self.mount * UnitQuaternion::from_scaled_axis(error);
            rows.extend((!is_lost).then_some((Timestamp::from_seconds(stamp_s), pose)));
        }
        rows
    }

    pub fn turns(&self, path: &Path) -> Turns {
        Turns::of_orientations(Timestamp::default(), self.orientations(path))
    }

    /// Returns rotations as measured from picture to picture: `gain` times the true ones, each with
    /// noise of its own.
    pub fn turns_of_pictures(&self, path: &Path, gain: f64) -> Turns {
        let exact = Self { noise_rad: 0.0, ..self.clone() }.turns(path);
        let mut random = Pcg64Mcg::seed_from_u64(self.seed + 1000);
        let mut normal = |sigma: f64| (0..12).map(|_| random.random_range(-0.5..0.5)).sum::<f64>() * sigma;
        let noisy = |turn: &Turn| Turn { angle: turn.angle * gain + Vector3::from_fn(|_, _| normal(self.noise_rad)), ..*turn };
        Turns::new(exact.as_slice().iter().map(noisy).collect::<Vec<_>>())
    }
}
