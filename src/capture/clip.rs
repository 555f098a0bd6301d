//! What is common to all clips: decoding, numbering, and the rules for rows that are no frames.
//!
//! Each form of clip is a [`PictureStream`] that gives pictures with their stamps as they lie in the file. A
//! [`Clip`] turns them into rows: it decodes, refuses stamps that do not increase and pictures of another size
//! than the first, and numbers every row whatever became of it.

use std::collections::VecDeque;
use std::path::Path;
use std::time::{Duration, Instant};

use image::GrayImage;

use super::error::CaptureError;
use super::grey::decode_grey;
use super::order::RowOrder;
use super::{FrameSource, Row, RowContent};
use crate::frame::Frame;

/// A picture as it lies in the clip.
pub(super) struct Picture {
    /// Nanoseconds, or why they cannot be told.
    pub stamp: Result<i64, String>,
    /// The picture.
    pub data: PictureData,
}

/// What there is of a picture.
pub(super) enum PictureData {
    /// A JPEG, PNG or PGM.
    Encoded(Vec<u8>),
    /// Grey levels.
    Grey(GrayImage),
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

    /// Why the stream ended before its first picture, where that is a failure of its own.
    fn failure(&mut self) -> Option<CaptureError> {
        None
    }
}

/// A clip as a source of rows.
pub(super) struct Clip {
    stream: Box<dyn PictureStream>,
    rows: Option<u64>,
    /// Rows that were read to find the size.
    ahead: VecDeque<Row>,
    size: Option<(u32, u32)>,
    order: RowOrder,
}

impl Clip {
    /// Reads up to the first frame, without losing a row.
    ///
    /// # Errors
    /// When the stream has no rows, or no frame among them; `path` is for the message.
    pub fn new(stream: Box<dyn PictureStream>, path: &Path) -> Result<Self, CaptureError> {
        let mut clip = Self { rows: stream.pictures(), stream, ahead: VecDeque::new(), size: None, order: RowOrder::default() };
        while clip.size.is_none() {
            match clip.read_row() {
                Some(row) => clip.ahead.push_back(row),
                None => return Err(clip.no_frame(path)),
            }
        }
        Ok(clip)
    }

    fn no_frame(&mut self, path: &Path) -> CaptureError {
        let path = path.to_owned();
        match (self.ahead.front(), self.stream.failure()) {
            (_, Some(failure)) => failure,
            (None, None) => CaptureError::Empty { path },
            (Some(row), None) => {
                let reason = match &row.content {
                    RowContent::Undecodable(reason) | RowContent::Skipped(reason) => reason.clone(),
                    RowContent::Frame(_) => String::new(),
                };
                CaptureError::NoFrameReadable { path, rows: self.order.rows(), reason }
            }
        }
    }

    fn read_row(&mut self) -> Option<Row> {
        let picture = self.stream.next_picture()?;
        let sequence = self.order.number();
        let skipped = |timestamp_ns, reason| Row {
            sequence,
            timestamp_ns,
            content: RowContent::Skipped(reason),
            decode: Duration::ZERO,
            received: None,
        };
        let timestamp_ns = match picture.stamp {
            Err(reason) => return Some(skipped(self.order.last_stamp_ns().unwrap_or(0), reason)),
            Ok(stamp) => stamp,
        };
        if let Err(reason) = self.order.follow(timestamp_ns) {
            return Some(skipped(timestamp_ns, reason));
        }
        let start = Instant::now();
        let image = match picture.data {
            PictureData::Encoded(bytes) => decode_grey(&bytes).map_err(|e| e.to_string()),
            PictureData::Grey(image) => Ok(image),
            PictureData::Missing(reason) => Err(reason),
        };
        let decode = start.elapsed();
        let content = match image {
            Ok(image) => self.frame_or_skip(image, timestamp_ns, sequence),
            Err(reason) => RowContent::Undecodable(reason),
        };
        Some(Row { sequence, timestamp_ns, content, decode, received: None })
    }

    /// The first frame sets the clip's size, the others must have it.
    fn frame_or_skip(&mut self, image: GrayImage, timestamp_ns: i64, sequence: u64) -> RowContent {
        let (width, height) = *self.size.get_or_insert(image.dimensions());
        if image.dimensions() == (width, height) {
            return RowContent::Frame(Frame { image, timestamp_ns, sequence });
        }
        RowContent::Skipped(format!("the picture is {} x {} pixels, the clip's are {width} x {height}", image.width(), image.height()))
    }
}

impl FrameSource for Clip {
    fn next_row(&mut self) -> Option<Row> {
        self.ahead.pop_front().or_else(|| self.read_row())
    }

    fn size(&self) -> (u32, u32) {
        self.size.unwrap_or_default() // set before `new` returns
    }

    fn rows(&self) -> Option<u64> {
        self.rows
    }
}
