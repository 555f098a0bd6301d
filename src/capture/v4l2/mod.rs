//! Cameras of Linux (V4L2): finding them by a name that lasts, listing what they can do, holding their controls,
//! and reading them through nokhwa.
//!
//! nokhwa opens a camera by number and hands out its frames. What it keeps to itself - menus, driver stamps, bytes
//! used, a time limit for reading - is asked of the kernel beside it.

mod camera;
mod controls;
mod ioctl;
mod listing;
mod nodes;
mod opener;

#[cfg(test)]
pub(crate) use listing::SizeListing;
pub use listing::{ControlListing, DeviceListing, FormatListing, devices};
pub use opener::V4l2Opener;
