//! The keyframes of a map: those in which a configured surface was found, and those that the points
//! of the set pose. If nothing configures the shutter, the points also tell whether it rolls.

use nalgebra::Vector3;

use super::super::keyframes::Keyframe;
use super::super::lively_part::NumberedFrame;
use super::super::progress::SurveyError;
use super::super::walk::{Walk, motion_since};
use super::bundle::{self, Cloud};
use super::error::MapError;
use super::growth::{Grown, Lens, Shot, grown};
use super::rolling_readout::{ASSUMED_S, readout};
use super::seed::{DISTANCE_M, seed};
use super::tracks::Recognition;
use super::views::View;
use crate::camera::Shutter;
use crate::frame::Timestamp;
use crate::geometry::robust_kernel::median;
use crate::geometry::{Body, Camera, Pose};
use crate::motion::Motion;
use crate::survey::shutter::ShutterTime;
use crate::track::KnownRates;

/// Minimum spacing of keyframes that only points pose, as a fraction of the distance or in radians.
/// Raised, parts without a surface have few keyframes; lowered, mapping takes longer.
const SPACING: f64 = 0.04;
/// One sigma of a rolling camera's rates as the points tell them: metres per second as a share of
/// the distance, and radians per second; and of its accelerations, which they do not tell. Raised,
/// a few facets decide on the motion instead; lowered, errors of the points stay.
const RATE_SIGMA: f64 = 0.02;
const ACCELERATION_SIGMA: f64 = 1.0;
/// Rounds of the adjustment that tells an unknown readout.
const READOUT_ROUNDS: usize = 2;

/// The posed keyframes of a walk.
pub struct PosedWalk {
    /// The keyframes, in the walk's order.
    pub keyframes: Vec<Keyframe>,
    /// Their poses and points.
    pub cloud: Cloud,
    /// Whether a configured surface was found in each.
    pub is_found: Vec<bool>,
    /// The readout that the points told, if nothing configured it and it is not 0.
    pub readout: Option<ShutterTime>,
}

/// A frame that may become a keyframe.
struct Candidate {
    keyframe: Keyframe,
    is_found: bool,
    /// Whether it stays, however near others are.
    is_asked_for: bool,
}

impl Candidate {
    fn shot(&self) -> Shot<'_> {
        let start = self.is_found.then_some(self.keyframe.motion.pose);
        let Motion { velocity, angular_velocity, .. } = self.keyframe.motion;
        Shot { picture: &self.keyframe.frame.image, start, rates: [velocity, angular_velocity], is_anchored: self.is_found }
    }
}

/// Poses the keyframes of a walk. `is_shutter_known`: whether the readout is configured.
///
/// # Errors
/// The walk does not determine them, or the work was stopped.
pub fn posed_walk(
    walk: Walk,
    lens: &Lens<'_>,
    is_shutter_known: bool,
    has_surfaces: bool,
    goes_on: &(dyn Fn() -> bool + Sync),
) -> Result<PosedWalk, MapError> {
    let failed = |error: MapError| if goes_on() { error } else { SurveyError::Interrupted.into() };
    let candidates = candidates(walk);
    let mut shots: Vec<Shot<'_>> = candidates.iter().map(Candidate::shot).collect();
    let pictures: Vec<_> = shots.iter().map(|shot| shot.picture).collect();
    let mut recognition = Recognition::of(&pictures, lens.mask, goes_on).ok_or(SurveyError::Interrupted)?;
    if !has_surfaces {
        let seeds = seed(&shots, lens, &mut recognition, goes_on).ok_or_else(|| failed(MapError::NoStart))?;
        for (order, (k, pose)) in seeds.into_iter().enumerate() {
            (shots[k].start, shots[k].is_anchored) = (Some(pose), order < 2);
        }
    }
    let undetermined = || failed(SurveyError::Undetermined.into());
    let mut all = grown(&shots, lens, &mut recognition, goes_on).ok_or_else(undetermined)?;
    let mut readout = None;
    if !is_shutter_known {
        let stamps: Vec<Timestamp> = all.frames.iter().map(|k| candidates[*k].keyframe.frame.timestamp).collect();
        readout = learnt_readout(&all, &shots, &stamps, lens, &mut recognition, goes_on);
    }
    let shutter = Shutter { readout_s: readout.map_or(lens.shutter.readout_s, |found| found.seconds), ..lens.shutter };
    if readout.is_some() {
        all = grown(&shots, &Lens { shutter, ..lens.clone() }, &mut recognition, goes_on).ok_or_else(undetermined)?;
    }
    drop(shots);
    let grown = spaced(all, &candidates);
    let mut keyframes = Vec::with_capacity(grown.frames.len());
    let mut is_found = Vec::with_capacity(grown.frames.len());
    for (k, candidate) in candidates.into_iter().enumerate().filter(|(k, _)| grown.frames.binary_search(k).is_ok()) {
        debug_assert_eq!(grown.frames.get(keyframes.len()), Some(&k));
        is_found.push(candidate.is_found);
        keyframes.push(candidate.keyframe);
    }
    match shutter.is_global() {
        true => take_motions(&mut keyframes, &is_found, &grown.cloud),
        false => take_rates(&mut keyframes, &grown.cloud),
    }
    Ok(PosedWalk { keyframes, cloud: grown.cloud, is_found, readout })
}

