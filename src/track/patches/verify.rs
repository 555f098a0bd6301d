//! Verification: a candidate pose is refined by registration, and then has to prove itself against the
//! picture before it may be given.
//!
//! What it must show: enough anchors that fit, a large enough share of those that should fit, spread over
//! the frame; a small enough uncertainty; and that the surface tilted the other way explains the same anchors
//! clearly worse.

use nalgebra::Matrix6;

use super::fitted_anchor::FittedAnchor;
use super::planar_ambiguity::{MIN_MARGIN, ambiguity_margin, most_frequent_surface};
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

/// Tiles across and down the frame that anchors are grouped by: their errors count as common, and poses must rest on several. Chosen, not
/// tuned. Raised, neighbours count as independent, and covariances shrink.
const TILES: [u32; 2] = [8, 6];
/// Anchors searched in the half-size and in the full frame. Chosen, not tuned: the first only leads to the start of the second. Raised,
/// verification costs more in proportion; lowered, poses are less sure and small parts of a stage are missed.
const COARSE_ANCHORS: usize = 120;
const FINE_ANCHORS: usize = 300;
/// Fewest anchors that a pose is computed from. Chosen: 16 numbers for six unknowns, so that a wrong one shows. Raised, small stages are
/// given up before they are judged.
const MIN_RESECTED: usize = 8;
/// Fewest anchors that must fit at half size for its pose to be taken over: a small stage shows too few there, and the start is better.
/// Chosen, not tuned. Raised, rough starts are searched at full size, where they are out of reach; lowered, a few wrong anchors spoil a
/// good start.
const MIN_COARSE_FITTING: usize = 24;
/// Fewest anchors that must fit. Chosen, not tuned. Raised, small or covered stages are refused; lowered, chance passes more easily.
const MIN_FITTING: usize = 16;
/// Fewest tiles that they must lie in, of 48. Chosen, not tuned. Raised, stages that are seen small are refused; lowered, a patch of
/// repeated detail can carry a wrong pose.
const MIN_TILES: usize = 4;
/// Least share of the anchors asked that must fit, for a pose without history, and for one that continues a track. Chosen, not tuned.
/// Raised, stages that are partly covered are refused; lowered, wrong poses pass more easily.
const MIN_SHARE_NEW: f64 = 0.35;
const MIN_SHARE_CONTINUED: f64 = 0.2;
/// Anchors found elsewhere than the pose says, for each that fits. What is hidden is not found at all, so even a few speak against it.
/// Raised, torn frames and wrong poses pass; lowered, repeated detail refuses right ones.
const MAX_CONTRADICTION: f64 = 0.5;
/// Largest residual, in pixels of a 1280-pixel-wide frame, of an anchor that counts as fitting. Chosen, not tuned: wide enough for a lens
/// that is known roughly. Raised, poses beside the right one pass; lowered, guessed lenses are never verified.
const MAX_RESIDUAL_PX: f64 = 1.5;
/// Largest standard deviation of a pose that is given: of the direction in radians (half a degree), and of the position as a share of the
/// distance. Chosen, not tuned. Raised, poses are given that tell little; lowered, distant or small stages are refused.
const MAX_TURN: f64 = 0.5 * std::f64::consts::PI / 180.0;
const MAX_SHIFT: f64 = 0.012;

/// A pose that passed.
#[derive(Debug, Clone, Copy)]
pub struct Verified {
    /// `T_body_camera`.
    pub pose: Pose<Body, Camera>,
    /// Of [δp, δθ] in body axes: what this frame's noise leaves open.
    pub covariance: Matrix6<f64>,
    /// The same of what the doubt about lens and shapes leaves open, and what of the model does not fit: it stays from frame to frame, so that no
    /// filter can average it away. None where there is none.
    pub by_model: Option<Matrix6<f64>>,
    /// Share of the anchors asked that fit.
    pub share: f64,
    /// Pixels or anchors that it rests on.
    pub inliers: usize,
    /// Root mean square of the displacements that are left, pixels: of the tiles, or of the anchors.
    pub rms_px: f64,
    /// Whether this frame alone leaves no doubt.
    pub is_conclusive: bool,
}

/// Why a candidate was not given.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Refusal {
    /// Too few anchors in view or fitting.
    TooFew(usize),
    /// They lie in too few tiles.
    Clustered(usize),
    /// Too small a share of those asked.
    Share(f64),
    /// Too many anchors were found, but elsewhere than the pose says: a torn frame, or a wrong pose.
    Contradicted(usize),
    /// The pose is too uncertain.
    Uncertain,
    /// The tilted twin explains the picture nearly as well; the margin.
    Ambiguous(f64),
    /// The picture repeats itself, and the pose a period aside explains it better.
    Repeated,
}

