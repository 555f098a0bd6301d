//! Hamming distances of binary descriptors, eight at a time: plain functions, also compiled for
//! wider registers if the processor has them (detected at run time).

use crate::features::Descriptor;
use crate::simd::multiversion;

/// Descriptors compared side by side: one AVX-512 register of 64-bit words.
pub const LANES: usize = 8;

/// Eight descriptors, word by word, so that one register holds the same word of all.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Block(pub [[u64; LANES]; 4]);

/// Packs descriptors into blocks. The last block is padded with copies of the last descriptor,
/// which are never nearer than the original.
pub fn pack_into(all: impl Iterator<Item = Descriptor>, blocks: &mut Vec<Block>) {
    blocks.clear();
    for (k, d) in all.enumerate() {
        if k % LANES == 0 {
            blocks.push(Block(d.0.map(|word| [word; LANES])));
        }
        if let Some(block) = blocks.last_mut() {
            for (words, word) in block.0.iter_mut().zip(d.0) {
                words[k % LANES..].fill(word);
            }
        }
    }
}

/// Groups items that are compared together; the last group is padded with defaults.
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

/// Number of queries compared with the packed descriptors at once. A set of views exceeds the
/// nearest cache, so each block is fetched once for all of them. Chosen: their words fill half of
/// the AVX-512 registers; raised, they no longer fit.
pub const QUERIES: usize = 4;

/// Maximum number of pieces of the packed descriptors. Raised, less is compared twice, and more is
/// stored per query.
pub const PIECES: usize = 256;
/// Minimum number of blocks per piece. Chosen: the minimum over a piece's distances then takes a
/// tenth of the time of computing them. Raised, more is compared twice.
const MIN_PIECE_BLOCKS: usize = 8;

/// Returns the number of blocks per piece for `blocks` in all.
pub fn piece_blocks(blocks: usize) -> usize {
    blocks.div_ceil(PIECES).max(MIN_PIECE_BLOCKS)
}

/// The minimum distances of a query.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LeastDistances {
    /// Overall minimum, and the first piece that has it; above 256 means none yet.
    pub nearest: (u16, usize),
    /// Minimum for each piece.
    pub to_piece: [u16; PIECES],
}

impl LeastDistances {
    /// Initial value, before any comparison.
    pub const NONE: Self = Self { nearest: (u16::MAX, 0), to_piece: [u16::MAX; PIECES] };

    #[inline(always)]
    fn note(&mut self, piece: usize, distance: u16) {
        self.to_piece[piece] = distance;
        if distance < self.nearest.0 {
            self.nearest = (distance, piece);
        }
    }
}

multiversion! {
    /// Stores each query's minimum distance to each piece of `piece_blocks` blocks; the last piece
    /// may be shorter.
    pub fn least_distances(queries: &[Descriptor; QUERIES], all: &[Block], piece_blocks: usize, least: &mut [LeastDistances; QUERIES]);
    ["avx512f" "avx512vpopcntdq"] => least_distances_avx512, else least_distances_avx2
}

multiversion! {
    fn least_distances_avx2(queries: &[Descriptor; QUERIES], all: &[Block], piece_blocks: usize, least: &mut [LeastDistances; QUERIES]);
    ["avx2" "popcnt"] => least_distances_plain, else least_distances_plain
}

/// The plain twin of [`least_distances`].
#[inline(always)]
fn least_distances_plain(queries: &[Descriptor; QUERIES], all: &[Block], piece_blocks: usize, least: &mut [LeastDistances; QUERIES]) {
    for (k, piece) in all.chunks(piece_blocks).enumerate() {
        let mut lanes = [[u64::MAX; LANES]; QUERIES];
        for block in piece {
            for (lanes, query) in lanes.iter_mut().zip(queries) {
                for (lane, distance) in lanes.iter_mut().zip(distances(query, block)) {
                    *lane = distance.min(*lane);
                }
            }
        }
        for (least, lanes) in least.iter_mut().zip(lanes) {
            // At most 256.
            least.note(k, lanes.iter().fold(u64::MAX, |least, lane| least.min(*lane)) as u16);
        }
    }
}

