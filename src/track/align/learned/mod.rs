//! What alignment learns over many frames: light, noise, exposure, gradient gain. With `body` this
//! is the only memory of the tracker; a frame changes it only through `SlowEstimates::learn`.
//!
//! - `light`, `noise`, `gradient_gain`: the slow estimates of one kind each
//! - `exposure`, `exposure_watch`: the exposure, learnt or checked
//! - `slow_estimates`: all of them together
//! - `clue`: what one frame says of such an unknown
//!
//! Uses `frame`.

pub mod clue;
pub mod exposure;
pub mod exposure_watch;
#[allow(clippy::needless_range_loop)]
pub mod gradient_gain;
pub mod light;
pub mod noise;
pub mod slow_estimates;
