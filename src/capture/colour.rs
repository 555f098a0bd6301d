//! The colours of a clip's pictures, for viewers. Tracking uses grey only.
//!
//! Rows carry the colours next to the grey frame, encoded as in the clip. [`Received::colours`]
//! decodes them on demand.

use std::io::Cursor;
use std::sync::Arc;

use image::{GrayImage, ImageFormat, ImageReader, RgbImage};
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use super::Received;
use super::error::CaptureError;
use super::ffmpeg::Ffmpeg;
use super::grey::{check_size, picture_size, sound_jpeg};
use super::picture_stream::{Picture, PictureData, PictureStream};
use crate::contain::contained;

impl Received {
    /// Returns the picture in colour, with its pixels as they lie in the file; `None` if there are
    /// no colours or they cannot be read.
    pub fn colours(&self) -> Option<Arc<RgbImage>> {
        match self {
            Self::Jpeg(bytes) | Self::Picture(bytes) => decode_colours(bytes).map(Arc::new),
            Self::Colours(picture) => Some(Arc::clone(picture)),
            Self::Raw | Self::Damaged => None,
        }
    }
}

/// Wraps a picture's bytes as a row carries them.
pub(super) fn received(bytes: Vec<u8>) -> Received {
    let is_jpeg = bytes.starts_with(&[0xFF, 0xD8]);
    let bytes = Arc::from(bytes);
    if is_jpeg { Received::Jpeg(bytes) } else { Received::Picture(bytes) }
}

/// Decodes JPEG, PNG or PNM bytes to colours, with the pixels as they lie in the file; `None` if
/// they are no such picture.
pub fn decode_colours(bytes: &[u8]) -> Option<RgbImage> {
    let colours = || if bytes.starts_with(&[0xFF, 0xD8]) { jpeg_colours(bytes) } else { picture_colours(bytes) };
    contained(colours).ok().flatten()
}

fn jpeg_colours(bytes: &[u8]) -> Option<RgbImage> {
    let (width, height) = picture_size(bytes)?;
    check_size(width, height).ok()?;
    let (whole, _) = sound_jpeg(bytes).ok()?;
    let options = DecoderOptions::default().jpeg_set_out_colorspace(ColorSpace::RGB);
    RgbImage::from_raw(width, height, JpegDecoder::new_with_options(Cursor::new(whole), options).decode().ok()?)
}

fn picture_colours(bytes: &[u8]) -> Option<RgbImage> {
    let format = image::guess_format(bytes).ok().filter(|format| matches!(format, ImageFormat::Png | ImageFormat::Pnm))?;
    let (width, height) = picture_size(bytes)?;
    check_size(width, height).ok()?;
    Some(ImageReader::with_format(Cursor::new(bytes), format).decode().ok()?.into_rgb8())
}

/// Layout of the chroma planes that follow the luma plane in raw video.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Chroma {
    /// Luma samples per chroma sample, horizontally.
    pub across: u32,
    /// Luma samples per chroma sample, vertically.
    pub down: u32,
    /// Whether levels run from 0 to 255 instead of 16 to 235 (chroma: 16 to 240).
    pub is_full_range: bool,
}

/// Minimum number of lines for which unlabelled video is taken as HD (BT.709); players guess the
/// same. A wrong matrix shifts the colours slightly; greys do not change.
const HD_LINES: u32 = 720;

impl Chroma {
    /// Returns the bytes of one chroma plane.
    pub fn plane_bytes(self, (width, height): (u32, u32)) -> u64 {
        u64::from(width.div_ceil(self.across)) * u64::from(height.div_ceil(self.down))
    }

