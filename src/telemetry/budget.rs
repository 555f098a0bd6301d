//! The delay budget: where the time between the instant of a pose and its packet goes, and how each
//! part is known.
//!
//! A pose is that of mid-exposure in the middle row, so half of the exposure and half of the
//! readout pass after its instant. The transfer is the rest of a frame's age when tracking
//! begins.

use std::fmt;

use crate::camera::KnownShutter;
use crate::track::LearntCamera;

/// How a part of the budget is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// By the config or the camera's driver.
    Known,
    /// From the pictures' blur or bending.
    Learnt,
    /// By clocks, as a mean since the start.
    Measured,
    /// By clocks, with other parts in it that are not known.
    AtMost,
    /// Not at all yet.
    Unknown,
}

impl Origin {
    /// Returns its word in sentences and metrics.
    pub fn word(self) -> &'static str {
        match self {
            Self::Known => "known",
            Self::Learnt => "learnt",
            Self::Measured => "measured",
            Self::AtMost => "at most",
            Self::Unknown => "unknown",
        }
    }
}

/// A part of the delay.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BudgetPart {
    /// Its name.
    pub name: &'static str,
    /// Its length, seconds; `None` while unknown.
    pub seconds: Option<f64>,
    /// How it is known.
    pub origin: Origin,
}

/// Mean times of the daemon's clocks, seconds; `None` before the first.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MeanTimes {
    /// A frame's age when tracking it begins, from mid-exposure in the middle row.
    pub age_s: Option<f64>,
    /// Decoding a picture.
    pub decode_s: Option<f64>,
    /// Tracking it.
    pub track_s: Option<f64>,
    /// From the sample to the last packet of the slowest output.
    pub send_s: Option<f64>,
}

/// Exposure, readout, transfer, decode, track and send, in the order in which they pass.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Budget(pub [BudgetPart; 6]);

impl Budget {
    /// Makes the budget of what is known.
    pub fn of(shutter: &KnownShutter, learnt: &LearntCamera, times: &MeanTimes) -> Self {
        let half = |name, known: Option<f64>, learnt: Option<f64>| {
            let (seconds, origin) = match (known, learnt) {
                (Some(seconds), _) => (Some(seconds), Origin::Known),
                (None, Some(seconds)) => (Some(seconds), Origin::Learnt),
                (None, None) => (None, Origin::Unknown),
            };
            // Rows that are read from the bottom up take as long.
            BudgetPart { name, seconds: seconds.map(|s| 0.5 * s.abs()), origin }
        };
        let exposure = half("exposure", shutter.exposure_s, learnt.exposure.map(|time| time.seconds));
        let readout = half("readout", shutter.readout_s, learnt.readout.map(|time| time.seconds));
        let measured = |name, seconds: Option<f64>| BudgetPart {
            name,
            seconds,
            origin: if seconds.is_some() { Origin::Measured } else { Origin::Unknown },
        };
        let halves = [exposure, readout];
        let is_whole = halves.iter().all(|part| part.seconds.is_some());
        let before: f64 = halves.iter().filter_map(|part| part.seconds).sum::<f64>() + times.decode_s.unwrap_or(0.0);
        let mut transfer = measured("transfer", times.age_s.map(|age_s| (age_s - before).max(0.0)));
        if transfer.seconds.is_some() && !is_whole {
            transfer.origin = Origin::AtMost;
        }
        let [decode, track, send] =
            [("decode", times.decode_s), ("track", times.track_s), ("send", times.send_s)].map(|(n, s)| measured(n, s));
        Self([exposure, readout, transfer, decode, track, send])
    }

    /// Returns the sum of the parts with a length, seconds; `None` while the transfer or the
    /// tracking has none, which are most of it.
    pub fn total_s(&self) -> Option<f64> {
        let [.., transfer, _, track, _] = &self.0;
        (transfer.seconds.is_some() && track.seconds.is_some()).then(|| self.0.iter().filter_map(|part| part.seconds).sum())
    }
}

impl fmt::Display for Budget {
    /// Writes the parts as a sum.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (k, part) in self.0.iter().enumerate() {
            let plus = if k == 0 { "" } else { " + " };
            match part.seconds {
                Some(seconds) => write!(f, "{plus}{} {:.1} ms ({})", part.name, seconds * 1e3, part.origin.word())?,
                None => write!(f, "{plus}{} ({})", part.name, part.origin.word())?,
            }
        }
        self.total_s().map_or(Ok(()), |total_s| write!(f, " = {:.1} ms", total_s * 1e3))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::track::LearntTime;

    #[test]
    fn every_part_says_how_it_is_known() {
        let shutter = KnownShutter { exposure_s: Some(0.008), readout_s: None };
        let learnt = LearntCamera { readout: Some(LearntTime { seconds: -0.02, sigma_s: 1e-4 }), exposure: None, curve: None };
        let times = MeanTimes { age_s: Some(0.035), decode_s: Some(0.002), track_s: Some(0.009), send_s: Some(0.0002) };
        let budget = Budget::of(&shutter, &learnt, &times);
        assert_eq!(
            budget.to_string(),
            "exposure 4.0 ms (known) + readout 10.0 ms (learnt) + transfer 19.0 ms (measured) + decode 2.0 ms (measured) + track 9.0 ms \
             (measured) + send 0.2 ms (measured) = 44.2 ms"
        );
        // Age at the begin of tracking, tracking and sending are the whole way.
        assert!((budget.total_s().unwrap() - (0.035 + 0.009 + 0.0002)).abs() < 1e-12);
    }

    #[test]
    fn what_is_not_known_is_not_made_up() {
        let nothing = Budget::of(&KnownShutter::default(), &LearntCamera::default(), &MeanTimes::default());
        assert_eq!(
            nothing.to_string(),
            "exposure (unknown) + readout (unknown) + transfer (unknown) + decode (unknown) + track (unknown) + send (unknown)"
        );
        // An exposure that nobody knows is in the transfer, which is then a bound.
        let times = MeanTimes { age_s: Some(0.03), track_s: Some(0.01), ..MeanTimes::default() };
        let bounded = Budget::of(&KnownShutter { exposure_s: None, readout_s: Some(0.0) }, &LearntCamera::default(), &times);
        assert_eq!((bounded.0[2].seconds, bounded.0[2].origin), (Some(0.03), Origin::AtMost));
        assert_eq!(bounded.total_s(), Some(0.04));
    }
}
