//! Frame rates, exact where they are a standard one.

use super::take::Take;

/// Frames per second as a fraction: 30000/1001 for 29.97.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rate {
    /// Frames in `seconds`.
    pub frames: u32,
    /// Seconds in which they pass.
    pub seconds: u32,
}

/// Rates that video also has 1000/1001 times as fast, frames per second.
const VIDEO: [u32; 8] = [24, 30, 48, 60, 72, 96, 120, 240];
/// Relative difference up to which a rate is taken for a standard one. Stamps in microseconds are
/// off by 0.00003 at 30 frames per second, clocks of cameras by less than 0.0001; standard rates
/// differ by 0.001. Raised, a rate of its own is rounded away.
const NEAR: f64 = 2e-4;
/// Possible rates, frames per second: from a time lapse to a high-speed camera.
const POSSIBLE: std::ops::RangeInclusive<f64> = 0.1..=10_000.0;

impl Rate {
    /// Returns the standard rate that `fps` stands for (29.97, 23.976), or `fps` to the thousandth
    /// of a frame. `None` outside 0.1 to 10000.
    pub fn new(fps: f64) -> Option<Self> {
        if !POSSIBLE.contains(&fps) {
            return None;
        }
        let near = |value: f64| (value - value.round()).abs() < NEAR * value && value.round() >= 1.0;
        let video = (fps * 1.001).round() as u32;
        Some(if near(fps) {
            Self { frames: fps.round() as u32, seconds: 1 }
        } else if near(fps * 1.001) && VIDEO.contains(&video) {
            Self { frames: 1000 * video, seconds: 1001 }
        } else {
            Self { frames: (1000.0 * fps).round() as u32, seconds: 1000 }
        })
    }

    /// Returns the rate of a take: the median of the steps between its stamps. `None` if there are
    /// no steps, or they are no rate.
    pub fn of_take(take: &Take) -> Option<Self> {
        let stamps: Vec<_> = take.lines().map(|(_, stamp)| stamp).collect();
        let mut steps: Vec<i64> = stamps.windows(2).map(|pair| pair[1].ns_since(pair[0])).filter(|step| *step > 0).collect();
        let middle = steps.len() / 2;
        if steps.is_empty() {
            return None;
        }
        let (_, median, _) = steps.select_nth_unstable(middle);
        Self::new(1e9 / *median as f64)
    }

    /// Returns frames per second.
    pub fn fps(self) -> f64 {
        f64::from(self.frames) / f64::from(self.seconds)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn standard_rates_are_exact() {
        for (fps, frames, seconds) in [
            (25.0, 25, 1),
            (29.97, 30_000, 1001),
            (23.976, 24_000, 1001),
            (23.98, 24_000, 1001),
            (59.94, 60_000, 1001),
            (1e9 / 33_333_333.0, 30, 1),
            (1e9 / 33_366_667.0, 30_000, 1001),
            (12.5, 12_500, 1000),
            (30.5, 30_500, 1000),
            (0.1, 100, 1000),
        ] {
            assert_eq!(Rate::new(fps), Some(Rate { frames, seconds }), "{fps}");
        }
        assert!([0.0, -25.0, 1e9, f64::NAN, f64::INFINITY].iter().all(|fps| Rate::new(*fps).is_none()));
        assert_eq!(Rate::new(29.97).map(Rate::fps), Some(30_000.0 / 1001.0));
    }
}
