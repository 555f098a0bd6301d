//! Rates how well each picture can be tracked, before the show: 0 to 5, with its weaknesses and
//! where they are.
//!
//! A picture is examined at the size at which the whole stage fills the camera's frame, with the
//! tracker's own features, and with the information that alignment uses. Up to seven properties are
//! scored from 0 to 5, and the lowest score is the rating: the weakest property limits tracking.
//!
//! | property | measured by | what fails without it |
//! |---|---|---|
//! | size | its shorter side in the frame | features and tiles have no room |
//! | corners | features recognised in a view from the side | it is not found |
//! | variety | fraction of features taken for others there | it is found one tile off, refused |
//! | uniqueness | features that differ from those one period away | copies cannot be told apart |
//! | detail | cells with edges in both directions | people hide it, and its tilt is unsure |
//! | sharpness | the noise of its position in the frame | poses scatter |
//! | other pictures | features that no other surface has | it is taken for another |
//!
//! The limits were set from the tracker's results with graded pictures on the virtual stage
//! (`ratings_order_pictures_by_how_well_they_are_tracked`).

mod repeated;
mod strength_map;

use std::fmt;

use image::{GrayImage, imageops};

use repeated::Copies;
pub use strength_map::StrengthMap;

use crate::camera::CameraModel;
use crate::features::{ExtractorOptions, Feature, FeatureExtractor, TiltedViews, Workers, append_tilted_features};
use crate::matching::{Match, MatchBuffers, ReferenceIndex};
use crate::track::{BodySpec, SurfaceSpec, TUNING};

/// The best rating.
pub const BEST: u8 = 5;
/// Rating up to which a surface gets a warning: the tracker loses it, or does not find it, in most
/// views of the tests' graded pictures. Raised, good pictures are warned of.
pub const POOR: u8 = 1;
/// Score below which a property is reported as weak. Chosen: what rounds to 4 needs no mention.
/// Raised, good pictures are criticised.
const WEAK: f64 = 3.5;
/// Number of features extracted from a picture. Chosen: a third of a frame's number, so that
/// comparing sixteen pictures takes a second. Raised, checks take longer; lowered, rich pictures
/// look alike.
const FEATURES: usize = 500;
/// Views in which a picture is tested: from 48 degrees, from the side and from above. Features
/// tolerate that like a typical tilt, blur and change of size.
const TRIED: TiltedViews = TiltedViews { tilt: 1.5, count: 2 };
/// Maximum distance between a corner and its match for a correct match, pixels of the pyramid level
/// of the coarser of the two. Chosen: acquisition tolerates as much. Raised, neighbouring corners
/// of a fine pattern count as correct; lowered, correct matches on coarse levels count as wrong.
const RIGHT_PX: f64 = 4.0;
/// Minimum number of matched corners in a view, right or wrong, for the fraction of wrong ones to
/// be significant. Chosen, not tuned. Raised, coarse patterns are called plain.
const MIN_MATCHES: f64 = 4.0;
/// Fraction of the recognised corners that are taken for others of the same picture, for scores 0
/// and 5. Photographs and paintings have 0.03 to 0.16, boards before a wall 0.35, windows, some of
/// them lit, 0.65, tiles 0.9. Raised, patterns pass; lowered, pictures in a uniform style are rated
/// lower.
const MISTAKEN: [f64; 2] = [0.65, 0.3];
/// Longer side at which pictures are compared with each other, pixels. Chosen: as large as a prop
/// appears from near. Raised, fine detail missing from a retouched copy counts as difference;
/// lowered, few corners remain.
const COMPARED_PX: f64 = 400.0;
/// Minimum contrast of a corner, grey levels: twice the tracker's own, as a show sometimes has half
/// the light. Raised, faint pictures are rated lower.
const MIN_CONTRAST: u8 = 12;
/// Median distance between the descriptors of a corner in a frame and in the reference, of 256
/// bits, with typical tilt and blur. A corner whose nearest rival is no farther than that is
/// mistaken for it. Raised, fewer corners count as distinct.
const USUAL_DISTANCE: f32 = 35.0;
/// Shorter side in the frame, pixels, for scores 0 and 5: features need some 60, and from 240 on
/// half of the tiles can be lost. Raised, props are rated lower.
const SIDE_PX: [f64; 2] = [40.0, 240.0];
/// Number of corners recognised in a view, for scores 0 and 5. Acquisition needs eight that agree,
/// and some are hidden; photographs and paintings have 100 to 260. Raised, plain pictures are rated
/// lower.
const CORNERS: [f64; 2] = [6.0, 140.0];
/// Fraction of the cells with detail in both directions, for scores 0 and 5. Alignment reports what
/// half of the tiles support. Raised, pictures with plain parts are rated lower.
const DETAILED: [f64; 2] = [0.02, 0.5];
/// One sigma of the picture's position in the frame, pixels, for scores 0 and 5. No frame
/// determines it better than to 0.001. Lowered, soft pictures are rated lower.
const SIGMA_PX: [f64; 2] = [0.04, 0.004];
/// Fraction of the distinct corners that another surface has as well, for scores 0 and 5. Two
/// prints of one file share nearly all; if one of them is cropped, softer and a tenth larger, two
/// fifths. Raised, near copies pass.
const SHARED: [f64; 2] = [0.35, 0.1];
/// Fraction from which two pictures count as the same. Chosen, not tuned: prints of one file, one
/// of them cropped or retouched, share more (see the tests). Raised, near copies are taken for two
/// pictures.
const SAME: f64 = 0.3;