impl Refusal {
    /// How far through the judgement a pose came.
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

/// A frame as verification needs it.
#[derive(Debug, Clone, Copy)]
pub struct View<'a> {
    /// The lens.
    pub camera: &'a CameraModel,
    /// The frame at full size.
    pub full: SearchPicture<'a>,
    /// The frame at half size.
    pub half: SearchPicture<'a>,
    /// What is known of the motion while its rows were read.
    pub row_motion: RowMotion,
    /// Who searches the anchors.
    pub workers: &'a Workers,
}

/// Buffers of the verification.
#[derive(Debug, Default)]
pub struct VerifyBuffers {
    targets: Vec<Target>,
    registered: Vec<Option<Registered>>,
    observations: Vec<Observation>,
    squared: SquaredResiduals,
    /// The anchors that fit the last pose that passed.
    pub anchors: Vec<FittedAnchor>,
    /// All that were found then, wherever that was.
    pub found: Vec<FittedAnchor>,
    /// Those that [`search_silent`] found.
    pub searched: Vec<FittedAnchor>,
    per_surface: Vec<[usize; 2]>,
}

/// A surface of which alignment shows less than this share of what it shows of all is silent: it is covered, or stands elsewhere. Chosen: a moved flat's tiles fit here
/// and there by chance. Raised, surfaces with few details are searched in vain, in time; lowered, a flat that was moved by little is not searched for.
const SILENT_SHARE: f64 = 0.6;
/// Anchors in view that a surface must have to be missed. Chosen, not tuned. Raised, small flats are never searched for; lowered, specks are.
const MIN_MISSED: usize = 10;

/// Searches for the anchors of surfaces that should be in view but of which alignment shows little, around where the pose puts them. `aligned`: what it shows. The anchors
/// are in `buffers.searched` then.
pub fn search_silent(body: &PreparedBody, pose: &Pose<Camera, Body>, view: &View, aligned: &[FittedAnchor], buffers: &mut VerifyBuffers) {
    let VerifyBuffers { targets, registered, searched, per_surface, .. } = buffers;
    searched.clear();
    if body.surfaces.len() < 2 {
        return;
    }
    visible_targets(body, pose, view.camera, &view.full, FINE_ANCHORS, targets);
    per_surface.clear();
    per_surface.resize(body.surfaces.len(), [0, 0]);
    targets.iter().for_each(|t| per_surface[t.surface as usize][0] += 1);
    aligned.iter().for_each(|a| per_surface[a.surface as usize][1] += 1);
    let usual = aligned.len() as f64 / targets.len().max(1) as f64;
    let is_silent = |[wanted, shown]: [usize; 2]| wanted >= MIN_MISSED && (shown as f64) < SILENT_SHARE * usual * wanted as f64;
    targets.retain(|t| is_silent(per_surface[t.surface as usize]));
    if targets.is_empty() {
        return;
    }
    register(body, targets, &view.full, view.workers, registered);
    let moving = MovingCamera { lens: view.camera, twist: view.row_motion.twist(pose) };
    let shutter = view.row_motion.shutter;
    searched.extend(registered.iter().flatten().filter_map(|r| {
        let seen = r.observation?;
        let observation = Observation { delay_s: shutter.delay_s(seen.pixel.y + 0.5, view.camera.height()), ..seen };
        let corrected_px = rolling_shutter_corrected_px(pose, &moving, &observation);
        Some(FittedAnchor { surface: r.surface, artwork: r.artwork, observation, corrected_px })
    }));
}

/// Refines a candidate coarse to fine and judges it. `continued`: the pose continues a confirmed track.
pub fn verify(
    body: &PreparedBody,
    start: &Pose<Camera, Body>,
    view: &View,
    continued: bool,
    buffers: &mut VerifyBuffers,
) -> Result<Verified, Refusal> {
    // A small stage has too little to hold on to at half size: then the start must do.
    let coarse = registered_pose(body, start, view, &view.half, COARSE_ANCHORS, buffers)
        .ok()
        .filter(|_| buffers.observations.len() >= MIN_COARSE_FITTING);
    let start = coarse.map_or(*start, |c| c.pose);
    let fine = registered_pose(body, &start, view, &view.full, FINE_ANCHORS, buffers)?;
    judge(body, &fine, view, continued, buffers)
}

/// One round: predict, search, resect.
fn registered_pose(
    body: &PreparedBody,
    start: &Pose<Camera, Body>,
    view: &View,
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
    if n < MIN_RESECTED {
        return Err(Refusal::TooFew(n));
    }
    let mut found = resect(start, &MovingCamera { lens: camera, twist: row_motion.twist(start) }, &buffers.observations, 15);
    if shutter.readout_s > 0.0 && row_motion.before.is_some() {
        // The motion follows from the pose, and the pose from the motion.
        for _ in 0..2 {
            let Some(pose) = found.map(|f| f.pose) else { break };
            found = resect(&pose, &MovingCamera { lens: camera, twist: row_motion.twist(&pose) }, &buffers.observations, 15);
        }
    }
    found.ok_or(Refusal::Uncertain)
}

