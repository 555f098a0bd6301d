//! The comparison as text and as JSON.

use std::fmt::Write as _;

use serde_json::{Value, json};

use crate::delay::Verdict;
use crate::geometry::Pose;
use crate::other_tracker::{Alignment, Differences, Spread};

/// Whether the stamps of both logs are of one clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Clocks {
    /// They are, as far as the formats say.
    Same,
    /// One has UTC, the other a clock of its own: the delay has no meaning of its own.
    Apart,
}

/// How much later the other's stamps are.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Shift {
    /// By the user's word.
    Given(f64),
    /// From the turn rates of both.
    Measured { delay_s: f64, sigma_s: f64 },
    /// It cannot be measured, and is taken to be 0.
    Unknown(String),
}

impl Shift {
    pub fn delay_s(&self) -> f64 {
        match self {
            Self::Given(delay_s) | Self::Measured { delay_s, .. } => *delay_s,
            Self::Unknown(_) => 0.0,
        }
    }
}

/// A finished comparison.
pub(super) struct Comparison {
    /// Our log and the other's, by name.
    pub files: [String; 2],
    pub rows: [usize; 2],
    pub clocks: Clocks,
    pub shift: Shift,
    pub alignment: Alignment,
    pub differences: Differences,
    pub verdict: Verdict,
    pub reasons: Vec<String>,
}

fn pose<A, B>(pose: &Pose<A, B>) -> Value {
    json!({"position_m": <[f64; 3]>::from(pose.translation), "orientation_xyzw": pose.orientation_xyzw()})
}

fn spread(spread: &Spread) -> Value {
    json!({"rms": spread.rms, "p95": spread.p95, "max": spread.max})
}

impl Comparison {
    pub fn text(&self) -> String {
        let mut text = String::new();
        for ((word, file), rows) in ["ours", "other's"].iter().zip(&self.files).zip(self.rows) {
            let _ = writeln!(text, "{word:<9} {file}: {rows} poses");
        }
        let delay = match &self.shift {
            Shift::Given(delay_s) => format!("{:+.2} ms, as it was typed", delay_s * 1e3),
            Shift::Measured { delay_s, sigma_s } => {
                format!("{:+.2} ms, sigma {:.2} ms: how late the other's stamps are", delay_s * 1e3, sigma_s * 1e3)
            }
            Shift::Unknown(why) => format!("not known, taken as 0: {why}"),
        };
        let _ = writeln!(text, "delay     {delay}");
        if self.clocks == Clocks::Apart {
            let _ = writeln!(
                text,
                "          the stamps are of two clocks: it counts from the first row of each log, and says nothing of the trackers"
            );
        }
        let d = &self.differences;
        let _ =
            writeln!(text, "instants  {}\nscale     {:+.3} %\n{:<9} {:>9} {:>9} {:>9}", d.pairs, d.scale * 100.0, "", "rms", "p95", "max");
        let mut line = |name: &str, spread: &Spread, factor: f64, unit: &str| {
            let [rms, p95, max] = [spread.rms, spread.p95, spread.max].map(|v| v * factor);
            let _ = writeln!(text, "{name:<9} {rms:>9.3} {p95:>9.3} {max:>9.3} {unit}");
        };
        for (name, spread) in ["x", "y", "z"].iter().zip(&d.position_m).chain([(&"distance", &d.distance_m)]) {
            line(name, spread, 1e3, "mm");
        }
        for (name, spread) in ["about x", "about y", "about z"].iter().zip(&d.rotation_deg).chain([(&"angle", &d.angle_deg)]) {
            line(name, spread, 1.0, "degrees");
        }
        let _ = writeln!(text, "verdict   {}", self.verdict);
        self.reasons.iter().for_each(|reason| {
            let _ = writeln!(text, "          {reason}");
        });
        text
    }

    pub fn json(&self) -> String {
        let (delay_s, sigma_s) = match &self.shift {
            Shift::Given(delay_s) => (Some(*delay_s), None),
            Shift::Measured { delay_s, sigma_s } => (Some(*delay_s), Some(*sigma_s)),
            Shift::Unknown(_) => (None, None),
        };
        let d = &self.differences;
        let value = json!({
            "delay_s": delay_s, "sigma_s": sigma_s, "same_clock": self.clocks == Clocks::Same, "pairs": d.pairs, "scale": d.scale + 1.0,
            "world": pose(&self.alignment.world), "sensor": pose(&self.alignment.sensor),
            "position_m": d.position_m.each_ref().map(spread), "distance_m": spread(&d.distance_m),
            "rotation_deg": d.rotation_deg.each_ref().map(spread), "angle_deg": spread(&d.angle_deg),
            "verdict": self.verdict.to_string(), "reasons": self.reasons,
        });
        format!("{value:#}\n")
    }
}
