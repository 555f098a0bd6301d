//! Judges how a frame looks as a picture, whatever it shows: dark, white, plain or blurred. Used
//! only for frames without a pose, to say why.

use crate::track::frame::tuning::TUNING;
use image::GrayImage;

/// What may be wrong with a frame as a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PictureFault {
    /// It is nearly black.
    TooDark,
    /// It is mostly white.
    TooBright,
    /// It is blurred.
    TooBlurred,
    /// It shows a plain area.
    Blank,
}

/// Brightness, contrast and sharpness of a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameLook {
    /// Grey levels below which 0.2, 50, 98 and 99.8 % of the pixels lie. A lamp may take 2 % of a
    /// dark frame, and a picture 2 % of a plain one.
    darkest: u8,
    middle: u8,
    bright: u8,
    brightest: u8,
    /// Mean square grey step between neighbours over that between pixels four apart, in the
    /// direction where it is smaller: near 1/16 if every edge is a slope, 1/4 if edges are steps,
    /// however few.
    sharpness: f32,
}

impl Default for FrameLook {
    /// A frame without faults.
    fn default() -> Self {
        Self { darkest: 20, middle: 110, bright: 200, brightest: 220, sharpness: 0.25 }
    }
}

impl FrameLook {
    /// Measures the half-size copy of a frame.
    pub fn at(half: &GrayImage) -> Self {
        let (width, height) = (half.width() as usize, half.height() as usize);
        if width <= TUNING.wide_step_px || height <= TUNING.wide_step_px {
            return Self::default();
        }
        let raw = half.as_raw();
        let mut levels = [0_u32; 256];
        // Near and wide steps, across and down.
        let mut steps = [[0_u64; 2]; 2];
        for y in (0..height - TUNING.wide_step_px).step_by(TUNING.look_stride_px) {
            for x in (0..width - TUNING.wide_step_px).step_by(TUNING.look_stride_px) {
                let at = y * width + x;
                let level = raw[at];
                levels[usize::from(level)] += 1;
                for (step, stride) in steps.iter_mut().zip([1, width]) {
                    step[0] += u64::from(level.abs_diff(raw[at + stride])).pow(2);
                    step[1] += u64::from(level.abs_diff(raw[at + TUNING.wide_step_px * stride])).pow(2);
                }
            }
        }
        let sharpness = steps.map(|[near, wide]| near as f32 / wide.max(1) as f32);
        let all: u32 = levels.iter().sum();
        let below = |thousandths: u32| {
            let mut sum = 0;
            let reached = levels.iter().position(|n| {
                sum += n;
                u64::from(sum) * 1000 >= u64::from(all) * u64::from(thousandths)
            });
            reached.unwrap_or(255) as u8
        };
        let sharpness = sharpness[0].min(sharpness[1]);
        Self { darkest: below(2), middle: below(500), bright: below(980), brightest: below(998), sharpness }
    }

    /// Returns what is wrong with the frame as a picture, worst first; `None` if nothing is.
    pub fn fault(&self) -> Option<PictureFault> {
        if self.bright < TUNING.max_dark_grey {
            Some(PictureFault::TooDark)
        } else if self.middle > TUNING.min_white_grey {
            Some(PictureFault::TooBright)
        } else if self.brightest - self.darkest < TUNING.max_plain_range {
            Some(PictureFault::Blank)
        } else {
            (self.sharpness < TUNING.min_sharpness).then_some(PictureFault::TooBlurred)
        }
    }
}

#[cfg(test)]
mod tests {
    use image::Luma;
    use image::imageops::{blur, resize};

    use super::*;
    use crate::track::synthetic::cloth;

    /// A frame's half-size copy: the cloth's artwork.
    fn half() -> GrayImage {
        resize(&cloth(1).artwork, 320, 240, image::imageops::FilterType::Triangle)
    }

    fn changed(change: impl Fn(f32) -> f32) -> GrayImage {
        let mut picture = half();
        picture.pixels_mut().for_each(|p| *p = Luma([change(f32::from(p[0])).clamp(0.0, 255.0) as u8]));
        picture
    }

    #[test]
    fn a_good_frame_has_no_fault() {
        assert_eq!(FrameLook::at(&half()).fault(), None, "{:?}", FrameLook::at(&half()));
        // Small in a plain frame.
        let mut small = GrayImage::from_pixel(320, 240, Luma([90]));
        image::imageops::replace(&mut small, &resize(&half(), 32, 24, image::imageops::FilterType::Triangle), 100, 100);
        assert_eq!(FrameLook::at(&small).fault(), None, "{:?}", FrameLook::at(&small));
        let dim = changed(|v| 0.3 * v);
        assert_eq!(FrameLook::at(&dim).fault(), None, "{:?}", FrameLook::at(&dim));
    }

    #[test]
    fn too_dark_too_bright_and_blank_frames_are_recognised() {
        assert_eq!(FrameLook::at(&changed(|v| 0.1 * v)).fault(), Some(PictureFault::TooDark));
        assert_eq!(FrameLook::at(&changed(|v| 4.0 * v + 150.0)).fault(), Some(PictureFault::TooBright));
        assert_eq!(FrameLook::at(&changed(|_| 120.0)).fault(), Some(PictureFault::Blank));
    }

    #[test]
    fn blurred_frames_are_recognised() {
        let blurred = blur(&half(), 5.0);
        assert_eq!(FrameLook::at(&blurred).fault(), Some(PictureFault::TooBlurred), "{:?}", FrameLook::at(&blurred));
    }

    #[test]
    fn blur_of_motion_is_judged_by_its_direction() {
        let sharp = half();
        let streaked = GrayImage::from_fn(300, 240, |x, y| {
            let sum: u32 = (0..20).map(|k| u32::from(sharp.get_pixel(x + k, y)[0])).sum();
            Luma([(sum / 20) as u8])
        });
        assert_eq!(FrameLook::at(&streaked).fault(), Some(PictureFault::TooBlurred), "{:?}", FrameLook::at(&streaked));
    }

    #[test]
    fn tiny_pictures_are_not_judged() {
        assert_eq!(FrameLook::at(&GrayImage::new(3, 3)).fault(), None);
    }
}
