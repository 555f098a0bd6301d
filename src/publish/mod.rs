//! Publishing: sends the pose to everything that moves, draws or lights by it.
//!
//! A [`Publisher`] runs one thread per output. Each output has a bounded queue that drops its
//! oldest sample when the output is late, so that no receiver can slow the tracker down. On the way
//! to its protocol a pose passes the output's rate (every n-th sample, or ticks of its own), the
//! safety limits, and the receiver's own origin, axes and units. Then an encoder (one file per
//! protocol) makes packets of it. If no pose is known, the output's `on_loss` applies.
//! docs/protocols.md lists every field.

mod channel;
mod clocks;
mod complaints;
mod ear;
mod encoder;
mod frame_clock;
pub mod freed;
#[cfg(test)]
pub(crate) mod golden;
mod json;
mod limiter;
mod mounted;
mod network;
pub mod opentrackio;
pub mod osc;
pub mod otp;
mod otp_demand;
mod placement;
pub mod psn;
mod publisher;
mod report;
mod resample;
mod rings;
mod settings;
mod stamps;
mod system_clock;
mod ticks;
mod transport;
mod worker;

pub use channel::PoseWithheld;
#[cfg(all(test, feature = "daemon"))]
pub(crate) use clocks::stepped;
pub use clocks::{Clocks, Reading};
pub use frame_clock::FrameClock;
pub use json::JsonSettings;
pub use mounted::{Mount, MountSettings};
pub use network::{Interface, needs_interface, udp_listener, udp_sender};
pub use placement::{Axes, Placement};
pub use publisher::{Context, OutputStatistics, PublishError, Publisher};
pub use report::BodyChoice;
pub use rings::{HeardRings, Rings};
pub use settings::{BlendRates, FixedRate, OnLoss, OutputSettings, Protocol, Rate, SafetySettings, TickPhase};
pub use stamps::{ClipStart, Stamps};
pub use system_clock::ClockQuality;
pub use transport::{StreamSettings, TransportError, UdpSettings};