/// The rating of one surface's picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Rating {
    /// Name of its body.
    pub body: String,
    /// Its own name.
    pub surface: String,
    /// From 0, which cannot be tracked, to [`BEST`].
    pub stars: u8,
    /// Its weaknesses, worst first.
    pub weaknesses: Vec<Weakness>,
    /// Where on the picture there is trackable detail.
    pub map: StrengthMap,
    /// Width and height, pixels, in a frame that the whole stage fills.
    pub seen_px: [u32; 2],
}

/// A weakness of a picture.
#[derive(Debug, Clone, PartialEq)]
pub enum Weakness {
    /// Small in the frame; holds its shorter side, pixels.
    Small(u32),
    /// Few corners are recognised from the side; holds their number.
    FewCorners(usize),
    /// Its corners resemble each other; holds the fraction taken for others from the side.
    Repetitive(f64),
    /// It repeats itself; holds the distance between its copies, metres.
    Repeats(f64),
    /// Much of it is plain; holds the fraction of its cells.
    Plain(f64),
    /// Its edges are soft or faint; holds one sigma of its position in the frame, pixels.
    Soft(f64),
    /// Another surface has the same corners.
    Like {
        /// Body and name of the other surface.
        other: [String; 2],
        /// Fraction of the corners.
        share: f64,
    },
}

impl Weakness {
    /// Returns the other body if it has the same picture, so that the two cannot be told apart.
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
                write!(f, "it is only {px} pixels large when the whole stage fills the frame: print it larger, or move the camera closer")
            }
            Self::FewCorners(n) => write!(f, "only {n} of its corners are recognised at an angle: add detail"),
            Self::Repetitive(share) => {
                write!(
                    f,
                    "{:.0} % of its corners look like other corners of it: break up the pattern so that every part differs",
                    100.0 * share
                )
            }
            Self::Repeats(apart_m) => {
                let apart = if *apart_m < 1.0 { format!("{:.0} cm", 100.0 * apart_m) } else { format!("{apart_m:.1} m") };
                write!(f, "it repeats every {apart}, so its copies cannot be told apart: add parts that occur only once")
            }
            Self::Plain(share) => write!(f, "{:.0} % of it is plain: spread the detail", 100.0 * share),
            Self::Soft(px) => write!(f, "its edges are soft or faint (its position is known to {px:.3} pixels): give it more contrast"),
            Self::Like { other: [body, surface], share } => {
                write!(f, "{:.0} % of its corners are also on {surface} of {body}: give each its own picture", 100.0 * share)
            }
        }
    }
}

/// A picture as the camera sees it, with its features.
struct Seen {
    body: usize,
    names: [String; 2],
    picture: GrayImage,
    features: Vec<Feature>,
    /// Its features at the common size at which pictures are compared, independent of the size in
    /// the frame.
    compared: Vec<Feature>,
    recognised: Recognised,
    /// Distance between its copies, metres, if it repeats itself.
    apart_m: Option<f64>,
}

/// The fate of a picture's corners in a view from the side, averaged over several views.
#[derive(Debug, Clone, Copy)]
struct Recognised {
    /// Number of corners recognised.
    right: f64,
    /// Number of corners taken for others of the same picture.
    wrong: f64,
    /// Number of recognised corners that exist only once in the picture: all of them if it does not
    /// repeat itself.
    once: f64,
}

