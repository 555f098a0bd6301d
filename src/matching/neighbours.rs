//! Finds neighbours among binary descriptors without checking most of them individually.
//!
//! The distances from four queries to all descriptors are computed in registers, keeping only the
//! minimum for each piece of a few dozen descriptors. Each question is then answered from the few
//! pieces that matter. Most frame features match nothing, which the first rival already shows.

use super::kernels::{self, Block, LANES, LeastDistances, QUERIES};
use crate::features::Descriptor;

/// The neighbours of some queries among packed descriptors.
pub(super) struct Neighbours<'a> {
    queries: &'a [Descriptor; QUERIES],
    blocks: &'a [Block],
    /// Number of packed descriptors.
    count: usize,
    piece_blocks: usize,
    least: [LeastDistances; QUERIES],
}

impl<'a> Neighbours<'a> {
    /// Compares the queries with `count` packed descriptors.
    pub fn of(queries: &'a [Descriptor; QUERIES], blocks: &'a [Block], count: usize) -> Self {
        let (piece_blocks, mut least) = (kernels::piece_blocks(blocks.len()), [LeastDistances::NONE; QUERIES]);
        kernels::least_distances(queries, blocks, piece_blocks, &mut least);
        Self { queries, blocks, count, piece_blocks, least }
    }

    /// Returns distance and index of the descriptor nearest to a query, the first on ties; `None`
    /// if there are none.
    pub fn nearest(&self, query: usize) -> Option<(u32, usize)> {
        let (distance, piece) = self.least[query].nearest;
        let mut nearest = None;
        self.visit_piece(query, piece, u32::from(distance) + 1, |k, distance| {
            nearest = Some((distance, k));
            0
        });
        nearest
    }

    /// Calls `visit(index, distance)` for every descriptor nearer to a query than `bar`, in order;
    /// its return value becomes the new bar.
    pub fn visit_nearer(&self, query: usize, mut bar: u32, mut visit: impl FnMut(usize, u32) -> u32) {
        let pieces = self.blocks.len().div_ceil(self.piece_blocks);
        for (piece, least) in self.least[query].to_piece[..pieces].iter().enumerate() {
            if u32::from(*least) < bar {
                bar = self.visit_piece(query, piece, bar, &mut visit);
            }
        }
    }

    /// The same for one piece; returns the last bar.
    fn visit_piece(&self, query: usize, piece: usize, mut bar: u32, mut visit: impl FnMut(usize, u32) -> u32) -> u32 {
        let blocks = self.blocks.chunks(self.piece_blocks).nth(piece).unwrap_or_default();
        let (first, first_bar) = (piece * self.piece_blocks * LANES, bar);
        kernels::visit_nearer(&self.queries[query], blocks, first_bar, |k, distance| {
            // The last block is padded.
            if first + k < self.count {
                bar = visit(first + k, distance);
            }
            bar
        });
        bar
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    #[test]
    fn nearest_neighbours_equal_a_full_search() {
        let mut random = Pcg64Mcg::seed_from_u64(3);
        for count in [1, 7, 8, 9, 63, 64, 65, 300, 2300] {
            // Few bits differ, so that many distances are equal.
            let mut near = || Descriptor(std::array::from_fn(|_| random.random::<u64>() & random.random::<u64>() & random.random::<u64>()));
            let all: Vec<Descriptor> = (0..count).map(|_| near()).collect();
            let queries: [Descriptor; QUERIES] = std::array::from_fn(|_| near());
            let mut blocks = Vec::new();
            kernels::pack_into(all.iter().copied(), &mut blocks);
            let neighbours = Neighbours::of(&queries, &blocks, count);
            for (n, query) in queries.iter().enumerate() {
                let distance = |k: usize| query.distance(&all[k]);
                let nearest = (0..count).min_by_key(|k| distance(*k)).map(|k| (distance(k), k));
                assert_eq!(neighbours.nearest(n), nearest, "of {count}");
                let mut seen = Vec::new();
                neighbours.visit_nearer(n, 60, |k, distance| {
                    seen.push((k, distance));
                    60
                });
                assert_eq!(seen, (0..count).map(|k| (k, distance(k))).filter(|(_, d)| *d < 60).collect::<Vec<_>>(), "of {count}");
            }
        }
        assert_eq!(Neighbours::of(&Default::default(), &[], 0).nearest(0), None);
    }
}
