//! The bank of views: descriptions of each reference picture as cameras see it from all sides,
//! computed once at the start.
//!
//! A picture's bank has the features of the picture seen frontally, which cameras up to 60 degrees
//! from its normal recognise; the features of tilted views, out to 80 degrees; and its anchors, the
//! places at which it is registered. It depends on the picture alone and takes half a second, so
//! the creator of a tracker may keep its bytes from one start to the next ([`ViewStore`]). A stored
//! bank is identical to a computed one: its [`BankKey`] is a digest of everything that it depends
//! on, and anything that does not parse as the bank of that key is recomputed.

use crate::track::acquire::tuning::TUNING;
use crate::track::scene::tuning::TUNING as SCENE_TUNING;
use std::hash::{DefaultHasher, Hasher};
use std::sync::Arc;

use image::GrayImage;
use nalgebra::{Matrix2, Vector2};
use tracing::debug;

use crate::features::{Descriptor, ExtractorOptions, Feature, FeatureExtractor, Polarity, TiltedViews, Workers, append_tilted_features};
use crate::light::Transfer;
use crate::track::scene::reference::{Anchor, PreparedSurface, octave_count};

/// Simulated tilted views: tilt and number of longitudes. More of one tilt: longitudes in between
/// are recognised better, and the start takes longer.
const VIEWS: [TiltedViews; 3] =
    [TiltedViews { tilt: 2.0, count: 5 }, TiltedViews { tilt: 3.4, count: 8 }, TiltedViews { tilt: 5.5, count: 11 }];
/// Returns the maps from the shapes of each tilted view to the picture's, in the order of the
/// views.
pub fn view_shapes() -> impl Iterator<Item = Matrix2<f64>> {
    VIEWS.into_iter().flat_map(|views| (0..views.count).map(move |number| views.shape_in_picture(number)))
}

/// Stores banks of pictures from one start to the next. The core exchanges bytes; the creator of a
/// tracker decides where they are.
pub trait ViewStore: std::fmt::Debug + Send + Sync {
    /// Returns the bytes stored under this name, if any. Damaged bytes are detected by the caller.
    fn load(&self, name: &str) -> Option<Vec<u8>>;
    /// Stores bytes under a name of 32 hexadecimal digits. On failure, the next start takes longer.
    fn store(&self, name: &str, bytes: &[u8]);
}

/// The bank of one picture. Features are in pixels of the copy from which they were taken.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewBank {
    /// Features of the frontal view.
    pub frontal: Vec<Feature>,
    /// Features of each tilted view.
    pub tilted: Vec<Vec<Feature>>,
    /// Anchors of each octave of the picture.
    pub anchors: Vec<Vec<Anchor>>,
}

/// A copy of a surface's picture, halved until it fits a maximum size.
#[derive(Debug, Clone, Copy)]
pub struct PictureCopy<'a> {
    image: &'a GrayImage,
    /// Artwork pixels per pixel of the copy.
    pub scale: f64,
}

impl<'a> PictureCopy<'a> {
    /// Returns the copy for frontal features.
    pub fn frontal(surface: &'a PreparedSurface) -> Self {
        Self::up_to(surface, TUNING.max_reference_px)
    }

    /// Returns the copy for tilted views.
    pub fn tilted(surface: &'a PreparedSurface) -> Self {
        Self::up_to(surface, TUNING.max_tilted_px)
    }

    fn up_to(surface: &'a PreparedSurface, largest_px: u32) -> Self {
        let fits = |k: &usize| surface.octaves[*k].image.width().max(surface.octaves[*k].image.height()) <= largest_px;
        let octave = (0..surface.octaves.len()).find(fits).unwrap_or(surface.octaves.len() - 1);
        Self { image: &surface.octaves[octave].image, scale: f64::from(1u32 << octave) }
    }

    /// Returns the map from its pixels to the artwork's.
    pub fn in_artwork(self) -> impl Fn(Vector2<f64>) -> Vector2<f64> {
        let half = Vector2::new(0.5, 0.5);
        move |p| (p + half) * self.scale - half
    }
}

/// Describes pictures, or loads their stored descriptions; keeps its buffers.
#[derive(Debug)]
pub struct BankBuilder<'a> {
    /// Maximum features of a frontal view, and of each tilted view.
    counts: [usize; 2],
    store: Option<Arc<dyn ViewStore>>,
    workers: &'a Workers,
    extractor: FeatureExtractor,
}

impl<'a> BankBuilder<'a> {
    /// Creates a builder. `pictures`: number of pictures that share the total number of features.
    /// Without a store every bank is computed.
    pub fn new(pictures: usize, store: Option<Arc<dyn ViewStore>>, workers: &'a Workers) -> Self {
        let views: usize = VIEWS.iter().map(|v| v.count).sum();
        let pictures = pictures.max(1);
        let counts = [
            (TUNING.max_reference_features / pictures).max(TUNING.min_surface_features),
            (TUNING.max_tilted_features / pictures / views).max(TUNING.min_tilted_view_features),
        ];
        Self { counts, store, workers, extractor: FeatureExtractor::default() }
    }

