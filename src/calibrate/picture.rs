//! One inspected picture: its board or the reason why there is none, and what its file states.

use std::path::PathBuf;

use image::GrayImage;

use super::board::Board;
use super::finder::{FoundBoard, NoBoard, find_board};
use super::origin::Origin;
use super::other_target::Target;
use super::recompute::BoardPatch;

/// What one picture yields before anything is estimated.
#[derive(Debug, Clone)]
pub struct Inspected {
    /// Name of the picture, for messages.
    pub file: PathBuf,
    /// Width and height, pixels; `None` if it cannot be read.
    pub size: Option<(u32, u32)>,
    /// The board, or why there is none.
    pub board: Result<FoundBoard, String>,
    /// Inner corners of another board that was seen instead, and whether more of it may lie outside
    /// the picture.
    pub other_size: Option<((u32, u32), bool)>,
    /// The kind of target that was seen instead, if it is no chessboard.
    pub other_target: Option<Target>,
    pub(crate) patch: Option<BoardPatch>,
    /// A small copy for the report.
    pub thumbnail: Option<GrayImage>,
    /// What the file states about the camera.
    pub origin: Origin,
}

/// Longer side of the report's thumbnails, pixels: enough to recognise the corners. Raised, the
/// report's file grows with its square.
const THUMBNAIL_PX: u32 = 360;

/// Searches for the board in one picture.
pub fn inspect(file: PathBuf, picture: &GrayImage, board: &Board) -> Inspected {
    let size = picture.dimensions();
    let found = find_board(picture, board);
    let other_size = match &found {
        Err(NoBoard::OtherSize { columns, rows, cut, .. }) => Some(((*columns, *rows), *cut)),
        _ => None,
    };
    let other_target = if found.is_err() { Target::seen_in(picture) } else { None };
    let patch = found.as_ref().ok().map(|found| BoardPatch::cut(picture, found));
    let scale = (f64::from(THUMBNAIL_PX) / f64::from(size.0.max(size.1))).min(1.0);
    let side = |s: u32| ((f64::from(s) * scale).round() as u32).max(1);
    let thumbnail = Some(image::imageops::thumbnail(picture, side(size.0), side(size.1)));
    let board = found.map_err(|e| e.to_string());
    Inspected { file, size: Some(size), board, other_size, other_target, patch, thumbnail, origin: Origin::default() }
}

impl Inspected {
    /// Describes a picture that cannot be read, with the reason.
    pub fn unreadable(file: PathBuf, reason: String) -> Self {
        let (board, origin) = (Err(reason), Origin::default());
        Self { file, size: None, board, other_size: None, other_target: None, patch: None, thumbnail: None, origin }
    }

    /// Adds what the picture's file states about the camera.
    pub fn taken_by(self, origin: Origin) -> Self {
        Self { origin, ..self }
    }
}
