//! The motion of a body: pose, velocity and acceleration as one state with 18 degrees of freedom, carried from
//! frame to frame by white jerk.
//!
//! It gives alignment its start, tells how the camera moved while the rows of a frame were read and while its
//! shutter was open, and is solved jointly with the picture: velocity and acceleration are what the filter says,
//! corrected by what the rows show.

use nalgebra::{Matrix3, SMatrix, SVector, UnitQuaternion, Vector3, Vector6};

use super::process_noise::ProcessNoise;
use crate::geometry::{Body, Camera, Pose, skew};

/// Error of the state: [δp, δθ, δv, δω, δa, δα]; position, velocity and acceleration in the body's axes, metres and
/// seconds; rotation R <- R Exp(δθ) and its rates in the camera's axes, radians.
pub type MotionError = SVector<f64, 18>;
/// Second moments of [`MotionError`].
pub type MotionMatrix = SMatrix<f64, 18, 18>;

/// What may be expected of a motion not seen yet, one sigma: m/s at 4 m, rad/s, m/s² at 4 m, rad/s². A hand that shakes a camera does as
/// much; less would pass for knowledge of what a single frame with a rolling shutter leaves open.
const UNSEEN: [f64; 4] = [0.8, 1.0, 10.0, 30.0];
const UNSEEN_DISTANCE_M: f64 = 4.0;
/// Tilt that a stretched picture is taken for, by the angle of the stretch over the frame.
const STRETCH_TO_TILT: f64 = 1.5;
/// A velocity is remembered for so long, seconds; beyond that it fades into what may be expected unseen, as a hand's does.
const REMEMBERED_S: f64 = 0.05;
const FADES_IN_S: f64 = 0.1;

/// Where the camera is as seen from the body, and how it moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// `T_body_camera` at the stamp of the frame.
    pub pose: Pose<Body, Camera>,
    /// m/s in the body's axes.
    pub velocity: Vector3<f64>,
    /// rad/s in the camera's axes.
    pub turn_rate: Vector3<f64>,
    /// m/s² in the body's axes.
    pub acceleration: Vector3<f64>,
    /// rad/s² in the camera's axes.
    pub turn_acceleration: Vector3<f64>,
}

impl Motion {
    /// At rest.
    pub fn still(pose: Pose<Body, Camera>) -> Self {
        let zero = Vector3::zeros();
        Self { pose, velocity: zero, turn_rate: zero, acceleration: zero, turn_acceleration: zero }
    }

    /// The state after an error is corrected.
    pub fn corrected(&self, error: &MotionError) -> Self {
        let part = |k: usize| Vector3::new(error[k], error[k + 1], error[k + 2]);
        let turn = UnitQuaternion::from_scaled_axis(part(3));
        Self {
            pose: Pose::new(self.pose.rotation * turn, self.pose.translation + part(0)),
            velocity: self.velocity + part(6),
            turn_rate: self.turn_rate + part(9),
            acceleration: self.acceleration + part(12),
            turn_acceleration: self.turn_acceleration + part(15),
        }
    }

    /// The pose alone after its error, [δp, δθ], is corrected.
    pub fn with_pose_corrected(&self, error: &Vector6<f64>) -> Pose<Body, Camera> {
        let mut of_motion = MotionError::zeros();
        of_motion.fixed_rows_mut::<6>(0).copy_from(error);
        self.corrected(&of_motion).pose
    }

    /// The error that [`corrected`](Self::corrected) would need to lead from here to `other`.
    pub fn error_to(&self, other: &Self) -> MotionError {
        let turn = (self.pose.rotation.inverse() * other.pose.rotation).scaled_axis();
        let mut error = MotionError::zeros();
        error.fixed_rows_mut::<3>(0).copy_from(&(other.pose.translation - self.pose.translation));
        error.fixed_rows_mut::<3>(3).copy_from(&turn);
        error.fixed_rows_mut::<3>(6).copy_from(&(other.velocity - self.velocity));
        error.fixed_rows_mut::<3>(9).copy_from(&(other.turn_rate - self.turn_rate));
        error.fixed_rows_mut::<3>(12).copy_from(&(other.acceleration - self.acceleration));
        error.fixed_rows_mut::<3>(15).copy_from(&(other.turn_acceleration - self.turn_acceleration));
        error
    }

    /// The part of [`error_to`](Self::error_to) that is the pose's.
    pub fn pose_error_to(&self, other: &Self) -> Vector6<f64> {
        self.error_to(other).fixed_rows::<6>(0).into_owned()
    }

