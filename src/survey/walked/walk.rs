//! The walk of a survey, as extracted from the clips before anything is adjusted: keyframes, and
//! the part with the fastest motion.
//!
//! Every frame of the clips is tracked here, which takes as long as all that follows. A
//! [`WalkRecord`] stores the result without the pictures: with it an interrupted survey continues
//! from here, with a result that is bit-identical to that of an uninterrupted one.

use nalgebra::{Quaternion, UnitQuaternion, Vector2};
use serde::{Deserialize, Serialize};

use super::camera_rates::RecentPoses;
use super::keyframes::{Keyframe, Keyframes, MatchedFeature};
use super::lively_part::{LivelyPart, NumberedFrame};
use super::progress::{SurveyError, SurveyStep};
use super::stage_model::distance_m;
use super::unseen_frames::UnseenFrames;
use crate::frame::{Frame, Timestamp};
use crate::geometry::{Body, Camera, Pose};
use crate::light::camera_curve::Bend;
use crate::motion::Motion;
use crate::track::{BodySpec, BodyTracker, KnownRates, SurfaceMatch};
use crate::tracker::TrackerSetup;

/// Maximum time between two poses that give a velocity, seconds. Raised, the velocity may span a
/// turn; lowered, cameras with few frames per second give none.
const MAX_GAP_S: f64 = 0.25;
/// Number of consecutive frames tracked in vain before only features are used to find the camera.
/// More than one, since a new pose may need confirmation by the next frame. Raised, stages that
/// differ from their config take longer, 0.15 s for each such frame of fifteen surfaces; lowered to
/// 1, poses that need confirmation never get it.
const TRACKED_IN_VAIN: u32 = 3;
/// Number of frames that are not tracked from then on, one second at 30 per second. Raised, a stage
/// hidden by people is tracked again later; lowered, stages that differ from their config take
/// longer.
const UNTRACKED: u32 = 30;
/// Maximum deviation of a recorded quaternion's norm from 1. Raised, a damaged record may pass;
/// lowered, a sound one may not.
const NORM_TOLERANCE: f64 = 1e-9;

/// What clips of walking around a stage showed.
#[derive(Debug, PartialEq)]
pub struct Walk {
    pub(super) keyframes: Vec<Keyframe>,
    /// The part with the fastest motion, in order; empty if the shutter is not needed.
    pub(super) lively: Vec<NumberedFrame>,
    /// Frames in which no surface was found, and those that were asked for, in order.
    pub(super) unseen: Vec<NumberedFrame>,
    /// The number of the last frame of each clip.
    pub(super) clip_ends: Vec<usize>,
    /// The numbers of the frames that were asked for; `None` if the clips have no such frame.
    pub(super) named: Vec<Option<usize>>,
    /// Numbers of frames examined, and of those in which the stage was found.
    pub(super) frames: usize,
    pub(super) found: usize,
    /// The camera's curve as learnt from the last clip: corrections of the configured one.
    pub(super) bend: Bend,
}

/// What a walk is to keep beside its keyframes.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct WalkOptions {
    /// The part with the fastest motion.
    pub lively: bool,
    /// Frames in which no surface is found.
    pub unseen: bool,
    /// These frames: the clip by its index, and the row in it.
    pub named: Vec<(usize, u64)>,
}

/// A walk without its pictures. Frame numbers count the frames of all clips together, from 1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WalkRecord {
    frames: usize,
    found: usize,
    keyframes: Vec<KeyframeRecord>,
    lively: Vec<usize>,
    unseen: Vec<usize>,
    clip_ends: Vec<usize>,
    named: Vec<Option<usize>>,
    bend: Bend,
}

/// A keyframe without its picture. Units as in [`Motion`] and [`MatchedFeature`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct KeyframeRecord {
    number: usize,
    position_m: [f64; 3],
    orientation_xyzw: [f64; 4],
    velocity: [f64; 3],
    #[serde(rename = "turn_rate")]
    angular_velocity: [f64; 3],
    /// Known velocity, angular velocity and their accelerations, and one sigma of each.
    rates: Option<[([f64; 3], f64); 4]>,
    /// Surface, metres on its picture, pixel, sigma in pixels.
    features: Vec<(usize, [f64; 2], [f64; 2], f64)>,
}

