//! The rotation of a camera as a smooth function of time: a cubic spline through what it has
//! rotated up to each frame.
//!
//! In the camera's own axes, ω is the derivative of this sum as long as it rotates by a few degrees
//! per frame. Its interpolation matters only between frames; over whole intervals it is exact.

use nalgebra::Vector3;

use super::turns::Turns;

/// Minimum number of successive intervals for a spline. Lowered, its curvature at the ends is a
/// guess for most of it.
const MIN_INTERVALS: usize = 4;

/// The rotation over an interval, and how it changes if the interval moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Between {
    /// Rotation over the interval, radians.
    pub angle: Vector3<f64>,
    /// Turn rate at its end minus that at its begin, radians per second.
    pub rate_change: Vector3<f64>,
}

/// Splines through runs of intervals without a gap.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct AngleSpline {
    runs: Vec<Run>,
}

#[derive(Debug, Clone, PartialEq)]
struct Run {
    times_s: Vec<f64>,
    /// Sum of the rotations up to each time, radians.
    angles: Vec<Vector3<f64>>,
    /// Second derivative there.
    curvatures: Vec<Vector3<f64>>,
}

impl AngleSpline {
    pub fn of(turns: &Turns) -> Self {
        let mut runs = Vec::new();
        let mut rest = turns.as_slice();
        while !rest.is_empty() {
            let joined = rest.windows(2).take_while(|pair| pair[0].to_s == pair[1].from_s).count() + 1;
            let (run, later) = rest.split_at(joined);
            rest = later;
            if run.len() < MIN_INTERVALS {
                continue;
            }
            let times_s = run[..1].iter().map(|turn| turn.from_s).chain(run.iter().map(|turn| turn.to_s)).collect();
            let mut sum = Vector3::zeros();
            let mut angles = vec![sum];
            angles.extend(run.iter().map(|turn| {
                sum += turn.angle;
                sum
            }));
            runs.push(Run::new(times_s, angles));
        }
        Self { runs }
    }

    /// Returns the rotation from one instant to a later one, `None` if a part of it is unknown.
    pub fn between(&self, from_s: f64, to_s: f64) -> Option<Between> {
        let run = &self.runs[self.runs.partition_point(|run| run.times_s[0] <= from_s).checked_sub(1)?];
        if to_s > *run.times_s.last()? {
            return None;
        }
        let ([begin, rate_before], [end, rate_after]) = (run.at(from_s), run.at(to_s));
        Some(Between { angle: end - begin, rate_change: rate_after - rate_before })
    }
}

impl Run {
    /// Solves for the curvatures; in the first and the last interval the curvature is constant.
    fn new(times_s: Vec<f64>, angles: Vec<Vector3<f64>>) -> Self {
        let n = times_s.len();
        let step = |k: usize| times_s[k + 1] - times_s[k];
        let slope = |k: usize| (angles[k + 1] - angles[k]) / step(k);
        // The equations of the inner knots, with the ends eliminated, by forward elimination.
        let mut factors = vec![0.0; n];
        let mut curvatures = vec![Vector3::zeros(); n];
        for k in 1..n - 1 {
            let (before, after) = (step(k - 1), step(k));
            let mut diagonal = 2.0 * (before + after);
            let mut right = (slope(k) - slope(k - 1)) * 6.0;
            diagonal += if k == 1 { before } else { -before * factors[k - 1] };
            if k > 1 {
                right -= curvatures[k - 1] * before;
            }
            if k == n - 2 {
                diagonal += after;
            }
            factors[k] = after / diagonal;
            curvatures[k] = right / diagonal;
        }
        for k in (1..n - 2).rev() {
            let later = curvatures[k + 1];
            curvatures[k] -= later * factors[k];
        }
        curvatures[0] = curvatures[1];
        curvatures[n - 1] = curvatures[n - 2];
        Self { times_s, angles, curvatures }
    }

    /// Returns angle and turn rate at an instant within the run.
    fn at(&self, time_s: f64) -> [Vector3<f64>; 2] {
        let k = self.times_s.partition_point(|t| *t <= time_s).clamp(1, self.times_s.len() - 1) - 1;
        let step = self.times_s[k + 1] - self.times_s[k];
        let b = (time_s - self.times_s[k]) / step;
        let a = 1.0 - b;
        let ([from, to], [bend, bend_to]) = ([self.angles[k], self.angles[k + 1]], [self.curvatures[k], self.curvatures[k + 1]]);
        let angle = from * a + to * b + (bend * (a * a * a - a) + bend_to * (b * b * b - b)) * (step * step / 6.0);
        let rate = (to - from) / step + (bend_to * (3.0 * b * b - 1.0) - bend * (3.0 * a * a - 1.0)) * (step / 6.0);
        [angle, rate]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::delay::Turn;

    fn turns(times_s: &[f64], angle: impl Fn(f64) -> f64) -> Turns {
        let turn = |pair: &[f64]| Turn { from_s: pair[0], to_s: pair[1], angle: Vector3::new(angle(pair[1]) - angle(pair[0]), 0.0, 1.0) };
        Turns::new(times_s.windows(2).map(turn))
    }

    #[test]
    fn a_parabola_is_exact_between_uneven_frames() {
        let spline = AngleSpline::of(&turns(&[0.0, 0.03, 0.07, 0.1, 0.13, 0.18], |t| 3.0 * t * t - t));
        let between = spline.between(0.02, 0.155).unwrap();
        assert!((between.angle.x - (3.0 * (0.155 * 0.155 - 0.0004) - 0.135)).abs() < 1e-12, "{between:?}");
        assert!((between.rate_change.x - 6.0 * 0.135).abs() < 1e-12, "{between:?}");
    }

    #[test]
    fn a_sway_is_followed_between_frames() {
        let times: Vec<f64> = (0..60).map(|k| f64::from(k) / 30.0).collect();
        let sway = |t: f64| (12.0 * t).sin();
        let spline = AngleSpline::of(&turns(&times, sway));
        for k in 10..90 {
            let from = f64::from(k) * 0.0187;
            let between = spline.between(from, from + 0.04).unwrap();
            assert!((between.angle.x - (sway(from + 0.04) - sway(from))).abs() < 1e-4, "{k}: {between:?}");
        }
    }

    #[test]
    fn nothing_is_invented_outside_and_in_gaps() {
        let times: Vec<f64> = (0..10).map(f64::from).chain((20..30).map(f64::from)).collect();
        let spline = AngleSpline::of(&turns(&times, |t| t));
        assert!(spline.between(0.0, 9.0).is_some() && spline.between(20.0, 29.0).is_some());
        for (from, to) in [(-0.1, 1.0), (8.5, 9.5), (9.5, 10.5), (15.0, 21.0), (28.0, 29.1)] {
            assert_eq!(spline.between(from, to), None, "{from} {to}");
        }
        assert_eq!(AngleSpline::of(&Turns::new([])).between(0.0, 1.0), None);
    }
}
