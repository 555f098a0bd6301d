//! Cameras at rest or in uniform motion: a line through their last poses.
//!
//! A motion prediction that allows for jerk is too wide to detect a small start or stop. The pose
//! is then taken for the camera's position, although it is the mean of a path that bent during the
//! exposure. If the last poses lie on a line, its continuation is known nearly as well as a pose,
//! and the first pose that leaves it shows by how much.

use nalgebra::{Matrix2, Matrix3, Matrix6, Vector6};

use super::estimate::{MotionEstimate, unseen};
use super::state::{Motion, MotionError, MotionMatrix};
use crate::geometry::{Body, Camera, Pose};

/// Maximum number of poses in the fit. Raised, a slowly changing velocity counts as a jump.
const MAX_POSES: f64 = 6.0;
/// Minimum number of poses for a reliable line: two always define one. Lowered to 2, a shaken
/// camera leaves it in every frame.
const MIN_POSES: f64 = 3.0;
/// Acceleration that still counts as uniform motion, one sigma, as a fraction of the prior of an
/// unobserved motion. At 0.1 it absorbs jumps; at 0.01 a quickening pan counts as a jump.
const EVEN: f64 = 0.03;
/// Squared distance in sigmas (six degrees of freedom) from which a pose has left the line: one in
/// 2000 by chance. Raised, small starts are missed; lowered, poses of a resting camera leave it by
/// chance, with a wider covariance.
const LEFT: f64 = 24.0;

/// A least-squares line through the last poses with fading memory (an alpha-beta filter, for the
/// rotation alpha-beta-gamma, whose gains start as those of the fit through all poses so far;
/// Bar-Shalom, Li and Kirubarajan 2001, section 6.5).
///
/// The position follows a straight line, the rotation a parabola: a camera passing what it looks at
/// rotates ever faster, then slower.
#[derive(Debug, Clone, Copy)]
pub struct UniformMotion {
    /// At the last pose, with its velocity.
    motion: Motion,
    last: Pose<Body, Camera>,
    /// Number of poses in the fit.
    poses: f64,
}

/// Prediction of a reliable line for a new pose.
#[derive(Debug, Clone, Copy)]
pub struct Continuation {
    /// The predicted motion.
    pub expected: MotionEstimate,
    /// Whether the pose is farther from it than chance explains.
    pub has_left: bool,
}

impl UniformMotion {
    /// Starts with one pose and no known motion.
    pub fn new(pose: Pose<Body, Camera>) -> Self {
        Self { motion: Motion::still(pose), last: pose, poses: 1.0 }
    }

    /// Adds a pose `dt_s` after the last and returns the line's prediction for it; `None` if the
    /// line had too few poses to be reliable.
    pub fn add(&mut self, pose: &Pose<Body, Camera>, covariance: &Matrix6<f64>, dt_s: f64, distance_m: f64) -> Option<Continuation> {
        let n = self.poses;
        let expected = self.motion.after(dt_s);
        let off = pose_error(&expected, pose);
        let has_left = n > 1.0 && is_far(&off, &(covariance + place_covariance(n, covariance)), n);
        if has_left || n < 2.0 {
            self.motion = Motion::between(&self.last, pose, dt_s);
            self.poses = 2.0;
        } else {
            self.poses = (n + 1.0).min(MAX_POSES);
            self.motion = expected.corrected(&correction(self.poses, &off, dt_s));
        }
        self.last = *pose;
        let covariance = line_covariance(n, covariance, dt_s, distance_m);
        (n >= MIN_POSES).then_some(Continuation { expected: MotionEstimate { motion: expected, covariance }, has_left })
    }
}

/// Whether a pose is farther from the line through `n` poses than chance explains. Two poses do not
/// determine the rotation's curvature.
fn is_far(off: &Vector6<f64>, covariance: &Matrix6<f64>, n: f64) -> bool {
    if n < 3.0 {
        let shift = off.fixed_rows::<3>(0);
        let factor = covariance.fixed_view::<3, 3>(0, 0).into_owned().cholesky();
        factor.is_none_or(|factor| shift.dot(&factor.solve(&shift)) > LEFT)
    } else {
        covariance.cholesky().is_none_or(|factor| off.dot(&factor.solve(off)) > LEFT)
    }
}

