//! Turns descriptor matches of one frame into candidate poses of a body, without prior knowledge.
//!
//! For each surface, its matches vote for a homography; each homography allows two planar poses;
//! each of these is refined over the matches of all surfaces of the body, with lens distortion.
//! Both planar poses stay candidates until alignment with the picture decides. If few matches
//! agree, affine maps replace homographies.

use crate::track::acquire::tuning::TUNING;
use nalgebra::{Matrix2, Vector2};

use crate::camera::{CameraModel, Pixel};
use crate::features::Feature;
use crate::geometry::covariance::covariance_of_inverse;
use crate::geometry::local_affinities::{LocalAffinity, most_agreeing, robust_affine};
use crate::geometry::planar_pose::planar_poses;
use crate::geometry::ransac::Order;
use crate::geometry::resection::{MovingCamera, Observation, Resection, resect, squared_residual};
use crate::geometry::robust::RobustOptions;
use crate::geometry::robust_homography::robust_homography;
use crate::geometry::{Body, Camera, Homography, PointPair, Pose};
use crate::matching::{Match, ReferenceFeature};
use crate::track::scene::reference::PreparedBody;

/// A feature of the frame, matched with a place on a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceMatch {
    /// Surface index in its body.
    pub surface: u32,
    /// Place on the artwork, pixels.
    pub artwork: Vector2<f64>,
    /// Place in the frame, raw pixels.
    pub pixel: Vector2<f64>,
    /// Place in the frame, undistorted pixels of the same K.
    pub undistorted: Vector2<f64>,
    /// Frame pixels per pixel of the level on which it was found.
    pub scale: f64,
    /// Local appearance of the surface: derivative of the frame's pixels by the artwork's.
    pub derivative: Matrix2<f64>,
}

/// A pose that matches support.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// `T_camera_body`.
    pub pose: Pose<Camera, Body>,
    /// Matches within reach of the pose.
    pub inliers: usize,
    /// Robust cost over all matches; lower is better.
    pub cost: f64,
    /// Uncertainty of `T_body_camera` due to the matches' noise, one sigma over all axes: metres
    /// and radians.
    pub off: [f64; 2],
}

/// What the matches of a frame show of a body, independent of lens and configured sizes.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Recognition {
    /// Matches that agree on one homography of a surface: the maximum over the surfaces.
    pub agreeing: usize,
    /// Residual of the best pose minus that of the homographies, over the agreeing matches of all
    /// surfaces: mean truncated squares, in sigmas. About 0 if lens, sizes and places are right,
    /// however noisy the matches; `None` without a pose.
    pub misfit: Option<f64>,
    /// Square root of the area that the surface with the most matches covers in the frame, pixels;
    /// `None` if it extends beyond the horizon.
    pub outline_px: Option<f64>,
    /// The matches that agree on the homography of their surface.
    pub matches: Vec<AgreeingMatch>,
}

/// A match that agrees on the homography of its surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AgreeingMatch {
    /// Surface index in its body.
    pub surface: u32,
    /// Place on the surface's picture, metres from its centre.
    pub on_picture_m: Vector2<f64>,
    /// The match as an observation of the configured body.
    pub observation: Observation,
    /// Truncated squared residual of the homography, in sigmas.
    pub floor: f64,
}

/// Returns the matches that belong to the surfaces of a body, in the same order (best first).
/// `surfaces`: range of the body's surface numbers in the index.
pub fn surface_matches(
    matches: &[Match],
    frame: &[Feature],
    reference: &[ReferenceFeature],
    surfaces: std::ops::Range<u32>,
    camera: &CameraModel,
) -> Vec<SurfaceMatch> {
    let of_body = |m: &Match| {
        let r = &reference[m.reference as usize];
        if !surfaces.contains(&r.surface) {
            return None;
        }
        let f = &frame[m.frame as usize];
        let normalized = camera.unproject(Pixel(f.position))?;
        Some(SurfaceMatch {
            surface: r.surface - surfaces.start,
            artwork: r.position,
            pixel: f.position,
            undistorted: camera.undistorted_pixel(normalized),
            scale: f.scale,
            derivative: f.shape() * r.shape.try_inverse()?,
        })
    };
    matches.iter().filter_map(of_body).collect()
}

