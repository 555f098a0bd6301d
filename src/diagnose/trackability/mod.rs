//! How well each picture can be tracked, before the show: 0 to 5, with what is weak about it and where.
//!
//! A picture is looked at as the camera sees it where the whole stage fills the frame: at that size, with the tracker's own features, and with the
//! information that alignment rests on. Six things are asked, each from 0 to 5, and the weakest is the rating: a picture is no better tracked
//! than its weakest side lets it be.
//!
//! | asked | by | what is lost without |
//! |---|---|---|
//! | size | its shorter side in the frame | features and tiles have no room |
//! | corners | features that are recognised in a view from the side | it is not found |
//! | variety | the share of features that are taken for others there | it is found one tile further, and refused |
//! | one of its kind | features that differ from what is a period aside, where it repeats itself | nothing tells which of its copies is seen |
//! | detail | cells in which edges run both ways | it is lost behind a person, and its tilt is unsure |
//! | sharpness | how far off the noise leaves its place in the frame | poses scatter |
//! | other pictures | features that no other surface has | it is taken for another |
//!
//! The steps were set by what the tracker does with graded pictures on the virtual stage (`ratings_order_pictures_by_what_the_tracker_does_with_them`).

mod repeated;
mod strength_map;

use std::fmt;

use image::{GrayImage, imageops};

use repeated::Copies;
pub use strength_map::StrengthMap;

use crate::camera::CameraModel;
use crate::features::{ExtractorOptions, Feature, FeatureExtractor, TiltedViews, Workers, append_tilted_features};
use crate::matching::{Match, MatchBuffers, ReferenceIndex};
use crate::track::{BodySpec, LOWE_RATIO, SurfaceSpec};

/// The best rating.
pub const BEST: u8 = 5;
/// A surface rated no better than this is worth a warning: the tracker loses it, or does not find it, in most views. From the graded pictures of
/// the tests. Raised, good pictures are warned of.
pub const POOR: u8 = 1;
/// Sides below this are named as too short, and things asked that reach less than this of 5 as weak. Chosen: what rounds to 4 needs no words. Raised, good pictures
/// are talked down.
const WEAK: f64 = 3.5;
/// Features looked for in a picture. Chosen: a third of what a frame is asked for, so that comparing sixteen pictures takes a second. Raised, checks take longer;
/// lowered, rich pictures look alike.
const FEATURES: usize = 500;
/// Views that a picture is tried in: from 48 degrees, from the side and from above. Features bear that, as they bear a usual tilt, blur and change of size.
const TRIED: TiltedViews = TiltedViews { tilt: 1.5, count: 2 };
/// Largest distance between a corner and the one that it is matched with, for the match to be right: pixels of the pyramid level of the coarser of the two. Chosen: acquisition bears as much. Raised,
/// neighbouring corners of a fine pattern count as right; lowered, right matches on coarse levels count as wrong.
const RIGHT_PX: f64 = 4.0;
/// Fewest corners in a view, right or wrong, of which the share that is wrong says something. Chosen, not tuned. Raised, coarse patterns are called plain.
const LEAST_MATCHES: f64 = 4.0;
/// Share of its recognised corners that are taken for others of its own, of pictures rated 0 and 5. Of photographs and paintings 0.03 to 0.16, of boards before a wall 0.35; of windows, some
/// of which are lit, 0.65, of tiles 0.9. Raised, patterns pass; lowered, pictures in one style are rated lower.
const MISTAKEN: [f64; 2] = [0.65, 0.3];
/// Longer side at which pictures are compared with each other, pixels. Chosen: as large as a prop is seen from near. Raised, fine detail that a retouched copy
/// lacks counts as difference; lowered, few corners are left.
const COMPARED_PX: f64 = 400.0;
/// Least contrast of a corner, grey levels. Twice the tracker's own, as a show has half the light now and then. Raised, faint pictures are rated lower.
const LEAST_CONTRAST: u8 = 12;
/// How far the description of a corner in a frame is from the reference's, of 256 bits: the median under usual tilt and blur. A corner whose nearest rival is
/// no further than that is mistaken for it. Raised, fewer corners count as distinct.
const USUAL_DISTANCE: f32 = 35.0;
/// Shorter side in the frame, pixels, of a picture rated 0 and 5: features need some 60, and from 240 on there are tiles enough to lose half of them. Raised, props
/// are rated lower.
const SIDE_PX: [f64; 2] = [40.0, 240.0];
/// Corners of a picture rated 0 and 5 that are recognised in a view. Acquisition wants eight that agree, and some are hidden; photographs and paintings have 100 to 260. Raised, plain
/// pictures are rated lower.
const CORNERS: [f64; 2] = [6.0, 140.0];
/// Share of the cells with detail in both directions, of pictures rated 0 and 5. Alignment gives what half of the tiles bear out. Raised, pictures with
/// plain parts are rated lower.
const DETAILED: [f64; 2] = [0.02, 0.5];
/// One sigma of the picture's place in the frame, pixels, of pictures rated 0 and 5. No frame tells it better than to 0.001. Lowered, soft pictures are
/// rated lower.
const SIGMA_PX: [f64; 2] = [0.04, 0.004];
/// Share of its distinct corners that another surface has as well, of pictures rated 0 and 5. Two prints of one file share nearly all, one of them cropped, softer and a tenth larger two fifths. Raised, near copies pass.
const SHARED: [f64; 2] = [0.35, 0.1];
/// From this share on two pictures count as the same. Chosen, not tuned: prints of one file, one of them cropped or retouched, share more (see the tests). Raised, near copies
/// are taken for two pictures.
const SAME: f64 = 0.3;

