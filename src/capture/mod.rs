//! Where frames come from: recorded clips and the virtual stage, behind one trait.
//!
//! [`open_clip`] takes a clip of any form and gives its rows one by one; nothing is held in memory but the row
//! at hand. [`decode_grey`] is the one way from a picture's bytes to grey levels. [`ClipWriter`] writes clips.
//! The readers of single formats are public for those who have bytes instead of files.

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
pub use error::CaptureError;
pub use ffmpeg::ffmpeg_account;
pub use folder::PICTURE_EXTENSIONS;
pub use grey::{
    DecodeError, LARGEST_PICTURE_FILE, decode_grey, decode_on_white, decode_oriented, orientation_words, picture_size, with_huffman_tables,
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

/// One entry of a clip (a row of its timestamps.csv): a frame, or why there is none.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ClipEntry {
    /// Row number from 0.
    pub sequence: u64,
    /// Mid-exposure of the middle row.
    pub timestamp: Timestamp,
    /// What the row holds.
    pub content: EntryContent,
    /// Time spent on turning its bytes into grey levels; reading and waiting excluded, zero for raw pictures.
    pub decode: Duration,
    /// Whether its picture is that of the row before, byte for byte, though pictures of this source
    /// differ: none was taken in between.
    pub repeats: bool,
    /// What the row's picture was before it became grey: of a camera for the recorder, of a clip only where its colours were asked for.
    pub received: Option<Received>,
}

impl ClipEntry {
    /// An entry that took no time to decode, and of which nothing but its content is known.
    pub fn new(sequence: u64, timestamp: Timestamp, content: EntryContent) -> Self {
        Self { sequence, timestamp, content, decode: Duration::ZERO, repeats: false, received: None }
    }
}

/// What a row's picture was before it became grey.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum Received {
    /// A JPEG; a camera's is cut at its end mark.
    Jpeg(Arc<[u8]>),
    /// A PNG, or PGM and its kin. Clips only.
    Picture(Arc<[u8]>),
    /// Decoded colours. Clips only.
    Colours(Arc<RgbImage>),
    /// Raw pixels; the row's grey picture is all that is kept of them.
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
    /// A picture that could not be read; time went on all the same. Holds the reason as a sentence.
    Undecodable(String),
    /// A row whose stamp does not follow the last one (duplicated or out of order), or whose picture has
    /// another size than the clip's; it is not tracked. Holds the reason as a sentence.
    Skipped(String),
}

/// A stream of rows: a clip, the virtual stage, a camera.
pub trait FrameSource: Send {
    /// The next row, or `None` at the end.
    fn next_entry(&mut self) -> Option<ClipEntry>;

    /// Says that rows before a time are too late to be of use: they may come as skipped ones, which costs less than decoding them.
    fn pass_over_before(&mut self, _earliest: Timestamp) {}

    /// Width and height of the pictures, pixels.
    fn size(&self) -> (u32, u32);

    /// How many rows there will be, where that is known.
    fn rows(&self) -> Option<u64>;

    /// Why the stamps cannot be what they are read as, in a sentence that is one of the notes, too: nothing that depends on times is to be
    /// believed then.
    fn doubt_of_stamps(&self) -> Option<String> {
        None
    }

    /// What is to be said of the pictures seen so far, a sentence each.
    fn notes(&self) -> Vec<String> {
        Vec::new()
    }
}
