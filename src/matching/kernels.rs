//! Hamming distances of binary descriptors, eight at a time from each of four: a plain function, and the same function compiled
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

/// Gathers what is compared together; the last group is filled up.
pub fn group_into<T: Copy + Default>(all: impl Iterator<Item = T>, groups: &mut Vec<[T; QUERIES]>) {
    groups.clear();
    for (k, one) in all.enumerate() {
        if k % QUERIES == 0 {
            groups.push([T::default(); QUERIES]);
        }
        if let Some(group) = groups.last_mut() {
            group[k % QUERIES] = one;
        }
    }
}

/// Queries that go through the packed descriptors together: a bank of views is larger than the nearest cache, and each block is fetched once for all of them.
/// Chosen: their words fill half of AVX-512's registers. Raised, they no longer fit.
pub const QUERIES: usize = 4;

multiversion! {
    /// Calls `visit(query, index, distance, bar)` for every packed descriptor that is nearer to a query than its bar, in order; `visit` may lower the bar, which is
    /// `from` at the start. Indices beyond the packed ones may be visited: they are filling.
    pub fn scan(queries: &[Descriptor; QUERIES], all: &[Block], from: u32, visit: impl FnMut(usize, usize, u32, &mut u32));
    ["avx512f" "avx512vpopcntdq"] => scan_avx512, else scan_avx2
}

multiversion! {
    fn scan_avx2(queries: &[Descriptor; QUERIES], all: &[Block], from: u32, visit: impl FnMut(usize, usize, u32, &mut u32));
    ["avx2" "popcnt"] => scan_plain, else scan_plain
}

/// The plain twin of [`scan`].
#[inline(always)]
fn scan_plain(queries: &[Descriptor; QUERIES], all: &[Block], from: u32, mut visit: impl FnMut(usize, usize, u32, &mut u32)) {
    let mut bars = [u64::from(from); QUERIES];
    for (k, block) in all.iter().enumerate() {
        // Negative, and so with the sign's bit, where a distance is below its bar.
        let mut beyond = [0u64; LANES];
        for (query, bar) in queries.iter().zip(&bars) {
            for (beyond, distance) in beyond.iter_mut().zip(distances(query, block)) {
                *beyond |= distance.wrapping_sub(*bar);
            }
        }
        if beyond.iter().fold(0, |all, lane| all | lane) >> 63 == 0 {
            continue;
        }
        // Few blocks come here.
        for (n, (query, bar)) in queries.iter().zip(&mut bars).enumerate() {
            let distances = distances(query, block);
            if distances.iter().fold(u64::MAX, |nearest, d| nearest.min(*d)) >= *bar {
                continue;
            }
            let mut nearest = *bar as u32;
            for (lane, &distance) in distances.iter().enumerate() {
                if (distance as u32) < nearest {
                    visit(n, k * LANES + lane, distance as u32, &mut nearest);
                }
            }
            *bar = u64::from(nearest);
        }
    }
}

