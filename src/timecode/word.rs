//! From bits to the words of frames (SMPTE ST 12-1): 64 bits of timecode and user bits, then the
//! synchronisation word, which also tells the direction.

use std::collections::VecDeque;

use super::code::Timecode;

/// Bits of a frame.
const BITS: usize = 80;
/// The last 16 bits of a frame, in the order of transmission.
const SYNCHRONISATION: u128 = 0b0011_1111_1111_1101;
/// The same as a tape that runs backwards plays it.
const REVERSED: u128 = 0b1011_1111_1111_1100;

/// A frame's word as it came.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Word {
    pub code: Timecode,
    /// Where its first bit begins, samples, in the order in which it came.
    pub begin: f64,
    /// Where its last bit ends, samples.
    pub end: f64,
    /// Whether it came backwards.
    pub is_reverse: bool,
}

/// Collects bits.
#[derive(Debug, Default)]
pub(super) struct WordReader {
    /// The last 80 bits, the newest lowest.
    register: u128,
    /// Where they begin.
    begins: VecDeque<f64>,
}

impl WordReader {
    /// Adds a bit, and where it begins and ends; returns the word that it completes.
    pub fn push(&mut self, value: bool, begin: f64, end: f64) -> Option<Word> {
        if self.begins.len() == BITS {
            self.begins.pop_front();
        }
        self.begins.push_back(begin);
        self.register = (self.register << 1 | u128::from(value)) & ((1 << BITS) - 1);
        if self.begins.len() < BITS {
            return None;
        }
        let is_reverse = self.register >> (BITS - 16) == REVERSED;
        if !is_reverse && self.register & 0xFFFF != SYNCHRONISATION {
            return None;
        }
        // Bit k of the frame at bit k of the number.
        let bits = if is_reverse { self.register } else { self.register.reverse_bits() >> (128 - BITS) };
        let code = timecode(bits)?;
        Some(Word { code, begin: *self.begins.front()?, end, is_reverse })
    }

    /// Forgets the bits.
    pub fn clear(&mut self) {
        self.begins.clear();
    }
}

/// Returns the timecode of a word; `None` if it has none.
fn timecode(bits: u128) -> Option<Timecode> {
    let field = |at: u32, length: u32| (bits >> at & ((1 << length) - 1)) as u8;
    let number = |ones: u8, tens: u8| (ones < 10).then_some(10 * tens + ones);
    let code = Timecode {
        frames: number(field(0, 4), field(8, 2))?,
        seconds: number(field(16, 4), field(24, 3))?,
        minutes: number(field(32, 4), field(40, 3))?,
        hours: number(field(48, 4), field(56, 2))?,
        is_drop: field(10, 1) == 1,
    };
    code.is_valid().then_some(code)
}
