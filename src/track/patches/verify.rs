//! Verification: refines a candidate pose by registration, then judges it against the frame before
//! it may be reported.
//!
//! A pose needs enough anchors that fit, a large enough fraction of those that should fit, spread
//! over the frame; a small enough covariance; and a clear margin over the pose with the surface
//! tilted the other way.

use crate::track::patches::tuning::TUNING;
use nalgebra::Matrix6;

use super::fitted_anchor::FittedAnchor;
use super::planar_ambiguity::{ambiguity_margin, most_frequent_surface};
use super::registration::{Registered, SearchPicture, Target, register, visible_targets};
use super::row_motion::RowMotion;
use crate::camera::CameraModel;
use crate::features::Workers;
use crate::geometry::covariance::covariance_of_inverse;
use crate::geometry::resection::{
    MovingCamera, Observation, Resection, SquaredResiduals, pose_by_twist, resect, rolling_shutter_corrected_px, sandwich_covariance,
    squared_residual,
};
use crate::geometry::robust_kernel::tukey_weight;
use crate::geometry::{Body, Camera, Pose};
use crate::track::scene::reference::PreparedBody;

/// A pose that passed.
#[derive(Debug, Clone, Copy)]
pub struct Verified {
    /// `T_body_camera`.
    pub pose: Pose<Body, Camera>,
    /// Covariance of [δp, δθ], body axes, from this frame's noise.
    pub covariance: Matrix6<f64>,
    /// The same from the uncertainty of lens and shapes and from model errors. It persists from
    /// frame to frame, so that no filter can average it away. `None` if there is none.
    pub by_model: Option<Matrix6<f64>>,
    /// Fraction of the searched anchors that fit.
    pub share: f64,
    /// Number of pixels or anchors that it rests on.
    pub inliers: usize,
    /// Root mean square residual of what the solver used, pixels: of pixels over their gradients,
    /// or of anchors.
    pub solver_rms_px: f64,
    /// Whether this frame alone is conclusive.
    pub is_conclusive: bool,
}

impl Verified {
    /// Returns the pose in the other direction, for projections.
    pub fn t_camera_body(&self) -> Pose<Camera, Body> {
        self.pose.inverse()
    }
}

/// Why a candidate was refused.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Refusal {
    /// Too few anchors in view or fitting: their number.
    TooFew(usize),
    /// They lie in too few tiles: the number of tiles.
    Clustered(usize),
    /// Too small a fraction of those searched fits: the fraction.
    Share(f64),
    /// Too many anchors were found away from their prediction (their number): a torn frame, or a
    /// wrong pose.
    Contradicted(usize),
    /// The pose is too uncertain.
    Uncertain,
    /// The tilted twin explains the picture nearly as well: the margin in chi-squared.
    Ambiguous(f64),
    /// The picture repeats itself, and the pose one period aside explains it better.
    Repeated,
}

impl Refusal {
    /// Returns how far a pose came through the tests, from 0.
    pub fn stage(self) -> u8 {
        match self {
            Self::TooFew(_) => 0,
            Self::Clustered(_) => 1,
            Self::Share(_) => 2,
            Self::Contradicted(_) => 3,
            Self::Uncertain => 4,
            Self::Ambiguous(_) | Self::Repeated => 5,
        }
    }
}

/// The frame at full size, its camera, and the workers that search in it.
#[derive(Debug, Clone, Copy)]
pub struct FullView<'a> {
    /// The lens.
    pub camera: &'a CameraModel,
    /// The frame.
    pub picture: SearchPicture<'a>,
    /// What is known about the motion during its readout.
    pub row_motion: RowMotion,
    /// The workers that search the anchors.
    pub workers: &'a Workers,
}

/// What verification uses: the frame at both sizes.
#[derive(Debug, Clone, Copy)]
pub struct View<'a> {
    /// The frame at full size.
    pub full: FullView<'a>,
    /// The same frame at half size.
    pub half: SearchPicture<'a>,
}

/// Buffers of the verification.
#[derive(Debug, Default)]
pub struct VerifyBuffers {
    targets: Vec<Target>,
    registered: Vec<Option<Registered>>,
    observations: Vec<Observation>,
    squared: SquaredResiduals,
    /// The anchors that fit the last judged pose.
    pub anchors: Vec<FittedAnchor>,
    /// All anchors that were found then, wherever they were.
    pub found: Vec<FittedAnchor>,
}

