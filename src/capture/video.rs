//! Clips that are one file or a pipe: .y4m, MJPEG .avi and .mjpeg as picture streams.

use std::io::{BufRead, Read};

use super::avi::AviReader;
use super::mjpeg::MjpegReader;
use super::picture_stream::{Picture, PictureData, PictureStream};
use super::rate::FrameRate;
use super::y4m::Y4mReader;

/// A reader's pictures at a constant rate.
pub(super) struct Paced<R> {
    reader: R,
    rate: FrameRate,
    total: Option<u64>,
    next: u64,
    notes: Vec<String>,
}

impl<R> Paced<R> {
    /// Creates a stream; `total` is the number of all pictures, if known.
    pub fn new(reader: R, rate: FrameRate, total: Option<u64>) -> Self {
        Self { reader, rate, total, next: 0, notes: Vec::new() }
    }

    /// Adds a remark about the clip.
    pub fn with_note(mut self, note: Option<String>) -> Self {
        self.notes.extend(note);
        self
    }
}

/// A reader of one video format.
pub(super) trait VideoReader: Send {
    fn next_data(&mut self) -> Option<PictureData>;

    /// Whether the format guarantees that all pictures have the same size.
    fn is_of_one_size(&self) -> bool {
        false
    }
}

impl<R: VideoReader> PictureStream for Paced<R> {
    fn next_picture(&mut self) -> Option<Picture> {
        let data = self.reader.next_data()?;
        let stamp = Ok(self.rate.stamp(self.next));
        self.next += 1;
        Some(Picture { stamp, data })
    }

    fn is_of_one_size(&self) -> bool {
        self.reader.is_of_one_size()
    }

    fn take_notes(&mut self) -> Vec<String> {
        std::mem::take(&mut self.notes)
    }

    fn pictures(&self) -> Option<u64> {
        self.total.map(|total| total.saturating_sub(self.next))
    }
}

impl<R: BufRead + Send> VideoReader for Y4mReader<R> {
    fn next_data(&mut self) -> Option<PictureData> {
        Some(match self.next_luma()? {
            Ok(luma) => match self.colours(&luma) {
                Some(colours) => PictureData::Coloured(luma, colours),
                None => PictureData::Grey(luma),
            },
            Err(reason) => PictureData::Missing(reason),
        })
    }

    fn is_of_one_size(&self) -> bool {
        true
    }
}

impl<R: Read + Send> VideoReader for AviReader<R> {
    fn next_data(&mut self) -> Option<PictureData> {
        Some(match self.next_jpeg()? {
            Ok(bytes) if bytes.is_empty() => PictureData::Missing("the recorder dropped this frame".to_owned()),
            Ok(bytes) => PictureData::Encoded(bytes),
            Err(reason) => PictureData::Missing(reason),
        })
    }
}

impl<R: Read + Send> VideoReader for MjpegReader<R> {
    fn next_data(&mut self) -> Option<PictureData> {
        let unreadable = |e| PictureData::Missing(format!("the file cannot be read on: {e}"));
        Some(self.next_jpeg()?.map_or_else(unreadable, PictureData::Encoded))
    }
}
