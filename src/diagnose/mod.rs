//! Diagnoses why a clip is not tracked: tries possible mistakes, and names the one that fits, with
//! the line to write instead.
//!
//! `picture` examines the frames themselves, and tries them mirrored, in negative and without the
//! mask. `geometry` uses `fit` to find the lens and shape of the picture that would explain how it
//! is seen, and the positions of the other surfaces. `corners` does the same from a photograph's
//! four corners alone. `lamps` finds walls of LEDs. `plausible` states what no picture shows:
//! sizes, distances, speeds. Every result is a [`Finding`]. `trackability` rates each picture
//! before the show.

mod corners;
mod finding;
mod fit;
mod geometry;
mod lamps;
mod picture;
mod plausible;
pub mod trackability;

use image::GrayImage;

pub use corners::{corners_begun_at_top_left, of_corners};
pub use finding::{Finding, Grade, known_to, written};
pub use plausible::{Travel, of_layout, of_lens, of_shutter};

use crate::camera::{CameraModel, LensGuess, Shutter};
use crate::compute_clock::ComputeClock;
use crate::frame::{Frame, Timestamp};
use crate::track::{BodySpec, BodyTracker, Reason, SurfaceView};
use crate::tracker::TrackerSetup;

/// Minimum number of matches in a view of a surface; fewer may be chance. Chosen, not tuned.
/// Raised, small and distant surfaces go unseen; lowered, chance is taken for a view.
const MIN_MATCHES: usize = 12;
/// Minimum number of a surface's patches that fit a pose for the surface to count as seen; fewer
/// may fit by chance. Chosen, not tuned. Raised, small surfaces count as unseen.
const MIN_PATCHES: usize = 4;
/// Number of evenly spaced frames on which a fix is tried. Chosen for time: each trial searches
/// each of them. Raised, the result is more certain and slower.
const TRIED_FRAMES: usize = 8;

/// A trial setup, similar to the config's, to be tested on the frames.
pub struct Trial {
    matcher: BodyTracker,
    stamp: Timestamp,
}

impl Trial {
    /// Prepares the pictures of a stage for a camera; the rest is as configured.
    pub fn new(camera: CameraModel, mask: Option<GrayImage>, stage: &BodySpec, setup: &TrackerSetup) -> Self {
        let (settings, store) = (setup.clone().as_trial().settings, setup.store.clone());
        let matcher = BodyTracker::new(camera, Shutter::default().into(), mask, &[stage], settings, ComputeClock::default(), store);
        Self { matcher, stamp: Timestamp::default() }
    }

    /// Prepares a trial of the config itself.
    pub fn of(setup: &TrackerSetup) -> Self {
        Self::new(setup.camera, setup.mask.clone(), &setup.stage, setup)
    }

    /// Recognises the surfaces in a frame, without using a lens or a size.
    pub fn views(&mut self, image: &GrayImage) -> Vec<SurfaceView> {
        let mut views = self.matcher.study().recognise(image);
        views.retain(|v| v.matches.len() >= MIN_MATCHES);
        views
    }

    /// Returns in how many frames a pose is verified, each frame by itself, and how many frames
    /// were tried.
    pub fn verified(&mut self, frames: &[Frame]) -> (usize, usize) {
        self.count(frames, |_| true)
    }

    /// Does the same as [`verified`](Self::verified), but also requires that patches of a surface
    /// fit the pose.
    pub fn fitted(&mut self, frames: &[Frame], surface: usize) -> (usize, usize) {
        self.count(frames, |matcher| matcher.study().fitting_patches(surface) >= MIN_PATCHES)
    }

    fn count(&mut self, frames: &[Frame], is_so: impl Fn(&mut BodyTracker) -> bool) -> (usize, usize) {
        let step = frames.len().div_ceil(TRIED_FRAMES).max(1);
        let (mut counted, mut asked) = (0, 0);
        for frame in frames.iter().step_by(step) {
            // Stamps far apart, so that no frame depends on the one before.
            self.stamp = self.stamp.after_s(10.0);
            let observation = self.matcher.track_frame(&Frame { timestamp: self.stamp, ..frame.clone() });
            asked += 1;
            counted += usize::from(observation.stage.reason.is_none_or(Reason::is_verified) && is_so(&mut self.matcher));
        }
        (counted, asked)
    }
}

/// Frames of a clip, and the result of tracking as configured.
pub struct Shown<'a> {
    /// The setup with which it was tracked.
    pub setup: &'a TrackerSetup,
    /// Some of its frames, spread over it.
    pub frames: &'a [Frame],
    /// Whether tracking succeeded.
    pub is_followed: bool,
    /// Whether aligned pixels, which are more precise than features, have already explained a small
    /// deviation.
    pub is_explained: bool,
    /// The camera's path, from the poses.
    pub travel: &'a Travel,
    /// How the lens is configured, if it is a guess.
    pub guess: Option<LensGuess>,
}

/// Diagnoses a clip by trials.
pub fn of_clip(shown: &Shown<'_>) -> Vec<Finding> {
    let Shown { setup, frames, is_followed, travel, .. } = *shown;
    let mut findings = picture::of_frames(frames, is_followed);
    findings.extend(lamps::of_walls(shown));
    let mut trial = Trial::of(setup);
    let views: Vec<Vec<SurfaceView>> = frames.iter().map(|f| trial.views(&f.image)).collect();
    let seen = views.iter().filter(|v| !v.is_empty()).count();
    if 2 * seen < frames.len() {
        findings.extend(picture::of_pictures(setup, frames, seen));
    }
    if seen > 0 {
        findings.extend(geometry::of_views(shown, &views));
        findings.extend(picture::never_recognised(setup, frames, &views, travel));
    }
    findings
}
