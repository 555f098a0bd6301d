//! The board finder: takes a grey picture and returns the board's inner corners, each to a few
//! hundredths of a pixel.
//!
//! The search runs from the coarsest level of a pyramid to the finest. On each level it finds
//! candidates (`saddle`), links them into lattices (`links`), and fits missing corners where their
//! neighbours predict them (`grow`, on the `lattice` stored in a `grid`). The first level that
//! shows the board nearly whole ends the search: coarse levels are cheap, and a screen's pixels,
//! paper grain and noise vanish on them. A level on which the lattice is torn is deferred until the
//! finer ones have been tried. Then all corners, including missing ones, are fitted on the finest
//! level that is sharp enough (`fit`), and the lattice is rotated so that the origin is the same
//! corner in every picture (`placement`).

pub(crate) mod fit;
mod gather;
mod grid;
mod grow;
mod islands;
pub(crate) mod lattice;
pub(crate) mod level;
mod links;
mod neighbours;
mod placement;
mod saddle;
mod step;
pub(crate) mod surroundings;
pub(crate) mod window;

use image::GrayImage;
use nalgebra::Vector2;
use thiserror::Error;

use super::board::Board;
use crate::track::{FrameLook, PictureFault};
use lattice::Lattice;
use level::Level;
use neighbours::Margin;
use surroundings::BLUR_REACHES;

/// A board in a picture.
#[derive(Debug, Clone, PartialEq)]
pub struct FoundBoard {
    /// The inner corners in raw pixels, row by row in the order of [`Board::corner`]; `None` for a
    /// hidden one.
    pub corners: Vec<Option<Vector2<f64>>>,
    /// Standard deviation of the blur across the corners' edges, pixels (including the pixel's own
    /// width of 0.3).
    pub blur_px: f64,
    /// Half the difference between light and dark squares, grey levels (the median).
    pub contrast: f64,
    /// Relative change of the light per pixel at each corner, along x and y.
    pub light: Vec<Vector2<f64>>,
    /// Level of the area around the board, on the scale on which dark squares are -1 and light ones
    /// 1.
    pub margin: f64,
    /// Whether the square between the origin's x and y is dark.
    pub dark_origin: bool,
    /// Shorter side of the median square, pixels.
    pub square_px: f64,
}

impl FoundBoard {
    /// Whether the square between x and y of corner `index` of a board with `columns` is dark.
    pub(crate) fn is_dark_beyond(&self, index: usize, columns: usize) -> bool {
        (index % columns + index / columns).is_multiple_of(2) == self.dark_origin
    }

    /// Returns how many corners are visible.
    pub fn seen(&self) -> usize {
        self.corners.iter().flatten().count()
    }
}

/// Why no board was found, and what was seen instead.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum NoBoard {
    /// No lattice was found; holds a description of the picture.
    #[error("no chessboard: {0}")]
    Nothing(String),
    /// A board, or part of one, with another number of corners.
    #[error("a chessboard of {columns}x{rows} inner corners{}, not the {wanted} that was asked for", if *cut { " at the picture's rim" } else { "" })]
    OtherSize {
        /// Inner corners along the longer side.
        columns: u32,
        /// Inner corners along the shorter side.
        rows: u32,
        /// The requested size.
        wanted: String,
        /// Whether it reaches the picture's rim, so that more of it may lie outside.
        cut: bool,
    },
    /// The requested size, but its end cannot be determined.
    #[error(
        "{0} corners of a chessboard whose outermost squares cannot be told from their surroundings; light the board evenly, and show its \
         rim"
    )]
    Endless(String),
    /// The right size, with too many corners hidden.
    #[error("only {seen} of the board's {all} corners can be seen")]
    Hidden {
        /// Corners seen.
        seen: usize,
        /// Corners of the board.
        all: usize,
    },
}

