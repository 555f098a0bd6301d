//! How a camera moved during a frame, from its poses in the two frames before and the two after.
//!
//! A walk sways: at 3 Hz and 30 frames per second, the mean rate between a frame's neighbours is
//! too small by 1/15. Two more poses (central differences of fourth order) reduce this to 1/200.
//! Its effect on the readout is part of the readout's sigma (`stage`).
//!
//! Poses from a wrong stage, lens or shutter jump from frame to frame, by centimetres if folds are
//! taken for flat, and their rates mislead the lens. The poses' distance from a smooth path
//! therefore sets the rates' sigma, and after the survey the clips are tracked again
//! ([`rates_in`]).

use nalgebra::Vector3;

use super::stage_model::distance_m;
use crate::frame::{Frame, Timestamp};
use crate::geometry::{Body, Camera, Pose};
use crate::track::{BodyTracker, KnownRates};
use crate::tracker::TrackerSetup;

/// Maximum relative deviation of the time steps between five frames from their mean. Raised,
/// dropped frames pass for even ones.
const MAX_JITTER: f64 = 0.1;
/// Maximum time between two frames, seconds: a camera's motion is not uniform for longer. Raised,
/// slow cameras yield wrong rates.
const MAX_STEP_S: f64 = 0.05;
/// The same for a map: its rates only predict how a rolling shutter shears a keyframe, and their
/// scatter is in their sigmas.
const MAX_MAP_STEP_S: f64 = 0.15;
/// Weights of the poses one and two frames away: in a first derivative with this sign after and the
/// opposite before, in a second derivative with this sign on both sides. Source: Abramowitz and
/// Stegun, *Handbook of Mathematical Functions*, table 25.2.
const FIRST: [f64; 2] = [2.0 / 3.0, -1.0 / 12.0];
const SECOND: [f64; 2] = [4.0 / 3.0, -1.0 / 12.0];
/// Scatter of the derivatives, in frames, for poses that scatter by 1: roots of the weights' sums
/// of squares.
const SCATTER: [f64; 2] = [0.95, 3.13];
/// Weights of a fourth difference, which vanishes on a smooth path, and its scatter.
const FOURTH: [f64; 5] = [1.0, -4.0, 6.0, -4.0, 1.0];
const FOURTH_SCATTER: f64 = 8.37;

/// How far poses may be trusted for rates, one sigma.
#[derive(Debug, Clone, Copy)]
struct Trust {
    /// As a fraction of the rate itself.
    own_share: f64,
    /// Scatter of the poses, radians.
    scatter: f64,
}

impl Trust {
    /// With lens, shutter and stage as configured, all of which may be wrong, and the rates with
    /// them. Raised, walks constrain the readout less; lowered, a fold's effect on the pose of a
    /// passing camera is taken for motion, and the lens compensates for it.
    const AS_CONFIGURED: Self = Self { own_share: 0.03, scatter: 1e-4 };
    /// As surveyed. Poses scattered by 0.03 mm at 3 m in a rendered walk. The share was lowered
    /// from 0.005 because of the result on a single clip (d-cloth-walk with 18 ms readout); it has
    /// yet to be checked on others. Raised, a lens is known less well; lowered, wrong poses
    /// mislead.
    const AS_SURVEYED: Self = Self { own_share: 0.002, scatter: 2e-5 };
}

/// The last poses of a clip, in consecutive frames.
#[derive(Debug)]
pub struct RecentPoses {
    poses: Vec<(usize, Pose<Body, Camera>, Timestamp)>,
    trust: Trust,
    max_step_s: f64,
}

impl RecentPoses {
    /// Creates the collector for a stage as configured.
    pub fn as_configured() -> Self {
        Self { poses: Vec::with_capacity(5), trust: Trust::AS_CONFIGURED, max_step_s: MAX_STEP_S }
    }

    /// Creates the collector for a map, which also takes slow cameras.
    pub fn for_map() -> Self {
        Self { max_step_s: MAX_MAP_STEP_S, ..Self::as_configured() }
    }

    /// Creates the collector for a surveyed stage.
    pub fn as_surveyed() -> Self {
        Self { trust: Trust::AS_SURVEYED, ..Self::as_configured() }
    }