    /// The state `dt_s` later, at constant acceleration.
    pub fn after(&self, dt_s: f64) -> Self {
        let half = 0.5 * dt_s * dt_s;
        let turn = UnitQuaternion::from_scaled_axis(self.turn_rate * dt_s + self.turn_acceleration * half);
        Self {
            pose: Pose::new(self.pose.rotation * turn, self.pose.translation + self.velocity * dt_s + self.acceleration * half),
            velocity: self.velocity + self.acceleration * dt_s,
            turn_rate: self.turn_rate + self.turn_acceleration * dt_s,
            ..*self
        }
    }

    /// The rotation matrix `tau` seconds from the stamp as a polynomial: R0 + tau R1 + tau² R2, exact to second order.
    pub fn rotation_polynomial(&self) -> [Matrix3<f64>; 3] {
        let r = self.pose.rotation_matrix();
        let w = skew(&self.turn_rate);
        [r, r * w, r * (skew(&self.turn_acceleration) + w * w) * 0.5]
    }

    /// The camera centre `tau` seconds from the stamp: p0 + tau p1 + tau² p2.
    pub fn centre_polynomial(&self) -> [Vector3<f64>; 3] {
        [self.pose.translation, self.velocity, self.acceleration * 0.5]
    }

    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        let parts = [&self.velocity, &self.turn_rate, &self.acceleration, &self.turn_acceleration];
        self.pose.is_finite() && parts.iter().all(|v| v.iter().all(|x| x.is_finite()))
    }
}

/// A motion and how sure it is.
#[derive(Debug, Clone, Copy)]
pub struct MotionEstimate {
    /// Best estimate.
    pub motion: Motion,
    /// Covariance of its error.
    pub covariance: MotionMatrix,
}

impl MotionEstimate {
    /// How far off a pose that features found may be, one sigma, m at a distance and rad: features know nothing of the shutter, and
    /// what moved meanwhile stretches their picture, which looks like a tilt.
    pub fn off_by_readout(readout_s: f64, distance_m: f64) -> [f64; 2] {
        let turn = STRETCH_TO_TILT * UNSEEN[1] * readout_s;
        [turn * distance_m, turn]
    }

    /// A pose whose motion nobody saw yet. `shift` and `turn`: one sigma of the pose, metres and radians.
    pub fn unseen(pose: Pose<Body, Camera>, distance_m: f64, shift: f64, turn: f64) -> Self {
        let mut covariance = MotionMatrix::zeros();
        for (block, sigma) in [shift, turn].into_iter().enumerate() {
            for k in 0..3 {
                covariance[(3 * block + k, 3 * block + k)] = sigma * sigma;
            }
        }
        add_unseen(&mut covariance, distance_m, 1.0);
        Self { motion: Motion::still(pose), covariance }
    }

    /// Squared innovations of shift and turn, where a pose was found: in sigmas of what was expected, a degree of freedom. `None` where
    /// the covariance is singular.
    pub fn squared_innovations(&self, found: &Motion) -> [Option<f64>; 2] {
        let error = self.motion.error_to(found);
        [0, 3].map(|first| {
            let part = error.fixed_rows::<3>(first).into_owned();
            let covariance = self.covariance.fixed_view::<3, 3>(first, first).into_owned();
            Some(part.dot(&covariance.cholesky()?.solve(&part)) / 3.0)
        })
    }

    /// What is expected `dt_s` later, at a distance from the stage.
    pub fn after(&self, dt_s: f64, distance_m: f64, process_noise: &ProcessNoise) -> Self {
        let motion = self.motion.after(dt_s);
        // The rotation error is told in the camera's axes, which turned meanwhile.
        let turned = (motion.pose.rotation.inverse() * self.motion.pose.rotation).to_rotation_matrix().into_inner();
        let mut step = MotionMatrix::identity();
        let i = Matrix3::identity();
        let blocks = [(0, 6, dt_s), (6, 12, dt_s), (3, 9, dt_s), (9, 15, dt_s), (0, 12, 0.5 * dt_s * dt_s), (3, 15, 0.5 * dt_s * dt_s)];
        for (row, column, factor) in blocks {
            step.fixed_view_mut::<3, 3>(row, column).copy_from(&(i * factor));
        }
        step.fixed_view_mut::<3, 3>(3, 3).copy_from(&turned);
        let mut covariance = step * self.covariance * step.transpose();
        add_jerk(&mut covariance, 0, process_noise.of_shift(distance_m), dt_s);
        add_jerk(&mut covariance, 3, process_noise.of_turn(), dt_s);
        // Between the frames of a slow camera jerk is no random walk any more: the motion is as good as new.
        let faded = ((dt_s - REMEMBERED_S).max(0.0) / FADES_IN_S).powi(2);
        add_unseen(&mut covariance, distance_m, 1.0 - (-faded).exp());
        Self { motion, covariance: (covariance + covariance.transpose()) * 0.5 }
    }
}

