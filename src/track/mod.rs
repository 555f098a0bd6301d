//! Tracking: what bodies are made of, and how a frame becomes a verified pose of each of them.

mod settings;
mod surface;

pub use settings::TrackerSettings;
pub use surface::{BodySpec, ReferenceKind, SurfaceError, SurfaceSpec};