/// Minimum shorter side of a level, pixels: squares of a 9x6 board that fills such a picture have
/// about 9 pixels. Raised, noisy pictures lose the level that shows the board best; lowered, one
/// more level is searched in vain.
const MIN_SIDE: usize = 60;
/// Maximum number of lattices examined per level, largest first: the board is mostly the first, the
/// others allow for larger patterns in the background. Raised, pictures without the board take
/// longer.
const LATTICES: usize = 3;
/// Minimum fraction of the board in one lattice for a coarse level to be completed at once; smaller
/// lattices are tried only if no other level shows the board. Raised, finer levels are searched
/// unnecessarily; lowered, time is spent completing lattices in vain.
const WORTH_COMPLETING: f64 = 0.5;
/// Minimum fraction of a coarse lattice's corners in one piece. Below it the lattice is torn, and
/// mostly stays so when completed; it is deferred until the finer levels are searched. Raised,
/// boards behind a reflection are deferred too; lowered, torn lattices are completed in vain.
const IN_ONE_PIECE: f64 = 0.7;
/// Fraction of the board's corners that ends the search: the few others are searched for on the
/// sharpest level. Raised, a board with hidden corners is searched on every level; lowered, the
/// search ends where a finer level would have shown more.
const NEARLY_WHOLE: f64 = 0.9;
/// Minimum fraction of visible corners for a board to count as found. Chosen, not tuned: fewer
/// mostly lie on one side and constrain the pose poorly. Raised, pictures with a hand before the
/// board are lost.
const MIN_SEEN: f64 = 0.7;
/// Maximum blur, pixels, of a level on which corners are fitted: finer pixels only make the windows
/// larger, for the edges hold no more detail. Raised, blurred pictures take longer; lowered,
/// corners are fitted on coarser pixels …
pub(crate) const WIDEST_BLUR: f64 = 2.5;
/// … unless squares are smaller than this, pixels: they have no pixels to spare. Raised, more
/// blurred pictures are fitted on the finer level.
pub(crate) const SMALL_SQUARE: f64 = 8.0;
/// Expected blur, pixels, above which a level is not even tried: a little above [`WIDEST_BLUR`], as
/// the expectation comes from the coarser level. Raised, levels are fitted in vain; lowered, some
/// that are sharp enough are skipped.
const EXPECTED_BLUR: f64 = 2.8;

/// Finds the board's corners in a picture.
///
/// # Errors
/// What was seen instead of the whole board.
pub fn find_board(picture: &GrayImage, board: &Board) -> Result<FoundBoard, NoBoard> {
    let levels = level::pyramid(picture, MIN_SIDE);
    let (index, lattice) = search(&levels, board).map_err(|partial| seen_instead(picture, board, partial, &levels))?;
    // Corners dropped from here on count as hidden: the board keeps its extent.
    let extent = lattice.extent().unwrap_or_default();
    let (mut lattice, sharp) = sharpened(lattice, index, &levels);
    let level = &levels[sharp];
    lattice.drop_outliers();
    if lattice.len() < board.corner_count() {
        lattice.grow(level, Some(extent));
    }
    let mut margin = Margin::around(&lattice, extent, level);
    let blur_reaches = |lattice: &Lattice| lattice.blur > BLUR_REACHES * lattice.square();
    // Refit with all that the neighbours tell about each corner, unless it was all known before.
    if sharp == index || blur_reaches(&lattice) {
        lattice.refit(level, Some(&margin));
        if blur_reaches(&lattice) {
            margin = Margin::around(&lattice, extent, level);
            lattice.refit(level, Some(&margin));
        }
    }
    lattice.drop_outliers();
    lattice.drop_islands();
    // After the islands, since this may split the board into pieces. Corners supported only by
    // disturbed ones go too.
    lattice.drop_disturbed();
    lattice.drop_outliers();
    let lattice = lattice.rescaled(-(sharp as i32));
    let found = placement::placed(&lattice, extent, board, margin.lightness);
    match found {
        Some(found) if found.seen() as f64 >= MIN_SEEN * board.corner_count() as f64 => Ok(found),
        found => Err(NoBoard::Hidden { seen: found.map_or(0, |f| f.seen()), all: board.corner_count() }),
    }
}

/// A lattice and the level it was found on.
type OnLevel = (usize, Lattice);

/// Returns the lattice that is the board, or the largest of those that are not.
fn search(levels: &[Level], board: &Board) -> Result<OnLevel, Option<OnLevel>> {
    let (mut best, mut partial, mut torn, mut small) = (None, None, Vec::new(), Vec::new());
    let mut keep = |index: usize, mut lattice: Lattice, best: &mut Option<OnLevel>| {
        let level = &levels[index];
        lattice.complete(level);
        lattice.drop_outliers();
        lattice.drop_islands();
        lattice.trim();
        lattice.drop_false_ends(level, placement::sorted_size(board));
        let fits = placement::fits(&lattice, board) && lattice.is_whole_board(level);
        let slot = if fits { best } else { &mut partial };
        if slot.as_ref().is_none_or(|(_, kept)| kept.len() < lattice.len()) {
            *slot = Some((index, lattice));
        }
    };
    let corners = board.corner_count() as f64;
    let is_nearly_whole = |best: &Option<OnLevel>| best.as_ref().is_some_and(|(_, lattice)| lattice.len() as f64 >= NEARLY_WHOLE * corners);
    for (index, level) in levels.iter().enumerate().rev() {
        for lattice in lattices_of(level) {
            let size = lattice.len() as f64;
            if index > 0 && size < WORTH_COMPLETING * corners {
                small.push((index, lattice));
            } else if index > 0 && (lattice.largest_piece() as f64) < IN_ONE_PIECE * size {
                torn.push((index, lattice));
            } else {
                keep(index, lattice, &mut best);
            }
        }
        if is_nearly_whole(&best) {
            break;
        }
    }
    if !is_nearly_whole(&best) {
        torn.into_iter().for_each(|(index, lattice)| keep(index, lattice, &mut best));
    }
    if best.is_none() {
        small.into_iter().for_each(|(index, lattice)| keep(index, lattice, &mut best));
    }
    best.ok_or(partial)
}

