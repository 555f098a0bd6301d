//! Describes a tracked frame by two-view geometry, for the record (contract C3): the homography
//! from the reference picture, the motion from the reference camera, and which of the two models
//! explains the frame better. It uses the anchors that fitted the verified pose; nothing here
//! influences tracking.

use super::tuning::frame_order::TUNING;
use nalgebra::{Matrix3, Point3, Vector3};

use super::patches::fitted_anchor::FittedAnchor;
use super::scene::reference::PreparedBody;
use super::scene::surface::ReferenceKind;
use crate::camera::{CameraModel, Normalized, Pixel};
use crate::geometry::distances::squared_sampson;
use crate::geometry::essential::essential_candidates;
use crate::geometry::essential_decomposition::motion_by_cheirality;
use crate::geometry::motion_refinement::refine_motion;
use crate::geometry::relative_pose::{RayPair, TwoViewMotion};
use crate::geometry::triangulation::depths;
use crate::geometry::{Body, Camera, Homography, PointPair, Pose, ReferenceCamera, SurfaceFrame};

/// The two-view description of a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TwoView {
    /// Reference pixels of the first surface to undistorted frame pixels, h33 = 1; present from
    /// twelve correspondences on.
    pub homography: Option<Matrix3<f64>>,
    /// Motion from the reference camera, and the number of correspondences that agree with it.
    pub essential: Option<(TwoViewMotion, usize)>,
    /// Whether a scene with depth explains the correspondences better than one plane.
    pub has_depth: bool,
}

/// Returns `T_body_reference`, the pose of the reference camera (C3, C13): with a map, the walk's
/// first keyframe; else the photograph's own camera, or a virtual pinhole on the first surface's
/// axis, as far in front of its centre as the surface is wide.
fn reference_camera(body: &PreparedBody) -> Pose<Body, ReferenceCamera> {
    let of_map = body.surfaces.iter().find(|surface| surface.spec.is_facet());
    let spec = &of_map.unwrap_or(&body.surfaces[0]).spec;
    match &spec.kind {
        ReferenceKind::Photograph { pose, .. } | ReferenceKind::Facet { pose } => spec.pose * pose.inverse(),
        ReferenceKind::Artwork => {
            // It looks against the surface's normal: x stays, y and z flip.
            let turn = nalgebra::UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
            spec.pose * Pose::<SurfaceFrame, ReferenceCamera>::new(turn, Vector3::new(0.0, 0.0, spec.size_m[0]))
        }
    }
}

/// Buffers of [`two_view`].
#[derive(Debug, Default)]
pub struct TwoViewBuffers {
    rays: Vec<Option<Normalized>>,
    pairs: Vec<RayPair>,
    points: Vec<PointPair>,
}

/// Describes a verified frame by the anchors that fit. `t_camera_body`: its pose; `rms_px`:
/// root mean square of its anchors' displacements, pixels; `camera`: the frame's; `seed`: of the
/// five-point samples.
pub fn two_view(
    body: &PreparedBody,
    t_camera_body: &Pose<Camera, Body>,
    rms_px: f64,
    anchors: &[FittedAnchor],
    camera: &CameraModel,
    seed: u64,
    buffers: &mut TwoViewBuffers,
) -> TwoView {
    let TwoViewBuffers { rays, pairs, points } = buffers;
    let t_body_reference = reference_camera(body);
    rays.clear();
    rays.extend(anchors.iter().map(|a| camera.unproject(Pixel(a.corrected_px))));
    pair_rays(body, anchors, rays, &t_body_reference, pairs);
    let t_frame_reference = *t_camera_body * t_body_reference;
    let distance = (*t_camera_body * body.surfaces[0].spec.pose).translation.norm();
    let focal = 0.5 * (camera.intrinsics().fx + camera.intrinsics().fy);
    let sigma = rms_px.max(0.05) / focal;
    let has_baseline = t_frame_reference.translation.norm() >= TUNING.min_baseline * distance;
    let essential = has_baseline.then(|| estimate_motion(pairs, &t_frame_reference, sigma, seed)).flatten();
    TwoView {
        homography: first_surface_homography(body, anchors, rays, camera, points),
        has_depth: essential.as_ref().is_some_and(|(motion, _)| depth_explains_better(pairs, motion, sigma, points)),
        essential,
    }
}

fn pair_rays(
    body: &PreparedBody,
    anchors: &[FittedAnchor],
    rays: &[Option<Normalized>],
    t_body_reference: &Pose<Body, ReferenceCamera>,
    pairs: &mut Vec<RayPair>,
) {
    let to_reference = t_body_reference.inverse();
    let pair = |(a, ray): (&FittedAnchor, &Option<Normalized>)| {
        let point: Point3<f64> = body.surfaces[a.surface as usize].spec.body_point(a.artwork);
        let seen = to_reference.transform(&point);
        let second = ray.as_ref()?.0;
        (seen.z > 1e-3 * to_reference.translation.norm()).then(|| RayPair { first: seen.coords.xy() / seen.z, second })
    };
    pairs.clear();
    pairs.extend(anchors.iter().zip(rays).filter_map(pair));
}

