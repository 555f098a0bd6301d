//! JPEG compression of a picture, as by a camera that sends JPEGs.

use std::io::Cursor;

use image::codecs::jpeg::JpegEncoder;
use image::{GrayImage, ImageError, ImageFormat, ImageReader};

/// Returns the picture after JPEG compression with a quality from 1 to 100.
///
/// # Errors
/// When the picture is larger than a JPEG can be, or empty.
pub fn through_jpeg(picture: &GrayImage, quality: u8) -> Result<GrayImage, ImageError> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, quality).encode_image(picture)?;
    Ok(ImageReader::with_format(Cursor::new(bytes), ImageFormat::Jpeg).decode()?.into_luma8())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::{grey, paint};

    #[test]
    fn a_jpeg_changes_little_and_the_less_the_better_it_is() {
        let picture = grey(&paint(200, 150, 3));
        let error = |quality: u8| {
            let after = through_jpeg(&picture, quality).unwrap();
            assert_eq!(after.dimensions(), picture.dimensions());
            let squares = picture.iter().zip(after.iter()).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2));
            (squares.sum::<f64>() / f64::from(200 * 150)).sqrt()
        };
        let [coarse, usual, fine] = [30, 85, 100].map(error);
        assert!(fine < 1.0 && usual < 8.0, "{fine} {usual}");
        assert!(fine < usual && usual < coarse && usual > 0.5, "{fine} {usual} {coarse}");
    }

    #[test]
    fn a_picture_without_pixels_is_refused() {
        assert!(through_jpeg(&GrayImage::new(0, 0), 85).is_err());
    }
}
