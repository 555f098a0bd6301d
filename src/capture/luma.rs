//! Converts a live camera's picture to grey, by the same rules as a recorded one.
//!
//! JPEG goes through [`decode_grey`], cut at its end mark first: drivers deliver whole buffers with
//! stale bytes behind the picture. YUYV and NV12 return their luma unchanged; RGB is converted by
//! BT.601.

use std::sync::Arc;

use image::GrayImage;

use super::bt601::luma_8;
use super::camera::{CapturedPicture, PixelLayout};
use super::grey::decode_grey;
use super::jpeg_markers::{JpegWalk, Walked};
use super::{EntryContent, Received};
use crate::frame::{Frame, Timestamp};

/// A decoded picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Decoded {
    /// The grey picture, or a sentence why there is none.
    pub image: Result<GrayImage, String>,
    /// What to record of it.
    pub received: Received,
}

/// Decodes a picture of `size` pixels.
pub fn decode_picture(picture: &CapturedPicture, layout: PixelLayout, size: (u32, u32)) -> Decoded {
    let damaged = |reason: String| Decoded { image: Err(reason), received: Received::Damaged };
    if picture.is_damaged {
        return damaged("the driver says that the picture is damaged".to_owned());
    }
    if layout == PixelLayout::Mjpeg {
        let jpeg = cut_at_end(&picture.bytes);
        let image = decode_grey(jpeg).map_err(|e| e.to_string());
        return Decoded { image, received: if jpeg.is_empty() { Received::Damaged } else { Received::Jpeg(Arc::from(jpeg)) } };
    }
    match raw(&picture.bytes, layout, size) {
        Some(image) => Decoded { image: Ok(image), received: Received::Raw },
        None => {
            let (width, height) = size;
            damaged(format!("the picture has {} bytes, too few for {width} x {height} pixels of {}", picture.bytes.len(), layout.fourcc()))
        }
    }
}

impl Decoded {
    /// Returns a row's content. Pictures whose size differs from the session's are skipped.
    pub fn content(self, size: (u32, u32), timestamp: Timestamp, sequence: u64) -> (EntryContent, Received) {
        let content = match self.image {
            Ok(image) if image.dimensions() == size => EntryContent::Frame(Frame { image, timestamp, sequence }),
            Ok(image) => EntryContent::Skipped(format!(
                "the picture is {} x {} pixels, the camera's are {} x {}",
                image.width(),
                image.height(),
                size.0,
                size.1
            )),
            Err(reason) => EntryContent::Undecodable(reason),
        };
        (content, self.received)
    }
}

/// Returns the JPEG up to its end mark; all bytes if it has none (a truncated picture, which the
/// decoder refuses).
fn cut_at_end(bytes: &[u8]) -> &[u8] {
    match JpegWalk::default().advance(bytes) {
        Walked::Whole(end) => &bytes[..end],
        Walked::Unfinished | Walked::Damaged(_) => bytes,
    }
}

fn raw(bytes: &[u8], layout: PixelLayout, (width, height): (u32, u32)) -> Option<GrayImage> {
    let pixels = (width as usize).checked_mul(height as usize)?;
    let take = |each: usize| bytes.get(..pixels.checked_mul(each)?);
    let grey: Vec<u8> = match layout {
        PixelLayout::Mjpeg => return None,
        PixelLayout::Yuyv => take(2)?.iter().step_by(2).copied().collect(),
        PixelLayout::Nv12 | PixelLayout::Grey => take(1)?.to_vec(),
        PixelLayout::Rgb => take(3)?.chunks_exact(3).map(|p| luma_8([p[0], p[1], p[2]])).collect(),
        PixelLayout::Bgr => take(3)?.chunks_exact(3).map(|p| luma_8([p[2], p[1], p[0]])).collect(),
    };
    GrayImage::from_raw(width, height, grey)
}

#[cfg(test)]
mod tests {
    use image::codecs::jpeg::JpegEncoder;
    use proptest::prelude::*;

    use super::*;
    use crate::capture::timestamping::DriverStamp;

    fn picture(bytes: Vec<u8>) -> CapturedPicture {
        CapturedPicture { bytes, stamp: DriverStamp::None, arrival: Timestamp::default(), device_sequence: None, is_damaged: false }
    }

    fn jpeg() -> Vec<u8> {
        let mut bytes = Vec::new();
        let image = GrayImage::from_fn(32, 16, |x, y| image::Luma([(x * 7 + y * 3) as u8]));
        JpegEncoder::new_with_quality(&mut bytes, 90).encode_image(&image).unwrap();
        bytes
    }

    #[test]
    fn stale_bytes_after_a_jpeg_are_cut() {
        let (jpeg, clean) = (jpeg(), decode_grey(&jpeg()).unwrap());
        let stale = [&jpeg[..], &[0; 40], &jpeg[30..]].concat();
        let decoded = decode_picture(&picture(stale), PixelLayout::Mjpeg, (32, 16));
        assert_eq!(decoded, Decoded { image: Ok(clean), received: Received::Jpeg(Arc::from(jpeg)) });
    }

    #[test]
    fn a_truncated_jpeg_is_undecodable_and_recorded_as_it_came() {
        let mut cut = jpeg();
        cut.truncate(cut.len() * 2 / 3);
        let decoded = decode_picture(&picture(cut.clone()), PixelLayout::Mjpeg, (32, 16));
        assert!(decoded.image.is_err());
        assert_eq!(decoded.received, Received::Jpeg(Arc::from(cut)));
    }

    #[test]
    fn raw_layouts_give_their_luma() {
        let size = (2, 2);
        let levels = |layout, bytes: &[u8]| decode_picture(&picture(bytes.to_vec()), layout, size).image.map(GrayImage::into_raw);
        assert_eq!(levels(PixelLayout::Yuyv, &[1, 128, 2, 128, 3, 128, 4, 128]), Ok(vec![1, 2, 3, 4]));
        assert_eq!(levels(PixelLayout::Nv12, &[1, 2, 3, 4, 128, 128]), Ok(vec![1, 2, 3, 4]));
        assert_eq!(levels(PixelLayout::Rgb, &[255, 0, 0, 0, 255, 0, 0, 0, 255, 9, 9, 9]), Ok(vec![76, 150, 29, 9]));
        assert_eq!(levels(PixelLayout::Bgr, &[0, 0, 255, 0, 255, 0, 255, 0, 0, 9, 9, 9]), Ok(vec![76, 150, 29, 9]));
        assert!(levels(PixelLayout::Yuyv, &[1, 128, 2]).unwrap_err().contains("3 bytes, too few for 2 x 2 pixels of YUYV"));
    }

    #[test]
    fn frames_flagged_damaged_by_the_driver_are_not_decoded() {
        let decoded = decode_picture(&CapturedPicture { is_damaged: true, ..picture(jpeg()) }, PixelLayout::Mjpeg, (32, 16));
        assert!(decoded.image.is_err() && decoded.received == Received::Damaged);
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..200), which in 0..6_usize, w in 0..9_u32, h in 0..9_u32) {
            use PixelLayout::*;
            let decoded = decode_picture(&picture(bytes), [Mjpeg, Yuyv, Nv12, Grey, Rgb, Bgr][which], (w, h));
            let _ = decoded.content((w, h), Timestamp::default(), 0);
        }
    }
}