/// The anchors of silent surfaces; keeps its buffers.
#[derive(Debug, Default)]
pub struct SilentSearch {
    targets: Vec<Target>,
    registered: Vec<Option<Registered>>,
    /// Per surface: anchors in view, and anchors that alignment shows.
    per_surface: Vec<[usize; 2]>,
    /// The anchors that [`search_silent`] found.
    pub found: Vec<FittedAnchor>,
}

/// Searches for the anchors of silent surfaces (in view, but hardly aligned) around their predicted
/// places, at half size where full size shows too few; the result is in `silent.found`. `aligned`:
/// the anchors that alignment shows.
pub fn search_silent(body: &PreparedBody, pose: &Pose<Camera, Body>, view: &View, aligned: &[FittedAnchor], silent: &mut SilentSearch) {
    let View { full: view, half } = view;
    let SilentSearch { targets, registered, per_surface, found } = silent;
    found.clear();
    if body.surfaces.len() < 2 {
        return;
    }
    visible_targets(body, pose, view.camera, &view.picture, TUNING.max_fine_anchors, targets);
    per_surface.clear();
    per_surface.resize(body.surfaces.len(), [0, 0]);
    targets.iter().for_each(|t| per_surface[t.surface as usize][0] += 1);
    aligned.iter().for_each(|a| per_surface[a.surface as usize][1] += 1);
    let usual = aligned.len() as f64 / targets.len().max(1) as f64;
    let is_silent = |[wanted, shown]: [usize; 2]| {
        wanted >= TUNING.min_silent_anchors && (shown as f64) < TUNING.silent_surface_ratio * usual * wanted as f64
    };
    targets.retain(|t| is_silent(per_surface[t.surface as usize]));
    if targets.is_empty() {
        return;
    }
    register(body, targets, &view.picture, view.workers, registered);
    let moving = MovingCamera { lens: view.camera, twist: view.row_motion.twist(pose) };
    let shutter = view.row_motion.shutter;
    let anchor = |r: &Registered| {
        let seen = r.observation?;
        let observation = Observation { delay_s: shutter.delay_s(seen.pixel.y + 0.5, view.camera.height()), ..seen };
        let corrected_px = rolling_shutter_corrected_px(pose, &moving, &observation);
        Some(FittedAnchor { surface: r.surface, artwork: r.artwork, observation, corrected_px })
    };
    found.extend(registered.iter().flatten().filter_map(anchor));
    // What is displaced beyond the reach of full size: anchors searched for, and found.
    per_surface.fill([0, 0]);
    targets.iter().for_each(|t| per_surface[t.surface as usize][0] += 1);
    found.iter().for_each(|a| per_surface[a.surface as usize][1] += 1);
    let is_far = |[wanted, shown]: [usize; 2]| wanted > 0 && (shown as f64) < TUNING.silent_surface_ratio * wanted as f64;
    if per_surface.iter().any(|counts| is_far(*counts)) {
        visible_targets(body, pose, view.camera, half, TUNING.max_coarse_anchors, targets);
        targets.retain(|t| is_far(per_surface[t.surface as usize]));
        register(body, targets, half, view.workers, registered);
        found.retain(|a| !is_far(per_surface[a.surface as usize]));
        found.extend(registered.iter().flatten().filter_map(anchor));
    }
}

/// Refines a candidate coarse to fine and judges it. `start`: `T_camera_body`; `continued`: the
/// pose continues a confirmed track. Returns why if it is refused.
pub fn verify(
    body: &PreparedBody,
    start: &Pose<Camera, Body>,
    view: &View,
    continued: bool,
    buffers: &mut VerifyBuffers,
) -> Result<Verified, Refusal> {
    // A small stage shows too few anchors at half size: then the start is used directly.
    let coarse = registered_pose(body, start, &view.full, &view.half, TUNING.max_coarse_anchors, buffers)
        .ok()
        .filter(|_| buffers.observations.len() >= TUNING.min_coarse_fitting_anchors);
    let start = coarse.map_or(*start, |c| c.pose);
    let fine = registered_pose(body, &start, &view.full, &view.full.picture, TUNING.max_fine_anchors, buffers)?;
    judge(body, &fine, &view.full, continued, buffers)
}

