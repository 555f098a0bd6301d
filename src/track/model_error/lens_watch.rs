//! Withholds poses while another focal length than the calibrated one explains the frames. A
//! changed focal length is never used.
//!
//! A single such frame is withheld; from the second one on every pose is, until frames show the
//! calibrated focal length again. Views that say nothing about it (a flat stage head-on) change
//! nothing: what was withheld stays withheld.
//!
//! If the stage does not fit its model (cloth in folds), its own pattern hides much of a zoom, and
//! no single frame is clear. That pattern, however, stays much the same from frame to frame. So the
//! mean estimate of the focal length is remembered, and a frame that clearly deviates from it
//! counts as well. A frame that deviates less is reported with the deviation in its covariance. An
//! uncalibrated lens gives another estimate in each view and contradicts its calibration from the
//! first frame: then a deviation must be clearer still.

use crate::track::model_error::tuning::TUNING;
use tracing::{info, warn};

use super::focal_clue::FocalClue;

/// What feature matches say about the focal length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MatchedFocal {
    /// Another one fits clearly better than the calibrated one: logarithm of their ratio.
    Changed(f64),
    /// Another one would fit better (logarithm of the ratio), but so would skewed pictures or
    /// displaced surfaces: no evidence against the lens, but a doubt.
    Contested(f64),
    /// The calibrated one fits clearly better than the suspected one.
    Calibrated,
    /// Nothing: too few matches, a view from head-on, or another misfit.
    Unclear,
}

/// The mean estimate of the log ratio of the focal length to the calibrated one: a mean that
/// forgets.
#[derive(Debug, Default, Clone, Copy)]
struct FocalMean {
    weights: f64,
    sum: f64,
    /// Number of frames, forgotten at the same rate.
    count: f64,
    frames: u32,
}

impl FocalMean {
    /// Adds a frame. `share`: its weight, 0 to 1.
    fn add(&mut self, change: f64, sigma: f64, share: f64) {
        let weight = share * sigma.max(TUNING.min_frame_focal_sigma).powi(-2);
        self.weights = TUNING.focal_mean_memory * self.weights + weight;
        self.sum = TUNING.focal_mean_memory * self.sum + weight * change;
        self.count = TUNING.focal_mean_memory * self.count + share;
        self.frames += 1;
    }

    /// Whether it contradicts the calibration.
    fn is_uncalibrated(&self) -> bool {
        self.mean().is_some_and(|(mean, sigma)| mean.abs() > TUNING.uncalibrated_sigmas * sigma * self.count.sqrt())
    }

    /// Returns the value and its sigma, once there are enough frames.
    fn mean(&self) -> Option<(f64, f64)> {
        (self.frames >= TUNING.min_focal_mean_frames).then(|| (self.sum / self.weights, self.weights.powf(-0.5)))
    }
}

/// How a frame's pose may be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LensState {
    /// Nothing contradicts the lens.
    Fits,
    /// This frame contradicts it and is withheld.
    Suspect,
    /// The lens was changed; every pose is withheld.
    Moved,
}

/// Remembers what frames said about the focal length.
#[derive(Debug, Default)]
pub struct LensWatch {
    is_moved: bool,
    /// Consecutive frames that contradict the current state.
    against: u32,
    focal_mean: FocalMean,
    /// Index of the body that the mean estimate is of.
    body: usize,
    /// Whether the lens counts as changed by comparison with the mean estimate rather than with
    /// the calibration.
    is_moved_by_mean: bool,
    /// Whether the mean estimate ever contradicted the calibration.
    is_uncalibrated: bool,
    /// Deviation of the last frame from the mean estimate, or its possible error if the frame is
    /// no evidence.
    deviation: Option<f64>,
    /// Size of the focal step that would explain a jump of the pose, until a frame contradicts it;
    /// 0 for none.
    step: f64,
    /// Logarithm of the ratio of the focal length that fits the matches to the calibrated one,
    /// until matches say otherwise.
    by_matches: Option<f64>,
    /// Whether that was logged in this session.
    has_warned: bool,
    /// Whether this is a trial, in which nothing is logged.
    is_trial: bool,
}

impl LensWatch {
    /// Creates the state before any frame. `is_trial`: log nothing.
    pub fn new(is_trial: bool) -> Self {
        Self { is_trial, ..Self::default() }
    }

    /// Whether poses are withheld.
    pub fn is_moved(&self) -> bool {
        self.is_moved
    }

    /// Whether the focal length must be estimated in every frame.
    pub fn needs_estimate(&self) -> bool {
        self.is_moved || self.step > 0.0 || self.by_matches.is_some()
    }

