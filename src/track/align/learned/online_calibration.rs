//! What is learnt slowly, over many frames: about the camera, the light, how the pictures are
//! shown, and how the body moves.
//!
//! A frame is solved with the estimates as they are, and collects what it would teach them
//! ([`Updates`]). They learn it only when the frame's pose is accepted: a frame that shows
//! something else has no information about the camera or the light.

use super::camera_curve::{CurveSums, LearntCurve};
use super::clue::Clue;
use super::exposure::UnknownExposure;
use super::exposure_watch::ExposureWatch;
use super::gradient_gain::{ChangeSums, GradientGain};
use super::light::RememberedLight;
use super::noise::{CameraNoise, NoiseSums};
use crate::camera::Shutter;
use crate::light::CameraCurve;
use crate::motion::UniformMotion;
use crate::track::align::tuning::TUNING;
use crate::track::frame::frame_levels::FINEST;

/// What one body's alignment has learnt about the camera, the light and the motion.
#[derive(Debug, Clone)]
pub struct OnlineCalibration {
    /// The shutter, with the exposure as configured or learnt.
    pub shutter: Shutter,
    /// Follows an unknown exposure; `None` where it is configured.
    exposure: Option<UnknownExposure>,
    /// Compares a configured exposure with the frames' blur.
    exposure_watch: ExposureWatch,
    /// The camera's noise.
    pub noise: CameraNoise,
    /// The camera's curve; `None` where it is configured.
    pub curve: Option<LearntCurve>,
    /// The fraction of the sampled gradients that is real.
    pub gradient_gain: GradientGain,
    /// Variance added by the point spread, in the kernel's unit.
    pub psf_variance: f64,
    /// The light of the last accepted frame.
    pub light: RememberedLight,
    /// Whether predictions may use the enlarged copies of the pictures.
    pub is_enlarged: bool,
    /// Accepted frames since the last trial of `is_enlarged`.
    pub(in crate::track::align) since_trial: u32,
    /// The constant-velocity line through the last accepted poses.
    pub line: Option<UniformMotion>,
    /// Decaying maximum of the start error: how far the prediction was off, pixels of the frame.
    pub start_error_px: f64,
    /// Fraction of the tiles that took part in the last accepted frame.
    pub inlier_tile_ratio: f64,
}

/// What a frame would teach the estimates.
#[derive(Debug)]
pub struct Updates {
    /// Predicted and real change of the prediction by the steps of the last descent.
    pub changes: ChangeSums,
    /// Variance added by the point spread; `None` where the frame is blurred.
    pub psf_variance: Option<f64>,
    /// The clue of the blur on the exposure, and the length of the blur in pixels of the frame.
    pub exposure: Option<(Clue, f64)>,
    /// Sums of the squared residuals, where the frame is sharp and its pose conclusive.
    pub noise: Option<NoiseSums>,
    /// Sums of the residuals by grey, where a frame is asked for them.
    pub curve: Option<CurveSums>,
    /// The start error, pixels of the frame, and the fraction of the tiles that took part; `None`
    /// where nothing moved.
    pub start: Option<(f64, f64)>,
    /// The constant-velocity line through the last poses and this one.
    pub line: Option<UniformMotion>,
    /// Whether the enlarged copies of the pictures fit the frame better.
    pub is_enlarged: bool,
    /// Whether that was tried in this frame.
    pub has_tried: bool,
}

impl Updates {
    /// Returns the updates of a frame before it is solved: none.
    pub fn none(calibration: &OnlineCalibration) -> Self {
        Self {
            changes: ChangeSums::default(),
            psf_variance: None,
            exposure: None,
            noise: None,
            curve: None,
            start: None,
            line: None,
            is_enlarged: calibration.is_enlarged,
            has_tried: false,
        }
    }
}

