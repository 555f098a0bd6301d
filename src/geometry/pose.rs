//! Rigid transforms SE(3) whose type names the frames they map between.

use std::marker::PhantomData;
use std::ops::Mul;

use nalgebra::{Matrix3, Matrix4, Point3, Rotation3, UnitQuaternion, Vector3};

/// The stage frame: right-handed, metres, x right as seen from the house, y upstage, z up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {}
/// The optical camera frame: x right, y down, z forward, origin at the projection centre.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Camera {}
/// The optical frame of the camera on air, mounted beside the tracking one; axes as [`Camera`]'s.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FilmingCamera {}
/// The frame of a rigid body made of surfaces; the stage's own body frame is the stage frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Body {}
/// The frame of a flat surface: x right and y up in its picture, z out of its face, origin at its
/// centre.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SurfaceFrame {}
/// The frame of the camera that "took" the reference picture (C3 `essential`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ReferenceCamera {}

/// The rigid transform `T_to_from`: `x_to = R x_from + t`, metres.
///
/// The translation is the origin of `From` in `To`; for `Pose<Stage, Camera>` it is the camera
/// centre in the stage.
#[derive(Debug)]
pub struct Pose<To, From> {
    /// Rotation part R.
    pub rotation: UnitQuaternion<f64>,
    /// Translation part t in metres, in the axes of `To`.
    pub translation: Vector3<f64>,
    frames: PhantomData<fn() -> (To, From)>,
}

impl<To, From> Clone for Pose<To, From> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<To, From> Copy for Pose<To, From> {}
impl<To, From> PartialEq for Pose<To, From> {
    fn eq(&self, other: &Self) -> bool {
        self.rotation == other.rotation && self.translation == other.translation
    }
}

impl<To, From> Pose<To, From> {
    /// Creates the transform with rotation R and translation t (metres, in `To`).
    pub fn new(rotation: UnitQuaternion<f64>, translation: Vector3<f64>) -> Self {
        Self { rotation, translation, frames: PhantomData }
    }

    /// Creates a pose from a rotation matrix that is orthonormal up to rounding.
    pub fn from_matrix(rotation: &Matrix3<f64>, translation: Vector3<f64>) -> Self {
        Self::new(quaternion(rotation), translation)
    }

    /// Returns the identity: no rotation, no translation.
    pub fn identity() -> Self {
        Self::new(UnitQuaternion::identity(), Vector3::zeros())
    }

    /// Returns `T_from_to`.
    pub fn inverse(&self) -> Pose<From, To> {
        let rotation = self.rotation.inverse();
        Pose::new(rotation, -(rotation * self.translation))
    }

    /// Maps a point from `From` to `To`.
    pub fn transform(&self, point: &Point3<f64>) -> Point3<f64> {
        self.rotation * point + self.translation
    }

    /// Returns R as a matrix.
    pub fn rotation_matrix(&self) -> Matrix3<f64> {
        self.rotation.to_rotation_matrix().into_inner()
    }

    /// Returns the homogeneous 4x4 matrix.
    pub fn matrix(&self) -> Matrix4<f64> {
        self.rotation.to_homogeneous().append_translation(&self.translation)
    }

    /// Returns the same transform under other frame names. Say at the call why the frames coincide.
    pub fn renamed<To2, From2>(&self) -> Pose<To2, From2> {
        Pose::new(self.rotation, self.translation)
    }

    /// Returns the quaternion x, y, z, w with w >= 0, as written in the pose record.
    pub fn orientation_xyzw(&self) -> [f64; 4] {
        let q = self.rotation.quaternion();
        let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
        // `+ 0.0` turns -0 into 0, so that a record never prints "-0.0".
        [q.i, q.j, q.k, q.w].map(|v| sign * v + 0.0)
    }

