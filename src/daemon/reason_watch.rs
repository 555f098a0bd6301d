//! Turns the reasons of single frames into events: a single frame may fail for any reason, but a
//! second without a pose is worth a line.

use std::time::Duration;

use super::live::Event;
use crate::frame::Timestamp;
use crate::record::{PoseSample, State};
use crate::track::Reason;

/// Time without a pose after which a loss is reported, and again when its reason changes. Shorter
/// gaps (a hand in front of the lens, a whip pan) would fill the log. Raised, a loss is reported
/// later.
const REPORT_AFTER: Duration = Duration::from_secs(1);

/// Watches samples, by their stamps.
#[derive(Debug, Default)]
pub struct ReasonWatch {
    /// Stamp of the first frame without a pose in this window.
    since: Option<Timestamp>,
    /// When tracking ended, or the first frame came.
    lost: Option<Timestamp>,
    counts: [u32; Reason::ALL.len()],
    last_report: LastReport,
}

/// What was reported last.
#[derive(Debug, Default, PartialEq, Eq)]
enum LastReport {
    #[default]
    Nothing,
    Tracking,
    Reason(Reason),
}

impl ReasonWatch {
    /// Takes a sample and returns the event that it completes.
    pub fn seen(&mut self, sample: &PoseSample) -> Option<Event> {
        if sample.state == State::Stale {
            return None;
        }
        let now = sample.timestamp;
        let Some(reason) = sample.reason.filter(|_| sample.state != State::Tracking) else {
            let after_ms = self.lost.take().map_or(0.0, |lost| now.ms_since(lost));
            self.start_window(None);
            let is_new = self.last_report != LastReport::Tracking;
            self.last_report = LastReport::Tracking;
            return is_new.then_some(Event::Tracked { after_ms });
        };
        self.lost.get_or_insert(now);
        let since = *self.since.get_or_insert(now);
        self.counts[reason as usize] += 1;
        if now.duration_since(since) < REPORT_AFTER {
            return None;
        }
        let most = Reason::ALL.into_iter().max_by_key(|r| self.counts[*r as usize]).unwrap_or(reason);
        self.start_window(Some(now));
        let is_new = self.last_report != LastReport::Reason(most);
        self.last_report = LastReport::Reason(most);
        // Mixed frames have their own report, which names the setting.
        (is_new && most != Reason::Mixed)
            .then(|| Event::NotTracked { reason: most.word().into(), text: format!("{}: {}", most.message(), most.hint()) })
    }

    fn start_window(&mut self, since: Option<Timestamp>) {
        self.since = since;
        self.counts = Default::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::StageTimes;

    fn sample(k: i64, state: State, reason: Option<Reason>) -> PoseSample {
        let (sequence, timestamp) = (k as u64, Timestamp::from_ns(k * 100_000_000));
        let (pose, measurement, objects, times) = (None, None, Vec::new(), StageTimes::default());
        PoseSample { sequence, timestamp, state, pose, measurement, objects, reason, learnt: Default::default(), times }
    }

    /// Returns the events with the frame that completes each; ten frames per second.
    fn events(frames: &[Option<Reason>]) -> Vec<(usize, Event)> {
        let mut watch = ReasonWatch::default();
        let state = |r: &Option<Reason>| if r.is_some() { State::Lost } else { State::Tracking };
        frames.iter().enumerate().filter_map(|(k, r)| Some((k, watch.seen(&sample(k as i64, state(r), *r))?))).collect()
    }

    fn word(event: &Event) -> &str {
        match event {
            Event::NotTracked { reason, .. } => reason,
            Event::Tracked { .. } => "tracked",
            _ => "another",
        }
    }

    #[test]
    fn a_second_without_a_pose_is_reported_once_with_its_end() {
        let mut frames = vec![None; 3];
        frames.extend([Some(Reason::Covered); 25]);
        frames.extend([Some(Reason::TooDark); 20]);
        frames.extend([None; 3]);
        let events = events(&frames);
        let words: Vec<&str> = events.iter().map(|(_, e)| word(e)).collect();
        assert_eq!(words, ["tracked", "covered", "too_dark", "tracked"]);
        assert_eq!((events[1].0, events[3].0), (13, 48));
        assert!(matches!(events[3].1, Event::Tracked { after_ms } if (after_ms - 4500.0).abs() < 1e-6), "{:?}", events[3]);
    }

    #[test]
    fn reasons_with_their_own_event_are_not_reported_again() {
        let mut frames = vec![None; 3];
        frames.extend([Some(Reason::Mixed); 25]);
        frames.extend([None; 3]);
        let words: Vec<String> = events(&frames).iter().map(|(_, e)| word(e).to_owned()).collect();
        assert_eq!(words, ["tracked", "tracked"]);
    }

    #[test]
    fn a_short_gap_is_not_reported() {
        let mut frames = vec![None; 3];
        frames.extend([Some(Reason::TooBlurred); 5]);
        frames.extend([None; 3]);
        assert_eq!(events(&frames).len(), 1);
    }
}
