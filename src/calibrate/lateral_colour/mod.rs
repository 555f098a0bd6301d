//! Lateral colour: a lens shows red, green and blue at slightly different sizes. Calibration and
//! tracking see their weighted sum, the grey picture; this module measures how far each colour
//! differs from it.
//!
//! With the lens and the board's pose known, the corners are fitted in each colour exactly as in
//! grey. [`fit`] estimates each colour's size from how far its corners lie from those in grey. The
//! calibration does not change.

mod fit;
#[cfg(test)]
mod tests;

use image::{GrayImage, RgbImage};
use nalgebra::Vector2;

use super::board::Board;
use super::finder::FoundBoard;
use super::finder::window::Window;
use super::recompute::{BoardPatch, BoardView};
use super::solve::adjust::BoardFrame;
use crate::camera::CameraModel;
use crate::geometry::{Camera, Pose};
pub use fit::ColourScale;

/// Names of the colours, in the order of a pixel's channels.
pub const COLOUR_NAMES: [&str; 3] = ["red", "green", "blue"];
/// Why nothing is measured where no picture has colours.
pub const GREY: &str = "the pictures are grey";
/// Why nothing is measured in a clip that comes from a pipe, or is no longer there.
pub const READ_ONCE: &str = "the clip cannot be read a second time for its colours";
/// Why nothing is measured with too few views or corners.
const TOO_FEW: &str = "fewer than two pictures show the board's corners in each colour";
/// Why nothing is measured where every colour is a copy of grey, as after strong compression.
const COPIES: &str = "the files keep no differences of colour; take PNG or JPEG of higher quality";
/// 3 sigma of every colour at the picture's corners, pixels, below which they are copies: noise of
/// their own gives a hundred times as much. Raised, very many pictures may count as copies.
const COPIED_PX: f64 = 1e-5;
/// Distance of a stage for which displacements are stated, metres.
const STAGE_M: f64 = 4.0;
/// A picture counts as coloured if in more than this fraction of the pixels …
const COLOURED_SHARE: f64 = 0.01;
/// … the strongest and the weakest channel differ by more than this, grey levels. Conversions of
/// grey pictures round by 1. Raised, pale pictures count as grey; at 0 rounding counts as colour.
const COLOURED_LEVELS: u8 = 2;
/// Maximum number of times that a patch is smoothed before its corners are fitted, each by a
/// Gaussian of sigma 1. Files keep differences of colour at half the size, and cameras compute them
/// from every other pixel; both blur the difference, and a sharp corner then shows only two thirds
/// of its displacement. Raised, it shows more, but corners reach into each other.
const MOST_PASSES: usize = 4;
/// Maximum blur after that, as a fraction of a square. Raised, the next edges reach into the
/// corners; lowered, small squares show less of the displacement.
const WIDEST_BLUR: f64 = 1.0 / 12.0;

/// One corner's place and how far it lies from it in each colour.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CornerColours {
    /// Place in grey, relative to the principal point, raw pixels.
    pub place: Vector2<f64>,
    /// Displacement from it in red, green and blue, pixels; `None` if the corner was not found.
    pub moved: [Option<Vector2<f64>>; 3],
}

/// The sizes of the colours relative to grey.
#[derive(Debug, Clone, PartialEq)]
pub struct LateralColour {
    /// Number of pictures in colour that were used.
    pub pictures: usize,
    /// Red, green and blue.
    pub colours: [ColourScale; 3],
}

/// Measures one picture's corners in each colour, with the lens, the board's pose, and the board;
/// `grey` is the picture's grey patch. Returns `None` if the picture is grey.
pub(crate) fn corner_colours(
    (model, pose, board): (&CameraModel, &Pose<Camera, BoardFrame>, &Board),
    (found, grey): (&FoundBoard, &BoardPatch),
    corners: &[Option<Vector2<f64>>],
    picture: &RgbImage,
) -> Option<Vec<CornerColours>> {
    is_coloured(picture, corners).then_some(())?;
    let passes = passes(found);
    let smooth = FoundBoard { blur_px: (found.blur_px.powi(2) + passes as f64).sqrt(), ..found.clone() };
    let view = BoardView::new(model, pose, board, &smooth)?;
    let mut window = Window::default();
    let mut places = |patch: &BoardPatch| -> Vec<Option<Vector2<f64>>> {
        let patch = patch.smoothed(passes, &smooth);
        let mut place = |index: usize, start: Vector2<f64>| {
            // The second fit's window is centred on the corner, so that it is symmetric about it.
            let near = view.corner(&patch, index, start, &mut window)?;
            view.corner(&patch, index, near, &mut window)
        };
        corners.iter().enumerate().map(|(k, corner)| place(k, (*corner)?)).collect()
    };
    let in_grey = places(grey);
    let in_colours = [0, 1, 2].map(|c| places(&BoardPatch::cut(&channel(picture, c), found)));
    let centre = Vector2::new(model.intrinsics().cx, model.intrinsics().cy);
    let measured = in_grey.iter().enumerate().filter_map(|(k, place)| {
        let place = (*place)?;
        Some(CornerColours { place: place - centre, moved: [0, 1, 2].map(|c| Some(in_colours[c][k]? - place)) })
    });
    Some(measured.collect())
}

