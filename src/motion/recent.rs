//! The last quarter of a second of something, for what has to be compared with a while ago.

use std::collections::VecDeque;

/// Entries kept. 64 are every frame at 240 frames a second; of faster cameras some frames are left out.
const CAPACITY: usize = 64;
/// How long entries are needed: the longest prediction and the longest coasting, with one frame before them, seconds.
const SPAN_S: f64 = 0.26;

/// The last entries with their stamps.
#[derive(Debug, Clone)]
pub struct Recent<T> {
    entries: VecDeque<(i64, T)>,
}

impl<T> Recent<T> {
    /// None yet.
    pub fn new() -> Self {
        Self { entries: VecDeque::with_capacity(CAPACITY) }
    }

    /// Adds the newest. Where the last two lie too close together it takes the place of the later one.
    pub fn push(&mut self, timestamp_ns: i64, entry: T) {
        let spacing_ns = (SPAN_S * 1e9) as i64 / (CAPACITY - 1) as i64;
        let mut newest = self.entries.iter().rev().map(|(at_ns, _)| *at_ns);
        let is_crowded = matches!((newest.next(), newest.next()), (Some(b), Some(a)) if b.saturating_sub(a) < spacing_ns);
        if is_crowded {
            self.entries.pop_back();
        } else if self.entries.len() == CAPACITY {
            self.entries.pop_front();
        }
        self.entries.push_back((timestamp_ns, entry));
    }

    /// The newest, those of the `seconds` before it, and the one before them; the newest first.
    pub fn within_last(&self, seconds: f64) -> impl Iterator<Item = &(i64, T)> {
        let newest_ns = self.entries.back().map_or(0, |(at_ns, _)| *at_ns);
        let since_ns = newest_ns.saturating_sub((seconds * 1e9) as i64);
        let mut is_before = false;
        self.entries.iter().rev().take_while(move |(at_ns, _)| !std::mem::replace(&mut is_before, *at_ns < newest_ns && *at_ns <= since_ns))
    }

    /// The newest that is at least so old.
    pub fn before(&self, timestamp_ns: i64, seconds: f64) -> Option<&(i64, T)> {
        let until_ns = timestamp_ns.saturating_sub((seconds * 1e9) as i64);
        self.entries.iter().rev().find(|(at_ns, _)| *at_ns <= until_ns)
    }

    /// Forgets all.
    pub fn clear(&mut self) {
        self.entries.clear();
    }
}
