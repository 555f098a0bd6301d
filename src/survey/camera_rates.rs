//! How fast a camera went and turned in a frame, by where it was in the frames before and after it.
//!
//! A walk sways: at 3 Hz and 30 frames a second the mean rate between the neighbours of a frame falls short by a fifteenth. What that does to
//! a readout is part of its sigma (`stage`).

use crate::frame::Timestamp;
use crate::geometry::{Body, Camera, Pose};
use crate::track::KnownRates;

/// How well three poses tell a rate, one sigma: a share of half of what changes from the one step to the other (a camera that sways does not change evenly), a share
/// of the rate itself (lens and layout may be off), and what poses scatter by, radians a second. Raised, the rows of a frame say how the camera moved, and no longer
/// how they were read; lowered, a readout is believed that jerks pretend.
const BEND_SHARE: f64 = 0.3;
const RATE_SHARE: f64 = 0.03;
const LEAST_SIGMA: f64 = 0.002;
/// The times between three frames differ from their mean by this share at most. Raised, dropped frames pass for even ones.
const LARGEST_JITTER: f64 = 0.1;
/// The time between two frames is no longer, seconds: a camera does not move evenly for as long. Raised, slow cameras tell rates that they did not have.
const LONGEST_STEP_S: f64 = 0.05;

/// The last poses of a clip, in frames that follow each other.
#[derive(Debug, Default)]
pub struct RecentPoses {
    poses: Vec<(usize, Pose<Body, Camera>, Timestamp)>,
}

impl RecentPoses {
    /// Adds the pose of a frame by its number. Gives the number of the frame before it and its rates, where the poses around tell them. `distance_m`: to the stage.
    pub fn add(&mut self, number: usize, pose: Pose<Body, Camera>, stamp: Timestamp, distance_m: f64) -> Option<(usize, KnownRates)> {
        if self.poses.last().is_some_and(|(last, ..)| last + 1 != number) {
            self.poses.clear();
        }
        if self.poses.len() == 3 {
            self.poses.remove(0);
        }
        self.poses.push((number, pose, stamp));
        let [before, (middle, from, then), after]: &[_; 3] = self.poses.as_slice().try_into().ok()?;
        let dt_s = after.2.seconds_since(before.2) / 2.0;
        let is_even = (after.2.seconds_since(*then) / dt_s - 1.0).abs() < LARGEST_JITTER;
        if !(is_even && dt_s > 0.0 && dt_s < LONGEST_STEP_S) {
            return None;
        }
        let (back, on) = (from.step_to(&before.1), from.step_to(&after.1));
        let means = [0, 1].map(|k| (on[k] - back[k]) / (2.0 * dt_s));
        let sigma = |k: usize, least: f64| {
            let bend = (on[k] + back[k]) / (2.0 * dt_s);
            (BEND_SHARE * bend.norm()).hypot(RATE_SHARE * means[k].norm()).hypot(least)
        };
        Some((*middle, KnownRates { means, sigmas: [sigma(0, LEAST_SIGMA * distance_m), sigma(1, LEAST_SIGMA)] }))
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

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
    fn a_sway_is_told_to_a_fifteenth() {
        let mut poses = RecentPoses::default();
        let mut told = 0;
        for n in 0..40 {
            let t = n as f64 / 30.0;
            let Some((number, rates)) = poses.add(n, swaying(t), Timestamp::from_seconds(t), 3.0) else {
                assert!(n < 2);
                continue;
            };
            assert_eq!(number, n - 1);
            let phase = 6.0 * std::f64::consts::PI * number as f64 / 30.0;
            let rate = 6.0 * std::f64::consts::PI;
            let real = [Vector3::new(0.008 * rate * phase.cos(), 0.1, 0.0), Vector3::new(0.0, -0.009 * rate * phase.sin(), 0.0)];
            for k in 0..2 {
                let off = (rates.means[k] - real[k]).norm();
                assert!(off < 0.07 * [0.008, 0.009][k] * rate && off < 2.0 * rates.sigmas[k], "{off} {rates:?}");
            }
            told += 1;
        }
        assert_eq!(told, 38);
    }

    #[test]
    fn a_gap_a_dropped_frame_and_a_slow_camera_tell_nothing() {
        let told = |frames: &[(usize, f64)]| {
            let mut poses = RecentPoses::default();
            frames.iter().filter_map(|(n, t)| poses.add(*n, swaying(*t), Timestamp::from_seconds(*t), 3.0)).count()
        };
        let even: Vec<(usize, f64)> = (0..3).map(|n| (n, n as f64 / 30.0)).collect();
        assert_eq!(told(&even), 1);
        assert_eq!(told(&even.iter().map(|(n, t)| (n + n / 2, *t)).collect::<Vec<_>>()), 0);
        assert_eq!(told(&even.iter().map(|(n, t)| (*n, t + 0.01 * (n / 2) as f64)).collect::<Vec<_>>()), 0);
        assert_eq!(told(&even.iter().map(|(n, t)| (*n, 3.0 * t)).collect::<Vec<_>>()), 0);
    }
}
