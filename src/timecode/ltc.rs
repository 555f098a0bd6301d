//! The decoder of linear timecode: samples in, frames out.
//!
//! A word of timecode has no checksum. So a frame is reported only if the word that touches it,
//! just before or just after, is its neighbour in count: a damaged word is absent, never wrong. The
//! first frame of a run is therefore reported one frame later than the others.

use super::bits::{BitReader, Step};
use super::code::Timecode;
use super::edges::EdgeFinder;
use super::word::{Word, WordReader};

/// How far two words may be apart and still touch, as a fraction of a frame: half a bit.
const TOUCHING: f64 = 0.5 / 80.0;

/// A decoded frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LtcFrame {
    /// Its timecode.
    pub code: Timecode,
    /// When the frame begins on the tape, in samples since the first. Played backwards, this is
    /// when the playing head has come back to its beginning.
    pub edge: f64,
    /// Length of the frame as played, samples.
    pub length: f64,
    /// Whether it was played backwards.
    pub is_reverse: bool,
}

impl LtcFrame {
    fn of(word: &Word) -> Self {
        let Word { code, begin, end, is_reverse } = *word;
        Self { code, edge: if is_reverse { end } else { begin }, length: end - begin, is_reverse }
    }
}

/// Decodes linear timecode at 24 to 30 frames per second, 0.5 to 1.5 times the speed, forwards and
/// backwards, in either polarity.
#[derive(Debug)]
pub struct LtcDecoder {
    edges: EdgeFinder,
    bits: BitReader,
    words: WordReader,
    last: Option<Word>,
    is_last_reported: bool,
    unconfirmed: u64,
}

impl LtcDecoder {
    /// Starts on samples of this rate, per second.
    pub fn new(sample_rate: u32) -> Self {
        Self {
            edges: EdgeFinder::new(f64::from(sample_rate)),
            bits: BitReader::default(),
            words: WordReader::default(),
            last: None,
            is_last_reported: false,
            unconfirmed: 0,
        }
    }

    /// Adds samples from -1 to 1, and passes the frames that they complete to `found`, in order.
    pub fn push(&mut self, samples: &[f32], found: &mut dyn FnMut(LtcFrame)) {
        for sample in samples {
            let Some(edge) = self.edges.push(*sample) else { continue };
            match self.bits.push(edge) {
                Some(Step::Bit(value, begin, end)) => {
                    if let Some(word) = self.words.push(value, begin, end) {
                        self.add(word, found);
                    }
                }
                Some(Step::Break) => self.words.clear(),
                None => {}
            }
        }
    }

    /// Returns how many words had no neighbour to confirm them.
    pub fn unconfirmed(&self) -> u64 {
        self.unconfirmed
    }

    fn add(&mut self, word: Word, found: &mut dyn FnMut(LtcFrame)) {
        let confirmed = self.last.filter(|last| confirms(last, &word));
        match confirmed {
            Some(last) if !self.is_last_reported => found(LtcFrame::of(&last)),
            None if self.last.is_some() && !self.is_last_reported => self.unconfirmed += 1,
            _ => {}
        }
        self.is_last_reported = confirmed.is_some();
        if self.is_last_reported {
            found(LtcFrame::of(&word));
        }
        self.last = Some(word);
    }
}

/// Whether two words touch and are neighbours in count.
fn confirms(last: &Word, word: &Word) -> bool {
    let (earlier, later) = if word.is_reverse { (word, last) } else { (last, word) };
    let touch = (word.begin - last.end).abs() < TOUCHING * (word.end - word.begin);
    last.is_reverse == word.is_reverse && touch && earlier.code.precedes(later.code)
}

#[cfg(test)]
#[path = "ltc_tests.rs"]
mod tests;
