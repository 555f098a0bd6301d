//! What is remembered from frame to frame: of each body, and of the camera's clock and shutter.
//! With `align::learned` the main memory of the tracker; the page of `track` lists the rest.
//!
//! - `tracked_body`: a body with its last motion, its anchors and its model errors
//! - `pose_anchors`: the anchors of a verified pose
//! - `track_state`: searching, tracking, coasting or lost
//! - `frame_interval`, `clock_steps`: how often frames come, and jumps of their clock
//! - `learnt_readout`, `learnt_camera`, `agreement`, `shutter_news`: the shutter, learnt or checked
//! - `reason`, `pixel_watch`: what is reported of a body besides its pose
//!
//! Uses every room above.

pub mod agreement;
pub mod clock_steps;
pub mod frame_interval;
pub mod learnt_camera;
pub mod learnt_readout;
pub mod pixel_watch;
pub mod pose_anchors;
pub mod reason;
pub mod shutter_news;
pub mod track_state;
pub mod tracked_body;
pub mod tuning;