/// Returns the correction of the motion at the last of `n` poses, given its deviation.
fn correction(n: f64, off: &Vector6<f64>, dt_s: f64) -> MotionError {
    let (shift, rotation) = (line_moments(n, 0.0), parabola_moments(n, 0.0));
    MotionError::from_fn(|row, _| {
        let (power, k) = (row / 6, row % 6);
        let gain = if k < 3 { shift[(power, 0)] } else { rotation[(power, 0)] };
        gain * off[k] / dt_s.powi(power as i32)
    })
}

/// Returns the uncertainty of a straight line through `n` poses, `ahead` steps after the last:
/// second moments of position, step and curvature, in units of a pose's variance.
fn line_moments(n: f64, ahead: f64) -> Matrix3<f64> {
    let [s0, s1, s2, ..] = sums_of_powers(n, ahead);
    let mut moments = Matrix3::zeros();
    moments.fixed_view_mut::<2, 2>(0, 0).copy_from(&Matrix2::new(s0, s1, s1, s2).try_inverse().unwrap_or_else(Matrix2::identity));
    moments
}

/// The same for a parabola; for a line if there are too few poses.
fn parabola_moments(n: f64, ahead: f64) -> Matrix3<f64> {
    let [s0, s1, s2, s3, s4] = sums_of_powers(n, ahead);
    let information = Matrix3::new(s0, s1, 0.5 * s2, s1, s2, 0.5 * s3, 0.5 * s2, 0.5 * s3, 0.25 * s4);
    let inverse = if n < 3.0 { None } else { information.try_inverse() };
    inverse.unwrap_or_else(|| line_moments(n, ahead))
}

/// Sums of powers of the `n` poses' times, in steps, relative to `ahead` steps after the last.
fn sums_of_powers(n: f64, ahead: f64) -> [f64; 5] {
    std::array::from_fn(|power| (0..n as usize).map(|pose| (-(pose as f64) - ahead).powi(power as i32)).sum())
}

/// Covariance of the pose predicted by a line through `n` poses.
fn place_covariance(n: f64, of_pose: &Matrix6<f64>) -> Matrix6<f64> {
    shared_out(of_pose, line_moments(n, 1.0)[(0, 0)], parabola_moments(n, 1.0)[(0, 0)])
}

/// Scales a covariance by one factor for the shift and another for the rotation. The cross terms
/// get the factor of the straight line, which both fits contain.
fn shared_out(of_pose: &Matrix6<f64>, of_shift: f64, of_rotation: f64) -> Matrix6<f64> {
    let mut covariance = of_pose * of_shift;
    covariance.fixed_view_mut::<3, 3>(3, 3).copy_from(&(of_pose.fixed_view::<3, 3>(3, 3) * of_rotation));
    covariance
}

/// Covariance of the motion predicted by a line through `n` poses, allowing a little acceleration.
fn line_covariance(n: f64, of_pose: &Matrix6<f64>, dt_s: f64, distance_m: f64) -> MotionMatrix {
    let (shift, rotation) = (line_moments(n, 1.0), parabola_moments(n, 1.0));
    let mut covariance = MotionMatrix::zeros();
    for (a, b) in (0..3).flat_map(|a| (0..3).map(move |b| (a, b))) {
        let per_s = dt_s.powi(-((a + b) as i32));
        let block = shared_out(of_pose, shift[(a, b)] * per_s, rotation[(a, b)] * per_s);
        covariance.fixed_view_mut::<6, 6>(6 * a, 6 * b).copy_from(&block);
    }
    let [_, _, of_shift, of_rotation] = unseen(distance_m);
    for k in 0..3 {
        covariance[(12 + k, 12 + k)] += (EVEN * of_shift).powi(2);
        covariance[(15 + k, 15 + k)] += (EVEN * of_rotation).powi(2);
    }
    covariance
}

