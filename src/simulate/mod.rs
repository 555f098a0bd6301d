//! The virtual stage: a painted stage and a camera in front of it, with exact ground truth.
//!
//! The demo, the fixtures and the tests need pictures whose camera pose is known exactly, which no
//! real clip provides. [`VirtualStage`] describes the scene: flat or bent surfaces, draughts,
//! moving objects, people in the way, light and spots, the camera and its path. [`Renderer`]
//! renders it at any instant as a real camera would see it, with lens distortion, motion blur,
//! rolling shutter and sensor noise. [`paint`] makes the pictures on the cloth.
//!
//! Everything is a pure function of its description, its seed and the time. Frames can be rendered
//! in any order and on any number of threads, and have the same bytes on every run.

mod backdrop;
mod canvas;
mod cloth;
mod dolly;
#[cfg(all(test, feature = "two-views"))]
mod gloh_basis_tests;
#[cfg(feature = "capture")]
mod jpeg;
mod light;
mod path;
mod person;
pub mod pose_error;
mod render;
mod samples;
mod sensor;
mod spot;
mod stage;
mod texture;
mod upright;

pub use backdrop::{grey, paint, paint_boards};
pub use dolly::{Dolly, DollyError, dolly};
#[cfg(feature = "capture")]
pub use jpeg::through_jpeg;
pub use light::{LightModel, ToneCurve};
pub use path::{CameraPath, ObjectPath, PathError, Roll, Shake, Spline, look_at};
pub use person::Person;
pub use pose_error::{PoseError, percentile};
pub use render::Renderer;
pub use sensor::SensorNoise;
pub use spot::Spot;
pub use stage::{Draught, LightKey, MovingObject, Occluder, VirtualStage, Wave, artwork_surface};
pub use upright::upright;