impl Walk {
    /// Extracts the walk from clips. A stage without surfaces is found in no frame. `progress` is
    /// called for each frame; `goes_on` stops the work by returning false.
    ///
    /// # Errors
    /// [`SurveyError::Interrupted`].
    pub fn take_in<C, F>(
        clips: C,
        setup: &TrackerSetup,
        options: &WalkOptions,
        mut progress: impl FnMut(SurveyStep),
        goes_on: &(dyn Fn() -> bool + Sync),
    ) -> Result<Self, SurveyError>
    where
        C: IntoIterator<Item = F>,
        F: IntoIterator<Item = Frame>,
    {
        let TrackerSetup { camera, shutter, mask, stage, settings, clock, store, .. } = setup.clone().as_trial();
        let (mut keyframes, mut lively) = (Keyframes::default(), LivelyPart::default());
        let (mut unseen, mut asked, mut named) = (UnseenFrames::default(), Vec::new(), vec![None; options.named.len()]);
        let (mut frames, mut found, mut bend, mut clip_ends) = (0, 0, Bend::default(), Vec::new());
        for (clip_index, clip) in clips.into_iter().enumerate() {
            let mut finder = (!stage.surfaces.is_empty()).then(|| {
                StageFinder::new(BodyTracker::new(
                    camera,
                    shutter.or_zero().into(),
                    mask.clone(),
                    &[&stage],
                    settings.clone(),
                    clock,
                    store.clone(),
                ))
            });
            let mut before: Option<(Pose<Body, Camera>, Timestamp)> = None;
            let mut recent = if options.unseen { RecentPoses::for_map() } else { RecentPoses::as_configured() };
            for frame in clip {
                if !goes_on() {
                    return Err(SurveyError::Interrupted);
                }
                progress(SurveyStep::Frame);
                frames += 1;
                let fits = frame.image.dimensions() == (camera.width(), camera.height());
                let is_asked_for = |wanted: &(usize, u64)| *wanted == (clip_index, frame.sequence) && fits;
                let is_kept = options.named.iter().any(is_asked_for);
                if is_kept {
                    asked.push(NumberedFrame { number: frames, frame: frame.clone() });
                    named.iter_mut().zip(&options.named).filter(|(_, wanted)| is_asked_for(wanted)).for_each(|(n, _)| *n = Some(frames));
                }
                let seen = finder.as_mut().and_then(|finder| Some((finder.pose(&frame)?, finder)));
                let Some((pose, finder)) = seen else {
                    lively.offer(None);
                    if options.unseen && fits && !is_kept {
                        unseen.offer(frames, &frame);
                    }
                    continue;
                };
                found += 1;
                let distance_m = distance_m(&stage.surfaces, &pose);
                let motion = motion_since(before.replace((pose, frame.timestamp)), pose, frame.timestamp);
                if let Some((number, rates)) = recent.add(frames, pose, frame.timestamp, distance_m) {
                    keyframes.take_rates(number, rates);
                }
                let speed = motion.velocity.norm() / distance_m + motion.angular_velocity.norm();
                if options.lively {
                    lively.offer(Some((frames, &frame, speed)));
                }
                keyframes.offer((frames, &frame), motion, speed, distance_m, |frame| finder.matched_features(frame, &stage));
            }
            lively.offer(None);
            bend = finder.and_then(|finder| finder.matcher.learnt().curve).unwrap_or(bend);
            clip_ends.push(frames);
        }
        let keyframes = keyframes.into_kept();
        asked.retain(|asked| keyframes.iter().all(|keyframe| keyframe.number != asked.number));
        let mut unseen = unseen.into_frames();
        unseen.extend(asked);
        unseen.sort_by_key(|frame| frame.number);
        Ok(Self { keyframes, lively: lively.into_frames(), unseen, clip_ends, named, frames, found, bend })
    }

    /// Creates a walk of keyframes alone.
    pub(super) fn of_keyframes(keyframes: Vec<Keyframe>, frames: usize, found: usize, bend: Bend) -> Self {
        Self { keyframes, lively: Vec::new(), unseen: Vec::new(), clip_ends: Vec::new(), named: Vec::new(), frames, found, bend }
    }

    /// Returns the pictures that may become keyframes: the clip by its index, the row in it.
    pub fn pictures(&self) -> impl Iterator<Item = (usize, &Frame)> {
        let keyframes = self.keyframes.iter().map(|keyframe| (keyframe.number, &keyframe.frame));
        let all = keyframes.chain(self.unseen.iter().map(|unseen| (unseen.number, &unseen.frame)));
        all.map(|(number, frame)| (self.clip_ends.partition_point(|end| *end < number), frame))
    }