/// Returns candidate poses of a body, best first, at most four, and what was recognised of it.
/// `sampled`: the matches among which homographies are sought; `seed`: of the robust estimation.
pub fn candidates(
    body: &PreparedBody,
    matches: &[SurfaceMatch],
    sampled: &[SurfaceMatch],
    camera: &CameraModel,
    seed: u64,
) -> (Vec<Candidate>, Recognition) {
    let mut seen = Recognition::default();
    let observations: Vec<Observation> = matches.iter().map(|m| observation(body, m)).collect();
    let still = MovingCamera::still(camera);
    let mut found: Vec<Candidate> = Vec::new();
    let mut poses: Vec<Pose<Camera, Body>> = Vec::new();
    for surface in 0..body.surfaces.len() as u32 {
        let Some(view) = surface_view(surface, sampled, camera, seed) else { continue };
        seen.matches.extend(view.observed(body));
        // Maximum number of matches that a pose of this surface explains so far.
        let mut explained = 0;
        for start in surface_poses(body, &view, camera, &mut seen) {
            // From nearby or far aside, the planar pose with the opposite tilt explains little.
            let near = || within_reach(&start, &still, &observations, TUNING.refinement_gate_sigmas[1]).count() as f64;
            if explained >= TUNING.twin_test_matches && near() < TUNING.min_twin_match_ratio * explained as f64 {
                continue;
            }
            let Some(candidate) = refined_candidate(&start, &still, &observations) else { continue };
            poses.push(candidate.pose);
            explained = explained.max(candidate.inliers);
            if candidate.inliers >= TUNING.min_homography_inliers {
                add_new(&mut found, candidate);
            }
        }
    }
    keep_best(&mut found);
    seen.misfit = misfit(&poses, &still, &seen.matches);
    (found, seen)
}

/// Adds poses supported by few matches, unless `found` already contains a well-supported one. Of
/// small, blurred and weak pictures so few matches are right that no sample of four consists of
/// right ones; but each single match tells how its surface is seen.
pub fn add_candidates_of_few(body: &PreparedBody, matches: &[SurfaceMatch], camera: &CameraModel, found: &mut Vec<Candidate>) {
    if found.iter().any(|candidate| candidate.inliers >= TUNING.well_supported_inliers) {
        return;
    }
    let observations: Vec<Observation> = matches.iter().map(|m| observation(body, m)).collect();
    let still = MovingCamera::still(camera);
    for surface in 0..body.surfaces.len() as u32 {
        let starts = affine_poses(body, surface, matches, camera);
        let refined = starts.iter().filter_map(|start| refined_candidate(start, &still, &observations));
        refined.filter(|candidate| candidate.inliers >= TUNING.min_affine_inliers).for_each(|candidate| add_new(found, candidate));
    }
    keep_best(found);
}

/// Keeps the candidates of lowest cost, best first.
fn keep_best(found: &mut Vec<Candidate>) {
    found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    found.truncate(TUNING.max_candidates);
}

/// Adds a candidate unless a nearly identical one is there.
fn add_new(found: &mut Vec<Candidate>, candidate: Candidate) {
    if !found.iter().any(|c| nearly_same(&c.pose, &candidate.pose)) {
        found.push(candidate);
    }
}

/// Refines a start and returns it with its inliers and cost.
fn refined_candidate(start: &Pose<Camera, Body>, camera: &MovingCamera<CameraModel>, observations: &[Observation]) -> Option<Candidate> {
    let found = refined(start, camera, observations)?;
    let inliers = within_reach(&found.pose, camera, observations, TUNING.max_squared_match_residual.sqrt()).count();
    Some(Candidate { pose: found.pose, inliers, cost: truncated_cost(&found.pose, camera, observations), off: off(&found) })
}

/// Refines a start over the matches near it: most matches may be wrong, but resection tolerates
/// only a minority of outliers.
fn refined(start: &Pose<Camera, Body>, camera: &MovingCamera<CameraModel>, observations: &[Observation]) -> Option<Resection> {
    let near = |pose: &Pose<Camera, Body>, sigmas: f64| -> Vec<Observation> {
        within_reach(pose, camera, observations, sigmas).copied().collect()
    };
    let [rough, fine] = TUNING.refinement_gate_sigmas;
    let pose = resect(start, camera, &near(start, rough), TUNING.max_refinement_steps)?.pose;
    resect(&pose, camera, &near(&pose, fine), TUNING.max_refinement_steps)
}

/// See [`Candidate::off`]; infinite if the matches leave a direction undetermined.
fn off(found: &Resection) -> [f64; 2] {
    let Some(noise) = found.normal.cholesky() else { return [f64::INFINITY; 2] };
    let covariance = covariance_of_inverse(&found.pose, &(noise.inverse() * found.scale.powi(2)));
    [0, 3].map(|first| covariance.fixed_view::<3, 3>(first, first).trace().sqrt())
}

