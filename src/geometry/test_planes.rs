//! Pairs on a known plane, for tests of several solvers.

use nalgebra::{Matrix3, Vector2};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::homography::{Homography, PointPair};

pub fn truth() -> Homography {
    Homography(Matrix3::new(0.8, 0.1, 120.0, -0.05, 0.9, 60.0, 1e-4, -2e-4, 1.0))
}

pub fn pairs(n: usize, noise: f64) -> Vec<PointPair> {
    let mut rng = Pcg64Mcg::seed_from_u64(3);
    (0..n)
        .map(|_| {
            let from = Vector2::new(rng.random_range(0.0..800.0), rng.random_range(0.0..600.0));
            let to = truth().map(from).expect("in front") + noise * Vector2::new(rng.random_range(-1.7..1.7), rng.random_range(-1.7..1.7));
            PointPair { from, to }
        })
        .collect()
}

pub fn corner_error(h: &Homography) -> f64 {
    [(0.0, 0.0), (800.0, 0.0), (800.0, 600.0), (0.0, 600.0)]
        .map(|(x, y)| (h.map(Vector2::new(x, y)).expect("in front") - truth().map(Vector2::new(x, y)).expect("in front")).norm())
        .into_iter()
        .fold(0.0, f64::max)
}