    /// Returns the bank of a surface's picture.
    pub fn bank(&mut self, surface: &PreparedSurface) -> ViewBank {
        let Some(store) = self.store.clone() else { return self.described(surface) };
        let artwork = &surface.octaves[0].image;
        let key = BankKey::of(artwork, surface.spec.transfer, self.counts);
        let kept = store.load(&key.name()).and_then(|bytes| ViewBank::from_bytes(&bytes, &key, artwork.dimensions()));
        debug!(surface = %surface.spec.name, is_kept = kept.is_some(), "bank of views");
        kept.unwrap_or_else(|| {
            let bank = self.described(surface);
            store.store(&key.name(), &bank.to_bytes(&key));
            bank
        })
    }

    fn described(&mut self, surface: &PreparedSurface) -> ViewBank {
        let Self { counts, workers, extractor, .. } = self;
        let [frontal, tilted] =
            counts.map(|count| ExtractorOptions { count, levels: TUNING.reference_levels, area_power: 0.35, ..Default::default() });
        let mut bank = ViewBank { frontal: Vec::new(), tilted: Vec::new(), anchors: surface.find_anchors() };
        extractor.extract(PictureCopy::frontal(surface).image, None, &frontal, workers, &mut bank.frontal);
        for views in VIEWS {
            append_tilted_features(PictureCopy::tilted(surface).image, views, &tilted, extractor, workers, &mut bank.tilted);
        }
        bank
    }
}

/// Digest of everything that a bank depends on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct BankKey([u8; KEY_BYTES]);

/// Bytes of a digest. Raised, files grow; lowered, collisions become likelier.
const KEY_BYTES: usize = 16;
/// First bytes of a bank's file.
const MAGIC: &[u8; 8] = b"SPVIEWS\n";
/// Version of the byte format; raise it when the format changes.
const BANK_VERSION: u32 = 4;
/// Bytes of a feature: place, scale, angle, descriptor and polarity (0 dark, 1 bright).
const FEATURE_BYTES: usize = 3 * 8 + 4 + 4 * 8 + 1;
/// Bytes of an anchor: column and row of its octave.
const ANCHOR_BYTES: usize = 2 * 4;

/// The source code of everything that computes a bank, including its constants. A
/// changed algorithm changes the keys by itself, without raising a version.
const SOURCES: [&str; 14] = [
    include_str!("tuning.rs"),
    include_str!("view_bank.rs"),
    include_str!("../scene/reference.rs"),
    include_str!("../scene/tuning.rs"),
    include_str!("../../features/corners.rs"),
    include_str!("../../features/descriptor.rs"),
    include_str!("../../features/extractor.rs"),
    include_str!("../../features/float_image.rs"),
    include_str!("../../features/kernels.rs"),
    include_str!("../../features/pattern.rs"),
    include_str!("../../features/pyramid.rs"),
    include_str!("../../features/simulated_view.rs"),
    include_str!("../../features/tilted_view.rs"),
    include_str!("../../light/square_root.rs"),
];

impl BankKey {
    fn of(artwork: &GrayImage, transfer: Transfer, counts: [usize; 2]) -> Self {
        let numbers: Vec<u8> = counts.iter().flat_map(|count| (*count as u64).to_le_bytes()).collect();
        let [width, height] = [artwork.width(), artwork.height()].map(u32::to_le_bytes);
        let version = env!("CARGO_PKG_VERSION").as_bytes();
        let sources = SOURCES.iter().map(|source| source.as_bytes());
        Self(digest(sources.chain([version, &numbers, &[u8::from(transfer.is_root())], &width, &height, artwork.as_raw()])))
    }

    fn name(&self) -> String {
        self.0.iter().map(|byte| format!("{byte:02x}")).collect()
    }
}

impl ViewBank {
    /// Serialises magic, version, key, both lists of features, the anchors of each octave (count,
    /// then items) and the digest of all that; numbers are little-endian.
    fn to_bytes(&self, key: &BankKey) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(128 + (self.frontal.len() + self.tilted.len()) * FEATURE_BYTES);
        bytes.extend_from_slice(MAGIC);
        bytes.extend_from_slice(&BANK_VERSION.to_le_bytes());
        bytes.extend_from_slice(&key.0);
        for list in std::iter::once(&self.frontal).chain(&self.tilted) {
            bytes.extend_from_slice(&(list.len() as u32).to_le_bytes());
            list.iter().for_each(|feature| append_feature(feature, &mut bytes));
        }
        for (octave, anchors) in self.anchors.iter().enumerate() {
            bytes.extend_from_slice(&(anchors.len() as u32).to_le_bytes());
            let pixels = anchors.iter().flat_map(|anchor| anchor.pixel(octave));
            pixels.for_each(|place| bytes.extend_from_slice(&place.to_le_bytes()));
        }
        let digest = digest([bytes.as_slice()]);
        bytes.extend_from_slice(&digest);
        bytes
    }

    /// Parses the bank of this key; `None` unless the bytes are what [`to_bytes`](Self::to_bytes)
    /// returned. `size`: of the artwork.
    fn from_bytes(bytes: &[u8], key: &BankKey, size: (u32, u32)) -> Option<Self> {
        let (content, own_digest) = bytes.split_last_chunk::<KEY_BYTES>()?;
        let is_whole = digest([content]) == *own_digest;
        let mut rest = content.strip_prefix(MAGIC)?.strip_prefix(&BANK_VERSION.to_le_bytes())?.strip_prefix(&key.0)?;
        let frontal = take_features(&mut rest, size)?;
        let tilted = view_shapes().map(|_| take_features(&mut rest, size)).collect::<Option<_>>()?;
        let anchors = (0..octave_count(size)).map(|octave| take_anchors(&mut rest, size, octave)).collect::<Option<_>>()?;
        let bank = Self { frontal, tilted, anchors };
        (is_whole && rest.is_empty()).then_some(bank)
    }
}