    /// Adds the pose of a frame, given its number. Returns the number of the frame two before it
    /// and its rates, if the poses around determine them. `distance_m` is the distance to the
    /// stage.
    pub fn add(&mut self, number: usize, pose: Pose<Body, Camera>, stamp: Timestamp, distance_m: f64) -> Option<(usize, KnownRates)> {
        if self.poses.last().is_some_and(|(last, ..)| last + 1 != number) {
            self.poses.clear();
        }
        if self.poses.len() == 5 {
            self.poses.remove(0);
        }
        self.poses.push((number, pose, stamp));
        let poses: &[_; 5] = self.poses.as_slice().try_into().ok()?;
        let dt_s = poses[4].2.seconds_since(poses[0].2) / 4.0;
        let is_even = poses.windows(2).all(|pair| (pair[1].2.seconds_since(pair[0].2) / dt_s - 1.0).abs() < MAX_JITTER);
        if !(is_even && dt_s > 0.0 && dt_s < self.max_step_s) {
            return None;
        }
        let (middle, from, _) = &poses[2];
        let [shift, rotation] = [0, 1].map(|part| Derivatives::of(poses.each_ref().map(|(_, pose, _)| from.step_to(pose)[part]), dt_s));
        let [velocity, acceleration] = shift.with_sigmas(&self.trust, distance_m, dt_s);
        let [angular_velocity, angular_acceleration] = rotation.with_sigmas(&self.trust, 1.0, dt_s);
        let all = [velocity, angular_velocity, acceleration, angular_acceleration];
        Some((*middle, KnownRates { means: all.map(|(mean, _)| mean), sigmas: all.map(|(_, sigma)| sigma) }))
    }
}

/// First and second derivative of a vector, and its distance from a smooth path.
struct Derivatives {
    both: [Vector3<f64>; 2],
    scatter: f64,
}

impl Derivatives {
    /// Computes them from positions at even times, of which the third is the origin.
    fn of(places: [Vector3<f64>; 5], dt_s: f64) -> Self {
        let [far_back, back, _, on, far_on] = places;
        let first = ((on - back) * FIRST[0] + (far_on - far_back) * FIRST[1]) / dt_s;
        let second = ((on + back) * SECOND[0] + (far_on + far_back) * SECOND[1]) / dt_s.powi(2);
        let fourth: Vector3<f64> = places.iter().zip(FOURTH).map(|(place, weight)| place * weight).sum();
        Self { both: [first, second], scatter: fourth.norm() / FOURTH_SCATTER }
    }

    /// Returns each derivative with its sigma. `unit` converts radians to the positions' unit.
    fn with_sigmas(&self, trust: &Trust, unit: f64, dt_s: f64) -> [(Vector3<f64>, f64); 2] {
        let scatter = self.scatter.hypot(trust.scatter * unit);
        std::array::from_fn(|k| {
            let mean = self.both[k];
            (mean, (trust.own_share * mean.norm()).hypot(SCATTER[k] * scatter / dt_s.powi(k as i32 + 1)))
        })
    }
}

