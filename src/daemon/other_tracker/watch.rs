//! Says what becomes of the other tracker: its status for health, and an event for every change of
//! its state or of the verdict.

use super::Known;
use crate::config::OtherTrackerSettings;
use crate::daemon::live::{Event, LiveLink};
use crate::delay::Verdict;
use crate::frame::Timestamp;
use crate::other_tracker::{Comparison, HeardState, Unalignable};
use crate::telemetry::{OtherTrackerStatus, TrackerDifference};

/// What was said last: the state, what is wrong, and the verdict.
#[derive(Debug, Default)]
pub(super) struct OtherTrackerWatch {
    said: Option<(&'static str, Option<String>, Option<String>)>,
}

impl OtherTrackerWatch {
    /// Publishes what has changed by now.
    pub fn look(&mut self, known: &Known, settings: &OtherTrackerSettings, now: Timestamp, link: &LiveLink) {
        let status = status(known, settings, now);
        let verdict = status.difference.as_ref().map(|difference| difference.verdict.clone());
        // Ages in the sentence change all the time; the fix does not.
        let said = (status.state, status.hint.clone(), verdict.clone());
        if self.said.as_ref() != Some(&said) {
            self.said = Some(said);
            let hint = status.hint.as_ref().map_or_else(String::new, |hint| format!("; {hint}"));
            let text = format!("other tracker: {}{hint}", status.sentence);
            link.events.publish(Event::OtherTracker { state: status.state.into(), verdict, text });
        }
        link.statistics.set_other_tracker(Some(status));
    }
}

/// Returns the status at a time.
fn status(known: &Known, settings: &OtherTrackerSettings, now: Timestamp) -> OtherTrackerStatus {
    let heard = &known.heard;
    let state = heard.state(now);
    let [zoom_raw, focus_raw] = heard.raw();
    // Poses of a tracker that is silent are compared no more.
    let compared = known.compared.as_ref().filter(|_| matches!(state, HeardState::Heard));
    let difference = compared.and_then(|compared| compared.as_ref().ok()).map(difference);
    let (sentence, hint) = match (&known.trouble, heard.complaint(now)) {
        (Some(trouble), _) => {
            let listen = settings.listen;
            (
                format!("cannot listen on {listen} ({trouble})"),
                Some("end the program that has the port, or change `listen` in [other_tracker]".to_owned()),
            )
        }
        (None, Some([said, hint])) => (said, Some(hint)),
        (None, None) => of_compared(known, &difference),
    };
    OtherTrackerStatus {
        state: state.word(),
        source: heard.source().map(ToString::to_string),
        rate_hz: heard.rate_hz().map(|hz| (hz * 10.0).round() / 10.0),
        zoom: heard.zoom(),
        zoom_raw,
        focus_raw,
        difference,
        sentence,
        hint,
    }
}

/// Says how the two differ while poses come.
fn of_compared(known: &Known, difference: &Option<TrackerDifference>) -> (String, Option<String>) {
    let source = known.heard.source().map_or_else(String::new, ToString::to_string);
    match (&known.compared, difference) {
        (Some(Ok(comparison)), Some(d)) => {
            let delay = d.delay_s.map_or("unknown".to_owned(), |[delay_s, _]| format!("{:.0} ms", delay_s * 1e3));
            let said = format!(
                "{source} differs by {:.1} mm and {:.2} degrees (root mean square of the last minute), delay {delay}, scale {:+.2} %: {}",
                d.rms_m * 1e3,
                d.rms_deg,
                d.scale * 100.0,
                d.verdict
            );
            let hint = (comparison.verdict != Verdict::Good).then(|| comparison.reasons.join("; "));
            (said, hint)
        }
        (Some(Err(Unalignable::Few(pairs))), _) => {
            (format!("{source} is heard; {pairs} instants of the last minute have a pose of both"), None)
        }
        (Some(Err(why)), _) => (format!("{source} is heard; {why}"), None),
        _ => (format!("{source} is heard; the first comparison comes in a few seconds"), None),
    }
}

fn difference(comparison: &Comparison) -> TrackerDifference {
    let d = &comparison.differences;
    TrackerDifference {
        pairs: d.pairs,
        delay_s: comparison.delay_s,
        rms_m: d.distance_m.rms,
        p95_m: d.distance_m.p95,
        rms_deg: d.angle_deg.rms,
        p95_deg: d.angle_deg.p95,
        scale: d.scale,
        verdict: comparison.verdict.to_string(),
    }
}