/// Returns a digest of parts and their lengths: the standard library's hash (SipHash) with two
/// different prefixes. It detects differences and accidental damage, not forgery: whoever can write
/// to the store can write to the program. Another library version may hash differently; then banks
/// are recomputed.
fn digest<'a>(parts: impl IntoIterator<Item = &'a [u8]>) -> [u8; KEY_BYTES] {
    let mut halves = [DefaultHasher::new(), DefaultHasher::new()];
    halves[1].write_u8(1);
    for part in parts {
        for half in &mut halves {
            half.write_u64(part.len() as u64);
            half.write(part);
        }
    }
    let mut bytes = [0; KEY_BYTES];
    let (first, second) = bytes.split_at_mut(8);
    first.copy_from_slice(&halves[0].finish().to_le_bytes());
    second.copy_from_slice(&halves[1].finish().to_le_bytes());
    bytes
}

fn append_feature(feature: &Feature, bytes: &mut Vec<u8>) {
    for number in [feature.position.x, feature.position.y, feature.scale] {
        bytes.extend_from_slice(&number.to_le_bytes());
    }
    bytes.extend_from_slice(&feature.angle.to_le_bytes());
    feature.descriptor.0.iter().for_each(|word| bytes.extend_from_slice(&word.to_le_bytes()));
    bytes.push(u8::from(feature.polarity == Polarity::Bright));
}

/// Parses a list of features from the front.
fn take_features(rest: &mut &[u8], size: (u32, u32)) -> Option<Vec<Feature>> {
    let (count, after) = rest.split_first_chunk::<4>()?;
    let length = (u32::from_le_bytes(*count) as usize).checked_mul(FEATURE_BYTES)?;
    let (own, after) = after.split_at_checked(length)?;
    *rest = after;
    own.chunks_exact(FEATURE_BYTES).map(|bytes| feature(bytes, size)).collect()
}

/// Parses the anchors of an octave from the front; `None` if the octave of a picture of that size
/// cannot have them.
fn take_anchors(rest: &mut &[u8], (width, height): (u32, u32), octave: usize) -> Option<Vec<Anchor>> {
    let (count, after) = rest.split_first_chunk::<4>()?;
    let count = Some(u32::from_le_bytes(*count) as usize).filter(|count| *count <= SCENE_TUNING.max_octave_anchors)?;
    let (own, after) = after.split_at_checked(count * ANCHOR_BYTES)?;
    *rest = after;
    let sides = [width >> octave, height >> octave];
    let is_inside =
        |place: u32, side: u32| place >= SCENE_TUNING.anchor_border_px && place.saturating_add(SCENE_TUNING.anchor_border_px) < side;
    own.as_chunks::<ANCHOR_BYTES>()
        .0
        .iter()
        .map(|bytes| {
            let [x, y] = [bytes.first_chunk()?, bytes.last_chunk()?].map(|place| u32::from_le_bytes(*place));
            (is_inside(x, sides[0]) && is_inside(y, sides[1])).then(|| Anchor::at([x, y], octave))
        })
        .collect()
}

/// Parses a feature; `None` if no picture of that size can have it.
fn feature(bytes: &[u8], (width, height): (u32, u32)) -> Option<Feature> {
    let number = |k: usize| Some(f64::from_le_bytes(*bytes.get(8 * k..)?.first_chunk()?));
    let word = |k: usize| Some(u64::from_le_bytes(*bytes.get(28 + 8 * k..)?.first_chunk()?));
    let [x, y, scale] = [number(0)?, number(1)?, number(2)?];
    let angle = f32::from_le_bytes(*bytes.get(24..)?.first_chunk()?);
    let is_inside = (0.0..f64::from(width)).contains(&x) && (0.0..f64::from(height)).contains(&y);
    let is_sized = scale > 0.0 && scale <= f64::from(width.max(height)) && angle.is_finite();
    let descriptor = Descriptor([word(0)?, word(1)?, word(2)?, word(3)?]);
    let polarity = match bytes.get(60)? {
        0 => Polarity::Dark,
        1 => Polarity::Bright,
        _ => return None,
    };
    (is_inside && is_sized).then_some(Feature { position: Vector2::new(x, y), scale, angle, polarity, descriptor })
}

#[cfg(test)]
#[path = "view_bank_tests.rs"]
mod tests;
