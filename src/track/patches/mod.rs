//! Near a pose: where are the anchors of the pictures in the frame, and do they agree?
//!
//! - `registration`: finds anchors in the frame by correlation
//! - `verify`: judges a pose by its anchors: enough inliers, spread over the frame
//! - `planar_ambiguity`: tells a flat surface from its mirror image in tilt
//! - `fitted_anchor`, `row_motion`: an anchor that was found, and the motion of the rows
//!
//! Uses `scene`.

pub mod fitted_anchor;
pub mod planar_ambiguity;
pub mod registration;
pub mod row_motion;
pub mod verify;
