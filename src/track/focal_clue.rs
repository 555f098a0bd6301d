//! Whether another focal length explains a frame better than the calibration's: the lens was zoomed or focused, or it is another lens.
//!
//! Seen straight from ahead, a flat stage that fills more of the picture is nearer, or the lens is longer: nothing tells. Seen from the side
//! or in depth, the two differ in perspective, and the tiles are left displaced. [`focal_memory`](super::focal_memory) finds what that says beside all else that may be off.

use nalgebra::{Matrix6, Vector6};

use super::row_motion::RowMotion;
use super::tile_residuals::TileResidual;
use crate::camera::{CameraModel, Shutter};
use crate::geometry::{Body, Camera, Pose};

/// How far the body may move while the rows are read, where that is not known, one sigma: m/s and rad/s. Raised, fast pans pass for less of a zoom.
const MOTION_SIGMA: [f64; 2] = [1.0, 1.0];
/// How long a frame is read where nothing is configured, seconds: the usual webcam's. Raised, fast pans pass for less of a zoom.
const USUAL_READOUT_S: f64 = 0.02;
/// A readout that is known to this share of itself, one sigma, is described. Raised, rows that a readout displaces pass for a lens; lowered, a learnt one is of less use.
const SURE_SHARE: f64 = 0.1;
/// Least sigma of that motion, m/s and rad/s: keeps the equations regular where nothing moves. Raised, see [`MOTION_SIGMA`].
const LEAST_MOTION: f64 = 1e-4;
/// A focal length counts as another one beyond this share of itself: it puts a camera 4 m away 2 cm off. Raised, such errors are given;
/// lowered, lenses that breathe with focus are refused.
const LEAST_CHANGE: f64 = 0.005;
/// A logarithm beyond this (+-30 %) is no evidence: the equations are linear, and do not describe such a change. Raised, what cannot exist is reported as a zoom.
const MOST_CHANGE: f64 = 0.26;
/// Sigmas of what frames say, and of the calibration's own doubt, beyond which the lens is another one. Raised, a zoom is noticed later; lowered, patterns of other causes pass for one.
const LEAST_SIGMAS: f64 = 5.0;
const DOUBT_SIGMAS: f64 = 4.0;
/// Sigmas beyond which another focal length is likely enough to be in the covariance. Raised, zooms are given too surely; lowered, chance makes poses less sure.
const CLEAR_SIGMAS: f64 = 3.0;

/// What is said of the focal length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FocalClue {
    /// Logarithm of the focal length that fits over the expected one.
    pub change: f64,
    /// One sigma of it, all else that may be off being free.
    pub sigma: f64,
}

impl FocalClue {
    /// Whether another focal length explains the frame clearly better. `doubt`: one sigma of the logarithm of the calibrated one.
    pub fn is_off(&self, doubt: f64) -> bool {
        let size = self.change.abs();
        (LEAST_CHANGE..MOST_CHANGE).contains(&size) && size > LEAST_SIGMAS * self.sigma && size > DOUBT_SIGMAS * doubt
    }

    /// Whether another focal length is likely.
    pub fn is_clear(&self) -> bool {
        self.change.abs() > LEAST_CHANGE.max(CLEAR_SIGMAS * self.sigma)
    }

    /// Whether a step of so much is clearly too large.
    pub fn contradicts(&self, step: f64) -> bool {
        self.change.abs() + CLEAR_SIGMAS * self.sigma < step
    }

    /// Whether the frame is clearly taken with the expected focal length.
    pub fn is_right(&self, doubt: f64) -> bool {
        self.change.abs() + CLEAR_SIGMAS * self.sigma < LEAST_CHANGE + DOUBT_SIGMAS * doubt
    }
}

/// What a frame says of the focal length, with the frames before.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LensClue {
    /// If all of them have one focal length: against the calibration's.
    pub whole: FocalClue,
    /// Of this frame alone, the other unknowns being those of the frames before: against [`usual`](Self::usual).
    pub changed: FocalClue,
    /// Logarithm of the focal length of the frames before over the calibration's.
    pub usual: f64,
}

