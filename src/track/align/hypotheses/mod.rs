//! Motions that the prediction does not contain. Each one is another start and another prior.
//!
//! - `velocity_jump`: the velocity jumped since the last frame
//! - `velocity_by_blur`: the velocity that motion blur shows
//!
//! Uses `align::solve`.

pub mod velocity_by_blur;
pub mod velocity_jump;
