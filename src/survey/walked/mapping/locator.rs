//! Locates keyframes by some surfaces alone, from where the adjustment has them.

use super::super::keyframes::Keyframe;
use crate::camera::Shutter;
use crate::geometry::{Body, Camera, Pose};
use crate::track::{BodySpec, BodyTracker};
use crate::tracker::TrackerSetup;

/// One sigma of an adjusted pose: of the rotation, radians, and of the position, as a share of the
/// distance. Raised, aligning the surfaces alone takes longer; lowered, a wrong adjustment stays.
const START_SIGMA: f64 = 0.003;
/// One sigma of a keyframe's rates as the whole set tells them: radians per second, and metres per
/// second as a share of the distance. Raised, a small surface decides on the motion instead.
const RATE_SIGMA: f64 = 0.01;

/// A tracker of some surfaces.
pub struct Locator {
    tracker: BodyTracker,
    shutter: Shutter,
    distance_m: f64,
}

impl Locator {
    /// Prepares the tracker of a stage at a distance.
    pub fn new(setup: &TrackerSetup, stage: &BodySpec, distance_m: f64) -> Self {
        let TrackerSetup { camera, shutter, mask, settings, clock, store, .. } = setup.clone().as_trial();
        let shutter = shutter.or_zero();
        Self { tracker: BodyTracker::new(camera, shutter.into(), mask, &[stage], settings, clock, store), shutter, distance_m }
    }

    /// Returns the pose of a keyframe; `None` if it does not show the surfaces.
    pub fn pose(&mut self, keyframe: &Keyframe) -> Option<Pose<Body, Camera>> {
        let mut study = self.tracker.study();
        let [shift_m, rotation] = [START_SIGMA * self.distance_m, START_SIGMA];
        // A rolling shutter shears what a small surface shows; the whole set tells the motion.
        let found = if self.shutter.readout_s == 0.0 {
            study.try_start(&keyframe.frame, &keyframe.motion.pose, shift_m, rotation)
        } else {
            study.try_moving_start(&keyframe.frame, &keyframe.motion, [shift_m, rotation], [RATE_SIGMA * self.distance_m, RATE_SIGMA])
        }?;
        found.is_credible(false).then_some(found.pose)
    }
}
