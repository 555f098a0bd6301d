//! How fast a camera went and turned in a frame, by where it was in the two frames before and the two after it.
//!
//! A walk sways: at 3 Hz and 30 frames a second the mean rate between the neighbours of a frame falls short by a fifteenth, and a readout that is found by it
//! comes out as much too long. Differences of five poses fall short by a three-hundredth. Source: Fornberg, *Generation of Finite Difference Formulas* (1988), table 1.

use nalgebra::Vector3;

use crate::frame::Timestamp;
use crate::geometry::{Body, Camera, Pose};
use crate::track::KnownRates;

/// How well five poses tell a rate, one sigma: a share of what they say beyond the neighbours alone, a share of the rate (lens and layout may be off), and what poses
/// scatter by, radians a second. Raised, the rows of a frame say how the camera moved, and no longer how they were read; lowered, a readout is believed that jerks
/// pretend.
const BEND_SHARE: f64 = 0.3;
const RATE_SHARE: f64 = 0.01;
const LEAST_SIGMA: f64 = 0.002;
/// The times between five frames differ by this share of their mean at most. Raised, dropped frames pass for even ones.
const LARGEST_JITTER: f64 = 0.1;
/// The time between two frames is no longer, seconds: a camera does not move evenly for as long. Raised, slow cameras tell rates that they did not have.
const LONGEST_STEP_S: f64 = 0.05;

/// The last poses of a clip, in frames that follow each other.
#[derive(Debug, Default)]
pub struct RecentPoses {
    poses: Vec<(usize, Pose<Body, Camera>, Timestamp)>,
}

impl RecentPoses {
    /// Adds the pose of a frame by its number, or none. Gives the number of the frame two before it and its rates, where five poses tell them. `distance_m`: to the stage.
    pub fn add(
        &mut self,
        number: usize,
        pose: Option<Pose<Body, Camera>>,
        stamp: Timestamp,
        distance_m: f64,
    ) -> Option<(usize, KnownRates)> {
        let Some(pose) = pose else {
            self.poses.clear();
            return None;
        };
        if self.poses.last().is_some_and(|(last, ..)| last + 1 != number) {
            self.poses.clear();
        }
        if self.poses.len() == 5 {
            self.poses.remove(0);
        }
        self.poses.push((number, pose, stamp));
        let five: &[_; 5] = self.poses.as_slice().try_into().ok()?;
        let dt_s = five[4].2.seconds_since(five[0].2) / 4.0;
        let is_even = five.windows(2).all(|two| (two[1].2.seconds_since(two[0].2) / dt_s - 1.0).abs() < LARGEST_JITTER);
        if !(is_even && dt_s > 0.0 && dt_s < LONGEST_STEP_S) {
            return None;
        }
        let (middle, from, _) = &five[2];
        let steps = five.each_ref().map(|(_, pose, _)| from.step_to(pose));
        let [velocity, turn_rate] = [0, 1].map(|k| Rate::of([0, 1, 3, 4].map(|n| steps[n][k]), dt_s));
        let means = [velocity.by_five, turn_rate.by_five];
        let sigmas = [velocity.sigma(LEAST_SIGMA * distance_m), turn_rate.sigma(LEAST_SIGMA)];
        Some((*middle, KnownRates { means, sigmas }))
    }
}

/// A rate by the neighbours alone, and by five poses.
struct Rate {
    by_neighbours: Vector3<f64>,
    by_five: Vector3<f64>,
}

impl Rate {
    /// Of the ways from a frame to the two before and the two after it, in order.
    fn of([a, b, d, e]: [Vector3<f64>; 4], dt_s: f64) -> Self {
        Self { by_neighbours: (d - b) / (2.0 * dt_s), by_five: ((d - b) * 8.0 - (e - a)) / (12.0 * dt_s) }
    }

    fn sigma(&self, least: f64) -> f64 {
        let bend = (self.by_five - self.by_neighbours).norm();
        (BEND_SHARE * bend).hypot(RATE_SHARE * self.by_five.norm()).hypot(least)
    }
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
    fn a_sway_is_told_to_a_hundredth() {
        let mut poses = RecentPoses::default();
        let mut told = 0;
        for n in 0..40 {
            let t = n as f64 / 30.0;
            let Some((number, rates)) = poses.add(n, Some(swaying(t)), Timestamp::from_seconds(t), 3.0) else {
                assert!(n < 4);
                continue;
            };
            assert_eq!(number, n - 2);
            let phase = 6.0 * std::f64::consts::PI * number as f64 / 30.0;
            let rate = 6.0 * std::f64::consts::PI;
            let real = [Vector3::new(0.008 * rate * phase.cos(), 0.1, 0.0), Vector3::new(0.0, -0.009 * rate * phase.sin(), 0.0)];
            for k in 0..2 {
                let off = (rates.means[k] - real[k]).norm();
                assert!(off < 0.01 * [0.008, 0.009][k] * rate && off < rates.sigmas[k], "{off} {rates:?}");
            }
            told += 1;
        }
        assert_eq!(told, 36);
    }

    #[test]
    fn a_gap_a_dropped_frame_and_a_slow_camera_tell_nothing() {
        let told = |frames: &[(usize, f64)]| {
            let mut poses = RecentPoses::default();
            frames.iter().filter_map(|(n, t)| poses.add(*n, Some(swaying(*t)), Timestamp::from_seconds(*t), 3.0)).count()
        };
        let even: Vec<(usize, f64)> = (0..5).map(|n| (n, n as f64 / 30.0)).collect();
        assert_eq!(told(&even), 1);
        assert_eq!(told(&even.iter().map(|(n, t)| (n + n / 3, *t)).collect::<Vec<_>>()), 0);
        assert_eq!(told(&even.iter().map(|(n, t)| (*n, t + 0.01 * (n / 3) as f64)).collect::<Vec<_>>()), 0);
        assert_eq!(told(&even.iter().map(|(n, t)| (*n, 3.0 * t)).collect::<Vec<_>>()), 0);
        let mut poses = RecentPoses::default();
        let all = even.iter().map(|(n, t)| poses.add(*n, (*n != 2).then(|| swaying(*t)), Timestamp::from_seconds(*t), 3.0));
        assert_eq!(all.flatten().count(), 0);
    }
}