/// The same with explicit registers: compilers use only half-width AVX-512 registers and spill the
/// queries.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512vpopcntdq")]
#[inline]
fn least_distances_avx512(queries: &[Descriptor; QUERIES], all: &[Block], piece_blocks: usize, least: &mut [LeastDistances; QUERIES]) {
    use std::arch::x86_64::{
        __m512i, _mm512_add_epi64, _mm512_loadu_si512, _mm512_min_epu64, _mm512_popcnt_epi64, _mm512_reduce_min_epu64, _mm512_set1_epi64,
        _mm512_setzero_si512, _mm512_xor_si512,
    };
    let mut words = [[_mm512_setzero_si512(); 4]; QUERIES];
    for (words, query) in words.iter_mut().zip(queries) {
        for (word, q) in words.iter_mut().zip(query.0) {
            *word = _mm512_set1_epi64(q as i64);
        }
    }
    for (k, piece) in all.chunks(piece_blocks).enumerate() {
        let mut lanes = [_mm512_set1_epi64(-1); QUERIES];
        for block in piece {
            let mut of_block = [_mm512_setzero_si512(); 4];
            for (of_block, words) in of_block.iter_mut().zip(&block.0) {
                // SAFETY: a row of the block is 64 bytes.
                *of_block = unsafe { _mm512_loadu_si512(words.as_ptr().cast::<__m512i>()) };
            }
            for n in 0..QUERIES {
                let [a, b, c, d] = [0, 1, 2, 3].map(|w| _mm512_popcnt_epi64(_mm512_xor_si512(of_block[w], words[n][w])));
                let distances = _mm512_add_epi64(_mm512_add_epi64(a, b), _mm512_add_epi64(c, d));
                lanes[n] = _mm512_min_epu64(lanes[n], distances);
            }
        }
        for n in 0..QUERIES {
            // At most 256.
            least[n].note(k, _mm512_reduce_min_epu64(lanes[n]) as u16);
        }
    }
}

multiversion! {
    /// Calls `visit(index, distance)` for every packed descriptor nearer to a query than `bar`, in
    /// order; its return value becomes the new bar.
    pub fn visit_nearer(query: &Descriptor, all: &[Block], bar: u32, visit: impl FnMut(usize, u32) -> u32);
    ["avx512f" "avx512vpopcntdq"] => visit_nearer_avx512, else visit_nearer_avx2
}

multiversion! {
    fn visit_nearer_avx2(query: &Descriptor, all: &[Block], bar: u32, visit: impl FnMut(usize, u32) -> u32);
    ["avx2" "popcnt"] => visit_nearer_plain, else visit_nearer_plain
}

/// The plain twin of [`visit_nearer`].
#[inline(always)]
fn visit_nearer_plain(query: &Descriptor, all: &[Block], mut bar: u32, mut visit: impl FnMut(usize, u32) -> u32) {
    for (k, block) in all.iter().enumerate() {
        let distances = distances(query, block);
        if distances.iter().fold(u64::MAX, |least, d| least.min(*d)) >= u64::from(bar) {
            continue;
        }
        for (lane, &distance) in distances.iter().enumerate() {
            if (distance as u32) < bar {
                bar = visit(k * LANES + lane, distance as u32);
            }
        }
    }
}

/// The same with explicit registers: compilers do not use the comparison mask that shows which
/// lanes are nearer.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512vpopcntdq")]
#[inline]
fn visit_nearer_avx512(query: &Descriptor, all: &[Block], mut bar: u32, mut visit: impl FnMut(usize, u32) -> u32) {
    use std::arch::x86_64::{
        __m512i, _mm512_add_epi64, _mm512_cmplt_epu64_mask, _mm512_loadu_si512, _mm512_popcnt_epi64, _mm512_set1_epi64,
        _mm512_setzero_si512, _mm512_storeu_si512, _mm512_xor_si512,
    };
    let words = query.0.map(|word| _mm512_set1_epi64(word as i64));
    for (k, block) in all.iter().enumerate() {
        let mut distances = _mm512_setzero_si512();
        for (words, of_block) in words.iter().zip(&block.0) {
            // SAFETY: a row of the block is 64 bytes.
            let of_block = unsafe { _mm512_loadu_si512(of_block.as_ptr().cast::<__m512i>()) };
            distances = _mm512_add_epi64(distances, _mm512_popcnt_epi64(_mm512_xor_si512(of_block, *words)));
        }
        let mut nearer = _mm512_cmplt_epu64_mask(distances, _mm512_set1_epi64(i64::from(bar)));
        if nearer == 0 {
            continue;
        }
        let mut lanes = [0u64; LANES];
        // SAFETY: as many bytes are written as the array has.
        unsafe { _mm512_storeu_si512(lanes.as_mut_ptr().cast::<__m512i>(), distances) };
        while nearer != 0 {
            let lane = nearer.trailing_zeros() as usize;
            nearer &= nearer - 1;
            if (lanes[lane] as u32) < bar {
                bar = visit(k * LANES + lane, lanes[lane] as u32);
            }
        }
    }
}