/// How well one surface's picture can be tracked.
#[derive(Debug, Clone, PartialEq)]
pub struct Rating {
    /// Name of its body.
    pub body: String,
    /// Its own name.
    pub surface: String,
    /// From 0, which cannot be tracked, to [`BEST`].
    pub stars: u8,
    /// What is weak, worst first; empty where nothing is.
    pub weaknesses: Vec<Weakness>,
    /// Where on the picture there is something to hold on to.
    pub map: StrengthMap,
    /// Width and height in the frame, pixels, where the whole stage fills it.
    pub seen_px: [u32; 2],
}

/// What is weak about a picture.
#[derive(Debug, Clone, PartialEq)]
pub enum Weakness {
    /// It is small in the frame: its shorter side, pixels.
    Small(u32),
    /// Few of its corners are recognised from the side: how many.
    FewCorners(usize),
    /// Its corners resemble each other: share of those that are taken for others from the side.
    Repetitive(f64),
    /// It repeats itself: how far from each other its copies are, metres.
    Repeats(f64),
    /// Much of it is plain: share of its cells.
    Plain(f64),
    /// Its edges are soft or faint: one sigma of its place in the frame, pixels.
    Soft(f64),
    /// Another surface has its corners as well.
    Like {
        /// Body and name of the other surface.
        other: [String; 2],
        /// Share of the corners.
        share: f64,
    },
}

impl Weakness {
    /// The other body, where that has the same picture: nothing can tell the two apart.
    pub fn same_as(&self) -> Option<&[String; 2]> {
        match self {
            Self::Like { other, share } if *share >= SAME => Some(other),
            _ => None,
        }
    }
}

impl fmt::Display for Weakness {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Small(px) => {
                write!(f, "it is {px} pixels in the frame where the whole stage fills it: print it larger, or bring the camera nearer")
            }
            Self::FewCorners(n) => write!(f, "{n} of its corners are recognised from the side: add detail"),
            Self::Repetitive(share) => {
                write!(f, "{:.0} % of its corners look like others of its own: break the pattern, each part should differ", 100.0 * share)
            }
            Self::Repeats(apart_m) => {
                let apart = if *apart_m < 1.0 { format!("{:.0} cm", 100.0 * apart_m) } else { format!("{apart_m:.1} m") };
                write!(
                    f,
                    "it repeats itself every {apart}, so that nothing tells which of its copies is seen: give it parts that are there once"
                )
            }
            Self::Plain(share) => write!(f, "{:.0} % of it is plain: spread the detail", 100.0 * share),
            Self::Soft(px) => write!(f, "its edges are soft or faint (its place is known to {px:.3} pixels): give it more contrast"),
            Self::Like { other: [body, surface], share } => {
                write!(f, "{:.0} % of its corners are also on {surface} of {body}: give each its own picture", 100.0 * share)
            }
        }
    }
}

/// A picture as the camera sees it, and what was found on it.
struct Seen {
    body: usize,
    names: [String; 2],
    picture: GrayImage,
    features: Vec<Feature>,
    /// Those of the picture at a size at which pictures are compared, whatever size they are seen at.
    compared: Vec<Feature>,
    recognised: Recognised,
    /// How far from each other its copies are, metres, where it repeats itself.
    apart_m: Option<f64>,
}