    /// Returns the walk without its pictures.
    pub fn record(&self) -> WalkRecord {
        let keyframes = self.keyframes.iter().map(KeyframeRecord::of).collect();
        let lively = self.lively.iter().map(|f| f.number).collect();
        let unseen = self.unseen.iter().map(|f| f.number).collect();
        let (clip_ends, named) = (self.clip_ends.clone(), self.named.clone());
        WalkRecord { frames: self.frames, found: self.found, keyframes, lively, unseen, clip_ends, named, bend: self.bend }
    }

    /// Restores a recorded walk with the pictures of its clips, which are read but not tracked.
    /// `None` if the clips have other frames, or the record cannot be one of this stage.
    ///
    /// # Errors
    /// [`SurveyError::Interrupted`].
    pub fn recall<C, F>(
        record: &WalkRecord,
        clips: C,
        stage: &BodySpec,
        mut progress: impl FnMut(SurveyStep),
        goes_on: &(dyn Fn() -> bool + Sync),
    ) -> Result<Option<Self>, SurveyError>
    where
        C: IntoIterator<Item = F>,
        F: IntoIterator<Item = Frame>,
    {
        let (mut keyframes, mut lively) = (Vec::with_capacity(record.keyframes.len()), Vec::with_capacity(record.lively.len()));
        let (mut unseen, mut frames) = (Vec::with_capacity(record.unseen.len()), 0);
        for frame in clips.into_iter().flatten() {
            if !goes_on() {
                return Err(SurveyError::Interrupted);
            }
            progress(SurveyStep::Frame);
            frames += 1;
            if record.lively.get(lively.len()) == Some(&frames) {
                lively.push(NumberedFrame { number: frames, frame: frame.clone() });
            }
            if record.unseen.get(unseen.len()) == Some(&frames) {
                unseen.push(NumberedFrame { number: frames, frame: frame.clone() });
            }
            if let Some(next) = record.keyframes.get(keyframes.len()).filter(|next| next.number == frames) {
                let Some(keyframe) = next.with_frame(frame, stage) else { return Ok(None) };
                keyframes.push(keyframe);
            }
        }
        let is_whole = frames == record.frames
            && keyframes.len() == record.keyframes.len()
            && lively.len() == record.lively.len()
            && unseen.len() == record.unseen.len();
        let is_sound = record.bend.iter().all(|correction| correction.is_finite());
        let (named, clip_ends) = (record.named.clone(), record.clip_ends.clone());
        Ok((is_whole && is_sound).then_some(Self {
            keyframes,
            lively,
            unseen,
            clip_ends,
            named,
            frames,
            found: record.found,
            bend: record.bend,
        }))
    }
}

impl KeyframeRecord {
    fn of(keyframe: &Keyframe) -> Self {
        let Keyframe { number, motion, rates, features, .. } = keyframe;
        let feature = |f: &MatchedFeature| (f.surface, f.on_picture_m, f.pixel.into(), f.sigma_px);
        Self {
            number: *number,
            position_m: motion.pose.translation.into(),
            orientation_xyzw: motion.pose.rotation.coords.into(),
            velocity: motion.velocity.into(),
            angular_velocity: motion.angular_velocity.into(),
            rates: rates.map(|known| std::array::from_fn(|k| (known.means[k].into(), known.sigmas[k]))),
            features: features.iter().map(feature).collect(),
        }
    }

    fn with_frame(&self, frame: Frame, stage: &BodySpec) -> Option<Keyframe> {
        let rotation = Quaternion::from_vector(self.orientation_xyzw.into());
        let numbers = [&self.position_m, &self.velocity, &self.angular_velocity];
        let is_sound = (rotation.norm() - 1.0).abs() < NORM_TOLERANCE
            && numbers.into_iter().flatten().all(|n| n.is_finite())
            && self.rates.iter().flatten().all(|(mean, sigma)| mean.iter().all(|n| n.is_finite()) && sigma.is_finite() && *sigma > 0.0)
            && self.features.iter().all(|(surface, ..)| *surface < stage.surfaces.len());
        if !is_sound {
            return None;
        }
        // Not normalised again, which would change the last bit.
        let pose = Pose::new(UnitQuaternion::new_unchecked(rotation), self.position_m.into());
        let motion = Motion { velocity: self.velocity.into(), angular_velocity: self.angular_velocity.into(), ..Motion::still(pose) };
        let feature = |(surface, on_picture_m, pixel, sigma_px): &(usize, [f64; 2], [f64; 2], f64)| MatchedFeature {
            surface: *surface,
            on_picture_m: *on_picture_m,
            pixel: Vector2::from(*pixel),
            sigma_px: *sigma_px,
        };
        let rates = self.rates.map(|known| KnownRates { means: known.map(|(mean, _)| mean.into()), sigmas: known.map(|(_, sigma)| sigma) });
        Some(Keyframe { number: self.number, frame, motion, rates, features: self.features.iter().map(feature).collect() })
    }
}

