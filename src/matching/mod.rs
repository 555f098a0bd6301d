//! Matches features of the frame with features of the reference pictures.
//!
//! Brute force over binary descriptors: the two nearest by Hamming distance, Lowe's ratio between
//! the nearest and the nearest elsewhere, and the mutual test. Dark corners are compared only with
//! dark ones and bright with bright, which halves the work. Matches are sorted best first, as
//! PROSAC needs.
//!
//! `exact` matches the features of any two pictures; only the feature `two-views` compiles it.

#[cfg(feature = "two-views")]
pub mod exact;
mod kernels;
mod neighbours;

use nalgebra::{Matrix2, Vector2};

use crate::features::{Descriptor, Feature, Polarity, Workers};
use kernels::QUERIES;
use neighbours::Neighbours;

/// A described corner of a reference picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReferenceFeature {
    /// The surface it lies on.
    pub surface: u32,
    /// Position in artwork pixels of that surface.
    pub position: Vector2<f64>,
    /// Artwork pixels per pixel of the pyramid level it was found on.
    pub scale: f64,
    /// Map from its descriptor's axes, in pixels of that level, to the artwork's.
    pub shape: Matrix2<f64>,
    /// Whether it is dark or bright.
    pub polarity: Polarity,
}

/// All reference features, with their descriptors.
#[derive(Debug, Clone, Default)]
pub struct ReferenceIndex {
    features: Vec<ReferenceFeature>,
    descriptors: Vec<Descriptor>,
    /// The dark and the bright ones, in the order of [`Polarity::ALL`].
    halves: [Half; 2],
}

/// The entries of one polarity.
#[derive(Debug, Clone, Default)]
struct Half {
    /// Their indices in the whole index.
    entries: Vec<usize>,
    /// Their places, contiguous in memory because rivals are accessed randomly.
    places: Vec<Place>,
    /// Their packed descriptors.
    blocks: Vec<kernels::Block>,
}

/// Place of an entry.
#[derive(Debug, Clone, Copy)]
struct Place {
    /// Position, artwork pixels.
    position: [f32; 2],
    /// Artwork pixels per pixel of the level it was found on.
    scale: f32,
    surface: u32,
}

impl Place {
    fn of(feature: &ReferenceFeature) -> Self {
        Self { position: [feature.position.x as f32, feature.position.y as f32], scale: feature.scale as f32, surface: feature.surface }
    }

    /// Whether another entry shows the same place, so that the two are not rivals.
    fn is_same(&self, other: &Self) -> bool {
        let near = 6.0 * self.scale.max(other.scale);
        let [x, y] = [self.position[0] - other.position[0], self.position[1] - other.position[1]];
        self.surface == other.surface && x * x + y * y < near * near
    }
}

/// A pair that passed the ratio test and the mutual test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Match {
    /// Index into the frame's features.
    pub frame: u32,
    /// Index into the reference index.
    pub reference: u32,
    /// Hamming distance divided by the rival's; lower is better.
    pub ratio: f32,
}

/// Reusable buffers of the matcher.
#[derive(Debug, Clone, Default)]
pub struct MatchBuffers {
    queries: Vec<[Descriptor; QUERIES]>,
    found: Vec<[Option<NearestEntry>; QUERIES]>,
    nearest_queries: Vec<[Descriptor; QUERIES]>,
    back: Vec<[usize; QUERIES]>,
    /// The frame's features of one polarity: their indices and packed descriptors.
    numbers: Vec<usize>,
    frame: Vec<kernels::Block>,
}

/// Maximum Hamming distance of a match: random pairs are around 128 +- 8, so this is six sigma
/// below. Raised, random matches pass the ratio test more often; lowered, matches under blur and
/// steep angles are lost.
const MAX_DISTANCE: u32 = 80;
/// Maximum distance considered for rivals; farther ones count as this far. It changes no decision:
/// at [`MAX_DISTANCE`] the ratio is then 0.85. Raised, more entries must be checked one by one;
/// lowered, weak matches pass the ratio test.
const FARTHEST_RIVAL: u32 = 95;

/// An entry that passed the ratio test.
#[derive(Debug, Clone, Copy)]
struct NearestEntry {
    /// Its index.
    entry: usize,
    /// See [`Match::ratio`].
    ratio: f32,
}

