//! Why a frame has no pose: for each case one word, one sentence and one fix, for a person to act
//! on.
//!
//! `failure` determines the reason; no pose depends on it.

use crate::track::frame::frame_look::PictureFault;

/// Why a body is not tracked in a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Reason {
    /// The picture's details are visible, but no pose of a surface of this size, seen through this
    /// lens, explains where they are.
    NoPoseFits,
    /// The picture is recognised, but most of it is occluded or looks different.
    Covered,
    /// The picture is recognised, but too small in the frame.
    TooSmall,
    /// The picture is recognised, but too little of it is visible to estimate the pose well enough.
    Uncertain,
    /// The opposite tilt, a repetition within the picture or a second copy of it explains the frame
    /// as well.
    Ambiguous,
    /// The pose is far from the previous one, or from anywhere that the body can have reached.
    Jumped,
    /// Found and verified; the next frame must confirm it.
    Unconfirmed,
    /// The frame is nearly black.
    TooDark,
    /// The frame is mostly white.
    TooBright,
    /// The frame is blurred.
    TooBlurred,
    /// The frame shows a plain area.
    Blank,
    /// The frame has detail, but none of it matches the picture.
    NotRecognised,
    /// The frame could not be decoded.
    Undecodable,
    /// The row's timestamp does not follow the last one, or its picture has another size.
    Skipped,
    /// Another focal length than the calibrated one explains the frame clearly better.
    LensMoved,
    /// The picture is identical to the previous frame, byte for byte, which already gave its pose.
    Repeated,
    /// The frame shows two moments at once: interlaced fields, blended or torn frames.
    Mixed,
    /// The stage is seen from another pose than a fixed camera's configured one.
    CameraMoved,
}

impl From<PictureFault> for Reason {
    fn from(fault: PictureFault) -> Self {
        match fault {
            PictureFault::TooDark => Self::TooDark,
            PictureFault::TooBright => Self::TooBright,
            PictureFault::TooBlurred => Self::TooBlurred,
            PictureFault::Blank => Self::Blank,
        }
    }
}

impl Reason {
    /// All reasons, in the order of their numbers.
    pub const ALL: [Self; 18] = [
        Self::NoPoseFits,
        Self::Covered,
        Self::TooSmall,
        Self::Uncertain,
        Self::Ambiguous,
        Self::Jumped,
        Self::Unconfirmed,
        Self::TooDark,
        Self::TooBright,
        Self::TooBlurred,
        Self::Blank,
        Self::NotRecognised,
        Self::Undecodable,
        Self::Skipped,
        Self::LensMoved,
        Self::Repeated,
        Self::Mixed,
        Self::CameraMoved,
    ];

