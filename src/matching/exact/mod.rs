//! Exact matching of two pictures' descriptors: all pairs are compared.
//!
//! Three rules decide what is a match: the nearest descriptor; Lowe's ratio (2004, section 7.1) of
//! its distance to that of the nearest one elsewhere in the picture; and the mutual test, that the
//! nearest of the other is this one. Matches are sorted by ratio, best first, as PROSAC needs.

mod rival;

use nalgebra::{DMatrixView, DMatrixViewMut};
use rayon::prelude::*;

use crate::features::Descriptor;
use crate::features::two_views::{Descriptors, Features, Keypoint};
use crate::matching::kernels::{self, QUERIES};
use crate::matching::neighbours::Neighbours;
use crate::simd::multiversion;
use rival::Nearest;

/// Matching criteria.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExactOptions {
    /// Maximum ratio of the distance to that of the nearest descriptor elsewhere; 1 accepts all.
    /// Raised, there are more matches and more wrong ones.
    pub ratio: f32,
    /// Whether matching back from the second picture must return to the same keypoint.
    pub is_mutual: bool,
}

impl Default for ExactOptions {
    /// Lowe's ratio, and mutual.
    fn default() -> Self {
        Self { ratio: 0.8, is_mutual: true }
    }
}

/// A matched pair of keypoints from the first and the second picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExactMatch {
    /// Index into the first picture's keypoints.
    pub first: u32,
    /// Index into the second picture's keypoints.
    pub second: u32,
    /// Distance of the descriptors: Euclidean or Hamming.
    pub distance: f32,
    /// Distance divided by that of the nearest descriptor elsewhere.
    pub ratio: f32,
}

/// Keypoints of the second picture closer together than this, in sigmas of the larger, show the
/// same place and are not rivals. A keypoint with two orientations, or seen in two simulated views,
/// occurs twice. Raised, neighbours that could be confused stop being rivals too.
const SAME_PLACE: f64 = 0.8;
/// The same, between a keypoint and the one that the mutual test returns to. Raised, more matches
/// pass that test.
const SAME_PLACE_BACK: f64 = 1.0;

/// Matches two pictures' features, best ratio first; returns none if their descriptors are of
/// different kinds.
pub fn match_exactly(first: &Features, second: &Features, options: &ExactOptions) -> Vec<ExactMatch> {
    match_watched(first, second, options, &|| true).unwrap_or_default()
}

/// Like [`match_exactly`]. `goes_on` is called a few times a second; when it returns false, the
/// work stops and the result is `None`.
pub fn match_watched(first: &Features, second: &Features, options: &ExactOptions, goes_on: &dyn Fn() -> bool) -> Option<Vec<ExactMatch>> {
    let Some(Compared { forth, back }) = compared(first, second, goes_on)? else { return Some(Vec::new()) };
    let mut matches: Vec<ExactMatch> = Vec::new();
    for (k, nearest) in forth.iter().enumerate() {
        let Some(found) = nearest.filter(|n| n.ratio < options.ratio || options.ratio >= 1.0) else { continue };
        let returned = &first.keypoints[back[found.index]];
        if !options.is_mutual || back[found.index] == k || same_place(returned, &first.keypoints[k], SAME_PLACE_BACK) {
            matches.push(ExactMatch { first: k as u32, second: found.index as u32, distance: found.distance, ratio: found.ratio });
        }
    }
    matches.sort_by(|a, b| a.ratio.total_cmp(&b.ratio).then(a.first.cmp(&b.first)));
    Some(matches)
}

fn same_place(a: &Keypoint, b: &Keypoint, sigmas: f64) -> bool {
    let near = sigmas * a.scale().max(b.scale());
    (a.position - b.position).norm_squared() < near * near
}

/// The nearest descriptor of the other picture, with its ratio.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Found {
    index: usize,
    distance: f32,
    ratio: f32,
}

/// The result of comparing every descriptor of one picture with every one of the other.
struct Compared {
    /// For each of the first picture's, the nearest of the second's.
    forth: Vec<Option<Found>>,
    /// For each of the second picture's, the nearest of the first's.
    back: Vec<usize>,
}

/// Returns `Some(None)` if there is nothing to compare, `None` if the work was stopped.
fn compared(first: &Features, second: &Features, goes_on: &dyn Fn() -> bool) -> Option<Option<Compared>> {
    if first.keypoints.is_empty() || second.keypoints.is_empty() {
        return goes_on().then_some(None);
    }
    match (&first.descriptors, &second.descriptors) {
        (Descriptors::Vectors { length: n, values: a }, Descriptors::Vectors { length: m, values: b }) if n == m && *n > 0 => {
            compared_vectors(a, b, *n, &second.keypoints, goes_on).map(Some)
        }
        // Bits are compared so fast that checking in between suffices.
        (Descriptors::Bits(a), Descriptors::Bits(b)) => {
            let back = goes_on().then(|| nearest_bits(b, a, None))?;
            let back = back.into_iter().map(|found| found.map_or(0, |found| found.index)).collect();
            let forth = goes_on().then(|| nearest_bits(a, b, Some(&second.keypoints)))?;
            Some(Some(Compared { forth, back }))
        }
        _ => Some(None),
    }
}

