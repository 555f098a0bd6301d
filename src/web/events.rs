//! Events besides the poses, for `/ws/events`: first the latest ones, then each new event.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{SystemTime, UNIX_EPOCH};

use axum::extract::ws::{Message, Utf8Bytes, WebSocket};
use serde::Serialize;
use tokio::sync::{broadcast, watch};
use tokio::time::timeout;

use super::lifetime::{TAKES_WITHIN, close, ended};
use crate::daemon::live::{Event, EventListener, StampedEvent};
use crate::printable::printable;

/// Number of past events that a new client receives: an evening's, unless something fails again and
/// again. Chosen, not tuned. Raised, only memory.
const REMEMBERED: usize = 200;
/// Maximum events that a client may be behind before it is dropped. Chosen, not tuned. Raised, only
/// memory.
const MAX_BEHIND: usize = 256;

/// Past events and the clients' channel.
#[derive(Debug)]
pub(super) struct Events {
    /// The source of events.
    source: Mutex<Option<EventListener>>,
    recent: Mutex<VecDeque<Utf8Bytes>>,
    lines: broadcast::Sender<Utf8Bytes>,
}

/// An event as it is sent.
#[derive(Serialize)]
struct Line<'a> {
    /// When it was received, milliseconds since 1970.
    unix_ms: u64,
    /// `error`, `warn` or `info`.
    level: &'static str,
    #[serde(rename = "says")]
    message: String,
    #[serde(flatten)]
    event: &'a StampedEvent,
}

impl Events {
    pub fn new() -> Self {
        Self { source: Mutex::default(), recent: Mutex::default(), lines: broadcast::Sender::new(MAX_BEHIND) }
    }

    /// Follows these events from now on.
    pub fn follow(&self, source: EventListener) {
        *self.source.lock().unwrap_or_else(PoisonError::into_inner) = Some(source);
    }

    /// Takes the events since the last call; called several times a second.
    pub fn watch(&self) {
        let source = self.source.lock().unwrap_or_else(PoisonError::into_inner);
        // Dropped frames are only counted; there may be thousands.
        let events = source.iter().flat_map(|source| source.try_iter()).filter(|e| !matches!(e.event, Event::FrameDropped { .. }));
        for (line, is_kept) in events.filter_map(|event| Some((line(&event)?, !event.event.is_progress()))) {
            let mut recent = self.recent.lock().unwrap_or_else(PoisonError::into_inner);
            if is_kept {
                if recent.len() == REMEMBERED {
                    recent.pop_front();
                }
                recent.push_back(line.clone());
            }
            // Sent under the lock, so that a new client gets each event once. There may be no
            // client.
            let _ = self.lines.send(line);
        }
    }

    /// Returns the last events, and a channel with those to come.
    fn listen(&self) -> (Vec<Utf8Bytes>, broadcast::Receiver<Utf8Bytes>) {
        let recent = self.recent.lock().unwrap_or_else(PoisonError::into_inner);
        (recent.iter().cloned().collect(), self.lines.subscribe())
    }
}

/// Returns an event's severity as a word, and its sentence.
pub(super) fn level_and_message(event: &Event) -> (&'static str, String) {
    let (level, message) = event.message();
    let level = match level {
        tracing::Level::ERROR => "error",
        tracing::Level::WARN => "warn",
        _ => "info",
    };
    (level, message)
}

pub(super) fn line(event: &StampedEvent) -> Option<Utf8Bytes> {
    let unix_ms = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_millis() as u64);
    let (level, message) = level_and_message(&event.event);
    // Serialising fails only for non-string map keys, of which there are none.
    let line = serde_json::to_string(&Line { unix_ms, level, message, event }).ok()?;
    Some(printable(&line).into_owned().into())
}

/// Serves one client until it goes.
pub(super) async fn tell(mut socket: WebSocket, events: Arc<Events>, mut stopped: watch::Receiver<bool>) {
    let (recent, mut lines) = events.listen();
    let mut recent = recent.into_iter();
    loop {
        let line = match recent.next() {
            Some(line) => line,
            None => tokio::select! {
                line = lines.recv() => match line {
                    Ok(line) => line,
                    // The client is further behind than the queue holds, or the server ends.
                    Err(_) => break,
                },
                message = socket.recv() => match message {
                    Some(Ok(Message::Close(_)) | Err(_)) | None => return,
                    // Clients have nothing to say here.
                    Some(Ok(_)) => continue,
                },
                () = ended(&mut stopped) => break,
            },
        };
        match timeout(TAKES_WITHIN, socket.send(Message::Text(line))).await {
            Ok(Ok(())) => {}
            _ => return,
        }
    }
    close(socket).await;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::daemon::live::EventLog;

    fn read(lines: &[Utf8Bytes]) -> Vec<serde_json::Value> {
        lines.iter().map(|line| serde_json::from_str(line.as_str()).unwrap()).collect()
    }

    #[test]
    fn late_listeners_get_recent_events_and_all_get_new_ones() {
        let (events, log) = (Events::new(), EventLog::default());
        log.publish(Event::NoDriverStamp { name: "before".to_owned() });
        events.follow(log.listen());
        let (_, mut early) = events.listen();
        for k in 0..REMEMBERED + 5 {
            log.publish(Event::CameraLost { reason: format!("reason {k}") });
            log.publish(Event::FrameDropped { timestamp: crate::frame::Timestamp::default() });
        }
        events.watch();
        let (recent, mut late) = events.listen();
        let lines = read(&recent);
        assert_eq!((lines.len(), &lines[0]["reason"]), (REMEMBERED, &"reason 5".into()));
        assert_eq!((&lines[0]["event"], &lines[0]["level"]), (&"camera_lost".into(), &"warn".into()));
        assert_eq!(lines[0]["says"], "the camera is lost: reason 5");
        assert!(lines[0]["unix_ms"].as_u64() > Some(1_600_000_000_000));
        log.publish(Event::CameraWaiting { reason: "a\u{1b}[2J".to_owned() });
        events.watch();
        let next = late.try_recv().unwrap();
        assert!(next.as_str().chars().all(crate::printable::stands_for_itself), "{next:?}");
        let received: Vec<_> = std::iter::from_fn(|| early.try_recv().ok()).collect();
        assert_eq!((received.len(), received.last()), (REMEMBERED + 6, Some(&next)));
    }
}
