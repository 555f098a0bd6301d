//! Logic common to all clips: decoding, numbering, and the rules for rows that are not frames.
//!
//! Each clip format is a [`PictureStream`] that returns pictures and stamps in file order. A
//! [`Clip`] turns them into rows: it decodes, refuses stamps that do not increase and pictures
//! whose size differs from the clip's, and numbers every row regardless of the outcome.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use image::metadata::Orientation;

use super::error::CaptureError;
use super::grey::{decode_oriented, orientation_words};
use super::order::EntryOrder;
use super::picture_stream::{PictureData, PictureStream};
use super::repeats::Repeats;
use super::{ClipEntry, EntryContent, FrameSource, Received, colour};
use crate::frame::{Frame, Timestamp};

/// A clip as a source of rows.
pub(super) struct Clip {
    stream: Box<dyn PictureStream>,
    rows: Option<u64>,
    /// Rows that were read to determine the size.
    ahead: VecDeque<ClipEntry>,
    /// Width and height of the clip's pictures, once determined.
    size: Option<(u32, u32)>,
    order: EntryOrder,
    /// Remarks about the clip, one sentence each.
    notes: Vec<String>,
    /// Whether a picture was seen whose file asks to show it rotated or mirrored.
    is_turned: bool,
    /// Whether rows also carry the picture before its conversion to grey.
    keeps_colours: bool,
    /// Rows before this time are not decoded.
    earliest: Option<Timestamp>,
    /// Detects repeated encoded pictures. Raw pictures are not compared: their video may repeat
    /// frames.
    repeats: Repeats,
}

/// Maximum number of pictures inspected to determine the clip's size, so that a stray first picture
/// does not decide it (chosen, not tuned). Raised, more leading strays are tolerated, but opening
/// takes longer.
const LOOKED_AT: usize = 8;
/// Maximum bytes of pictures held meanwhile: eight pictures of 33 million pixels. Beyond it fewer
/// pictures decide. Raised, opening takes more memory.
const MAX_AHEAD_BYTES: u64 = 256 << 20;