/// Number of queries a thread takes at a time, a chunk; the nearest of them is stored per target:
/// some megabytes for the largest pictures. Raised, threads wait for each other at the end;
/// lowered, more is stored.
const QUERIES_PER_CHUNK: usize = 256;
/// Number of targets multiplied with a chunk's queries at once. Raised, the products (256 kB) no
/// longer fit the second-level cache; lowered, the queries are read more often.
const TARGETS: usize = 256;
/// Chunks between two calls of `goes_on`, over all threads: a quarter of a second for some ten
/// thousand vectors of 128 on one thread. Raised, an interrupt takes longer; lowered, threads wait
/// for each other more often.
const CHUNKS_PER_CALL: usize = 8;

/// The query nearest to one target: the query-dependent part of the distance, and its index.
type NearestQuery = (f32, u32);

/// Returns `None` if the work was stopped.
fn compared_vectors(queries: &[f32], targets: &[f32], length: usize, places: &[Keypoint], goes_on: &dyn Fn() -> bool) -> Option<Compared> {
    let squares = squares_of(targets, length);
    let compare = |(chunk, queries): (usize, &[f32])| {
        let mut asked = Queries::new(queries, length);
        let count = asked.own.len();
        let mut back: Vec<NearestQuery> = Vec::with_capacity(squares.len());
        // The product is fast if neither factor needs transposing.
        let rows = DMatrixView::from_slice(queries, length, count).transpose();
        let mut products = vec![0.0; count * TARGETS.min(squares.len())];
        for targets in targets.chunks(TARGETS * length) {
            let columns = DMatrixView::from_slice(targets, length, targets.len() / length);
            DMatrixViewMut::from_slice(&mut products, count, columns.ncols()).gemm(1.0, &rows, &columns, 0.0);
            for products in products.chunks_exact(count).take(columns.ncols()) {
                let k = back.len();
                let (least, query) = asked.take(k, squares[k], products, places);
                back.push((least, (chunk * QUERIES_PER_CHUNK + query) as u32));
            }
        }
        let answers = queries.chunks_exact(length).zip(asked.nearest);
        (answers.map(|(query, nearest)| found(query, targets, places, nearest)).collect(), back)
    };
    let mut back = vec![(f32::INFINITY, 0); squares.len()];
    let mut forth = Vec::with_capacity(queries.len() / length);
    let all: Vec<(usize, &[f32])> = queries.chunks(QUERIES_PER_CHUNK * length).enumerate().collect();
    for some in all.chunks(CHUNKS_PER_CALL) {
        if !goes_on() {
            return None;
        }
        let compared: Vec<(Vec<Option<Found>>, Vec<NearestQuery>)> = some.par_iter().copied().map(compare).collect();
        for (nearest, of_chunk) in compared {
            forth.extend(nearest);
            // Chunks come in query order, so ties keep the first.
            back.iter_mut().zip(of_chunk).filter(|(best, other)| other.0 < best.0).for_each(|(best, other)| *best = other);
        }
    }
    Some(Compared { forth, back: back.into_iter().map(|(_, index)| index as usize).collect() })
}

fn squares_of(vectors: &[f32], length: usize) -> Vec<f32> {
    vectors.chunks_exact(length).map(|vector| vector.iter().map(|v| v * v).sum()).collect()
}

/// The queries of a chunk, with their nearest targets so far.
struct Queries {
    /// Their squared norms.
    own: Vec<f32>,
    nearest: Vec<Nearest>,
    /// The distance each one's candidates must beat: contiguous, since all are checked for each
    /// target.
    bars: Vec<f32>,
}

impl Queries {
    fn new(queries: &[f32], length: usize) -> Self {
        let own = squares_of(queries, length);
        Self { nearest: vec![Nearest::default(); own.len()], bars: vec![f32::INFINITY; own.len()], own }
    }

    /// Processes target `k`, given its squared norm and its products with all queries. Returns the
    /// nearest query, with the query-dependent part of the distance; infinity if all products are
    /// NaN.
    fn take(&mut self, k: usize, square: f32, products: &[f32], places: &[Keypoint]) -> (f32, usize) {
        let Self { own, nearest, bars } = self;
        // Squared distances, each without the square that is common to all compared.
        let (is_any_below, least) = scan(products, square, bars, own);
        if is_any_below {
            for ((nearest, bar), product) in nearest.iter_mut().zip(bars).zip(products) {
                nearest.offer(k, square - 2.0 * product, |a, b| same_place(&places[a], &places[b], SAME_PLACE));
                *bar = nearest.bar();
            }
        }
        let query = own.iter().zip(products).position(|(own, product)| own - 2.0 * product == least);
        (least, query.unwrap_or(0))
    }
}

