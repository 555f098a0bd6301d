//! Summarises a whole clip or show in one or two sentences: how much was recognised and tracked,
//! and why the rest was not.

use serde::{Serialize, Serializer};

use crate::record::{PoseSample, State};
use crate::track::Reason;

/// Counts of frames, tracked frames, and the reasons for the others.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Outcome {
    /// Frames so far.
    pub frames: u64,
    /// Frames with a reported pose.
    pub tracked: u64,
    reasons: [u64; Reason::ALL.len()],
}

/// Number of most frequent reasons that get a sentence each; the others are only counted. Chosen,
/// not tuned. Raised, the summary is longer.
const MAX_DETAILED_REASONS: usize = 2;
/// The sentence for a clip of one picture.
const ONE_FRAME: &str =
    "One picture is not enough for a pose, because every pose is checked against another frame's: give two or more pictures, or a clip";
/// Minimum share of frames for a reason after the first to get a sentence. Chosen: as for `check`'s
/// notes. Raised, rarer reasons are only counted.
const MIN_SHARE: f64 = 0.02;

impl Outcome {
    /// Counts a sample; stale messages do not count.
    pub fn add(&mut self, sample: &PoseSample) {
        if sample.state == State::Stale {
            return;
        }
        self.frames += 1;
        match sample.reason {
            _ if sample.state == State::Tracking => self.tracked += 1,
            Some(reason) => self.reasons[reason as usize] += 1,
            // A tracker always states a reason; samples from elsewhere may not.
            None => {}
        }
    }

    /// Returns the number of frames with a verified pose, reported or not.
    pub fn followed(&self) -> u64 {
        self.tracked + self.sum(Reason::is_verified)
    }

    /// Returns the number of frames with this reason.
    fn count(&self, reason: Reason) -> u64 {
        self.reasons[reason as usize]
    }

    /// Returns the number of frames that showed the picture, tracked or not.
    pub fn recognised(&self) -> u64 {
        self.tracked + self.sum(Reason::is_recognised)
    }

    fn sum(&self, which: impl Fn(Reason) -> bool) -> u64 {
        Reason::ALL.iter().filter(|r| which(**r)).map(|r| self.count(*r)).sum()
    }

    /// Returns the reasons that occurred, most frequent first.
    pub fn reasons(&self) -> Vec<(Reason, u64)> {
        let mut found: Vec<(Reason, u64)> = Reason::ALL.iter().map(|r| (*r, self.count(*r))).filter(|(_, n)| *n > 0).collect();
        found.sort_by_key(|(_, n)| std::cmp::Reverse(*n));
        found
    }

    /// Returns the counts of the reasons that occurred, for the summary.
    pub fn counts(&self) -> ByWord<u64> {
        ByWord(self.reasons().into_iter().map(|(reason, n)| (reason.word(), n)).collect())
    }

    /// Whether there is a single frame whose pose still needs a second frame to confirm it.
    pub fn awaits_a_second_frame(&self) -> bool {
        self.frames == 1 && self.count(Reason::Unconfirmed) == 1
    }

    /// Returns one sentence on what was tracked and up to [`MAX_DETAILED_REASONS`] on why the rest
    /// was not.
    pub fn sentences(&self) -> String {
        let Self { frames, tracked, .. } = *self;
        if frames == 0 {
            return "No frame came.".to_owned();
        }
        if self.awaits_a_second_frame() {
            return format!("The picture is recognised in {frames} of {frames} frames. {ONE_FRAME}.");
        }
        let recognised = self.recognised();
        let mut text = match (tracked, recognised) {
            (_, 0) => format!("The picture is recognised in none of {frames} frames."),
            (0, _) => format!("The picture is recognised in {recognised} of {frames} frames, and tracked in none."),
            _ if tracked == frames => format!("The picture is tracked in all {frames} frames."),
            _ => format!("The picture is recognised in {recognised} of {frames} frames and tracked in {tracked}."),
        };
        // Every acquisition waits one frame for its confirmation, so a few of these are normal.
        let faults: Vec<(Reason, u64)> = self.reasons().into_iter().filter(|(r, n)| *r != Reason::Unconfirmed || *n * 4 > frames).collect();
        let worth = |k: usize, n: u64| k == 0 || n as f64 >= MIN_SHARE * frames as f64;
        let detailed = faults.iter().enumerate().take(MAX_DETAILED_REASONS).filter(|(k, (_, n))| worth(*k, *n));
        for (_, (reason, n)) in detailed {
            let of = if *n == 1 { "1 frame".to_owned() } else { format!("{n} frames") };
            text += &format!(" In {of} {}: {}.", reason.message(), reason.hint());
        }
        text
    }
}

/// Words with their values, serialised as a JSON object in this order.
pub(super) struct ByWord<V>(pub Vec<(&'static str, V)>);

impl<V: Serialize> Serialize for ByWord<V> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.iter().map(|(word, value)| (word, value)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outcome(tracked: u64, reasons: &[(Reason, u64)]) -> Outcome {
        let mut outcome = Outcome { tracked, frames: tracked, ..Outcome::default() };
        for (reason, n) in reasons {
            outcome.reasons[*reason as usize] += n;
            outcome.frames += n;
        }
        outcome
    }

    #[test]
    fn a_single_picture_gets_no_advice_to_wait_for_another() {
        let said = outcome(0, &[(Reason::Unconfirmed, 1)]).sentences();
        assert!(said.contains("One picture is not enough") && !said.contains("too rarely"), "{said}");
        assert!(!outcome(0, &[(Reason::NotRecognised, 1)]).sentences().contains("One picture"));
        assert!(!outcome(0, &[(Reason::Unconfirmed, 2)]).sentences().contains("One picture"));
    }

    #[test]
    fn a_fully_tracked_clip_is_summed_up_in_one_sentence() {
        assert_eq!(outcome(90, &[]).sentences(), "The picture is tracked in all 90 frames.");
        assert_eq!(outcome(89, &[(Reason::Unconfirmed, 1)]).sentences(), "The picture is recognised in 90 of 90 frames and tracked in 89.");
    }

    #[test]
    fn the_most_frequent_reason_comes_first_with_its_hint() {
        let text = outcome(0, &[(Reason::NotRecognised, 34), (Reason::NoPoseFits, 127)]).sentences();
        assert_eq!(
            text,
            "The picture is recognised in 127 of 161 frames, and tracked in none. In 127 frames the picture is recognised, but no pose \
             fits: check the order of the corners, size_m, position_m and the calibration. In 34 frames the frame has detail, but the \
             picture is not recognised in it: point the camera at the stage, from near enough; if it was, name the picture of this stage \
             as `image` or `photo`."
        );
    }

    #[test]
    fn an_outcome_without_frames_does_not_divide_by_zero() {
        assert_eq!(Outcome::default().sentences(), "No frame came.");
    }

    #[test]
    fn outcome_counts_are_complete_and_keyed_by_reason() {
        let outcome = outcome(2, &[(Reason::TooDark, 3), (Reason::Covered, 1)]);
        let json = serde_json::to_value(outcome.counts()).unwrap();
        assert_eq!(json, serde_json::json!({"too_dark": 3, "covered": 1}));
        assert_eq!((outcome.recognised(), outcome.followed(), outcome.frames), (3, 2, 6));
    }
}
