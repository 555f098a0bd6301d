//! Recognises corners of the set in several keyframes.
//!
//! Every keyframe is matched with the next ones and with others taken from nearby. A match must
//! agree with the cameras' start poses to some pixels, which keeps most look-alikes out. Matches of
//! the same corner are joined into a track, which has at most one sighting in a keyframe.

use std::collections::{BTreeMap, BTreeSet};

use image::GrayImage;
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

use super::views::Views;
use crate::features::{ExtractorOptions, Feature, FeatureExtractor, Workers};
use crate::matching::{MatchBuffers, ReferenceIndex};

/// Features of a keyframe: twice the tracker's, because all of the set counts. Raised, matching
/// takes longer (squared); lowered, plain parts of the set have no points.
const FEATURES: usize = 3000;
/// Number of pyramid levels. Raised, coarse corners join whose places are less certain; lowered,
/// keyframes at another distance do not match.
const LEVELS: usize = 6;
/// Number of following keyframes that each is matched with. Raised, matching takes longer; lowered,
/// tracks are shorter.
const FOLLOWING: usize = 3;
/// Number of other keyframes, taken from nearby, that each is matched with: the walk passed there
/// before. Raised, matching takes longer; lowered, the walk's ends do not hold together.
const NEARBY: usize = 3;
/// Maximum angle between the views of two keyframes taken from nearby, radians. Raised, pairs that
/// share little are matched in vain.
const MAX_TURN: f64 = 0.6;
/// Maximum ratio of the best descriptor distance to the second best (Lowe). Raised, look-alikes
/// match; lowered, repeated boards and stones have no points.
const MAX_RATIO: f32 = 0.85;
/// Maximum distance of a match from its epipolar line, pixels: the error of the start poses.
/// Raised, look-alikes match; lowered, keyframes with a poor start lose their matches.
const MAX_EPIPOLAR_PX: f64 = 4.0;
/// Minimum number of keyframes of a track. Two cannot show that a match is wrong.
const MIN_SIGHTINGS: usize = 3;
/// One sigma of a corner's place, pixels of the level it was found on: it is found to a whole
/// pixel.
const CORNER_SIGMA_PX: f64 = 0.5;

/// A corner of the set in a keyframe.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sighting {
    /// The keyframe's index.
    pub view: usize,
    /// Its number among the frame's features.
    pub feature: usize,
    /// Its raw pixel.
    pub pixel: Vector2<f64>,
    /// One sigma of the pixel along each axis.
    pub sigma_px: f64,
}

/// The sightings of one corner, by keyframe.
pub type Track = Vec<Sighting>;

/// The features of frames, and those of two frames that look alike. Frames are matched once,
/// however often tracks are made of them.
pub struct Recognition {
    features: Vec<Vec<Feature>>,
    /// Pairs of features, by the frames' indices, the smaller one first.
    alike: BTreeMap<(usize, usize), Vec<[usize; 2]>>,
}

impl Recognition {
    /// Extracts the features of frames. `None` if `goes_on` returned false.
    pub fn of(pictures: &[&GrayImage], mask: Option<&GrayImage>, goes_on: &(dyn Fn() -> bool + Sync)) -> Option<Self> {
        let options = ExtractorOptions { count: FEATURES, levels: LEVELS, ..ExtractorOptions::default() };
        let extracted = |picture: &&GrayImage| {
            let mut features = Vec::new();
            if goes_on() {
                FeatureExtractor::default().extract(picture, mask, &options, &Workers::new(1), &mut features);
            }
            features
        };
        let features = pictures.par_iter().map(extracted).collect();
        goes_on().then_some(Self { features, alike: BTreeMap::new() })
    }

    /// Returns where a feature of a frame is, its raw pixel, and one sigma of it.
    pub fn place(&self, frame: usize, feature: usize) -> (Vector2<f64>, f64) {
        let found = &self.features[frame][feature];
        (found.position, CORNER_SIGMA_PX * found.scale)
    }

    /// Matches pairs of frames that were not matched before, the smaller index first. `None` if
    /// `goes_on` returned false.
    pub fn compare(&mut self, pairs: impl IntoIterator<Item = (usize, usize)>, goes_on: &(dyn Fn() -> bool + Sync)) -> Option<()> {
        let mut others: BTreeMap<usize, BTreeSet<usize>> = BTreeMap::new();
        for (a, b) in pairs.into_iter().filter(|pair| !self.alike.contains_key(pair)) {
            others.entry(a).or_default().insert(b);
        }
        let features = &self.features;
        let compared = |(a, others): (usize, BTreeSet<usize>)| {
            let mut index = ReferenceIndex::default();
            index.add(0, &features[a], |p| p, 1.0);
            let (mut buffers, mut matches) = (MatchBuffers::default(), Vec::new());
            let mut with = |b: usize| {
                index.match_features(&features[b], MAX_RATIO, &Workers::new(1), &mut buffers, &mut matches);
                ((a, b), matches.iter().map(|m| [m.reference as usize, m.frame as usize]).collect::<Vec<_>>())
            };
            others.into_iter().take_while(|_| goes_on()).map(&mut with).collect::<Vec<_>>()
        };
        let found: Vec<_> = others.into_par_iter().map(compared).collect();
        self.alike.extend(found.into_iter().flatten());
        goes_on().then_some(())
    }

    /// Returns the pairs of features of two compared frames that look alike, best first.
    pub fn alike(&self, a: usize, b: usize) -> impl Iterator<Item = [usize; 2]> {
        let pairs = self.alike.get(&(a.min(b), a.max(b))).map_or(&[][..], Vec::as_slice);
        pairs.iter().map(move |[m, n]| if a < b { [*m, *n] } else { [*n, *m] })
    }