/// Builds the result for one query; searches the rival again if it may have been missed.
fn found(query: &[f32], targets: &[f32], places: &[Keypoint], nearest: Nearest) -> Option<Found> {
    let length = query.len();
    // Squaring differences here rounds less than products of large vectors do.
    let distance = |k: usize| query.iter().zip(&targets[k * length..]).map(|(a, b)| (a - b) * (a - b)).sum::<f32>().sqrt();
    let (_, best) = nearest.best()?;
    let elsewhere = |k: &usize| !same_place(&places[best], &places[*k], SAME_PLACE);
    let rival = if nearest.may_miss_rival() {
        (0..places.len()).filter(elsewhere).map(distance).min_by(f32::total_cmp)
    } else {
        nearest.rival().map(|(_, k)| distance(k))
    };
    let own = distance(best);
    // Two exact copies are rivals: 0 / 0 counts as 1.
    let ratio = rival.map_or(NO_RIVAL, |rival| if rival > 0.0 { own / rival } else { 1.0 });
    own.is_finite().then_some(Found { index: best, distance: own, ratio })
}

/// Ratio assigned to a match without any rival: it may pass, but ranks below clear winners.
const NO_RIVAL: f32 = 0.5;

/// Finds the nearest target of each query, and its rival if places are given.
fn nearest_bits(queries: &[Descriptor], targets: &[Descriptor], places: Option<&[Keypoint]>) -> Vec<Option<Found>> {
    let mut blocks = Vec::new();
    kernels::pack_into(targets.iter().copied(), &mut blocks);
    let is_same = |a: usize, b: usize| places.is_none_or(|places| same_place(&places[a], &places[b], SAME_PLACE));
    let found = |neighbours: &Neighbours, n: usize| {
        let (own, best) = neighbours.nearest(n)?;
        let mut rival = None;
        neighbours.visit_nearer(n, u32::MAX, |k, distance| {
            rival = if is_same(best, k) { rival } else { Some(distance) };
            rival.unwrap_or(u32::MAX)
        });
        // Adding one to both makes two exact copies rivals (0 / 0).
        let ratio = rival.map_or(NO_RIVAL, |rival| (own + 1) as f32 / (rival + 1) as f32);
        Some(Found { index: best, distance: own as f32, ratio })
    };
    let group = |queries: &[Descriptor; QUERIES]| {
        let neighbours = Neighbours::of(queries, &blocks, targets.len());
        std::array::from_fn::<_, QUERIES, _>(|n| found(&neighbours, n))
    };
    let mut groups = Vec::new();
    kernels::group_into(queries.iter().copied(), &mut groups);
    let groups: Vec<_> = groups.par_iter().map(group).collect();
    groups.into_iter().flatten().take(queries.len()).collect()
}

multiversion! {
    /// For one target's products with many queries, returns whether any squared distance, without
    /// the query's own square, is below the query's bar; and the smallest one, without the target's
    /// `square`.
    fn scan(products: &[f32], square: f32, bars: &[f32], own: &[f32]) -> (bool, f32); ["avx2"] => scan_lanes, else scan_lanes
}

/// Numbers processed side by side: the lanes of two registers.
const LANES: usize = 16;