/// Returns the readout that the points tell, if it is not 0.
fn learnt_readout(
    all: &Grown,
    shots: &[Shot<'_>],
    stamps: &[Timestamp],
    lens: &Lens<'_>,
    recognition: &mut Recognition,
    goes_on: &(dyn Fn() -> bool + Sync),
) -> Option<ShutterTime> {
    let rolling = Lens { shutter: Shutter { readout_s: ASSUMED_S, ..lens.shutter }, ..lens.clone() };
    let posed = all.frames.iter().zip(all.cloud.poses.iter().zip(&all.cloud.rates));
    let view = |(k, (pose, rates)): (&usize, (&Pose<Body, Camera>, &_))| {
        let Shot { picture, is_anchored, .. } = shots[*k];
        View { picture, pose: *pose, rates: *rates, is_anchored }
    };
    let views = rolling.views(posed.map(view).collect());
    let tracks = recognition.tracks(&views, &all.frames, goes_on)?;
    readout(&views, &bundle::adjusted(&views, tracks, READOUT_ROUNDS, goes_on)?, stamps)
}

/// Returns all frames that may become keyframes, in the walk's order.
fn candidates(walk: Walk) -> Vec<Candidate> {
    let asked: Vec<usize> = walk.named.iter().flatten().copied().collect();
    let rated = |keyframe: Keyframe| {
        let motion = keyframe.rates.map_or(keyframe.motion, |rates| rates.on(&keyframe.motion.pose));
        Keyframe { motion, ..keyframe }
    };
    let found = walk.keyframes.into_iter().map(|keyframe| (rated(keyframe), true));
    let unseen = walk.unseen.into_iter().map(|NumberedFrame { number, frame }| {
        (Keyframe { number, frame, motion: Motion::still(Pose::identity()), rates: None, features: Vec::new() }, false)
    });
    let mut all: Vec<Candidate> = found
        .chain(unseen)
        .map(|(keyframe, is_found)| Candidate { is_asked_for: asked.contains(&keyframe.number), keyframe, is_found })
        .collect();
    all.sort_by_key(|candidate| candidate.keyframe.number);
    all
}

/// Returns the median distance of the points from the cameras, metres.
fn usual_distance_m(cloud: &Cloud) -> f64 {
    let depth = |point: &bundle::CloudPoint| Some((cloud.poses[point.sightings.first()?.view].translation - point.place).norm());
    let mut depths: Vec<f64> = cloud.points.iter().filter_map(depth).collect();
    median(&mut depths).unwrap_or(DISTANCE_M)
}

/// Leaves out frames that only points pose and that are too near the one before.
fn spaced(grown: Grown, candidates: &[Candidate]) -> Grown {
    let Grown { frames, cloud } = grown;
    let distance_m = usual_distance_m(&cloud);
    let mut last: Option<Pose<Body, Camera>> = None;
    let is_kept = |view: &usize| {
        let (pose, candidate) = (&cloud.poses[*view], &candidates[frames[*view]]);
        let moved =
            last.map_or(f64::INFINITY, |last| (last.translation - pose.translation).norm() / distance_m + 0.5 * last.angle_to(pose));
        let is_kept = candidate.is_found || candidate.is_asked_for || moved >= SPACING;
        if is_kept {
            last = Some(*pose);
        }
        is_kept
    };
    let kept: Vec<usize> = (0..frames.len()).filter(is_kept).collect();
    if kept.len() == frames.len() {
        return Grown { frames, cloud };
    }
    Grown { frames: kept.iter().map(|view| frames[*view]).collect(), cloud: cloud.of_views(&kept) }
}

/// Gives the frames that points pose their motion, from the keyframes before and after.
fn take_motions(keyframes: &mut [Keyframe], is_found: &[bool], cloud: &Cloud) {
    for k in (0..keyframes.len()).filter(|k| !is_found[*k]) {
        let at = |k: usize| Some((*cloud.poses.get(k)?, keyframes.get(k)?.frame.timestamp));
        let own = (cloud.poses[k], keyframes[k].frame.timestamp);
        let (before, (until, stamp)) = (k.checked_sub(1).and_then(at).unwrap_or(own), at(k + 1).unwrap_or(own));
        let motion = motion_since(Some(before), until, stamp);
        keyframes[k].motion = Motion { pose: own.0, ..motion };
    }
}

/// Gives the frames of a rolling shutter the motion that the points tell.
fn take_rates(keyframes: &mut [Keyframe], cloud: &Cloud) {
    let distance_m = usual_distance_m(cloud);
    for (keyframe, (pose, [velocity, angular_velocity])) in keyframes.iter_mut().zip(cloud.poses.iter().zip(&cloud.rates)) {
        let means = [*velocity, *angular_velocity, Vector3::zeros(), Vector3::zeros()];
        let sigmas = [RATE_SIGMA * distance_m, RATE_SIGMA, ACCELERATION_SIGMA * distance_m, ACCELERATION_SIGMA];
        let rates = KnownRates { means, sigmas };
        (keyframe.motion, keyframe.rates) = (rates.on(pose), Some(rates));
    }
}
