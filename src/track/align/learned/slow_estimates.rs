//! What is learnt slowly, over many frames: of the camera, of the light, of how the pictures are shown, and of how the body moves.
//!
//! A frame is solved with the estimates as they stand, and collects what it would teach them ([`Lessons`]). They learn that only when its
//! pose is accepted: a frame that shows something else says nothing of the camera or the light.

use super::clue::Clue;
use super::exposure::{USUAL_EXPOSURE_S, UnknownExposure};
use super::exposure_watch::ExposureWatch;
use super::gradient_gain::{ChangeSums, GradientGain};
use super::light::RememberedLight;
use super::noise::{CameraNoise, NoiseSums};
use crate::camera::Shutter;
use crate::motion::UniformMotion;
use crate::track::frame::frame_levels::FINEST;

/// Share of the difference to a sharp frame's point spread that is taken over each frame: a memory of some ten frames. Raised, it follows
/// noise; lowered, a change of focus is learnt later.
const PSF_VARIANCE_SHARE: f64 = 0.2;
/// The decaying maximum of the start error keeps this share a frame. Raised, the search stays wide longer after a jump, and costs a level more.
const START_ERROR_KEPT: f64 = 0.8;
/// The decaying maximum of the start error at first, pixels of the frame: the basin of the coarsest level, from which the first frames so
/// begin. Raised, they do so for more frames; lowered, a pose from features may lie outside of the first level's basin and is solved twice.
const FIRST_START_ERROR_PX: f64 = 40.0;
/// One sigma of an exposure that was told, as a share of it. Chosen: drivers tell it in steps. Raised, the speed of a body that was just found is less sure.
const KNOWN_EXPOSURE_SIGMA: f64 = 0.03;
/// Accepted frames between trials of how the picture was enlarged, and before the first, so that light and noise are known. A trial costs
/// about 1 ms in one frame of 32. Raised, a wrong way stays longer; lowered, frames cost more.
pub(in crate::track::align) const TRIAL_FRAMES: u32 = 32;
pub(in crate::track::align) const FIRST_TRIAL: u32 = 3;

/// The slow estimates of one body's alignment.
#[derive(Debug, Clone)]
pub struct SlowEstimates {
    /// The shutter, with the exposure as known or learnt.
    pub shutter: Shutter,
    /// Follows an unknown exposure; `None` where it is known.
    exposure: Option<UnknownExposure>,
    /// What frames say of a configured exposure.
    exposure_watch: ExposureWatch,
    /// The camera's noise.
    pub noise: CameraNoise,
    /// How much of the slopes over samples is real.
    pub gradient_gain: GradientGain,
    /// Variance of the point spread function, in the kernel's unit.
    pub psf_variance: f64,
    /// The light of the last accepted frame.
    pub light: RememberedLight,
    /// Whether the enlarged copies of the pictures are what the frame shows.
    pub is_enlarged: bool,
    /// Accepted frames since that was tried.
    pub(in crate::track::align) since_trial: u32,
    /// The line that the last accepted poses lie on.
    pub line: Option<UniformMotion>,
    /// Decaying maximum of the start error, pixels of the frame.
    pub start_error_px: f64,
    /// Share of the tiles that took part in the last accepted frame.
    pub open_share: f64,
}

/// What a frame would teach.
#[derive(Debug)]
pub struct Lessons {
    /// What the last descent's steps changed in the prediction, and what they should have changed.
    pub changes: ChangeSums,
    /// Variance of the point spread function; `None` where the frame is blurred.
    pub psf_variance: Option<f64>,
    /// What the blur says of the exposure, and its length in pixels of the frame.
    pub exposure: Option<(Clue, f64)>,
    /// Squared residuals, where the frame is sharp and leaves no doubt.
    pub noise: Option<NoiseSums>,
    /// The start error, pixels of the frame, and the share of the tiles that took part; `None` where nothing moved.
    pub start: Option<(f64, f64)>,
    /// The line of the last poses, with this one.
    pub line: Option<UniformMotion>,
    /// Whether the enlarged copies of the pictures are what the frame shows.
    pub is_enlarged: bool,
    /// Whether that was tried.
    pub has_tried: bool,
}

impl Lessons {
    /// Before a frame is solved.
    pub fn none(slow: &SlowEstimates) -> Self {
        Self {
            changes: ChangeSums::default(),
            psf_variance: None,
            exposure: None,
            noise: None,
            start: None,
            line: None,
            is_enlarged: slow.is_enlarged,
            has_tried: false,
        }
    }
}