impl ReferenceIndex {
    /// Adds the features of a surface; `transform` maps a feature's position to artwork pixels.
    pub fn add(&mut self, surface: u32, features: &[Feature], transform: impl Fn(Vector2<f64>) -> Vector2<f64>, artwork_scale: f64) {
        self.add_views(surface, std::iter::once((features, Matrix2::identity() * artwork_scale)), transform);
    }

    /// Like [`add`](Self::add) for several views of a surface, each with the map from its shapes to
    /// the artwork's. Along the direction that a view compresses, that map scales to the artwork's
    /// full size; along the other by less (`TiltedViews::shape_in_picture`).
    pub fn add_views<'a>(
        &mut self,
        surface: u32,
        views: impl Iterator<Item = (&'a [Feature], Matrix2<f64>)>,
        transform: impl Fn(Vector2<f64>) -> Vector2<f64>,
    ) {
        for (features, shape) in views {
            let scale = shape.column(0).norm();
            for f in features {
                let position = transform(f.position);
                self.features.push(ReferenceFeature {
                    surface,
                    position,
                    scale: f.scale * scale,
                    shape: shape * f.shape(),
                    polarity: f.polarity,
                });
                self.descriptors.push(f.descriptor);
            }
        }
        self.pack();
    }

    /// Replaces its features by those of another index whose surfaces are wanted, keeping their
    /// order.
    pub fn take_from(&mut self, other: &Self, is_wanted: impl Fn(u32) -> bool) {
        self.features.clear();
        self.descriptors.clear();
        for (feature, descriptor) in other.features.iter().zip(&other.descriptors).filter(|(f, _)| is_wanted(f.surface)) {
            self.features.push(*feature);
            self.descriptors.push(*descriptor);
        }
        self.pack();
    }

    fn pack(&mut self) {
        for (half, polarity) in self.halves.iter_mut().zip(Polarity::ALL) {
            half.entries.clear();
            half.entries.extend((0..self.features.len()).filter(|k| self.features[*k].polarity == polarity));
            half.places.clear();
            half.places.extend(half.entries.iter().map(|k| Place::of(&self.features[*k])));
            kernels::pack_into(half.entries.iter().map(|k| self.descriptors[*k]), &mut half.blocks);
        }
    }

    /// Returns the features, by index.
    pub fn features(&self) -> &[ReferenceFeature] {
        &self.features
    }

    /// Returns each query's nearest entry of a half, if it passes the ratio test.
    fn nearest(half: &Half, queries: &[Descriptor; QUERIES], ratio: f32) -> [Option<NearestEntry>; QUERIES] {
        let neighbours = Neighbours::of(queries, &half.blocks, half.entries.len());
        std::array::from_fn(|n| {
            let (distance, nearest) = neighbours.nearest(n).filter(|(distance, _)| *distance <= MAX_DISTANCE)?;
            // Adding one to both makes two exact copies rivals (0 / 0).
            let ratio_to = |rival: u32| (distance + 1) as f32 / (rival + 1) as f32;
            let is_elsewhere = |k: usize| !half.places[nearest].is_same(&half.places[k]);
            // Most fail by the first rival that is near enough.
            let near_enough = (distance..=FARTHEST_RIVAL).take_while(|rival| ratio_to(*rival) >= ratio).count() as u32;
            let mut passes = true;
            neighbours.visit_nearer(n, distance + near_enough, |k, _| {
                passes &= !is_elsewhere(k);
                if passes { distance + near_enough } else { 0 }
            });
            let mut rival = FARTHEST_RIVAL;
            if passes {
                neighbours.visit_nearer(n, FARTHEST_RIVAL, |k, distance| {
                    rival = if is_elsewhere(k) { distance } else { rival };
                    rival
                });
            }
            // The farthest rival considered may still be too near.
            let own = NearestEntry { entry: half.entries[nearest], ratio: ratio_to(rival) };
            (passes && own.ratio < ratio).then_some(own)
        })
    }

    /// Matches frame features with the index: best ratio first (ties by frame index).
    pub fn match_features(&self, frame: &[Feature], ratio: f32, workers: &Workers, buffers: &mut MatchBuffers, matches: &mut Vec<Match>) {
        matches.clear();
        for (half, polarity) in self.halves.iter().zip(Polarity::ALL) {
            buffers.numbers.clear();
            buffers.numbers.extend((0..frame.len()).filter(|k| frame[*k].polarity == polarity));
            if !half.entries.is_empty() && !buffers.numbers.is_empty() {
                self.match_half(half, frame, ratio, workers, buffers, matches);
            }
        }
        matches.sort_unstable_by(|a, b| a.ratio.total_cmp(&b.ratio).then(a.frame.cmp(&b.frame)));
    }

