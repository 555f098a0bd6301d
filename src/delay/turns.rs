//! Rotations of a camera over successive intervals.

use nalgebra::{UnitQuaternion, Vector3};

use crate::frame::Timestamp;

/// Intervals longer than this times the median contain a gap: what the camera did meanwhile is
/// unknown. Chosen: one lost frame passes. Raised, interpolation invents motion; lowered, clips
/// with lost frames fall into pieces.
const LONGEST_INTERVAL: f64 = 2.5;

/// The rotation of a camera over an interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Turn {
    /// Begin of the interval, seconds.
    pub from_s: f64,
    /// Its end, seconds.
    pub to_s: f64,
    /// Rotation vector from the axes at the end to those at the begin, radians, in the camera's own
    /// axes.
    pub angle: Vector3<f64>,
}

impl Turn {
    /// Returns the length of the interval, seconds.
    pub fn duration_s(&self) -> f64 {
        self.to_s - self.from_s
    }

    /// Returns the mean turn rate, radians per second.
    pub fn rate(&self) -> f64 {
        self.angle.norm() / self.duration_s()
    }
}

/// The rotations of one camera, in order of time and without overlap. Intervals that follow each
/// other directly share an instant.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Turns {
    turns: Vec<Turn>,
    typical_s: f64,
}

impl Turns {
    /// Keeps the intervals that follow one another, are not much longer than most, and have finite
    /// numbers.
    pub fn new(turns: impl IntoIterator<Item = Turn>) -> Self {
        let mut end_s = f64::NEG_INFINITY;
        let follows = |turn: &Turn| {
            let is_good = turn.from_s >= end_s && turn.to_s > turn.from_s && turn.angle.iter().all(|v| v.is_finite());
            end_s = if is_good { turn.to_s } else { end_s };
            is_good && turn.to_s.is_finite()
        };
        let mut turns: Vec<Turn> = turns.into_iter().filter(follows).collect();
        let mut durations: Vec<f64> = turns.iter().map(Turn::duration_s).collect();
        durations.sort_by(f64::total_cmp);
        let typical_s = durations.get(durations.len() / 2).copied().unwrap_or(0.0);
        turns.retain(|turn| turn.duration_s() <= LONGEST_INTERVAL * typical_s);
        Self { turns, typical_s }
    }

    /// Returns the rotations between successive orientations, each a rotation from the camera's
    /// axes to fixed ones. Times are counted from `origin`. An orientation whose stamp does not
    /// follow is left out.
    pub fn of_orientations(origin: Timestamp, rows: impl IntoIterator<Item = (Timestamp, UnitQuaternion<f64>)>) -> Self {
        let mut last: Option<(Timestamp, UnitQuaternion<f64>)> = None;
        let step = |(at, rotation): (Timestamp, UnitQuaternion<f64>)| {
            let (before, from) = match last {
                Some((before, _)) if at <= before => return None,
                last => last.unwrap_or((at, rotation)),
            };
            last = Some((at, rotation));
            let angle = (from.inverse() * rotation).scaled_axis();
            Some(Turn { from_s: before.seconds_since(origin), to_s: at.seconds_since(origin), angle })
        };
        // The first one has no length and is left out.
        Self::new(rows.into_iter().filter_map(step).collect::<Vec<_>>())
    }

    /// Returns the rotations in order.
    pub fn as_slice(&self) -> &[Turn] {
        &self.turns
    }

    /// Returns the median length of an interval, seconds.
    pub fn typical_s(&self) -> f64 {
        self.typical_s
    }

    /// Returns the first and the last instant, seconds; `None` if there are no rotations.
    pub fn span_s(&self) -> Option<[f64; 2]> {
        Some([self.turns.first()?.from_s, self.turns.last()?.to_s])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: i64, pan: f64) -> (Timestamp, UnitQuaternion<f64>) {
        (Timestamp::from_ns(ms * 1_000_000), UnitQuaternion::from_scaled_axis(Vector3::new(0.0, pan, 0.0)))
    }

    #[test]
    fn rotations_skip_gaps_and_stamps_that_go_back() {
        let rows = [at(1000, 0.0), at(1040, 0.1), at(1020, 0.9), at(1080, 0.3), at(1500, 0.4), at(1540, 0.45), at(1540, 0.8)];
        let turns = Turns::of_orientations(Timestamp::from_ns(1_000_000_000), rows);
        let seen: Vec<(f64, f64, f64)> = turns.as_slice().iter().map(|t| (t.from_s, t.to_s, (t.angle.y * 1e6).round() / 1e6)).collect();
        assert_eq!(seen, [(0.0, 0.04, 0.1), (0.04, 0.08, 0.2), (0.5, 0.54, 0.05)]);
        assert_eq!(turns.span_s(), Some([0.0, 0.54]));
    }

    #[test]
    fn numbers_that_are_not_finite_are_left_out() {
        let turn = |from_s: f64, to_s: f64, x: f64| Turn { from_s, to_s, angle: Vector3::new(x, 0.0, 0.0) };
        let turns = Turns::new([turn(0.0, 1.0, f64::NAN), turn(0.0, f64::INFINITY, 0.0), turn(f64::NAN, 1.0, 0.0), turn(1.0, 2.0, 0.5)]);
        assert!(turns.as_slice().len() <= 1 && turns.as_slice().iter().all(|t| t.to_s.is_finite()), "{turns:?}");
        assert_eq!(Turns::new([]).span_s(), None);
    }
}