impl SlowEstimates {
    /// Nothing learnt yet. An exposure of 0 in `shutter` is learnt from blurred frames.
    pub fn new(shutter: Shutter) -> Self {
        let is_known = shutter.exposure_s > 0.0;
        Self {
            shutter: Shutter { exposure_s: if is_known { shutter.exposure_s } else { USUAL_EXPOSURE_S }, ..shutter },
            exposure: (!is_known).then(UnknownExposure::default),
            exposure_watch: ExposureWatch::default(),
            noise: CameraNoise::usual(FINEST),
            gradient_gain: GradientGain::default(),
            psf_variance: 0.0,
            light: RememberedLight::default(),
            is_enlarged: true,
            since_trial: TRIAL_FRAMES - FIRST_TRIAL,
            line: None,
            start_error_px: FIRST_START_ERROR_PX,
            open_share: 0.0,
        }
    }

    /// Takes the shutter as given from now on.
    pub fn fix_shutter(&mut self, shutter: Shutter) {
        self.exposure = None;
        self.shutter = shutter;
    }

    /// One sigma of the exposure, as a share of it.
    pub fn exposure_sigma(&self) -> f64 {
        self.exposure.as_ref().map_or(KNOWN_EXPOSURE_SIGMA, UnknownExposure::sigma)
    }

    /// Begins with an exposure that an earlier session learnt, known to one sigma, seconds; a configured one stays.
    pub fn take_learnt_exposure(&mut self, exposure_s: f64, sigma_s: f64) {
        if let Some(unknown) = &mut self.exposure {
            *unknown = UnknownExposure::known_to(sigma_s / exposure_s);
            self.shutter.exposure_s = exposure_s;
        }
    }

    /// The exposure and one sigma, seconds, where it is learnt and frames told of it.
    pub fn learnt_exposure(&self) -> Option<(f64, f64)> {
        let unknown = self.exposure.as_ref().filter(|unknown| unknown.is_told())?;
        Some((self.shutter.exposure_s, unknown.sigma() * self.shutter.exposure_s))
    }

    /// The configured exposure and the one that fits, seconds, where frames contradict it.
    pub fn contradicted_exposure(&self) -> Option<[f64; 2]> {
        let configured_s = self.shutter.exposure_s;
        let ratio = self.exposure_watch.contradiction().filter(|_| self.exposure.is_none())?;
        Some([configured_s, ratio * configured_s])
    }

    /// Takes what another body has learnt of the camera that both are seen by, where it knows that better: the exposure, and the noise.
    pub fn take_camera(&mut self, other: &Self) {
        if let (Some(own), Some(others)) = (&mut self.exposure, &other.exposure)
            && own.sigma() > others.sigma()
        {
            own.clone_from(others);
            self.shutter.exposure_s = other.shutter.exposure_s;
        }
        if self.noise.told() < other.noise.told() {
            self.noise.clone_from(&other.noise);
        }
    }

    /// Whether it is time to try how the pictures were enlarged.
    pub fn is_trial_due(&self) -> bool {
        self.since_trial + 1 >= TRIAL_FRAMES
    }

    /// Learns what a frame taught whose pose was accepted. `light`: that it was solved in.
    pub fn learn(&mut self, lessons: &Lessons, light: &RememberedLight) {
        self.light.clone_from(light);
        self.line = lessons.line;
        self.is_enlarged = lessons.is_enlarged;
        self.gradient_gain.learn(&lessons.changes);
        if let Some(shown) = lessons.psf_variance {
            self.psf_variance += PSF_VARIANCE_SHARE * (shown - self.psf_variance);
        }
        if let Some((clue, blur_px)) = lessons.exposure {
            match &mut self.exposure {
                Some(unknown) => unknown.learn(&mut self.shutter, clue, blur_px),
                None => self.exposure_watch.take(clue, blur_px),
            }
        }
        if let Some(sums) = &lessons.noise {
            self.noise.learn(sums);
        }
        if let Some((start_error_px, open_share)) = lessons.start {
            self.start_error_px = start_error_px.max(START_ERROR_KEPT * self.start_error_px);
            self.open_share = open_share;
            self.since_trial = if lessons.has_tried { 0 } else { self.since_trial + 1 };
        }
    }
}
