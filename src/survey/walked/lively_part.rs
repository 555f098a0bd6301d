//! Finds the shutter from the walk itself: tracks the part in which the picture moved most, with
//! the current stage and lens.
//!
//! Keyframes are of no use for this: they are sharp, so all shutters look alike in them. The
//! shutter shows in fast motion, which is known from consecutive frames.

use crate::camera::Shutter;
use crate::frame::Frame;
use crate::survey::shutter::{ShutterEstimate, ShutterTime, estimate_shutter};
use crate::tracker::{Tracker, TrackerSetup};

/// Number of frames of a part: three seconds at 30 per second. Two parts are in memory at a time.
/// Raised, the shutter is known better and more memory is used.
const FRAMES: usize = 100;
/// Minimum number of frames of a part: a dozen must be informative (`shutter`). Raised, short clips
/// give no result; lowered, they are tracked in vain.
const FEWEST: usize = 40;
/// Difference of two times, seconds, below which they count as equal: in a slow walk nothing moves
/// by a tenth of a pixel in it. Raised, readouts of fast sensors count as zero; lowered, a global
/// shutter is called a rolling one because of model errors.
pub const SAME_S: f64 = 3e-4;
/// Difference from the configured time, in sigmas, above which the time is changed. Raised, small
/// mistakes stay; lowered, noise changes what was configured.
const OTHER_SIGMAS: f64 = 3.0;

/// A frame and its number among all frames of the walk, from 1.
#[derive(Debug, Clone, PartialEq)]
pub struct NumberedFrame {
    /// Its number.
    pub number: usize,
    /// The frame.
    pub frame: Frame,
}

/// Collects the part of the clips with the fastest motion.
#[derive(Debug, Default)]
pub struct LivelyPart {
    run: Vec<NumberedFrame>,
    speed: f64,
    kept: Option<(Vec<NumberedFrame>, f64)>,
}

impl LivelyPart {
    /// Offers the next frame, with its number and how fast the picture moved in it; `None` if the
    /// stage was not found, or a clip ends.
    pub fn offer(&mut self, next: Option<(usize, &Frame, f64)>) {
        let Some((number, frame, speed)) = next else { return self.close() };
        self.run.push(NumberedFrame { number, frame: frame.clone() });
        self.speed += speed;
        if self.run.len() == FRAMES {
            self.close();
        }
    }

    fn close(&mut self) {
        let (run, speed) = (std::mem::take(&mut self.run), std::mem::take(&mut self.speed));
        let mean = speed / run.len().max(1) as f64;
        if run.len() >= FEWEST && self.kept.as_ref().is_none_or(|(_, most)| mean > *most) {
            self.kept = Some((run, mean));
        }
    }

    /// Returns its frames, in order; empty if the clips are too short.
    pub fn into_frames(mut self) -> Vec<NumberedFrame> {
        self.close();
        self.kept.map_or_else(Vec::new, |(frames, _)| frames)
    }
}

/// Estimates the shutter from frames, with a stage and a lens. `None` if there are too few frames,
/// or the work was stopped meanwhile.
pub fn shutter_of(frames: &[NumberedFrame], setup: TrackerSetup, goes_on: &(dyn Fn() -> bool + Sync)) -> Option<ShutterEstimate> {
    if frames.is_empty() {
        return None;
    }
    let tracker = Tracker::new(TrackerSetup { shutter: Default::default(), objects: Vec::new(), ..setup }.as_trial()).ok()?;
    let open = || goes_on().then(|| frames.iter().take_while(|_| goes_on()).map(|numbered| numbered.frame.clone())).ok_or(());
    estimate_shutter(open, tracker).ok().filter(|_| goes_on())
}

/// Returns the shutter to use: as configured, except for times that a clip shows to be different.
/// An unconfigured exposure stays unknown: the tracker learns it, and the camera may choose another
/// one in show light.
pub fn corrected_shutter(configured: Shutter, found: &ShutterEstimate) -> Shutter {
    let time = |configured_s: f64, found: Option<ShutterTime>| {
        let Some(found) = found else { return configured_s };
        let unsure_s = SAME_S.max(OTHER_SIGMAS * found.sigma_s);
        match found.seconds {
            s if (s - configured_s).abs() < unsure_s => configured_s,
            s if s.abs() < unsure_s => 0.0,
            // A config cannot express rows that are read from the bottom up.
            s if s < 0.0 => configured_s,
            s => s,
        }
    };
    let exposure = found.exposure.filter(|_| configured.exposure_s != 0.0);
    Shutter { readout_s: time(configured.readout_s, found.readout), exposure_s: time(configured.exposure_s, exposure) }
}

#[cfg(test)]
mod tests {
    use image::GrayImage;

    use super::*;

    fn frames(n: u64) -> Vec<Frame> {
        let frame = |sequence| Frame { image: GrayImage::new(4, 3), timestamp: Default::default(), sequence };
        (0..n).map(frame).collect()
    }

    #[test]
    fn the_part_in_which_the_picture_moved_most_is_kept() {
        let mut part = LivelyPart::default();
        for frame in &frames(350) {
            part.offer(Some((frame.sequence as usize, frame, if frame.sequence / 100 == 1 { 0.5 } else { 0.1 })));
        }
        let kept = part.into_frames();
        assert_eq!((kept.len(), kept[0].number), (FRAMES, 100));
    }

    #[test]
    fn a_part_has_no_gaps_and_is_long_enough() {
        let mut part = LivelyPart::default();
        for frame in &frames(FEWEST as u64 - 1) {
            part.offer(Some((frame.sequence as usize, frame, 9.0)));
        }
        part.offer(None);
        for frame in &frames(FEWEST as u64) {
            part.offer(Some((frame.sequence as usize, frame, 0.1)));
        }
        assert_eq!(part.into_frames().len(), FEWEST);
        assert!(LivelyPart::default().into_frames().is_empty());
    }

    #[test]
    fn configured_shutter_times_stay_unless_contradicted() {
        let time = |seconds, sigma_s| Some(ShutterTime { seconds, sigma_s, frames: 50 });
        let found = |readout, exposure| ShutterEstimate { readout, exposure, frames: 100, aligned: 100, has_settled: true };
        let configured = Shutter { readout_s: 0.012, exposure_s: 0.01 };
        let corrected = |readout, exposure| {
            let Shutter { readout_s, exposure_s } = corrected_shutter(configured, &found(readout, exposure));
            (readout_s, exposure_s)
        };
        assert_eq!(corrected(None, None), (0.012, 0.01));
        assert_eq!(corrected(time(0.0121, 1e-5), None), (0.012, 0.01));
        assert_eq!(corrected(time(0.018, 1e-4), time(0.004, 1e-4)), (0.018, 0.004));
        assert_eq!(corrected(time(0.018, 4e-3), None), (0.012, 0.01));
        assert_eq!(corrected(time(1e-5, 1e-5), None), (0.0, 0.01));
        assert_eq!(corrected(time(-0.01, 1e-5), None), (0.012, 0.01));
        assert_eq!(corrected_shutter(Shutter::default(), &found(None, time(0.004, 1e-4))), Shutter::default());
    }
}
