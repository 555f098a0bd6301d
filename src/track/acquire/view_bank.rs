//! The bank of views: each reference picture described once, at the start, as cameras see it from all sides.
//!
//! A picture's bank has two parts: the picture as it is, which cameras up to 60 degrees from its normal recognise, and as tilted cameras see it,
//! out to 80 degrees; beside them are its anchors, the places where it is registered. It follows from the picture alone, and takes half a second;
//! so whoever builds a tracker may keep its bytes from one start to the next ([`ViewStore`]). A bank that was kept is the one that would be
//! computed: its [`BankKey`] is a digest of all that it follows from, and whatever does not read as the bank of that key is computed anew.

use std::hash::{DefaultHasher, Hasher};
use std::sync::Arc;

use image::GrayImage;
use nalgebra::{Matrix2, Vector2};
use tracing::debug;

use crate::features::{Descriptor, ExtractorOptions, Feature, FeatureExtractor, Polarity, TiltedViews, Workers, append_tilted_features};
use crate::track::scene::reference::{ANCHOR_BORDER, ANCHORS, Anchor, PreparedSurface, octave_count};

/// Reference features of all surfaces together, and of one at least. Chosen, not tuned. Raised, matching costs more in proportion; lowered,
/// fewer features of a stage that is seen in part or small are among them.
const REFERENCE_FEATURES: usize = 4000;
const MIN_REFERENCE_FEATURES: usize = 700;
/// The same of the tilted views, and of one view at least. Chosen, not tuned: a close look takes three times as long as one at the pictures as
/// they are. Raised, it takes longer; lowered, steep views of a stage that is partly covered are not recognised.
const TILTED_FEATURES: usize = 8000;
const MIN_TILTED_FEATURES: usize = 60;
/// Artwork is looked at for features at no more than this many pixels across, or down where it is higher: no camera resolves more. Raised,
/// features are spent on detail that no frame shows; lowered, close views find fewer.
const MAX_REFERENCE_PX: u32 = 2000;
/// The same for tilted views, which no frame shows as large. Raised, the start takes longer by the square.
const MAX_TILTED_PX: u32 = 1300;
/// Tilted views that are simulated. Descriptors bear a tilt of two from one view to another, and so do these among each other; the last reaches
/// beyond 80 degrees (a tilt of 5.8). More of one tilt: longitudes in between are recognised better, and the start takes longer.
const VIEWS: [TiltedViews; 3] =
    [TiltedViews { tilt: 2.0, count: 5 }, TiltedViews { tilt: 3.4, count: 8 }, TiltedViews { tilt: 5.5, count: 11 }];
/// From the shapes of each tilted view to the picture's, in the order of the views.
pub fn view_shapes() -> impl Iterator<Item = Matrix2<f64>> {
    VIEWS.into_iter().flat_map(|views| (0..views.count).map(move |number| views.shape_in_picture(number)))
}

/// Levels of a reference picture: a factor of 15 in scale (1.2 a level). Lowered, stages that are seen small are not recognised.
const LEVELS: usize = 16;

/// Keeps the banks of pictures from one start to the next. The core gives and takes bytes; where they are is up to whoever builds a tracker.
pub trait ViewStore: std::fmt::Debug + Send + Sync {
    /// The bytes kept under this name, where they are still there. What happened to them meanwhile is noticed.
    fn load(&self, name: &str) -> Option<Vec<u8>>;
    /// Keeps bytes under a name, 32 digits of base 16. Where it cannot, the next start takes longer.
    fn store(&self, name: &str, bytes: &[u8]);
}

/// The bank of one picture. Features are in pixels of the copy that they were taken of.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewBank {
    /// Of the picture as it is.
    pub frontal: Vec<Feature>,
    /// Of its tilted views, a list for each.
    pub tilted: Vec<Vec<Feature>>,
    /// The anchors of each octave of the picture.
    pub anchors: Vec<Vec<Anchor>>,
}

/// A copy of a surface's picture, halved as often as it takes to be no larger than some bound.
#[derive(Debug, Clone, Copy)]
pub struct PictureCopy<'a> {
    image: &'a GrayImage,
    /// Artwork pixels to one of its.
    pub scale: f64,
}

