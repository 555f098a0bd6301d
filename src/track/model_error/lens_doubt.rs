//! Pose covariance from the stated uncertainty of the lens.
//!
//! The pose is where its pixels are explained best by the configured lens. Had the lens been
//! configured one sigma differently, the same pixels would have led to another pose: to first
//! order, the least-squares answer to the pixels' shifts. Each way in which the lens may be off
//! yields one such shift of the pose, and their outer products add up to the covariance.

use nalgebra::{Matrix6, SMatrix, Vector2};

use crate::camera::{CameraModel, LENS_WAYS, Normalized};
use crate::geometry::covariance::covariance_of_inverse;
use crate::geometry::resection::{MovingCamera, Observation, residual_and_jacobian};
use crate::geometry::{Body, Camera, Pose};

/// Returns the covariance of [δp, δθ] of `T_body_camera`, body axes, from the lens alone; `None` if
/// the lens has no stated uncertainty.
pub fn covariance_by_lens<'a>(
    t_body_camera: &Pose<Body, Camera>,
    camera: &CameraModel,
    observations: impl Iterator<Item = &'a Observation>,
) -> Option<Matrix6<f64>> {
    camera.doubt()?;
    let pose = t_body_camera.inverse();
    let still = MovingCamera::still(camera);
    let mut normal = Matrix6::zeros();
    let mut right = SMatrix::<f64, 6, LENS_WAYS>::zeros();
    for o in observations {
        let seen = pose.transform(&o.point).coords;
        let normalized = Normalized(Vector2::new(seen.x / seen.z, seen.y / seen.z));
        let (Some((_, j)), Some(shifts)) = (residual_and_jacobian(&pose, &still, o), camera.pixel_doubt(normalized)) else { continue };
        let weighted = j.transpose() * o.information;
        normal += weighted * j;
        right += weighted * shifts;
    }
    let by_way = normal.cholesky()?.solve(&right);
    let covariance = covariance_of_inverse(&pose, &(by_way * by_way.transpose()));
    covariance.iter().all(|v| v.is_finite()).then_some(covariance)
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix2, Point3, Vector3};

    use super::*;
    use crate::camera::{Intrinsics, LensGuess};
    use crate::geometry::resection::resect;

    /// Points of a backdrop of 4 x 3 m with a flat half a metre in front of it, 4 m away.
    fn seen_by(camera: &CameraModel, pose: &Pose<Camera, Body>) -> Vec<Observation> {
        let points = (0..9).flat_map(|i| (0..7).map(move |k| (i, k)));
        let observation = |(i, k): (i32, i32)| {
            let (x, y) = (f64::from(i - 4) * 0.35, f64::from(k - 3) * 0.3);
            let point = Point3::new(x, y, if i > 5 { -0.5 } else { 0.0 });
            let c = pose.transform(&point).coords;
            let pixel = camera.project(Normalized(Vector2::new(c.x / c.z, c.y / c.z))).0;
            Observation { point, pixel, information: Matrix2::identity() * 100.0, delay_s: 0.0, group: 0 }
        };
        points.map(observation).collect()
    }

    #[test]
    fn lens_covariance_equals_the_pose_error_of_a_wrong_lens() {
        let configured = LensGuess::FieldOfView(60.0).camera(1280, 720).unwrap();
        let rotation = nalgebra::UnitQuaternion::from_euler_angles(0.1, -0.25, 0.05);
        let pose = Pose::new(rotation, Vector3::new(0.2, -0.1, 4.0));
        let observations = seen_by(&configured, &pose);
        let covariance = covariance_by_lens(&pose.inverse(), &configured, observations.iter()).unwrap();
        // A wrong focal length changes the scale: 3 % of 4 m.
        assert!((0.09..=0.2).contains(&covariance[(2, 2)].sqrt()), "{}", covariance[(2, 2)].sqrt());
        let u = configured.doubt().unwrap().uncertainty;
        let i = *configured.intrinsics();
        let bent = |which: usize| {
            let mut distortion = [0.0; 5];
            distortion[which] = u.distortion[which] / 3000.0;
            Intrinsics { distortion, ..i }
        };
        let others: [Intrinsics; 7] = [
            Intrinsics { fx: i.fx + u.focal_px[0] / 3000.0, fy: i.fy + u.focal_px[1] / 3000.0, ..i },
            Intrinsics { cx: i.cx + u.centre_px[0] / 3000.0, ..i },
            Intrinsics { cy: i.cy + u.centre_px[1] / 3000.0, ..i },
            bent(0),
            bent(1),
            bent(2),
            bent(3),
        ];
        // The poses that the configured lens finds in pictures taken with each of the other lenses.
        // The errors are so small that the robust weights stay 1.
        let mut scatter = Matrix6::zeros();
        for real in others {
            let found =
                resect(&pose, &MovingCamera::still(&configured), &seen_by(&CameraModel::new(real).unwrap(), &pose), 20).unwrap().pose;
            let (found, pose) = (found.inverse(), pose.inverse());
            let (rotated, moved) = ((found.rotation * pose.rotation.inverse()).scaled_axis(), found.translation - pose.translation);
            let step = nalgebra::Vector6::new(moved.x, moved.y, moved.z, rotated.x, rotated.y, rotated.z) * 1000.0;
            scatter += step * step.transpose();
        }
        assert!((scatter - covariance).norm() < 0.05 * covariance.norm(), "{scatter}\n{covariance}");
    }

    #[test]
    fn an_exact_lens_adds_no_covariance() {
        let camera = CameraModel::pinhole(1280, 720, 1000.0, 1000.0, 639.5, 359.5).unwrap();
        let pose = Pose::new(nalgebra::UnitQuaternion::identity(), Vector3::new(0.0, 0.0, 4.0));
        assert_eq!(covariance_by_lens(&pose.inverse(), &camera, seen_by(&camera, &pose).iter()), None);
    }
}