#[inline(always)]
fn scan_lanes(products: &[f32], square: f32, bars: &[f32], own: &[f32]) -> (bool, f32) {
    let mut below = [false; LANES];
    let mut least = [f32::INFINITY; LANES];
    for ((products, bars), own) in products.chunks(LANES).zip(bars.chunks(LANES)).zip(own.chunks(LANES)) {
        for (((product, bar), own), (below, least)) in products.iter().zip(bars).zip(own).zip(below.iter_mut().zip(&mut least)) {
            *below |= square - 2.0 * product < *bar;
            let from_here = own - 2.0 * product;
            // Written so that a NaN product is never the minimum.
            *least = if from_here < *least { from_here } else { *least };
        }
    }
    (below.contains(&true), least.into_iter().fold(f32::INFINITY, f32::min))
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    fn vectors(n: usize, length: usize, seed: u64) -> Features {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let keypoints =
            (0..n).map(|_| Keypoint::round(Vector2::new(rng.random_range(0.0..40.0), rng.random_range(0.0..40.0)), 1.5, 1.0)).collect();
        Features { keypoints, descriptors: Descriptors::Vectors { length, values: (0..n * length).map(|_| rng.random()).collect() } }
    }

    /// All distances one by one, with the rules written out.
    fn plain(first: &Features, second: &Features, options: &ExactOptions) -> Vec<(u32, u32, f32)> {
        let distance = |a: usize, b: usize| match (&first.descriptors, &second.descriptors) {
            (Descriptors::Vectors { length: n, values: p }, Descriptors::Vectors { values: q, .. }) => {
                (0..*n).map(|k| (p[a * n + k] - q[b * n + k]).powi(2)).sum::<f32>().sqrt()
            }
            (Descriptors::Bits(p), Descriptors::Bits(q)) => p[a].distance(&q[b]) as f32,
            _ => f32::NAN,
        };
        let one = if matches!(first.descriptors, Descriptors::Bits(_)) { 1.0 } else { 0.0 };
        let (n, m) = (first.keypoints.len(), second.keypoints.len());
        let mut found = Vec::new();
        for a in 0..n {
            let best = (0..m).min_by(|p, q| distance(a, *p).total_cmp(&distance(a, *q))).unwrap();
            let elsewhere = (0..m).filter(|k| !same_place(&second.keypoints[best], &second.keypoints[*k], SAME_PLACE));
            let rival = elsewhere.map(|k| distance(a, k)).min_by(f32::total_cmp);
            let ratio = rival.map_or(NO_RIVAL, |r| (distance(a, best) + one) / (r + one));
            let back = (0..n).min_by(|p, q| distance(*p, best).total_cmp(&distance(*q, best))).unwrap();
            let returns = back == a || same_place(&first.keypoints[back], &first.keypoints[a], SAME_PLACE_BACK);
            if ratio < options.ratio && (returns || !options.is_mutual) {
                found.push((a as u32, best as u32, ratio));
            }
        }
        found.sort_by(|a, b| a.2.total_cmp(&b.2));
        found
    }

    fn same(first: &Features, second: &Features) {
        for is_mutual in [false, true] {
            let options = ExactOptions { ratio: 0.97, is_mutual };
            let mut expected: Vec<_> = plain(first, second, &options).iter().map(|m| (m.0, m.1)).collect();
            let found = match_exactly(first, second, &options);
            assert!(found.windows(2).all(|w| w[0].ratio <= w[1].ratio));
            let mut found: Vec<_> = found.iter().map(|m| (m.first, m.second)).collect();
            expected.sort_unstable();
            found.sort_unstable();
            assert!(expected.len() > 5, "{}", expected.len());
            assert_eq!(found, expected);
        }
    }

    /// Thesis error E12: the source keeps a stale second best, so its ratio test accepts too much.
    #[test]
    fn e12_the_second_nearest_neighbour_is_exact() {
        for seed in 0..20 {
            same(&vectors(60, 13, seed), &vectors(80, 13, seed + 100));
            let bits = |seed| {
                let mut rng = Pcg64Mcg::seed_from_u64(seed);
                Features { descriptors: Descriptors::Bits((0..80).map(|_| Descriptor(rng.random())).collect()), ..vectors(80, 1, seed) }
            };
            same(&bits(seed), &bits(seed + 100));
        }
    }

    /// More than one chunk holds, and more than are multiplied at once.
    #[test]
    fn large_sets_match_the_same_as_small_ones() {
        for length in [3, 8, 64, 129] {
            same(&vectors(QUERIES_PER_CHUNK + 37, length, 1), &vectors(2 * TARGETS + 1, length, 2));
        }
    }

    #[test]
    fn only_a_distant_look_alike_blocks_a_match() {
        let query = vectors(1, 32, 1);
        let both = |shift: f64| {
            let Descriptors::Vectors { length, values } = &query.descriptors else { unreachable!("vectors") };
            let place = query.keypoints[0];
            let other = Keypoint { position: place.position + Vector2::new(shift, 0.0), ..place };
            Features { keypoints: vec![place, other], descriptors: Descriptors::Vectors { length: *length, values: values.repeat(2) } }
        };
        assert_eq!(match_exactly(&query, &both(0.3), &ExactOptions::default()).len(), 1);
        assert_eq!(match_exactly(&query, &both(30.0), &ExactOptions::default()).len(), 0);
    }

    #[test]
    fn incomparable_descriptors_yield_no_match() {
        let none = Features { keypoints: Vec::new(), descriptors: Descriptors::Bits(Vec::new()) };
        for (a, b) in [(&vectors(5, 8, 1), &vectors(5, 9, 2)), (&none, &vectors(5, 8, 1)), (&vectors(5, 8, 1), &none)] {
            assert_eq!(match_exactly(a, b, &ExactOptions::default()), Vec::new());
        }
        let mut holed = vectors(5, 8, 3);
        if let Descriptors::Vectors { values, .. } = &mut holed.descriptors {
            values.fill(f32::NAN);
        }
        assert_eq!(match_exactly(&holed, &holed, &ExactOptions::default()), Vec::new());
    }
}
