//! The tilted twin: from afar or through a long lens, a flat surface looks almost the same when it
//! is tilted the other way about the line of sight. Only the likelihood of the observations can
//! tell which of the two poses is right.
//!
//! This is checked for every pose that features found before it is reported, and from time to time
//! for a tracked pose: a track that passes through the head-on view, where both poses coincide, may
//! leave it on the wrong branch.

use crate::track::patches::tuning::TUNING;
use nalgebra::UnitQuaternion;

use super::fitted_anchor::FittedAnchor;
use crate::camera::CameraModel;
use crate::geometry::resection::{MovingCamera, Observation, SquaredResiduals, resect_within, residual_scale, squared_residual};
use crate::geometry::{Body, Camera, Pose, SurfaceFrame};
use crate::track::scene::reference::PreparedBody;

/// Returns the excess robust chi-squared of the best pose near the tilted twin over that of `pose`
/// (`T_camera_body`); infinite if there is no such pose. `surface`: index of the surface that is
/// tilted; `squared`: a buffer.
pub fn ambiguity_margin(
    body: &PreparedBody,
    surface: u32,
    pose: &Pose<Camera, Body>,
    camera: &MovingCamera<CameraModel>,
    observations: &[Observation],
    squared: &mut SquaredResiduals,
) -> f64 {
    let twin = flipped(pose, body, surface);
    let Some(other) = resect_within(&twin, camera, observations, TUNING.max_twin_iterations, squared) else { return f64::INFINITY };
    if other.pose.angle_to(pose) < TUNING.same_pose_angle {
        // It converged to the same minimum.
        return f64::INFINITY;
    }
    let Some(scale) = residual_scale(pose, camera, observations, squared) else { return f64::INFINITY };
    let cost = |pose: &Pose<Camera, Body>| -> f64 {
        let sigmas = |o: &Observation| squared_residual(pose, camera, o).unwrap_or(f64::INFINITY) / scale.powi(2);
        observations.iter().map(|o| sigmas(o).min(TUNING.max_squared_observation_residual)).sum()
    };
    cost(&other.pose) - cost(pose)
}

/// Returns the pose with the surface tilted the other way about the line of sight, where a wrong
/// twin would lie.
fn flipped(pose: &Pose<Camera, Body>, body: &PreparedBody, surface: u32) -> Pose<Camera, Body> {
    let spec = &body.surfaces[surface as usize].spec;
    let t_camera_surface = *pose * spec.pose;
    let sight = t_camera_surface.translation.normalize();
    let r = t_camera_surface.rotation_matrix();
    let normal = r.column(2).into_owned();
    // Mirror the normal at the line of sight, and rotate the surface there by the shortest
    // rotation.
    let mirrored = 2.0 * sight.dot(&normal) * sight - normal;
    let rotation = UnitQuaternion::rotation_between(&normal, &mirrored).unwrap_or_else(UnitQuaternion::identity);
    let flipped = Pose::<Camera, SurfaceFrame>::new(rotation * t_camera_surface.rotation, t_camera_surface.translation);
    flipped * spec.pose.inverse()
}

/// Returns the index of the surface with the most anchors.
pub fn most_frequent_surface(anchors: &[FittedAnchor], surfaces: usize) -> u32 {
    let count = |s: usize| anchors.iter().filter(|a| a.surface as usize == s).count();
    (0..surfaces).max_by_key(|&s| count(s)).unwrap_or(0) as u32
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix2, Vector2, Vector3};

    use super::*;
    use crate::camera::Normalized;
    use crate::geometry::resection::resect;
    use crate::track::synthetic::{cloth, facing, lens, prepared};

    /// Observations of a cloth on a grid, each known to a twentieth of a pixel.
    fn seen(body: &PreparedBody, pose: &Pose<Camera, Body>, camera: &CameraModel) -> Vec<Observation> {
        let information = Matrix2::identity() * 400.0;
        let observation = |k: u32| {
            let artwork = Vector2::new(f64::from(k % 12) + 0.5, f64::from(k / 12) + 0.5).component_mul(&Vector2::new(640.0, 480.0)) / 12.0;
            let point = body.surfaces[0].spec.body_point(artwork);
            let c = pose.transform(&point);
            let pixel = camera.project(Normalized(Vector2::new(c.x / c.z, c.y / c.z))).0;
            Observation { point, pixel, information, delay_s: 0.0, group: 0 }
        };
        (0..144).map(observation).collect()
    }

    #[test]
    fn the_wrong_planar_twin_is_recognised() {
        let (body, camera) = (prepared(vec![cloth(1)]), lens(640, 480));
        let still = MovingCamera::still(&camera);
        let mut found = 0;
        for (distance, tilt) in [(8.0, 0.15), (15.0, 0.2), (30.0, 0.3), (60.0, 0.4)] {
            let truth = facing(tilt, 0.1, Vector3::new(0.0, 0.0, distance));
            let observations = seen(&body, &truth, &camera);
            let Some(wrong) = resect(&flipped(&truth, &body, 0), &still, &observations, 15).map(|r| r.pose) else { continue };
            if wrong.angle_to(&truth) < TUNING.same_pose_angle {
                continue;
            }
            found += 1;
            let mut squared = SquaredResiduals::default();
            let right = ambiguity_margin(&body, 0, &truth, &still, &observations, &mut squared);
            let other = ambiguity_margin(&body, 0, &wrong, &still, &observations, &mut squared);
            println!("{distance} m: {:.1} degrees apart, margins {right:.1} and {other:.1}", wrong.angle_to(&truth).to_degrees());
            assert!(right > 0.0 && other < 0.0, "{distance} m: {right} {other}");
        }
        assert!(found >= 2, "too few of the views have a twin");
    }

    #[test]
    fn the_planar_twin_keeps_position_and_mirrors_the_normal() {
        let body = prepared(vec![cloth(1)]);
        let truth = facing(0.4, -0.2, Vector3::new(0.3, 0.1, 6.0));
        let twin = flipped(&truth, &body, 0);
        assert_eq!(twin.translation, truth.translation);
        let sight = truth.translation.normalize();
        let normal = |p: &Pose<Camera, Body>| p.rotation * Vector3::z();
        let across = |n: Vector3<f64>| n - sight * n.dot(&sight);
        assert!((normal(&twin).dot(&sight) - normal(&truth).dot(&sight)).abs() < 1e-12);
        assert!((across(normal(&twin)) + across(normal(&truth))).norm() < 1e-12);
        assert!(flipped(&twin, &body, 0).angle_to(&truth) < 1e-9);
    }
}