    /// Returns the tracks of all corners that enough keyframes show. `frames` are the indices of
    /// the keyframes' frames, in order. `None` if `goes_on` returned false.
    pub fn tracks(&mut self, views: &Views<'_>, frames: &[usize], goes_on: &(dyn Fn() -> bool + Sync)) -> Option<Vec<Track>> {
        let partners = partners(views);
        let pairs = || partners.iter().enumerate().flat_map(|(a, others)| others.iter().map(move |b| (a, *b)));
        self.compare(pairs().map(|(a, b)| (frames[a], frames[b])), goes_on)?;
        let known = &*self;
        let of_frames = |(a, b): (usize, usize)| {
            let near = known.alike(frames[a], frames[b]).filter(move |[m, n]| {
                let [in_a, in_b] = [(a, *m), (b, *n)].map(|(view, feature)| (view, known.place(frames[view], feature).0));
                epipolar_px(views, in_a, in_b) < MAX_EPIPOLAR_PX
            });
            near.map(|[m, n]| [(a, m), (b, n)]).collect::<Vec<_>>()
        };
        let joined: Vec<Vec<_>> = pairs().collect::<Vec<_>>().into_par_iter().map(of_frames).collect();
        let mut sets = Sets::new(frames.iter().map(|frame| self.features[*frame].len()));
        joined.iter().flatten().for_each(|[a, b]| sets.join(*a, *b));
        let sighting = |(view, feature): (usize, usize)| {
            let (pixel, sigma_px) = self.place(frames[view], feature);
            Sighting { view, feature, pixel, sigma_px }
        };
        let long = sets.members.into_iter().filter(|members| members.len() >= MIN_SIGHTINGS);
        goes_on().then(|| long.map(|members| members.into_iter().map(sighting).collect()).collect())
    }
}

/// Returns for each keyframe the later ones that it is matched with.
fn partners(views: &Views<'_>) -> Vec<Vec<usize>> {
    let poses: Vec<_> = views.views.iter().map(|view| view.pose).collect();
    let of = |a: usize| {
        let far: Vec<usize> = (a + FOLLOWING + 1..poses.len()).filter(|b| poses[a].angle_to(&poses[*b]) < MAX_TURN).collect();
        let mut near: Vec<(f64, usize)> = far.into_iter().map(|b| ((poses[a].translation - poses[b].translation).norm(), b)).collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let following = a + 1..poses.len().min(a + FOLLOWING + 1);
        following.chain(near.into_iter().take(NEARBY).map(|(_, b)| b)).collect()
    };
    (0..poses.len()).map(of).collect()
}

/// Returns how far a pixel of keyframe `b` is from the epipolar line of one of keyframe `a`,
/// pixels; infinite if the lens does not map one of them.
fn epipolar_px(views: &Views<'_>, (a, in_a): (usize, Vector2<f64>), (b, in_b): (usize, Vector2<f64>)) -> f64 {
    let [from, to] = [a, b].map(|k| views.views[k].pose);
    let (Some(along), Some(seen)) = (views.direction(a, in_a), views.direction(b, in_b)) else { return f64::INFINITY };
    let base = from.translation - to.translation;
    let normal = base.cross(&along);
    if normal.norm() < f64::EPSILON {
        return f64::INFINITY;
    }
    // In the axes of camera b, where the ray has depth 1.
    let [line, ray]: [Vector3<f64>; 2] = [normal, seen].map(|v| to.rotation.inverse() * v);
    let distance = line.dot(&ray) / ray.z / line.xy().norm().max(f64::EPSILON);
    distance.abs() * views.camera.intrinsics().fx
}

/// Disjoint sets of features, each with at most one feature of a keyframe.
struct Sets {
    /// The set of each feature, by keyframe; several may lead to the same one.
    of: Vec<Vec<usize>>,
    /// The members of each set, by keyframe and feature; empty once joined with another.
    members: Vec<Vec<(usize, usize)>>,
}

impl Sets {
    /// Every feature alone; `counts` are those of the keyframes.
    fn new(counts: impl Iterator<Item = usize>) -> Self {
        let mut members = Vec::new();
        let mut of = Vec::new();
        for (view, count) in counts.enumerate() {
            of.push((members.len()..members.len() + count).collect());
            members.extend((0..count).map(|feature| vec![(view, feature)]));
        }
        Self { of, members }
    }

    /// Joins the sets of two features, unless a keyframe would then have two.
    fn join(&mut self, a: (usize, usize), b: (usize, usize)) {
        let [into, from] = [a, b].map(|(view, feature)| self.of[view][feature]);
        let has = |set: usize, view: usize| self.members[set].iter().any(|(own, _)| *own == view);
        if into == from || self.members[from].iter().any(|(view, _)| has(into, *view)) {
            return;
        }
        let moved = std::mem::take(&mut self.members[from]);
        moved.iter().for_each(|(view, feature)| self.of[*view][*feature] = into);
        self.members[into].extend(moved);
        self.members[into].sort_unstable();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_set_has_one_feature_of_a_keyframe() {
        let mut sets = Sets::new([2, 2, 1].into_iter());
        sets.join((0, 0), (1, 1));
        sets.join((1, 1), (2, 0));
        // Keyframe 0 has another feature in that set already.
        sets.join((0, 1), (2, 0));
        sets.join((0, 1), (1, 0));
        let kept: Vec<_> = sets.members.into_iter().filter(|set| !set.is_empty()).collect();
        assert_eq!(kept, [vec![(0, 0), (1, 1), (2, 0)], vec![(0, 1), (1, 0)]]);
    }
}
