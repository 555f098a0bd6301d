//! Near a pose: finds where the anchors of the reference pictures are in the frame, and decides
//! whether they agree with the pose. This is how a candidate pose from features is refined and
//! accepted.
//!
//! - `registration`: locates anchors in the frame by correlation
//! - `verify`: refines a pose with them and judges it: enough inliers, spread over the frame, small
//!   covariance
//! - `planar_ambiguity`: tells a flat surface's pose from its mirror image in tilt
//! - `fitted_anchor`, `row_motion`: a located anchor, and the motion during readout
//!
//! Uses `scene`.

pub mod fitted_anchor;
pub mod planar_ambiguity;
pub mod registration;
pub mod row_motion;
pub mod tuning;
pub mod verify;