impl LensClue {
    /// Another focal length that explains the frame clearly better, as the logarithm over the calibration's; see [`FocalClue::is_off`].
    pub fn off(&self, doubt: f64) -> Option<f64> {
        let changed = self.changed.is_off(doubt).then_some(self.usual + self.changed.change);
        changed.or(self.whole.is_off(doubt).then_some(self.whole.change))
    }

    /// How far the focal length may be off, where another one is likely: one sigma of its logarithm.
    pub fn doubt(&self) -> Option<f64> {
        let sizes = [self.whole, self.changed].into_iter().filter(FocalClue::is_clear).map(|clue| clue.change.abs().min(MOST_CHANGE));
        sizes.max_by(f64::total_cmp)
    }
}

/// How the rows of a frame may be displaced by a motion that its pose does not account for.
#[derive(Debug, Clone, Copy)]
pub struct RowDisplacement {
    shutter: Shutter,
    height: u32,
    /// Inverse covariance of the motion, per second.
    motion_information: Matrix6<f64>,
    is_described: bool,
}

impl RowDisplacement {
    /// A shutter that was described leaves what its motion was estimated wrong by. One that was not may read the rows one after the other all the same:
    /// then any share of the body's motion to `pose` (`T_camera_body`) may be in the rows, and of each component what it changed by.
    pub fn new(camera: &CameraModel, rows: &RowMotion, pose: &Pose<Camera, Body>) -> Self {
        let is_described = rows.shutter.readout_s != 0.0 && rows.readout_sigma_s <= SURE_SHARE * rows.shutter.readout_s.abs();
        let [moving, turning] = MOTION_SIGMA.map(|sigma| sigma.powi(2));
        let usual = Matrix6::from_diagonal(&Vector6::new(moving, moving, moving, turning, turning, turning));
        let moved = rows.twist_and_change(pose).filter(|_| !is_described);
        let covariance = moved.map_or(usual, |(twist, change)| {
            twist * twist.transpose() + Matrix6::from_diagonal(&change.component_mul(&change).add_scalar(LEAST_MOTION.powi(2)))
        });
        let motion_information = covariance.cholesky().map_or(still(), |factor| factor.inverse());
        let readout_s = if is_described { rows.shutter.readout_s } else { USUAL_READOUT_S };
        Self { shutter: Shutter { readout_s, ..rows.shutter }, height: camera.height(), motion_information, is_described }
    }

    /// Whether somebody said when the rows are exposed.
    pub fn is_described(&self) -> bool {
        self.is_described
    }

    /// Inverse covariance of the motion that displaces them, per second.
    pub fn motion_information(&self) -> &Matrix6<f64> {
        &self.motion_information
    }

    /// When a tile's row was exposed, seconds after the middle one.
    pub fn delay_s(&self, t: &TileResidual) -> f64 {
        self.shutter.delay_s(t.place_px.y + 0.5, self.height)
    }
}

/// Inverse covariance of a motion that is none.
fn still() -> Matrix6<f64> {
    Matrix6::identity() * LEAST_MOTION.powi(-2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_no_linear_step_can_tell_is_no_evidence() {
        // +507 %, -100 % and -73 % were reported of a calibrated lens, for a corner of a photograph that was a pixel off.
        for change in [1.8, -7.0, -1.3, 0.3] {
            assert!(!FocalClue { change, sigma: 0.001 }.is_off(0.0), "{change}");
        }
        assert!(FocalClue { change: 0.15, sigma: 0.01 }.is_off(0.0) && !FocalClue { change: 0.15, sigma: 0.03 }.is_off(0.0));
        assert!(!FocalClue { change: 0.05, sigma: 0.0005 }.is_off(0.02), "a lens that is known roughly");
    }

    #[test]
    fn what_is_likely_is_in_doubt_before_it_is_clear() {
        let none = FocalClue { change: 0.001, sigma: 0.001 };
        let clue = |whole: FocalClue, changed: FocalClue| LensClue { whole, changed, usual: 0.0 };
        assert_eq!(clue(none, none).doubt(), None);
        let likely = FocalClue { change: -0.02, sigma: 0.004 };
        assert_eq!((clue(none, likely).doubt(), clue(none, likely).off(0.0)), (Some(0.02), None));
        assert_eq!(clue(FocalClue { change: 1.5, sigma: 0.1 }, none).doubt(), Some(MOST_CHANGE));
    }
}