impl OnlineCalibration {
    /// Returns the estimates before any frame. An exposure of 0 in `shutter` is unknown, and learnt
    /// from blurred frames.
    pub fn new(shutter: Shutter) -> Self {
        let is_known = shutter.exposure_s > 0.0;
        Self {
            shutter: Shutter { exposure_s: if is_known { shutter.exposure_s } else { TUNING.initial_exposure_s }, ..shutter },
            exposure: (!is_known).then(UnknownExposure::default),
            exposure_watch: ExposureWatch::default(),
            noise: CameraNoise::usual(FINEST, &CameraCurve::default()),
            curve: None,
            gradient_gain: GradientGain::default(),
            psf_variance: 0.0,
            light: RememberedLight::default(),
            is_enlarged: true,
            since_trial: TUNING.enlargement_trial_interval_frames - TUNING.first_enlargement_trial_frames,
            line: None,
            start_error_px: TUNING.initial_start_error_px,
            inlier_tile_ratio: 0.0,
        }
    }

    /// Sets the shutter and stops learning the exposure.
    pub fn fix_shutter(&mut self, shutter: Shutter) {
        self.exposure = None;
        self.shutter = shutter;
    }

    /// Returns the relative sigma of the exposure.
    pub fn exposure_sigma(&self) -> f64 {
        self.exposure.as_ref().map_or(TUNING.configured_exposure_sigma, UnknownExposure::sigma)
    }

    /// Starts from an exposure that an earlier session learnt, with one sigma, both in seconds; a
    /// configured exposure stays.
    pub fn take_learnt_exposure(&mut self, exposure_s: f64, sigma_s: f64) {
        if let Some(unknown) = &mut self.exposure {
            *unknown = UnknownExposure::known_to(sigma_s / exposure_s);
            self.shutter.exposure_s = exposure_s;
        }
    }

    /// Returns the exposure and one sigma, seconds, where it is learnt and frames have determined
    /// it.
    pub fn learnt_exposure(&self) -> Option<(f64, f64)> {
        let unknown = self.exposure.as_ref().filter(|unknown| unknown.is_learnt())?;
        Some((self.shutter.exposure_s, unknown.sigma() * self.shutter.exposure_s))
    }

    /// Returns the configured exposure and the one that fits, seconds, where the frames contradict
    /// the configured one.
    pub fn contradicted_exposure(&self) -> Option<[f64; 2]> {
        let configured_s = self.shutter.exposure_s;
        let ratio = self.exposure_watch.contradiction().filter(|_| self.exposure.is_none())?;
        Some([configured_s, ratio * configured_s])
    }

    /// Takes the exposure and the noise that another body of the same camera has learnt, each where
    /// that body knows it better.
    pub fn take_camera(&mut self, other: &Self) {
        if let (Some(own), Some(others)) = (&mut self.exposure, &other.exposure)
            && own.sigma() > others.sigma()
        {
            own.clone_from(others);
            self.shutter.exposure_s = other.shutter.exposure_s;
        }
        if self.noise.total_weight() < other.noise.total_weight() {
            self.noise.clone_from(&other.noise);
        }
    }

    /// Whether a trial of the enlarged pictures is due.
    pub fn is_trial_due(&self) -> bool {
        self.since_trial + 1 >= TUNING.enlargement_trial_interval_frames
    }

    /// Learns from a frame whose pose was accepted. `light`: the light it was solved in.
    pub fn learn(&mut self, updates: &Updates, light: &RememberedLight) {
        self.light.clone_from(light);
        self.line = updates.line;
        self.is_enlarged = updates.is_enlarged;
        self.gradient_gain.learn(&updates.changes);
        if let Some(shown) = updates.psf_variance {
            self.psf_variance += TUNING.psf_variance_learning_rate * (shown - self.psf_variance);
        }
        if let Some((clue, blur_px)) = updates.exposure {
            match &mut self.exposure {
                Some(unknown) => unknown.learn(&mut self.shutter, clue, blur_px),
                None => self.exposure_watch.take(clue, blur_px),
            }
        }
        if let Some(sums) = &updates.noise {
            self.noise.learn(sums);
        }
        if let Some(curve) = &mut self.curve {
            curve.learn(updates.curve.as_ref());
        }
        if let Some((start_error_px, inlier_tile_ratio)) = updates.start {
            self.start_error_px = start_error_px.max(TUNING.start_error_decay * self.start_error_px);
            self.inlier_tile_ratio = inlier_tile_ratio;
            self.since_trial = if updates.has_tried { 0 } else { self.since_trial + 1 };
        }
    }
}
