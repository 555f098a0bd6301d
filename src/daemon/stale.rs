//! Reports that a camera delivers no pictures: at once, and repeatedly while it lasts.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use super::live::{Event, LiveLink};
use crate::capture::timestamping::monotonic_now;
use crate::frame::Timestamp;
use crate::record::{PoseSample, State};

/// Interval of messages during one silence: ten per second. Chosen, not tuned. Raised, a client
/// that connects later learns of it later.
const REPEAT: Duration = Duration::from_millis(100);

/// Watches the pulse for the pose stage.
pub(super) struct StaleWatch {
    link: LiveLink,
    /// The last frame's number and stamp.
    last: (u64, Timestamp),
    /// When the silence started, and when it was last reported.
    silent: Option<(Instant, Instant)>,
    /// Set when the daemon is to end: silence is then no fault.
    ending: Arc<AtomicBool>,
}

impl StaleWatch {
    pub fn new(link: LiveLink, ending: Arc<AtomicBool>) -> Self {
        Self { link, last: Default::default(), silent: None, ending }
    }

    pub fn link(&self) -> &LiveLink {
        &self.link
    }

    /// Returns how long to wait for a frame before the next [`check`](Self::check).
    pub fn wait(&self) -> Duration {
        if self.ending.load(Ordering::Relaxed) {
            return REPEAT;
        }
        match (self.silent, self.link.pulse.time_left(monotonic_now())) {
            (_, Some(left)) => left,
            (Some((_, sent_at)), None) => REPEAT.saturating_sub(sent_at.elapsed()).max(Duration::from_millis(1)),
            (None, None) => Duration::ZERO,
        }
    }

    /// Notes a tracked frame.
    pub fn seen(&mut self, sample: &PoseSample) {
        self.last = (sample.sequence, sample.timestamp);
        // A frame that was in progress when the silence started does not end it.
        if self.link.pulse.time_left(monotonic_now()).is_some() {
            self.end_silence();
        }
    }

    /// Returns the message for subscribers, if it is due.
    pub fn check(&mut self) -> Option<PoseSample> {
        let now = monotonic_now();
        if self.ending.load(Ordering::Relaxed) || self.link.pulse.time_left(now).is_some() {
            return None;
        }
        let age_ms = self.link.pulse.age_ms(now);
        match &mut self.silent {
            Some((_, sent_at)) if sent_at.elapsed() < REPEAT => return None,
            Some((_, sent_at)) => *sent_at = Instant::now(),
            None => {
                self.silent = Some((Instant::now(), Instant::now()));
                self.link.statistics.set_silent(true);
                self.link.events.publish(Event::Stale { state: State::Stale, pose: None, age_ms });
            }
        }
        let sample = PoseSample::stale(self.last.0, self.last.1, age_ms);
        self.link.statistics.sample(&sample);
        Some(sample)
    }

    fn end_silence(&mut self) {
        if let Some((since, _)) = self.silent.take() {
            self.link.statistics.set_silent(false);
            self.link.events.publish(Event::Resumed { after_ms: since.elapsed().as_secs_f64() * 1e3 });
        }
    }
}
