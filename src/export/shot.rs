//! A take with its lens and rate, on the time line of a program.

use super::rate::Rate;
use super::take::{Key, Take};
use crate::camera::Intrinsics;
use crate::frame::Timestamp;
use crate::timecode::TimecodeRate;

/// How close to its end a frame counts as the next one, frames: stamps scatter. Raised, a take
/// begins a frame too late.
const WITHIN_FRAME: f64 = 0.05;

/// A take, the lens it was taken with, and its rate.
#[derive(Debug, Clone, Copy)]
pub struct Shot<'a> {
    /// The poses.
    pub take: &'a Take,
    /// The lens at the size of the clip's pictures.
    pub lens: &'a Intrinsics,
    /// Frames per second.
    pub rate: Rate,
}

/// A change between having a pose and having none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Change {
    /// When, in frames; see [`Shot::code`].
    pub code: f64,
    /// Whether there is a pose from then on.
    pub has_pose: bool,
}

impl Shot<'_> {
    /// Returns a stamp as a time code: frames since the stamp of row 0, rounded to a millionth.
    pub fn code(&self, timestamp: Timestamp) -> f64 {
        let frames = timestamp.seconds_since(self.take.stamp(0)) * self.rate.fps();
        (frames * 1e6).round() / 1e6 + 0.0
    }

    /// Returns the time code after the last row, at least the last pose's.
    pub fn last_code(&self) -> f64 {
        let last = self.take.camera.last().map_or(0.0, |key| self.code(key.timestamp));
        last.max(self.code(self.take.stamp(self.take.rows().saturating_sub(1))))
    }

    /// Returns the timecode of row 0 in whole frames of the take's rate since 00:00:00:00, counted
    /// back from the first row that has one; `None` without timecode, and before midnight.
    pub fn first_frame_of_day(&self) -> Option<(u32, TimecodeRate)> {
        let (_, stamp, timecode) = self.take.timecodes().next()?;
        let rate = timecode.rate;
        let of_day_s = (f64::from(timecode.code.number(rate)) + timecode.fraction) / rate.fps();
        let frames = ((of_day_s - stamp.seconds_since(self.take.stamp(0))) * self.rate.fps() + WITHIN_FRAME).floor();
        (frames >= 0.0).then_some((frames as u32, rate))
    }

    /// Returns where poses begin and end; empty if every row has one.
    pub fn changes<From>(&self, keys: &[Key<From>]) -> Vec<Change> {
        let mut changes = Vec::new();
        for (k, key) in keys.iter().enumerate() {
            let code = self.code(key.timestamp);
            if k == 0 && key.row > 0 {
                changes.push(Change { code: self.code(self.take.stamp(0)).min(code - 1.0), has_pose: false });
            }
            if (k == 0 && key.row > 0) || (k > 0 && key.row > keys[k - 1].row + 1) {
                changes.push(Change { code, has_pose: true });
            }
            let next = keys.get(k + 1);
            if key.row + 1 < next.map_or(self.take.rows(), |next| next.row) {
                // Rows without a pose may have stamps out of order.
                let missing = self.code(self.take.stamp(key.row + 1));
                let end = next.map_or(f64::INFINITY, |next| self.code(next.timestamp));
                let between = if end.is_finite() { 0.5 * (code + end) } else { code + 1.0 };
                changes.push(Change { code: if code < missing && missing < end { missing } else { between }, has_pose: false });
            }
        }
        changes
    }
}

/// Whether the key is the last one before a gap.
pub fn ends_run<From>(keys: &[Key<From>], k: usize) -> bool {
    keys.get(k + 1).is_some_and(|next| next.row > keys[k].row + 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::synthetic;

    #[test]
    fn gaps_begin_at_the_first_row_without_a_pose() {
        let (take, lens) = (synthetic::take(), synthetic::lens());
        let shot = Shot { take: &take, lens: &lens, rate: Rate::new(29.97).unwrap() };
        let changes: Vec<(f64, bool)> = shot.changes(&take.camera).iter().map(|c| (c.code.round(), c.has_pose)).collect();
        // Rows 0, 5, 6 and 11 have no pose.
        assert_eq!(changes, [(0.0, false), (1.0, true), (5.0, false), (7.0, true), (11.0, false)]);
        assert_eq!(shot.last_code().round(), 11.0);
        assert_eq!((0..9).filter(|k| ends_run(&take.camera, *k)).collect::<Vec<_>>(), [3]);
    }
}
