//! What alignment learns over many frames: light, noise, exposure, gradient gain. With `body` this
//! is the main memory of the tracker; the page of `track` lists the rest. A frame changes it only
//! through `OnlineCalibration::learn`, after its pose was accepted.
//!
//! - `light`: the photometric model; the last accepted frame's is where the next one starts
//! - `camera_curve`: the light that the camera's grey levels stand for
//! - `noise`, `gradient_gain`: one slow estimate each
//! - `exposure`, `exposure_watch`: the exposure, learnt or checked
//! - `online_calibration`: all of them together
//! - `clue`: a frame's estimate of an unknown it did not solve for
//!
//! Uses the core's light, `frame` and `align::lanes`.

pub mod camera_curve;
pub mod clue;
pub mod exposure;
pub mod exposure_watch;
#[allow(clippy::needless_range_loop)]
pub mod gradient_gain;
pub mod light;
pub mod noise;
pub mod online_calibration;