/// Finds the stage in the frames of a clip, even if lens or layout differ from the config.
struct StageFinder {
    matcher: BodyTracker,
    pause: TrackingPause,
}

/// Skips tracking for a while after several frames were tracked in vain.
#[derive(Debug, Default)]
struct TrackingPause {
    /// Number of consecutive frames tracked in vain.
    in_vain: u32,
    /// Number of frames until the next one is tracked.
    left: u32,
}

impl TrackingPause {
    /// Advances to the next frame; returns whether to track it.
    fn tracks_next(&mut self) -> bool {
        let tracks = self.left == 0;
        self.left = self.left.saturating_sub(1);
        tracks
    }

    /// Records whether tracking a frame succeeded.
    fn take(&mut self, is_tracked: bool) {
        self.in_vain = if is_tracked { 0 } else { self.in_vain + 1 };
        if self.in_vain == TRACKED_IN_VAIN {
            *self = Self { in_vain: 0, left: UNTRACKED };
        }
    }
}

impl StageFinder {
    fn new(matcher: BodyTracker) -> Self {
        Self { matcher, pause: TrackingPause::default() }
    }

    /// Returns the camera's pose in a frame.
    fn pose(&mut self, frame: &Frame) -> Option<Pose<Body, Camera>> {
        self.tracked(frame).or_else(|| {
            // With a wrong lens or layout nothing may pass verification although the stage is
            // there.
            let quick = self.matcher.study().quickly_recognised_pose(&frame.image);
            quick.or_else(|| Some(self.matcher.study().recognised_pose(&frame.image)?.0))
        })
    }

    /// Returns the pose by tracking, if that is worth its time.
    fn tracked(&mut self, frame: &Frame) -> Option<Pose<Body, Camera>> {
        if !self.pause.tracks_next() {
            return None;
        }
        let verified = self.matcher.track_frame(frame).stage.verified;
        self.pause.take(verified.is_some());
        verified.map(|verified| verified.pose)
    }

    /// Returns the features of a stage matched in a frame.
    fn matched_features(&mut self, frame: &Frame, stage: &BodySpec) -> Vec<MatchedFeature> {
        let feature = |m: &SurfaceMatch| MatchedFeature {
            surface: m.surface as usize,
            on_picture_m: stage.surfaces[m.surface as usize].to_metres(m.artwork).into(),
            pixel: m.pixel,
            sigma_px: m.scale,
        };
        self.matcher.study().recognised_pose(&frame.image).map_or_else(Vec::new, |(_, matches)| matches.iter().map(feature).collect())
    }
}

/// Returns the uniform motion since the last pose, or none if that is too long ago.
pub(super) fn motion_since(before: Option<(Pose<Body, Camera>, Timestamp)>, pose: Pose<Body, Camera>, stamp: Timestamp) -> Motion {
    before
        .map(|(then, at)| (then, stamp.seconds_since(at)))
        .filter(|(_, dt_s)| *dt_s > 0.0 && *dt_s < MAX_GAP_S)
        .map_or(Motion::still(pose), |(then, dt_s)| Motion::between(&then, &pose, dt_s))
}

#[cfg(test)]
mod tests {
    use image::GrayImage;
    use nalgebra::Vector3;

    use super::*;
    use crate::survey::walked::synthetic;

    const FRAMES: usize = 9;

    fn clips() -> [Vec<Frame>; 2] {
        let frame = |n: u64| Frame::new(GrayImage::from_pixel(4, 3, image::Luma([n as u8])), Timestamp::from_ns(n as i64 * 7), n);
        [(0..5).map(frame).collect(), (0..4).map(frame).collect()]
    }

