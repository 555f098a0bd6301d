//! The start of a map without a configured surface: two frames that show much of the set from
//! different places, and the frames around them, up to scale.

use std::collections::BTreeSet;

use nalgebra::Vector3;
use rayon::prelude::*;

use super::bundle::{Cloud, CloudPoint};
use super::growth::{Lens, Shot, posed};
use super::tracks::{Recognition, Sighting};
use crate::camera::Pixel;
use crate::geometry::distances::squared_sampson;
use crate::geometry::essential::essential_candidates;
use crate::geometry::essential_decomposition::motion_by_cheirality;
use crate::geometry::motion_refinement::refine_motion;
use crate::geometry::relative_pose::{RayPair, TwoViewMotion};
use crate::geometry::robust_kernel::median;
use crate::geometry::triangulation::depths;
use crate::geometry::{Body, Camera, Pose};

/// Median distance of the points from the first camera, metres: while nothing is metric, the set is
/// as large as most are.
pub const DISTANCE_M: f64 = 4.0;
/// Number of frames, evenly over the walk, that pairs are made with. Raised, it takes longer.
const PLACES: usize = 10;
/// Minimum number of frames between the two of a pair; doubled up to half of the walk.
const FIRST_GAP: usize = 2;
/// Minimum number of features that look alike in a pair.
const MIN_ALIKE: usize = 60;
/// Minimum number of points of a pair. Raised, plain sets have no start; lowered, a wrong motion is
/// one.
const MIN_POINTS: usize = 40;
/// Maximum distance of a feature from its epipolar line, pixels.
const MAX_OFF_PX: f64 = 2.0;
/// Number of samples of five features.
const SAMPLES: usize = 200;
/// Number of motions that are looked at: a flat scene allows two.
const MOTIONS: usize = 3;
/// Steps of a motion's refinement.
const REFINING_STEPS: usize = 30;
/// Minimum angle between the rays of a point, and the angle beyond which more is no better,
/// radians.
const MIN_ANGLE: f64 = 0.03;
const ENOUGH_ANGLE: f64 = 0.2;
/// Seed of the samples: the result is the same every time.
const SEED: u64 = 0x7365_6564;

/// Two frames with the points that they share.
struct Pair {
    frames: [usize; 2],
    motion: TwoViewMotion,
    /// Features of both frames, and the point in the first camera's axes, in baselines.
    points: Vec<([usize; 2], Vector3<f64>)>,
    /// The sum of the points' angles.
    score: f64,
}

