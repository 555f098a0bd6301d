//! Events of a live daemon besides its poses: one line each in events.jsonl and in the log.

use std::borrow::Cow;
use std::sync::{Arc, Mutex, PoisonError, Weak};

use crossbeam_channel::Receiver;
use serde::{Deserialize, Serialize};
use tracing::Level;

use super::job::{Job, JobState};
use crate::capture::timestamping::monotonic_now;
use crate::drop_oldest::{DropOldestSender, drop_oldest};
use crate::frame::Timestamp;
use crate::printable::printable;
use crate::record::State;

/// Something that happened.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// The camera streams.
    CameraOpened {
        /// Its name and place.
        name: String,
        /// Picture width, pixels.
        width: u32,
        /// Picture height, pixels.
        height: u32,
        /// V4L2's four-character code.
        format: Cow<'static, str>,
        /// Pictures per second.
        fps: f64,
        /// Its exposure, seconds, if it is locked and known; otherwise null.
        exposure_s: Option<f64>,
        /// Controls as read back.
        controls: Vec<(String, i64)>,
        /// Whether it had been open before.
        again: bool,
    },
    /// The camera cannot be opened; opening is retried.
    CameraWaiting {
        /// Why, with the fix.
        reason: String,
    },
    /// The camera is gone, or was given up.
    CameraLost {
        /// Why.
        reason: String,
    },
    /// The driver provides no stamps; frames are stamped when they are read, which is less
    /// accurate.
    NoDriverStamp {
        /// The camera.
        name: String,
    },
    /// The poses are based on another exposure than the camera's.
    ExposureDiffers {
        /// Both exposures, with the fix.
        reason: String,
    },
    /// No picture has come for three frame times.
    Stale {
        /// Always `stale`.
        state: State,
        /// Always null.
        pose: Option<()>,
        /// Age of the last picture, milliseconds.
        age_ms: f64,
    },
    /// Pictures come again.
    Resumed {
        /// Duration of the gap, milliseconds.
        after_ms: f64,
    },
    /// A frame was dropped because the tracker was late.
    FrameDropped {
        /// Its stamp.
        #[serde(rename = "frame_timestamp_ns")]
        timestamp: Timestamp,
    },
    /// A recording started.
    RecorderStarted {
        /// The clip.
        clip: String,
    },
    /// A recording is complete and closed; the last line of its own events.
    RecorderFinished {
        /// The clip.
        clip: String,
        /// Number of its rows.
        frames: u64,
    },
    /// Recording was given up; tracking continues.
    RecorderStopped {
        /// Why.
        reason: String,
    },
    /// The last seconds were saved.
    RingSaved {
        /// The clip.
        clip: String,
    },
    /// Someone marked this moment.
    Marked {
        /// The mark's text.
        text: String,
    },
    /// The stage has not been tracked for a second, mostly for this reason; reported again when the
    /// reason changes.
    NotTracked {
        /// One word.
        reason: Cow<'static, str>,
        /// The problem, and what to do about it.
        text: String,
    },
    /// The stage is tracked, for the first time or again.
    Tracked {
        /// Time since the first frame, or since the loss, milliseconds.
        after_ms: f64,
    },
    /// A part of the stage or the lens is not as configured or surveyed; reported once each.
    /// Tracking continues with what fits.
    ModelDiffers {
        /// `lens`, `shape`, `layout` or `ratio`.
        part: String,
        /// The name of its surface; null for the lens.
        surface: Option<String>,
        /// The problem, its size, and what to do about it.
        text: String,
    },
    /// The frames have determined the shutter; reported once.
    ShutterLearnt {
        /// The shutter.
        text: String,
    },
    /// The frames contradict the configured readout; reported once.
    ShutterDiffers {
        /// What they show, and what to do about it.
        text: String,
    },
    /// The timecode's state changed.
    Timecode {
        /// `never found`, `locked`, `free-wheeling` or `lost`.
        state: Cow<'static, str>,
        /// The timecode of this moment, if it is known.
        timecode: Option<String>,
        /// What it means.
        text: String,
    },
    /// The timecode runs at another rate than configured; reported once for each rate.
    TimecodeRate {
        /// The rate as heard.
        heard: Cow<'static, str>,
        /// Both rates, with the fix.
        text: String,
    },
    /// The sound with the timecode cannot be used; reading it is tried again.
    TimecodeWaiting {
        /// Why, with the fix.
        reason: String,
    },
    /// The other tracker's state, or how far it agrees with ours, changed.
    OtherTracker {
        /// `never heard`, `unreadable`, `other source`, `heard`, `no pose`, `stale` or `lost`.
        state: Cow<'static, str>,
        /// `good`, `usable` or `do not use`; null until it is known.
        verdict: Option<String>,
        /// What it means, and what to do about it.
        text: String,
    },
    /// The safety limits started to withhold a pose.
    PoseWithheld {
        /// The output.
        output: String,
        /// The body.
        body: String,
        /// The reason.
        reason: Cow<'static, str>,
    },
    /// A job started, continues, or ended.
    Job(Job),
    /// The config was reloaded.
    ConfigReloaded {
        /// The file.
        file: String,
    },
    /// The config was read again and refused; the old one stays.
    ConfigRefused {
        /// Why.
        reason: String,
    },
    /// The daemon ended normally; always the last line.
    Ended {
        /// Why.
        reason: String,
    },
}

