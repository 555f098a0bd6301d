//! Sources of frames behind one trait: recorded clips, live cameras and the virtual stage.
//!
//! [`open_clip`] opens a clip of any format and returns its rows one by one; only the current row
//! is held in memory. [`decode_grey`] is the only way from a picture's bytes to grey levels.
//! [`ClipWriter`] writes clips. The readers of single formats are public for callers that have
//! bytes instead of files.

mod avi;
mod bt601;
pub mod camera;
pub mod choice;
mod clip;
mod colour;
mod error;
mod ffmpeg;
mod folder;
pub(crate) mod foreign;
mod grey;
mod jpeg_markers;
mod luma;
mod mjpeg;
mod open;
mod order;
mod picture_stream;
mod played;
mod rate;
mod remarks;
pub(crate) mod repeats;
mod stamp_unit;
pub mod timestamping;
pub(crate) mod timestamps;
mod transparency;
mod video;
mod waiting;
mod writer;
mod y4m;

#[cfg(feature = "live")]
pub mod v4l2;
mod virtual_stage;

use std::sync::Arc;
use std::time::Duration;

pub use avi::AviReader;
pub use colour::decode_colours;
pub use error::CaptureError;
pub use ffmpeg::ffmpeg_account;
pub use folder::PICTURE_EXTENSIONS;
pub use grey::{
    DecodeError, MAX_PICTURE_FILE, decode_grey, decode_on_white, decode_oriented, orientation_words, picture_size, with_huffman_tables,
};
pub use luma::decode_picture;
pub use mjpeg::MjpegReader;
pub use open::{ClipOptions, open_clip, open_clip_in_colour};
pub use order::EntryOrder;
pub use played::PlayedClip;
pub use timestamps::read_timestamps;
pub use writer::{ClipWriter, PictureFormat};
pub use y4m::Y4mReader;

use crate::frame::{Frame, Timestamp};
use image::RgbImage;

pub use virtual_stage::VirtualCamera;

/// One entry of a clip (a row of its timestamps.csv): a frame, or the reason why there is none.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ClipEntry {
    /// Row number from 0.
    pub sequence: u64,
    /// Time of mid-exposure of the middle row.
    pub timestamp: Timestamp,
    /// What the row holds.
    pub content: EntryContent,
    /// Time spent on decoding to grey, without reading and waiting; zero for raw pictures.
    pub decode: Duration,
    /// Whether its picture equals the previous row's byte for byte although this source's pictures
    /// normally differ: no new picture was taken in between.
    pub repeats: bool,
    /// The row's picture before its conversion to grey: always set for a camera (for the recorder),
    /// for a clip only if its colours were requested.
    pub received: Option<Received>,
}

impl ClipEntry {
    /// Creates an entry with content only, and no decoding time.
    pub fn new(sequence: u64, timestamp: Timestamp, content: EntryContent) -> Self {
        Self { sequence, timestamp, content, decode: Duration::ZERO, repeats: false, received: None }
    }
}

/// A row's picture before its conversion to grey.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum Received {
    /// A JPEG; a camera's is cut at its end mark.
    Jpeg(Arc<[u8]>),
    /// A PNG or PNM (PGM etc.). Clips only.
    Picture(Arc<[u8]>),
    /// Decoded colours. Clips only.
    Colours(Arc<RgbImage>),
    /// Raw pixels, of which only the row's grey picture is kept.
    Raw,
    /// Nothing that could be a picture.
    Damaged,
}

/// What a row holds.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum EntryContent {
    /// A picture.
    Frame(Frame),
    /// A picture that could not be decoded. Its time still counts. Holds the reason as a sentence.
    Undecodable(String),
    /// A row that is not tracked: its stamp does not follow the last one (duplicated or out of
    /// order), or its picture's size differs from the clip's. Holds the reason as a sentence.
    Skipped(String),
}

/// A stream of rows: a clip, the virtual stage, a camera.
pub trait FrameSource: Send {
    /// Returns the next row, or `None` at the end.
    fn next_entry(&mut self) -> Option<ClipEntry>;

    /// Announces that rows before a time are too late to be useful: they may be returned as
    /// skipped, which is cheaper than decoding them.
    fn pass_over_before(&mut self, _earliest: Timestamp) {}

    /// Returns width and height of the pictures, pixels.
    fn size(&self) -> (u32, u32);

    /// Returns how many rows there will be, if known.
    fn rows(&self) -> Option<u64>;

    /// Returns a sentence if the stamps cannot be in the unit they are read in; nothing that
    /// depends on times can then be trusted. The sentence is also one of the notes.
    fn doubt_of_stamps(&self) -> Option<String> {
        None
    }

    /// Returns remarks about the pictures seen so far, one sentence each.
    fn notes(&self) -> Vec<String> {
        Vec::new()
    }
}
