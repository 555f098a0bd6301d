//! The last sample, for requests, and every sample as it comes, for WebSockets.
//!
//! Both are told how old a frame is by the same rule as the outputs: once the newest frame is older than the limit, the answer is that no
//! pose is known, whatever the last record was, and so it is where a record comes late. A record whose stamp does not follow the last one
//! (a row that was skipped) says nothing of the bodies and is passed over.

use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;

use axum::extract::ws::Utf8Bytes;
use serde_json::json;
use tokio::sync::broadcast;

use super::routes::Reply;
use crate::publish::FrameClock;
use crate::record::{PoseSample, State};

/// Records that a client may be behind before it is let go.
const MOST_BEHIND: usize = 256;
/// How often a silence is said again, nanoseconds.
const REPEAT_NS: i64 = 1_000_000_000;

/// What has been published so far.
#[derive(Debug)]
pub(super) struct Feed {
    ages: OnceLock<Ages>,
    last: Mutex<Last>,
    lines: broadcast::Sender<Utf8Bytes>,
}

/// How old frames are, and may be.
#[derive(Debug)]
struct Ages {
    clock: Arc<FrameClock>,
    most_ns: i64,
}

#[derive(Debug, Default)]
struct Last {
    /// The last record, and when its frame was taken.
    record: Option<(Arc<PoseSample>, i64)>,
    /// What came after it says that no frame comes.
    silence: Option<Arc<PoseSample>>,
    /// When a silence was last said.
    said_ns: Option<i64>,
}

impl Feed {
    pub fn new() -> Self {
        Self { ages: OnceLock::new(), last: Mutex::default(), lines: broadcast::Sender::new(MOST_BEHIND) }
    }

    /// From now on a frame older than `most` is too old. Only the first call counts.
    pub fn judge_ages(&self, clock: Arc<FrameClock>, most: Duration) {
        self.ages.get_or_init(|| Ages { clock, most_ns: i64::try_from(most.as_nanos()).unwrap_or(i64::MAX) });
    }

    fn last(&self) -> MutexGuard<'_, Last> {
        self.last.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes a sample; never waits.
    pub fn publish(&self, sample: &PoseSample) {
        let mut last = self.last();
        if sample.state == State::Stale {
            last.silence = Some(Arc::new(sample.clone()));
            return self.say_silence(&mut last);
        }
        let taken_ns = match self.ages.get() {
            None => 0,
            Some(_) if last.record.as_ref().is_some_and(|(before, _)| sample.timestamp_ns <= before.timestamp_ns) => return,
            Some(ages) => match ages.clock.taken_ns(sample.timestamp_ns, 0) {
                Some(taken_ns) => taken_ns,
                None => return,
            },
        };
        *last = Last { record: Some((Arc::new(sample.clone()), taken_ns)), ..Last::default() };
        if self.is_too_old(&last) {
            self.say_silence(&mut last);
        } else {
            self.send(|| sample.to_json_line());
        }
    }

    /// Says that the newest frame has become too old, once a second; called several times a second.
    pub fn watch(&self) {
        let Some(ages) = self.ages.get() else { return };
        let now_ns = ages.clock.now().boot_ns;
        let mut last = self.last();
        let is_said = last.said_ns.is_some_and(|said_ns| now_ns.saturating_sub(said_ns) < REPEAT_NS);
        if !is_said && self.is_too_old(&last) {
            self.say_silence(&mut last);
        }
    }

    fn say_silence(&self, last: &mut Last) {
        last.said_ns = self.ages.get().map(|ages| ages.clock.now().boot_ns);
        self.send(|| self.silence(last).to_json_line());
    }

    fn send(&self, line: impl FnOnce() -> String) {
        if self.lines.receiver_count() > 0 {
            // Nobody may be left to hear it by now.
            let _ = self.lines.send(line().into());
        }
    }

    /// How old the newest frame is, where that is known.
    fn age_ns(&self, last: &Last) -> Option<i64> {
        let (ages, (_, taken_ns)) = (self.ages.get()?, last.record.as_ref()?);
        Some(ages.clock.now().boot_ns.saturating_sub(*taken_ns).max(0))
    }

    fn is_too_old(&self, last: &Last) -> bool {
        last.silence.is_some() || self.ages.get().is_some_and(|ages| self.age_ns(last).is_some_and(|age_ns| age_ns >= ages.most_ns))
    }

    /// The message that no frame comes, with the newest one's age as it is now.
    fn silence(&self, last: &Last) -> PoseSample {
        let (sequence, stamp_ns) = last.record.as_ref().map_or((0, 0), |(record, _)| (record.sequence, record.timestamp_ns));
        let told_ms = last.silence.as_ref().and_then(|silence| silence.times.age_ms);
        let age_ms = self.age_ns(last).map(|ns| ns as f64 * 1e-6).or(told_ms);
        PoseSample::stale(sequence, stamp_ns, age_ms.unwrap_or(0.0))
    }

    /// Every line from now on.
    pub fn lines(&self) -> broadcast::Receiver<Utf8Bytes> {
        self.lines.subscribe()
    }

    /// How many listen.
    #[cfg(test)]
    pub fn clients(&self) -> usize {
        self.lines.receiver_count()
    }

    /// `GET /api/v1/pose`: the last record, or that it is too old; 503 before the first.
    pub fn pose(&self) -> Reply {
        let last = self.last();
        match &last.record {
            _ if self.is_too_old(&last) => Reply::json(200, self.silence(&last).to_json_line()),
            Some((record, _)) => Reply::json(200, record.to_json_line()),
            None => Reply::json(503, r#"{"error":"no frame has been tracked yet"}"#),
        }
    }

    /// `GET /api/v1/state`: what is known, of which frame, and how old that frame is.
    pub fn state(&self) -> Reply {
        let last = self.last();
        let is_too_old = self.is_too_old(&last);
        let told = |state: State| if is_too_old { State::Stale } else { state };
        let Some((record, _)) = &last.record else {
            let state = is_too_old.then_some(State::Stale);
            return Reply::json(200, json!({"state": state, "sequence": null, "age_s": null, "objects": []}).to_string());
        };
        let objects: Vec<_> = record.objects.iter().map(|o| json!({"name": o.name, "state": told(o.state)})).collect();
        let age_s = self.age_ns(&last).map(|ns| (ns as f64 * 1e-6).round() * 1e-3);
        let state = json!({
            "state": told(record.state), "sequence": record.sequence, "timestamp_ns": record.timestamp_ns,
            "age_s": age_s, "objects": objects,
        });
        Reply::json(200, state.to_string())
    }
}
