//! Picks from a clip, or from a live camera, the views that are worth having: sharp, held still, and unlike those taken before.

use std::path::PathBuf;

use image::GrayImage;
use nalgebra::Vector2;

use super::board::Board;
use super::finder::{NoBoard, find_board};
use super::guide::{ViewSet, ViewShape};
use super::picture::{Inspected, inspect};
use super::solve::adjust::{mean_distance, observations_of};

/// More views than this add little and cost time: uncertainties fall with the root of their number, the solver's time grows with it.
const MOST_VIEWS: usize = 40;
/// The board is held still when its corners moved less than this on average since the frame before, as a share of the picture's width: 4
/// pixels of 640. Chosen, not tuned. Raised, views with motion blur are taken; lowered, few moments of a clip count.
const STILL_SHARE: f64 = 0.006;
/// A view must be this unlike all before it (see [`ViewShape::distance`]) to be taken: a tenth of
/// the picture, or 5 degrees of tilt. Raised, short clips give too few views …
const NOVELTY: f64 = 0.2;
/// … and this much more for every view that there is already: at twenty views twice as much.
/// Raised, long clips give fewer views; at 0 the first seconds fill the set.
const NOVELTY_PER_VIEW: f64 = 0.01;
/// A view this many times as blurred as the sharpest so far is passed over. Raised, blurred views are
/// taken; lowered, views at another distance, slightly out of focus, are lost.
const BLURRED: f64 = 1.6;

/// What a frame showed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Look {
    /// No board.
    NoBoard(NoBoard),
    /// A board in motion.
    Moving,
    /// A board, more blurred than those before.
    Blurred,
    /// A view like one that there is already.
    Known,
    /// A view worth having; it was taken.
    Taken,
}

/// Looks at the frames of a clip one after the other.
#[derive(Debug)]
pub struct ViewPicker {
    board: Board,
    taken: ViewSet,
    pictures: Vec<Inspected>,
    before: Option<Vec<Option<Vector2<f64>>>>,
    sharpest_px: f64,
    /// The last frame without the board, for the case that none has it.
    without: Option<Inspected>,
}

impl ViewPicker {
    /// Picks views of this board.
    pub fn new(board: Board) -> Self {
        Self { board, taken: ViewSet::default(), pictures: Vec::new(), before: None, sharpest_px: f64::INFINITY, without: None }
    }

    /// Looks at the next frame, and takes it where it is worth having.
    pub fn look_at(&mut self, name: PathBuf, picture: &GrayImage) -> Look {
        let found = match find_board(picture, &self.board) {
            Ok(found) => found,
            Err(reason) => {
                self.before = None;
                if self.pictures.is_empty() {
                    self.without = Some(inspect(name, picture, &self.board));
                }
                return Look::NoBoard(reason);
            }
        };
        let width = f64::from(picture.width().max(picture.height()));
        let before = self.before.replace(found.corners.clone());
        let still = before.is_some_and(|before| mean_distance(&before, &found.corners) < STILL_SHARE * width);
        self.sharpest_px = self.sharpest_px.min(found.blur_px);
        if !still {
            return Look::Moving;
        }
        if found.blur_px >= BLURRED * self.sharpest_px.max(0.5) {
            return Look::Blurred;
        }
        let observations = observations_of(&found.corners, &self.board);
        let Some(shape) = ViewShape::new(&observations, picture.dimensions(), None) else { return Look::Known };
        // The first views may be rather alike; the more there are, the more a new one must bring.
        let wanted = NOVELTY + NOVELTY_PER_VIEW * self.taken.len() as f64;
        let worth = self.taken.worth(&shape);
        if self.taken.len() >= MOST_VIEWS || !(worth.is_worth_it() || worth.novelty > wanted) {
            return Look::Known;
        }
        self.taken.add(shape);
        self.pictures.push(inspect(name, picture, &self.board));
        Look::Taken
    }

    /// The views taken so far.
    pub fn taken(&self) -> &ViewSet {
        &self.taken
    }

    /// The pictures taken; where there is none, one that says why.
    pub fn finish(self) -> Vec<Inspected> {
        if self.pictures.is_empty() { self.without.into_iter().collect() } else { self.pictures }
    }
}
