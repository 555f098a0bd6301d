//! Finds the lens and the shape of a flat picture that explain its views: the focal length and the
//! ratio of height to width, each free with the other known, or both.
//!
//! With a known lens, four corners determine a rectangle's shape (Zhang and He, "Whiteboard
//! scanning and image enhancement", 2007); several tilted views determine both (Zhang, 2000). Here
//! all matches of all views contribute: for each trial of lens and shape the best pose of each view
//! is solved, and the trial with the smallest residuals wins.

use nalgebra::{Matrix2, Vector2};

use crate::camera::{CameraModel, Intrinsics, Pixel};
use crate::geometry::planar_pose::planar_poses;
use crate::geometry::resection::{MovingCamera, Observation, resect, squared_residual};
use crate::geometry::{Body, Camera, Homography, PointPair, Pose};
use crate::track::SurfaceView;

/// A trial: the config's lens and shape, each times a factor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shape {
    /// Focal length, relative to the config's.
    pub focal: f64,
    /// Height over width, relative to the config's.
    pub ratio: f64,
    /// Width over height of a pixel, relative to the config's: other than 1 if a clip was
    /// stretched.
    pub pixel: f64,
}

/// The config's own shape and lens.
pub const AS_CONFIGURED: Shape = Shape { focal: 1.0, ratio: 1.0, pixel: 1.0 };

/// The result of a search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Found {
    /// The shape.
    pub shape: Shape,
    /// Mean capped square of the matches' residuals, in sigmas.
    pub left: f64,
    /// Standard deviation of the logarithm of the free factor (for two, of the one that was
    /// searched last).
    pub sigma: f64,
}

/// Views of one surface.
pub struct Views<'a> {
    /// The camera, at the size of the frames.
    pub camera: CameraModel,
    /// Size as configured, metres.
    pub size_m: [f64; 2],
    /// Size of the surface's picture, pixels.
    pub artwork_px: [f64; 2],
    /// One view per frame.
    pub views: Vec<&'a SurfaceView>,
}

/// Noise of a feature's position, pixels of its pyramid level: a round figure, the unit of the
/// residuals. Raised, all residuals shrink, and worse shapes fit.
const NOISE_PX: f64 = 1.0;
/// Cap on squared residuals, in sigmas squared, so that a wrong match counts no more than one at
/// four sigmas. Raised, wrong matches decide more; lowered, a wrong shape looks less wrong.
pub(super) const CUT: f64 = 16.0;
/// Maximum number of matches used per view. Chosen for time: each trial solves a pose for each
/// view. Raised, factors are known a little better, and a check takes longer.
const MAX_MATCHES: usize = 60;
/// Factors are searched from 1 / this to this, in this many steps up and down, each e^0.12 from the
/// next. Chosen, not tuned. With the first raised, swapped sides of longer surfaces are found,
/// whose ratio is off by its square; with fewer steps the best factor may be missed.
const MAX_FACTOR: f64 = 2.6;
const TRIALS: i32 = 8;
/// Maximum number of alternations when two factors are searched. Raised, a check takes longer, and
/// long valleys are followed to their end.
const MAX_ROUNDS: usize = 4;