/// One iteration: predict, search, resect.
fn registered_pose(
    body: &PreparedBody,
    start: &Pose<Camera, Body>,
    view: &FullView,
    picture: &SearchPicture,
    count: usize,
    buffers: &mut VerifyBuffers,
) -> Result<Resection, Refusal> {
    let (camera, row_motion) = (view.camera, &view.row_motion);
    let shutter = row_motion.shutter;
    visible_targets(body, start, camera, picture, count, &mut buffers.targets);
    register(body, &buffers.targets, picture, view.workers, &mut buffers.registered);
    buffers.observations.clear();
    for o in buffers.registered.iter().flatten().filter_map(|r| r.observation) {
        buffers.observations.push(Observation { group: tile(camera, &o), delay_s: shutter.delay_s(o.pixel.y + 0.5, camera.height()), ..o });
    }
    let n = buffers.observations.len();
    if n < TUNING.min_resection_anchors {
        return Err(Refusal::TooFew(n));
    }
    let mut found = resect(start, &MovingCamera { lens: camera, twist: row_motion.twist(start) }, &buffers.observations, 15);
    if shutter.readout_s > 0.0 && row_motion.before.is_some() {
        // The motion depends on the pose, and the pose on the motion.
        for _ in 0..2 {
            let Some(pose) = found.map(|f| f.pose) else { break };
            found = resect(&pose, &MovingCamera { lens: camera, twist: row_motion.twist(&pose) }, &buffers.observations, 15);
        }
    }
    found.ok_or(Refusal::Uncertain)
}

fn tile(camera: &CameraModel, o: &Observation) -> u32 {
    let index = |v: f64, size: u32, n: u32| ((v / f64::from(size) * f64::from(n)) as u32).min(n - 1);
    index(o.pixel.y, camera.height(), TUNING.verification_tiles[1]) * TUNING.verification_tiles[0]
        + index(o.pixel.x, camera.width(), TUNING.verification_tiles[0])
}

fn judge(
    body: &PreparedBody,
    fine: &Resection,
    view: &FullView,
    continued: bool,
    buffers: &mut VerifyBuffers,
) -> Result<Verified, Refusal> {
    let moving = MovingCamera { lens: view.camera, twist: view.row_motion.twist(&fine.pose) };
    let asked = buffers.registered.iter().flatten().count();
    collect_anchors(fine, &moving, buffers);
    let anchors = &buffers.anchors;
    if anchors.len() < TUNING.min_fitting_anchors {
        return Err(Refusal::TooFew(anchors.len()));
    }
    let mut tiles: Vec<u32> = anchors.iter().map(|a| a.observation.group).collect();
    tiles.sort_unstable();
    tiles.dedup();
    if tiles.len() < TUNING.min_occupied_tiles {
        return Err(Refusal::Clustered(tiles.len()));
    }
    let share = anchors.len() as f64 / asked.max(1) as f64;
    if share < if continued { TUNING.min_continued_fitting_ratio } else { TUNING.min_new_fitting_ratio } {
        return Err(Refusal::Share(share));
    }
    let contradicting = contradicting_anchors(fine, &moving, &buffers.observations);
    tracing::trace!(fitting = anchors.len(), contradicting, asked);
    if contradicting as f64 > TUNING.max_contradiction * anchors.len() as f64 {
        return Err(Refusal::Contradicted(contradicting));
    }
    let covariance = judged_covariance(body, fine, &moving, view, &buffers.observations)?;
    let surface = most_frequent_surface(anchors, body.surfaces.len());
    let margin = ambiguity_margin(body, surface, &fine.pose, &moving, &buffers.observations, &mut buffers.squared);
    if margin < TUNING.min_twin_margin {
        return Err(Refusal::Ambiguous(margin));
    }
    let squared_px = |a: &FittedAnchor| {
        let unit = Observation { information: nalgebra::Matrix2::identity(), ..a.observation };
        squared_residual(&fine.pose, &moving, &unit).unwrap_or(0.0)
    };
    let solver_rms_px = (anchors.iter().map(squared_px).sum::<f64>() / anchors.len() as f64).sqrt();
    let (pose, covariance) = (fine.pose.inverse(), covariance_of_inverse(&fine.pose, &covariance));
    Ok(Verified { pose, covariance, by_model: None, share, inliers: anchors.len(), solver_rms_px, is_conclusive: false })
}

