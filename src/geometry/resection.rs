//! Resection: the six degrees of freedom of a body from its points in one picture, including lens
//! distortion.
//!
//! Levenberg-Marquardt on robustly weighted reprojection errors. Each correspondence has its own
//! information matrix, so a point on an edge constrains the pose only across that edge.

use std::cell::{Cell, RefCell};
use std::ops::ControlFlow;

use nalgebra::{Matrix2, Matrix6, Point3, SMatrix, UnitQuaternion, Vector2, Vector3, Vector6};

use super::least_squares::{Damping, Options, Problem, minimise};
use super::pose::{Body, Camera, Pose, skew};
use super::robust_kernel::{tukey_cost, tukey_weight};

/// Projection of rays to pixels; the camera module implements it.
pub trait Projection {
    /// Returns the pixel of the normalised point (x/z, y/z) and its 2x2 derivative.
    fn pixel_and_jacobian(&self, normalized: Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>);
}

/// A known point of a body and the pixel where it was seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Position in the body frame, metres.
    pub point: Point3<f64>,
    /// Raw pixel.
    pub pixel: Vector2<f64>,
    /// Inverse covariance of the pixel, 1/px².
    pub information: Matrix2<f64>,
    /// Exposure time of its row, seconds after the middle row (negative above it; 0 for a global
    /// shutter).
    pub delay_s: f64,
    /// Groups correlated observations (a tile of the picture); used only for the covariance.
    pub group: u32,
}

/// A body's motion in the camera: rate of the left perturbation [δt, δθ] of `T_camera_body`, per
/// second, camera axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Twist(pub Vector6<f64>);

impl Twist {
    /// Returns zero motion.
    pub fn still() -> Self {
        Self(Vector6::zeros())
    }

    /// Returns the motion that leads from one pose to another in `dt_s` seconds.
    pub fn between(before: &Pose<Camera, Body>, after: &Pose<Camera, Body>, dt_s: f64) -> Self {
        let rotation = after.rotation * before.rotation.inverse();
        let shift = after.translation - rotation * before.translation;
        let angle = rotation.scaled_axis();
        Self(Vector6::new(shift.x, shift.y, shift.z, angle.x, angle.y, angle.z) / dt_s)
    }

    /// Moves a point in camera axes by `delay_s`, to second order in the angle, which is small
    /// during a readout.
    fn carried(&self, c: Vector3<f64>, delay_s: f64) -> Vector3<f64> {
        let shift = Vector3::new(self.0[0], self.0[1], self.0[2]) * delay_s;
        let angle = Vector3::new(self.0[3], self.0[4], self.0[5]) * delay_s;
        let first = angle.cross(&c);
        c + shift + first + 0.5 * angle.cross(&first)
    }
}

/// A moving camera: its projection, and the body's motion while its rows are read.
#[derive(Debug, Clone, Copy)]
pub struct MovingCamera<'a, P> {
    /// The lens.
    pub lens: &'a P,
    /// The body's motion.
    pub twist: Twist,
}

impl<'a, P> MovingCamera<'a, P> {
    /// Creates a camera at rest, or one that exposes all rows at once.
    pub fn still(lens: &'a P) -> Self {
        Self { lens, twist: Twist::still() }
    }
}

/// A refined pose and its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Resection {
    /// `T_camera_body`.
    pub pose: Pose<Camera, Body>,
    /// Robust cost: sum of ρ over the observations.
    pub cost: f64,
    /// Scale of the residuals in sigmas (1 if the information matrices are accurate).
    pub scale: f64,
    /// J^T W J at the solution, for the left perturbation [δt, δθ] of `T_camera_body` in camera
    /// axes.
    pub normal: Matrix6<f64>,
}

/// Step size at which the iteration has converged: radians, and relative to the distance. Far below
/// what a picture can resolve and far above rounding. Raised to measurement accuracy, poses stop
/// short; lowered, iterations are wasted.
const MIN_STEP: f64 = 1e-9;