impl Recognised {
    /// Returns the fraction taken for others, with one more of each kind added, so that few matches
    /// give a moderate value; 0 if there are next to none.
    fn share_wrong(&self) -> f64 {
        let all = self.right + self.wrong;
        if all < MIN_MATCHES { 0.0 } else { (self.wrong + 1.0) / (all + 2.0) }
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
            // Levels as for the references to which frames are matched: soft pictures have their
            // corners on the coarse ones.
            let options =
                ExtractorOptions { count: FEATURES, least_threshold: MIN_CONTRAST, levels: 16, area_power: 0.35, ..Default::default() };
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

/// Returns the pixels per metre at which the largest surface of the stage just fits into the frame.
fn whole_stage_px_per_m(stage: &BodySpec, camera: &CameraModel) -> f64 {
    let area = |s: &&SurfaceSpec| s.size_m[0] * s.size_m[1];
    let largest = stage.surfaces.iter().max_by(|a, b| area(a).total_cmp(&area(b)));
    let [width_m, height_m] = largest.map_or([1.0, 1.0], |s| s.size_m);
    (f64::from(camera.width()) / width_m).min(f64::from(camera.height()) / height_m)
}

/// Returns the picture at another size, pixels; never enlarged, since that adds no detail.
fn scaled(surface: &SurfaceSpec, size_px: [f64; 2]) -> GrayImage {
    let (width, height) = surface.artwork.dimensions();
    let side = |px: f64, most: u32| (px.round() as u32).clamp(1, most.max(1));
    let [across, down] = [side(size_px[0], width), side(size_px[1], height)];
    if (across, down) == (width, height) {
        return surface.artwork.clone();
    }
    imageops::resize(&surface.artwork, across, down, imageops::FilterType::Triangle)
}

/// Returns those features of the first list that resemble no other place in either list.
fn distinct(own: &[Feature], other: &[Feature], workers: &Workers) -> Vec<Match> {
    let mut index = ReferenceIndex::default();
    index.add(0, own, |p| p, 1.0);
    index.add(1, other, |p| p, 1.0);
    // A feature matches itself at distance zero; its rival is the nearest elsewhere. One is added
    // to both (see the index).
    matched(own, &index, 1.0 / (1.0 + USUAL_DISTANCE), workers)
}

fn matched(seen: &[Feature], index: &ReferenceIndex, ratio: f32, workers: &Workers) -> Vec<Match> {
    let mut matches = Vec::new();
    index.match_features(seen, ratio, workers, &mut MatchBuffers::default(), &mut matches);
    matches
}

/// Views a picture from the side, as the tracker does, and matches it to its own corners.
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
    let matches = matched(&seen, &index, TUNING.acquire.lowe_ratio, workers);
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
    let mut scores = vec![
        (by_ratio(f64::from(side), SIDE_PX), Weakness::Small(side)),
        (by_difference(mistaken, MISTAKEN), Weakness::Repetitive(mistaken)),
        (by_ratio(recognised.right, CORNERS), Weakness::FewCorners(recognised.right.round() as usize)),
        (by_ratio(1.0 - share_plain, DETAILED), Weakness::Plain(share_plain)),
        (by_ratio(sigma_px, SIGMA_PX), Weakness::Soft(sigma_px)),
    ];
    scores.extend(apart_m.map(|apart_m| (by_ratio(recognised.once, CORNERS), Weakness::Repeats(apart_m))));
    if let Some((other, share)) = like {
        // On the same body the other features still help, so it costs at most half.
        let least = if all[other].body == *body { 0.5 * f64::from(BEST) } else { 0.0 };
        scores.push((by_difference(share, SHARED).max(least), Weakness::Like { other: all[other].names.clone(), share }));
    }
    scores.sort_by(|a, b| a.0.total_cmp(&b.0));
    let stars = scores.first().map_or(0, |(score, _)| score.round() as u8);
    let weaknesses = scores.into_iter().filter(|(score, _)| *score < WEAK).map(|(_, weakness)| weakness).collect();
    let [body, surface] = names.clone();
    Rating { body, surface, stars, weaknesses, map, seen_px: [picture.width(), picture.height()] }
}

/// Returns a score from 0 to 5 by the logarithm of a value, between the values that score 0 and 5.
fn by_ratio(value: f64, [none, best]: [f64; 2]) -> f64 {
    by_difference(value.max(1e-9).ln(), [none.ln(), best.ln()])
}

/// Returns a score from 0 to 5 by a value, between the values that score 0 and 5.
fn by_difference(value: f64, [none, best]: [f64; 2]) -> f64 {
    f64::from(BEST) * ((value - none) / (best - none)).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests;
