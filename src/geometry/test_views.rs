//! Rays of a known scene in two views, for tests of several solvers.

use nalgebra::{Matrix3, UnitQuaternion, Vector2, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::homography::PointPair;
use super::relative_pose::{RayPair, TwoViewMotion};

pub fn truth() -> TwoViewMotion {
    TwoViewMotion { rotation: UnitQuaternion::from_euler_angles(0.1, -0.3, 0.05), direction: Vector3::new(0.8, 0.1, 0.3).normalize() }
}

pub fn scene(n: usize, noise: f64, flat: bool, seed: u64) -> Vec<RayPair> {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    (0..n)
        .map(|_| {
            let depth = if flat { 4.0 } else { rng.random_range(3.0..6.0) };
            let p = Vector3::new(rng.random_range(-1.5..1.5), rng.random_range(-1.0..1.0), depth);
            let q = truth().rotation * p + truth().direction;
            let mut jitter = || Vector2::new(rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0)) * noise;
            RayPair { first: p.xy() / p.z + jitter(), second: q.xy() / q.z + jitter() }
        })
        .collect()
}

pub fn errors_deg(m: &TwoViewMotion) -> (f64, f64) {
    let t = truth();
    (m.rotation.angle_to(&t.rotation).to_degrees(), m.direction.dot(&t.direction).clamp(-1.0, 1.0).acos().to_degrees())
}

/// Focal lengths of the two pictures that [`pixels`] makes, pixels.
pub const FOCALS: [f64; 2] = [800.0, 800.0];

/// Converts the rays to pixels of two 1000 x 800 pictures.
pub fn pixels(rays: &[RayPair]) -> Vec<PointPair> {
    let middle = Vector2::new(500.0, 400.0);
    rays.iter().map(|r| PointPair { from: r.first * FOCALS[0] + middle, to: r.second * FOCALS[1] + middle }).collect()
}

/// Returns the fundamental matrix of those, norm 1.
pub fn true_fundamental() -> Matrix3<f64> {
    let k_inverse = Matrix3::new(800.0, 0.0, 500.0, 0.0, 800.0, 400.0, 0.0, 0.0, 1.0).try_inverse().expect("regular");
    (k_inverse.transpose() * truth().essential() * k_inverse).normalize()
}