/// Squared Mahalanobis residuals of a pose; a reusable buffer.
#[derive(Debug, Clone, Default)]
pub struct SquaredResiduals {
    /// The pose they belong to; `None` before the first.
    pose: Option<Pose<Camera, Body>>,
    /// One per observation; `None` behind the camera.
    each: Vec<Option<f64>>,
    /// The existing ones, for finding their median.
    sorted: Vec<f64>,
}

impl SquaredResiduals {
    /// Creates an empty buffer with capacity for this many observations, to avoid later
    /// allocations.
    pub fn with_room_for(observations: usize) -> Self {
        Self { pose: None, each: Vec::with_capacity(observations), sorted: Vec::with_capacity(observations) }
    }

    fn take<P: Projection>(&mut self, pose: &Pose<Camera, Body>, camera: &MovingCamera<P>, observations: &[Observation]) {
        self.each.clear();
        self.each.extend(observations.iter().map(|o| squared_residual(pose, camera, o)));
        self.pose = Some(*pose);
    }

    /// Returns the median of |r| divided by its value for two-dimensional Gaussian noise (sqrt(2 ln
    /// 2)); at least 1. `None` for fewer than four.
    fn scale(&mut self) -> Option<f64> {
        self.sorted.clear();
        self.sorted.extend(self.each.iter().flatten());
        if self.sorted.len() < 4 {
            return None;
        }
        let middle = self.sorted.len() / 2;
        let (_, median, _) = self.sorted.select_nth_unstable_by(middle, f64::total_cmp);
        Some((median.sqrt() / 1.177_410_022_515_474_6).max(1.0))
    }
}

/// Returns the squared Mahalanobis residual of one observation; `None` behind the camera.
pub fn squared_residual<P: Projection>(pose: &Pose<Camera, Body>, camera: &MovingCamera<P>, o: &Observation) -> Option<f64> {
    let c = camera.twist.carried(pose.transform(&o.point).coords, o.delay_s);
    if c.z < 1e-6 {
        return None;
    }
    let (pixel, _) = camera.lens.pixel_and_jacobian(Vector2::new(c.x / c.z, c.y / c.z));
    let r = pixel - o.pixel;
    Some((r.transpose() * o.information * r).x)
}

/// Returns the pixel residual and its 2x6 derivative by a left perturbation [δt, δθ]: T <- (Exp δθ,
/// δt) T, in camera axes; `None` behind the camera.
pub fn residual_and_jacobian<P: Projection>(
    pose: &Pose<Camera, Body>,
    camera: &MovingCamera<P>,
    o: &Observation,
) -> Option<(Vector2<f64>, SMatrix<f64, 2, 6>)> {
    let c = camera.twist.carried(pose.transform(&o.point).coords, o.delay_s);
    if c.z < 1e-6 {
        return None;
    }
    let n = Vector2::new(c.x / c.z, c.y / c.z);
    let (pixel, distortion) = camera.lens.pixel_and_jacobian(n);
    let iz = 1.0 / c.z;
    let by_point = distortion * SMatrix::<f64, 2, 3>::new(iz, 0.0, -n.x * iz, 0.0, iz, -n.y * iz);
    let mut j = SMatrix::<f64, 2, 6>::zeros();
    j.fixed_columns_mut::<3>(0).copy_from(&by_point);
    // d(Exp(δθ) c)/dδθ = -[c]x
    j.fixed_columns_mut::<3>(3).copy_from(&(-by_point * skew(&c)));
    Some((pixel - o.pixel, j))
}

/// Applies a left perturbation [δt, δθ] in camera axes.
pub fn perturbed(pose: &Pose<Camera, Body>, step: &Vector6<f64>) -> Pose<Camera, Body> {
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(step[3], step[4], step[5]));
    Pose::new(rotation * pose.rotation, rotation * pose.translation + Vector3::new(step[0], step[1], step[2]))
}