    /// Appends the matches of the frame's features in `buffers.numbers` with the entries of their
    /// polarity.
    fn match_half(
        &self,
        half: &Half,
        frame: &[Feature],
        ratio: f32,
        workers: &Workers,
        buffers: &mut MatchBuffers,
        matches: &mut Vec<Match>,
    ) {
        let first = matches.len();
        let MatchBuffers { queries, found, numbers, .. } = buffers;
        kernels::group_into(numbers.iter().map(|k| frame[*k].descriptor), queries);
        workers.map_into(queries, found, |queries| Self::nearest(half, queries, ratio));
        for (k, found) in numbers.iter().zip(found.iter().flatten()) {
            matches.extend(found.map(|f| Match { frame: *k as u32, reference: f.entry as u32, ratio: f.ratio }));
        }
        self.keep_mutual(first, frame, workers, buffers, matches);
    }

    /// Drops matches from `first` on whose entry is nearest to another feature elsewhere in the
    /// frame, among those in `buffers.numbers`.
    fn keep_mutual(&self, first: usize, frame: &[Feature], workers: &Workers, buffers: &mut MatchBuffers, matches: &mut Vec<Match>) {
        let MatchBuffers { numbers, frame: packed, nearest_queries, back, .. } = buffers;
        kernels::pack_into(numbers.iter().map(|k| frame[*k].descriptor), packed);
        kernels::group_into(matches[first..].iter().map(|m| self.descriptors[m.reference as usize]), nearest_queries);
        workers.map_into(nearest_queries, back, |queries| nearest_frame_features(queries, packed, numbers));
        let mut back = back.iter().flatten();
        // Two frame features at the same place (neighbouring levels) may both match a reference
        // feature.
        let mut is_mutual = |m: &Match| {
            back.next().is_some_and(|&b| {
                let (claimed, nearest) = (&frame[m.frame as usize], &frame[b]);
                let near = 3.0 * claimed.scale.max(nearest.scale);
                b == m.frame as usize || (claimed.position - nearest.position).norm_squared() < near * near
            })
        };
        let mut kept = first;
        for k in first..matches.len() {
            if is_mutual(&matches[k]) {
                matches[kept] = matches[k];
                kept += 1;
            }
        }
        matches.truncate(kept);
    }
}

