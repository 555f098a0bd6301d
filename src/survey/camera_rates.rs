//! How a camera moved in a frame, by where it was in the two frames before and after it.
//!
//! A walk sways: at 3 Hz and 30 frames a second the mean rate between the neighbours of a frame falls short by a fifteenth. Two more poses tell the bend of the bend
//! (central differences of fourth order), and leave a two hundredth. What that does to a readout is part of its sigma (`stage`).

use nalgebra::Vector3;

use crate::frame::Timestamp;
use crate::geometry::{Body, Camera, Pose};
use crate::track::KnownRates;

/// How well five poses tell a rate or an acceleration, one sigma: a share of what the outer two change (a camera that sways faster is not followed by them either), a
/// share of itself (lens and layout may be off), and what poses scatter by, radians. Raised, the rows of a frame say how the camera moved, and no longer how they were
/// read; lowered, a readout is believed that jerks pretend.
const CHANGE_SHARE: f64 = 0.3;
const OWN_SHARE: f64 = 0.03;
const POSE_SCATTER: f64 = 1e-4;
/// The times between five frames differ from their mean by this share at most. Raised, dropped frames pass for even ones.
const LARGEST_JITTER: f64 = 0.1;
/// The time between two frames is no longer, seconds: a camera does not move evenly for as long. Raised, slow cameras tell rates that they did not have.
const LONGEST_STEP_S: f64 = 0.05;
/// Weights of the poses one and two frames away in a first derivative, those after with this sign, those before with the other; and in a second one, all with this
/// sign. Source: Abramowitz and Stegun, *Handbook of Mathematical Functions*, table 25.2.
const FIRST: [f64; 2] = [2.0 / 3.0, -1.0 / 12.0];
const SECOND: [f64; 2] = [4.0 / 3.0, -1.0 / 12.0];
/// How far derivatives of poses scatter that scatter by 1 each, in frames.
const SCATTER: [f64; 2] = [0.95, 3.13];

/// The last poses of a clip, in frames that follow each other.
#[derive(Debug, Default)]
pub struct RecentPoses {
    poses: Vec<(usize, Pose<Body, Camera>, Timestamp)>,
}

impl RecentPoses {
    /// Adds the pose of a frame by its number. Gives the number of the frame two before it and its rates, where the poses around tell them. `distance_m`: to the stage.
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
        let is_even = poses.windows(2).all(|pair| (pair[1].2.seconds_since(pair[0].2) / dt_s - 1.0).abs() < LARGEST_JITTER);
        if !(is_even && dt_s > 0.0 && dt_s < LONGEST_STEP_S) {
            return None;
        }
        let (middle, from, _) = &poses[2];
        let [shift, turn] = [0, 1].map(|part| Derivatives::of(poses.each_ref().map(|(_, pose, _)| from.step_to(pose)[part]), dt_s));
        let [velocity, acceleration] = shift.with_sigmas(POSE_SCATTER * distance_m, dt_s);
        let [turn_rate, turn_acceleration] = turn.with_sigmas(POSE_SCATTER, dt_s);
        let all = [velocity, turn_rate, acceleration, turn_acceleration];
        Some((*middle, KnownRates { means: all.map(|(mean, _)| mean), sigmas: all.map(|(_, sigma)| sigma) }))
    }
}

/// First and second derivative of a vector, and how they differ from those by the nearest two of its places.
struct Derivatives([(Vector3<f64>, Vector3<f64>); 2]);

impl Derivatives {
    /// Of places at even times, the third of which is the origin.
    fn of(places: [Vector3<f64>; 5], dt_s: f64) -> Self {
        let [far_back, back, _, on, far_on] = places;
        let first = ((on - back) * FIRST[0] + (far_on - far_back) * FIRST[1]) / dt_s;
        let second = ((on + back) * SECOND[0] + (far_on + far_back) * SECOND[1]) / dt_s.powi(2);
        Self([(first, first - (on - back) / (2.0 * dt_s)), (second, second - (on + back) / dt_s.powi(2))])
    }

    /// Each with its sigma, where places scatter by `scatter`.
    fn with_sigmas(&self, scatter: f64, dt_s: f64) -> [(Vector3<f64>, f64); 2] {
        std::array::from_fn(|k| {
            let (mean, change) = &self.0[k];
            let least = SCATTER[k] * scatter / dt_s.powi(k as i32 + 1);
            (*mean, (CHANGE_SHARE * change.norm()).hypot(OWN_SHARE * mean.norm()).hypot(least))
        })
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
    fn a_sway_is_told_to_a_two_hundredth() {
        let mut poses = RecentPoses::default();
        let mut told = 0;
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
            told += 1;
        }
        assert_eq!(told, 36);
    }

    #[test]
    fn a_gap_a_dropped_frame_and_a_slow_camera_tell_nothing() {
        let told = |frames: &[(usize, f64)]| {
            let mut poses = RecentPoses::default();
            frames.iter().filter_map(|(n, t)| poses.add(*n, swaying(*t), Timestamp::from_seconds(*t), 3.0)).count()
        };
        let even: Vec<(usize, f64)> = (0..5).map(|n| (n, n as f64 / 30.0)).collect();
        assert_eq!(told(&even), 1);
        assert_eq!(told(&even.iter().map(|(n, t)| (n + n / 4, *t)).collect::<Vec<_>>()), 0);
        assert_eq!(told(&even.iter().map(|(n, t)| (*n, t + 0.01 * (n / 3) as f64)).collect::<Vec<_>>()), 0);
        assert_eq!(told(&even.iter().map(|(n, t)| (*n, 3.0 * t)).collect::<Vec<_>>()), 0);
    }
}
