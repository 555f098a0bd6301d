//! What stage machines speak: FreeD D1, OpenTrackIO 1.0.1 and PosiStageNet 2.03, encoded and decoded.
//!
//! Bytes in, numbers out, and back: no sockets, no clocks, no state. [`freed`], [`psn`] and [`opentrackio`] hold a protocol each;
//! [`PanTiltRoll`] is the angles that the first and the last share, [`opentrackio_lens`] a lens in OpenTrackIO's terms. Decoders refuse what is
//! damaged, with an error that says why, and never panic. What an output sends when is decided in `publish`.

mod body_pose;
pub mod freed;
#[cfg(test)]
pub(crate) mod golden;
pub mod opentrackio;
pub mod opentrackio_lens;
pub mod psn;

pub use body_pose::{PanTiltRoll, to_body_axes, to_camera_axes};
