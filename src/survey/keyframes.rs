//! The frames of a walk that a survey rests on: sharp ones, spread over the places that the camera came to.

use nalgebra::Vector2;

use crate::frame::Frame;
use crate::geometry::{Body, Camera, Pose};
use crate::motion::Motion;

/// Keyframes at most. Chosen: with 0.45 m between them, twice as many were no better (research/mapping.md). Raised, the time grows in proportion.
const MOST_KEYFRAMES: usize = 120;
/// Keyframes are this far apart at first, as a share of the distance or in radians; where there are too many, twice as far. Raised, short walks have
/// few of them; lowered, long ones hold more frames in memory meanwhile.
const FIRST_SPACING: f64 = 0.03;
/// A turn counts as a movement by this share of its angle: it shows the stage elsewhere in the frame, but from the same place.
const TURN_SHARE: f64 = 0.5;

/// A frame that the survey rests on.
#[derive(Debug, Clone, PartialEq)]
pub struct Keyframe {
    /// Its number among all frames of the walk, from 1.
    pub number: usize,
    /// The picture, with its stamp and its row in the clip.
    pub frame: Frame,
    /// Where the camera was and how it moved, as far as known.
    pub motion: Motion,
    /// Features that were matched in it: they lead to the basin of the alignment.
    pub features: Vec<MatchedFeature>,
}

/// A feature of a frame that was matched with a place on a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MatchedFeature {
    /// Index of the surface in its body.
    pub surface: usize,
    /// Metres on the picture from its centre.
    pub on_picture_m: [f64; 2],
    /// In the frame.
    pub pixel: Vector2<f64>,
    /// One sigma of that, along each axis.
    pub sigma_px: f64,
}

/// Collects keyframes.
#[derive(Debug, Default)]
pub struct Keyframes {
    kept: Vec<Keyframe>,
    /// The sharpest frame since the last one that was kept, and how fast the picture moved in it.
    best: Option<(Keyframe, f64)>,
    spacing: Option<f64>,
    last: Option<Pose<Body, Camera>>,
}

impl Keyframes {
    /// Offers the frame of this number in which the stage was found, with the camera's motion and how fast the picture moved, radians a second. `features` is asked for those of
    /// a frame that is kept.
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
            self.best = Some((Keyframe { number, frame: frame.clone(), motion, features: Vec::new() }, speed));
        }
        let moved = self.last.map_or(f64::INFINITY, |last| {
            (last.translation - motion.pose.translation).norm() / distance_m + TURN_SHARE * last.rotation.angle_to(&motion.pose.rotation)
        });
        if moved < spacing {
            return;
        }
        self.last = Some(motion.pose);
        self.kept.extend(self.best.take().map(|(keyframe, _)| Keyframe { features: features(&keyframe.frame), ..keyframe }));
        if self.kept.len() > MOST_KEYFRAMES {
            let mut index = 0;
            self.kept.retain(|_| {
                index += 1;
                index % 2 == 1
            });
            self.spacing = Some(2.0 * spacing);
        }
    }

    /// All that were kept, in order.
    pub fn into_kept(self) -> Vec<Keyframe> {
        self.kept
    }
}
