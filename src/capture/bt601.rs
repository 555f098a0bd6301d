//! Converts colours to grey levels by BT.601, and 16-bit levels to 8 bits.

use image::{DynamicImage, GrayImage};

/// Converts a decoded picture to grey (BT.601, 8 bits).
pub(super) fn grey_of(picture: DynamicImage) -> GrayImage {
    let (width, height) = (picture.width(), picture.height());
    let grey: Vec<u8> = match &picture {
        DynamicImage::ImageLuma8(p) => p.as_raw().clone(),
        DynamicImage::ImageLumaA8(p) => p.pixels().map(|p| p.0[0]).collect(),
        DynamicImage::ImageRgb8(p) => p.pixels().map(|p| luma_8(p.0)).collect(),
        DynamicImage::ImageRgba8(p) => p.pixels().map(|p| luma_8([p.0[0], p.0[1], p.0[2]])).collect(),
        DynamicImage::ImageLuma16(p) => p.pixels().map(|p| eight_bits(p.0[0])).collect(),
        DynamicImage::ImageLumaA16(p) => p.pixels().map(|p| eight_bits(p.0[0])).collect(),
        other => other.to_rgb16().pixels().map(|p| luma_16(p.0)).collect(),
    };
    // The buffer has one level per pixel by construction, so the default never applies.
    GrayImage::from_raw(width, height, grey).unwrap_or_default()
}

/// Returns the BT.601 luma of 8-bit RGB, rounded.
pub(super) fn luma_8([r, g, b]: [u8; 3]) -> u8 {
    ((299 * u32::from(r) + 587 * u32::from(g) + 114 * u32::from(b) + 500) / 1000) as u8
}

/// Returns the BT.601 luma of 16-bit RGB in 8 bits, rounded once.
pub(super) fn luma_16([r, g, b]: [u16; 3]) -> u8 {
    ((299 * u64::from(r) + 587 * u64::from(g) + 114 * u64::from(b) + 128_500) / 257_000) as u8
}

pub(super) fn eight_bits(level: u16) -> u8 {
    ((u32::from(level) + 128) / 257) as u8
}
