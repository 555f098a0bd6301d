//! Light in one byte, encoded as its square root.
//!
//! One byte holds light too coarsely where it is dark. Its square root spreads it as evenly as
//! sRGB does, and is decoded by one multiplication: light is root² / 255.

use image::GrayImage;

use super::transfer::{FULL, Transfer};
use crate::features::{self, halved_by};
use crate::simd::multiversion;

/// Returns a picture's light as square roots.
pub fn roots_of(picture: &GrayImage, transfer: Transfer) -> GrayImage {
    let roots: [u8; 256] = std::array::from_fn(|grey| (FULL * transfer.decoded(grey as f32 / FULL).sqrt() + 0.5) as u8);
    let mut picture = picture.clone();
    picture.iter_mut().for_each(|grey| *grey = roots[usize::from(*grey)]);
    picture
}

/// Returns a picture at half its size, with the light of its pixels averaged: exactly where they
/// are square roots or light itself, and nearly where they are sRGB.
pub fn halved_in_light(picture: &GrayImage, transfer: Transfer) -> GrayImage {
    if transfer.is_root() { halved(picture) } else { features::halved(picture) }
}

/// Returns the light of 2x2 pixels averaged, all as square roots; an odd last row or column is
/// dropped, so that positions stay exact.
pub fn halved(roots: &GrayImage) -> GrayImage {
    halved_by(roots, average)
}

multiversion! {
    fn average(top: &[u8], bottom: &[u8], out: &mut [u8]); ["avx2"] => average_plain, else average_plain
}

#[inline(always)]
fn average_plain(top: &[u8], bottom: &[u8], out: &mut [u8]) {
    let squared = |root: u8| u32::from(root) * u32::from(root);
    for ((out, t), b) in out.iter_mut().zip(top.as_chunks::<2>().0).zip(bottom.as_chunks::<2>().0) {
        let sum = squared(t[0]) + squared(t[1]) + squared(b[0]) + squared(b[1]);
        *out = byte((sum as f32 * 0.25).sqrt());
    }
}

/// Rounds to a byte. Above 2^23 the lowest bits of a float count whole numbers, so the low byte is
/// the integer. This converts eight values at once, where `as` would check one after the other.
#[inline(always)]
pub fn byte(value: f32) -> u8 {
    ((value + 0.5).clamp(0.0, FULL).floor() + 8_388_608.0).to_bits() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_root_squared_is_the_light() {
        let picture = GrayImage::from_fn(256, 1, |x, _| image::Luma([x as u8]));
        for transfer in [Transfer::Srgb, Transfer::Bt709, Transfer::Linear] {
            for (grey, root) in roots_of(&picture, transfer).iter().enumerate() {
                let [light, decoded] = [FULL * transfer.decoded(grey as f32 / FULL), f32::from(*root).powi(2) / FULL];
                // Half a root more or less.
                assert!((light - decoded).abs() <= f32::from(*root) / FULL + 0.002, "{transfer:?} {grey}: {light} {decoded}");
            }
        }
    }

    #[test]
    fn a_picture_is_halved_in_the_light_of_its_encoding() {
        let checker = GrayImage::from_fn(8, 8, |x, y| image::Luma([if (x + y) % 2 == 0 { 0 } else { 255 }]));
        let mean = |transfer| halved_in_light(&checker, transfer).get_pixel(1, 1)[0];
        assert_eq!(mean(Transfer::Linear), 128);
        // Half the light is grey 188 in sRGB, and 180 as a square root.
        assert_eq!((mean(Transfer::Srgb), mean(Transfer::Bt709)), (180, 180));
    }

    #[test]
    fn halving_averages_light() {
        let picture = GrayImage::from_fn(41, 21, |x, y| image::Luma([(x * 7 + y * 13) as u8]));
        let half = halved(&picture);
        assert_eq!(half.dimensions(), (20, 10));
        for (x, y, root) in half.enumerate_pixels() {
            let squared = |dx: u32, dy: u32| f32::from(picture.get_pixel(2 * x + dx, 2 * y + dy)[0]).powi(2);
            let expected = (0.25 * (squared(0, 0) + squared(1, 0) + squared(0, 1) + squared(1, 1))).sqrt();
            assert!((f32::from(root[0]) - expected).abs() <= 0.501, "{x} {y}");
        }
    }
}
