//! Why a clip is not followed: what may be wrong is tried, and what then fits is named with the line to write instead.
//!
//! `picture` looks at the frames themselves and tries them mirrored, in negative and without the mask; `geometry` asks, by
//! `fit`, which lens and which shape of the picture would explain how it is seen, and where the other surfaces stand;
//! `corners` asks the same of a photograph's four corners alone; `plausible` says in words what no picture shows: sizes,
//! distances, speeds. Everything ends as a [`Finding`]. `trackability` rates each picture before the show.

mod corners;
mod finding;
mod fit;
mod geometry;
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
use crate::track::{BodySpec, Matcher, Reason, SurfaceView};
use crate::tracker::TrackerSetup;

/// Matches of a view that count as seeing the surface at all; fewer may be chance. Chosen, not tuned. Raised, small and distant surfaces go
/// unseen; lowered, chance is taken for a view.
const LEAST_MATCHES: usize = 12;
/// Patches of a surface that fit a pose where the surface is seen; fewer may fit by chance. Chosen, not tuned. Raised, small surfaces count
/// as unseen.
const LEAST_PATCHES: usize = 4;
/// Frames that a mend is tried on, at even steps. Chosen for time: each trial searches each of them. Raised, the verdict is surer and
/// slower.
const TRIED_FRAMES: usize = 8;

/// What is tried on the frames: a setup like the config's, and a way to ask it.
pub struct Trial {
    matcher: Matcher,
    stamp: Timestamp,
}

impl Trial {
    /// Prepares the pictures of a stage for a camera; the rest is as configured.
    pub fn new(camera: CameraModel, mask: Option<GrayImage>, stage: &BodySpec, setup: &TrackerSetup) -> Self {
        let (settings, store) = (setup.clone().as_trial().settings, setup.store.clone());
        let matcher = Matcher::new(camera, Shutter::default().into(), mask, &[stage], settings, ComputeClock::default(), store);
        Self { matcher, stamp: Timestamp::default() }
    }

    /// As configured.
    pub fn of(setup: &TrackerSetup) -> Self {
        Self::new(setup.camera, setup.mask.clone(), &setup.stage, setup)
    }

    /// The surfaces that are recognised in a frame, before any lens or size is asked.
    pub fn views(&mut self, image: &GrayImage) -> Vec<SurfaceView> {
        let mut views = self.matcher.recognise(image);
        views.retain(|v| v.matches.len() >= LEAST_MATCHES);
        views
    }

    /// Of some frames, how many have a verified pose, each by itself; and how many were asked.
    pub fn verified(&mut self, frames: &[Frame]) -> (usize, usize) {
        self.count(frames, |_| true)
    }

    /// As [`verified`](Self::verified), where patches of a surface fit the pose as well.
    pub fn fitted(&mut self, frames: &[Frame], surface: usize) -> (usize, usize) {
        self.count(frames, |matcher| matcher.fitting_patches(surface) >= LEAST_PATCHES)
    }

    fn count(&mut self, frames: &[Frame], is_so: impl Fn(&Matcher) -> bool) -> (usize, usize) {
        let step = frames.len().div_ceil(TRIED_FRAMES).max(1);
        let (mut counted, mut asked) = (0, 0);
        for frame in frames.iter().step_by(step) {
            // Stamps far apart: no frame knows of the one before.
            self.stamp = self.stamp.after_s(10.0);
            let sighting = self.matcher.look(&Frame { timestamp: self.stamp, ..frame.clone() });
            asked += 1;
            counted += usize::from(sighting.stage.reason.is_none_or(Reason::is_verified) && is_so(&self.matcher));
        }
        (counted, asked)
    }
}

/// Frames of a clip, and what tracking as configured made of it.
pub struct Shown<'a> {
    /// What it was tracked with.
    pub setup: &'a TrackerSetup,
    /// Some of its frames, spread over it.
    pub frames: &'a [Frame],
    /// Whether tracking went well.
    pub is_followed: bool,
    /// Whether aligned pixels, which tell more finely than features, have named what is a little off.
    pub is_explained: bool,
    /// The camera's way, by the poses.
    pub travel: &'a Travel,
    /// How the lens is configured, where it is a guess.
    pub guess: Option<LensGuess>,
}

/// What is wrong with a clip, by trying.
pub fn of_clip(shown: &Shown<'_>) -> Vec<Finding> {
    let Shown { setup, frames, is_followed, travel, .. } = *shown;
    let mut findings = picture::of_frames(frames, is_followed);
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