/// What becomes of a picture's corners in a view from the side, the mean of several.
#[derive(Debug, Clone, Copy)]
struct Recognised {
    /// How many are recognised.
    right: f64,
    /// How many are taken for others of the same picture.
    wrong: f64,
    /// Of those that are recognised, how many the picture has once: all of them where it does not repeat itself.
    once: f64,
}

impl Recognised {
    /// Share of those that are taken for others, with one more of each kind, so that few say little; 0 where there are next to none.
    fn share_wrong(&self) -> f64 {
        let all = self.right + self.wrong;
        if all < LEAST_MATCHES { 0.0 } else { (self.wrong + 1.0) / (all + 2.0) }
    }
}

/// Rates every surface of the stage and the objects, in their order.
pub fn rate(stage: &BodySpec, objects: &[BodySpec], camera: &CameraModel) -> Vec<Rating> {
    let px_per_m = whole_stage_px_per_m(stage, camera);
    let workers = Workers::new(1);
    let mut extractor = FeatureExtractor::default();
    let bodies = std::iter::once(stage).chain(objects).enumerate();
    let surfaces = bodies.flat_map(|(k, body)| body.surfaces.iter().map(move |surface| (k, body, surface)));
    let all: Vec<Seen> = surfaces
        .map(|(body, of, surface)| {
            let picture = scaled(surface, surface.size_m.map(|m| m * px_per_m));
            let longer_m = surface.size_m[0].max(surface.size_m[1]);
            let same_size = scaled(surface, surface.size_m.map(|m| m / longer_m * COMPARED_PX));
            let [mut features, mut compared] = [Vec::new(), Vec::new()];
            // Levels as of the references that frames are matched with: what is soft has its corners on the coarse ones.
            let options =
                ExtractorOptions { count: FEATURES, least_threshold: LEAST_CONTRAST, levels: 16, area_power: 0.35, ..Default::default() };
            extractor.extract(&picture, None, &options, &workers, &mut features);
            extractor.extract(&same_size, None, &options, &workers, &mut compared);
            let copies = Copies::of(&picture);
            let recognised = recognised(&picture, &features, &copies, &options, &mut extractor, &workers);
            let apart_m = copies.apart_px().map(|px| px * surface.size_m[0] / f64::from(picture.width()));
            Seen { body, names: [of.name.clone(), surface.name.clone()], picture, features, compared, recognised, apart_m }
        })
        .collect();
    (0..all.len()).map(|k| rating(&all, k, &workers)).collect()
}

/// Pixels a metre where the largest surface of the stage just fits into the frame.
fn whole_stage_px_per_m(stage: &BodySpec, camera: &CameraModel) -> f64 {
    let area = |s: &&SurfaceSpec| s.size_m[0] * s.size_m[1];
    let largest = stage.surfaces.iter().max_by(|a, b| area(a).total_cmp(&area(b)));
    let [width_m, height_m] = largest.map_or([1.0, 1.0], |s| s.size_m);
    (f64::from(camera.width()) / width_m).min(f64::from(camera.height()) / height_m)
}

/// The picture at another size, pixels; never larger than it is, as no detail comes of that.
fn scaled(surface: &SurfaceSpec, size_px: [f64; 2]) -> GrayImage {
    let (width, height) = surface.artwork.dimensions();
    let side = |px: f64, most: u32| (px.round() as u32).clamp(1, most.max(1));
    let [across, down] = [side(size_px[0], width), side(size_px[1], height)];
    if (across, down) == (width, height) {
        return surface.artwork.clone();
    }
    imageops::resize(&surface.artwork, across, down, imageops::FilterType::Triangle)
}

/// Those of the first of these features that no other place of any of them resembles.
fn distinct(own: &[Feature], other: &[Feature], workers: &Workers) -> Vec<Match> {
    let mut index = ReferenceIndex::default();
    index.add(0, own, |p| p, 1.0);
    index.add(1, other, |p| p, 1.0);
    // A feature finds itself, at no distance; its rival is the nearest elsewhere. One is added to both (see the index).
    matched(own, &index, 1.0 / (1.0 + USUAL_DISTANCE), workers)
}

fn matched(seen: &[Feature], index: &ReferenceIndex, ratio: f32, workers: &Workers) -> Vec<Match> {
    let mut matches = Vec::new();
    index.match_features(seen, ratio, workers, &mut MatchBuffers::default(), &mut matches);
    matches
}

