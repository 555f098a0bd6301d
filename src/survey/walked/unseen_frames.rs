//! Collects the sharp frames of a walk in which no configured surface was found: a map poses them
//! by its own points.

use image::GrayImage;

use super::lively_part::NumberedFrame;
use crate::frame::Frame;

/// Maximum number of frames. Raised, time and memory grow in proportion; lowered, long walks
/// without a poster have gaps.
const MAX_FRAMES: usize = 160;
/// Spacing of the pixels at which sharpness is measured. Raised, it is measured faster and less
/// surely.
const PIXEL_STEP: usize = 3;

/// Collects frames, evenly over the walk; the sharpest of each stretch.
#[derive(Debug)]
pub struct UnseenFrames {
    kept: Vec<NumberedFrame>,
    /// The sharpest of the current stretch, with its sharpness.
    best: Option<(NumberedFrame, f64)>,
    /// Number of frames in the current stretch, and of those that close it.
    offered: usize,
    stretch: usize,
}

impl Default for UnseenFrames {
    fn default() -> Self {
        Self { kept: Vec::new(), best: None, offered: 0, stretch: 1 }
    }
}

impl UnseenFrames {
    /// Offers a frame, by its number.
    pub fn offer(&mut self, number: usize, frame: &Frame) {
        let sharpness = sharpness(&frame.image);
        if self.best.as_ref().is_none_or(|(_, most)| sharpness > *most) {
            self.best = Some((NumberedFrame { number, frame: frame.clone() }, sharpness));
        }
        self.offered += 1;
        if self.offered < self.stretch {
            return;
        }
        self.close();
        if self.kept.len() > MAX_FRAMES {
            let mut index = 0;
            self.kept.retain(|_| {
                index += 1;
                index % 2 == 1
            });
            self.stretch *= 2;
        }
    }

    fn close(&mut self) {
        self.offered = 0;
        self.kept.extend(self.best.take().map(|(frame, _)| frame));
    }

    /// Returns the frames, in order.
    pub fn into_frames(mut self) -> Vec<NumberedFrame> {
        self.close();
        self.kept
    }
}

/// Returns how sharp a picture is: the mean square of its second differences.
fn sharpness(picture: &GrayImage) -> f64 {
    let (width, raw) = (picture.width() as usize, picture.as_raw());
    let (mut sum, mut count) = (0.0, 0.0);
    for row in raw.chunks_exact(width.max(1)).step_by(PIXEL_STEP) {
        for three in row.windows(3).step_by(PIXEL_STEP) {
            let second = f64::from(three[0]) - 2.0 * f64::from(three[1]) + f64::from(three[2]);
            sum += second * second;
            count += 1.0;
        }
    }
    sum / f64::max(count, 1.0)
}

#[cfg(test)]
mod tests {
    use image::Luma;

    use super::*;

    fn frame(number: usize, contrast: u8) -> Frame {
        let image = GrayImage::from_fn(32, 8, |x, _| Luma([if x % 2 == 0 { contrast } else { 0 }]));
        Frame::new(image, Default::default(), number as u64)
    }

    #[test]
    fn few_frames_are_all_kept() {
        let mut frames = UnseenFrames::default();
        (1..=20).for_each(|number| frames.offer(number, &frame(number, 10)));
        assert_eq!(frames.into_frames().iter().map(|f| f.number).collect::<Vec<_>>(), (1..=20).collect::<Vec<_>>());
    }

    #[test]
    fn many_frames_are_thinned_evenly_to_the_sharpest() {
        let mut frames = UnseenFrames::default();
        let count = 5 * MAX_FRAMES;
        (1..=count).for_each(|number| frames.offer(number, &frame(number, if number % 8 == 5 { 90 } else { 10 })));
        let kept: Vec<usize> = frames.into_frames().iter().map(|f| f.number).collect();
        assert!((MAX_FRAMES / 2..=MAX_FRAMES + 1).contains(&kept.len()), "{}", kept.len());
        assert!(kept.windows(2).all(|pair| pair[1] > pair[0] && pair[1] - pair[0] <= 16), "{kept:?}");
        // The last stretches have eight frames each, with one sharp one.
        assert!(kept.iter().rev().take(20).filter(|number| **number % 8 == 5).count() >= 19, "{kept:?}");
    }
}
