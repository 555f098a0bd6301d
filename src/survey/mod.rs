//! What a clip of a known stage reveals about the camera and the stage itself: [`shutter`]
//! estimates readout and exposure from a shaken clip, `walked` surveys the stage as it hangs and
//! the lens from a walk (C11); only the program compiles it. `measured` and `named_points` are
//! what a config states for that.
//!
//! Both take an iterator of frames from any source, and may read them several times.

#[cfg(feature = "daemon")]
pub mod measured;
#[cfg(feature = "daemon")]
pub mod named_points;
pub mod shutter;
#[cfg(feature = "cli")]
pub mod walked;
