//! What alignment learns over many frames: light, noise, exposure, gradient gain. With `body` this
//! is the only memory of the tracker. A frame changes it only through `OnlineCalibration::learn`,
//! after its pose was accepted.
//!
//! - `light`, `noise`, `gradient_gain`: one slow estimate each
//! - `exposure`, `exposure_watch`: the exposure, learnt or checked
//! - `online_calibration`: all of them together
//! - `clue`: a frame's estimate of an unknown it did not solve for
//!
//! Uses `frame` and `align::lanes`.

pub mod clue;
pub mod exposure;
pub mod exposure_watch;
#[allow(clippy::needless_range_loop)]
pub mod gradient_gain;
pub mod light;
pub mod noise;
pub mod online_calibration;