/// Refines `start` over all observations; `None` if they do not determine a pose.
///
/// The residual scale is re-estimated in every iteration from the median, and is at least 1 sigma;
/// Tukey's biweight removes residuals beyond 4.7 times it.
pub fn resect<P: Projection>(
    start: &Pose<Camera, Body>,
    camera: &MovingCamera<P>,
    observations: &[Observation],
    iterations: usize,
) -> Option<Resection> {
    resect_within(start, camera, observations, iterations, &mut SquaredResiduals::default())
}

/// Like [`resect`], with a caller-owned buffer.
pub fn resect_within<P: Projection>(
    start: &Pose<Camera, Body>,
    camera: &MovingCamera<P>,
    observations: &[Observation],
    iterations: usize,
    squared: &mut SquaredResiduals,
) -> Option<Resection> {
    if observations.len() < 4 {
        return None;
    }
    let scale = residual_scale(start, camera, observations, squared)?;
    let mut errors = ReprojectionErrors { camera, observations, scale, squared: RefCell::new(squared), is_singular: Cell::new(false) };
    let options = Options { iterations, damping: Damping { now: 1e-6, least: 1e-9, most: 1e4 }, least_gain: 1e-9 };
    let (pose, cost) = minimise(&mut errors, *start, &options);
    if errors.is_singular.get() {
        return None;
    }
    let scale = errors.scale;
    let (normal, _) = normal_equations(&pose, camera, observations, scale);
    pose.is_finite().then_some(Resection { pose, cost, scale, normal })
}

/// Squared Mahalanobis residuals of all observations, under Tukey's biweight at a scale that is
/// re-estimated at each step.
struct ReprojectionErrors<'a, P: Projection> {
    camera: &'a MovingCamera<'a, P>,
    observations: &'a [Observation],
    scale: f64,
    /// Residuals of the last pose evaluated; if that pose is accepted, they are needed again.
    squared: RefCell<&'a mut SquaredResiduals>,
    /// Set if the observations do not determine a pose.
    is_singular: Cell<bool>,
}

impl<P: Projection> Problem for ReprojectionErrors<'_, P> {
    type State = Pose<Camera, Body>;
    type Normal = (Matrix6<f64>, Vector6<f64>);

    fn cost(&self, pose: &Self::State) -> f64 {
        let mut squared = self.squared.borrow_mut();
        if squared.pose != Some(*pose) {
            squared.take(pose, self.camera, self.observations);
        }
        squared.each.iter().map(|squared| tukey_cost(*squared, self.scale)).sum()
    }

    fn linearised(&self, pose: &Self::State) -> Self::Normal {
        normal_equations(pose, self.camera, self.observations, self.scale)
    }

    fn stepped(&self, pose: &Self::State, (normal, gradient): &Self::Normal, damping: f64) -> Option<Self::State> {
        let damped = normal + Matrix6::from_diagonal(&(normal.diagonal() * damping));
        let factor = damped.cholesky();
        self.is_singular.set(factor.is_none());
        Some(perturbed(pose, &-factor?.solve(gradient)))
    }

    fn taken(&mut self, before: &Self::State, pose: &Self::State, _: f64) -> ControlFlow<f64, f64> {
        // Its cost has just been computed, so the residuals are current.
        let Some(scale) = self.squared.get_mut().scale() else {
            self.is_singular.set(true);
            return ControlFlow::Break(f64::INFINITY);
        };
        self.scale = scale;
        let cost = self.cost(pose);
        let rotation = before.rotation.angle_to(&pose.rotation);
        let shift = (pose.translation - before.translation).norm();
        if rotation < MIN_STEP && shift < MIN_STEP * pose.translation.norm() {
            ControlFlow::Break(cost)
        } else {
            ControlFlow::Continue(cost)
        }
    }
}