/// Number of bits in which a descriptor differs from each of a block.
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

    fn packed(descriptors: &[Descriptor]) -> Vec<Block> {
        let mut all = Vec::new();
        pack_into(descriptors.iter().copied(), &mut all);
        all
    }

    proptest! {
        #[test]
        fn minimum_distances_match_the_plain_implementation(
            queries in any::<[[u64; 4]; QUERIES]>(),
            all in proptest::collection::vec(any::<[u64; 4]>(), 1..90),
            piece_blocks in 1usize..5,
        ) {
            let (queries, descriptors) = (queries.map(Descriptor), all.into_iter().map(Descriptor).collect::<Vec<_>>());
            let all = packed(&descriptors);
            let (mut wide, mut plain) = ([LeastDistances::NONE; QUERIES], [LeastDistances::NONE; QUERIES]);
            least_distances(&queries, &all, piece_blocks, &mut wide);
            least_distances_plain(&queries, &all, piece_blocks, &mut plain);
            prop_assert!(wide == plain);
            for (n, query) in queries.iter().enumerate() {
                for (k, piece) in descriptors.chunks(piece_blocks * LANES).enumerate() {
                    prop_assert_eq!(piece.iter().map(|d| query.distance(d)).min(), Some(u32::from(wide[n].to_piece[k])));
                }
                let (least, piece) = wide[n].nearest;
                prop_assert_eq!(Some(piece), wide[n].to_piece.iter().position(|distance| *distance == least));
                prop_assert_eq!(Some(&least), wide[n].to_piece.iter().min());
            }
        }

        #[test]
        fn every_descriptor_below_the_bar_is_visited(
            query in any::<[u64; 4]>(),
            all in proptest::collection::vec(any::<[u64; 4]>(), 0..50),
            bar in 90..257u32,
            lowers in any::<bool>(),
        ) {
            let (query, descriptors) = (Descriptor(query), all.into_iter().map(Descriptor).collect::<Vec<_>>());
            let all = packed(&descriptors);
            let run = |is_wide: bool| {
                let mut seen = Vec::new();
                let visit = |k: usize, d: u32| {
                    seen.push((k, d));
                    if lowers { d } else { bar }
                };
                if is_wide { visit_nearer(&query, &all, bar, visit) } else { visit_nearer_plain(&query, &all, bar, visit) }
                seen.retain(|(k, _)| *k < descriptors.len());
                seen
            };
            let (mut expected, mut below) = (Vec::new(), bar);
            for (k, distance) in descriptors.iter().map(|d| query.distance(d)).enumerate().filter(|(_, d)| *d < bar) {
                if distance < below {
                    expected.push((k, distance));
                    below = if lowers { distance } else { bar };
                }
            }
            prop_assert_eq!(run(true), expected.clone());
            prop_assert_eq!(run(false), expected);
        }
    }

    #[test]
    fn distance_counts_bits() {
        assert_eq!(Descriptor([0; 4]).distance(&Descriptor([u64::MAX; 4])), 256);
        assert_eq!(Descriptor([5, 0, 0, 0]).distance(&Descriptor([0, 0, 0, 1])), 3);
    }

    #[test]
    fn the_number_of_pieces_is_bounded() {
        for blocks in [0_usize, 1, 8, 9, 2048, 2049, 100_000] {
            assert!(blocks.div_ceil(piece_blocks(blocks)) <= PIECES, "{blocks}");
        }
    }
}