/// Returns how often a board's patches are smoothed.
fn passes(found: &FoundBoard) -> usize {
    let room = (WIDEST_BLUR * found.square_px).powi(2) - found.blur_px.powi(2);
    // The cast saturates at 0.
    (room as usize).min(MOST_PASSES)
}

/// Whether the part of a picture that shows the corners is in colour.
fn is_coloured(picture: &RgbImage, corners: &[Option<Vector2<f64>>]) -> bool {
    let bound = |k: usize, size: u32| {
        let fold = |f: fn(f64, f64) -> f64, start: f64| corners.iter().flatten().fold(start, |a, c| f(a, c[k]));
        (fold(f64::min, f64::INFINITY).max(0.0) as u32, (fold(f64::max, 0.0) as u32).saturating_add(1).min(size))
    };
    let ((left, right), (top, bottom)) = (bound(0, picture.width()), bound(1, picture.height()));
    let is_coloured = |[r, g, b]: [u8; 3]| r.max(g).max(b) - r.min(g).min(b) > COLOURED_LEVELS;
    let count = |y: u32| (left..right).filter(|x| is_coloured(picture.get_pixel(*x, y).0)).count();
    let all = f64::from(right.saturating_sub(left)) * f64::from(bottom.saturating_sub(top));
    (top..bottom).map(count).sum::<usize>() as f64 > COLOURED_SHARE * all
}

fn channel(picture: &RgbImage, channel: usize) -> GrayImage {
    let levels = picture.as_raw().iter().skip(channel).step_by(3).copied().collect();
    // By construction, the buffer has one level per pixel.
    GrayImage::from_raw(picture.width(), picture.height(), levels).unwrap_or_default()
}

impl LateralColour {
    /// Estimates the sizes from the corners of the pictures in colour; `size` is the pictures'.
    ///
    /// # Errors
    /// Why there is no estimate, as the end of a sentence.
    pub fn of(views: &[Vec<CornerColours>], size: (u32, u32)) -> Result<Self, &'static str> {
        if views.is_empty() {
            return Err(GREY);
        }
        match [0, 1, 2].map(|colour| ColourScale::of(views, colour, size)) {
            [Some(r), Some(g), Some(b)] if [r, g, b].iter().all(|c| c.corner_uncertainty_px < COPIED_PX) => Err(COPIES),
            [Some(red), Some(green), Some(blue)] => Ok(Self { pictures: views.len(), colours: [red, green, blue] }),
            _ => Err(TOO_FEW),
        }
    }

    /// Returns the colours with their names.
    pub fn named(&self) -> impl Iterator<Item = (&'static str, &ColourScale)> {
        COLOUR_NAMES.into_iter().zip(&self.colours)
    }

    /// States the sizes with 3 sigma.
    pub fn sizes(&self) -> String {
        let sizes: Vec<String> = self.named().map(|(name, c)| format!("{name} {:.6} +/- {:.6}", c.scale, c.scale_uncertainty)).collect();
        format!("{} times as large as grey", sizes.join(", "))
    }

    /// States what the sizes mean for measuring, one sentence after the other.
    pub fn meaning(&self) -> String {
        let seen: Vec<_> = self.named().filter(|(_, c)| (c.scale - 1.0).abs() > c.scale_uncertainty).collect();
        if seen.is_empty() {
            let most = self.colours.iter().map(|c| c.scale_uncertainty).fold(0.0, f64::max);
            return format!("None differs by more than its 3 sigma: less than {}.", error_words(most));
        }
        let side = |px: f64| if px < 0.0 { "in" } else { "out" };
        let moved = |(name, c): &(&str, &ColourScale)| {
            format!("{name} lies {:.2} +/- {:.2} px farther {}", c.corner_px.abs(), c.corner_uncertainty_px, side(c.corner_px))
        };
        let way = |scale: f64| if scale > 1.0 { "near" } else { "far" };
        let error =
            |(name, c): &(&str, &ColourScale)| format!("in {name} alone {} too {}", error_words((c.scale - 1.0).abs()), way(c.scale));
        let list = |parts: Vec<String>| parts.join(", ");
        format!(
            "At the picture's corners {}. The focal length is that of grey: a stage is measured {}.",
            list(seen.iter().map(moved).collect()),
            list(seen.iter().map(error).collect())
        )
    }
}

/// Describes an error of the focal length, as a fraction, by what it does to a distance.
fn error_words(fraction: f64) -> String {
    format!("{:.3} % ({:.1} mm at {STAGE_M} m)", 100.0 * fraction, 1e3 * STAGE_M * fraction)
}