    /// Returns the pose with its origin shifted by `shift` (metres, axes of `To`) and rotated by
    /// `rotation` (radians, axes of `From`).
    pub fn moved(&self, shift: &Vector3<f64>, rotation: &Vector3<f64>) -> Self {
        Self::new(self.rotation * UnitQuaternion::from_scaled_axis(*rotation), self.translation + shift)
    }

    /// Returns the shift and rotation with which [`moved`](Self::moved) leads to another pose.
    pub fn step_to(&self, other: &Self) -> [Vector3<f64>; 2] {
        [other.translation - self.translation, (self.rotation.inverse() * other.rotation).scaled_axis()]
    }

    /// Returns the rotation angle between two poses, radians.
    pub fn angle_to(&self, other: &Self) -> f64 {
        self.rotation.angle_to(&other.rotation)
    }

    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        self.translation.iter().chain(self.rotation.coords.iter()).all(|v| v.is_finite())
    }
}

impl<A, B, C> Mul<Pose<B, C>> for Pose<A, B> {
    type Output = Pose<A, C>;
    fn mul(self, right: Pose<B, C>) -> Pose<A, C> {
        Pose::new(self.rotation * right.rotation, self.rotation * right.translation + self.translation)
    }
}

/// Converts a rotation matrix that is orthonormal up to rounding to a unit quaternion, in closed
/// form (iterative methods stall at half turns).
pub fn quaternion(rotation: &Matrix3<f64>) -> UnitQuaternion<f64> {
    let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*rotation));
    UnitQuaternion::new_normalize(q.into_inner())
}

/// Returns the cross-product matrix: `skew(a) b = a x b`.
pub fn skew(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn golden_pose_looks_upstage() {
        // DESIGN section 2: 4 m in front of the origin, level, looking upstage.
        let s = std::f64::consts::FRAC_1_SQRT_2;
        let q = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(s, -s, 0.0, 0.0));
        let pose = Pose::<Stage, Camera>::new(q, Vector3::new(0.0, -4.0, 0.0));
        let ahead = pose.transform(&Point3::new(0.0, 0.0, 4.0));
        assert!((ahead - Point3::origin()).norm() < 1e-12);
        let below = pose.transform(&Point3::new(0.0, 1.0, 4.0));
        assert!((below - Point3::new(0.0, 0.0, -1.0)).norm() < 1e-12);
    }

    #[test]
    fn inverse_and_product_agree_with_matrices() {
        let a = Pose::<Stage, Camera>::new(UnitQuaternion::from_euler_angles(0.1, -0.4, 2.0), Vector3::new(1.0, 2.0, -3.0));
        let b = Pose::<Camera, Body>::new(UnitQuaternion::from_euler_angles(-1.1, 0.3, 0.2), Vector3::new(0.1, 0.0, 5.0));
        assert!(((a * b).matrix() - a.matrix() * b.matrix()).norm() < 1e-12);
        assert!(((a * a.inverse()).matrix() - Matrix4::identity()).norm() < 1e-12);
    }

    #[test]
    fn half_turn_matrices_round_trip() {
        for axis in [Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis(), nalgebra::Unit::new_normalize(Vector3::new(1.0, -2.0, 0.5))] {
            for angle in [0.0, 1e-9, 1.0, std::f64::consts::PI - 1e-9, std::f64::consts::PI] {
                let m = UnitQuaternion::from_axis_angle(&axis, angle).to_rotation_matrix().into_inner();
                let back = Pose::<Stage, Camera>::from_matrix(&m, Vector3::zeros()).rotation_matrix();
                assert!((back - m).norm() < 1e-12, "{axis:?} {angle}: {}", (back - m).norm());
            }
        }
    }

    #[test]
    fn written_quaternion_has_positive_w() {
        let q = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(-0.5, 0.5, 0.5, 0.5));
        assert_eq!(Pose::<Stage, Camera>::new(q, Vector3::zeros()).orientation_xyzw(), [-0.5, -0.5, -0.5, 0.5]);
    }
}