/// An event with its time.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StampedEvent {
    /// On the monotonic clock, like frames.
    #[serde(rename = "timestamp_ns")]
    pub timestamp: Timestamp,
    /// What happened.
    #[serde(flatten)]
    pub event: Event,
}

impl StampedEvent {
    /// Returns one line of JSON, without the line end. Control characters, which may come from
    /// names of cameras and files, are escaped.
    pub fn to_json_line(&self) -> String {
        // Serialising to a string fails only for non-string map keys, and an event has none.
        let line = serde_json::to_string(self).expect("an event has only string keys");
        printable(&line).into_owned()
    }
}

/// Distributes every event to the log and to all listeners.
#[derive(Debug, Default)]
pub struct EventLog {
    listeners: Mutex<Vec<(DropOldestSender<StampedEvent>, Weak<()>)>>,
}

/// A listener's own channel of events; the log removes it after it is dropped.
#[derive(Debug)]
pub struct EventListener {
    events: Receiver<StampedEvent>,
    _alive: Arc<()>,
}

impl std::ops::Deref for EventListener {
    type Target = Receiver<StampedEvent>;

    fn deref(&self) -> &Receiver<StampedEvent> {
        &self.events
    }
}

/// Maximum events queued for a listener before the oldest is dropped. A round figure far above a
/// second's events. Raised, only memory.
const QUEUE: usize = 4096;

impl EventLog {
    /// Returns a channel with every event from now on; a slow listener loses the oldest.
    pub fn listen(&self) -> EventListener {
        let (sender, events) = drop_oldest(QUEUE);
        let alive = Arc::new(());
        self.listeners.lock().unwrap_or_else(PoisonError::into_inner).push((sender, Arc::downgrade(&alive)));
        EventListener { events, _alive: alive }
    }

    /// Publishes an event with the current time.
    pub fn publish(&self, event: Event) {
        note(&event);
        let stamped = StampedEvent { timestamp: monotonic_now(), event };
        self.listeners.lock().unwrap_or_else(PoisonError::into_inner).retain(|(listener, alive)| {
            listener.send(stamped.clone());
            alive.strong_count() > 0
        });
    }

    /// Ends all listeners' channels.
    pub fn close(&self) {
        self.listeners.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }
}

impl Event {
    /// Whether it only reports progress: lists of what happened leave it out.
    pub fn is_progress(&self) -> bool {
        matches!(self, Self::FrameDropped { .. } | Self::Job(Job { state: JobState::Running, .. }))
    }

