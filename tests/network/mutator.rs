//! Damages good inputs in a reproducible way.

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

/// Maximum size of an input, bytes: about what one datagram holds.
const LONGEST: usize = 60_000;
/// Values at which numbers of one, two, four and eight bytes go wrong.
const EDGES: [u64; 12] = [0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x7FFF_FFFF, 0x8000_0000, 0xFFFF_FFFF, u64::MAX];
/// Terminal escape sequences, bytes that are not text, and pieces with which protocols begin, end
/// and nest.
const PIECES: [&[u8]; 20] = [
    b"\x1b]0;owned\x07",
    b"\x1b[2J\x1b[H",
    b"\xc2\x9b2J",
    b"\xe2\x80\xaegnp.exe",
    b"\r\nstagepose: good\n",
    b"\xff\xfe",
    b"\xed\xa0\x80",
    b"\0",
    b"#bundle\0\0\0\0\0\0\0\0\x01",
    b"[[[[[[[[",
    b"]]]]]]]]",
    b"{\"a\":",
    b"1e999",
    b"\\u0000\\ud800",
    b"\x9b\xff\xff\xff\xff\xff\xff\xff\xff",
    b"\x5f\x7f\xff",
    b"NaN",
    b"\r\n\r\n",
    b"\r\nHost: evil.example",
    b"\r\nTransfer-Encoding: chunked\r\nContent-Length: 7",
];

/// A reproducible source of damage.
pub struct Mutator {
    random: Pcg64,
}

impl Mutator {
    pub fn new(seed: u64) -> Self {
        Self { random: Pcg64::seed_from_u64(seed) }
    }

    pub fn below(&mut self, n: usize) -> usize {
        self.random.random_range(0..n.max(1))
    }

    /// Returns one of the good inputs with zero to eight faults.
    pub fn input(&mut self, good: &[Vec<u8>]) -> Vec<u8> {
        let mut bytes = good[self.below(good.len())].clone();
        for _ in 0..self.below(9) {
            self.damage(&mut bytes, good);
        }
        bytes.truncate(LONGEST);
        bytes
    }

    fn damage(&mut self, bytes: &mut Vec<u8>, good: &[Vec<u8>]) {
        let (at, kind) = (self.below(bytes.len() + 1), self.below(9));
        let length = 1 + self.below(16);
        let end = (at + length).min(bytes.len());
        match kind {
            0 if at < bytes.len() => bytes[at] ^= 1 << self.below(8),
            1 if at < bytes.len() => bytes[at] = self.random.random(),
            2 => drop(bytes.drain(at..end)),
            3 => bytes.truncate(at),
            4 => {
                let piece = PIECES[self.below(PIECES.len())].repeat(if self.below(20) == 0 { 1 + self.below(2000) } else { 1 });
                drop(bytes.splice(at..at, piece));
            }
            5 => {
                let (edge, width) = (EDGES[self.below(EDGES.len())], 1 << self.below(4));
                let number =
                    if self.below(2) == 0 { edge.to_be_bytes()[8 - width..].to_vec() } else { edge.to_le_bytes()[..width].to_vec() };
                let end = (at + width).min(bytes.len());
                drop(bytes.splice(at..end, number));
            }
            6 => {
                let copy = bytes[at..end].to_vec();
                drop(bytes.splice(at..at, copy));
            }
            7 => {
                let other = &good[self.below(good.len())];
                let from = self.below(other.len() + 1);
                drop(bytes.splice(at.., other[from..].iter().copied()));
            }
            _ => bytes.extend((0..length).map(|_| self.random.random::<u8>())),
        }
    }
}
