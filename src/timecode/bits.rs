//! From edges to bits: biphase mark.
//!
//! Every bit begins with an edge, and a 1 has another one in its middle. The length of a bit is
//! learnt from the edges and followed, so that any speed is read.

use std::collections::VecDeque;

/// Number of intervals from which the length of a bit is learnt. The synchronisation word has 24
/// equal ones in a row; with fewer than 12, noise passes for bits more often.
const LEARNT_FROM: usize = 12;
/// Share of a difference by which the length of a bit follows a new one. Raised, noise shakes it;
/// lowered, it does not follow a tape that starts.
const FOLLOW: f64 = 0.1;
/// Boundaries between an interval that is too short, half a bit, a whole bit, and too long, in
/// bits.
const HALF_BITS: std::ops::Range<f64> = 0.25..0.75;
const WHOLE_BITS: std::ops::Range<f64> = 0.75..1.4;
/// Number of faults, each forgotten after as many good bits as a frame has, after which the length
/// of a bit is learnt again. Raised, a change of speed costs more frames.
const MAX_FAULTS: u32 = 3;
const FORGOTTEN_AFTER: u32 = 80;

/// What an edge brought.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Step {
    /// A bit, and where it begins and ends, samples.
    Bit(bool, f64, f64),
    /// The bits before and after it do not belong together.
    Break,
}

/// Reads bits from edges.
#[derive(Debug, Default)]
pub(super) struct BitReader {
    /// Length of a bit, samples.
    bit: Option<f64>,
    last: Option<f64>,
    /// Where a 1 began whose second half is due.
    half: Option<f64>,
    intervals: VecDeque<f64>,
    faults: u32,
    good: u32,
}

impl BitReader {
    /// Adds an edge.
    pub fn push(&mut self, edge: f64) -> Option<Step> {
        let begin = self.last.replace(edge)?;
        let interval = edge - begin;
        let Some(bit) = self.bit else {
            if self.intervals.len() == LEARNT_FROM {
                self.intervals.pop_front();
            }
            self.intervals.push_back(interval);
            self.bit = learn(&self.intervals);
            return None;
        };
        let length = interval / bit;
        if HALF_BITS.contains(&length) {
            let Some(begin) = self.half.take() else {
                self.half = Some(begin);
                return None;
            };
            return Some(self.good(true, begin, edge, bit));
        }
        if WHOLE_BITS.contains(&length) {
            if self.half.take().is_none() {
                return Some(self.good(false, begin, edge, bit));
            }
            return Some(self.fault());
        }
        self.half = None;
        Some(self.fault())
    }

    fn good(&mut self, value: bool, begin: f64, end: f64, bit: f64) -> Step {
        self.bit = Some(bit + FOLLOW * (end - begin - bit));
        self.good += 1;
        if self.good >= FORGOTTEN_AFTER {
            (self.good, self.faults) = (0, 0);
        }
        Step::Bit(value, begin, end)
    }

    fn fault(&mut self) -> Step {
        (self.good, self.faults) = (0, self.faults + 1);
        if self.faults >= MAX_FAULTS {
            (self.bit, self.faults) = (None, 0);
            self.intervals.clear();
        }
        Step::Break
    }
}

/// Returns the length of a bit if the intervals are of two lengths, one twice the other.
fn learn(intervals: &VecDeque<f64>) -> Option<f64> {
    if intervals.len() < LEARNT_FROM {
        return None;
    }
    let (least, most) = intervals.iter().fold((f64::INFINITY, 0.0_f64), |(least, most), i| (least.min(*i), most.max(*i)));
    let border = (least * most).sqrt();
    let mean = |is_long: bool| {
        let (sum, n) = intervals.iter().filter(|i| (**i > border) == is_long).fold((0.0, 0), |(sum, n), i| (sum + i, n + 1));
        (n > 0).then(|| sum / f64::from(n))
    };
    let (short, long) = (mean(false)?, mean(true)?);
    let is_close = intervals.iter().all(|i| (0.75..1.25).contains(&(i / if *i > border { long } else { short })));
    ((1.6..2.4).contains(&(long / short)) && is_close).then_some(0.5 * (long + 2.0 * short))
}