impl Clip {
    /// Reads up to the first frames without losing a row. If the pictures differ in size, the
    /// clip's size is the calibration's, else one of its shape, else the most frequent.
    ///
    /// # Errors
    /// When the stream has no rows, or no frame among the rows read; `path` is used in the message.
    pub fn new(
        stream: Box<dyn PictureStream>,
        path: &Path,
        calibrated: Option<(u32, u32)>,
        keeps_colours: bool,
    ) -> Result<Self, CaptureError> {
        let (rows, order) = (stream.pictures(), EntryOrder::default());
        let mut clip = Self {
            rows,
            stream,
            ahead: VecDeque::new(),
            size: None,
            order,
            notes: Vec::new(),
            is_turned: false,
            keeps_colours,
            earliest: None,
            repeats: Repeats::default(),
        };
        clip.notes.extend(clip.stream.doubt_of_stamps());
        let mut sizes: Vec<(u32, u32)> = Vec::new();
        let is_enough = |sizes: &[(u32, u32)], one: bool| {
            let bytes: u64 = sizes.iter().map(|(w, h)| u64::from(*w) * u64::from(*h)).sum();
            let known = sizes.last().is_some_and(|last| one || Some(*last) == calibrated);
            known || sizes.len() >= LOOKED_AT || bytes > MAX_AHEAD_BYTES
        };
        while !is_enough(&sizes, clip.stream.is_of_one_size()) {
            let Some(row) = clip.read_row() else { break };
            if let EntryContent::Frame(frame) = &row.content {
                sizes.push(frame.image.dimensions());
            }
            clip.ahead.push_back(row);
        }
        let Some(size) = chosen(&sizes, calibrated) else { return Err(clip.no_frame(path)) };
        clip.size = Some(size);
        for row in &mut clip.ahead {
            skip_other_sizes(&mut row.content, size);
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
                    EntryContent::Undecodable(reason) | EntryContent::Skipped(reason) => reason.clone(),
                    EntryContent::Frame(_) => String::new(),
                };
                CaptureError::NoFrameReadable { path, rows: self.order.rows(), reason }
            }
        }
    }

    fn read_row(&mut self) -> Option<ClipEntry> {
        let picture = self.stream.next_picture();
        self.stream.take_notes().into_iter().for_each(|note| self.note(note));
        let picture = picture?;
        let sequence = self.order.number();
        let skipped = |timestamp, reason| ClipEntry {
            sequence,
            timestamp,
            content: EntryContent::Skipped(reason),
            decode: Duration::ZERO,
            repeats: false,
            received: None,
        };
        let timestamp = match picture.stamp {
            Err(reason) => return Some(skipped(self.order.last_stamp().unwrap_or_default(), reason)),
            Ok(stamp) => stamp,
        };
        match self.order.follow(timestamp, &self.stream.stamps_ahead()) {
            Err(reason) => return Some(skipped(timestamp, reason)),
            Ok(word) => word.into_iter().for_each(|word| self.note(format!("row {sequence}: {word}"))),
        }
        if self.earliest.is_some_and(|earliest| timestamp < earliest) {
            return Some(skipped(timestamp, "its picture was skipped: it was too late to be played".to_owned()));
        }
        let start = Instant::now();
        let mut repeats = false;
        let (image, received) = match picture.data {
            PictureData::Encoded(bytes) => {
                repeats = self.repeats.is_repeat(bytes.clone());
                let decoded = decode_oriented(&bytes).map_err(|e| e.to_string()).map(|(image, orientation)| {
                    self.note_turned(orientation, sequence);
                    image
                });
                (decoded, self.keeps_colours.then(|| colour::received(bytes)))
            }
            PictureData::Grey(image) => (Ok(image), None),
            PictureData::Coloured(image, colours) => (Ok(image), Some(Received::Colours(Arc::new(colours)))),
            PictureData::Missing(reason) => (Err(reason), None),
        };
        let decode = start.elapsed();
        let mut content = match image {
            Ok(image) => EntryContent::Frame(Frame { image, timestamp, sequence }),
            Err(reason) => EntryContent::Undecodable(reason),
        };
        if let Some(size) = self.size {
            skip_other_sizes(&mut content, size);
        }
        Some(ClipEntry { sequence, timestamp, content, decode, repeats, received })
    }

    /// Keeps a remark for whoever opened the clip; later remarks are also logged.
    fn note(&mut self, note: String) {
        if self.size.is_some() {
            tracing::warn!("{note}");
        }
        self.notes.push(note);
    }

    fn note_turned(&mut self, orientation: Orientation, sequence: u64) {
        let Some(words) = orientation_words(orientation).filter(|_| !self.is_turned) else { return };
        self.is_turned = true;
        self.note(format!(
            "row {sequence}: the file says to show its picture {words} (EXIF); clips are tracked as stored in the file, which is how the \
             camera is calibrated"
        ));
    }
}

/// Chooses the clip's size from those of its first pictures.
fn chosen(sizes: &[(u32, u32)], calibrated: Option<(u32, u32)>) -> Option<(u32, u32)> {
    let shape = |(w, h): (u32, u32)| f64::from(w) / f64::from(h);
    let rank = |size: &(u32, u32)| {
        let has_shape = calibrated.is_some_and(|c| (shape(c) / shape(*size) - 1.0).abs() < 0.01);
        (Some(*size) == calibrated, has_shape, sizes.iter().filter(|s| *s == size).count())
    };
    // `max_by_key` returns the last of equals; reversing makes the earliest win.
    sizes.iter().rev().max_by_key(|size| rank(size)).copied()
}

/// Turns a picture of another size than the clip's into a skipped row.
fn skip_other_sizes(content: &mut EntryContent, (width, height): (u32, u32)) {
    if let EntryContent::Frame(Frame { image, .. }) = content
        && image.dimensions() != (width, height)
    {
        let (w, h) = image.dimensions();
        *content = EntryContent::Skipped(format!("the picture is {w} x {h} pixels, the clip's are {width} x {height}"));
    }
}

impl FrameSource for Clip {
    fn next_entry(&mut self) -> Option<ClipEntry> {
        self.ahead.pop_front().or_else(|| self.read_row())
    }

    fn pass_over_before(&mut self, earliest: Timestamp) {
        self.earliest = Some(earliest);
    }

    fn size(&self) -> (u32, u32) {
        self.size.unwrap_or_default() // set before `new` returns
    }

    fn rows(&self) -> Option<u64> {
        self.rows
    }

    fn doubt_of_stamps(&self) -> Option<String> {
        self.stream.doubt_of_stamps()
    }

    fn notes(&self) -> Vec<String> {
        self.notes.clone()
    }
}