    /// Returns the log ratio of the focal length that fits the matches to the calibrated one.
    pub fn by_matches(&self) -> Option<f64> {
        self.by_matches
    }

    /// Whether a frame's tiles contradict the matches, so that matching again is worthwhile. Tiles
    /// alone do not decide: through a wrong lens few of them are aligned.
    pub fn contradicts_matches(&self, clue: &FocalClue) -> bool {
        self.by_matches.is_some_and(|change| self.contradicts(clue, change.abs()))
    }

    /// Takes the result of matching.
    pub fn update_by_matches(&mut self, focal: MatchedFocal) {
        match focal {
            MatchedFocal::Changed(change) => {
                if !self.is_trial && !std::mem::replace(&mut self.has_warned, true) {
                    let percent = 100.0 * (change.exp() - 1.0);
                    warn!(
                        "the matches do not fit the calibrated lens; a focal length {percent:+.0} % off fits them better: \
                         poses are reported with that uncertainty until frames decide; `stagepose check` tells more"
                    );
                }
                self.by_matches = Some(change);
            }
            MatchedFocal::Contested(change) => self.by_matches = Some(change),
            MatchedFocal::Calibrated => self.by_matches = None,
            MatchedFocal::Unclear => {}
        }
    }

    /// Returns the deviation of the last frame's log focal length from the mean estimate if it is
    /// clear, or how far it may be off.
    pub fn deviation(&self) -> Option<f64> {
        self.deviation
    }

    /// Says which body the next clue comes from: the mean estimate of one body does not apply to
    /// another.
    pub fn select_body(&mut self, body: usize) {
        if body != self.body && !self.is_moved {
            (self.focal_mean, self.body, self.is_uncalibrated) = (FocalMean::default(), body, false);
        }
    }

    /// Takes a frame's clue, if it has one. `step`: the focal step that would explain a jump of its
    /// pose; `is_seen`: whether the frame was examined; `doubt`: sigma of the log of the calibrated
    /// focal length.
    pub fn update(&mut self, clue: Option<&FocalClue>, step: Option<f64>, is_seen: bool, doubt: f64) -> LensState {
        self.update_step(clue, step);
        let doubted = self.by_matches.map_or(0.0, f64::abs).max(self.step);
        self.deviation = Some(doubted).filter(|size| *size > 0.0);
        let Some(clue) = clue else {
            // Examined, and nothing contradicts the lens: the sequence of contradicting frames
            // ends.
            if is_seen {
                self.against = 0;
                self.focal_mean.add(0.0, TUNING.fitting_frame_focal_sigma, 1.0);
            }
            return self.state(false);
        };
        let mean = self.focal_mean.mean();
        let deviation = mean.and_then(|(mean, sigma)| clue.deviation(mean, sigma));
        let likely = deviation.map(f64::abs).or(clue.possible_change(doubt)).unwrap_or(0.0);
        self.deviation = Some(likely.min(TUNING.max_focal_change).max(doubted)).filter(|size| *size > 0.0);
        self.is_uncalibrated |= self.focal_mean.is_uncalibrated();
        let is_uncalibrated = self.is_uncalibrated;
        let has_changed = mean.is_some_and(|(mean, sigma)| clue.has_changed(mean, sigma, doubt, is_uncalibrated));
        let agrees_with_mean = self.is_moved_by_mean && mean.is_some_and(|(mean, sigma)| clue.agrees_with_mean(mean, sigma));
        let is_against = if self.is_moved { clue.is_right(doubt) || agrees_with_mean } else { clue.is_off(doubt) || has_changed };
        // While the lens counts as changed, the mean estimate stays as it was before.
        if !self.is_moved && !is_against && doubted == 0.0 {
            self.focal_mean.add(clue.change, clue.sigma, if deviation.is_some() { TUNING.deviating_frame_weight } else { 1.0 });
        }
        self.against = if is_against { self.against + 1 } else { 0 };
        let needed = if self.is_moved { TUNING.frames_to_restored_lens } else { TUNING.frames_to_changed_lens };
        if self.against >= needed {
            (self.is_moved, self.against) = (!self.is_moved, 0);
            self.is_moved_by_mean = self.is_moved && has_changed && !clue.is_off(doubt);
            if !self.is_trial {
                self.log_change(clue.change);
            }
        }
        self.state(is_against)
    }