/// What may be expected of a motion not seen yet at a distance from the stage, one sigma: m/s, rad/s, m/s², rad/s².
pub fn unseen(distance_m: f64) -> [f64; 4] {
    let d = distance_m / UNSEEN_DISTANCE_M;
    [UNSEEN[0] * d, UNSEEN[1], UNSEEN[2] * d, UNSEEN[3]]
}

/// Adds a share of what may be expected of velocities and accelerations that nobody saw.
fn add_unseen(covariance: &mut MotionMatrix, distance_m: f64, share: f64) {
    for (block, sigma) in unseen(distance_m).into_iter().enumerate() {
        for k in 6 + 3 * block..9 + 3 * block {
            covariance[(k, k)] += share * sigma * sigma;
        }
    }
}

/// Adds the second moments of white jerk of density `q` over `dt` to one half (shift at 0, turn at 3) of the state.
fn add_jerk(covariance: &mut MotionMatrix, first: usize, q: f64, dt: f64) {
    let moments = [
        [dt.powi(5) / 20.0, dt.powi(4) / 8.0, dt.powi(3) / 6.0],
        [dt.powi(4) / 8.0, dt.powi(3) / 3.0, dt.powi(2) / 2.0],
        [dt.powi(3) / 6.0, dt.powi(2) / 2.0, dt],
    ];
    for (i, row) in moments.iter().enumerate() {
        for (j, moment) in row.iter().enumerate() {
            for k in 0..3 {
                covariance[(first + 6 * i + k, first + 6 * j + k)] += q * moment;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn moving() -> Motion {
        Motion {
            pose: Pose::new(UnitQuaternion::from_euler_angles(1.2, 0.3, -0.4), Vector3::new(0.3, -4.0, 0.5)),
            velocity: Vector3::new(0.4, -0.2, 0.1),
            turn_rate: Vector3::new(0.5, -0.8, 0.3),
            acceleration: Vector3::new(1.0, 2.0, -0.5),
            turn_acceleration: Vector3::new(3.0, -5.0, 2.0),
        }
    }

    #[test]
    fn polynomials_follow_the_motion() {
        let m = moving();
        for tau in [-0.008, 0.003, 0.01] {
            let after = m.after(tau);
            let [r0, r1, r2] = m.rotation_polynomial();
            let [p0, p1, p2] = m.centre_polynomial();
            assert!((r0 + r1 * tau + r2 * (tau * tau) - after.pose.rotation_matrix()).norm() < 1e-5);
            assert!((p0 + p1 * tau + p2 * (tau * tau) - after.pose.translation).norm() < 1e-12);
        }
    }

    #[test]
    fn corrections_come_back_as_errors() {
        let error = MotionError::from_fn(|k, _| 0.01 * (k as f64 - 7.5));
        let back = moving().error_to(&moving().corrected(&error));
        assert!((back - error).norm() < 1e-9);
    }

    #[test]
    fn the_covariance_follows_small_errors() {
        let dt = 0.02;
        let estimate = MotionEstimate::unseen(moving().pose, 4.0, 0.01, 0.01);
        let estimate = MotionEstimate { motion: moving(), ..estimate };
        for k in 0..18 {
            let mut error = MotionError::zeros();
            error[k] = 1e-5;
            let alone = MotionEstimate { covariance: error * error.transpose(), ..estimate };
            let carried = estimate.motion.after(dt).error_to(&estimate.motion.corrected(&error).after(dt));
            let grown = alone.after(dt, 0.0, &ProcessNoise::default());
            let mut jerk = MotionMatrix::zeros();
            add_jerk(&mut jerk, 3, ProcessNoise::default().of_turn(), dt);
            let expected = carried * carried.transpose();
            assert!((grown.covariance - jerk - expected).norm() < 0.02 * expected.norm(), "{k}");
        }
    }
}