/// Returns the largest lattices of one level.
fn lattices_of(level: &Level) -> Vec<Lattice> {
    let smooth = level.smoothed();
    let mut lattices = links::lattices(&smooth, &saddle::find_saddles(&smooth));
    lattices.truncate(LATTICES);
    lattices
}

/// Fits the corners on the finest level whose blur is at most [`WIDEST_BLUR`], or that small
/// squares need; returns the lattice and that level's index.
fn sharpened(lattice: Lattice, found_on: usize, levels: &[Level]) -> (Lattice, usize) {
    let (mut lattice, mut at) = (lattice, found_on);
    let is_sharp = |lattice: &Lattice, most: f64| lattice.blur <= most || lattice.square() < SMALL_SQUARE;
    // Try two levels at once: the start of the fit is then at most half a pixel off.
    let mut stride = 2;
    while at > 0 {
        let to = at.saturating_sub(stride);
        let mut finer = lattice.rescaled(to as i32 - at as i32);
        let before = finer.len();
        let expected_sharp = is_sharp(&finer, EXPECTED_BLUR);
        if expected_sharp {
            // The blur of small squares is poorly known, so measure it on the finer level itself.
            finer.refit(&levels[to], None);
        }
        // Where noise or a screen's own pixels hide the corners on the finer level, keep the
        // coarser one.
        let lost = finer.len() * 20 < before * 19;
        if expected_sharp && !lost && is_sharp(&finer, WIDEST_BLUR) {
            (lattice, at) = (finer, to);
        } else if stride > 1 && at > 1 {
            stride = 1;
        } else {
            break;
        }
    }
    (lattice, at)
}

/// Describes what was seen in a picture without the board.
fn seen_instead(picture: &GrayImage, board: &Board, partial: Option<(usize, Lattice)>, levels: &[Level]) -> NoBoard {
    let found = partial.and_then(|(index, lattice)| Some((lattice.extent()?, lattice, &levels[index])));
    let Some((extent, lattice, level)) = found.filter(|(e, l, _)| e.sorted_size().1 >= 3 && l.len() >= 9) else {
        return NoBoard::Nothing(brightness(picture));
    };
    if placement::fits(&lattice, board) {
        return NoBoard::Endless(board.to_string());
    }
    let (columns, rows) = extent.sorted_size();
    let cut = lattice.cells().any(|((i, j), cell)| {
        let step = lattice.steps(i, j).map_or(0.0, |[u, v]| u.norm().max(v.norm()));
        !level.has(cell.position, 1.2 * step)
    });
    NoBoard::OtherSize { columns, rows, wanted: board.to_string(), cut }
}

/// Describes a picture without a board, for the user.
fn brightness(picture: &GrayImage) -> String {
    let mut counts = [0_usize; 256];
    picture.as_raw().iter().for_each(|&v| counts[usize::from(v)] += 1);
    let total = picture.as_raw().len().max(1);
    let mut sum = 0;
    let up_to = counts.map(|n| {
        sum += n;
        sum
    });
    let level_at = |share: f64| up_to.partition_point(|&n| n <= (share * total as f64) as usize).min(255);
    let (dark, light) = (level_at(0.02), level_at(0.98));
    match (dark, light) {
        (_, 0..40) => format!("the picture is dark (98 % of it below grey level {})", light + 1),
        (200.., _) => format!("the picture is overexposed (98 % of it above grey level {dark})"),
        _ if light - dark < 12 => format!("the picture is flat (grey levels {dark} to {light})"),
        _ if is_blurred(picture) => "the picture is blurred; focus the lens, and hold board and camera still".to_owned(),
        _ => "no connected group of corners".to_owned(),
    }
}

/// Maximum width, pixels, of the downscaled copy in which blur is measured: fine enough for blur
/// that ruins corners, while the noise of large sensors is averaged out. Raised, the lens's own
/// softness in large pictures is reported as blur; lowered, harmful blur is missed.
const LOOKED_AT_PX: u32 = 640;

fn is_blurred(picture: &GrayImage) -> bool {
    let (width, height) = picture.dimensions();
    let part = width.div_ceil(LOOKED_AT_PX).max(2);
    let small = image::imageops::thumbnail(picture, (width / part).max(1), (height / part).max(1));
    FrameLook::at(&small).fault() == Some(PictureFault::TooBlurred)
}

#[cfg(test)]
mod tests;
