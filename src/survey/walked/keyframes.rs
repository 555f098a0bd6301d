//! Keyframes: the sharp frames of a walk, spread over the camera's positions, from which a survey
//! is computed.

use nalgebra::Vector2;

use crate::frame::Frame;
use crate::geometry::{Body, Camera, Pose};
use crate::motion::Motion;
use crate::track::KnownRates;

/// Maximum number of keyframes. If the first surface has little detail and is half hidden, its
/// accuracy depends on averaging its pixels' errors, and the whole stage depends on it: the
/// positions of fifteen panels were 0.09 and 0.11 mm off with 67 keyframes (two noise
/// realisations), and 0.05 with all 131. Raised, time and memory grow in proportion.
const MAX_KEYFRAMES: usize = 160;
/// Initial spacing of keyframes, as a fraction of the distance or in radians; doubled whenever
/// there are too many. Raised, short walks have few of them; lowered, long ones hold more frames in
/// memory meanwhile.
const FIRST_SPACING: f64 = 0.03;
/// Weight of a rotation relative to a movement: it shows the stage elsewhere in the frame, but from
/// the same position.
const ROTATION_WEIGHT: f64 = 0.5;

/// A frame used by the survey.
#[derive(Debug, Clone, PartialEq)]
pub struct Keyframe {
    /// Its number among all frames of the walk, from 1.
    pub number: usize,
    /// The picture, with its stamp and its row in the clip.
    pub frame: Frame,
    /// The camera's pose and motion, as far as known.
    pub motion: Motion,
    /// The motion's rates, from the frames before and after it.
    pub rates: Option<KnownRates>,
    /// Its matched features, which lead to the basin of the alignment.
    pub features: Vec<MatchedFeature>,
}

impl Keyframe {
    /// Multiplies the speeds by a factor, with the unit of length.
    pub fn scale(&mut self, factor: f64) {
        self.motion.velocity *= factor;
        self.motion.acceleration *= factor;
        for k in [0, 2] {
            self.rates.iter_mut().for_each(|rates| {
                rates.means[k] *= factor;
                rates.sigmas[k] *= factor;
            });
        }
    }
}

/// A feature of a frame that was matched to a point on a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MatchedFeature {
    /// Index of the surface in its body.
    pub surface: usize,
    /// Metres on the picture from its centre.
    pub on_picture_m: [f64; 2],
    /// Position in the frame, pixels.
    pub pixel: Vector2<f64>,
    /// One sigma of the pixel, along each axis.
    pub sigma_px: f64,
}

/// Collects keyframes.
#[derive(Debug, Default)]
pub struct Keyframes {
    kept: Vec<Keyframe>,
    /// The sharpest frame since the last one kept, and how fast the picture moved in it.
    best: Option<(Keyframe, f64)>,
    spacing: Option<f64>,
    last: Option<Pose<Body, Camera>>,
}

impl Keyframes {
    /// Offers a frame, by its number, in which the stage was found, with the camera's motion and
    /// how fast the picture moved, radians per second. `features` is called for a frame that is
    /// kept.
    pub fn offer(
        &mut self,
        (number, frame): (usize, &Frame),
        motion: Motion,
        speed: f64,
        distance_m: f64,
        features: impl FnOnce(&Frame) -> Vec<MatchedFeature>,
    ) {
        let spacing = *self.spacing.get_or_insert(FIRST_SPACING);
        if self.best.as_ref().is_none_or(|(_, slowest)| speed < *slowest) {
            self.best = Some((Keyframe { number, frame: frame.clone(), motion, rates: None, features: Vec::new() }, speed));
        }
        let moved = self.last.map_or(f64::INFINITY, |last| {
            (last.translation - motion.pose.translation).norm() / distance_m
                + ROTATION_WEIGHT * last.rotation.angle_to(&motion.pose.rotation)
        });
        if moved < spacing {
            return;
        }
        self.last = Some(motion.pose);
        self.kept.extend(self.best.take().map(|(keyframe, _)| Keyframe { features: features(&keyframe.frame), ..keyframe }));
        if self.kept.len() > MAX_KEYFRAMES {
            let mut index = 0;
            self.kept.retain(|_| {
                index += 1;
                index % 2 == 1
            });
            self.spacing = Some(2.0 * spacing);
        }
    }

    /// Records how the camera moved in frame `number`, which is only known some frames later.
    pub fn take_rates(&mut self, number: usize, rates: KnownRates) {
        let best = self.best.as_mut().map(|(keyframe, _)| keyframe);
        if let Some(keyframe) = best.into_iter().chain(self.kept.iter_mut().rev()).find(|keyframe| keyframe.number <= number)
            && keyframe.number == number
        {
            keyframe.rates = Some(rates);
        }
    }

    /// Returns all keyframes, in order.
    pub fn into_kept(self) -> Vec<Keyframe> {
        self.kept
    }
}

#[cfg(test)]
mod tests {
    use image::GrayImage;
    use nalgebra::Vector3;

    use super::*;

    #[test]
    fn frames_after_a_keyframe_determine_its_motion() {
        let frame = Frame { image: GrayImage::new(4, 3), timestamp: Default::default(), sequence: 0 };
        let at = |x: f64| Motion::still(Pose::new(Default::default(), Vector3::new(x, 0.0, -3.0)));
        let rates = |speed: f64| KnownRates {
            means: [Vector3::new(speed, 0.0, 0.0), Vector3::zeros(), Vector3::zeros(), Vector3::zeros()],
            sigmas: [0.01; 4],
        };
        let mut keyframes = Keyframes::default();
        for (number, x) in [(1, 0.0), (2, 1.0), (3, 1.0), (4, 2.0)] {
            keyframes.offer((number, &frame), at(x), 0.1 * number as f64, 3.0, |_| Vec::new());
            if number > 2 {
                keyframes.take_rates(number - 2, rates(number as f64));
            }
        }
        let kept: Vec<(usize, Option<f64>)> = keyframes.into_kept().iter().map(|k| (k.number, k.rates.map(|r| r.means[0].x))).collect();
        // The third is the sharper one of the two since the second.
        assert_eq!(kept, [(1, Some(3.0)), (2, Some(4.0)), (3, None)]);
    }

    #[test]
    fn a_long_walk_is_thinned_evenly_from_start_to_end() {
        let frame = Frame { image: GrayImage::new(4, 3), timestamp: Default::default(), sequence: 0 };
        let mut keyframes = Keyframes::default();
        let frames = 5 * MAX_KEYFRAMES;
        for number in 1..=frames {
            let motion = Motion::still(Pose::new(Default::default(), Vector3::new(0.1 * number as f64, 0.0, -3.0)));
            keyframes.offer((number, &frame), motion, 0.1, 3.0, |_| Vec::new());
        }
        let kept: Vec<usize> = keyframes.into_kept().iter().map(|k| k.number).collect();
        assert!((MAX_KEYFRAMES / 2..=MAX_KEYFRAMES).contains(&kept.len()), "{}", kept.len());
        let widest = kept.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap();
        assert!(kept[0] == 1 && frames - kept[kept.len() - 1] < 16 && widest <= 16, "{kept:?}");
    }
}
