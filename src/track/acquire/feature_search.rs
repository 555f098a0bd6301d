//! Extracts features of a frame and matches them with the reference pictures.
//!
//! Each picture's part of the [bank of views](super::view_bank) contains features of the picture
//! seen frontally and from tilted directions. The strongest features of a frame are matched with
//! the frontal ones first; if a body is not found this way, a close look uses more features and the
//! whole bank. Once the stage is known, only unexplained parts of the frame are searched, a limited
//! slice per frame.

use crate::track::acquire::tuning::TUNING;
use std::sync::Arc;

use image::GrayImage;

use super::candidate::{SurfaceMatch, surface_matches};
use super::unexplained::Unexplained;
use super::view_bank::{BankBuilder, PictureCopy, ViewStore, view_shapes};
use crate::camera::CameraModel;
use crate::features::{ContrastStretch, ExtractorOptions, Feature, FeatureExtractor, Workers};
use crate::matching::{Match, MatchBuffers, ReferenceFeature, ReferenceIndex};
use crate::track::scene::reference::PreparedSurface;

/// Features of a quick look: the strongest of a frame. Raised, every frame of a search takes
/// longer; lowered, occluded stages need the close look more often.
const QUICK_FEATURES: usize = 600;
/// Features of a glance: the strongest of a frame. Raised, every frame of a search takes longer;
/// lowered, more frames need a quick look as well.
const GLANCE_FEATURES: usize = QUICK_FEATURES / 2;

/// How closely a frame is searched.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Look {
    /// Half as many features as a quick look: enough for a stage that is seen well.
    Glance,
    /// The strongest features, compared with the frontal views.
    Quick,
    /// All features, compared with the frontal views; for diagnosis.
    Frontal,
}

/// Extracts features and matches them; keeps its buffers between frames.
#[derive(Debug, Default)]
pub struct FeatureSearch {
    /// Maximum features of a frame.
    count: usize,
    /// The pictures seen frontally.
    frontal: ReferenceIndex,
    /// The frontal and the tilted views.
    all_views: ReferenceIndex,
    extractor: FeatureExtractor,
    contrast: ContrastStretch,
    features: Vec<Feature>,
    matches: Vec<Match>,
    buffers: MatchBuffers,
    /// All views of the surfaces searched in a slice, and the numbers of these surfaces.
    missing_views: ReferenceIndex,
    missing: Vec<u32>,
    /// Number of slices so far.
    slices: usize,
    /// The part of the bank that the last features were compared with.
    references: ReferenceSet,
}

/// A part of the bank.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum ReferenceSet {
    #[default]
    Frontal,
    AllViews,
    MissingViews,
}

