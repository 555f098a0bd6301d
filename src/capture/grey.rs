//! The only grey decoder: pictures from live cameras, clips and the config all become grey here.
//!
//! JPEG returns its luma plane. Grey stays grey, RGB becomes BT.601's Y = 0.299 R + 0.587 G + 0.114
//! B, 16 bits are scaled to 8, alpha is ignored. A truncated picture is an error, never half a
//! picture.
//!
//! A file may ask to be shown rotated or mirrored (EXIF). Cameras write that according to how they
//! are held; the pixels stay in sensor order, and so does the calibration. [`decode_grey`] returns
//! the pixels as they lie in the file; [`decode_oriented`] also returns the orientation in which to
//! show them.

use std::borrow::Cow;
use std::io::Cursor;

use image::metadata::Orientation;
use image::{DynamicImage, GrayImage, ImageDecoder, ImageFormat, ImageReader};
use thiserror::Error;
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use super::bt601::{grey_of, luma_8};
use super::jpeg_markers::{JpegWalk, Walked, standard_huffman_tables};
use super::{foreign, transparency};
use crate::contain::contained;

/// Why bytes cannot be decoded as a picture.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum DecodeError {
    /// There are no bytes.
    #[error("the picture is empty")]
    Empty,
    /// Not a known format.
    #[error("the picture is not JPEG, PNG or PGM")]
    UnknownForm,
    /// A known but unsupported format.
    #[error("the picture is not JPEG, PNG or PGM but {form}; {hint}")]
    Foreign {
        /// Its name.
        form: &'static str,
        /// How to convert it.
        hint: &'static str,
    },
    /// The bytes end before the picture does.
    #[error("the picture is cut off")]
    CutOff,
    /// The picture has more pixels than are allowed.
    #[error("the picture is {width} x {height} pixels, the maximum is {} million; scale it down", MAX_PIXELS / 1_000_000)]
    TooLarge {
        /// Width, pixels.
        width: u32,
        /// Height, pixels.
        height: u32,
    },
    /// The bytes violate the format.
    #[error("the picture is damaged: {reason}")]
    Damaged {
        /// The decoder's message.
        reason: String,
    },
}

impl DecodeError {
    fn damaged(reason: impl ToString) -> Self {
        Self::Damaged { reason: reason.to_string().trim().replace('\n', " ") }
    }
}

/// Maximum number of pixels of a picture; keeps a forged header from requesting all memory. A
/// surface or a calibration view of that size takes about a gigabyte with everything derived from
/// it; stage cameras have 2 to 8 million.
const MAX_PIXELS: u64 = 67_000_000;

/// Maximum size of a picture file: eight bytes per pixel for 67 million pixels, rounded. No such
/// picture needs more. Raised, a wrong file takes more memory.
pub const MAX_PICTURE_FILE: u64 = 512 << 20;

/// Decodes JPEG, PNG or PNM bytes to 8-bit grey, row-major.
///
/// # Errors
/// When the bytes are not such a picture, or are cut off or damaged. Bytes after a JPEG's end are
/// allowed.
pub fn decode_grey(bytes: &[u8]) -> Result<GrayImage, DecodeError> {
    decode_oriented(bytes).map(|(picture, _)| picture)
}

/// Decodes like [`decode_grey`], and returns the orientation in which the file asks to be shown.
///
/// # Errors
/// As [`decode_grey`].
pub fn decode_oriented(bytes: &[u8]) -> Result<(GrayImage, Orientation), DecodeError> {
    decoded(bytes, grey_of)
}

/// Decodes like [`decode_oriented`], with transparency composited onto white, as printers and
/// viewers show artwork. Also returns the transparent fraction of the picture.
///
/// # Errors
/// As [`decode_grey`].
pub fn decode_on_white(bytes: &[u8]) -> Result<(GrayImage, Orientation, f64), DecodeError> {
    let mut unseen = 0.0;
    let (picture, orientation) = decoded(bytes, |picture| {
        let (grey, share) = transparency::on_white(picture);
        unseen = share;
        grey
    })?;
    Ok((picture, orientation, unseen))
}

