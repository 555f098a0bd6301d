//! Puts an adjusted map where the configured surfaces say that it is.
//!
//! In the joint adjustment a poster is a small part of every picture, and a few of its tiles decide
//! on frame and scale. Tracked alone, it has all of a frame's pixels, and its poses scatter without
//! a common error: over a hundred keyframes their mean is ten times better than one of them. So the
//! map is moved, turned and scaled as a whole, until its cameras fit those poses best.

use nalgebra::{UnitQuaternion, Vector3};

use crate::geometry::robust_kernel::median;
use crate::geometry::{Body, Camera, Pose};

/// Number of rounds of reweighting. Raised, nothing is gained.
const ROUNDS: usize = 10;
/// Distance at which a camera counts half, in robust sigmas. Raised, badly tracked keyframes pull
/// more; lowered, good ones count less.
const HALF_WEIGHT: f64 = 2.0;
/// Minimum robust sigma of a camera's position, metres, to divide by.
const MIN_SIGMA_M: f64 = 1e-9;
/// Minimum number of cameras.
const MIN_CAMERAS: usize = 3;

/// A motion and a scale that map one body frame to another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Anchoring {
    /// Factor on all lengths.
    scale: f64,
    rotation: UnitQuaternion<f64>,
    /// Metres, after scaling and rotation.
    shift: Vector3<f64>,
    /// One sigma of the scale, as a fraction.
    pub scale_sigma: f64,
}

impl Anchoring {
    /// Fits cameras, each given as its pose in the map and as the surfaces say. `None` if there are
    /// too few, or all in one place.
    pub fn of(cameras: &[[Pose<Body, Camera>; 2]]) -> Option<Self> {
        if cameras.len() < MIN_CAMERAS {
            return None;
        }
        let mut weights = vec![1.0; cameras.len()];
        let mut found = None;
        for _ in 0..ROUNDS {
            let fit = Self::weighted(cameras, &weights)?;
            let errors: Vec<f64> = cameras.iter().map(|[map, wanted]| (fit.place(&map.translation) - wanted.translation).norm()).collect();
            // The median length of a three-dimensional normal error is 1.54 sigma.
            let sigma_m = (median(&mut errors.clone())? / 1.54).max(MIN_SIGMA_M);
            weights = errors.iter().map(|error| 1.0 / (1.0 + (error / (HALF_WEIGHT * sigma_m)).powi(2))).collect();
            let (middle, total) = middle(cameras.iter().map(|[map, _]| map.translation), &weights);
            let spread: f64 = cameras.iter().zip(&weights).map(|([map, _], w)| w * (map.translation - middle).norm_squared()).sum();
            found = Some(Self { scale_sigma: sigma_m / spread.sqrt().max(MIN_SIGMA_M), ..fit }).filter(|_| total > 0.0);
        }
        found
    }

    fn weighted(cameras: &[[Pose<Body, Camera>; 2]], weights: &[f64]) -> Option<Self> {
        let mut rotation = cameras[0][1].rotation * cameras[0][0].rotation.inverse();
        for _ in 0..ROUNDS {
            let off = cameras.iter().map(|[map, wanted]| (wanted.rotation * map.rotation.inverse() * rotation.inverse()).scaled_axis());
            rotation = UnitQuaternion::from_scaled_axis(middle(off, weights).0) * rotation;
        }
        let (from, _) = middle(cameras.iter().map(|[map, _]| map.translation), weights);
        let (to, _) = middle(cameras.iter().map(|[_, wanted]| wanted.translation), weights);
        let sums = cameras.iter().zip(weights).map(|([map, wanted], w)| {
            let [own, other] = [rotation * (map.translation - from), wanted.translation - to];
            (w * own.dot(&other), w * own.norm_squared())
        });
        let (product, square) = sums.fold((0.0, 0.0), |(a, b), (c, d)| (a + c, b + d));
        let scale = product / square;
        (scale.is_finite() && scale > 0.0).then(|| Self {
            scale,
            rotation,
            shift: to - rotation * from * scale,
            scale_sigma: f64::INFINITY,
        })
    }

    /// Returns where a point of the map is.
    fn place(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * point * self.scale + self.shift
    }

    /// Returns where something of the map is.
    pub fn pose<T>(&self, pose: &Pose<Body, T>) -> Pose<Body, T> {
        Pose::new(self.rotation * pose.rotation, self.place(&pose.translation))
    }

    /// Returns how long a length of the map is.
    pub fn length(&self, length: f64) -> f64 {
        self.scale * length
    }
}

/// Returns the weighted mean of vectors, and the sum of the weights.
fn middle(values: impl Iterator<Item = Vector3<f64>>, weights: &[f64]) -> (Vector3<f64>, f64) {
    let (sum, total) = values.zip(weights).fold((Vector3::zeros(), 0.0), |(sum, total), (v, w)| (sum + v * *w, total + w));
    (sum / total, total)
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::super::super::synthetic::camera_poses;
    use super::*;

    /// Cameras of a map that is 300 ppm too small, turned and shifted, with errors of `sigma_m` and
    /// some outliers.
    fn cameras(sigma_m: f64) -> Vec<[Pose<Body, Camera>; 2]> {
        let mut random = Pcg64Mcg::seed_from_u64(3);
        let turn = UnitQuaternion::from_euler_angles(0.02, -0.01, 0.03);
        let mut noisy = |size: f64| Vector3::from_fn(|_, _| size * random.random_range(-1.7..1.7));
        let pair = |(k, wanted): (usize, &Pose<Body, Camera>)| {
            let map = Pose::new(turn * wanted.rotation, turn * wanted.translation * 0.9997 + Vector3::new(0.1, -0.2, 0.05));
            let outlier = if k % 10 == 4 { 0.05 } else { 0.0 };
            [map, wanted.moved(&(noisy(sigma_m) + Vector3::new(outlier, 0.0, 0.0)), &noisy(0.2 * sigma_m))]
        };
        camera_poses(60).iter().enumerate().map(pair).collect()
    }

    #[test]
    fn a_turned_shifted_and_scaled_map_is_put_back_despite_outliers() {
        for sigma_m in [0.0, 5e-4] {
            let cameras = cameras(sigma_m);
            let found = Anchoring::of(&cameras).unwrap();
            let within = 1e-7 + 0.7 * sigma_m;
            for (pair, truth) in cameras.iter().zip(camera_poses(60)) {
                let error = found.pose(&pair[0]).translation - truth.translation;
                assert!(error.norm() < within, "{sigma_m}: {error}");
            }
            let error = found.length(0.9997) - 1.0;
            assert!(
                error.abs() < 1e-7 + 4.0 * found.scale_sigma && found.scale_sigma < 1e-7 + 0.2 * sigma_m,
                "{error} {}",
                found.scale_sigma
            );
        }
    }

    #[test]
    fn cameras_in_one_place_give_no_scale() {
        let pose = camera_poses(1)[0];
        assert!(Anchoring::of(&[[pose; 2]; 5]).is_none());
        assert!(Anchoring::of(&[[pose; 2]; 2]).is_none());
    }
}
