//! Cameras on Linux (V4L2): finds them by a persistent name, lists their capabilities, sets their
//! controls, and reads them through nokhwa.
//!
//! nokhwa opens a camera by number and delivers its frames. What it does not expose (menus, driver
//! stamps, bytes used, a timeout for reading) is queried directly from the kernel.

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
