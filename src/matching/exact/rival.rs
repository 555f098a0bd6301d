//! Keeps the nearest descriptor and its rival: the nearest one elsewhere.
//!
//! Candidates arrive one by one. Those at the best one's place are not rivals, and the best changes
//! on the way. If a rival may have been dropped by that, this is reported, and the caller searches
//! all candidates again.

/// The nearest so far; an infinite distance means none.
#[derive(Debug, Clone, Copy)]
pub(super) struct Nearest {
    best: (f32, usize),
    second: (f32, usize),
    /// Whether candidates were dropped because they are at the best one's place.
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
    /// Offers a candidate; `same_place` tells whether two show the same place.
    #[inline]
    pub fn offer(&mut self, k: usize, distance: f32, same_place: impl Fn(usize, usize) -> bool) {
        // Most candidates are farther than both. NaN is never nearer.
        let is_nearer = distance < self.second.0;
        if !is_nearer && self.second.1 != usize::MAX {
            return;
        }
        let none = (f32::INFINITY, usize::MAX);
        if distance < self.best.0 {
            if self.best.1 == usize::MAX || !same_place(self.best.1, k) {
                // The old best is nearer than everything dropped at its place.
                (self.second, self.has_left_out) = (self.best, false);
            } else {
                // What was at the old best's place may be elsewhere relative to the new one.
                self.may_miss_rival |= self.has_left_out;
                self.has_left_out = true;
            }
            self.best = (distance, k);
            if self.second.1 != usize::MAX && same_place(self.second.1, k) {
                (self.second, self.may_miss_rival) = (none, true);
            }
        } else if self.best.1 == usize::MAX {
            // Not a number, or infinite: no candidate.
        } else if same_place(self.best.1, k) {
            self.has_left_out = true;
        } else if distance < self.second.0 {
            self.second = (distance, k);
        }
    }

    /// Returns the bar: candidates not below it change nothing.
    pub fn bar(&self) -> f32 {
        self.second.0
    }

    /// Returns distance and index of the nearest.
    pub fn best(&self) -> Option<(f32, usize)> {
        (self.best.1 != usize::MAX).then_some(self.best)
    }

    /// Returns distance and index of the nearest elsewhere, unless it
    /// [may be another](Self::may_miss_rival).
    pub fn rival(&self) -> Option<(f32, usize)> {
        (self.second.1 != usize::MAX).then_some(self.second)
    }

    /// Whether a nearer rival may have been dropped.
    pub fn may_miss_rival(&self) -> bool {
        self.may_miss_rival
    }
}
