//! What is tracked: surfaces, their shapes and their reference pictures, prepared once at load and
//! immutable afterwards.
//!
//! - `surface`, `shape`, `corner_ways`: a surface as configured, flat or bent, and how its corners
//!   may be off
//! - `rectangle`: where a surface lies in its body, and where the camera sees it
//! - `repetition`: the periods of a picture that repeats itself
//! - `stage_map`: the map of a set, whose facets are surfaces, and its file
//! - `reference`: the picture prepared for search: octaves and anchors
//! - `averaged_picture`, `bilinear`: how the picture is sampled
//!
//! Uses only the core's geometry and camera.

pub mod averaged_picture;
pub mod bilinear;
pub mod corner_ways;
pub mod rectangle;
pub mod reference;
pub mod repetition;
pub mod shape;
pub mod stage_map;
pub mod surface;
pub mod tuning;
