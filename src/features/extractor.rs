//! Extracts the features of a picture: pyramid, corners, orientation, descriptor, with reusable
//! buffers.

use image::GrayImage;
use nalgebra::{Matrix2, Vector2};

use super::corners::{Corner, CornerBuffers, CornerOptions, Polarity, detect_more_corners, polarity};
use super::descriptor::{Descriptor, oriented_descriptor};
use super::open_pixels::{LevelMask, OpenTiles};
use super::pattern::PATCH_RADIUS;
use super::pyramid::{Level, Pyramid};
use super::workers::Workers;

/// A described corner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Feature {
    /// Position in picture pixels.
    pub position: Vector2<f64>,
    /// Picture pixels per pixel of the level it was found on.
    pub scale: f64,
    /// Direction of the intensity centroid, radians, y down.
    pub angle: f32,
    /// Whether it is dark or bright.
    pub polarity: Polarity,
    /// Its descriptor.
    pub descriptor: Descriptor,
}

impl Feature {
    /// Returns the map from its descriptor's axes, in pixels of the level it was found on, to the
    /// picture's.
    pub fn shape(&self) -> Matrix2<f64> {
        let (sin, cos) = f64::from(self.angle).sin_cos();
        Matrix2::new(cos, -sin, sin, cos) * self.scale
    }
}

/// Options of feature extraction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExtractorOptions {
    /// Maximum number of features, over all levels.
    pub count: usize,
    /// Size ratio of one level to the next, above 1.
    pub factor: f64,
    /// Maximum number of levels.
    pub levels: usize,
    /// Maximum width or height of a level, pixels; larger ones, which hold most of the pixels, are
    /// skipped.
    pub largest_px: u32,
    /// Initial FAST contrast, grey levels.
    pub threshold: u8,
    /// Minimum FAST contrast, for dim pictures.
    pub least_threshold: u8,
    /// Distribution of features over the levels: 1 in proportion to area, 0 equal numbers.
    pub area_power: f64,
}

impl Default for ExtractorOptions {
    fn default() -> Self {
        Self { count: 1500, factor: 1.2, levels: 8, largest_px: u32::MAX, threshold: 20, least_threshold: 6, area_power: 0.5 }
    }
}

/// Width of a level's border without features, so that no descriptor reaches outside: follows from
/// [`describe`](super::descriptor::describe).
pub(super) const BORDER: u32 = PATCH_RADIUS as u32 + 2;

#[derive(Debug, Default)]
struct LevelWork {
    buffers: CornerBuffers,
    corners: Vec<Corner>,
    quota: usize,
    index: usize,
}

/// Finds and describes features; reuses its buffers.
#[derive(Debug, Default)]
pub struct FeatureExtractor {
    pyramid: Pyramid,
    tiles: OpenTiles,
    /// Coarsest level first: it costs least, and shows the others which contrast yields enough
    /// corners.
    work: Vec<LevelWork>,
    /// Shares its learnt contrast with the buffers of all levels; not used to search itself.
    alike: CornerBuffers,
    jobs: Vec<(usize, Corner)>,
}

impl FeatureExtractor {
    /// Fills `features` with those of a picture, except where `mask` (same size) is 0.
    pub fn extract(
        &mut self,
        picture: &GrayImage,
        mask: Option<&GrayImage>,
        options: &ExtractorOptions,
        workers: &Workers,
        features: &mut Vec<Feature>,
    ) {
        self.pyramid.shrink(picture, options.factor, options.levels, 2 * BORDER + 8);
        self.work.iter_mut().for_each(|work| work.buffers.forget_picture());
        mask.into_iter().for_each(|mask| self.tiles.update(mask));
        self.extract_more(picture, mask, options, workers, features);
    }