fn pose_error(from: &Motion, to: &Pose<Body, Camera>) -> Vector6<f64> {
    from.pose_error_to(&Motion { pose: *to, ..*from })
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    const DT_S: f64 = 0.04;
    const SIGMA: f64 = 1e-4;

    fn with_velocity(motion: &Motion, velocity: &Vector6<f64>) -> Motion {
        let mut error = MotionError::zeros();
        error.fixed_rows_mut::<6>(6).copy_from(velocity);
        motion.corrected(&error)
    }

    /// Uniform motion.
    fn truth(frame: u32) -> Motion {
        let start = Motion::still(Pose::new(UnitQuaternion::from_euler_angles(0.1, 0.2, 0.3), Vector3::new(1.0, 2.0, 3.0)));
        with_velocity(&start, &Vector6::new(0.3, -0.2, 0.1, 0.2, 0.1, -0.3)).after(f64::from(frame) * DT_S)
    }

    /// A noisy pose of it.
    fn seen(frame: u32, random: &mut Pcg64Mcg) -> Pose<Body, Camera> {
        let noise = Vector6::from_fn(|_, _| SIGMA * ((0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0));
        truth(frame).with_pose_corrected(&noise)
    }

    /// The covariance of [`seen`], and a line through its first pose.
    fn begun(random: &mut Pcg64Mcg) -> (Matrix6<f64>, UniformMotion) {
        (Matrix6::identity() * SIGMA.powi(2), UniformMotion::new(seen(0, random)))
    }

    fn departs(line: &mut UniformMotion, pose: &Pose<Body, Camera>, covariance: &Matrix6<f64>) -> bool {
        line.add(pose, covariance, DT_S, 4.0).is_some_and(|c| c.has_left)
    }

    #[test]
    fn a_uniform_motion_stays_on_its_line_within_its_covariance() {
        let mut random = Pcg64Mcg::seed_from_u64(1);
        for frames in [3, 4, 6, 12] {
            let (mut sum, mut left, runs) = (0.0, 0, 2000);
            for _ in 0..runs {
                let (covariance, mut line) = begun(&mut random);
                left += (1..frames).filter(|f| departs(&mut line, &seen(*f, &mut random), &covariance)).count();
                let expected = line.motion.after(DT_S);
                let off = pose_error(&expected, &truth(frames).pose);
                let factor = place_covariance(line.poses, &covariance).cholesky().expect("positive definite");
                sum += off.dot(&factor.solve(&off)) / 6.0;
            }
            let ratio = sum / f64::from(runs);
            // Gains that no longer fall remember more poses than their nominal number.
            assert!((if frames > 6 { 0.6 } else { 0.9 }..1.1).contains(&ratio), "{frames}: {ratio}");
            assert!(left * 200 < runs as usize * frames as usize, "{frames}: {left}");
        }
    }

    #[test]
    fn a_stop_is_detected_as_a_deviation_from_the_line() {
        let mut random = Pcg64Mcg::seed_from_u64(2);
        let (covariance, mut line) = begun(&mut random);
        for frame in 1..8 {
            assert!(!departs(&mut line, &seen(frame, &mut random), &covariance), "{frame}");
        }
        let (rests, would_be) = (seen(7, &mut random), seen(8, &mut random));
        let left = line.add(&rests, &covariance, DT_S, 4.0).expect("seven poses lie on it");
        assert!(left.has_left, "12 mm are many sigmas");
        let (off, expected) = (pose_error(&left.expected.motion, &rests), pose_error(&Motion::still(would_be), &rests));
        assert!((off - expected).norm() < 10.0 * SIGMA, "{off:?}");
        // The line through the moving and the resting pose differs; the next poses are at rest.
        line.add(&rests, &covariance, DT_S, 4.0);
        for frame in 0..4 {
            assert!(!departs(&mut line, &rests, &covariance), "{frame}");
        }
    }

    #[test]
    fn an_accelerating_rotation_stays_on_its_line() {
        let mut random = Pcg64Mcg::seed_from_u64(4);
        let mut on_line = 0;
        for _ in 0..200 {
            let (covariance, mut line) = begun(&mut random);
            on_line += (1..8)
                .filter(|frame| {
                    let t = f64::from(*frame) * DT_S;
                    // Its curvature from frame to frame is 16 sigmas.
                    let bend = Vector6::new(0.0, 0.0, 0.0, 1.0, 0.0, 0.0) * (0.5 * t * t);
                    let pose = Motion::still(seen(*frame, &mut random)).with_pose_corrected(&bend);
                    !departs(&mut line, &pose, &covariance) && line.poses > 2.0
                })
                .count();
        }
        assert!(on_line > 1180, "{on_line} of 1200");
    }

    #[test]
    fn a_shaken_camera_never_forms_a_line() {
        let mut random = Pcg64Mcg::seed_from_u64(3);
        let (covariance, mut line) = begun(&mut random);
        for frame in 1..50 {
            let shake = Vector6::from_fn(|_, _| random.random_range(-0.01..0.01));
            let pose = Motion::still(seen(frame, &mut random)).with_pose_corrected(&shake);
            assert!(!departs(&mut line, &pose, &covariance), "{frame}");
        }
    }
}