    /// Returns the event as a sentence without its full stop, and its severity.
    pub fn message(&self) -> (Level, String) {
        match self {
            Self::CameraOpened { name, width, height, format, fps, again, .. } => {
                let again = if *again { "open again" } else { "open" };
                (Level::INFO, format!("{name} is {again}: {format} {width}x{height}, {fps}/s"))
            }
            Self::CameraWaiting { reason } => (Level::WARN, format!("waiting for the camera: {reason}")),
            Self::CameraLost { reason } => (Level::WARN, format!("the camera is lost: {reason}")),
            Self::NoDriverStamp { name } => (
                Level::WARN,
                format!(
                    "{name}: its driver's time stamps are implausible; frames are stamped on arrival, which is later than they were taken"
                ),
            ),
            Self::ExposureDiffers { reason } => (Level::WARN, reason.clone()),
            Self::Stale { age_ms, .. } => (Level::WARN, format!("no picture for {age_ms:.0} ms")),
            Self::Resumed { after_ms } => (Level::INFO, format!("pictures come again after {after_ms:.0} ms")),
            Self::FrameDropped { timestamp } => (Level::DEBUG, format!("the frame of {timestamp} was dropped: the tracker was late")),
            Self::RecorderStarted { clip } => (Level::INFO, format!("recording to {clip}")),
            Self::RecorderFinished { clip, frames } => (Level::INFO, format!("{clip} is recorded: {frames} frames")),
            Self::RecorderStopped { reason } => (Level::ERROR, format!("recording stopped: {reason}")),
            Self::RingSaved { clip } => (Level::INFO, format!("the last seconds are saved in {clip}")),
            Self::Marked { text } => (Level::INFO, format!("marked: {text}")),
            Self::NotTracked { text, .. } => (Level::WARN, format!("not tracked: {text}")),
            Self::Tracked { after_ms } => (Level::INFO, format!("tracked after {after_ms:.0} ms")),
            Self::ShutterLearnt { text } => (Level::INFO, text.clone()),
            Self::ShutterDiffers { text } => (Level::WARN, text.clone()),
            Self::ModelDiffers { text, .. } => (Level::WARN, text.clone()),
            Self::Timecode { state, text, .. } => {
                let is_good = matches!(&**state, "locked" | "never found");
                (if is_good { Level::INFO } else { Level::WARN }, text.clone())
            }
            Self::TimecodeRate { text, .. } => (Level::WARN, text.clone()),
            Self::OtherTracker { state, verdict, text } => {
                let is_good = state == "heard" && verdict.as_ref().is_none_or(|verdict| verdict == "good");
                (if is_good { Level::INFO } else { Level::WARN }, text.clone())
            }
            Self::TimecodeWaiting { reason } => (Level::WARN, format!("no timecode: {reason}")),
            // The output has already logged a warning, at most once a minute.
            Self::PoseWithheld { output, body, reason } => {
                (Level::DEBUG, format!("output {output}: the pose of {body} is withheld, {reason}"))
            }
            Self::Job(Job { job, kind, done, state: JobState::Running, .. }) => {
                (Level::DEBUG, format!("job {job} ({kind}): {:.0} %", done * 100.0))
            }
            Self::Job(Job { job, kind, state: JobState::Done, text, .. }) => (Level::INFO, format!("job {job} ({kind}) is done: {text}")),
            Self::Job(Job { job, kind, text, .. }) => (Level::WARN, format!("job {job} ({kind}) is not done: {text}")),
            Self::ConfigReloaded { file } => (Level::INFO, format!("{file} was reloaded")),
            Self::ConfigRefused { reason } => (Level::ERROR, format!("the old config stays in use: {reason}")),
            Self::Ended { reason } => (Level::INFO, format!("ended: {reason}")),
        }
    }
}

/// Writes an event to the log.
fn note(event: &Event) {
    // Progress comes with every late frame and is seldom wanted.
    if event.is_progress() && !tracing::enabled!(Level::DEBUG) {
        return;
    }
    match event.message() {
        (Level::ERROR, text) => tracing::error!("{text}"),
        (Level::WARN, text) => tracing::warn!("{text}"),
        (Level::INFO, text) => tracing::info!("{text}"),
        (_, text) => tracing::debug!("{text}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_in_event_names_are_escaped() {
        let name = "Cam\u{9b}2J\x1b]0;x\x07\u{202e}".to_owned();
        let line = StampedEvent { timestamp: Timestamp::from_ns(1), event: Event::NoDriverStamp { name: name.clone() } }.to_json_line();
        assert!(line.chars().all(crate::printable::stands_for_itself), "{line:?}");
        let read: serde_json::Value = serde_json::from_str(&line).unwrap();
        assert_eq!(read["name"], name);
    }

    #[test]
    fn listeners_get_event_lines_and_may_disconnect() {
        let log = EventLog::default();
        let (kept, gone) = (log.listen(), log.listen());
        drop(gone);
        log.publish(Event::Stale { state: State::Stale, pose: None, age_ms: 101.5 });
        assert_eq!(log.listeners.lock().unwrap().len(), 1);
        log.close();
        let lines: Vec<String> = kept.iter().map(|e| e.to_json_line()).collect();
        assert_eq!(lines.len(), 1);
        assert!(lines[0].ends_with(r#""event":"stale","state":"stale","pose":null,"age_ms":101.5}"#), "{}", lines[0]);
    }
}