/// Returns the scale of a pose's residuals in sigmas: the median of |r| divided by its value for
/// two-dimensional Gaussian noise; at least 1. `None` for fewer than four observations.
pub fn residual_scale<P: Projection>(
    pose: &Pose<Camera, Body>,
    camera: &MovingCamera<P>,
    observations: &[Observation],
    squared: &mut SquaredResiduals,
) -> Option<f64> {
    squared.take(pose, camera, observations);
    squared.scale()
}

fn normal_equations<P: Projection>(
    pose: &Pose<Camera, Body>,
    camera: &MovingCamera<P>,
    observations: &[Observation],
    scale: f64,
) -> (Matrix6<f64>, Vector6<f64>) {
    let mut normal = Matrix6::zeros();
    let mut gradient = Vector6::zeros();
    for o in observations {
        let Some((r, j)) = residual_and_jacobian(pose, camera, o) else { continue };
        let squared = (r.transpose() * o.information * r).x;
        let w = tukey_weight(squared, scale);
        if w > 0.0 {
            let jw = j.transpose() * o.information * w;
            normal += jw * j;
            gradient += jw * r;
        }
    }
    (normal, gradient)
}

/// Computes the covariance of the left perturbation [δt, δθ] of `T_camera_body`: in each direction
/// the larger of measurement noise and the scatter that observations of one group share (White's
/// sandwich estimator over groups).
///
/// `None` if the observations leave a direction undetermined, or there are fewer than three groups.
pub fn sandwich_covariance<P: Projection>(
    resection: &Resection,
    camera: &MovingCamera<P>,
    observations: &[Observation],
) -> Option<Matrix6<f64>> {
    let bread = resection.normal.cholesky()?.inverse();
    let mut groups: Vec<(u32, Vector6<f64>)> = Vec::new();
    for o in observations {
        let Some((r, j)) = residual_and_jacobian(&resection.pose, camera, o) else { continue };
        let squared = (r.transpose() * o.information * r).x;
        let score = j.transpose() * o.information * r * tukey_weight(squared, resection.scale);
        match groups.iter_mut().find(|(g, _)| *g == o.group) {
            Some((_, sum)) => *sum += score,
            None => groups.push((o.group, score)),
        }
    }
    let n = groups.len() as f64;
    if n < 3.0 {
        return None;
    }
    // Six parameters were fitted to n group scores: the usual small-sample factor.
    let factor = n / (n - 1.0).max(1.0) * if n > 7.0 { n / (n - 6.0) } else { 7.0 };
    let meat: Matrix6<f64> = groups.iter().map(|(_, s)| s * s.transpose()).sum::<Matrix6<f64>>() * factor;
    let noise = bread * resection.scale.powi(2);
    larger_covariance(&noise, &(bread * meat * bread))
}

/// Returns the larger of noise and scatter in every direction, after whitening by noise; `None` if
/// noise is not positive definite.
pub fn larger_covariance(noise: &Matrix6<f64>, scatter: &Matrix6<f64>) -> Option<Matrix6<f64>> {
    let root = noise.cholesky()?.l();
    let inverse_root = root.try_inverse()?;
    let mut eigen = (inverse_root * scatter * inverse_root.transpose()).symmetric_eigen();
    eigen.eigenvalues.apply(|v| *v = v.max(1.0));
    let covariance = root * eigen.recompose() * root.transpose();
    Some((covariance + covariance.transpose()) * 0.5)
}

/// Returns the pixel where the observation's point would be seen if its row were exposed with the
/// middle one, i.e. without the shift due to motion.
pub fn rolling_shutter_corrected_px<P: Projection>(pose: &Pose<Camera, Body>, camera: &MovingCamera<P>, o: &Observation) -> Vector2<f64> {
    let project = |c: Vector3<f64>| camera.lens.pixel_and_jacobian(Vector2::new(c.x / c.z, c.y / c.z)).0;
    let middle = pose.transform(&o.point).coords;
    let then = camera.twist.carried(middle, o.delay_s);
    if middle.z < 1e-6 || then.z < 1e-6 { o.pixel } else { o.pixel - (project(then) - project(middle)) }
}

