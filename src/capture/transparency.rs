//! Renders transparent artwork as printed on white paper.

use image::{DynamicImage, GrayImage, Rgba};

use super::bt601::grey_of;

/// Composites a picture onto white; returns its grey levels and its transparent fraction, 0 for an
/// opaque picture.
pub(super) fn on_white(picture: DynamicImage) -> (GrayImage, f64) {
    if !picture.color().has_alpha() {
        return (grey_of(picture), 0.0);
    }
    let mut colours = picture.into_rgba16();
    let mut unseen = 0_u64;
    for Rgba([r, g, b, alpha]) in colours.pixels_mut() {
        let hidden = u64::from(u16::MAX - *alpha);
        unseen += hidden;
        for level in [r, g, b] {
            *level = ((u64::from(*level) * u64::from(*alpha) + hidden * u64::from(u16::MAX) + 32_767) / 65_535) as u16;
        }
        *alpha = u16::MAX;
    }
    let all = u64::from(u16::MAX) * u64::from(colours.width()) * u64::from(colours.height());
    (grey_of(DynamicImage::ImageRgba16(colours)), unseen as f64 / all.max(1) as f64)
}

#[cfg(test)]
mod tests {
    use image::{ImageBuffer, Luma, LumaA};

    use super::*;

    #[test]
    fn transparent_pixels_become_white_and_are_counted() {
        let of = |pixels: Vec<u8>| on_white(DynamicImage::ImageRgba8(ImageBuffer::from_raw(2, 1, pixels).unwrap()));
        assert_eq!(of(vec![0, 0, 0, 255, 0, 0, 0, 0]), (GrayImage::from_raw(2, 1, vec![0, 255]).unwrap(), 0.5));
        assert_eq!(of(vec![10, 10, 10, 255, 200, 200, 200, 255]), (GrayImage::from_raw(2, 1, vec![10, 200]).unwrap(), 0.0));
        let (half, share) = of(vec![0, 0, 0, 128, 0, 0, 0, 255]);
        assert_eq!((half.as_raw().as_slice(), (share * 1000.0).round()), (&[127, 0][..], 249.0));
        let grey = ImageBuffer::from_raw(2, 1, [LumaA([40_u8, 255]).0, LumaA([40, 0]).0].concat()).unwrap();
        assert_eq!(on_white(DynamicImage::ImageLumaA8(grey)), (GrayImage::from_raw(2, 1, vec![40, 255]).unwrap(), 0.5));
        let deep = ImageBuffer::from_raw(2, 1, vec![0_u16, u16::MAX, 0, 0]).unwrap();
        assert_eq!(on_white(DynamicImage::ImageLumaA16(deep)).0.as_raw(), &[0, 255]);
    }

    #[test]
    fn an_opaque_alpha_channel_changes_nothing() {
        let plain = image::RgbImage::from_fn(7, 5, |x, y| image::Rgb([(x * 31) as u8, (y * 47) as u8, (x * y * 5) as u8]));
        let opaque = DynamicImage::ImageRgba8(DynamicImage::ImageRgb8(plain.clone()).into_rgba8());
        assert_eq!(on_white(opaque), (grey_of(DynamicImage::ImageRgb8(plain)), 0.0));
        let grey = GrayImage::from_fn(4, 4, |x, y| Luma([(x * 60 + y) as u8]));
        assert_eq!(on_white(DynamicImage::ImageLuma8(grey.clone())), (grey, 0.0));
    }
}