/// Looks at a picture from the side, as the tracker does, and compares that with its own corners.
fn recognised(
    picture: &GrayImage,
    own: &[Feature],
    copies: &Copies,
    options: &ExtractorOptions,
    extractor: &mut FeatureExtractor,
    workers: &Workers,
) -> Recognised {
    let mut seen = Vec::new();
    append_tilted_features(picture, TRIED, options, extractor, workers, &mut seen);
    let seen = seen.concat();
    let mut index = ReferenceIndex::default();
    index.add(0, own, |p| p, 1.0);
    let matches = matched(&seen, &index, LOWE_RATIO, workers);
    let is_right = |m: &&Match| {
        let (seen, own) = (&seen[m.frame as usize], &own[m.reference as usize]);
        (seen.position - own.position).norm() < RIGHT_PX * seen.scale.max(own.scale)
    };
    let right = matches.iter().filter(is_right).count();
    let is_there_once: Vec<bool> = own.iter().map(|feature| !copies.has(picture, feature)).collect();
    let once = matches.iter().filter(is_right).filter(|m| is_there_once[m.reference as usize]).count();
    let of_a_view = |n: usize| n as f64 / TRIED.count as f64;
    Recognised { right: of_a_view(right), wrong: of_a_view(matches.len() - right), once: of_a_view(once) }
}

fn rating(all: &[Seen], own: usize, workers: &Workers) -> Rating {
    let Seen { body, names, picture, features, recognised, apart_m, .. } = &all[own];
    let distinct_features = distinct(features, &[], workers);
    let alone = distinct(&all[own].compared, &[], workers).len();
    let share_with = |other: usize| 1.0 - distinct(&all[own].compared, &all[other].compared, workers).len() as f64 / alone as f64;
    let others = (0..all.len()).filter(|other| *other != own && alone > 0);
    let like = others.map(|other| (other, share_with(other))).max_by(|a, b| a.1.total_cmp(&b.1));
    let is_distinct = |k: usize| distinct_features.iter().any(|m| m.frame as usize == k);
    let corners_at = features.iter().enumerate().map(|(k, f)| ([f.position.x, f.position.y], is_distinct(k)));
    let map = StrengthMap::of(picture, corners_at);

    let side = picture.width().min(picture.height());
    let share_plain = 1.0 - map.share_detailed();
    let mistaken = recognised.share_wrong();
    let sigma_px = map.sigma_px();
    let mut asked = vec![
        (by_ratio(f64::from(side), SIDE_PX), Weakness::Small(side)),
        (by_difference(mistaken, MISTAKEN), Weakness::Repetitive(mistaken)),
        (by_ratio(recognised.right, CORNERS), Weakness::FewCorners(recognised.right.round() as usize)),
        (by_ratio(1.0 - share_plain, DETAILED), Weakness::Plain(share_plain)),
        (by_ratio(sigma_px, SIGMA_PX), Weakness::Soft(sigma_px)),
    ];
    asked.extend(apart_m.map(|apart_m| (by_ratio(recognised.once, CORNERS), Weakness::Repeats(apart_m))));
    if let Some((other, share)) = like {
        // On one body the other features still tell: it costs at most half.
        let least = if all[other].body == *body { 0.5 * f64::from(BEST) } else { 0.0 };
        asked.push((by_difference(share, SHARED).max(least), Weakness::Like { other: all[other].names.clone(), share }));
    }
    asked.sort_by(|a, b| a.0.total_cmp(&b.0));
    let stars = asked.first().map_or(0, |(score, _)| score.round() as u8);
    let weaknesses = asked.into_iter().filter(|(score, _)| *score < WEAK).map(|(_, weakness)| weakness).collect();
    let [body, surface] = names.clone();
    Rating { body, surface, stars, weaknesses, map, seen_px: [picture.width(), picture.height()] }
}

/// 0 to 5 by the logarithm of a value, from the one that is rated 0 to the one that is rated 5.
fn by_ratio(value: f64, [none, best]: [f64; 2]) -> f64 {
    by_difference(value.max(1e-9).ln(), [none.ln(), best.ln()])
}

/// 0 to 5 by a value, from the one that is rated 0 to the one that is rated 5.
fn by_difference(value: f64, [none, best]: [f64; 2]) -> f64 {
    f64::from(BEST) * ((value - none) / (best - none)).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests;
