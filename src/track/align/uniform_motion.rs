//! Cameras that rest or go evenly: a line through their last poses.
//!
//! The expectation of a motion allows for jerk, and is too wide to see a small start or stop: the pose is then taken for where the camera
//! was, though it is the mean of a path that bent while the frame was exposed. Where the last poses lie on a line, their
//! continuation is known nearly as well as a pose, and the first pose that leaves it shows by how much.

use nalgebra::{Matrix6, Vector6};

use super::motion::{Motion, MotionError, MotionEstimate, MotionMatrix, unseen};
use crate::geometry::{Body, Camera, Pose};

/// Poses that a line is fitted through at most. Raised, a velocity that changes slowly passes for a jump.
const MOST_POSES: f64 = 6.0;
/// Fewest that a line is believed from: through two there always is one. Lowered to 2, a shaken camera leaves it in every frame.
const LEAST_POSES: f64 = 3.0;
/// What a motion accelerates by that passes for even, one sigma, as a share of what may be expected unseen. With 0.1 it takes up what a jump
/// does, with 0.01 a pan that quickens passes for one.
const EVEN: f64 = 0.03;
/// A pose further from the line than this has left it (squared, in sigmas, six degrees of freedom: one in 2000 by chance).
const LEFT: f64 = 24.0;

/// A line through the last poses, by least squares with a memory that fades (an alpha-beta filter whose gains begin as those of the line
/// through all poses so far; Bar-Shalom, Li and Kirubarajan 2001, section 6.5).
#[derive(Debug, Clone, Copy)]
pub struct UniformMotion {
    /// At the last pose, with its velocity.
    motion: Motion,
    last: Pose<Body, Camera>,
    /// Poses that it was fitted through.
    poses: f64,
}

impl UniformMotion {
    /// One pose, of which no motion is known.
    pub fn new(pose: Pose<Body, Camera>) -> Self {
        Self { motion: Motion::still(pose), last: pose, poses: 1.0 }
    }

    /// Takes another pose, `dt_s` after the last; where it left the line, the motion that the line led to.
    pub fn add(&mut self, pose: &Pose<Body, Camera>, covariance: &Matrix6<f64>, dt_s: f64, distance_m: f64) -> Option<MotionEstimate> {
        let n = self.poses;
        let expected = self.motion.after(dt_s);
        let off = pose_error(&expected, pose);
        let [extrapolated, ..] = line_variances(n);
        let by_line = covariance * extrapolated;
        let has_left = n > 1.0 && (covariance + by_line).cholesky().is_none_or(|factor| off.dot(&factor.solve(&off)) > LEFT);
        if has_left || n < 2.0 {
            let velocity = pose_error(&Motion::still(self.last), pose) / dt_s;
            self.motion = corrected(&Motion::still(*pose), &Vector6::zeros(), &velocity);
            self.poses = 2.0;
        } else {
            let n = (n + 1.0).min(MOST_POSES);
            let (alpha, beta) = (2.0 * (2.0 * n - 1.0) / (n * (n + 1.0)), 6.0 / (n * (n + 1.0)));
            self.motion = corrected(&expected, &(off * alpha), &(off * (beta / dt_s)));
            self.poses = n;
        }
        self.last = *pose;
        (has_left && n >= LEAST_POSES)
            .then(|| MotionEstimate { motion: expected, covariance: line_covariance(n, covariance, dt_s, distance_m) })
    }
}

/// Covariance of the motion that a line through `n` poses leads to, which may accelerate a little.
fn line_covariance(n: f64, of_pose: &Matrix6<f64>, dt_s: f64, distance_m: f64) -> MotionMatrix {
    let [place, both, velocity] = line_variances(n);
    let mut covariance = MotionMatrix::zeros();
    for (row, column, share) in [(0, 0, place), (0, 6, both / dt_s), (6, 0, both / dt_s), (6, 6, velocity / (dt_s * dt_s))] {
        covariance.fixed_view_mut::<6, 6>(row, column).copy_from(&(of_pose * share));
    }
    let [_, _, shift, turn] = unseen(distance_m);
    for k in 0..3 {
        covariance[(12 + k, 12 + k)] = (EVEN * shift).powi(2);
        covariance[(15 + k, 15 + k)] = (EVEN * turn).powi(2);
    }
    covariance
}