    /// Returns the word used in the summary and in events.
    pub fn word(self) -> &'static str {
        match self {
            Self::NoPoseFits => "no_pose_fits",
            Self::Covered => "covered",
            Self::TooSmall => "too_small",
            Self::Uncertain => "uncertain",
            Self::Ambiguous => "ambiguous",
            Self::Jumped => "jumped",
            Self::Unconfirmed => "unconfirmed",
            Self::TooDark => "too_dark",
            Self::TooBright => "too_bright",
            Self::TooBlurred => "too_blurred",
            Self::Blank => "blank",
            Self::NotRecognised => "not_recognised",
            Self::Undecodable => "undecodable",
            Self::Skipped => "skipped",
            Self::LensMoved => "lens_moved",
            Self::Repeated => "repeated",
            Self::Mixed => "mixed",
            Self::CameraMoved => "camera_moved",
        }
    }

    /// Returns what is wrong, as a short clause.
    pub fn message(self) -> &'static str {
        match self {
            Self::NoPoseFits => "the picture is recognised, but no pose fits",
            Self::Covered => "the picture is recognised, but most of it is covered or looks different",
            Self::TooSmall => "the picture is recognised, but it is too small in the frame",
            Self::Uncertain => "the picture is recognised, but too little of it is visible to determine the pose",
            Self::Ambiguous => {
                "two poses explain the picture about equally well: it is too far away or too flat to the lens to tell its tilt, it \
                 repeats itself, or a second copy of it is in view"
            }
            Self::Jumped => {
                "a pose is found that the camera cannot have reached since the last one: another copy of the picture may be in view"
            }
            Self::Unconfirmed => "a pose is found and waits for the next frame to confirm it",
            Self::TooDark => "the frame is too dark",
            Self::TooBright => "the frame is overexposed",
            Self::TooBlurred => "the frame is blurred",
            Self::Blank => "the frame shows a plain area without detail",
            Self::NotRecognised => "the frame has detail, but the picture is not recognised in it",
            Self::Undecodable => "the frame cannot be decoded",
            Self::Skipped => "the row is skipped: its stamp or its size does not fit the clip",
            Self::LensMoved => "the picture is recognised, but through a lens of another focal length than the calibration's",
            Self::Repeated => "the picture is identical to the one before: the camera or the capture device is frozen",
            Self::Mixed => "the frame mixes two moments, like interlaced, converted or torn video",
            Self::CameraMoved => "the stage is seen from another place than [camera.pose]: the camera was moved",
        }
    }

    /// Returns what to do about it.
    pub fn hint(self) -> &'static str {
        match self {
            Self::NoPoseFits => "check the order of the corners, size_m, position_m and the calibration",
            Self::Covered => "clear the view, or take a new photo of the stage as it looks now",
            Self::TooSmall => "go nearer, use a longer lens, or give a larger picture",
            Self::Uncertain => "let the camera see more of the stage, or go nearer",
            Self::Ambiguous => {
                "go nearer, add a surface that stands at another angle, break a repetition with something of its own, or cover the copy"
            }
            Self::Jumped => "cover other copies of the picture (prints, screens); else check the clip's stamps and its frame rate",
            Self::Unconfirmed => "nothing; if it persists, frames come too rarely: at least two a second are needed",
            Self::TooDark => "give more light or a longer exposure",
            Self::TooBright => "expose less, or turn the lamp out of the picture",
            Self::TooBlurred => "focus the lens, expose for a shorter time, or move the camera more slowly",
            Self::Blank => "take the lens cap off, and point the camera at the stage",
            Self::NotRecognised => {
                "point the camera at the stage, from near enough; if it was, name the picture of this stage as `image` or `photo`"
            }
            Self::Undecodable => "record the clip again, or repair it",
            Self::Skipped => "record with stamps that rise and frames of one size",
            Self::LensMoved => "set zoom and focus back, or calibrate the lens as it is now (`stagepose survey --lens refine` on a walk)",
            Self::Mixed => {
                "set the camera to progressive video, and the capture card to the camera's own frame rate and to whole frames, without conversion"
            }
            Self::CameraMoved => "set the camera back as it stood, or measure where it stands now (`stagepose freeze`)",
            Self::Repeated => "check the cable, the capture card and the USB port; set the card to the camera's own frame rate",
        }
    }

    /// Whether the picture was found in the frame.
    pub fn is_recognised(self) -> bool {
        use Reason::{Ambiguous, CameraMoved, Covered, Jumped, LensMoved, Mixed, NoPoseFits, TooSmall, Uncertain, Unconfirmed};
        matches!(self, NoPoseFits | Covered | TooSmall | Uncertain | Ambiguous | Jumped | Unconfirmed | LensMoved | Mixed | CameraMoved)
    }

    /// Whether a pose was found and verified in the frame, though not reported.
    pub fn is_verified(self) -> bool {
        matches!(self, Self::Jumped | Self::Unconfirmed | Self::LensMoved | Self::Mixed | Self::CameraMoved)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reason_words_are_unique_and_ordered_by_number() {
        let words: std::collections::HashSet<&str> = Reason::ALL.iter().map(|r| r.word()).collect();
        assert_eq!(words.len(), Reason::ALL.len());
        assert!(Reason::ALL.iter().enumerate().all(|(k, r)| *r as usize == k));
    }
}
