//! From what a frame showed to the reason why it has no pose.
//!
//! A reason is found where the decision falls: acquisition knows how many of the frame's details are the picture's, and
//! whether any pose explains them; verification knows what its anchors lacked; the track state knows which poses disagree; and
//! the frame itself is dark, blank or blurred (`frame_look`).

use super::acquire::candidate::Recognition;
use super::body::reason::Reason;
use super::body::track_state::Doubt;
use super::frame::frame_look::FrameLook;
use super::patches::verify::Refusal;

/// Matches that agree on one homography from here on are no chance. Chance agrees on 8 now and then where a frame is full of detail.
/// Raised, a picture that is hardly seen counts as not recognised. Only the reason that is given depends on it.
const MIN_RECOGNISED: usize = 12;
/// Side of the picture (root of its area) below which size is what is wrong with it, as a share of the frame's width and in pixels:
/// features need some 60 pixels of it. Raised, other faults of a small picture are called its size.
const MIN_SIDE: f64 = 0.09;
const MIN_SIDE_PX: f64 = 60.0;
/// What a pose may leave of the matches beyond a homography, for the geometry not to be what is wrong: right ones leave 0.1 at most, a
/// width and a height that are swapped 2, and a rolling shutter that the config does not mention a few tenths. Raised, wrong sizes go
/// unnamed.
const MAX_MISFIT: f64 = 0.6;

impl Reason {
    /// Why a verified pose was not given.
    pub(super) fn of_doubt(doubt: Doubt) -> Self {
        match doubt {
            Doubt::First => Self::Unconfirmed,
            Doubt::Disagrees => Self::Jumped,
        }
    }

    /// Why no pose was verified in a frame: what was recognised, what verification refused, and how the frame looks.
    pub(super) fn of_failure(seen: &Recognition, refusal: Option<Refusal>, look: &FrameLook, width_px: u32) -> Self {
        let of_frame = look.fault().map(Self::from);
        if seen.agreeing < MIN_RECOGNISED {
            return of_frame.unwrap_or(Self::NotRecognised);
        }
        if seen.outline_px.is_some_and(|side| side < MIN_SIDE_PX.max(MIN_SIDE * f64::from(width_px))) {
            return Self::TooSmall;
        }
        // A homography needs no lens and no size. Where it explains the matches far better than any pose does, those are wrong.
        if seen.misfit.is_none_or(|misfit| misfit > MAX_MISFIT) {
            return of_frame.unwrap_or(Self::NoPoseFits);
        }
        match refusal {
            Some(Refusal::Contradicted(_)) | None => of_frame.unwrap_or(Self::NoPoseFits),
            Some(Refusal::Share(_) | Refusal::TooFew(_)) => of_frame.unwrap_or(Self::Covered),
            Some(Refusal::Clustered(_) | Refusal::Uncertain) => Self::Uncertain,
            Some(Refusal::Ambiguous(_) | Refusal::Repeated) => Self::Ambiguous,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(agreeing: usize, misfit: f64, outline_px: f64) -> Recognition {
        Recognition { agreeing, misfit: Some(misfit), outline_px: Some(outline_px), matches: Vec::new() }
    }

    fn reason(seen: &Recognition, refusal: Option<Refusal>) -> Reason {
        Reason::of_failure(seen, refusal, &FrameLook::default(), 640)
    }

    #[test]
    fn a_homography_without_a_pose_is_a_matter_of_geometry() {
        assert_eq!(reason(&seen(80, 2.0, 300.0), Some(Refusal::Share(0.1))), Reason::NoPoseFits);
        assert_eq!(reason(&Recognition { misfit: None, ..seen(80, 0.0, 300.0) }, None), Reason::NoPoseFits);
        assert_eq!(reason(&seen(80, 0.05, 300.0), Some(Refusal::Contradicted(90))), Reason::NoPoseFits);
    }

    #[test]
    fn a_pose_with_few_anchors_is_a_matter_of_the_view() {
        assert_eq!(reason(&seen(80, 0.05, 300.0), Some(Refusal::Share(0.1))), Reason::Covered);
        assert_eq!(reason(&seen(80, 0.05, 300.0), Some(Refusal::Uncertain)), Reason::Uncertain);
        assert_eq!(reason(&seen(40, 2.0, 30.0), Some(Refusal::Uncertain)), Reason::TooSmall);
        assert_eq!(reason(&seen(9, 0.0, 30.0), None), Reason::NotRecognised);
    }
}
