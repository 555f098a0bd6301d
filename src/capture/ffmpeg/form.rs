//! How pictures come through the pipe, and how their bytes become grey levels.

use image::GrayImage;

use super::super::bt601::{eight_bits, luma_8, luma_16};
use super::log::Announced;

/// The pixel form in which ffmpeg delivers pictures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Form {
    /// The unchanged luma plane of video.
    Luma,
    /// Grey pictures that use the full range of levels.
    Grey,
    /// RGB, 8 bits per sample.
    Rgb,
    /// RGB, 16 bits per sample.
    DeepRgb,
}

/// Substrings of the names of pixel formats without a luma plane. All other formats are reduced to
/// their luma, via a planar format if necessary.
const WITHOUT_LUMA: [&str; 6] = ["rgb", "bgr", "gbr", "bayer", "pal8", "xyz"];
/// Substrings of the names of RGB formats with more than 8 bits per sample. Some packed formats
/// with fewer bits match too.
const DEEP: [&str; 9] = ["48", "64", "p9", "10", "12", "14", "16", "f16", "f32"];

impl Form {
    /// Chooses the form by ffmpeg's name of the pixel format.
    pub fn of(pixels: &str) -> Self {
        let has = |parts: &[&str]| parts.iter().any(|part| pixels.contains(part));
        match has(&WITHOUT_LUMA) {
            true if has(&DEEP) => Self::DeepRgb,
            true => Self::Rgb,
            false if ["gray", "ya", "mono"].iter().any(|name| pixels.starts_with(name)) => Self::Grey,
            false => Self::Luma,
        }
    }

    /// Returns the filters that deliver pictures of this form and announce them.
    pub fn filter(self) -> &'static str {
        match self {
            Self::Luma | Self::Grey => "extractplanes=y,format=gray|gray9le|gray10le|gray12le|gray14le|gray16le,showinfo",
            Self::Rgb => "format=rgb24,showinfo",
            Self::DeepRgb => "format=rgb48le,showinfo",
        }
    }

    /// Returns the bytes per pixel of an announced picture.
    pub fn bytes_a_pixel(self, announced: &Announced) -> u64 {
        let samples = if matches!(self, Self::Rgb | Self::DeepRgb) { 3 } else { 1 };
        samples * u64::from(announced.bits.div_ceil(8))
    }

    /// Converts a picture's bytes to grey; `None` if there are too few bytes.
    pub fn grey(self, bytes: Vec<u8>, announced: &Announced) -> Option<GrayImage> {
        let bits = announced.bits;
        let deep = || bytes.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]]));
        let grey = match self {
            Self::Luma | Self::Grey if bits <= 8 => bytes,
            Self::Luma => deep().map(|level| upper_bits(level, bits)).collect(),
            Self::Grey => deep().map(|level| of_all_levels(level, bits)).collect(),
            Self::Rgb => bytes.chunks_exact(3).map(|p| luma_8([p[0], p[1], p[2]])).collect(),
            Self::DeepRgb => {
                let samples: Vec<u16> = deep().collect();
                samples.chunks_exact(3).map(|p| luma_16([p[0], p[1], p[2]])).collect()
            }
        };
        GrayImage::from_raw(announced.width, announced.height, grey)
    }
}

/// Rounds a video level to 8 bits. Deeper video levels are 8-bit levels with extra low bits, in
/// full range as in limited range.
fn upper_bits(level: u16, bits: u32) -> u8 {
    let places = bits.clamp(9, 16) - 8;
    ((u32::from(level) + (1 << (places - 1))) >> places).min(255) as u8
}

/// Scales a level of a grey picture from its full range to 0..=255.
fn of_all_levels(level: u16, bits: u32) -> u8 {
    if bits >= 16 {
        return eight_bits(level);
    }
    let most = (1u32 << bits.max(1)) - 1;
    ((u32::from(level).min(most) * 255 + most / 2) / most) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_are_told_apart_by_their_names() {
        let forms = |names: &[&str], form| names.iter().for_each(|name| assert_eq!(Form::of(name), form, "{name}"));
        forms(&["yuv420p", "yuvj422p", "yuv420p10le", "nv12", "p010le", "yuyv422", "uyvy422", "yuva420p", "yuv444p16le"], Form::Luma);
        forms(&["gray", "gray10le", "gray16be", "ya8", "monow"], Form::Grey);
        forms(&["rgb24", "bgr24", "gbrp", "gbrap", "rgba", "bgr0", "0rgb", "pal8", "bayer_rggb8", "rgb565le", "bgr8"], Form::Rgb);
        forms(&["rgb48be", "rgba64le", "gbrp10le", "gbrpf32le", "x2rgb10le", "bayer_bggr16le", "xyz12le", "gbrp9le"], Form::DeepRgb);
    }

    #[test]
    fn deep_levels_convert_to_eight_bits() {
        assert!((0..=255u16).all(|level| (9..=16).all(|bits| u16::from(upper_bits(level << (bits - 8), bits)) == level)));
        assert_eq!((upper_bits(1023, 10), upper_bits(65_535, 16), upper_bits(2, 10), upper_bits(1, 10)), (255, 255, 1, 0));
        assert_eq!([0, 512, 1023, 2000].map(|level| of_all_levels(level, 10)), [0, 128, 255, 255]);
        assert_eq!([0, 128, 257, 65_535].map(|level| of_all_levels(level, 16)), [0, 0, 1, 255]);
    }
}