impl FeatureSearch {
    /// Describes all surfaces, in the order of their numbers, or loads their descriptions from the
    /// store, and assigns them their anchors. `count`: maximum features of a frame.
    pub fn new<'a>(
        surfaces: impl Iterator<Item = &'a mut PreparedSurface>,
        count: usize,
        store: Option<Arc<dyn ViewStore>>,
        workers: &Workers,
    ) -> Self {
        let mut surfaces: Vec<&mut PreparedSurface> = surfaces.collect();
        let mut builder = BankBuilder::new(surfaces.len(), store, workers);
        let mut banks: Vec<_> = surfaces.iter().map(|surface| builder.bank(surface)).collect();
        for (surface, bank) in surfaces.iter_mut().zip(&mut banks) {
            surface.take_anchors(std::mem::take(&mut bank.anchors));
        }
        let mut search = Self { count, ..Self::default() };
        for (number, (surface, bank)) in surfaces.iter().zip(&banks).enumerate() {
            let copy = PictureCopy::frontal(surface);
            search.frontal.add(number as u32, &bank.frontal, copy.in_artwork(), copy.scale);
        }
        search.all_views = search.frontal.clone();
        for (number, (surface, bank)) in surfaces.iter().zip(&banks).enumerate() {
            let copy = PictureCopy::tilted(surface);
            let views = bank.tilted.iter().zip(view_shapes()).map(|(features, shape)| (features.as_slice(), shape * copy.scale));
            search.all_views.add_views(number as u32, views, copy.in_artwork());
        }
        search
    }

    /// Extracts the features of a frame and matches them with the frontal views. Where `mask` is 0,
    /// no feature is taken.
    pub fn look(&mut self, image: &GrayImage, mask: Option<&GrayImage>, look: Look, workers: &Workers) {
        let options = self.options(look);
        let image = self.contrast.stretched(image).unwrap_or(image);
        self.extractor.extract(image, mask, &options, workers, &mut self.features);
        self.compare(ReferenceSet::Frontal, workers);
    }

    /// Adds features to those of the last frame, as many as `look` allows, and matches again.
    pub fn look_again(&mut self, image: &GrayImage, mask: Option<&GrayImage>, look: Look, workers: &Workers) {
        self.take_more(image, mask, &self.options(look), workers);
        self.compare(ReferenceSet::Frontal, workers);
    }

    /// Matches the last features with all views, including tilted ones.
    pub fn compare_with_all_views(&mut self, workers: &Workers) {
        self.compare(ReferenceSet::AllViews, workers);
    }

    /// Extracts all features of the last frame and matches them with all views.
    pub fn look_closer(&mut self, image: &GrayImage, mask: Option<&GrayImage>, workers: &Workers) {
        self.take_more(image, mask, &self.options(Look::Frontal), workers);
        self.compare(ReferenceSet::AllViews, workers);
    }

    /// Extracts the features of a part of a frame (where `mask` is not 0) and matches them with all
    /// views, to find a second copy of a body that was found.
    pub fn look_for_copies(&mut self, image: &GrayImage, mask: &GrayImage, workers: &Workers) {
        let options = ExtractorOptions { count: self.count.min(QUICK_FEATURES), ..Default::default() };
        self.extractor.extract(image, Some(mask), &options, workers, &mut self.features);
        self.compare(ReferenceSet::AllViews, workers);
    }

    /// Extracts features where the frame is unexplained and matches them with all views of the
    /// missing surfaces (in ascending order of their numbers). The cost per frame is bounded, as
    /// many missing surfaces take turns.
    pub fn look_beside(
        &mut self,
        image: &GrayImage,
        mask: Option<&GrayImage>,
        unexplained: &mut Unexplained,
        missing: impl Iterator<Item = u32> + Clone,
        workers: &Workers,
    ) {
        let is_due = is_due(missing.clone().count(), self.slices);
        let missing = missing.enumerate().filter(|(k, _)| is_due(*k)).map(|(_, surface)| surface);
        self.slices = self.slices.wrapping_add(1);
        if !missing.clone().eq(self.missing.iter().copied()) {
            self.missing.clear();
            self.missing.extend(missing);
            self.missing_views.take_from(&self.all_views, |surface| self.missing.binary_search(&surface).is_ok());
        }
        let entries = self.missing_views.features().len().max(1);
        let count = (TUNING.comparisons_per_slice / entries).clamp(TUNING.min_slice_features, TUNING.max_slice_features).min(self.count);
        // If everything is explained, there is nothing to stretch the contrast of.
        let stretched = if unexplained.is_anything() { self.contrast.stretched(image) } else { None };
        let image = stretched.unwrap_or(image);
        unexplained.extract(image, mask, count, &mut self.extractor, workers, &mut self.features);
        self.compare(ReferenceSet::MissingViews, workers);
    }

    fn options(&self, look: Look) -> ExtractorOptions {
        let all = ExtractorOptions { count: self.count, ..Default::default() };
        let strongest = |count: usize| ExtractorOptions { count: self.count.min(count), largest_px: TUNING.max_quick_width_px, ..all };
        match look {
            Look::Glance => strongest(GLANCE_FEATURES),
            Look::Quick => strongest(QUICK_FEATURES),
            Look::Frontal => all,
        }
    }

    fn take_more(&mut self, image: &GrayImage, mask: Option<&GrayImage>, options: &ExtractorOptions, workers: &Workers) {
        let image = self.contrast.last().unwrap_or(image);
        self.extractor.extract_more(image, mask, options, workers, &mut self.features);
    }

    /// Whether the last features matched enough of a body with these surfaces that more features
    /// would add nothing.
    pub fn is_enough(&self, surfaces: std::ops::Range<u32>) -> bool {
        let reference = self.reference();
        let own = self.matches.iter().filter(|m| surfaces.contains(&reference[m.reference as usize].surface));
        own.count() >= TUNING.sufficient_glance_matches
    }

    fn compare(&mut self, references: ReferenceSet, workers: &Workers) {
        self.references = references;
        let Self { frontal, all_views, missing_views, features, buffers, matches, .. } = self;
        let index = part(references, frontal, all_views, missing_views);
        index.match_features(features, TUNING.lowe_ratio, workers, buffers, matches);
    }

    /// Returns the matches of a body's surfaces, best first.
    pub fn of_body(&self, surfaces: std::ops::Range<u32>, camera: &CameraModel) -> Vec<SurfaceMatch> {
        surface_matches(&self.matches, &self.features, self.reference(), surfaces, camera)
    }

    /// Returns the last frame's features.
    pub fn features(&self) -> &[Feature] {
        &self.features
    }

    /// Returns the reference features that they were matched with.
    fn reference(&self) -> &[ReferenceFeature] {
        part(self.references, &self.frontal, &self.all_views, &self.missing_views).features()
    }
}

/// Returns a test of which of `number` missing surfaces belong to a slice. The first one advances
/// by one more per round, so that the same surfaces do not always meet the same part of the frame.
fn is_due(number: usize, slice: usize) -> impl Fn(usize) -> bool + Clone {
    let round = number.div_ceil(TUNING.max_slice_surfaces).max(1);
    let first = (slice * TUNING.max_slice_surfaces + slice / round) % number.max(1);
    move |k| number <= TUNING.max_slice_surfaces || (k + number - first) % number < TUNING.max_slice_surfaces
}