fn decoded(bytes: &[u8], grey: impl FnOnce(DynamicImage) -> GrayImage) -> Result<(GrayImage, Orientation), DecodeError> {
    if bytes.is_empty() {
        return Err(DecodeError::Empty);
    }
    // The decoders are third-party code with untrusted input: treat a panic in them as a damaged
    // picture.
    let decoded = contained(|| match bytes {
        [0xFF, 0xD8, ..] => decode_jpeg(bytes),
        _ => decode_other(bytes, grey),
    });
    decoded.unwrap_or_else(|_| Err(DecodeError::damaged("the decoder failed")))
}

/// Returns width and height from the file's header; `None` if it has none.
pub fn picture_size(bytes: &[u8]) -> Option<(u32, u32)> {
    let size = || ImageReader::new(Cursor::new(bytes)).with_guessed_format().ok()?.into_dimensions().ok();
    contained(size).ok().flatten()
}

/// Describes an orientation in words; `None` if the picture is to be shown as it lies.
pub fn orientation_words(orientation: Orientation) -> Option<&'static str> {
    match orientation {
        Orientation::NoTransforms => None,
        Orientation::Rotate90 => Some("turned by 90 degrees"),
        Orientation::Rotate180 => Some("turned by 180 degrees"),
        Orientation::Rotate270 => Some("turned by 270 degrees"),
        Orientation::FlipHorizontal | Orientation::FlipVertical => Some("mirrored"),
        Orientation::Rotate90FlipH | Orientation::Rotate270FlipH => Some("turned and mirrored"),
    }
}

/// Refuses more than [`MAX_PIXELS`] before memory is allocated for them.
pub(super) fn check_size(width: u32, height: u32) -> Result<(), DecodeError> {
    if u64::from(width) * u64::from(height) > MAX_PIXELS { Err(DecodeError::TooLarge { width, height }) } else { Ok(()) }
}

fn decode_jpeg(bytes: &[u8]) -> Result<(GrayImage, Orientation), DecodeError> {
    let (whole, has_tall_units) = sound_jpeg(bytes)?;
    // Asked for luma alone, the decoder miscounts tall units and reads past the data.
    decode_sound_jpeg(&whole, if has_tall_units { ColorSpace::YCbCr } else { ColorSpace::Luma })
}

/// Prepares a whole JPEG for the decoder: adds missing tables and cuts what follows its end. Also
/// returns whether its units are taller than wide.
pub(super) fn sound_jpeg(bytes: &[u8]) -> Result<(Vec<u8>, bool), DecodeError> {
    let mut walk = JpegWalk::default();
    let picture = match walk.advance(bytes) {
        Walked::Whole(end) => &bytes[..end],
        Walked::Unfinished => return Err(DecodeError::CutOff),
        Walked::Damaged(at) => return Err(DecodeError::damaged(format!("byte {at} should begin a JPEG marker and does not"))),
    };
    let scan = walk.first_scan.ok_or(DecodeError::CutOff)?;
    let tables = if walk.has_huffman_tables { Vec::new() } else { standard_huffman_tables() };
    // At a premature end mark the decoder accepts half a picture; if the bytes run out instead, it
    // reports an error. So replace the end mark by zeros, which its read-ahead needs and a whole
    // picture never decodes. Other kinds of JPEG need the end mark even when whole.
    let (data, tail) =
        if walk.is_one_plain_scan() { (&picture[scan..picture.len() - 2], &[0; 16][..]) } else { (&picture[scan..], &[][..]) };
    Ok(([&picture[..scan], &tables, data, tail].concat(), walk.has_tall_units()))
}

