//! Covariances of poses, propagated through inversion and composition.
//!
//! Everywhere except inside a solver, the covariance of a pose `T_a_b` = (R, p) is that of [δp, δθ]
//! with p_true = p + δp and R_true = Exp(δθ) R, both in the axes of `a`. Resection perturbs
//! `T_camera_body` from the left instead: T <- (Exp φ, τ) T.

use nalgebra::{Matrix3, Matrix6};

use super::{Body, Camera, Pose, Stage, skew};

/// Computes the covariance of the camera's pose in a body, [δp, δθ] of `T_body_camera`, from
/// resection's covariance, [τ, φ] of `T_camera_body`.
///
/// With T_body_camera = T⁻¹: R' = Rᵀ, p = -Rᵀ t. A left perturbation (φ, τ) of T gives R'_true = Rᵀ
/// Exp(-φ) = Exp(-Rᵀφ) R', and p_true = -Rᵀ Exp(-φ) (Exp(φ) t + τ) = p - Rᵀ τ to first order.
pub fn covariance_of_inverse(t_camera_body: &Pose<Camera, Body>, covariance: &Matrix6<f64>) -> Matrix6<f64> {
    let rt = t_camera_body.rotation_matrix().transpose();
    let mut g = Matrix6::zeros();
    g.fixed_view_mut::<3, 3>(0, 0).copy_from(&(-rt));
    g.fixed_view_mut::<3, 3>(3, 3).copy_from(&(-rt));
    symmetric(g * covariance * g.transpose())
}

/// Computes the covariance of an object's pose in the stage from the object's measurement and the
/// camera's, which are independent measurements from the same frame.
///
/// T_stage_object = T_stage_camera T_object_camera⁻¹, (R, p) = (R_c R_oᵀ, p_c - R p_o). The
/// camera's perturbation is (δp, δθ) in stage axes, that of `T_object_camera` is (δp_o, δθ_o) in
/// the object's. The rotation's perturbation is then δθ - R δθ_o, the position's δp + δθ x (p -
/// p_c) - R (δp_o - δθ_o x p_o).
pub fn covariance_of_object(
    t_stage_camera: &Pose<Stage, Camera>,
    camera_covariance: &Matrix6<f64>,
    t_object_camera: &Pose<Body, Camera>,
    object_covariance: &Matrix6<f64>,
) -> Matrix6<f64> {
    let r = (t_stage_camera.rotation * t_object_camera.rotation.inverse()).to_rotation_matrix().into_inner();
    let arm = -r * t_object_camera.translation;
    let mut by_camera = Matrix6::identity();
    by_camera.fixed_view_mut::<3, 3>(0, 3).copy_from(&(-skew(&arm)));
    let mut by_object: Matrix6<f64> = Matrix6::zeros();
    let rotation: Matrix3<f64> = -r * skew(&t_object_camera.translation);
    by_object.fixed_view_mut::<3, 3>(0, 0).copy_from(&(-r));
    by_object.fixed_view_mut::<3, 3>(0, 3).copy_from(&rotation);
    by_object.fixed_view_mut::<3, 3>(3, 3).copy_from(&(-r));
    symmetric(by_camera * camera_covariance * by_camera.transpose() + by_object * object_covariance * by_object.transpose())
}

/// Removes asymmetry due to rounding.
fn symmetric(m: Matrix6<f64>) -> Matrix6<f64> {
    (m + m.transpose()) * 0.5
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::resection::perturbed;
    use nalgebra::{UnitQuaternion, Vector3, Vector6};

    fn difference<A, B>(truth: &Pose<A, B>, estimate: &Pose<A, B>) -> Vector6<f64> {
        let p = truth.translation - estimate.translation;
        let r = (truth.rotation * estimate.rotation.inverse()).scaled_axis();
        Vector6::new(p.x, p.y, p.z, r.x, r.y, r.z)
    }

    fn moved<A, B>(pose: &Pose<A, B>, step: &Vector6<f64>) -> Pose<A, B> {
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(step[3], step[4], step[5]));
        Pose::new(rotation * pose.rotation, pose.translation + Vector3::new(step[0], step[1], step[2]))
    }

    fn poses() -> (Pose<Camera, Body>, Pose<Camera, Body>) {
        let stage = Pose::new(UnitQuaternion::from_euler_angles(1.8, 0.3, -0.2), Vector3::new(0.4, 0.2, 4.0));
        let object = Pose::new(UnitQuaternion::from_euler_angles(0.3, -0.9, 1.2), Vector3::new(-0.5, 0.3, 2.5));
        (stage, object)
    }

    /// Σ step stepᵀ over the six unit steps must equal the covariance propagated from the identity.
    #[test]
    fn covariance_of_an_inverse_agrees_with_differences() {
        let (t, _) = poses();
        let mut sum = Matrix6::zeros();
        for k in 0..6 {
            let mut step = Vector6::zeros();
            step[k] = 1e-6;
            let d = difference(&perturbed(&t, &step).inverse(), &t.inverse()) / 1e-6;
            sum += d * d.transpose();
        }
        let computed = covariance_of_inverse(&t, &Matrix6::identity());
        // The solver's step also rotates the translation, so its unit covariance is exactly that of
        // (τ, φ).
        assert!((computed - sum).norm() < 1e-4, "{computed} {sum}");
    }

    #[test]
    fn object_covariance_agrees_with_differences() {
        let (stage, object) = poses();
        let t_stage_camera: Pose<Stage, Camera> = stage.inverse().renamed();
        let (t_object_camera, t_stage_object) = (object.inverse(), t_stage_camera * object);
        let mut sum = Matrix6::zeros();
        for k in 0..6 {
            let mut step = Vector6::zeros();
            step[k] = 1e-6;
            let by_object = difference(&(t_stage_camera * moved(&t_object_camera, &step).inverse()), &t_stage_object) / 1e-6;
            let by_camera = difference(&(moved(&t_stage_camera, &step) * object), &t_stage_object) / 1e-6;
            sum += by_object * by_object.transpose() + by_camera * by_camera.transpose();
        }
        let computed = covariance_of_object(&t_stage_camera, &Matrix6::identity(), &t_object_camera, &Matrix6::identity());
        assert!((computed - sum).norm() < 1e-3, "{computed} {sum}");
    }
}