/// Returns how much the pose changes with the motion assumed during readout: d[δt, δθ] / d twist at
/// the solution.
pub fn pose_by_twist<P: Projection>(resection: &Resection, camera: &MovingCamera<P>, observations: &[Observation]) -> Option<Matrix6<f64>> {
    let mut mixed = Matrix6::zeros();
    for o in observations {
        let Some((r, j)) = residual_and_jacobian(&resection.pose, camera, o) else { continue };
        let weight = tukey_weight((r.transpose() * o.information * r).x, resection.scale);
        // A later row sees the body moved by twist times delay: to first order the same derivative.
        mixed += j.transpose() * o.information * j * (weight * o.delay_s);
    }
    Some(-resection.normal.cholesky()?.solve(&mixed))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    struct Pinhole;
    impl Projection for Pinhole {
        fn pixel_and_jacobian(&self, n: Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
            // Mild distortion, to test the chain rule.
            let r2 = n.norm_squared();
            let bent = n * (1.0 - 0.1 * r2);
            let j = Matrix2::identity() * (1.0 - 0.1 * r2) - 0.2 * n * n.transpose();
            (bent * 900.0 + Vector2::new(640.0, 360.0), j * 900.0)
        }
    }

    fn truth() -> Pose<Camera, Body> {
        Pose::new(UnitQuaternion::from_euler_angles(2.8, 0.2, 0.1), Vector3::new(0.2, -0.1, 4.0))
    }

    fn scene(noise: f64, outliers: usize, seed: u64) -> Vec<Observation> {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        (0..200)
            .map(|k| {
                let point = Point3::new(rng.random_range(-2.0..2.0), rng.random_range(-1.5..1.5), if k % 3 == 0 { 0.5 } else { 0.0 });
                let c = truth().transform(&point);
                let (pixel, _) = Pinhole.pixel_and_jacobian(c.coords.xy() / c.z);
                let mut gauss = || (0..12).map(|_| rng.random_range(-0.5..0.5)).sum::<f64>();
                let mut pixel = pixel + Vector2::new(gauss(), gauss()) * noise;
                if k < outliers {
                    pixel += Vector2::new(50.0, 20.0);
                }
                let information = Matrix2::identity() / noise.max(0.1).powi(2);
                Observation { point, pixel, information, delay_s: 0.0, group: k as u32 }
            })
            .collect()
    }

    #[test]
    fn jacobian_agrees_with_differences() {
        let o = scene(0.3, 0, 1)[7];
        let (_, j) = residual_and_jacobian(&truth(), &MovingCamera::still(&Pinhole), &o).expect("in front");
        for k in 0..6 {
            let mut step = Vector6::zeros();
            step[k] = 1e-6;
            let (plus, _) = residual_and_jacobian(&perturbed(&truth(), &step), &MovingCamera::still(&Pinhole), &o).expect("in front");
            let (minus, _) = residual_and_jacobian(&perturbed(&truth(), &-step), &MovingCamera::still(&Pinhole), &o).expect("in front");
            let difference = (plus - minus) / 2e-6;
            assert!((difference - j.column(k)).norm() < 1e-4 * (1.0 + difference.norm()), "column {k}");
        }
    }

    #[test]
    fn a_known_motion_explains_a_rolling_shutter() {
        let twist = Twist(Vector6::new(0.3, -0.2, 0.1, 0.2, 0.5, -0.4));
        let observations = rolled(&twist);
        let moving = MovingCamera { lens: &Pinhole, twist };
        let found = resect(&truth(), &moving, &observations, 30).expect("regular");
        assert!(found.pose.angle_to(&truth()) < 1e-6, "{}", found.pose.angle_to(&truth()));
        let blind = resect(&truth(), &MovingCamera::still(&Pinhole), &observations, 30).expect("regular");
        assert!(blind.pose.angle_to(&truth()) > 1e-4);
        for o in &observations {
            let steady = Observation { pixel: rolling_shutter_corrected_px(&found.pose, &moving, o), delay_s: 0.0, ..*o };
            assert!(squared_residual(&truth(), &MovingCamera::still(&Pinhole), &steady).expect("in front") < 1e-3);
        }
    }

    #[test]
    fn an_ignored_motion_shifts_the_pose_as_predicted() {
        // Slow enough that no observation loses weight.
        let twist = Twist(Vector6::new(0.3, -0.2, 0.1, 0.2, 0.5, -0.4) * 0.02);
        let observations = rolled(&twist);
        let moving = MovingCamera { lens: &Pinhole, twist };
        let found = resect(&truth(), &moving, &observations, 30).expect("regular");
        let blind = resect(&truth(), &MovingCamera::still(&Pinhole), &observations, 30).expect("regular");
        let by_twist = pose_by_twist(&found, &moving, &observations).expect("regular");
        let expected = perturbed(&found.pose, &(by_twist * -twist.0));
        assert!(expected.angle_to(&blind.pose) < 0.1 * blind.pose.angle_to(&truth()));
        assert!((expected.translation - blind.pose.translation).norm() < 0.1 * (blind.pose.translation - truth().translation).norm());
    }

    /// Exact observations of the scene with 12 ms readout while the body moves by `twist`.
    fn rolled(twist: &Twist) -> Vec<Observation> {
        scene(0.0, 0, 3)
            .into_iter()
            .map(|o| {
                // Find the row at which the moving body crosses it.
                let mut delay_s = 0.0;
                let mut pixel = o.pixel;
                for _ in 0..20 {
                    let moved = perturbed(&truth(), &(twist.0 * delay_s)).transform(&o.point);
                    pixel = Pinhole.pixel_and_jacobian(moved.coords.xy() / moved.z).0;
                    delay_s = 0.012 * (pixel.y - 359.5) / 720.0;
                }
                Observation { pixel, delay_s, ..o }
            })
            .collect()
    }

    #[test]
    fn the_twist_between_two_poses_connects_them() {
        let after = perturbed(&truth(), &Vector6::new(0.02, 0.01, -0.03, 0.01, -0.02, 0.015));
        let twist = Twist::between(&truth(), &after, 0.02);
        let there = perturbed(&truth(), &(twist.0 * 0.02));
        assert!(there.angle_to(&after) < 1e-9 && (there.translation - after.translation).norm() < 1e-9);
    }

    #[test]
    fn exact_data_give_the_exact_pose_despite_outliers() {
        let start = perturbed(&truth(), &Vector6::new(0.1, -0.1, 0.2, 0.02, 0.03, -0.02));
        let found = resect(&start, &MovingCamera::still(&Pinhole), &scene(0.0, 40, 2), 50).expect("regular");
        assert!(found.pose.angle_to(&truth()) < 1e-8);
        assert!((found.pose.translation - truth().translation).norm() < 1e-7);
    }

    #[test]
    fn covariance_tells_the_scatter() {
        let mut nees = 0.0;
        let runs = 200;
        for seed in 0..runs {
            let observations = scene(0.5, 10, 100 + seed);
            let found = resect(&truth(), &MovingCamera::still(&Pinhole), &observations, 30).expect("regular");
            let covariance = sandwich_covariance(&found, &MovingCamera::still(&Pinhole), &observations).expect("full rank");
            let rotation = (found.pose.rotation.inverse() * truth().rotation).scaled_axis();
            let rotation = found.pose.rotation * rotation;
            let shift = truth().translation - UnitQuaternion::from_scaled_axis(rotation) * found.pose.translation;
            let e = Vector6::new(shift.x, shift.y, shift.z, rotation.x, rotation.y, rotation.z);
            nees += (e.transpose() * covariance.try_inverse().expect("positive") * e).x / 6.0 / runs as f64;
        }
        assert!((0.6..1.4).contains(&nees), "mean NEES/6 = {nees}");
    }
}
