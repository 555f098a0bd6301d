//! Picks useful views from a clip or a live camera: sharp, held still, and unlike those taken
//! before.

use std::path::PathBuf;

use image::GrayImage;
use nalgebra::Vector2;

use super::board::Board;
use super::finder::{NoBoard, find_board};
use super::guide::{ViewSet, ViewShape};
use super::picture::{Inspected, inspect};
use super::solve::adjust::{mean_distance, observations_of};

/// Maximum number of views. More add little: uncertainties fall with the root of their number,
/// while the solver's time grows with it.
const MAX_VIEWS: usize = 40;
/// Maximum mean motion of the corners since the previous frame for the board to count as held
/// still, as a fraction of the picture's width: 4 pixels of 640. Chosen, not tuned. Raised, views
/// with motion blur are taken; lowered, few moments of a clip count.
const STILL_SHARE: f64 = 0.006;
/// Minimum difference from all earlier views (see [`ViewShape::distance`]): a tenth of the picture,
/// or 5 degrees of tilt. Raised, short clips give too few views …
const NOVELTY: f64 = 0.2;
/// … increased by this for every view taken: at twenty views it has doubled. Raised, long clips
/// give fewer views; at 0 the first seconds fill the set.
const NOVELTY_PER_VIEW: f64 = 0.01;
/// Blur, relative to the sharpest view so far, above which a view is rejected. Raised, blurred
/// views are taken; lowered, views at another distance, slightly out of focus, are lost.
const BLURRED: f64 = 1.6;

/// The result for one frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Look {
    /// No board.
    NoBoard(NoBoard),
    /// A board in motion.
    Moving,
    /// A board, more blurred than those before.
    Blurred,
    /// A view like one already taken.
    Known,
    /// A useful view, which was taken.
    Taken,
}

/// Examines the frames of a clip one after the other.
#[derive(Debug)]
pub struct ViewPicker {
    board: Board,
    taken: ViewSet,
    pictures: Vec<Inspected>,
    before: Option<Vec<Option<Vector2<f64>>>>,
    sharpest_px: f64,
    /// The last frame without the board, reported if none shows it.
    without: Option<Inspected>,
}

impl ViewPicker {
    /// Creates a picker for views of this board.
    pub fn new(board: Board) -> Self {
        Self { board, taken: ViewSet::default(), pictures: Vec::new(), before: None, sharpest_px: f64::INFINITY, without: None }
    }

    /// Adds a picture that was taken before, whatever it adds; returns whether it shows the board.
    pub fn recall(&mut self, name: PathBuf, picture: &GrayImage) -> bool {
        let inspected = inspect(name, picture, &self.board);
        let Ok(found) = &inspected.board else { return false };
        let shape = ViewShape::new(&observations_of(&found.corners, &self.board), picture.dimensions(), None);
        self.sharpest_px = self.sharpest_px.min(found.blur_px);
        let Some(shape) = shape else { return false };
        self.taken.add(shape);
        self.pictures.push(inspected);
        true
    }

    /// Returns the board's corners in the last frame, raw pixels; `None` for hidden ones. `None` if
    /// that frame showed no board.
    pub fn corners(&self) -> Option<&[Option<Vector2<f64>>]> {
        self.before.as_deref()
    }

    /// Examines the next frame, and takes it if it is useful.
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
        // The first views may be rather alike; later ones must differ more.
        let wanted = NOVELTY + NOVELTY_PER_VIEW * self.taken.len() as f64;
        let worth = self.taken.worth(&shape);
        if self.taken.len() >= MAX_VIEWS || !(worth.is_worth_it() || worth.novelty > wanted) {
            return Look::Known;
        }
        self.taken.add(shape);
        self.pictures.push(inspect(name, picture, &self.board));
        Look::Taken
    }

    /// Returns the views taken so far.
    pub fn taken(&self) -> &ViewSet {
        &self.taken
    }

    /// Returns the pictures taken; if there are none, one that explains why.
    pub fn finish(self) -> Vec<Inspected> {
        if self.pictures.is_empty() { self.without.into_iter().collect() } else { self.pictures }
    }
}