/// Of a line through `n` poses, one step further, in the variance of a pose: the variance of its place, its covariance with the step, and
/// the variance of the step.
fn line_variances(n: f64) -> [f64; 3] {
    if n < 2.0 { [1.0; 3] } else { [2.0 * (2.0 * n + 1.0) / (n * (n - 1.0)), 6.0 / (n * (n - 1.0)), 12.0 / (n * (n * n - 1.0))] }
}

fn pose_error(from: &Motion, to: &Pose<Body, Camera>) -> Vector6<f64> {
    from.error_to(&Motion { pose: *to, ..*from }).fixed_rows::<6>(0).into_owned()
}

fn corrected(motion: &Motion, pose: &Vector6<f64>, velocity: &Vector6<f64>) -> Motion {
    let mut error = MotionError::zeros();
    error.fixed_rows_mut::<6>(0).copy_from(pose);
    error.fixed_rows_mut::<6>(6).copy_from(velocity);
    motion.corrected(&error)
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    const DT_S: f64 = 0.04;
    const SIGMA: f64 = 1e-4;

    /// Goes evenly.
    fn truth(frame: u32) -> Motion {
        let start = Motion::still(Pose::new(UnitQuaternion::from_euler_angles(0.1, 0.2, 0.3), Vector3::new(1.0, 2.0, 3.0)));
        corrected(&start, &Vector6::zeros(), &Vector6::new(0.3, -0.2, 0.1, 0.2, 0.1, -0.3)).after(f64::from(frame) * DT_S)
    }

    /// Is seen with noise.
    fn seen(frame: u32, random: &mut Pcg64Mcg) -> Pose<Body, Camera> {
        let noise = Vector6::from_fn(|_, _| SIGMA * ((0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0));
        truth(frame).with_pose_corrected(&noise)
    }

    /// The covariance of [`seen`], and a line through its first pose.
    fn begun(random: &mut Pcg64Mcg) -> (Matrix6<f64>, UniformMotion) {
        (Matrix6::identity() * SIGMA.powi(2), UniformMotion::new(seen(0, random)))
    }

    #[test]
    fn an_even_motion_stays_on_its_line_and_the_line_is_as_sure_as_it_says() {
        let mut random = Pcg64Mcg::seed_from_u64(1);
        for frames in [3, 4, 6, 12] {
            let (mut sum, mut left, runs) = (0.0, 0, 2000);
            for _ in 0..runs {
                let (covariance, mut line) = begun(&mut random);
                left += (1..frames).filter(|f| line.add(&seen(*f, &mut random), &covariance, DT_S, 4.0).is_some()).count();
                let expected = line.motion.after(DT_S);
                sum += pose_error(&expected, &truth(frames).pose).norm_squared() / 6.0 / SIGMA.powi(2) / line_variances(line.poses)[0];
            }
            let ratio = sum / f64::from(runs);
            // Gains that no longer fall remember more poses than they are named after.
            assert!((if frames > 6 { 0.6 } else { 0.9 }..1.1).contains(&ratio), "{frames}: {ratio}");
            assert!(left * 200 < runs as usize * frames as usize, "{frames}: {left}");
        }
    }

    #[test]
    fn a_stop_leaves_the_line_by_what_the_camera_did_not_go_on() {
        let mut random = Pcg64Mcg::seed_from_u64(2);
        let (covariance, mut line) = begun(&mut random);
        for frame in 1..8 {
            assert!(line.add(&seen(frame, &mut random), &covariance, DT_S, 4.0).is_none(), "{frame}");
        }
        let (rests, would_be) = (seen(7, &mut random), seen(8, &mut random));
        let left = line.add(&rests, &covariance, DT_S, 4.0).expect("12 mm are many sigmas");
        let (off, expected) = (pose_error(&left.motion, &rests), pose_error(&Motion::still(would_be), &rests));
        assert!((off - expected).norm() < 10.0 * SIGMA, "{off:?}");
        // The line through the moving and the resting pose is another; the next ones are at rest.
        line.add(&rests, &covariance, DT_S, 4.0);
        for frame in 0..4 {
            assert!(line.add(&rests, &covariance, DT_S, 4.0).is_none(), "{frame}");
        }
    }

    #[test]
    fn a_shaken_camera_is_on_no_line() {
        let mut random = Pcg64Mcg::seed_from_u64(3);
        let (covariance, mut line) = begun(&mut random);
        for frame in 1..50 {
            let shake = Vector6::from_fn(|_, _| random.random_range(-0.01..0.01));
            let pose = Motion::still(seen(frame, &mut random)).with_pose_corrected(&shake);
            assert!(line.add(&pose, &covariance, DT_S, 4.0).is_none(), "{frame}");
        }
    }
}
