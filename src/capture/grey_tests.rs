//! Every picture format, and every way of being cut off or damaged.

use image::codecs::jpeg::JpegEncoder;
use image::{ImageBuffer, Luma, LumaA, Rgb, RgbImage, Rgba};
use proptest::prelude::*;

use super::*;

fn png(picture: impl Into<DynamicImage>) -> Vec<u8> {
    encoded(picture, ImageFormat::Png)
}

fn encoded(picture: impl Into<DynamicImage>, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    picture.into().write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

/// A textured picture whose size is not a multiple of a JPEG block.
fn textured(width: u32, height: u32) -> GrayImage {
    GrayImage::from_fn(width, height, |x, y| Luma([(128.0 + 90.0 * (f64::from(x) * 0.31).sin() * (f64::from(y) * 0.17).cos()) as u8]))
}

fn jpeg(picture: &DynamicImage, quality: u8) -> Vec<u8> {
    let mut bytes = Vec::new();
    picture.write_with_encoder(JpegEncoder::new_with_quality(&mut bytes, quality)).unwrap();
    bytes
}

/// The EXIF of a camera held in an orientation (1 to 8).
pub(crate) fn exif(orientation: u8) -> Vec<u8> {
    let mut block = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0".to_vec();
    block.extend_from_slice(&[orientation, 0, 0, 0, 0, 0, 0, 0]);
    block
}

#[test]
fn an_exif_orientation_is_reported_and_changes_no_pixel() {
    let picture = textured(40, 24);
    for form in [ImageFormat::Png, ImageFormat::Jpeg] {
        for (number, words) in [(1, None), (3, Some("turned by 180 degrees")), (6, Some("turned by 90 degrees")), (2, Some("mirrored"))] {
            let mut bytes = Vec::new();
            match form {
                ImageFormat::Png => {
                    let mut encoder = image::codecs::png::PngEncoder::new(&mut bytes);
                    image::ImageEncoder::set_exif_metadata(&mut encoder, exif(number)).unwrap();
                    picture.write_with_encoder(encoder).unwrap();
                }
                _ => {
                    let mut encoder = JpegEncoder::new_with_quality(&mut bytes, 95);
                    image::ImageEncoder::set_exif_metadata(&mut encoder, exif(number)).unwrap();
                    picture.write_with_encoder(encoder).unwrap();
                }
            }
            let (decoded, orientation) = decode_oriented(&bytes).unwrap();
            assert_eq!((decoded.dimensions(), orientation_words(orientation)), ((40, 24), words), "{form:?} {number}");
            assert_eq!(picture_size(&bytes), Some((40, 24)));
        }
    }
}

#[test]
fn oversized_pictures_are_refused_before_allocating() {
    let too_large = |bytes: &[u8]| {
        let message = decode_grey(bytes).unwrap_err().to_string();
        assert_eq!(message, "the picture is 16384 x 16384 pixels, the maximum is 67 million; scale it down");
    };
    too_large(b"P5 16384 16384 255\n");
    let mut header = b"\0\0\x40\0\0\0\x40\0\x08\0\0\0\0".to_vec();
    let mut whole = png(textured(60, 50));
    let crc = [&b"IHDR"[..], &header]
        .concat()
        .iter()
        .fold(u32::MAX, |crc, byte| (0..8).fold(crc ^ u32::from(*byte), |c, _| if c & 1 == 1 { c >> 1 ^ 0xEDB8_8320 } else { c >> 1 }));
    header.extend((!crc).to_be_bytes());
    whole[16..33].copy_from_slice(&header);
    too_large(&whole);
    let mut whole = jpeg(&textured(60, 50).into(), 90);
    let size = whole.windows(2).position(|w| w == [0xFF, 0xC0]).unwrap() + 5;
    whole[size..size + 4].copy_from_slice(&[0x40, 0, 0x40, 0]);
    too_large(&whole);
}

#[test]
fn colours_become_bt_601_luma() {
    let colours = [[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 255], [10, 200, 30], [0, 0, 0]];
    let wanted = [76, 150, 29, 255, 124, 0];
    for (rgb, grey) in colours.into_iter().zip(wanted) {
        let of = |bytes: Vec<u8>| decode_grey(&bytes).unwrap().get_pixel(1, 1).0[0];
        assert_eq!(of(png(RgbImage::from_pixel(3, 2, Rgb(rgb)))), grey, "{rgb:?}");
        assert_eq!(of(encoded(RgbImage::from_pixel(3, 2, Rgb(rgb)), ImageFormat::Pnm)), grey, "{rgb:?} as PPM");
        assert_eq!(of(png(image::RgbaImage::from_pixel(3, 2, Rgba([rgb[0], rgb[1], rgb[2], 7])))), grey, "{rgb:?} half seen");
        let deep = Rgb(rgb.map(|v: u8| u16::from(v) * 257));
        assert_eq!(of(png(ImageBuffer::<Rgb<u16>, _>::from_pixel(3, 2, deep))), grey, "{rgb:?} in 16 bits");
    }
}

#[test]
fn grey_stays_grey() {
    let picture = textured(37, 23);
    assert_eq!(decode_grey(&png(picture.clone())).unwrap(), picture);
    assert_eq!(decode_grey(&encoded(picture.clone(), ImageFormat::Pnm)).unwrap(), picture);
    let see_through = ImageBuffer::from_fn(37, 23, |x, y| LumaA([picture.get_pixel(x, y).0[0], 9]));
    assert_eq!(decode_grey(&png(see_through)).unwrap(), picture);
    let deep = |low: u16| ImageBuffer::<Luma<u16>, _>::from_fn(37, 23, |x, y| Luma([u16::from(picture.get_pixel(x, y).0[0]) * 257 + low]));
    assert_eq!(decode_grey(&png(deep(0))).unwrap(), picture);
    assert_eq!(decode_grey(&png(ImageBuffer::from_pixel(2, 2, Luma([128u16])))).unwrap().get_pixel(0, 0).0, [0]);
    assert_eq!(decode_grey(&png(ImageBuffer::from_pixel(2, 2, Luma([129u16])))).unwrap().get_pixel(0, 0).0, [1]);
    assert_eq!(decode_grey(&encoded(deep(0), ImageFormat::Pnm)).unwrap(), picture);
}

#[test]
fn pgm_levels_are_scaled_by_their_maximum() {
    assert_eq!(decode_grey(b"P5 3 1 255\n\x00\x80\xff").unwrap().as_raw(), &[0, 128, 255]);
    assert_eq!(decode_grey(b"P5 3 1 1023\n\x00\x00\x02\x00\x03\xff").unwrap().as_raw(), &[0, 128, 255]);
    assert_eq!(decode_grey(b"P5 3 1 100\n\x00\x32\x64").unwrap().as_raw(), &[0, 128, 255]);
    assert_eq!(decode_grey(b"P2\n3 1\n255\n1 2 3\n").unwrap().as_raw(), &[1, 2, 3]);
    assert!(decode_grey(b"P5 3 1 255\n\x00\x80").is_err());
}

#[test]
fn jpeg_gives_its_luma_plane() {
    let grey = textured(75, 41);
    let close = |a: &GrayImage, b: &GrayImage| a.dimensions() == b.dimensions() && a.iter().zip(b.iter()).all(|(a, b)| a.abs_diff(*b) <= 3);
    assert!(close(&decode_grey(&jpeg(&grey.clone().into(), 98)).unwrap(), &grey));
    // Strong flat colour: the luma plane is BT.601's Y, whatever happens to the chroma.
    let colour = DynamicImage::from(RgbImage::from_fn(75, 41, |x, y| {
        let level = grey.get_pixel(x, y).0[0] / 2;
        Rgb([level + 100, level, 127 - level])
    }));
    let wanted = decode_grey(&png(colour.clone())).unwrap();
    assert!(close(&decode_grey(&jpeg(&colour, 98)).unwrap(), &wanted));
}

#[test]
fn jpeg_without_tables_is_decoded_with_the_standard_ones() {
    let whole = jpeg(&textured(75, 41).into(), 90);
    let mut bare = Vec::new();
    let mut at = 2;
    bare.extend_from_slice(&whole[..2]);
    while whole[at + 1] != 0xDA {
        let end = at + 2 + usize::from(u16::from_be_bytes([whole[at + 2], whole[at + 3]]));
        if whole[at + 1] != 0xC4 {
            bare.extend_from_slice(&whole[at..end]);
        }
        at = end;
    }
    bare.extend_from_slice(&whole[at..]);
    assert!(bare.len() < whole.len());
    assert_eq!(decode_grey(&bare).unwrap(), decode_grey(&whole).unwrap());
}

#[test]
fn trailing_bytes_are_not_an_error() {
    let whole = jpeg(&textured(64, 64).into(), 90);
    let stale = [&whole[..], &[0, 1, 0xFF, 0xD8, 0xFF, 0xC4, 9], &whole[30..200]].concat();
    assert_eq!(decode_grey(&stale).unwrap(), decode_grey(&whole).unwrap());
}

#[test]
fn a_truncated_jpeg_is_refused() {
    let whole = jpeg(&textured(200, 160).into(), 90);
    for n in 0..whole.len() {
        assert!(decode_grey(&whole[..n]).is_err(), "{n} of {} bytes", whole.len());
    }
}

#[test]
fn a_jpeg_whose_data_end_early_is_refused() {
    let whole = jpeg(&textured(200, 160).into(), 90);
    let colour = jpeg(&DynamicImage::from(textured(200, 160)).to_rgb8().into(), 90);
    for whole in [whole, colour] {
        for part in [3, 5, 7, 8] {
            let cut = [&whole[..whole.len() * part / 9], &[0xFF, 0xD9]].concat();
            assert!(decode_grey(&cut).is_err(), "{part} ninths and an end mark");
        }
    }
}

#[test]
fn a_truncated_png_is_refused() {
    let whole = png(textured(60, 50));
    for n in 0..whole.len() {
        assert!(decode_grey(&whole[..n]).is_err(), "{n} of {} bytes", whole.len());
    }
    let mut damaged = whole.clone();
    damaged[60] ^= 0x40;
    assert!(decode_grey(&damaged).is_err());
}

#[test]
fn non_pictures_are_refused_with_the_reason() {
    assert_eq!(decode_grey(b""), Err(DecodeError::Empty));
    assert_eq!(decode_grey(b"hello there"), Err(DecodeError::UnknownForm));
    assert!(decode_grey(b"GIF89a......").unwrap_err().to_string().starts_with("the picture is not JPEG, PNG or PGM but GIF; convert it"));
    assert!(decode_grey(b"P5 99999 99999 255\n").is_err());
    assert!(decode_grey(b"P5 0 0 255\n").is_err());
}

proptest! {
    #[test]
    fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        for start in [&b""[..], b"P5 4 4 255\n", b"P6 ", b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"] {
            let _ = decode_grey(&[start, &bytes].concat());
        }
    }

    #[test]
    fn every_whole_jpeg_is_decoded(width in 1u32..70, height in 1u32..70, quality in 1u8..=100, level in any::<u8>(), rough in any::<bool>(), colour in any::<bool>()) {
        let picture = GrayImage::from_fn(width, height, |x, y| Luma([if rough { level ^ (x * x * 31 + y * 77) as u8 } else { level }]));
        let picture = DynamicImage::from(picture);
        let bytes = jpeg(&if colour { picture.to_rgb8().into() } else { picture }, quality);
        let decoded = decode_grey(&bytes);
        prop_assert_eq!(decoded.map(|d| d.dimensions()), Ok((width, height)));
    }

    #[test]
    fn damaged_pictures_end_without_panic(form in 0..3, at in any::<prop::sample::Index>(), with in prop::collection::vec(any::<u8>(), 1..4)) {
        let picture = textured(40, 30);
        let mut bytes = match form {
            0 => png(picture),
            1 => jpeg(&picture.into(), 80),
            _ => jpeg(&DynamicImage::from(picture).to_rgb8().into(), 80),
        };
        let at = at.index(bytes.len());
        bytes.iter_mut().skip(at).zip(with).for_each(|(to, from)| *to = from);
        let _ = decode_grey(&bytes);
    }

    #[test]
    fn png_and_pgm_round_trip(width in 1u32..40, height in 1u32..40, seed in any::<u8>()) {
        let picture = GrayImage::from_fn(width, height, |x, y| Luma([(x * 7 + y * 13) as u8 ^ seed]));
        prop_assert_eq!(&decode_grey(&png(picture.clone())).unwrap(), &picture);
        prop_assert_eq!(&decode_grey(&encoded(picture.clone(), ImageFormat::Pnm)).unwrap(), &picture);
    }
}