    /// Keyframes and a lively part from both clips.
    fn walk() -> Walk {
        let frames: Vec<Frame> = clips().into_iter().flatten().collect();
        let keyframe = |number: usize| {
            let x = number as f64 / 7.0;
            let pose = Pose::new(UnitQuaternion::from_euler_angles(x, -0.3, 0.1 * x), Vector3::new(x, -2.0, 1.0 / 3.0));
            let motion = Motion { velocity: Vector3::new(0.1, x, 0.3), angular_velocity: Vector3::new(x, 0.2, 0.0), ..Motion::still(pose) };
            let feature = MatchedFeature { surface: 0, on_picture_m: [x, 0.1], pixel: Vector2::new(1.0 / x, 2.0), sigma_px: 0.7 * x };
            let means = [motion.velocity, motion.angular_velocity * x, motion.velocity / x, motion.angular_velocity];
            let rates = (number > 1).then_some(KnownRates { means, sigmas: [0.1 * x, 0.3, x, 0.7 * x] });
            Keyframe { number, frame: frames[number - 1].clone(), motion, rates, features: vec![feature; number] }
        };
        let lively = [6, 7].map(|number| NumberedFrame { number, frame: frames[number - 1].clone() }).to_vec();
        Walk {
            keyframes: [1, 4, 6, 9].map(keyframe).to_vec(),
            lively,
            unseen: [3, 8].map(|number| NumberedFrame { number, frame: frames[number - 1].clone() }).to_vec(),
            clip_ends: vec![5, 9],
            named: vec![Some(8), None],
            frames: FRAMES,
            found: 8,
            bend: [0.0, 0.1, 1.0 / 3.0, 2.0, 1.0, 0.5, -1.0],
        }
    }

    fn recalled(record: &WalkRecord, clips: &[Vec<Frame>]) -> Option<Walk> {
        let stage = BodySpec::new("stage", synthetic::stage()[..1].to_vec());
        Walk::recall(record, clips.iter().map(|clip| clip.iter().cloned()), &stage, |_| (), &|| true).expect("it goes on")
    }

    #[test]
    fn three_failures_pause_tracking_for_a_second() {
        let tracked = |is_found: fn(usize) -> bool| {
            let mut pause = TrackingPause::default();
            let is_tracked = |frame: &usize| {
                let tracks = pause.tracks_next();
                if tracks {
                    pause.take(is_found(*frame));
                }
                tracks
            };
            (0..70).filter(is_tracked).collect::<Vec<_>>()
        };
        assert_eq!(tracked(|_| false), [0, 1, 2, 33, 34, 35, 66, 67, 68]);
        // Two consecutive lost frames do not cause a pause.
        assert_eq!(tracked(|frame| frame % 3 == 0), (0..70).collect::<Vec<_>>());
        assert_eq!(tracked(|frame| frame > 3), [0, 1, 2].into_iter().chain(33..70).collect::<Vec<_>>());
    }

    #[test]
    fn a_recorded_walk_reads_back_bit_for_bit() {
        let found = recalled(&walk().record(), &clips()).expect("the clips are its own");
        assert_eq!(found, walk());
        let pictures: Vec<(usize, u64)> = found.pictures().map(|(clip, frame)| (clip, frame.sequence)).collect();
        assert_eq!(pictures, [(0, 0), (0, 3), (1, 0), (1, 3), (0, 2), (1, 2)]);
        for (a, b) in found.keyframes.iter().zip(&walk().keyframes) {
            let bits = |k: &Keyframe| k.motion.pose.rotation.coords.map(f64::to_bits);
            assert_eq!(bits(a), bits(b));
        }
    }

    #[test]
    fn a_damaged_or_foreign_walk_record_is_ignored() {
        let record = walk().record();
        let [first, second] = clips();
        assert_eq!(recalled(&record, std::slice::from_ref(&first)), None);
        assert_eq!(recalled(&record, &[first.clone(), second.clone(), first.clone()]), None);
        let damaged = |damage: fn(&mut WalkRecord)| {
            let mut record = record.clone();
            damage(&mut record);
            recalled(&record, &clips())
        };
        assert_eq!(damaged(|r| r.keyframes[1].orientation_xyzw[3] *= 1.001), None);
        assert_eq!(damaged(|r| r.keyframes[2].velocity[0] = f64::NAN), None);
        assert_eq!(damaged(|r| r.keyframes[0].features[0].0 = 1), None);
        assert_eq!(damaged(|r| r.lively.push(10)), None);
        assert_eq!(damaged(|r| r.bend[3] = f32::INFINITY), None);
        assert!(damaged(|_| ()).is_some());
        let stage = BodySpec::new("stage", synthetic::stage()[..1].to_vec());
        assert_eq!(Walk::recall(&record, [first], &stage, |_| (), &|| false), Err(SurveyError::Interrupted));
    }
}
