//! A lens that was moved is never believed: where another focal length than the calibration's explains the frames, poses are withheld.
//!
//! One such frame is not given; from the second one on nothing is, until frames say that the focal length is the calibration's again. Views that
//! tell nothing of it (a flat stage straight from ahead) change nothing: what was withheld stays so.
//!
//! A change that is likely and not yet clear is in the covariance ([`LensClue::doubt`]).

use tracing::{info, warn};

use super::focal_clue::LensClue;

/// Frames in a row that say so, before the lens counts as moved. Chosen: one may be a torn frame. Raised, a zoom is named later; the frames
/// until then are withheld all the same.
const FRAMES_TO_MOVE: u32 = 2;
/// Frames in a row that show the calibrated focal length, before the lens counts as back. Raised, poses are given later.
const FRAMES_TO_RETURN: u32 = 3;

/// What a frame's pose may be taken for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LensState {
    /// Nothing speaks against the lens.
    Fits,
    /// This frame does; it is not given.
    Suspect,
    /// The lens was moved; nothing is given.
    Moved,
}

/// Remembers what frames said of the focal length.
#[derive(Debug, Default)]
pub struct LensWatch {
    is_moved: bool,
    /// Frames in a row that contradict the state.
    against: u32,
    /// Whether nothing is logged: it is a trial.
    is_quiet: bool,
}

impl LensWatch {
    /// `is_quiet`: it logs nothing.
    pub fn new(is_quiet: bool) -> Self {
        Self { is_quiet, ..Self::default() }
    }

    /// Takes a frame's clue, if it has one. `is_seen`: whether there was anything to ask; `doubt`: one sigma of the logarithm of the calibrated focal
    /// length.
    pub fn update(&mut self, clue: Option<&LensClue>, is_seen: bool, doubt: f64) -> LensState {
        let Some(clue) = clue else {
            // Asked, and nothing speaks against the lens: not a frame in a row.
            if is_seen {
                self.against = 0;
            }
            return self.state(false);
        };
        let off = clue.off(doubt);
        let is_against = if self.is_moved { clue.changed.is_right(doubt) } else { off.is_some() };
        self.against = if is_against { self.against + 1 } else { 0 };
        let needed = if self.is_moved { FRAMES_TO_RETURN } else { FRAMES_TO_MOVE };
        if self.against >= needed {
            (self.is_moved, self.against) = (!self.is_moved, 0);
            self.tell(off.unwrap_or_default());
        }
        self.state(is_against)
    }

    fn tell(&self, change: f64) {
        match (self.is_quiet, self.is_moved) {
            (true, _) => {}
            (false, true) => warn!(
                "the focal length that fits the frames is {:+.1} % off the calibration's: poses are withheld; set the lens back, or calibrate it as it is",
                100.0 * (change.exp() - 1.0)
            ),
            (false, false) => info!("the focal length is the calibration's again: poses are given"),
        }
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
    use super::super::focal_clue::FocalClue;
    use super::*;

    fn clue(change: f64) -> LensClue {
        let said = FocalClue { change, sigma: 0.0005 };
        LensClue { whole: FocalClue { change: 0.0, sigma: 0.1 }, changed: said, usual: 0.0 }
    }

    #[test]
    fn one_frame_is_held_back_and_two_withhold_all() {
        use LensState::{Fits, Moved, Suspect};
        let mut watch = LensWatch::default();
        let said = [0.0, 0.02, 0.001, 0.02, 0.04, 0.002].map(|change| watch.update(Some(&clue(change)), true, 0.0));
        assert_eq!(said, [Fits, Suspect, Fits, Suspect, Moved, Moved]);
    }

    #[test]
    fn only_frames_that_tell_bring_the_lens_back() {
        use LensState::{Fits, Moved};
        let mut watch = LensWatch::default();
        assert_eq!([0.02, 0.03].map(|change| watch.update(Some(&clue(change)), true, 0.0))[1], Moved);
        let weak = LensClue { changed: FocalClue { change: 0.0, sigma: 0.01 }, ..clue(0.0) };
        assert!((0..50).all(|_| watch.update(Some(&weak), true, 0.0) == Moved && watch.update(None, false, 0.0) == Moved));
        let said = [0.001, 0.03, 0.001, 0.001, 0.001].map(|change| watch.update(Some(&clue(change)), true, 0.0));
        assert_eq!(said, [Moved, Moved, Moved, Moved, Fits]);
    }

    #[test]
    fn a_lens_that_is_known_roughly_is_not_called_moved() {
        let mut watch = LensWatch::default();
        assert!((0..10).all(|_| watch.update(Some(&clue(0.05)), true, 0.02) == LensState::Fits));
    }
}
