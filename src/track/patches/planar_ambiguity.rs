//! The tilted twin: seen from afar or through a long lens, a flat surface looks nearly the same when it is tilted the other
//! way about the line of sight. Which of the two a pose is, only the likelihood of what was seen can tell.
//!
//! Asked of every pose that features found before it is given, and of a followed one from time to time: a track that came through
//! the view from straight ahead, where both are one, may leave it on the wrong branch.

use nalgebra::UnitQuaternion;

use super::fitted_anchor::FittedAnchor;
use crate::camera::CameraModel;
use crate::geometry::resection::{MovingCamera, Observation, SquaredResiduals, resect_within, residual_scale, squared_residual};
use crate::geometry::{Body, Camera, Pose, SurfaceFrame};
use crate::track::scene::reference::PreparedBody;

/// By how much (chi-squared) the twin of a pose that is given must be worse: five sigmas. A followed pose is given up only where the twin
/// is better by as much. Raised, pictures seen small or from straight ahead are refused more often; lowered, wrong twins pass.
pub const MIN_MARGIN: f64 = 25.0;
/// Poses nearer to each other are one, radians: half a degree. Chosen: as far as a pose that is given may be uncertain (`MAX_TURN` in
/// `verify`). Raised, twins of a nearly frontal view are not told apart; lowered, the same minimum counts as a rival.
const SAME_TURN: f64 = 0.0087;
/// Largest squared residual that counts, squared scales: the square of Tukey's limit, 4.7. Raised, what is no part of the surface decides.
const MAX_SQUARED: f64 = 22.0;
/// Steps of the twin's refinement at most. As many as other poses get; they stop earlier where they converge. Lowered, a twin that is not
/// at its minimum looks worse than it is.
const ITERATIONS: usize = 15;

/// How much worse (in robust chi-squared) the best pose near the tilted twin explains what was seen; infinite where there is none.
/// `surface`: the one that is tilted; `squared`: a buffer.
pub fn ambiguity_margin(
    body: &PreparedBody,
    surface: u32,
    pose: &Pose<Camera, Body>,
    camera: &MovingCamera<CameraModel>,
    observations: &[Observation],
    squared: &mut SquaredResiduals,
) -> f64 {
    let twin = flipped(pose, body, surface);
    let Some(other) = resect_within(&twin, camera, observations, ITERATIONS, squared) else { return f64::INFINITY };
    if other.pose.angle_to(pose) < SAME_TURN {
        // It fell back into the same minimum.
        return f64::INFINITY;
    }
    let Some(scale) = residual_scale(pose, camera, observations, squared) else { return f64::INFINITY };
    let cost = |pose: &Pose<Camera, Body>| -> f64 {
        let sigmas = |o: &Observation| squared_residual(pose, camera, o).unwrap_or(f64::INFINITY) / scale.powi(2);
        observations.iter().map(|o| sigmas(o).min(MAX_SQUARED)).sum()
    };
    cost(&other.pose) - cost(pose)
}

/// The pose of the same surface tilted the other way about the line of sight: where a wrong twin would lie.
fn flipped(pose: &Pose<Camera, Body>, body: &PreparedBody, surface: u32) -> Pose<Camera, Body> {
    let spec = &body.surfaces[surface as usize].spec;
    let t_camera_surface = *pose * spec.pose;
    let sight = t_camera_surface.translation.normalize();
    let r = t_camera_surface.rotation_matrix();
    let normal = r.column(2).into_owned();
    // Mirror the normal across the line of sight, and turn the surface there by the shortest way.
    let mirrored = 2.0 * sight.dot(&normal) * sight - normal;
    let turn = UnitQuaternion::rotation_between(&normal, &mirrored).unwrap_or_else(UnitQuaternion::identity);
    let flipped = Pose::<Camera, SurfaceFrame>::new(turn * t_camera_surface.rotation, t_camera_surface.translation);
    flipped * spec.pose.inverse()
}

/// The surface that most anchors lie on.
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

    /// What a pose shows of a cloth on a grid, each place known to a twentieth of a pixel.
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
    fn the_wrong_twin_is_told_from_the_right_one() {
        let (body, camera) = (prepared(vec![cloth(1)]), lens(640, 480));
        let still = MovingCamera::still(&camera);
        let mut found = 0;
        for (distance, tilt) in [(8.0, 0.15), (15.0, 0.2), (30.0, 0.3), (60.0, 0.4)] {
            let truth = facing(tilt, 0.1, Vector3::new(0.0, 0.0, distance));
            let observations = seen(&body, &truth, &camera);
            let Some(wrong) = resect(&flipped(&truth, &body, 0), &still, &observations, 15).map(|r| r.pose) else { continue };
            if wrong.angle_to(&truth) < SAME_TURN {
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
    fn the_twin_keeps_the_place_and_mirrors_the_normal() {
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