/// The same, told register by register: compilers prefer half of AVX-512's, and spill what the queries need.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512vpopcntdq")]
#[inline]
fn scan_avx512(queries: &[Descriptor; QUERIES], all: &[Block], from: u32, mut visit: impl FnMut(usize, usize, u32, &mut u32)) {
    use std::arch::x86_64::{
        __m512i, _mm512_add_epi64, _mm512_cmplt_epu64_mask, _mm512_loadu_si512, _mm512_popcnt_epi64, _mm512_set1_epi64,
        _mm512_setzero_si512, _mm512_storeu_si512, _mm512_xor_si512,
    };
    let mut words = [[_mm512_setzero_si512(); 4]; QUERIES];
    for (words, query) in words.iter_mut().zip(queries) {
        for (word, q) in words.iter_mut().zip(query.0) {
            *word = _mm512_set1_epi64(q as i64);
        }
    }
    let mut bars = [_mm512_set1_epi64(i64::from(from)); QUERIES];
    let mut bar_of = [from; QUERIES];
    for (k, block) in all.iter().enumerate() {
        let mut of_block = [_mm512_setzero_si512(); 4];
        for (of_block, words) in of_block.iter_mut().zip(&block.0) {
            // SAFETY: a row of the block is 64 bytes.
            *of_block = unsafe { _mm512_loadu_si512(words.as_ptr().cast::<__m512i>()) };
        }
        let mut distances = [_mm512_setzero_si512(); QUERIES];
        let mut nearer = [0; QUERIES];
        for n in 0..QUERIES {
            let [a, b, c, d] = [0, 1, 2, 3].map(|w| _mm512_popcnt_epi64(_mm512_xor_si512(of_block[w], words[n][w])));
            distances[n] = _mm512_add_epi64(_mm512_add_epi64(a, b), _mm512_add_epi64(c, d));
            nearer[n] = _mm512_cmplt_epu64_mask(distances[n], bars[n]);
        }
        if nearer == [0; QUERIES] {
            continue;
        }
        for n in 0..QUERIES {
            if nearer[n] == 0 {
                continue;
            }
            let mut lanes = [0u64; LANES];
            // SAFETY: as many bytes are written as the array has.
            unsafe { _mm512_storeu_si512(lanes.as_mut_ptr().cast::<__m512i>(), distances[n]) };
            while nearer[n] != 0 {
                let lane = nearer[n].trailing_zeros() as usize;
                nearer[n] &= nearer[n] - 1;
                if (lanes[lane] as u32) < bar_of[n] {
                    visit(n, k * LANES + lane, lanes[lane] as u32, &mut bar_of[n]);
                }
            }
            bars[n] = _mm512_set1_epi64(i64::from(bar_of[n]));
        }
    }
}

/// Bits in which a descriptor differs from each of a block.
#[inline(always)]
fn distances(query: &Descriptor, block: &Block) -> [u64; LANES] {
    let mut distances = [0u64; LANES];
    for (words, q) in block.0.iter().zip(query.0) {
        for (distance, word) in distances.iter_mut().zip(words) {
            *distance += u64::from((word ^ q).count_ones());
        }
    }
    distances
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
        fn wide_scan_equals_plain(
            queries in any::<[[u64; 4]; QUERIES]>(),
            all in proptest::collection::vec(any::<[u64; 4]>(), 0..50),
            from in 90..257u32,
        ) {
            let queries = queries.map(Descriptor);
            let descriptors: Vec<Descriptor> = all.into_iter().map(Descriptor).collect();
            let mut all = Vec::new();
            pack_into(descriptors.iter().copied(), &mut all);
            let run = |wide: bool| {
                let mut seen = Vec::new();
                let visit = |n: usize, k: usize, d: u32, bar: &mut u32| { seen.push((n, k, d)); *bar = (*bar).min(d + 10); };
                if wide { scan(&queries, &all, from, visit) } else { scan_plain(&queries, &all, from, visit) }
                seen
            };
            prop_assert_eq!(run(true), run(false));
            let mut all_seen = vec![u32::MAX; QUERIES * all.len() * LANES];
            scan(&queries, &all, from, |n, k, d, _| all_seen[n * all.len() * LANES + k] = d);
            for (n, query) in queries.iter().enumerate() {
                for (k, d) in descriptors.iter().enumerate() {
                    let distance = hamming(query, d);
                    prop_assert_eq!(all_seen[n * all.len() * LANES + k], if distance < from { distance } else { u32::MAX });
                }
            }
        }
    }

    #[test]
    fn distance_counts_bits() {
        assert_eq!(hamming(&Descriptor([0; 4]), &Descriptor([u64::MAX; 4])), 256);
        assert_eq!(hamming(&Descriptor([5, 0, 0, 0]), &Descriptor([0, 0, 0, 1])), 3);
    }
}
