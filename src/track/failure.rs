//! Decides why a frame has no pose.
//!
//! Each stage of the search records what it lacked: acquisition knows how many matches agree and
//! whether any pose explains them; verification knows what its anchors lacked; the track state
//! knows which poses disagree; `frame_look` knows whether the frame is dark, blank or blurred. This
//! module combines them into one [`Reason`], from the earliest stage that failed. It does not
//! influence tracking.

use super::acquire::candidate::Recognition;
use super::body::reason::Reason;
use super::body::track_state::Doubt;
use super::frame::frame_look::FrameLook;
use super::patches::verify::Refusal;
use super::tuning::frame_order::TUNING;

impl Reason {
    /// Returns why a verified pose was not reported.
    pub(super) fn of_doubt(doubt: Doubt) -> Self {
        match doubt {
            Doubt::First => Self::Unconfirmed,
            Doubt::Disagrees => Self::Jumped,
        }
    }

    /// Returns why no pose was verified. `seen`: what was recognised; `refusal`: why verification
    /// refused; `look`: the frame's appearance; `width_px`: the frame's width.
    pub(super) fn of_failure(seen: &Recognition, refusal: Option<Refusal>, look: &FrameLook, width_px: u32) -> Self {
        let of_frame = look.fault().map(Self::from);
        if seen.agreeing < TUNING.min_recognised_matches {
            return of_frame.unwrap_or(Self::NotRecognised);
        }
        if seen
            .outline_px
            .is_some_and(|side| side < TUNING.min_recognisable_side_px.max(TUNING.min_recognisable_width_ratio * f64::from(width_px)))
        {
            return Self::TooSmall;
        }
        // A homography assumes neither lens nor size. If it explains the matches far better than
        // any pose does, lens or size is wrong.
        if seen.misfit.is_none_or(|misfit| misfit > TUNING.max_geometry_misfit) {
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
    fn a_homography_without_a_pose_is_reported_as_geometry() {
        assert_eq!(reason(&seen(80, 2.0, 300.0), Some(Refusal::Share(0.1))), Reason::NoPoseFits);
        assert_eq!(reason(&Recognition { misfit: None, ..seen(80, 0.0, 300.0) }, None), Reason::NoPoseFits);
        assert_eq!(reason(&seen(80, 0.05, 300.0), Some(Refusal::Contradicted(90))), Reason::NoPoseFits);
    }

    #[test]
    fn a_pose_with_few_anchors_is_reported_by_its_view() {
        assert_eq!(reason(&seen(80, 0.05, 300.0), Some(Refusal::Share(0.1))), Reason::Covered);
        assert_eq!(reason(&seen(80, 0.05, 300.0), Some(Refusal::Uncertain)), Reason::Uncertain);
        assert_eq!(reason(&seen(40, 2.0, 30.0), Some(Refusal::Uncertain)), Reason::TooSmall);
        assert_eq!(reason(&seen(9, 0.0, 30.0), None), Reason::NotRecognised);
    }
}
