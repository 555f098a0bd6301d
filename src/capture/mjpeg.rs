//! Splits concatenated JPEG pictures (.mjpeg, .mjpg) at their markers.

use std::io::{self, Read};

use super::jpeg_markers::{JpegWalk, Walked};

/// A stream of concatenated JPEGs.
#[derive(Debug)]
pub struct MjpegReader<R> {
    input: R,
    /// Bytes read but not yet returned.
    buffer: Vec<u8>,
    at_end: bool,
}

/// Maximum size of a picture, bytes (a round figure); a stream without an end mark is cut here.
/// Raised, such a stream takes more memory before it is cut.
const MAX_PICTURE: usize = 64 << 20;
/// Bytes requested per read: about one webcam picture (chosen, not tuned). Raised, a picture of a
/// live stream waits for the next ones.
const READ_AT_ONCE: u64 = 256 << 10;

impl<R: Read> MjpegReader<R> {
    /// Creates a reader at the start of a stream.
    pub fn new(input: R) -> Self {
        Self { input, buffer: Vec::new(), at_end: false }
    }

    /// Returns the bytes of the next picture. A damaged picture is returned up to the next start
    /// mark, for the decoder to refuse.
    ///
    /// # Errors
    /// When the stream cannot be read; it ends then.
    pub fn next_jpeg(&mut self) -> Option<io::Result<Vec<u8>>> {
        match self.find_next() {
            Ok(Some(length)) => {
                let rest = self.buffer.split_off(length);
                Some(Ok(std::mem::replace(&mut self.buffer, rest)))
            }
            Ok(None) => None,
            Err(e) => {
                self.at_end = true;
                self.buffer.clear();
                Some(Err(e))
            }
        }
    }

    /// Moves the next picture's start to the buffer's start and returns its length.
    fn find_next(&mut self) -> io::Result<Option<usize>> {
        if !self.skip_to_start()? {
            return Ok(None);
        }
        let mut walk = JpegWalk::default();
        loop {
            match walk.advance(&self.buffer) {
                Walked::Whole(end) => return Ok(Some(end)),
                Walked::Unfinished if !self.at_end && self.buffer.len() < MAX_PICTURE => self.read_more()?,
                // Start marks before the first scan are thumbnails, unless the headers themselves
                // are broken.
                Walked::Damaged(_) | Walked::Unfinished => return self.find_start(walk.first_scan.unwrap_or(2)).map(Some),
            }
        }
    }

    /// Drops everything before the next start mark; returns false if there is none.
    fn skip_to_start(&mut self) -> io::Result<bool> {
        loop {
            let start = start_mark(&self.buffer);
            self.buffer.drain(..start.unwrap_or(self.buffer.len().saturating_sub(2)));
            if start.is_some() || self.at_end {
                return Ok(start.is_some());
            }
            self.read_more()?;
        }
    }

    /// Returns the offset of the next start mark at or after `from`, or of the end of the stream or
    /// of the size limit.
    fn find_start(&mut self, from: usize) -> io::Result<usize> {
        let mut from = from;
        loop {
            if let Some(start) = self.buffer.get(from..).and_then(start_mark) {
                return Ok(from + start);
            }
            if self.at_end || self.buffer.len() >= MAX_PICTURE {
                return Ok(self.buffer.len());
            }
            from = from.max(self.buffer.len().saturating_sub(2));
            self.read_more()?;
        }
    }

    fn read_more(&mut self) -> io::Result<()> {
        self.at_end = (&mut self.input).take(READ_AT_ONCE).read_to_end(&mut self.buffer)? == 0;
        Ok(())
    }
}

/// Finds the first SOI that is followed by another marker.
fn start_mark(bytes: &[u8]) -> Option<usize> {
    bytes.windows(3).position(|w| w == [0xFF, 0xD8, 0xFF])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn jpeg(level: u8) -> Vec<u8> {
        let mut bytes = Vec::new();
        let picture = image::GrayImage::from_fn(40, 24, |x, y| image::Luma([level.wrapping_add((x * y) as u8)]));
        picture.write_with_encoder(image::codecs::jpeg::JpegEncoder::new(&mut bytes)).unwrap();
        bytes
    }

    /// Reads `bytes` in pieces of 7, so that picture boundaries fall inside a piece.
    fn split(bytes: &[u8]) -> Vec<Vec<u8>> {
        struct Trickle<'a>(&'a [u8]);
        impl Read for Trickle<'_> {
            fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
                let n = to.len().min(7);
                self.0.read(&mut to[..n])
            }
        }
        let mut reader = MjpegReader::new(Trickle(bytes));
        std::iter::from_fn(|| reader.next_jpeg()).map(Result::unwrap).collect()
    }

    #[test]
    fn whole_pictures_pass_through_unchanged() {
        let pictures: Vec<_> = (0..5).map(|n| jpeg(n * 40)).collect();
        assert_eq!(split(&pictures.concat()), pictures);
        let padded: Vec<u8> = pictures.iter().flat_map(|p| [p, &[0u8; 5][..]].concat()).collect();
        assert_eq!(split(&padded), pictures);
    }

    #[test]
    fn a_thumbnail_does_not_split_its_picture() {
        let (small, large) = (jpeg(1), jpeg(2));
        let length = (small.len() + 2) as u16;
        let with_thumbnail = [&large[..2], &[0xFF, 0xE1], &length.to_be_bytes(), &small, &large[2..]].concat();
        assert_eq!(split(&[&with_thumbnail[..], &large].concat()), [with_thumbnail.clone(), large.clone()]);
    }

    #[test]
    fn a_truncated_picture_loses_only_itself() {
        let (a, b) = (jpeg(1), jpeg(2));
        let cut = &a[..a.len() - 20];
        assert_eq!(split(&[cut, &b, cut].concat()), [cut.to_vec(), b, cut.to_vec()]);
        assert!(split(b"nothing here").is_empty());
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic(mut bytes in prop::collection::vec(prop_oneof![any::<u8>(), Just(0xFFu8), Just(0xD8), Just(0xD9), Just(0xDA)], 0..300)) {
            let total: usize = split(&bytes).iter().map(Vec::len).sum();
            prop_assert!(total <= bytes.len());
            bytes.splice(0..0, [0xFF, 0xD8, 0xFF]);
            prop_assert!(!split(&bytes).is_empty());
        }
    }
}