/// Returns the unconstrained 8-parameter fit to the first surface's correspondences; `None` for a
/// facet, which has no picture of its own (C13).
fn first_surface_homography(
    body: &PreparedBody,
    anchors: &[FittedAnchor],
    rays: &[Option<Normalized>],
    camera: &CameraModel,
    pairs: &mut Vec<PointPair>,
) -> Option<Matrix3<f64>> {
    let h_photo_artwork = match &body.surfaces[0].spec.kind {
        ReferenceKind::Facet { .. } => return None,
        ReferenceKind::Artwork => None,
        ReferenceKind::Photograph { h_photo_artwork, .. } => Some(h_photo_artwork),
    };
    let of_first = anchors.iter().zip(rays).filter(|(a, _)| a.surface == 0);
    pairs.clear();
    pairs.extend(of_first.filter_map(|(a, ray)| Some(PointPair { from: a.artwork, to: camera.undistorted_pixel((*ray)?) })));
    if pairs.len() < TUNING.min_homography_matches {
        return None;
    }
    let fit = Homography::from_pairs(pairs, None)?.refined(pairs, 0.2, 15)?;
    match h_photo_artwork {
        Some(h_photo_artwork) => Homography(fit.0 * h_photo_artwork.try_inverse()?).with_unit_h33(),
        None => fit.with_unit_h33(),
    }
}

/// Estimates the motion from the correspondences. First refines the metric pose; if that does not
/// explain most of them, also refines five-point samples. A flat scene allows two motions; if both
/// explain the pairs equally well, the one nearer to the metric pose, whose plane is known, is the
/// true one.
fn estimate_motion(pairs: &[RayPair], metric: &Pose<Camera, ReferenceCamera>, sigma: f64, seed: u64) -> Option<(TwoViewMotion, usize)> {
    if pairs.len() < 8 {
        return None;
    }
    let threshold = 4.0 * sigma;
    let known = TwoViewMotion { rotation: metric.rotation, direction: metric.translation.normalize() };
    let agreeing = |m: &TwoViewMotion| {
        let e = m.essential();
        let agrees = |p: &&RayPair| squared_sampson(&e, p) < threshold * threshold && depths(m, p).is_none_or(|(a, b)| a > 0.0 && b > 0.0);
        pairs.iter().filter(agrees).count()
    };
    let near = refine_motion(&known, pairs, sigma, 12);
    let agreeing_near = agreeing(&near);
    if agreeing_near as f64 >= TUNING.min_refined_inlier_ratio * pairs.len() as f64 {
        return Some((near, agreeing_near));
    }
    let mut starts: Vec<TwoViewMotion> = essential_candidates(pairs, threshold, TUNING.five_point_samples, TUNING.kept_models, seed)
        .iter()
        .filter_map(|e| motion_by_cheirality(e, pairs))
        .filter(|(_, in_front)| 2 * in_front > pairs.len())
        .map(|(motion, _)| motion)
        .collect();
    starts.push(known);
    let cost = |m: &TwoViewMotion| {
        let e = m.essential();
        pairs.iter().map(|p| (squared_sampson(&e, p) / (sigma * sigma)).min(16.0)).sum::<f64>()
    };
    let refined: Vec<(f64, TwoViewMotion)> = starts.iter().map(|s| refine_motion(s, pairs, sigma, 12)).map(|m| (cost(&m), m)).collect();
    let least = refined.iter().map(|(c, _)| *c).fold(f64::INFINITY, f64::min);
    // Costs within the scatter of a chi-squared with this many pairs are equal.
    let alike = least + 3.0 * (2.0 * pairs.len() as f64).sqrt();
    let (_, best) = refined
        .into_iter()
        .filter(|(c, _)| *c <= alike)
        .min_by(|(_, a), (_, b)| a.rotation.angle_to(&known.rotation).total_cmp(&b.rotation.angle_to(&known.rotation)))?;
    Some((best, agreeing(&best)))
}

/// Compares Torr's GRIC ("Geometric robust information criterion", 1998) of both models over all
/// pairs; true if the essential matrix has the lower one.
fn depth_explains_better(pairs: &[RayPair], motion: &TwoViewMotion, sigma: f64, points: &mut Vec<PointPair>) -> bool {
    points.clear();
    points.extend(pairs.iter().map(|p| PointPair { from: p.first, to: p.second }));
    let Some(plane) = Homography::from_pairs(points, None).and_then(|h| h.refined(points, sigma, 10)) else {
        return true;
    };
    let e = motion.essential();
    let plane_errors = points.iter().map(|p| plane.squared_error(p));
    let depth_errors = pairs.iter().map(|p| squared_sampson(&e, p));
    gric(depth_errors, sigma, 3.0, 5.0) < gric(plane_errors, sigma, 2.0, 8.0)
}

/// Returns GRIC for data of dimension 4. `d`: dimension of the model's manifold; `k`: its number of
/// parameters.
fn gric(squared_errors: impl Iterator<Item = f64>, sigma: f64, d: f64, k: f64) -> f64 {
    let mut n = 0.0;
    let mut sum = 0.0;
    for e2 in squared_errors {
        n += 1.0;
        sum += (e2 / (sigma * sigma)).min(2.0 * (4.0 - d));
    }
    sum + 4.0_f64.ln() * d * n + (4.0_f64 * n).ln() * k
}

#[cfg(test)]
#[path = "two_view_tests.rs"]
mod tests;
