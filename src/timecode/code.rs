//! A timecode: hours, minutes, seconds and frames.

use std::fmt;
use std::str::FromStr;

use super::rate::TimecodeRate;

/// Hours, minutes, seconds and frames of a day.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Timecode {
    /// 0 to 23.
    pub hours: u8,
    /// 0 to 59.
    pub minutes: u8,
    /// 0 to 59.
    pub seconds: u8,
    /// From 0 to one less than the rate's count, at most 29.
    pub frames: u8,
    /// Whether it belongs to a drop-frame count.
    pub is_drop: bool,
}

/// Frames that drop-frame timecode counts in a minute that leaves out two numbers.
const DROP_MINUTE: u32 = 60 * 30 - 2;
/// Frames that it counts in ten minutes, of which the first leaves none out.
const DROP_TEN_MINUTES: u32 = 10 * DROP_MINUTE + 2;

impl Timecode {
    /// Whether such a timecode exists at any rate.
    pub fn is_valid(self) -> bool {
        let is_dropped = self.is_drop && self.seconds == 0 && self.frames < 2 && !self.minutes.is_multiple_of(10);
        self.hours < 24 && self.minutes < 60 && self.seconds < 60 && self.frames < 30 && !is_dropped
    }

    /// Returns the number of its frame since 00:00:00:00.
    pub fn number(self, rate: TimecodeRate) -> u32 {
        let [hours, minutes, seconds, frames] = [self.hours, self.minutes, self.seconds, self.frames].map(u32::from);
        let of_minutes = 60 * hours + minutes;
        let all = (60 * of_minutes + seconds) * u32::from(rate.count()) + frames;
        all - if rate.is_drop() { 2 * (of_minutes - of_minutes / 10) } else { 0 }
    }

    /// Returns the timecode of a frame number; the number starts again after a day.
    pub fn of_number(number: i64, rate: TimecodeRate) -> Self {
        let count = u32::from(rate.count());
        let day = if rate.is_drop() { 24 * 6 * DROP_TEN_MINUTES } else { 86_400 * count };
        // The remainder is below a day's frames, which fit.
        let mut number = number.rem_euclid(i64::from(day)) as u32;
        if rate.is_drop() {
            let (tens, rest) = (number / DROP_TEN_MINUTES, number % DROP_TEN_MINUTES);
            number += 18 * tens + if rest >= 2 { 2 * ((rest - 2) / DROP_MINUTE) } else { 0 };
        }
        let (seconds, frames) = (number / count, number % count);
        let [hours, minutes, seconds, frames] = [seconds / 3600, seconds / 60 % 60, seconds % 60, frames].map(|part| part as u8);
        Self { hours, minutes, seconds, frames, is_drop: rate.is_drop() }
    }

    /// Whether `next` can be the frame after this one, at any of the rates.
    pub fn precedes(self, next: Self) -> bool {
        if self.is_drop != next.is_drop {
            return false;
        }
        let counts: &[u8] = if self.is_drop { &[30] } else { &[24, 25, 30] };
        counts.iter().filter(|count| self.frames < **count).any(|count| {
            let rate = TimecodeRate::nearest(*count, self.is_drop, f64::from(*count));
            rate.is_some_and(|rate| Self::of_number(i64::from(self.number(rate)) + 1, rate) == next)
        })
    }
}

/// `01:02:03:04`; with drop frame `01:02:03;04`.
impl fmt::Display for Timecode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let before_frames = if self.is_drop { ';' } else { ':' };
        write!(f, "{:02}:{:02}:{:02}{before_frames}{:02}", self.hours, self.minutes, self.seconds, self.frames)
    }
}

impl FromStr for Timecode {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        let is_drop = text.contains(';');
        let mut parts = text.split([':', ';']).map(|part| match part.as_bytes() {
            [tens @ b'0'..=b'9', ones @ b'0'..=b'9'] => Ok(10 * (tens - b'0') + ones - b'0'),
            _ => Err(()),
        });
        let mut part = || parts.next().unwrap_or(Err(()));
        let code = Self { hours: part()?, minutes: part()?, seconds: part()?, frames: part()?, is_drop };
        (parts.next().is_none() && code.is_valid() && code.to_string() == text).then_some(code).ok_or(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn code(text: &str) -> Timecode {
        text.parse().unwrap()
    }

    #[test]
    fn every_number_of_a_day_returns() {
        for rate in TimecodeRate::ALL {
            let mut last = Timecode::of_number(-1, rate);
            let mut number = 0;
            while number == 0 || last != Timecode::of_number(-1, rate) {
                let next = Timecode::of_number(number, rate);
                assert!(next.is_valid() && last.precedes(next), "{last} {next} at {rate}");
                assert_eq!(i64::from(next.number(rate)), number);
                (last, number) = (next, number + 1);
            }
            let day_s = number as f64 / rate.fps();
            // Drop frame is 86 ms late after a day; without, 29.97 is 86 s late.
            let wanted = match rate {
                TimecodeRate::Fps29_97 | TimecodeRate::Fps23_976 => 86_486.4,
                TimecodeRate::Fps29_97Drop => 86_399.913_6,
                _ => 86_400.0,
            };
            assert!((day_s - wanted).abs() < 1e-6, "{rate}: {day_s}");
        }
    }

    #[test]
    fn drop_frame_leaves_out_two_numbers_but_every_tenth_minute() {
        assert!(code("00:00:59;29").precedes(code("00:01:00;02")) && code("00:09:59;29").precedes(code("00:10:00;00")));
        assert!("00:01:00;01".parse::<Timecode>().is_err() && "00:01:00:01".parse::<Timecode>().is_ok());
        assert!(!code("00:00:59:29").precedes(code("00:01:00;02")));
    }

    #[test]
    fn only_a_following_frame_follows() {
        for [a, b] in [["01:02:03:23", "01:02:04:00"], ["01:02:03:24", "01:02:04:00"], ["23:59:59:29", "00:00:00:00"]] {
            assert!(code(a).precedes(code(b)) && !code(b).precedes(code(a)), "{a} {b}");
        }
        for [a, b] in [["01:02:03:22", "01:02:04:00"], ["01:02:03:05", "01:02:03:07"], ["01:02:03:05", "01:02:03:05"]] {
            assert!(!code(a).precedes(code(b)), "{a} {b}");
        }
    }

    #[test]
    fn texts_that_are_no_timecode_are_refused() {
        for text in
            ["", "1:02:03:04", "01:02:03", "01:02:03:30", "24:00:00:00", "01:60:00:00", "01;02:03:04", "01:02:03:04:05", "a1:00:00:00"]
        {
            assert!(text.parse::<Timecode>().is_err(), "{text}");
        }
    }
}