fn part<'a>(
    references: ReferenceSet,
    frontal: &'a ReferenceIndex,
    all_views: &'a ReferenceIndex,
    missing_views: &'a ReferenceIndex,
) -> &'a ReferenceIndex {
    match references {
        ReferenceSet::Frontal => frontal,
        ReferenceSet::AllViews => all_views,
        ReferenceSet::MissingViews => missing_views,
    }
}

#[cfg(test)]
mod tests {
    use crate::track::scene::surface::SurfaceSpec;
    use crate::track::synthetic::{prepared, texture};
    use nalgebra::{Matrix2, Vector2};

    use super::*;
    use crate::geometry::Pose;

    /// Returns the cloth as seen from far aside: every new column is the mean of a few.
    fn squeezed(picture: &GrayImage, columns: u32) -> GrayImage {
        GrayImage::from_fn(picture.width() / columns, picture.height(), |x, y| {
            let sum: u32 = (0..columns).map(|k| u32::from(picture.get_pixel(columns * x + k, y)[0])).sum();
            image::Luma([(sum / columns) as u8])
        })
    }

    #[test]
    fn many_missing_surfaces_take_turns() {
        assert!((0..5).all(is_due(5, 3)) && !is_due(6, 0)(5));
        for number in [6_usize, 7, 10, 16, 33] {
            // Within two rounds, starting at any slice, each surface has its turn; five per slice.
            let round = number.div_ceil(TUNING.max_slice_surfaces);
            for slice in 0..40 {
                assert!((0..number).all(|k| (slice..slice + 2 * round).any(|slice| is_due(number, slice)(k))), "{number} {slice}");
                assert_eq!((0..number).filter(|k| is_due(number, slice)(*k)).count(), TUNING.max_slice_surfaces);
            }
        }
    }

    #[test]
    fn a_glance_suffices_for_a_clear_view() {
        let [shown, other] = [5, 6].map(|seed| texture(1200, 800, seed));
        let mut body =
            prepared(vec![SurfaceSpec::from_artwork("cloth".into(), shown, [3.0, 2.0], Pose::identity()).expect("texture enough")]);
        let workers = Workers::new(1);
        let mut search = FeatureSearch::new(body.surfaces.iter_mut(), 1500, None, &workers);
        search.look(&body.surfaces[0].octaves[0].image, None, Look::Glance, &workers);
        assert!(search.is_enough(0..1) && !search.is_enough(1..2));
        assert!(search.features().len() <= GLANCE_FEATURES + 8, "{}", search.features().len());
        search.look(&other, None, Look::Glance, &workers);
        assert!(!search.is_enough(0..1), "{} matches", search.matches.len());
        search.look_again(&other, None, Look::Quick, &workers);
        let (features, matches) = (search.features().to_vec(), search.matches.clone());
        search.look(&other, None, Look::Quick, &workers);
        assert!(search.features() == features && search.matches == matches);
    }

    #[test]
    fn a_steep_view_is_recognised_by_a_thorough_search() {
        let artwork = texture(2400, 480, 5);
        let mut body =
            prepared(vec![SurfaceSpec::from_artwork("cloth".into(), artwork, [20.0, 4.0], Pose::identity()).expect("texture enough")]);
        let workers = Workers::new(1);
        let mut search = FeatureSearch::new(body.surfaces.iter_mut(), 1500, None, &workers);
        let picture = &body.surfaces[0].octaves[0].image;
        let columns = 5;
        let frame = squeezed(picture, columns);
        let is_right = |search: &FeatureSearch, m: &Match| {
            let seen = search.features()[m.frame as usize].position;
            let off = search.reference()[m.reference as usize].position - Vector2::new((seen.x + 0.5) * f64::from(columns) - 0.5, seen.y);
            off.x.abs() < 4.0 * f64::from(columns) && off.y.abs() < 4.0
        };
        let right = |search: &FeatureSearch| search.matches.iter().filter(|m| is_right(search, m)).count();
        search.look(&frame, None, Look::Frontal, &workers);
        let frontal = right(&search);
        search.look_closer(&frame, None, &workers);
        let close = right(&search);
        assert!(close >= 30 && close > 3 * frontal, "{close} with tilted views, {frontal} without, of {}", search.features().len());
        // Each single match shows how the picture is squeezed: by five along its rows, not across.
        let squeeze = Matrix2::new(1.0 / f64::from(columns), 0.0, 0.0, 1.0);
        let mut off: Vec<f64> = (search.matches.iter().filter(|m| is_right(&search, m)))
            .map(|m| {
                let shape = search.reference()[m.reference as usize].shape;
                (search.features()[m.frame as usize].shape() * shape.try_inverse().expect("regular") - squeeze).norm()
            })
            .collect();
        off.sort_by(f64::total_cmp);
        assert!(off[off.len() / 2] < 0.2, "{off:?}");
    }
}
