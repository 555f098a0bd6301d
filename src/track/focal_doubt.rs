//! How far the focal length may be off in a frame: what the covariance of its pose contains.

use super::focal_clue::LensClue;

/// Remembers what frames said of it.
#[derive(Debug, Default)]
pub struct FocalDoubt {
    clue: Option<LensClue>,
    /// A step of its logarithm that would explain how a pose jumped, until frames say that it was none.
    step: f64,
}

impl FocalDoubt {
    /// Takes a frame's clue, and the step that would explain its jump.
    pub fn update(&mut self, clue: Option<&LensClue>, step: Option<f64>) {
        self.clue = clue.copied();
        self.step = self.step.max(step.map_or(0.0, f64::abs));
        if clue.is_some_and(|clue| clue.changed.contradicts(self.step)) {
            self.step = 0.0;
        }
    }

    /// Whether a pose jumped as a step of the focal length would make it, and no frame contradicted that.
    pub fn has_step(&self) -> bool {
        self.step > 0.0
    }

    /// Whether another focal length is likely.
    pub fn is_doubted(&self) -> bool {
        self.step > 0.0 || self.likely() > 0.0
    }

    /// One sigma of its logarithm; `None` where nothing was asked. `calibrated`: one sigma by the calibration; `adds`: whether that is part of it.
    pub fn sigma(&self, calibrated: f64, adds: bool) -> Option<f64> {
        let clue = self.clue.as_ref()?;
        let (known, calibrated) = (clue.whole.sigma.powi(2), if adds { calibrated.powi(2) } else { 0.0 });
        // What calibration and frames say together, and how far that is from the calibrated one.
        let share = calibrated / (calibrated + known).max(f64::MIN_POSITIVE);
        let variance = share * known + (share * clue.whole.change).powi(2);
        Some((variance + self.likely().powi(2) + self.step.powi(2)).sqrt())
    }

    fn likely(&self) -> f64 {
        self.clue.as_ref().and_then(LensClue::doubt).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::super::focal_clue::FocalClue;
    use super::*;

    fn clue(change: f64, sigma: f64) -> LensClue {
        LensClue { whole: FocalClue { change, sigma }, changed: FocalClue { change, sigma }, usual: 0.0 }
    }

    #[test]
    fn frames_that_tell_the_focal_length_take_the_calibrations_doubt_away() {
        let mut doubt = FocalDoubt::default();
        assert_eq!(doubt.sigma(0.003, true), None);
        doubt.update(Some(&clue(0.001, 2.0)), None);
        assert!((doubt.sigma(0.003, true).unwrap() - 0.003).abs() < 1e-5);
        doubt.update(Some(&clue(0.0001, 0.0003)), None);
        assert!(doubt.sigma(0.003, true).unwrap() < 0.0004 && !doubt.is_doubted());
        assert_eq!(doubt.sigma(0.003, false), Some(0.0));
        // A guess that is 2 % off.
        doubt.update(Some(&clue(0.02, 0.008)), None);
        assert!((0.018..0.025).contains(&doubt.sigma(0.03, true).unwrap()));
    }

    #[test]
    fn a_step_stays_in_doubt_until_frames_contradict_it() {
        let mut doubt = FocalDoubt::default();
        doubt.update(Some(&clue(0.0, 1.0)), Some(-0.03));
        assert!(doubt.is_doubted() && doubt.sigma(0.003, true).unwrap() > 0.03);
        doubt.update(Some(&clue(0.02, 0.02)), None);
        assert!(doubt.is_doubted());
        doubt.update(Some(&clue(0.001, 0.004)), None);
        assert!(!doubt.is_doubted());
    }
}