/// Returns the observations within a number of sigmas of where the pose projects them.
fn within_reach<'a>(
    pose: &Pose<Camera, Body>,
    camera: &MovingCamera<'a, CameraModel>,
    observations: &'a [Observation],
    sigmas: f64,
) -> impl Iterator<Item = &'a Observation> {
    let (pose, camera) = (*pose, *camera);
    observations.iter().filter(move |o| squared_residual(&pose, &camera, o).is_some_and(|s| s < sigmas * sigmas))
}

fn observation(body: &PreparedBody, m: &SurfaceMatch) -> Observation {
    let information = Matrix2::identity() / (TUNING.feature_noise_px * m.scale).powi(2);
    Observation { point: body.surfaces[m.surface as usize].spec.body_point(m.artwork), pixel: m.pixel, information, delay_s: 0.0, group: 0 }
}

/// Returns the sum of squared residuals in sigmas, each truncated at `max_squared_match_residual`.
fn truncated_cost(pose: &Pose<Camera, Body>, camera: &MovingCamera<CameraModel>, observations: &[Observation]) -> f64 {
    let squared = |o: &Observation| squared_residual(pose, camera, o).unwrap_or(f64::INFINITY);
    observations.iter().map(|o| squared(o).min(TUNING.max_squared_match_residual)).sum()
}

/// Whether two candidates are equivalent: within a hundredth of the distance and half a degree.
pub fn nearly_same(a: &Pose<Camera, Body>, b: &Pose<Camera, Body>) -> bool {
    a.angle_to(b) < 0.01 && (a.translation - b.translation).norm() < 0.01 * a.translation.norm()
}

/// A surface as the matches of a frame show it, independent of its configured size.
#[derive(Debug, Clone, PartialEq)]
pub struct SurfaceView {
    /// Its index in its body.
    pub surface: u32,
    /// From the artwork's pixels to undistorted pixels of the frame.
    pub homography: Homography,
    /// The matches that agree on it, best first.
    pub matches: Vec<SurfaceMatch>,
}

impl SurfaceView {
    /// Returns the matches as observations of the body.
    pub fn observed(&self, body: &PreparedBody) -> impl Iterator<Item = AgreeingMatch> {
        let spec = &body.surfaces[self.surface as usize].spec;
        self.matches.iter().map(move |m| AgreeingMatch {
            surface: self.surface,
            on_picture_m: spec.to_metres(m.artwork),
            observation: observation(body, m),
            floor: self.squared_error(m),
        })
    }

    /// Returns the squared residual of the homography for a match, in sigmas, truncated.
    fn squared_error(&self, m: &SurfaceMatch) -> f64 {
        let pair = PointPair { from: m.artwork, to: m.undistorted };
        (self.homography.squared_error(&pair) / (TUNING.feature_noise_px * m.scale).powi(2)).min(TUNING.max_squared_match_residual)
    }
}

/// See [`Recognition::misfit`].
fn misfit(poses: &[Pose<Camera, Body>], camera: &MovingCamera<CameraModel>, agreeing: &[AgreeingMatch]) -> Option<f64> {
    let squared = |pose: &Pose<Camera, Body>, o: &Observation| {
        squared_residual(pose, camera, o).map_or(TUNING.max_squared_match_residual, |s| s.min(TUNING.max_squared_match_residual))
    };
    let over =
        |pose: &Pose<Camera, Body>| agreeing.iter().map(|m| squared(pose, &m.observation) - m.floor).sum::<f64>() / agreeing.len() as f64;
    poses.iter().map(over).min_by(f64::total_cmp).filter(|m| m.is_finite())
}

/// Returns the homography that most matches of a surface agree on; `None` if too few do or it is
/// mirrored, as the surface's front never is.
pub fn surface_view(surface: u32, matches: &[SurfaceMatch], camera: &CameraModel, seed: u64) -> Option<SurfaceView> {
    let own: Vec<SurfaceMatch> = matches.iter().filter(|m| m.surface == surface).copied().collect();
    if own.len() < TUNING.min_homography_inliers {
        return None;
    }
    let pairs: Vec<PointPair> = own.iter().map(|m| PointPair { from: m.artwork, to: m.undistorted }).collect();
    let threshold = 4.0 * (f64::from(camera.width().max(camera.height())) / 1280.0).max(0.75);
    let order = Order::BestFirst { even_after: TUNING.max_homography_samples, draws_each: 1, stops_by_best: false };
    let options =
        RobustOptions { threshold, max_samples: TUNING.max_homography_samples, confidence: 0.9999, order, weighs_alike: false, seed };
    let found =
        robust_homography(&pairs, &options).filter(|f| f.inliers.len() >= TUNING.min_homography_inliers && f.model.keeps_orientation())?;
    let matches = found.inliers.iter().map(|&k| own[k]).collect();
    Some(SurfaceView { surface, homography: found.model, matches })
}

