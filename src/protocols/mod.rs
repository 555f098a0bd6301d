//! The protocols of stage equipment: FreeD D1, OpenTrackIO 1.0.1, PosiStageNet 2.03 and OTP (ANSI
//! E1.59-2021), encoded and decoded.
//!
//! This module only converts between bytes and numbers: no sockets, no clocks, no state. [`freed`],
//! [`psn`], [`opentrackio`] and [`otp`] hold one protocol each; [`PanTiltRoll`] has the angles that
//! FreeD and OpenTrackIO share, [`opentrackio_lens`] expresses a lens in OpenTrackIO's terms, and
//! [`otp_pose`] a pose in OTP's. [`camera_packet`] is what a received packet of FreeD or
//! OpenTrackIO says of its camera.
//! Decoders refuse damaged data with an error that states why, and never panic. `publish` decides
//! what an output sends and when.

mod body_pose;
pub mod camera_packet;
pub mod freed;
#[cfg(test)]
pub(crate) mod golden;
pub mod opentrackio;
pub mod opentrackio_lens;
pub mod otp;
pub mod otp_pose;
pub mod psn;

pub use body_pose::{PanTiltRoll, to_body_axes, to_camera_axes};
