//! Where frames come from: recorded clips and the virtual stage, behind one trait.

mod virtual_stage;

use std::time::Duration;

use crate::frame::Frame;

pub use virtual_stage::VirtualCamera;

/// One row of a clip: a frame, or why there is none.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// Row number from 0.
    pub sequence: u64,
    /// Mid-exposure of the middle row, monotonic nanoseconds.
    pub timestamp_ns: i64,
    /// What the row holds.
    pub content: RowContent,
    /// Time spent on decoding it.
    pub decode: Duration,
}

/// What a row holds.
#[derive(Debug, Clone, PartialEq)]
pub enum RowContent {
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
    fn next_row(&mut self) -> Option<Row>;

    /// Width and height of the pictures, pixels.
    fn size(&self) -> (u32, u32);

    /// How many rows there will be, where that is known.
    fn rows(&self) -> Option<u64>;

    /// Hands a picture buffer back for reuse.
    fn recycle(&mut self, _image: image::GrayImage) {}
}
