//! What every form of clip gives: its pictures one by one, with their stamps, as they lie in the file.

use image::{GrayImage, RgbImage};

use super::error::CaptureError;
use crate::frame::Timestamp;

/// A picture as it lies in the clip.
pub(super) struct Picture {
    /// When it was taken, or why that is not known.
    pub stamp: Result<Timestamp, String>,
    /// The picture.
    pub data: PictureData,
}

/// What there is of a picture.
pub(super) enum PictureData {
    /// A JPEG, PNG or PGM.
    Encoded(Vec<u8>),
    /// Grey levels.
    Grey(GrayImage),
    /// Grey levels, and the colours that were asked for.
    Coloured(GrayImage, RgbImage),
    /// Nothing, and why.
    Missing(String),
}

/// Pictures with their stamps, in the order of the clip.
pub(super) trait PictureStream: Send {
    /// The next picture, or `None` at the end.
    fn next_picture(&mut self) -> Option<Picture>;

    /// How many there are from here to the end, where that is known.
    fn pictures(&self) -> Option<u64> {
        None
    }

    /// Whether all pictures are of one size, by the clip's form.
    fn is_of_one_size(&self) -> bool {
        false
    }

    /// What is to be said of the file since the last call, a sentence each.
    fn take_notes(&mut self) -> Vec<String> {
        Vec::new()
    }

    /// The stamps of the next pictures, as far as they are known; those that cannot be read are left out.
    fn stamps_ahead(&self) -> Vec<Timestamp> {
        Vec::new()
    }

    /// Why the stamps cannot be what they are read as.
    fn doubt_of_stamps(&self) -> Option<String> {
        None
    }

    /// Why the stream ended before its first picture, where that is a failure of its own.
    fn failure(&mut self) -> Option<CaptureError> {
        None
    }
}
