//! The last sample, for requests, and every sample as it comes, for WebSockets.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use axum::extract::ws::Utf8Bytes;
use serde_json::json;
use tokio::sync::broadcast;

use super::routes::Reply;
use crate::record::PoseSample;

/// Records that a client may be behind before it is let go.
const MOST_BEHIND: usize = 256;

/// What has been published so far.
#[derive(Debug)]
pub(super) struct Feed {
    last: Mutex<Option<(Arc<PoseSample>, Instant)>>,
    lines: broadcast::Sender<Utf8Bytes>,
}

impl Feed {
    pub fn new() -> Self {
        Self { last: Mutex::new(None), lines: broadcast::Sender::new(MOST_BEHIND) }
    }

    /// Takes a sample; never waits.
    pub fn publish(&self, sample: &PoseSample) {
        let shared = Arc::new(sample.clone());
        *self.last.lock().unwrap_or_else(PoisonError::into_inner) = Some((shared, Instant::now()));
        if self.lines.receiver_count() > 0 {
            // Nobody may be left to hear it by now.
            let _ = self.lines.send(sample.to_json_line().into());
        }
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

    fn last(&self) -> Option<(Arc<PoseSample>, f64)> {
        let last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        last.as_ref().map(|(sample, when)| (sample.clone(), when.elapsed().as_secs_f64()))
    }

    /// `GET /api/v1/pose`: the last record; 503 before the first.
    pub fn pose(&self) -> Reply {
        match self.last() {
            Some((sample, _)) => Reply::json(200, sample.to_json_line()),
            None => Reply::json(503, r#"{"error":"no frame has been tracked yet"}"#),
        }
    }

    /// `GET /api/v1/state`: what is known, of which frame, and how long ago it was published.
    pub fn state(&self) -> Reply {
        let Some((sample, age_s)) = self.last() else {
            return Reply::json(200, json!({"state": null, "sequence": null, "age_s": null, "objects": []}).to_string());
        };
        let objects: Vec<_> = sample.objects.iter().map(|o| json!({"name": o.name, "state": o.state})).collect();
        let state = json!({
            "state": sample.state, "sequence": sample.sequence, "timestamp_ns": sample.timestamp_ns,
            "age_s": (age_s * 1e3).round() / 1e3, "objects": objects,
        });
        Reply::json(200, state.to_string())
    }
}