/// Adds the standard Huffman tables to a JPEG without tables: cameras omit them, and a browser need
/// not know them. Returns anything but a whole JPEG unchanged.
pub fn with_huffman_tables(bytes: &[u8]) -> Cow<'_, [u8]> {
    let mut walk = JpegWalk::default();
    match (walk.advance(bytes), walk.first_scan) {
        (Walked::Whole(_), Some(scan)) if !walk.has_huffman_tables => {
            [&bytes[..scan], &standard_huffman_tables(), &bytes[scan..]].concat().into()
        }
        _ => bytes.into(),
    }
}

/// Decodes a JPEG that has its tables; `luma_from` is the colour space requested if the picture has
/// a luma plane.
fn decode_sound_jpeg(bytes: &[u8], luma_from: ColorSpace) -> Result<(GrayImage, Orientation), DecodeError> {
    // The decoder's own size limit gives a less helpful error.
    let side = usize::from(u16::MAX);
    let options = DecoderOptions::default().set_strict_mode(true).set_max_width(side).set_max_height(side);
    let mut decoder = JpegDecoder::new_with_options(Cursor::new(bytes), options);
    decoder.decode_headers().map_err(DecodeError::damaged)?;
    let (width, height) = decoder.info().map(|info| (u32::from(info.width), u32::from(info.height))).ok_or(DecodeError::CutOff)?;
    check_size(width, height)?;
    let orientation = decoder.exif().and_then(|exif| Orientation::from_exif_chunk(exif)).unwrap_or(Orientation::NoTransforms);
    let wanted = match decoder.input_colorspace() {
        Some(ColorSpace::Luma) => ColorSpace::Luma,
        Some(ColorSpace::YCbCr) => luma_from,
        _ => ColorSpace::RGB,
    };
    decoder.set_options(options.jpeg_set_out_colorspace(wanted));
    let pixels = decoder.decode().map_err(DecodeError::damaged)?;
    let grey = match wanted {
        ColorSpace::Luma => pixels,
        ColorSpace::YCbCr => pixels.iter().step_by(3).copied().collect(),
        _ => pixels.chunks_exact(3).map(|p| luma_8([p[0], p[1], p[2]])).collect(),
    };
    let image = GrayImage::from_raw(width, height, grey).filter(|_| width > 0 && height > 0);
    image.map(|image| (image, orientation)).ok_or_else(|| DecodeError::damaged("its size differs from its header"))
}

fn decode_other(bytes: &[u8], grey: impl FnOnce(DynamicImage) -> GrayImage) -> Result<(GrayImage, Orientation), DecodeError> {
    let format = match image::guess_format(bytes) {
        Ok(ImageFormat::Png) if !png_is_whole(bytes) => return Err(DecodeError::CutOff),
        Ok(format @ (ImageFormat::Png | ImageFormat::Pnm)) => format,
        _ => return Err(foreign::form_of(bytes).map_or(DecodeError::UnknownForm, |(form, hint)| DecodeError::Foreign { form, hint })),
    };
    let mut decoder = ImageReader::with_format(Cursor::new(bytes), format).into_decoder().map_err(not_decoded)?;
    let (width, height) = decoder.dimensions();
    check_size(width, height)?;
    let orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms);
    let decoded = DynamicImage::from_decoder(decoder).map_err(not_decoded)?;
    if decoded.width() == 0 || decoded.height() == 0 {
        return Err(DecodeError::Empty);
    }
    Ok((grey(decoded), orientation))
}

fn not_decoded(error: image::ImageError) -> DecodeError {
    match error {
        image::ImageError::IoError(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => DecodeError::CutOff,
        other => DecodeError::damaged(other),
    }
}

/// Whether the chunks run to IEND: the decoder stops as soon as it believes it has all pixels.
fn png_is_whole(bytes: &[u8]) -> bool {
    let mut at = 8;
    while let Some(&[a, b, c, d, ref kind @ ..]) = bytes.get(at..at + 8) {
        at = at.saturating_add(12).saturating_add(u32::from_be_bytes([a, b, c, d]) as usize);
        if kind == b"IEND" {
            return at <= bytes.len();
        }
    }
    false
}

#[cfg(test)]
#[path = "grey_tests.rs"]
pub(super) mod tests;