    /// Like [`extract`](Self::extract) on the last picture and mask, with another count or other
    /// levels: keeps the levels and what was found on them.
    pub fn extract_more(
        &mut self,
        picture: &GrayImage,
        mask: Option<&GrayImage>,
        options: &ExtractorOptions,
        workers: &Workers,
        features: &mut Vec<Feature>,
    ) {
        let is_wanted = |level: &Level| level.image.width().max(level.image.height()) <= options.largest_px;
        let finest = self.pyramid.levels().iter().position(is_wanted).unwrap_or(self.pyramid.levels().len() - 1);
        let levels = self.pyramid.smooth_from(finest, picture);
        let alike = &self.alike;
        self.work.resize_with(levels.len(), || LevelWork { buffers: CornerBuffers::alike(alike), ..Default::default() });
        let share = |level: &Level| (level.scale[0] * level.scale[1]).powf(options.area_power);
        let wanted = || levels.iter().enumerate().skip(finest);
        let total: f64 = wanted().map(|(_, level)| share(level)).sum();
        let work = &mut self.work[..levels.len() - finest];
        for (work, (index, level)) in work.iter_mut().zip(wanted().rev()) {
            work.index = index;
            work.quota = (options.count as f64 * share(level) / total).round() as usize;
        }
        let tiles = &self.tiles;
        workers.for_each(work, |work| {
            let level = &levels[work.index];
            let corner_options = CornerOptions {
                count: work.quota,
                threshold: options.threshold,
                least_threshold: options.least_threshold,
                border: BORDER,
                cell_px: 40,
            };
            let mask = mask.map(|mask| LevelMask { mask, tiles, level });
            detect_more_corners(&level.image, &corner_options, mask.as_ref(), &mut work.buffers, &mut work.corners);
        });
        self.jobs.clear();
        for work in work.iter().rev() {
            self.jobs.extend(work.corners.iter().map(|c| (work.index, *c)));
        }
        workers.map_into(&self.jobs, features, |(k, corner)| described(&levels[*k], corner));
    }
}

fn described(level: &Level, corner: &Corner) -> Feature {
    let (angle, descriptor) = oriented_descriptor(&level.smooth, corner.x, corner.y);
    let [x, y] = level.in_picture(f64::from(corner.x), f64::from(corner.y));
    Feature {
        position: Vector2::new(x, y),
        scale: 1.0 / level.scale[0],
        angle,
        polarity: polarity(&level.image, corner.x, corner.y),
        descriptor,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture() -> GrayImage {
        GrayImage::from_fn(320, 240, |x, y| {
            let cell = (x / 13).wrapping_mul(2654435761) ^ (y / 11).wrapping_mul(40503).wrapping_mul(2246822519);
            image::Luma([(cell >> 13) as u8])
        })
    }

    #[test]
    fn workers_do_not_change_the_features() {
        let options = ExtractorOptions { count: 400, ..Default::default() };
        let (mut one, mut two) = (Vec::new(), Vec::new());
        FeatureExtractor::default().extract(&picture(), None, &options, &Workers::new(1), &mut one);
        FeatureExtractor::default().extract(&picture(), None, &options, &Workers::new(2), &mut two);
        assert!(one.len() > 200, "{}", one.len());
        assert_eq!(one, two);
    }

    #[test]
    fn asking_for_more_features_matches_a_fresh_extraction() {
        let few = ExtractorOptions { count: 100, largest_px: 200, ..Default::default() };
        let many = ExtractorOptions { count: 700, ..Default::default() };
        let mut mask = GrayImage::from_pixel(320, 240, image::Luma([255]));
        (0..60).for_each(|x| mask.put_pixel(x, 100, image::Luma([0])));
        let (mut more, mut fresh, mut extractor) = (Vec::new(), Vec::new(), FeatureExtractor::default());
        extractor.extract(&picture(), Some(&mask), &few, &Workers::new(1), &mut more);
        assert!(more.len() > 50 && more.iter().all(|f| f.scale >= 320.0 / 200.0), "{}", more.len());
        extractor.extract_more(&picture(), Some(&mask), &many, &Workers::new(1), &mut more);
        FeatureExtractor::default().extract(&picture(), Some(&mask), &many, &Workers::new(1), &mut fresh);
        assert!(more.len() > 300, "{}", more.len());
        assert_eq!(more, fresh);
    }

    #[test]
    fn buffers_left_from_another_size_do_no_harm() {
        let options = ExtractorOptions { count: 400, ..Default::default() };
        let mut extractor = FeatureExtractor::default();
        let (mut fresh, mut reused) = (Vec::new(), Vec::new());
        extractor.extract(&GrayImage::new(640, 480), None, &options, &Workers::new(1), &mut reused);
        extractor.extract(&picture(), None, &options, &Workers::new(1), &mut reused);
        FeatureExtractor::default().extract(&picture(), None, &options, &Workers::new(1), &mut fresh);
        assert_eq!(fresh, reused);
    }

    #[test]
    fn a_black_mask_leaves_nothing() {
        let mut features = Vec::new();
        let mask = GrayImage::new(320, 240);
        FeatureExtractor::default().extract(&picture(), Some(&mask), &ExtractorOptions::default(), &Workers::new(1), &mut features);
        assert!(features.is_empty());
    }
}