impl Views<'_> {
    /// Returns the mean capped square of the residuals of free homographies, which no lens and
    /// shape can undercut.
    pub fn floor(&self) -> f64 {
        self.mean(|view| {
            let squared = |m: &&crate::track::SurfaceMatch| {
                let pair = PointPair { from: m.artwork, to: m.undistorted };
                (view.homography.squared_error(&pair) / (NOISE_PX * m.scale).powi(2)).min(CUT)
            };
            view.matches.iter().take(MAX_MATCHES).map(|m| squared(&m)).sum()
        })
    }

    fn mean(&self, cost: impl Fn(&SurfaceView) -> f64) -> f64 {
        let count: usize = self.views.iter().map(|v| v.matches.len().min(MAX_MATCHES)).sum();
        self.views.iter().map(|v| cost(v)).sum::<f64>() / count.max(1) as f64
    }

    /// Returns the mean capped square of the residuals with a lens and a shape.
    pub fn left(&self, shape: Shape) -> f64 {
        let Some((camera, size_m)) = self.trial(shape) else { return CUT };
        self.left_by(&camera, size_m)
    }

    /// Does the same as [`left`](Self::left) with a given lens and size.
    pub fn left_by(&self, camera: &CameraModel, size_m: [f64; 2]) -> f64 {
        self.mean(|view| self.pose_of(view, camera, size_m).map_or(CUT * view.matches.len().min(MAX_MATCHES) as f64, |(cost, _)| cost))
    }

    /// Returns the config's lens and size, changed by a shape; the width stays.
    pub fn trial(&self, shape: Shape) -> Option<(CameraModel, [f64; 2])> {
        let i = *self.camera.intrinsics();
        let camera = CameraModel::new(Intrinsics { fx: i.fx * shape.focal, fy: i.fy * shape.focal * shape.pixel, ..i }).ok()?;
        Some((camera, [self.size_m[0], self.size_m[1] * shape.ratio]))
    }

    /// Finds the best pose of the surface in a view; returns its cost and the pose
    /// (`T_camera_surface`).
    pub fn pose_of(&self, view: &SurfaceView, camera: &CameraModel, size_m: [f64; 2]) -> Option<(f64, Pose<Camera, Body>)> {
        let metres = |p: Vector2<f64>| {
            let [w, h] = self.artwork_px;
            Vector2::new(((p.x + 0.5) / w - 0.5) * size_m[0], (0.5 - (p.y + 0.5) / h) * size_m[1])
        };
        let mut pairs = Vec::with_capacity(MAX_MATCHES);
        let mut observations = Vec::with_capacity(MAX_MATCHES);
        for m in view.matches.iter().take(MAX_MATCHES) {
            let Some(ray) = camera.unproject(Pixel(m.pixel)) else { continue };
            let from = metres(m.artwork);
            pairs.push(PointPair { from, to: ray.0 });
            let information = Matrix2::identity() / (NOISE_PX * m.scale).powi(2);
            observations.push(Observation { point: from.push(0.0).into(), pixel: m.pixel, information, delay_s: 0.0, group: 0 });
        }
        let still = MovingCamera::still(camera);
        let poses = planar_poses(&Homography::from_pairs(&pairs, None)?, &pairs);
        let judged = poses.into_iter().filter_map(|start| {
            let pose = resect(&start.renamed(), &still, &observations, 10)?.pose;
            let cost = observations.iter().map(|o| squared_residual(&pose, &still, o).unwrap_or(CUT).min(CUT)).sum::<f64>();
            Some((cost, pose))
        });
        judged.min_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// Returns the ratio that fits best with the config's lens.
    pub fn free_ratio(&self) -> Found {
        self.along(|ratio| Shape { ratio, ..AS_CONFIGURED })
    }

    /// Returns the focal length that fits best with the config's shape.
    pub fn free_focal(&self) -> Found {
        self.along(|focal| Shape { focal, ..AS_CONFIGURED })
    }

    /// Returns the focal length and the ratio that fit best together.
    pub fn free_both(&self) -> Found {
        let shape = |focal, ratio| Shape { focal, ratio, ..AS_CONFIGURED };
        self.alternately(self.free_ratio(), |found| found.shape.ratio, shape)
    }

    /// Returns the pixel's shape and the focal length that fit best together.
    pub fn free_pixel(&self) -> Found {
        let alone = self.along(|pixel| Shape { pixel, ..AS_CONFIGURED });
        self.alternately(alone, |found| found.shape.pixel, |focal, pixel| Shape { focal, pixel, ..AS_CONFIGURED })
    }

    /// Alternately searches the focal length and another factor, starting from the best of the
    /// latter, until nothing more is gained.
    fn alternately(&self, mut best: Found, factor: impl Fn(&Found) -> f64, shape: impl Fn(f64, f64) -> Shape) -> Found {
        for _ in 0..MAX_ROUNDS {
            let other = factor(&best);
            let focal = self.along(|focal| shape(focal, other)).shape.focal;
            let next = self.along(|other| shape(focal, other));
            let gained = best.left - next.left;
            if next.left < best.left {
                best = next;
            }
            if gained < 0.01 {
                break;
            }
        }
        best
    }

    /// Finds the best factor along a line of shapes: first trials over the whole range, then
    /// golden-section search.
    fn along(&self, shape: impl Fn(f64) -> Shape) -> Found {
        let step = MAX_FACTOR.ln() / f64::from(TRIALS);
        let left = |log: f64| self.left(shape(log.exp()));
        let trials = (-TRIALS..=TRIALS).map(|k| f64::from(k) * step);
        let centre = trials.map(|log| (left(log), log)).min_by(|a, b| a.0.total_cmp(&b.0)).map_or(0.0, |(_, log)| log);
        let golden = 0.5 * (5.0_f64.sqrt() - 1.0);
        let (mut low, mut high) = (centre - step, centre + step);
        let mut inner = [high - golden * (high - low), low + golden * (high - low)];
        let mut values = inner.map(left);
        for _ in 0..9 {
            if values[0] < values[1] {
                high = inner[1];
                inner = [high - golden * (high - low), inner[0]];
                values = [left(inner[0]), values[0]];
            } else {
                low = inner[0];
                inner = [inner[1], low + golden * (high - low)];
                values = [values[1], left(inner[1])];
            }
        }
        let log = 0.5 * (low + high);
        let least = left(log);
        Found { shape: shape(log.exp()), left: least, sigma: self.sigma(&left, log, least) }
    }

    /// Returns the standard deviation, from how much worse the neighbours fit: the sum of squares
    /// rises by its own scale at one sigma.
    fn sigma(&self, left: &impl Fn(f64) -> f64, log: f64, least: f64) -> f64 {
        /// Distance of the neighbours, as a logarithm. Chosen: well above the residual's roughness,
        /// within the parabola. Raised, the cap flattens it and sigma is too large.
        const LOG_STEP: f64 = 0.04;
        let count: usize = self.views.iter().map(|v| v.matches.len().min(MAX_MATCHES)).sum();
        let curvature = (left(log - LOG_STEP) + left(log + LOG_STEP) - 2.0 * least).max(0.0) / (LOG_STEP * LOG_STEP);
        let sigma = (2.0 * least.max(0.05) / (curvature * count.max(1) as f64)).sqrt();
        if sigma.is_finite() { sigma.max(MIN_SIGMA) } else { f64::INFINITY }
    }
}

