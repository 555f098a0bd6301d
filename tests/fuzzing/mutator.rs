//! Changes good files slightly: bytes as damage changes them, text as typing changes it.

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// The format of a file, which decides how it is changed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Form {
    /// Lines, words and numbers.
    Text,
    /// Plain bytes.
    Binary,
    /// Bytes with a checksum over each chunk. The checksum is usually corrected afterwards, because
    /// nothing is read behind a wrong one.
    Png,
}

/// Makes inputs from good ones; the same seed makes the same inputs.
pub struct Mutator {
    random: Pcg64Mcg,
    form: Form,
    seeds: Vec<Vec<u8>>,
}

/// Maximum input size, bytes: larger than every seed. It limits the growth from repeated pieces.
const LONGEST: usize = 1 << 20;
/// Numbers at the limits of their types and beyond.
const BYTES: [u64; 14] = [0, 1, 0x7F, 0x80, 0xFF, 0x100, 0x7FFF, 0x8000, 0xFFFF, 0x4000, 0x7FFF_FFFF, 0x8000_0000, 0xFFFF_FFFF, u64::MAX];
const WORDS: [&str; 31] = [
    "0",
    "-1",
    "1",
    "1e300",
    "-1e300",
    "1e-320",
    "nan",
    "inf",
    ".nan",
    "-.inf",
    "4294967295",
    "99999999999999999999",
    "0x10",
    "1.",
    ".5",
    "",
    "true",
    "\"\"",
    "\"x\"",
    "[]",
    "[[[[[[[[[[[[[[[[[[[[",
    "{}",
    "{",
    "*a",
    "&a",
    "../x",
    "/dev/zero",
    ".",
    "-",
    "\u{1F3AD}",
    "\u{1b}[31m",
];

impl Mutator {
    pub fn new(seed: u64, form: Form, seeds: Vec<Vec<u8>>) -> Self {
        assert!(!seeds.is_empty() && seeds.iter().all(|s| !s.is_empty() && s.len() < LONGEST));
        Self { random: Pcg64Mcg::seed_from_u64(seed), form, seeds }
    }

    /// Returns the next input; one in ten is an unchanged good file.
    pub fn next_input(&mut self) -> Vec<u8> {
        let mut input = self.seeds[self.random.random_range(0..self.seeds.len())].clone();
        // Mostly one change: a file that is wrong in many places is refused at the first of them.
        let changes = [0, 1, 1, 1, 1, 1, 2, 2, 4, 16][self.random.random_range(0..10)];
        for _ in 0..changes {
            let as_text = self.form == Form::Text && self.random.random_ratio(2, 3);
            if as_text {
                self.change_text(&mut input)
            } else {
                self.change_bytes(&mut input)
            }
            input.truncate(LONGEST);
        }
        if self.form == Form::Png && self.random.random_ratio(4, 5) {
            set_checksums(&mut input);
        }
        input
    }

    /// Returns a random range, which is often short.
    fn piece(&mut self, length: usize) -> std::ops::Range<usize> {
        let from = self.random.random_range(0..=length);
        let most = if self.random.random_bool(0.7) { 16 } else { length };
        from..(from + self.random.random_range(0..=most)).min(length)
    }

    fn change_bytes(&mut self, input: &mut Vec<u8>) {
        let piece = self.piece(input.len());
        match self.random.random_range(0..9) {
            0 => {
                if let Some(byte) = input.get_mut(piece.start) {
                    *byte ^= 1 << self.random.random_range(0..8);
                }
            }
            1 => {
                if let Some(byte) = input.get_mut(piece.start) {
                    *byte = self.random.random();
                }
            }
            2 => drop(input.drain(piece)),
            3 => input.truncate(piece.start),
            4 => {
                let copy = input[piece].to_vec();
                let at = self.random.random_range(0..=input.len());
                input.splice(at..at, copy);
            }
            5 => {
                let random: Vec<u8> = (0..self.random.random_range(1..20)).map(|_| self.random.random()).collect();
                input.splice(piece.start..piece.start, random);
            }
            6 => {
                let other = &self.seeds[self.random.random_range(0..self.seeds.len())];
                let tail = other[piece.start.min(other.len())..].to_vec();
                input.splice(piece.start.., tail);
            }
            _ => {
                let number = BYTES[self.random.random_range(0..BYTES.len())];
                let width = [1, 2, 4][self.random.random_range(0..3)];
                let little = number.to_le_bytes();
                let mut bytes = little[..width].to_vec();
                if self.random.random() {
                    bytes.reverse();
                }
                input.iter_mut().skip(piece.start).zip(bytes).for_each(|(to, from)| *to = from);
            }
        }
    }

    fn change_text(&mut self, input: &mut Vec<u8>) {
        let text = String::from_utf8_lossy(input).into_owned();
        let mut lines: Vec<String> = text.split('\n').map(str::to_owned).collect();
        let (one, other) = (self.random.random_range(0..lines.len()), self.random.random_range(0..lines.len()));
        match self.random.random_range(0..7) {
            0 => drop(lines.remove(one)),
            1 => lines.insert(other, lines[one].clone()),
            2 => lines.swap(one, other),
            // The key of one line with the value of another.
            3 => {
                let value = lines[other].split_once(['=', ':']).map_or_else(String::new, |(_, value)| value.to_owned());
                if let Some(at) = lines[one].find(['=', ':']) {
                    lines[one].replace_range(at + 1.., &value);
                }
            }
            _ => {
                let word = WORDS[self.random.random_range(0..WORDS.len())];
                lines[one] = self.with_word(&lines[one], word);
            }
        }
        *input = lines.join("\n").into_bytes();
    }

    /// Returns a line with one of its words or numbers replaced.
    fn with_word(&mut self, line: &str, word: &str) -> String {
        let is_inside = |c: char| c.is_alphanumeric() || "._+-\"/".contains(c);
        let starts: Vec<usize> = line
            .char_indices()
            .filter(|(at, c)| is_inside(*c) && !line[..*at].chars().next_back().is_some_and(is_inside))
            .map(|(at, _)| at)
            .collect();
        if starts.is_empty() {
            return format!("{line}{word}");
        }
        let start = starts[self.random.random_range(0..starts.len())];
        let end = line[start..].find(|c| !is_inside(c)).map_or(line.len(), |length| start + length);
        format!("{}{word}{}", &line[..start], &line[end..])
    }
}

/// Corrects the checksum of every chunk that is still intact.
fn set_checksums(png: &mut [u8]) {
    let mut at = 8;
    while let Some(&[a, b, c, d]) = png.get(at..at + 4) {
        let end = at.saturating_add(8).saturating_add(u32::from_be_bytes([a, b, c, d]) as usize);
        let Some(chunk) = png.get(at + 4..end) else { return };
        let checksum = crc(chunk).to_be_bytes();
        let Some(place) = png.get_mut(end..end + 4) else { return };
        place.copy_from_slice(&checksum);
        at = end + 4;
    }
}

/// Computes the CRC-32 of ISO 3309, as PNG uses it.
fn crc(bytes: &[u8]) -> u32 {
    let step =
        |crc: u32, byte: &u8| (0..8).fold(crc ^ u32::from(*byte), |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0xEDB8_8320 } else { crc >> 1 });
    !bytes.iter().fold(u32::MAX, step)
}
