//! The nearest descriptor and its rival: the nearest that lies elsewhere.
//!
//! Candidates come one after the other. Those beside the best are no rivals, and the best changes on the way; where a rival may have been
//! forgotten with that, it says so, and whoever asks looks through all again.

/// The nearest so far; an infinite distance is none.
#[derive(Debug, Clone, Copy)]
pub(super) struct Nearest {
    best: (f32, usize),
    second: (f32, usize),
    /// Whether candidates were left out because they lie beside the best one.
    has_left_out: bool,
    may_miss_rival: bool,
}

impl Default for Nearest {
    fn default() -> Self {
        let none = (f32::INFINITY, usize::MAX);
        Self { best: none, second: none, has_left_out: false, may_miss_rival: false }
    }
}

impl Nearest {
    /// Takes a candidate; `same_place` says of two whether they show the same place.
    #[inline]
    pub fn offer(&mut self, k: usize, distance: f32, same_place: impl Fn(usize, usize) -> bool) {
        // Most candidates are further away than both.
        // A distance that is no number is not nearer.
        let is_nearer = distance < self.second.0;
        if !is_nearer && self.second.1 != usize::MAX {
            return;
        }
        let none = (f32::INFINITY, usize::MAX);
        if distance < self.best.0 {
            if self.best.1 == usize::MAX || !same_place(self.best.1, k) {
                // The old best is nearer than all that was left out beside it.
                (self.second, self.has_left_out) = (self.best, false);
            } else {
                // What lay beside the old best may lie elsewhere from the new one.
                self.may_miss_rival |= self.has_left_out;
                self.has_left_out = true;
            }
            self.best = (distance, k);
            if self.second.1 != usize::MAX && same_place(self.second.1, k) {
                (self.second, self.may_miss_rival) = (none, true);
            }
        } else if self.best.1 == usize::MAX {
            // Not a number, or the largest: no candidate.
        } else if same_place(self.best.1, k) {
            self.has_left_out = true;
        } else if distance < self.second.0 {
            self.second = (distance, k);
        }
    }

    /// Candidates that are not below this change nothing.
    pub fn bar(&self) -> f32 {
        self.second.0
    }

    /// Distance and index of the nearest.
    pub fn best(&self) -> Option<(f32, usize)> {
        (self.best.1 != usize::MAX).then_some(self.best)
    }

    /// Distance and index of the nearest elsewhere, unless it [may be another](Self::may_miss_rival).
    pub fn rival(&self) -> Option<(f32, usize)> {
        (self.second.1 != usize::MAX).then_some(self.second)
    }

    /// Whether a nearer rival may have been forgotten.
    pub fn may_miss_rival(&self) -> bool {
        self.may_miss_rival
    }
}