impl<'a> PictureCopy<'a> {
    /// The one that the picture is described by as it is.
    pub fn frontal(surface: &'a PreparedSurface) -> Self {
        Self::up_to(surface, MAX_REFERENCE_PX)
    }

    /// The one that its tilted views are made of.
    pub fn tilted(surface: &'a PreparedSurface) -> Self {
        Self::up_to(surface, MAX_TILTED_PX)
    }

    fn up_to(surface: &'a PreparedSurface, largest_px: u32) -> Self {
        let fits = |k: &usize| surface.octaves[*k].image.width().max(surface.octaves[*k].image.height()) <= largest_px;
        let octave = (0..surface.octaves.len()).find(fits).unwrap_or(surface.octaves.len() - 1);
        Self { image: &surface.octaves[octave].image, scale: f64::from(1u32 << octave) }
    }

    /// From its pixels to the artwork's.
    pub fn in_artwork(self) -> impl Fn(Vector2<f64>) -> Vector2<f64> {
        let half = Vector2::new(0.5, 0.5);
        move |p| (p + half) * self.scale - half
    }
}

/// Describes pictures, or takes what was kept of them; keeps its buffers.
#[derive(Debug)]
pub struct BankBuilder<'a> {
    /// Features wanted of a picture as it is, and of each of its views.
    counts: [usize; 2],
    store: Option<Arc<dyn ViewStore>>,
    workers: &'a Workers,
    extractor: FeatureExtractor,
}

impl<'a> BankBuilder<'a> {
    /// `pictures`: how many share the features that are wanted in all. Without a store every bank is computed.
    pub fn new(pictures: usize, store: Option<Arc<dyn ViewStore>>, workers: &'a Workers) -> Self {
        let views: usize = VIEWS.iter().map(|v| v.count).sum();
        let pictures = pictures.max(1);
        let counts =
            [(REFERENCE_FEATURES / pictures).max(MIN_REFERENCE_FEATURES), (TILTED_FEATURES / pictures / views).max(MIN_TILTED_FEATURES)];
        Self { counts, store, workers, extractor: FeatureExtractor::default() }
    }

    /// The bank of a surface's picture.
    pub fn bank(&mut self, surface: &PreparedSurface) -> ViewBank {
        let Some(store) = self.store.clone() else { return self.described(surface) };
        let artwork = &surface.octaves[0].image;
        let key = BankKey::of(artwork, self.counts);
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
        let [frontal, tilted] = counts.map(|count| ExtractorOptions { count, levels: LEVELS, area_power: 0.35, ..Default::default() });
        let mut bank = ViewBank { frontal: Vec::new(), tilted: Vec::new(), anchors: surface.find_anchors() };
        extractor.extract(PictureCopy::frontal(surface).image, None, &frontal, workers, &mut bank.frontal);
        for views in VIEWS {
            append_tilted_features(PictureCopy::tilted(surface).image, views, &tilted, extractor, workers, &mut bank.tilted);
        }
        bank
    }
}

/// What a bank follows from, as a digest.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct BankKey([u8; KEY_BYTES]);

/// Bytes of a digest.
const KEY_BYTES: usize = 16;
/// How a bank's bytes begin.
const MAGIC: &[u8; 8] = b"SPVIEWS\n";
/// Of the form of the bytes.
const VERSION: u32 = 4;
/// Bytes of a feature: place, scale, angle, descriptor and polarity (0 dark, 1 bright).
const FEATURE_BYTES: usize = 3 * 8 + 4 + 4 * 8 + 1;
/// Bytes of an anchor: column and row of its octave.
const ANCHOR_BYTES: usize = 2 * 4;

/// The source code of all that makes a bank, with the constants of this file. A changed algorithm changes the keys by itself; nobody has to raise a version.
const SOURCES: [&str; 11] = [
    include_str!("view_bank.rs"),
    include_str!("../scene/reference.rs"),
    include_str!("../../features/corners.rs"),
    include_str!("../../features/descriptor.rs"),
    include_str!("../../features/extractor.rs"),
    include_str!("../../features/float_image.rs"),
    include_str!("../../features/kernels.rs"),
    include_str!("../../features/pattern.rs"),
    include_str!("../../features/pyramid.rs"),
    include_str!("../../features/tilted_view.rs"),
    include_str!("../../features/view_simulation.rs"),
];