/// Returns both planar poses of a view and records what was recognised.
fn surface_poses(body: &PreparedBody, view: &SurfaceView, camera: &CameraModel, seen: &mut Recognition) -> Vec<Pose<Camera, Body>> {
    let spec = &body.surfaces[view.surface as usize].spec;
    if view.matches.len() > seen.agreeing {
        (seen.agreeing, seen.outline_px) = (view.matches.len(), outline_px(&view.homography, spec.artwork.dimensions()));
    }
    let metric: Vec<PointPair> = view
        .matches
        .iter()
        .map(|m| PointPair { from: spec.to_metres(m.artwork), to: camera.from_undistorted_pixel(m.undistorted).0 })
        .collect();
    let Some(homography) = Homography::from_pairs(&metric, None) else { return Vec::new() };
    planar_poses(&homography, &metric).into_iter().map(|p| p * spec.pose.inverse()).collect()
}

/// Returns the matches of a surface and the local affine map that each of them implies.
fn affinities(surface: u32, matches: &[SurfaceMatch]) -> (Vec<&SurfaceMatch>, Vec<LocalAffinity>) {
    let affinity = |m: &SurfaceMatch| LocalAffinity {
        pair: PointPair { from: m.artwork, to: m.undistorted },
        derivative: m.derivative,
        noise: TUNING.feature_noise_px * m.scale,
    };
    matches.iter().filter(|m| m.surface == surface).map(|m| (m, affinity(m))).unzip()
}

/// Returns, per surface, the matches that agree on one affine map, if they are enough to justify a
/// search. Valid for bodies that are small relative to their distance, where perspective is
/// negligible.
pub fn agreeing_matches(body: &PreparedBody, matches: &[SurfaceMatch]) -> Vec<SurfaceMatch> {
    let of_surface = |surface: u32| {
        let (own, affinities) = affinities(surface, matches);
        most_agreeing(&affinities, TUNING.min_affine_inliers).unwrap_or_default().into_iter().map(move |k| *own[k])
    };
    (0..body.surfaces.len() as u32).flat_map(of_surface).collect()
}

/// Returns both planar poses of the affine map that a few matches of a surface agree on.
fn affine_poses(body: &PreparedBody, surface: u32, matches: &[SurfaceMatch], camera: &CameraModel) -> Vec<Pose<Camera, Body>> {
    let spec = &body.surfaces[surface as usize].spec;
    let (own, affinities) = affinities(surface, matches);
    let Some((map, agreeing)) = robust_affine(&affinities, TUNING.min_affine_inliers) else { return Vec::new() };
    let steps = [Vector2::x(), -Vector2::x(), Vector2::y(), -Vector2::y()];
    let around = |m: &SurfaceMatch| {
        let back = m.derivative.try_inverse().unwrap_or_default() * (TUNING.affine_reach_px * m.scale);
        steps.map(|step| m.artwork + back * step)
    };
    let metric = |artwork: Vector2<f64>| {
        let seen = map.map(artwork)?;
        Some(PointPair { from: spec.to_metres(artwork), to: camera.from_undistorted_pixel(seen).0 })
    };
    let pairs: Vec<PointPair> = agreeing.iter().flat_map(|&k| around(own[k])).filter_map(metric).collect();
    let Some(homography) = Homography::from_pairs(&pairs, None) else { return Vec::new() };
    planar_poses(&homography, &pairs).into_iter().map(|p| p * spec.pose.inverse()).collect()
}

/// Returns the square root of the area that a picture of this size covers in the frame.
fn outline_px(homography: &Homography, (width, height): (u32, u32)) -> Option<f64> {
    let (w, h) = (f64::from(width), f64::from(height));
    let corners = [(0.0, 0.0), (w, 0.0), (w, h), (0.0, h)].map(|(x, y)| homography.map(Vector2::new(x, y)));
    let [a, b, c, d] = [corners[0]?, corners[1]?, corners[2]?, corners[3]?];
    Some((0.5 * (c - a).perp(&(d - b))).abs().sqrt())
}

#[cfg(test)]
#[path = "candidate_tests.rs"]
mod tests;