/// Minimum sigma of a ratio's logarithm, since features of one frame share errors. Chosen, not
/// measured. Raised, smaller deviations pass unmentioned.
const MIN_SIGMA: f64 = 0.002;

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::camera::Normalized;
    use crate::track::SurfaceMatch;

    const SIZE_M: [f64; 2] = [4.0, 3.0];
    const FOCAL_PX: f64 = 600.0;

    fn lens(focal: f64) -> CameraModel {
        CameraModel::pinhole(640, 480, focal, focal, 319.5, 239.5).unwrap()
    }

    /// Tilted views of the picture as it truly is, with half a pixel of noise.
    fn views(count: u32) -> Vec<SurfaceView> {
        let mut random = Pcg64Mcg::seed_from_u64(9);
        let view = |k: u32| {
            let flip = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
            let tilt = UnitQuaternion::from_euler_angles(0.3 * f64::from(k % 3) - 0.2, 0.7 - 0.4 * f64::from(k), 0.1);
            let pose = Pose::<Camera, Body>::new(tilt * flip, Vector3::new(0.1, 0.0, 5.0));
            let mut seen = |_| {
                let artwork = Vector2::new(random.random_range(0.0..800.0), random.random_range(0.0..600.0));
                let metres = Vector2::new((artwork.x / 800.0 - 0.5) * SIZE_M[0], (0.5 - artwork.y / 600.0) * SIZE_M[1]);
                let c = pose.transform(&metres.push(0.0).into());
                let noise = Vector2::new(random.random_range(-0.8..0.8), random.random_range(-0.8..0.8));
                let pixel = lens(FOCAL_PX).project(Normalized(c.coords.xy() / c.z)).0 + noise;
                SurfaceMatch { surface: 0, artwork, pixel, undistorted: pixel, scale: 1.0, derivative: Matrix2::identity() }
            };
            let matches: Vec<SurfaceMatch> = (0..60).map(&mut seen).collect();
            let pairs: Vec<PointPair> = matches.iter().map(|m| PointPair { from: m.artwork, to: m.undistorted }).collect();
            SurfaceView { surface: 0, homography: Homography::from_pairs(&pairs, None).unwrap(), matches }
        };
        (0..count).map(view).collect()
    }

    fn configured(views: &[SurfaceView], focal: f64, size_m: [f64; 2]) -> Views<'_> {
        Views { camera: lens(focal), size_m, artwork_px: [800.0, 600.0], views: views.iter().collect() }
    }

    #[test]
    fn a_correct_config_leaves_only_the_floor_residual() {
        let seen = views(4);
        let views = configured(&seen, FOCAL_PX, SIZE_M);
        let (left, floor) = (views.left(AS_CONFIGURED), views.floor());
        assert!(left < floor + 0.1, "{left} over {floor}");
        let found = views.free_ratio();
        assert!((found.shape.ratio - 1.0).abs() < 3.0 * found.sigma.max(0.004) && found.sigma < 0.01, "{found:?}");
    }

    #[test]
    fn swapped_sides_and_another_lens_are_found() {
        let seen = views(4);
        let swapped = configured(&seen, FOCAL_PX, [3.0, 4.0]);
        assert!(swapped.left(AS_CONFIGURED) > swapped.floor() + 1.0);
        let found = swapped.free_ratio();
        assert!((found.shape.ratio - 0.5625).abs() < 0.02 && found.left < swapped.floor() + 0.1, "{found:?}");
        let long = configured(&seen, 1.7 * FOCAL_PX, SIZE_M);
        let found = long.free_focal();
        assert!((found.shape.focal * 1.7 - 1.0).abs() < 0.05 && found.left < long.floor() + 0.1, "{found:?}");
        let both = configured(&seen, 1.5 * FOCAL_PX, [4.0, 2.0]);
        let found = both.free_both();
        assert!(found.left < both.floor() + 0.1 && (found.shape.ratio - 1.5).abs() < 0.06, "{found:?}");
    }

    #[test]
    fn non_square_pixels_are_not_mistaken_for_another_shape() {
        let mut seen = views(4);
        // 640 x 480 pixels, stretched to 853 x 480.
        for view in &mut seen {
            view.matches.iter_mut().for_each(|m| m.pixel.x = (m.pixel.x + 0.5) * 4.0 / 3.0 - 0.5);
            view.matches.iter_mut().for_each(|m| m.undistorted = m.pixel);
            let pairs: Vec<PointPair> = view.matches.iter().map(|m| PointPair { from: m.artwork, to: m.undistorted }).collect();
            view.homography = Homography::from_pairs(&pairs, None).unwrap();
        }
        let focal = FOCAL_PX * 4.0 / 3.0;
        let camera = CameraModel::pinhole(853, 480, focal, focal, 426.0, 239.5).unwrap();
        let stretched = Views { camera, size_m: SIZE_M, artwork_px: [800.0, 600.0], views: seen.iter().collect() };
        let found = stretched.free_pixel();
        assert!((found.shape.pixel - 0.75).abs() < 0.02 && (found.shape.focal - 1.0).abs() < 0.05, "{found:?}");
        assert!(found.left < stretched.floor() + 0.1 && stretched.free_ratio().left > found.left + 0.1, "{:?}", stretched.free_ratio());
    }

    #[test]
    fn a_fit_without_views_does_not_panic() {
        let views = configured(&[], FOCAL_PX, SIZE_M);
        assert_eq!(views.left(AS_CONFIGURED), 0.0);
        assert!(views.free_both().shape.focal.is_finite());
    }
}