impl BankKey {
    fn of(artwork: &GrayImage, counts: [usize; 2]) -> Self {
        let numbers: Vec<u8> = counts.iter().flat_map(|count| (*count as u64).to_le_bytes()).collect();
        let [width, height] = [artwork.width(), artwork.height()].map(u32::to_le_bytes);
        let version = env!("CARGO_PKG_VERSION").as_bytes();
        let sources = SOURCES.iter().map(|source| source.as_bytes());
        Self(digest(sources.chain([version, &numbers, &width, &height, artwork.as_raw()])))
    }

    fn name(&self) -> String {
        self.0.iter().map(|byte| format!("{byte:02x}")).collect()
    }
}

impl ViewBank {
    /// Magic, version, key, both lists of features and those of each octave's anchors (their number, then each), and the digest of all that; numbers
    /// little-endian.
    fn to_bytes(&self, key: &BankKey) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(128 + (self.frontal.len() + self.tilted.len()) * FEATURE_BYTES);
        bytes.extend_from_slice(MAGIC);
        bytes.extend_from_slice(&VERSION.to_le_bytes());
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

    /// The bank of this key; none where the bytes are not what [`to_bytes`](Self::to_bytes) gave. `size`: of the artwork.
    fn from_bytes(bytes: &[u8], key: &BankKey, size: (u32, u32)) -> Option<Self> {
        let (content, own_digest) = bytes.split_last_chunk::<KEY_BYTES>()?;
        let is_whole = digest([content]) == *own_digest;
        let mut rest = content.strip_prefix(MAGIC)?.strip_prefix(&VERSION.to_le_bytes())?.strip_prefix(&key.0)?;
        let frontal = take_features(&mut rest, size)?;
        let tilted = view_shapes().map(|_| take_features(&mut rest, size)).collect::<Option<_>>()?;
        let anchors = (0..octave_count(size)).map(|octave| take_anchors(&mut rest, size, octave)).collect::<Option<_>>()?;
        let bank = Self { frontal, tilted, anchors };
        (is_whole && rest.is_empty()).then_some(bank)
    }
}

/// A digest of parts and of their lengths: the standard library's hash (SipHash) from two beginnings. It tells what differs or was damaged by chance, not what was forged:
/// whoever may write to the store may write to the program. Another version of the library may hash otherwise; then banks are computed anew.
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

/// Takes a list of features from the front.
fn take_features(rest: &mut &[u8], size: (u32, u32)) -> Option<Vec<Feature>> {
    let (count, after) = rest.split_first_chunk::<4>()?;
    let length = (u32::from_le_bytes(*count) as usize).checked_mul(FEATURE_BYTES)?;
    let (own, after) = after.split_at_checked(length)?;
    *rest = after;
    own.chunks_exact(FEATURE_BYTES).map(|bytes| feature(bytes, size)).collect()
}

/// Takes the anchors of an octave from the front; none where the octave of a picture of that size cannot have them.
fn take_anchors(rest: &mut &[u8], (width, height): (u32, u32), octave: usize) -> Option<Vec<Anchor>> {
    let (count, after) = rest.split_first_chunk::<4>()?;
    let count = Some(u32::from_le_bytes(*count) as usize).filter(|count| *count <= ANCHORS)?;
    let (own, after) = after.split_at_checked(count * ANCHOR_BYTES)?;
    *rest = after;
    let sides = [width >> octave, height >> octave];
    let is_inside = |place: u32, side: u32| place >= ANCHOR_BORDER && place.saturating_add(ANCHOR_BORDER) < side;
    own.as_chunks::<ANCHOR_BYTES>()
        .0
        .iter()
        .map(|bytes| {
            let [x, y] = [bytes.first_chunk()?, bytes.last_chunk()?].map(|place| u32::from_le_bytes(*place));
            (is_inside(x, sides[0]) && is_inside(y, sides[1])).then(|| Anchor::at([x, y], octave))
        })
        .collect()
}

/// A feature; none that no picture of that size has.
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
