//! A pose, its velocity and its acceleration as one state with 18 degrees of freedom: the basic
//! motion model.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3, Vector6};

use crate::geometry::{Body, Camera, Pose, skew};

/// Error of the state: [δp, δθ, δv, δω, δa, δα]. Position, velocity and acceleration in the body's
/// axes, metres and seconds; rotation R <- R Exp(δθ) and its rates in the camera's axes, radians.
pub type MotionError = SVector<f64, 18>;
/// Second moments of [`MotionError`].
pub type MotionMatrix = SMatrix<f64, 18, 18>;

/// A pose and its motion: of the camera in a body, unless stated otherwise.
#[derive(Debug, PartialEq)]
pub struct Motion<To = Body, From = Camera> {
    /// The pose at some instant: for alignment, at the frame's stamp.
    pub pose: Pose<To, From>,
    /// Velocity, m/s in the axes of `To`.
    pub velocity: Vector3<f64>,
    /// Angular velocity, rad/s in the axes of `From`.
    pub angular_velocity: Vector3<f64>,
    /// Acceleration, m/s² in the axes of `To`.
    pub acceleration: Vector3<f64>,
    /// Angular acceleration, rad/s² in the axes of `From`.
    pub angular_acceleration: Vector3<f64>,
}

impl<To, From> Clone for Motion<To, From> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<To, From> Copy for Motion<To, From> {}

impl<To, From> Motion<To, From> {
    /// Creates a motion at rest.
    pub fn still(pose: Pose<To, From>) -> Self {
        let zero = Vector3::zeros();
        Self { pose, velocity: zero, angular_velocity: zero, acceleration: zero, angular_acceleration: zero }
    }

    /// Creates the uniform motion from one pose to another within `dt_s`, at the latter.
    pub fn between(before: &Pose<To, From>, pose: &Pose<To, From>, dt_s: f64) -> Self {
        let [way, rotation] = before.step_to(pose);
        Self { velocity: way / dt_s, angular_velocity: rotation / dt_s, ..Self::still(*pose) }
    }

    /// Returns the same pose with reversed motion.
    pub fn reversed(&self) -> Self {
        Self { velocity: -self.velocity, angular_velocity: -self.angular_velocity, ..*self }
    }

    /// Returns the same motion without acceleration.
    pub fn even(&self) -> Self {
        let zero = Vector3::zeros();
        Self { acceleration: zero, angular_acceleration: zero, ..*self }
    }

    /// Returns [v, ω]: velocity and angular velocity.
    pub fn twist(&self) -> Vector6<f64> {
        let (v, w) = (self.velocity, self.angular_velocity);
        Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z)
    }

    /// Returns the same motion with this velocity and angular velocity.
    pub fn with_twist(&self, twist: &Vector6<f64>) -> Self {
        Self { velocity: twist.fixed_rows::<3>(0).into_owned(), angular_velocity: twist.fixed_rows::<3>(3).into_owned(), ..*self }
    }

    /// Returns the state after correcting an error.
    pub fn corrected(&self, error: &MotionError) -> Self {
        let part = |k: usize| Vector3::new(error[k], error[k + 1], error[k + 2]);
        Self {
            pose: self.pose.moved(&part(0), &part(3)),
            velocity: self.velocity + part(6),
            angular_velocity: self.angular_velocity + part(9),
            acceleration: self.acceleration + part(12),
            angular_acceleration: self.angular_acceleration + part(15),
        }
    }

    /// Returns the pose after correcting its error, [δp, δθ].
    pub fn with_pose_corrected(&self, error: &Vector6<f64>) -> Pose<To, From> {
        self.pose.moved(&error.fixed_rows::<3>(0).into_owned(), &error.fixed_rows::<3>(3).into_owned())
    }

    /// Returns the error with which [`corrected`](Self::corrected) leads from here to `other`.
    pub fn error_to(&self, other: &Self) -> MotionError {
        let [shift, rotation] = self.pose.step_to(&other.pose);
        let (velocity, angular_velocity) = (other.velocity - self.velocity, other.angular_velocity - self.angular_velocity);
        let acceleration = other.acceleration - self.acceleration;
        let angular_acceleration = other.angular_acceleration - self.angular_acceleration;
        let parts = [shift, rotation, velocity, angular_velocity, acceleration, angular_acceleration];
        MotionError::from_fn(|row, _| parts[row / 3][row % 3])
    }

    /// Returns the pose part of [`error_to`](Self::error_to).
    pub fn pose_error_to(&self, other: &Self) -> Vector6<f64> {
        self.error_to(other).fixed_rows::<6>(0).into_owned()
    }

    /// Returns the state `dt_s` later, at constant acceleration.
    pub fn after(&self, dt_s: f64) -> Self {
        let half = 0.5 * dt_s * dt_s;
        let rotation = self.angular_velocity * dt_s + self.angular_acceleration * half;
        Self {
            pose: self.pose.moved(&(self.velocity * dt_s + self.acceleration * half), &rotation),
            velocity: self.velocity + self.acceleration * dt_s,
            angular_velocity: self.angular_velocity + self.angular_acceleration * dt_s,
            ..*self
        }
    }

    /// Returns the rotation matrix `tau` seconds from the stamp as a polynomial: R0 + tau R1 + tau²
    /// R2, exact to second order.
    pub fn rotation_polynomial(&self) -> [Matrix3<f64>; 3] {
        let r = self.pose.rotation_matrix();
        let w = skew(&self.angular_velocity);
        [r, r * w, r * (skew(&self.angular_acceleration) + w * w) * 0.5]
    }

    /// Returns the camera centre `tau` seconds from the stamp as a polynomial: p0 + tau p1 + tau²
    /// p2.
    pub fn centre_polynomial(&self) -> [Vector3<f64>; 3] {
        [self.pose.translation, self.velocity, self.acceleration * 0.5]
    }

    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        let parts = [&self.velocity, &self.angular_velocity, &self.acceleration, &self.angular_acceleration];
        self.pose.is_finite() && parts.iter().all(|v| v.iter().all(|x| x.is_finite()))
    }
}

#[cfg(test)]
pub(super) mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;

    pub fn moving() -> Motion {
        Motion {
            pose: Pose::new(UnitQuaternion::from_euler_angles(1.2, 0.3, -0.4), Vector3::new(0.3, -4.0, 0.5)),
            velocity: Vector3::new(0.4, -0.2, 0.1),
            angular_velocity: Vector3::new(0.5, -0.8, 0.3),
            acceleration: Vector3::new(1.0, 2.0, -0.5),
            angular_acceleration: Vector3::new(3.0, -5.0, 2.0),
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
    fn corrections_round_trip_as_errors() {
        let error = MotionError::from_fn(|k, _| 0.01 * (k as f64 - 7.5));
        let back = moving().error_to(&moving().corrected(&error));
        assert!((back - error).norm() < 1e-9);
    }
}