/// Measures how the camera moved in the frames of clips, with a surveyed stage: returns rates by
/// the frames' numbers, counted as in `Walk`. `progress` receives the number of each frame;
/// `goes_on` stops the work by returning false.
pub fn rates_in<C, F>(
    clips: C,
    setup: TrackerSetup,
    mut progress: impl FnMut(usize),
    goes_on: &(dyn Fn() -> bool + Sync),
) -> Vec<(usize, KnownRates)>
where
    C: IntoIterator<Item = F>,
    F: IntoIterator<Item = Frame>,
{
    let TrackerSetup { camera, shutter, mask, stage, settings, clock, store, .. } = setup.as_trial();
    let (mut rates, mut number) = (Vec::new(), 0);
    for clip in clips {
        let mut matcher =
            BodyTracker::new(camera, shutter.or_zero().into(), mask.clone(), &[&stage], settings.clone(), clock, store.clone());
        let mut recent = RecentPoses::as_surveyed();
        for frame in clip.into_iter().take_while(|_| goes_on()) {
            number += 1;
            progress(number);
            let Some(pose) = matcher.track_frame(&frame).stage.verified.map(|verified| verified.pose) else { continue };
            rates.extend(recent.add(number, pose, frame.timestamp, distance_m(&stage.surfaces, &pose)));
        }
    }
    rates
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;

    /// A camera that sways by 8 mm and half a degree at 3 Hz.
    fn swaying(t: f64) -> Pose<Body, Camera> {
        let phase = 6.0 * std::f64::consts::PI * t;
        Pose::new(
            UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.009 * phase.cos(), 0.0)),
            Vector3::new(0.008 * phase.sin(), 0.1 * t, -3.0),
        )
    }

    #[test]
    fn camera_rates_of_a_sway_are_accurate() {
        let mut poses = RecentPoses::as_configured();
        let mut rated = 0;
        for n in 0..40 {
            let t = n as f64 / 30.0;
            let Some((number, rates)) = poses.add(n, swaying(t), Timestamp::from_seconds(t), 3.0) else {
                assert!(n < 4);
                continue;
            };
            assert_eq!(number, n - 2);
            let phase = 6.0 * std::f64::consts::PI * number as f64 / 30.0;
            let rate = 6.0 * std::f64::consts::PI;
            let real = [
                Vector3::new(0.008 * rate * phase.cos(), 0.1, 0.0),
                Vector3::new(0.0, -0.009 * rate * phase.sin(), 0.0),
                Vector3::new(-0.008 * rate.powi(2) * phase.sin(), 0.0, 0.0),
                Vector3::new(0.0, -0.009 * rate.powi(2) * phase.cos(), 0.0),
            ];
            for (k, most) in [0.008 * rate, 0.009 * rate, 0.008 * rate.powi(2), 0.009 * rate.powi(2)].into_iter().enumerate() {
                let off = (rates.means[k] - real[k]).norm();
                assert!(off < 0.006 * most && off < 2.0 * rates.sigmas[k], "{k}: {off} {rates:?}");
            }
            rated += 1;
        }
        assert_eq!(rated, 36);
    }

    #[test]
    fn rate_sigmas_cover_jumping_poses() {
        let steady = |t: f64| Pose::<Body, Camera>::new(UnitQuaternion::identity(), Vector3::new(0.7 * t, 0.0, -3.0));
        // One wrong pose, and a path that is offset from one pose on.
        for (from, to) in (0..5).flat_map(|from| [(from, from + 1), (from, 5)]) {
            let mut poses = RecentPoses::as_surveyed();
            let seen = |n: usize| {
                let pose = steady(n as f64 / 30.0);
                let off = if (from..to).contains(&n) { 0.02 } else { 0.0 };
                Pose::new(pose.rotation, pose.translation + Vector3::new(0.0, off, 0.0))
            };
            let rated = (0..5).filter_map(|n| poses.add(n, seen(n), Timestamp::from_seconds(n as f64 / 30.0), 3.0)).last();
            let KnownRates { means, sigmas } = rated.unwrap().1;
            let off = [(means[0] - Vector3::x() * 0.7).norm() / sigmas[0], means[2].norm() / sigmas[2]];
            assert!(off.into_iter().all(|off| off < 2.0), "{from} {to}: {off:?}");
        }
    }

    #[test]
    fn gaps_dropped_frames_and_slow_cameras_yield_no_rates() {
        let rated = |frames: &[(usize, f64)]| {
            let mut poses = RecentPoses::as_configured();
            frames.iter().filter_map(|(n, t)| poses.add(*n, swaying(*t), Timestamp::from_seconds(*t), 3.0)).count()
        };
        let even: Vec<(usize, f64)> = (0..5).map(|n| (n, n as f64 / 30.0)).collect();
        assert_eq!(rated(&even), 1);
        assert_eq!(rated(&even.iter().map(|(n, t)| (n + n / 4, *t)).collect::<Vec<_>>()), 0);
        assert_eq!(rated(&even.iter().map(|(n, t)| (*n, t + 0.01 * (n / 3) as f64)).collect::<Vec<_>>()), 0);
        assert_eq!(rated(&even.iter().map(|(n, t)| (*n, 3.0 * t)).collect::<Vec<_>>()), 0);
    }
}