/// Returns frames with poses in the first one's frame, the two that fix it first. `None` if no two
/// frames show enough of the set from different places, or the work was stopped.
pub fn seed(
    shots: &[Shot<'_>],
    lens: &Lens<'_>,
    recognition: &mut Recognition,
    goes_on: &(dyn Fn() -> bool + Sync),
) -> Option<Vec<(usize, Pose<Body, Camera>)>> {
    let pairs: Vec<(usize, usize)> = tried(shots.len()).into_iter().collect();
    recognition.compare(pairs.iter().copied(), goes_on)?;
    let made = {
        let recognition = &*recognition;
        pairs.par_iter().map(|pair| goes_on().then(|| Pair::of(*pair, recognition, lens)).flatten()).collect::<Vec<_>>()
    };
    // The first of equally good ones.
    let best = made.into_iter().flatten().reduce(|best, next| if next.score > best.score { next } else { best })?;
    tracing::debug!(frames = ?best.frames, points = best.points.len(), score = best.score, "seed");
    let (poses, cloud) = best.start()?;
    let between: Vec<usize> = (0..shots.len()).filter(|k| !best.frames.contains(k)).collect();
    let around = posed(&cloud, &best.frames, &between, lens, recognition, goes_on)?;
    (!around.is_empty()).then(|| best.frames.into_iter().zip(poses).chain(around).collect())
}

/// Returns the pairs that are tried, the smaller index first.
fn tried(count: usize) -> BTreeSet<(usize, usize)> {
    let firsts = (0..PLACES).map(|n| n * count / PLACES);
    let gaps = || std::iter::successors(Some(FIRST_GAP), |gap| Some(2 * gap)).take_while(move |gap| *gap <= count / 2);
    firsts.flat_map(|a| gaps().map(move |gap| (a, a + gap))).filter(|(_, b)| *b < count).collect()
}

impl Pair {
    fn of((a, b): (usize, usize), recognition: &Recognition, lens: &Lens<'_>) -> Option<Self> {
        let ray = |frame: usize, feature: usize| Some(lens.camera.unproject(Pixel(recognition.place(frame, feature).0))?.0);
        let alike: Vec<([usize; 2], RayPair)> =
            recognition.alike(a, b).filter_map(|[m, n]| Some(([m, n], RayPair { first: ray(a, m)?, second: ray(b, n)? }))).collect();
        if alike.len() < MIN_ALIKE {
            return None;
        }
        let rays: Vec<RayPair> = alike.iter().map(|(_, pair)| *pair).collect();
        let most = MAX_OFF_PX / lens.camera.intrinsics().fx;
        let made = |e| {
            let agreeing: Vec<RayPair> = rays.iter().filter(|pair| squared_sampson(&e, pair) < most * most).copied().collect();
            let (start, _) = motion_by_cheirality(&e, &agreeing)?;
            let motion = refine_motion(&start, &rays, 0.5 * most, REFINING_STEPS);
            let (mut points, mut score) = (Vec::new(), 0.0);
            for (features, pair) in alike.iter().filter(|(_, pair)| squared_sampson(&motion.essential(), pair) < most * most) {
                let angle = (motion.rotation * pair.first.push(1.0)).angle(&pair.second.push(1.0));
                let Some((depth, _)) = depths(&motion, pair).filter(|(near, far)| *near > 0.0 && *far > 0.0) else { continue };
                if angle >= MIN_ANGLE {
                    points.push((*features, pair.first.push(1.0) * depth));
                    score += angle.min(ENOUGH_ANGLE);
                }
            }
            (points.len() >= MIN_POINTS).then_some(Self { frames: [a, b], motion, points, score })
        };
        let motions = essential_candidates(&rays, most, SAMPLES, MOTIONS, SEED);
        motions.into_iter().filter_map(made).reduce(|best, next| if next.score > best.score { next } else { best })
    }

    /// Returns the poses of the two frames and their points, with the set at [`DISTANCE_M`].
    fn start(&self) -> Option<([Pose<Body, Camera>; 2], Cloud)> {
        let mut depths: Vec<f64> = self.points.iter().map(|(_, point)| point.norm()).collect();
        let baseline_m = DISTANCE_M / median(&mut depths)?;
        let second: Pose<Camera, Body> = Pose::new(self.motion.rotation, self.motion.direction * baseline_m);
        let poses = [Pose::identity(), second.inverse()];
        let sighting = |view: usize, feature: usize| Sighting { view, feature, pixel: Default::default(), sigma_px: 1.0 };
        let point = |(features, place): &([usize; 2], Vector3<f64>)| CloudPoint {
            place: place * baseline_m,
            sightings: vec![sighting(0, features[0]), sighting(1, features[1])],
        };
        let rates = vec![[Vector3::zeros(); 2]; poses.len()];
        Some((poses, Cloud { poses: poses.to_vec(), rates, points: self.points.iter().map(point).collect(), scale: 1.0 }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_are_spread_over_the_walk_and_inside_it() {
        let pairs = tried(100);
        assert!(pairs.iter().all(|(a, b)| a < b && *b < 100));
        assert!(pairs.contains(&(0, 2)) && pairs.contains(&(0, 32)) && pairs.contains(&(90, 98)));
        assert!(tried(1).is_empty() && tried(0).is_empty());
        assert!(!tried(8).is_empty());
    }
}