fn tile(camera: &CameraModel, o: &Observation) -> u32 {
    let index = |v: f64, size: u32, n: u32| ((v / f64::from(size) * f64::from(n)) as u32).min(n - 1);
    index(o.pixel.y, camera.height(), TILES[1]) * TILES[0] + index(o.pixel.x, camera.width(), TILES[0])
}

fn judge(body: &PreparedBody, fine: &Resection, view: &View, continued: bool, buffers: &mut VerifyBuffers) -> Result<Verified, Refusal> {
    let moving = MovingCamera { lens: view.camera, twist: view.row_motion.twist(&fine.pose) };
    let asked = buffers.registered.iter().flatten().count();
    collect_anchors(fine, &moving, buffers);
    let anchors = &buffers.anchors;
    if anchors.len() < MIN_FITTING {
        return Err(Refusal::TooFew(anchors.len()));
    }
    let mut tiles: Vec<u32> = anchors.iter().map(|a| a.observation.group).collect();
    tiles.sort_unstable();
    tiles.dedup();
    if tiles.len() < MIN_TILES {
        return Err(Refusal::Clustered(tiles.len()));
    }
    let share = anchors.len() as f64 / asked.max(1) as f64;
    if share < if continued { MIN_SHARE_CONTINUED } else { MIN_SHARE_NEW } {
        return Err(Refusal::Share(share));
    }
    let contradicting = contradicting_anchors(fine, &moving, &buffers.observations);
    tracing::trace!(fitting = anchors.len(), contradicting, asked);
    if contradicting as f64 > MAX_CONTRADICTION * anchors.len() as f64 {
        return Err(Refusal::Contradicted(contradicting));
    }
    let covariance = judged_covariance(body, fine, &moving, view, &buffers.observations)?;
    let surface = most_frequent_surface(anchors, body.surfaces.len());
    let margin = ambiguity_margin(body, surface, &fine.pose, &moving, &buffers.observations, &mut buffers.squared);
    if margin < MIN_MARGIN {
        return Err(Refusal::Ambiguous(margin));
    }
    let squared_px = |a: &FittedAnchor| {
        let unit = Observation { information: nalgebra::Matrix2::identity(), ..a.observation };
        squared_residual(&fine.pose, &moving, &unit).unwrap_or(0.0)
    };
    let rms_px = (anchors.iter().map(squared_px).sum::<f64>() / anchors.len() as f64).sqrt();
    let (pose, covariance) = (fine.pose.inverse(), covariance_of_inverse(&fine.pose, &covariance));
    Ok(Verified { pose, covariance, by_model: None, share, inliers: anchors.len(), rms_px, is_conclusive: false })
}

/// Collects the anchors that were found, and those of them that agree with the pose, in pixels and in sigmas.
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

/// Anchors that were found well away from where the pose puts them: more than a lens known only roughly explains.
fn contradicting_anchors(fine: &Resection, moving: &MovingCamera<CameraModel>, observations: &[Observation]) -> usize {
    let limit = 2.0 * residual_limit_px(moving.lens);
    let is_far = |o: &&Observation| {
        let unit = Observation { information: nalgebra::Matrix2::identity(), ..**o };
        squared_residual(&fine.pose, moving, &unit).is_none_or(|squared| squared > limit * limit)
    };
    observations.iter().filter(is_far).count()
}

/// [`MAX_RESIDUAL_PX`] at the size of this camera's frames.
fn residual_limit_px(lens: &CameraModel) -> f64 {
    MAX_RESIDUAL_PX * (f64::from(lens.width().max(lens.height())) / 1280.0).max(0.5)
}

/// The covariance, refused where noise alone leaves too much open; what the motion leaves open is added after.
fn judged_covariance(
    body: &PreparedBody,
    fine: &Resection,
    moving: &MovingCamera<CameraModel>,
    view: &View,
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

/// Refuses a pose that its noise leaves too uncertain. `covariance`: of shift and turn, of either direction of the pose; `distance_m`: to
/// the nearest surface.
pub fn judged_noise(covariance: &Matrix6<f64>, distance_m: f64) -> Result<(), Refusal> {
    let sigma = |first: usize| covariance.fixed_view::<3, 3>(first, first).trace().sqrt();
    let is_known = sigma(0) <= MAX_SHIFT * distance_m && sigma(3) <= MAX_TURN;
    is_known.then_some(()).ok_or(Refusal::Uncertain)
}

/// Distance from the camera to the nearest surface centre, metres.
fn nearest_surface_distance(body: &PreparedBody, pose: &Pose<Camera, Body>) -> f64 {
    body.surfaces.iter().map(|s| (*pose * s.spec.pose).translation.norm()).fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
#[path = "verify_tests.rs"]
mod tests;
