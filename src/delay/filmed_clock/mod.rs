//! How late a camera's stamps are, from a clip that films a clock.
//!
//! The page shows the time as a code of black and white cells on any screen. Each frame of a camera
//! that films it shows when it was exposed: [`find_code`] finds the code in the picture, [`read`]
//! reads it, and [`measure_lateness`] compares the times read with the frames' stamps. Where the
//! code changed during the exposure, cells are grey, and how grey they are says when, to a fraction
//! of the screen's refresh.
//!
//! - `layout`: which cell is black at which time
//! - `find`: where a picture shows the code
//! - `read`: the time that the cells show
//! - `lateness`: the delay of the stamps, its spread and its drift
//! - `judge`: how far to trust it

mod find;
mod judge;
mod lateness;
mod layout;
mod read;
#[cfg(test)]
mod screen;

pub use find::find_code;
pub use judge::judge_lateness;
pub use lateness::{Lateness, Look, MIN_LOOKS, measure_lateness};
pub use read::read;
