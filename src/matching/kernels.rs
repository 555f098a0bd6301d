//! Hamming distances of binary descriptors, eight at a time: a plain function, and the same function compiled
//! for wider registers where the processor has them (asked at run time).

use crate::features::Descriptor;
use crate::simd::multiversion;

/// Descriptors whose distances are computed side by side: one AVX-512 register of 64-bit words.
pub const LANES: usize = 8;

/// Eight descriptors, word by word, so that one register holds the same word of all.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Block(pub [[u64; LANES]; 4]);

/// Packs descriptors into blocks; the last one is filled up with zeros.
pub fn pack_into(all: impl Iterator<Item = Descriptor>, blocks: &mut Vec<Block>) {
    blocks.clear();
    for (k, d) in all.enumerate() {
        if k % LANES == 0 {
            blocks.push(Block([[0; LANES]; 4]));
        }
        if let Some(block) = blocks.last_mut() {
            for (words, word) in block.0.iter_mut().zip(d.0) {
                words[k % LANES] = word;
            }
        }
    }
}

multiversion! {
    /// Calls `visit(index, distance, bar)` for every packed descriptor nearer than the bar, in order; `visit` may lower the bar.
    /// Indices beyond the packed ones may be visited: they are filling.
    pub fn scan(query: &Descriptor, all: &[Block], visit: impl FnMut(usize, u32, &mut u32));
    ["avx512f" "avx512vpopcntdq"] => scan_plain, else scan_avx2
}

multiversion! {
    fn scan_avx2(query: &Descriptor, all: &[Block], visit: impl FnMut(usize, u32, &mut u32));
    ["avx2" "popcnt"] => scan_plain, else scan_plain
}

/// The plain twin of [`scan`].
#[inline(always)]
fn scan_plain(query: &Descriptor, all: &[Block], mut visit: impl FnMut(usize, u32, &mut u32)) {
    let mut bar = u32::MAX;
    for (k, block) in all.iter().enumerate() {
        let mut distances = [0u64; LANES];
        for (words, q) in block.0.iter().zip(query.0) {
            for (distance, word) in distances.iter_mut().zip(words) {
                *distance += u64::from((word ^ q).count_ones());
            }
        }
        let nearest = distances.iter().fold(u64::MAX, |m, d| m.min(*d));
        if nearest < u64::from(bar) {
            for (lane, &distance) in distances.iter().enumerate() {
                if (distance as u32) < bar {
                    visit(k * LANES + lane, distance as u32, &mut bar);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Bits in which two descriptors differ.
    fn hamming(a: &Descriptor, b: &Descriptor) -> u32 {
        (a.0[0] ^ b.0[0]).count_ones() + (a.0[1] ^ b.0[1]).count_ones() + (a.0[2] ^ b.0[2]).count_ones() + (a.0[3] ^ b.0[3]).count_ones()
    }

    proptest! {
        #[test]
        fn wide_scan_equals_plain(query in any::<[u64; 4]>(), all in proptest::collection::vec(any::<[u64; 4]>(), 0..50)) {
            let query = Descriptor(query);
            let descriptors: Vec<Descriptor> = all.into_iter().map(Descriptor).collect();
            let mut all = Vec::new();
            pack_into(descriptors.iter().copied(), &mut all);
            let run = |wide: bool| {
                let mut seen = Vec::new();
                let visit = |k: usize, d: u32, bar: &mut u32| { seen.push((k, d)); *bar = (*bar).min(d + 10); };
                if wide { scan(&query, &all, visit) } else { scan_plain(&query, &all, visit) }
                seen
            };
            prop_assert_eq!(run(true), run(false));
            let mut all_seen = vec![u32::MAX; all.len() * LANES];
            scan(&query, &all, |k, d, _| all_seen[k] = d);
            for (k, d) in descriptors.iter().enumerate() {
                prop_assert_eq!(all_seen[k], hamming(&query, d));
            }
        }
    }

    #[test]
    fn distance_counts_bits() {
        assert_eq!(hamming(&Descriptor([0; 4]), &Descriptor([u64::MAX; 4])), 256);
        assert_eq!(hamming(&Descriptor([5, 0, 0, 0]), &Descriptor([0, 0, 0, 1])), 3);
    }
}