/// Collects the anchors that were found, and those of them that agree with the pose both in pixels
/// and in sigmas.
fn collect_anchors(fine: &Resection, moving: &MovingCamera<CameraModel>, buffers: &mut VerifyBuffers) {
    let VerifyBuffers { registered, observations, anchors, found, .. } = buffers;
    let limit = residual_limit_px(moving.lens);
    // The observations were collected from these, in this order.
    let seen = registered.iter().flatten().filter(|r| r.observation.is_some());
    found.clear();
    found.extend(seen.zip(&*observations).map(|(r, &observation)| FittedAnchor {
        surface: r.surface,
        artwork: r.artwork,
        observation,
        corrected_px: rolling_shutter_corrected_px(&fine.pose, moving, &observation),
    }));
    let fits = |anchor: &&FittedAnchor| {
        let unit = Observation { information: nalgebra::Matrix2::identity(), ..anchor.observation };
        let squared = |o: &Observation| squared_residual(&fine.pose, moving, o).unwrap_or(f64::INFINITY);
        squared(&unit) < limit * limit && tukey_weight(squared(&anchor.observation), fine.scale) > 0.0
    };
    anchors.clear();
    anchors.extend(found.iter().filter(fits));
}

/// Returns the number of anchors that were found further from their prediction than a roughly known
/// lens explains.
fn contradicting_anchors(fine: &Resection, moving: &MovingCamera<CameraModel>, observations: &[Observation]) -> usize {
    let limit = 2.0 * residual_limit_px(moving.lens);
    let is_far = |o: &&Observation| {
        let unit = Observation { information: nalgebra::Matrix2::identity(), ..**o };
        squared_residual(&fine.pose, moving, &unit).is_none_or(|squared| squared > limit * limit)
    };
    observations.iter().filter(is_far).count()
}

/// Returns `max_residual_px` scaled to the size of this camera's frames, at least half of it.
fn residual_limit_px(lens: &CameraModel) -> f64 {
    TUNING.max_residual_px * (f64::from(lens.width().max(lens.height())) / 1280.0).max(0.5)
}

/// Returns the covariance; refuses the pose if noise alone makes it too uncertain. The uncertainty
/// of the motion is added after that test.
fn judged_covariance(
    body: &PreparedBody,
    fine: &Resection,
    moving: &MovingCamera<CameraModel>,
    view: &FullView,
    observations: &[Observation],
) -> Result<Matrix6<f64>, Refusal> {
    let mut covariance = sandwich_covariance(fine, moving, observations).ok_or(Refusal::Uncertain)?;
    let distance = nearest_surface_distance(body, &fine.pose);
    judged_noise(&covariance, distance)?;
    if let Some(deviation) = view.row_motion.twist_deviation(&fine.pose) {
        let by_twist = pose_by_twist(fine, moving, observations).ok_or(Refusal::Uncertain)?;
        let spread = by_twist * Matrix6::from_diagonal(&deviation);
        covariance += spread * spread.transpose();
    }
    Ok(covariance)
}

/// Refuses a pose whose noise makes it too uncertain. `covariance`: of position and rotation, of
/// the pose in either direction; `distance_m`: distance to the nearest surface.
pub fn judged_noise(covariance: &Matrix6<f64>, distance_m: f64) -> Result<(), Refusal> {
    let sigma = |first: usize| covariance.fixed_view::<3, 3>(first, first).trace().sqrt();
    let is_known = sigma(0) <= TUNING.max_position_sigma * distance_m && sigma(3) <= TUNING.max_direction_sigma;
    is_known.then_some(()).ok_or(Refusal::Uncertain)
}

/// Returns the distance from the camera to the nearest surface centre, metres.
fn nearest_surface_distance(body: &PreparedBody, pose: &Pose<Camera, Body>) -> f64 {
    body.surfaces.iter().map(|s| (*pose * s.spec.pose).translation.norm()).fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
#[path = "verify_tests.rs"]
mod tests;
