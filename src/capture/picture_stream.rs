//! The interface of every clip format: its pictures one by one, with their stamps, in file order.

use image::{GrayImage, RgbImage};

use super::error::CaptureError;
use crate::frame::Timestamp;

/// A picture as it lies in the clip.
pub(super) struct Picture {
    /// When it was taken, or why that is unknown.
    pub stamp: Result<Timestamp, String>,
    /// The picture data.
    pub data: PictureData,
}

/// A picture's data.
pub(super) enum PictureData {
    /// A JPEG, PNG or PGM.
    Encoded(Vec<u8>),
    /// Grey levels.
    Grey(GrayImage),
    /// Grey levels, with the requested colours.
    Coloured(GrayImage, RgbImage),
    /// No data, with the reason.
    Missing(String),
}

/// Pictures with their stamps, in file order.
pub(super) trait PictureStream: Send {
    /// Returns the next picture, or `None` at the end.
    fn next_picture(&mut self) -> Option<Picture>;

    /// Returns how many pictures remain, if known.
    fn pictures(&self) -> Option<u64> {
        None
    }

    /// Whether the format guarantees that all pictures have the same size.
    fn is_of_one_size(&self) -> bool {
        false
    }

    /// Returns the remarks about the file since the last call, one sentence each.
    fn take_notes(&mut self) -> Vec<String> {
        Vec::new()
    }

    /// Returns the stamps of the next pictures as far as they are known, without those that cannot
    /// be parsed.
    fn stamps_ahead(&self) -> Vec<Timestamp> {
        Vec::new()
    }

    /// Returns why the stamps cannot be in the unit they are read in.
    fn doubt_of_stamps(&self) -> Option<String> {
        None
    }

    /// Returns why the stream ended before its first picture, if that is an error of its own.
    fn failure(&mut self) -> Option<CaptureError> {
        None
    }
}
