//! The rates of timecode.

use std::fmt;
use std::str::FromStr;

/// Frames per second of a timecode, and how they are counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum TimecodeRate {
    /// 24000/1001 frames per second, counted as 24.
    Fps23_976,
    /// 24 frames per second.
    Fps24,
    /// 25 frames per second.
    Fps25,
    /// 30000/1001 frames per second, counted as 30: an hour of timecode lasts 3603.6 s.
    Fps29_97,
    /// 30000/1001 frames per second. Two numbers are left out at the start of every minute but
    /// every tenth, so that timecode follows the time of day.
    Fps29_97Drop,
    /// 30 frames per second.
    Fps30,
}

impl TimecodeRate {
    /// All rates.
    pub const ALL: [Self; 6] = [Self::Fps23_976, Self::Fps24, Self::Fps25, Self::Fps29_97, Self::Fps29_97Drop, Self::Fps30];

    /// Returns its name: `23.976`, `24`, `25`, `29.97`, `29.97df`, `30`.
    pub fn word(self) -> &'static str {
        match self {
            Self::Fps23_976 => "23.976",
            Self::Fps24 => "24",
            Self::Fps25 => "25",
            Self::Fps29_97 => "29.97",
            Self::Fps29_97Drop => "29.97df",
            Self::Fps30 => "30",
        }
    }

    /// Returns frames per second as numerator and denominator.
    pub fn fraction(self) -> (u32, u32) {
        match self {
            Self::Fps23_976 => (24_000, 1001),
            Self::Fps24 => (24, 1),
            Self::Fps25 => (25, 1),
            Self::Fps29_97 | Self::Fps29_97Drop => (30_000, 1001),
            Self::Fps30 => (30, 1),
        }
    }

    /// Returns frames per second.
    pub fn fps(self) -> f64 {
        let (numerator, denominator) = self.fraction();
        f64::from(numerator) / f64::from(denominator)
    }

    /// Returns how many frame numbers a second has: 24, 25 or 30.
    pub fn count(self) -> u8 {
        match self {
            Self::Fps23_976 | Self::Fps24 => 24,
            Self::Fps25 => 25,
            Self::Fps29_97 | Self::Fps29_97Drop | Self::Fps30 => 30,
        }
    }

    /// Whether frame numbers are left out.
    pub fn is_drop(self) -> bool {
        self == Self::Fps29_97Drop
    }

    /// Returns the rate that counts `count` frames a second, with or without drop frame, and is
    /// nearest to `fps`.
    pub fn nearest(count: u8, is_drop: bool, fps: f64) -> Option<Self> {
        let far = |rate: &Self| (rate.fps() - fps).abs();
        Self::ALL.into_iter().filter(|rate| rate.count() == count && rate.is_drop() == is_drop).min_by(|a, b| far(a).total_cmp(&far(b)))
    }
}

impl fmt::Display for TimecodeRate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}

impl FromStr for TimecodeRate {
    type Err = ();

    fn from_str(word: &str) -> Result<Self, ()> {
        Self::ALL.into_iter().find(|rate| rate.word() == word).ok_or(())
    }
}