    /// Converts to RGB; `None` if `planes` does not hold both chroma planes.
    pub fn colours(self, luma: &GrayImage, planes: &[u8]) -> Option<RgbImage> {
        let size = luma.dimensions();
        let plane = self.plane_bytes(size) as usize;
        let (blue, red) = planes.get(..2 * plane)?.split_at(plane);
        // Weights of red and blue in the luma.
        let (kr, kb) = if size.1 >= HD_LINES { (0.2126_f32, 0.0722_f32) } else { (0.299, 0.114) };
        let (floor, luma_gain, chroma_gain) = if self.is_full_range { (0.0, 1.0, 1.0) } else { (16.0, 255.0 / 219.0, 255.0 / 224.0) };
        let stride = size.0.div_ceil(self.across);
        Some(RgbImage::from_fn(size.0, size.1, |x, y| {
            let at = ((y / self.down) * stride + x / self.across) as usize;
            let level = (f32::from(luma.get_pixel(x, y).0[0]) - floor) * luma_gain;
            let (cb, cr) = ((f32::from(blue[at]) - 128.0) * chroma_gain, (f32::from(red[at]) - 128.0) * chroma_gain);
            let (r, b) = (level + 2.0 * (1.0 - kr) * cr, level + 2.0 * (1.0 - kb) * cb);
            let g = (level - kr * r - kb * b) / (1.0 - kr - kb);
            // The cast saturates.
            image::Rgb([r, g, b].map(|v| v.round() as u8))
        }))
    }
}

/// A clip read by ffmpeg, with a second ffmpeg process for the colours, in step picture by picture.
pub(super) struct Coloured {
    grey: Ffmpeg,
    colours: Ffmpeg,
}

impl Coloured {
    /// Pairs two readers of the same file.
    pub fn new(grey: Ffmpeg, colours: Ffmpeg) -> Self {
        Self { grey, colours }
    }
}

impl PictureStream for Coloured {
    fn next_picture(&mut self) -> Option<Picture> {
        let mut picture = self.grey.next_picture()?;
        let colours = self.colours.next_colours();
        picture.data = match (picture.data, colours) {
            (PictureData::Grey(grey), Some(colours)) => PictureData::Coloured(grey, colours),
            (data, _) => data,
        };
        Some(picture)
    }

    fn failure(&mut self) -> Option<CaptureError> {
        self.grey.failure()
    }

    fn take_notes(&mut self) -> Vec<String> {
        self.grey.take_notes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn raw_video_converts_to_the_original_colours() {
        // Pure red, green and blue in BT.601, in both ranges, from the standard's formulas.
        let cases = [
            (false, [81, 90, 240], [255, 0, 0]),
            (false, [145, 54, 34], [0, 255, 0]),
            (false, [41, 240, 110], [0, 0, 255]),
            (true, [76, 85, 255], [255, 0, 0]),
            (false, [235, 128, 128], [255, 255, 255]),
        ];
        for (is_full_range, [y, cb, cr], wanted) in cases {
            let chroma = Chroma { across: 2, down: 2, is_full_range };
            let planes: Vec<u8> = [vec![cb; 6], vec![cr; 6]].concat();
            let picture = chroma.colours(&GrayImage::from_pixel(5, 3, image::Luma([y])), &planes).unwrap();
            for (level, wanted) in picture.get_pixel(4, 2).0.iter().zip(wanted) {
                assert!((i32::from(*level) - wanted).abs() <= 2, "{:?} {wanted}", picture.get_pixel(4, 2));
            }
            assert_eq!(chroma.colours(&GrayImage::new(5, 3), &planes[..11]), None);
        }
    }

    #[test]
    fn encoded_pictures_keep_their_colours() {
        let wanted = RgbImage::from_pixel(32, 16, image::Rgb([200, 40, 90]));
        for format in [ImageFormat::Png, ImageFormat::Jpeg, ImageFormat::Pnm] {
            let mut bytes = Cursor::new(Vec::new());
            wanted.write_to(&mut bytes, format).unwrap();
            let seen = received(bytes.into_inner()).colours().unwrap();
            let off = seen.pixels().zip(wanted.pixels()).flat_map(|(a, b)| a.0.into_iter().zip(b.0)).map(|(a, b)| a.abs_diff(b)).max();
            assert!(seen.dimensions() == (32, 16) && off <= Some(3), "{format:?} {off:?}");
        }
        assert_eq!(received(b"\xFF\xD8no".to_vec()).colours(), None);
        assert_eq!(received(b"P6 nonsense".to_vec()).colours(), None);
    }
}