    /// Logs whether poses are withheld from now on; `change`: log ratio of the fitted focal length
    /// to the calibrated one.
    fn log_change(&self, change: f64) {
        let percent = 100.0 * (change.exp() - 1.0);
        if self.is_moved {
            warn!(
                "the focal length that fits the frames is {percent:+.1} % off the calibration's: poses are withheld; set the lens back, or calibrate it as it is"
            );
        } else {
            info!("the focal length is the calibration's again: poses are given");
        }
    }

    /// Remembers a step until a frame's estimate of the focal length contradicts it.
    fn update_step(&mut self, clue: Option<&FocalClue>, step: Option<f64>) {
        self.step = self.step.max(step.map_or(0.0, f64::abs));
        if clue.is_some_and(|clue| self.contradicts(clue, self.step)) {
            self.step = 0.0;
        }
    }

    /// Whether a frame's estimate is closer to no step than to one of this size.
    fn contradicts(&self, clue: &FocalClue, size: f64) -> bool {
        let mean = self.focal_mean.mean().map_or(0.0, |(mean, _)| mean);
        (clue.change - mean).abs() + TUNING.restored_focal_sigmas * clue.sigma < 0.5 * size
    }

    fn state(&self, is_against: bool) -> LensState {
        match (self.is_moved, is_against) {
            (true, _) => LensState::Moved,
            (false, true) if self.against > 0 => LensState::Suspect,
            _ => LensState::Fits,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn clue(change: f64) -> FocalClue {
        FocalClue { change, sigma: 0.0005, share: 0.9, is_contested: false }
    }

    #[test]
    fn one_bad_frame_is_suspect_and_two_mean_the_lens_moved() {
        use LensState::{Fits, Moved, Suspect};
        let mut watch = LensWatch::default();
        let states = [0.0, 0.02, 0.001, 0.02, 0.04, 0.002].map(|change| watch.update(Some(&clue(change)), None, true, 0.0));
        assert_eq!(states, [Fits, Suspect, Fits, Suspect, Moved, Moved]);
    }

    #[test]
    fn only_informative_frames_restore_the_lens() {
        use LensState::{Fits, Moved};
        let mut watch = LensWatch::default();
        assert_eq!([0.02, 0.03].map(|change| watch.update(Some(&clue(change)), None, true, 0.0))[1], Moved);
        let weak = FocalClue { change: 0.0, sigma: 0.01, share: 0.0, is_contested: false };
        assert!((0..50).all(|_| watch.update(Some(&weak), None, true, 0.0) == Moved && watch.update(None, None, false, 0.0) == Moved));
        let states = [0.001, 0.03, 0.001, 0.001, 0.001].map(|change| watch.update(Some(&clue(change)), None, true, 0.0));
        assert_eq!(states, [Moved, Moved, Moved, Moved, Fits]);
    }

    /// An estimate from folded cloth, varying slightly from frame to frame.
    fn folds(k: u32) -> FocalClue {
        FocalClue { change: 0.012 + 0.001 * f64::from(k % 3), sigma: 0.0035, share: 0.01, is_contested: false }
    }

    #[test]
    fn a_zoom_is_detected_despite_folds() {
        use LensState::{Fits, Moved, Suspect};
        let mut watch = LensWatch::default();
        assert!((0..40).all(|k| watch.update(Some(&folds(k)), None, true, 0.0) == Fits));
        let zoomed = |k: u32, by: f64| FocalClue { change: folds(k).change + by, share: 0.1, ..folds(k) };
        let states = [0.005, 0.02, 0.025, 0.03].map(|by| watch.update(Some(&zoomed(0, by)), None, true, 0.0));
        assert_eq!(states, [Fits, Suspect, Moved, Moved]);
        // A view from head-on has no information; from the side the folds give the same estimate as
        // before.
        let ahead = FocalClue { change: 0.01, sigma: 0.08, share: 0.01, is_contested: false };
        assert!((0..20).all(|_| watch.update(Some(&ahead), None, true, 0.0) == Moved));
        assert_eq!([0, 1, 2].map(|k| watch.update(Some(&folds(k)), None, true, 0.0)), [Moved, Moved, Fits]);
    }

    #[test]
    fn small_focal_deviations_are_reported_as_uncertainty() {
        let deviating = |of: FocalClue| FocalClue { change: of.change + 0.013, share: 0.1, ..of };
        let mut watch = LensWatch::default();
        assert!((0..40).all(|k| watch.update(Some(&folds(k)), None, true, 0.0) == LensState::Fits && watch.deviation().is_none()));
        assert_eq!(watch.update(Some(&deviating(folds(1))), None, true, 0.0), LensState::Fits);
        assert!(watch.deviation().is_some_and(|by| (0.01..0.015).contains(&by)), "{:?}", watch.deviation());
        assert_eq!(watch.update(Some(&folds(1)), None, true, 0.0), LensState::Fits);
        assert!(watch.deviation().is_none());
    }

    #[test]
    fn an_initially_wrong_lens_is_not_called_moved_in_a_new_view() {
        let guessed = |k: u32| FocalClue { change: 0.03 + 0.001 * f64::from(k % 3), sigma: 0.003, share: 0.2, is_contested: false };
        let mut watch = LensWatch::default();
        assert!((0..20).all(|k| watch.update(Some(&guessed(k)), None, true, 0.0) == LensState::Fits));
        let elsewhere = FocalClue { change: 0.055, sigma: 0.004, share: 0.4, is_contested: false };
        assert!((0..9).all(|_| watch.update(Some(&elsewhere), None, true, 0.0) == LensState::Fits));
        let zoomed = FocalClue { change: 0.1, sigma: 0.005, share: 0.4, is_contested: false };
        assert_eq!([0, 1].map(|_| watch.update(Some(&zoomed), None, true, 0.0)), [LensState::Suspect, LensState::Moved]);
    }

    #[test]
    fn edges_shifted_by_light_are_not_a_zoom_in_weak_views() {
        let mut watch = LensWatch::default();
        // A print of red things on the way to a blue gel, from ever closer to head-on.
        let gel = [(-0.006, 0.005), (-0.0087, 0.0059), (-0.0128, 0.0082), (-0.0186, 0.0099), (-0.0394, 0.0119), (-0.0591, 0.0177)];
        let blue = [(-0.13, 0.0266), (-0.192, 0.044), (-0.254, 0.0512), (-0.586, 0.171), (1.752, 0.491), (0.444, 0.16)];
        let state = |watch: &mut LensWatch, (change, sigma)| {
            watch.update(Some(&FocalClue { change, sigma, share: 0.09, is_contested: false }), None, true, 0.0)
        };
        assert!((0..20).all(|_| state(&mut watch, gel[0]) == LensState::Fits));
        assert!(gel.into_iter().chain(blue).all(|clue| state(&mut watch, clue) == LensState::Fits));
    }

    #[test]
    fn a_focal_step_stays_suspected_until_contradicted() {
        let mut watch = LensWatch::default();
        let ahead = FocalClue { sigma: 0.02, ..clue(0.01) };
        assert_eq!(watch.update(Some(&ahead), Some(-0.03), true, 0.0), LensState::Fits);
        // Frames that say nothing about it leave it open.
        assert!((0..9).all(|_| watch.update(None, None, false, 0.0) == LensState::Fits && watch.deviation() == Some(0.03)));
        watch.update(Some(&ahead), None, true, 0.0);
        assert!(watch.needs_estimate() && watch.deviation() == Some(0.03));
        watch.update(Some(&clue(0.001)), None, true, 0.0);
        assert!(!watch.needs_estimate() && watch.deviation().is_none());
    }

    #[test]
    fn a_focal_doubt_from_matches_needs_matches_to_clear_it() {
        let mut watch = LensWatch::new(true);
        watch.update_by_matches(MatchedFocal::Changed(0.4));
        // Few tiles are aligned through such a lens, and those may claim that it fits.
        let fits = clue(0.001);
        assert_eq!(watch.update(Some(&fits), None, true, 0.0), LensState::Fits);
        assert!(watch.needs_estimate() && watch.contradicts_matches(&fits) && watch.deviation() == Some(0.4));
        watch.update_by_matches(MatchedFocal::Unclear);
        watch.update(None, None, false, 0.0);
        assert_eq!(watch.deviation(), Some(0.4));
        watch.update_by_matches(MatchedFocal::Calibrated);
        watch.update(Some(&fits), None, true, 0.0);
        assert!(!watch.needs_estimate() && watch.deviation().is_none());
    }

    #[test]
    fn slow_focal_drift_from_moving_cloth_is_no_zoom() {
        let mut watch = LensWatch::default();
        let draught = |k: u32| FocalClue { change: 0.03 * (0.15 * f64::from(k)).sin(), sigma: 0.01, share: 0.03, is_contested: false };
        assert!((0..200).all(|k| watch.update(Some(&draught(k)), None, true, 0.0) == LensState::Fits));
    }

    #[test]
    fn a_lens_that_is_known_roughly_is_not_called_moved() {
        let mut watch = LensWatch::default();
        assert!((0..10).all(|_| watch.update(Some(&clue(0.05)), None, true, 0.02) == LensState::Fits));
    }
}
