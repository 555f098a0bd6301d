//! The last sample, for requests, and every sample as it comes, for WebSockets.
//!
//! Both judge a frame's age by the outputs' rule: once the newest frame is older than the limit,
//! the answer is that no pose is known, whatever the last record was. The same holds for a record
//! that arrives late. A record whose stamp does not follow the last one (a skipped row) says
//! nothing about the bodies and is ignored.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use axum::extract::ws::Utf8Bytes;
use serde_json::{Value, json};
use tokio::sync::broadcast;

use super::reply::Reply;
use crate::frame::Timestamp;
use crate::publish::FrameClock;
use crate::record::{PoseSample, State};

/// Maximum records that a client may be behind before it is dropped: about 8 seconds at 30 per
/// second. Chosen, not tuned. Raised, slow clients show older poses, and more lines are held.
const MAX_BEHIND: usize = 256;
/// Interval at which a silence is repeated. Chosen, not tuned. Raised, a client that connects later
/// learns of it later.
const REPEAT: Duration = Duration::from_secs(1);

/// What has been published so far.
#[derive(Debug)]
pub(super) struct Feed {
    ages: Mutex<Option<Ages>>,
    last: Mutex<Last>,
    lines: broadcast::Sender<Utf8Bytes>,
}

/// The clock for frames' ages, and the age limit.
#[derive(Debug, Clone)]
struct Ages {
    clock: Arc<FrameClock>,
    most: Duration,
}

#[derive(Debug, Default)]
struct Last {
    /// The last record, and when its frame was taken.
    record: Option<(Arc<PoseSample>, Timestamp)>,
    /// The stale message that followed it.
    silence: Option<Arc<PoseSample>>,
    /// When a silence was last reported.
    sent_at: Option<Timestamp>,
}

fn milliseconds(age: Duration) -> f64 {
    age.as_nanos() as f64 * 1e-6
}

impl Feed {
    pub fn new() -> Self {
        Self { ages: Mutex::default(), last: Mutex::default(), lines: broadcast::Sender::new(MAX_BEHIND) }
    }

    /// Treats frames older than `most` as too old from now on.
    pub fn judge_ages(&self, clock: Arc<FrameClock>, most: Duration) {
        *self.ages.lock().unwrap_or_else(PoisonError::into_inner) = Some(Ages { clock, most });
    }

    fn ages(&self) -> Option<Ages> {
        self.ages.lock().unwrap_or_else(PoisonError::into_inner).clone()
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
        let taken = match &self.ages() {
            None => Timestamp::default(),
            Some(_) if last.record.as_ref().is_some_and(|(before, _)| sample.timestamp <= before.timestamp) => return,
            Some(ages) => match ages.clock.taken(sample.timestamp, Duration::ZERO) {
                Some(taken) => taken,
                None => return,
            },
        };
        *last = Last { record: Some((Arc::new(sample.clone()), taken)), ..Last::default() };
        if self.is_too_old(&last) {
            self.say_silence(&mut last);
        } else {
            self.send(|| sample.to_json_line());
        }
    }

    /// Reports once a second that the newest frame is too old; called several times a second.
    pub fn watch(&self) {
        let Some(ages) = self.ages() else { return };
        let now = ages.clock.now().boot;
        let mut last = self.last();
        let was_just_sent = last.sent_at.is_some_and(|sent_at| now.duration_since(sent_at) < REPEAT);
        if !was_just_sent && self.is_too_old(&last) {
            self.say_silence(&mut last);
        }
    }

    fn say_silence(&self, last: &mut Last) {
        last.sent_at = self.ages().map(|ages| ages.clock.now().boot);
        self.send(|| self.silence(last).to_json_line());
    }

    fn send(&self, line: impl FnOnce() -> String) {
        if self.lines.receiver_count() > 0 {
            // By now there may be no client left.
            let _ = self.lines.send(line().into());
        }
    }

    /// Returns the newest frame's age, if known.
    fn age(&self, last: &Last) -> Option<Duration> {
        let (ages, (_, taken)) = (self.ages()?, last.record.as_ref()?);
        Some(ages.clock.now().boot.duration_since(*taken))
    }

    fn is_too_old(&self, last: &Last) -> bool {
        last.silence.is_some() || self.ages().is_some_and(|ages| self.age(last).is_some_and(|age| age >= ages.most))
    }

    /// Returns the stale message, with the newest frame's current age.
    fn silence(&self, last: &Last) -> PoseSample {
        let (sequence, timestamp) = last.record.as_ref().map(|(record, _)| (record.sequence, record.timestamp)).unwrap_or_default();
        let reported_ms = last.silence.as_ref().and_then(|silence| silence.times.age_ms);
        let age_ms = self.age(last).map(milliseconds).or(reported_ms);
        PoseSample::stale(sequence, timestamp, age_ms.unwrap_or(0.0))
    }

    /// Returns a channel with every line from now on.
    pub fn lines(&self) -> broadcast::Receiver<Utf8Bytes> {
        self.lines.subscribe()
    }

    /// Returns the number of listeners.
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

    /// `GET /api/v1/state`.
    pub fn state(&self) -> Reply {
        Reply::json(200, self.known().to_string())
    }

    /// Returns the known state, its frame, and that frame's age.
    pub fn known(&self) -> Value {
        let last = self.last();
        let is_too_old = self.is_too_old(&last);
        let shown = |state: State| if is_too_old { State::Stale } else { state };
        let Some((record, _)) = &last.record else {
            let state = is_too_old.then_some(State::Stale);
            return json!({"state": state, "sequence": null, "age_s": null, "objects": []});
        };
        let objects: Vec<_> = record.objects.iter().map(|o| json!({"name": o.name, "state": shown(o.state)})).collect();
        let age_s = self.age(&last).map(|age| milliseconds(age).round() * 1e-3);
        json!({
            "state": shown(record.state), "sequence": record.sequence, "timestamp_ns": record.timestamp,
            "age_s": age_s, "objects": objects,
        })
    }
}
