//! A buffer of the last quarter of a second of something, for comparisons with a moment ago.

use std::collections::VecDeque;

use crate::frame::Timestamp;

/// Maximum number of entries. 64 hold every frame at 240 frames per second; of faster cameras some
/// frames are dropped. Raised, every look back costs more.
const CAPACITY: usize = 64;
/// How long entries are needed, seconds: the longest prediction (`predict_s`) and coasting's look
/// back (`FADE_S`), both 0.2, plus one frame. Raised, entries of fast cameras are farther apart;
/// lowered, the oldest are gone when needed.
const SPAN_S: f64 = 0.26;

/// The last entries with their stamps.
#[derive(Debug, Clone)]
pub struct Recent<T> {
    entries: VecDeque<(Timestamp, T)>,
}

impl<T> Recent<T> {
    /// Creates an empty buffer.
    pub fn new() -> Self {
        Self { entries: VecDeque::with_capacity(CAPACITY) }
    }

    /// Adds the newest entry, replacing the last one if the last two are too close together.
    pub fn push(&mut self, timestamp: Timestamp, entry: T) {
        let spacing_ns = (SPAN_S * 1e9) as i64 / (CAPACITY - 1) as i64;
        let mut newest = self.entries.iter().rev().map(|(at, _)| *at);
        let is_crowded = matches!((newest.next(), newest.next()), (Some(b), Some(a)) if b.ns_since(a) < spacing_ns);
        if is_crowded {
            self.entries.pop_back();
        } else if self.entries.len() == CAPACITY {
            self.entries.pop_front();
        }
        self.entries.push_back((timestamp, entry));
    }

    /// Returns the newest entry, those of the `seconds` before it, and the one before them; newest
    /// first.
    pub fn within_last(&self, seconds: f64) -> impl Iterator<Item = &(Timestamp, T)> {
        let newest = self.entries.back().map(|(at, _)| *at).unwrap_or_default();
        let since = newest.after_s(-seconds);
        let mut is_before = false;
        self.entries.iter().rev().take_while(move |(at, _)| !std::mem::replace(&mut is_before, *at < newest && *at <= since))
    }

    /// Returns the newest entry at least `seconds` older than `timestamp`.
    pub fn before(&self, timestamp: Timestamp, seconds: f64) -> Option<&(Timestamp, T)> {
        let until = timestamp.after_s(-seconds);
        self.entries.iter().rev().find(|(at, _)| *at <= until)
    }

    pub fn clear(&mut self) {
        self.entries.clear();
    }
}