/// Returns the features nearest to the given descriptors; `numbers` are the indices of the packed
/// ones.
fn nearest_frame_features(queries: &[Descriptor; QUERIES], packed: &[kernels::Block], numbers: &[usize]) -> [usize; QUERIES] {
    let neighbours = Neighbours::of(queries, packed, numbers.len());
    // There is at least one.
    std::array::from_fn(|n| neighbours.nearest(n).map_or(0, |(_, k)| numbers[k]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    fn features(n: usize, seed: u64) -> Vec<Feature> {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        (0..n)
            .map(|_| Feature {
                position: Vector2::new(rng.random_range(0.0..1000.0), rng.random_range(0.0..800.0)),
                scale: 1.0,
                angle: 0.0,
                polarity: Polarity::ALL[rng.random_range(0..2)],
                descriptor: Descriptor(rng.random()),
            })
            .collect()
    }

    #[test]
    fn noisy_copies_find_their_originals() {
        let reference = features(500, 1);
        let mut index = ReferenceIndex::default();
        index.add(0, &reference, |p| p, 1.0);
        let mut frame: Vec<Feature> = reference.iter().take(200).copied().collect();
        let mut rng = Pcg64Mcg::seed_from_u64(2);
        for f in &mut frame {
            for _ in 0..25 {
                f.descriptor.0[rng.random_range(0..4)] ^= 1 << rng.random_range(0..64);
            }
        }
        frame.extend(features(300, 3));
        let mut matches = Vec::new();
        index.match_features(&frame, 0.8, &Workers::new(1), &mut MatchBuffers::default(), &mut matches);
        assert!(matches.len() >= 195, "{}", matches.len());
        assert!(matches.iter().all(|m| m.frame == m.reference));
        assert!(matches.windows(2).all(|w| w[0].ratio <= w[1].ratio));
    }

    #[test]
    fn a_repeated_motif_is_no_match() {
        let mut reference = features(50, 4);
        let mut twin = reference[7];
        twin.position += Vector2::new(300.0, 0.0);
        reference.push(twin);
        let mut index = ReferenceIndex::default();
        index.add(0, &reference, |p| p, 1.0);
        let mut matches = Vec::new();
        let frame = [reference[7], reference[8]];
        index.match_features(&frame, 0.8, &Workers::new(1), &mut MatchBuffers::default(), &mut matches);
        assert_eq!(matches.iter().map(|m| m.frame).collect::<Vec<_>>(), [1]);
    }

    #[test]
    fn an_index_subset_has_only_the_features_of_its_surfaces() {
        let (mut all, mut part) = (ReferenceIndex::default(), ReferenceIndex::default());
        for surface in 0..3 {
            all.add(surface, &features(60, u64::from(surface) + 10), |p| p, 1.0);
        }
        part.take_from(&all, |surface| surface == 1);
        let frame = features(60, 11);
        let mut matches = Vec::new();
        part.match_features(&frame, 0.8, &Workers::new(1), &mut MatchBuffers::default(), &mut matches);
        assert_eq!(matches.len(), 60);
        assert!(matches.iter().all(|m| m.frame == m.reference && part.features()[m.reference as usize].surface == 1));
        part.match_features(&features(60, 10), 0.8, &Workers::new(1), &mut MatchBuffers::default(), &mut matches);
        assert!(matches.is_empty());
    }

    #[test]
    fn every_rival_match_is_considered() {
        let mut random = Pcg64Mcg::seed_from_u64(9);
        for _ in 0..2000 {
            // Few places close together and similar distances: places chain, and the best changes
            // often.
            let (query, polarity) = (Descriptor([0; 4]), Polarity::Bright);
            let mut index = ReferenceIndex::default();
            let entries: Vec<Feature> = (0..30)
                .map(|_| {
                    let mut descriptor = query;
                    (0..random.random_range(5..60))
                        .for_each(|_| descriptor.0[random.random_range(0..4)] |= 1 << random.random_range(0..64));
                    let position = Vector2::new(random.random_range(0.0..30.0), 0.0);
                    Feature { position, scale: 1.0, angle: 0.0, polarity, descriptor }
                })
                .collect();
            index.add(0, &entries, |p| p, 1.0);
            let distance = |k: usize| entries[k].descriptor.0.iter().map(|word| word.count_ones()).sum::<u32>();
            let best = (0..entries.len()).min_by_key(|k| distance(*k)).unwrap();
            let rival = (0..entries.len())
                .filter(|k| !Place::of(&index.features[best]).is_same(&Place::of(&index.features[*k])))
                .map(distance)
                .min();
            let ratio = (distance(best) + 1) as f32 / (rival.map_or(FARTHEST_RIVAL, |rival| rival.min(FARTHEST_RIVAL)) + 1) as f32;
            let frame = [Feature { position: Vector2::zeros(), scale: 1.0, angle: 0.0, polarity, descriptor: query }];
            let mut matches = Vec::new();
            index.match_features(&frame, f32::INFINITY, &Workers::new(1), &mut MatchBuffers::default(), &mut matches);
            assert_eq!(matches, [Match { frame: 0, reference: best as u32, ratio }]);
        }
    }

    #[test]
    fn dark_corners_match_and_compete_with_dark_ones_only() {
        let bright = Feature { polarity: Polarity::Bright, ..features(1, 12)[0] };
        let dark = Feature { polarity: Polarity::Dark, position: bright.position.add_scalar(300.0), ..bright };
        let (mut matches, workers) = (Vec::new(), Workers::new(1));
        for (entries, expected) in [([dark, dark], 0), ([bright, dark], 1)] {
            let mut index = ReferenceIndex::default();
            index.add(0, &entries, |p| p, 1.0);
            index.match_features(&[bright], 0.8, &workers, &mut MatchBuffers::default(), &mut matches);
            assert_eq!(matches.len(), expected);
        }
        assert_eq!((matches[0].frame, matches[0].reference), (0, 0));
    }

    #[test]
    fn workers_do_not_change_the_matches() {
        let mut index = ReferenceIndex::default();
        index.add(0, &features(400, 5), |p| p, 1.0);
        let frame = [features(200, 5), features(100, 6)].concat();
        let (mut one, mut two) = (Vec::new(), Vec::new());
        index.match_features(&frame, 0.9, &Workers::new(1), &mut MatchBuffers::default(), &mut one);
        index.match_features(&frame, 0.9, &Workers::new(2), &mut MatchBuffers::default(), &mut two);
        assert_eq!(one, two);
    }
}
