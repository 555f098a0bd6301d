use std::collections::BTreeMap;
use std::sync::Mutex;

use proptest::prelude::*;

use super::*;
use crate::light::Transfer;
use crate::track::scene::reference::PreparedBody;
use crate::track::scene::surface::SurfaceSpec;
use crate::track::synthetic::{cloth, prepared};

/// Stores banks in memory, and records what was requested.
#[derive(Debug, Default)]
struct Memory {
    kept: Mutex<BTreeMap<String, Vec<u8>>>,
    stored: Mutex<usize>,
}

impl ViewStore for Memory {
    fn load(&self, name: &str) -> Option<Vec<u8>> {
        self.kept.lock().unwrap().get(name).cloned()
    }

    fn store(&self, name: &str, bytes: &[u8]) {
        *self.stored.lock().unwrap() += 1;
        self.kept.lock().unwrap().insert(name.to_owned(), bytes.to_owned());
    }
}

impl Memory {
    fn bytes(&self) -> Vec<Vec<u8>> {
        self.kept.lock().unwrap().values().cloned().collect()
    }

    fn stored(&self) -> usize {
        *self.stored.lock().unwrap()
    }
}

fn small_cloth(seed: u32) -> PreparedBody {
    let spec = cloth(seed);
    let artwork = image::imageops::crop_imm(&spec.artwork, 0, 0, 240, 180).to_image();
    prepared(vec![SurfaceSpec { artwork, ..spec }])
}

fn bank(body: &PreparedBody, pictures: usize, store: Option<&Arc<Memory>>) -> ViewBank {
    let workers = Workers::new(1);
    let store = store.map(|store| Arc::clone(store) as Arc<dyn ViewStore>);
    BankBuilder::new(pictures, store, &workers).bank(&body.surfaces[0])
}

#[test]
fn a_kept_bank_is_the_computed_one_to_the_bit() {
    let (body, store) = (small_cloth(3), Arc::new(Memory::default()));
    let computed = bank(&body, 1, None);
    assert!(computed.frontal.len() > 100 && computed.tilted.iter().map(Vec::len).sum::<usize>() > 100);
    assert_eq!(computed.anchors.len(), body.surfaces[0].octaves.len());
    assert!(computed.anchors[0].len() > 100 && !computed.anchors[1].is_empty());
    assert_eq!(bank(&body, 1, Some(&store)), computed);
    let cold = store.bytes();
    assert_eq!(bank(&body, 1, Some(&store)), computed);
    assert_eq!((store.bytes(), store.stored()), (cold, 1));
}

#[test]
fn banks_of_other_pictures_and_sizes_are_cached_separately() {
    let store = Arc::new(Memory::default());
    for (seed, pictures) in [(3, 1), (3, 4), (4, 1)] {
        let body = small_cloth(seed);
        assert_eq!(bank(&body, pictures, Some(&store)), bank(&body, pictures, None));
    }
    assert_eq!((store.bytes().len(), store.stored()), (3, 3));
    // One grey level makes a different picture, and so do the same pixels in rows of another
    // length.
    let [plain, wide] = [(8, 6), (6, 8)].map(|(width, height)| GrayImage::new(width, height));
    let mut spotted = plain.clone();
    spotted.put_pixel(7, 5, image::Luma([1]));
    let keys = [&plain, &wide, &spotted].map(|picture| BankKey::of(picture, Transfer::Srgb, [700, 60]).name());
    assert!(keys[0] != keys[1] && keys[0] != keys[2], "{keys:?}");
}

#[test]
fn a_damaged_bank_is_recomputed() {
    let (body, store) = (small_cloth(3), Arc::new(Memory::default()));
    let computed = bank(&body, 1, Some(&store));
    let whole = store.bytes().remove(0);
    let name = store.kept.lock().unwrap().keys().next().cloned().unwrap();
    let mut flipped = whole.clone();
    flipped[whole.len() / 2] ^= 4;
    for damaged in [Vec::new(), whole[..whole.len() - 1].to_vec(), flipped, [whole.as_slice(), b"x"].concat(), vec![0; 4096]] {
        store.kept.lock().unwrap().insert(name.clone(), damaged);
        assert_eq!(bank(&body, 1, Some(&store)), computed);
        assert!(store.bytes() == std::slice::from_ref(&whole));
    }
    assert_eq!(store.stored(), 6);
}

/// Returns a bank of few features, for a picture of 40 x 30.
fn few() -> ViewBank {
    let feature = |k: u8| Feature {
        position: Vector2::new(3.25 * f64::from(k), 2.5 * f64::from(k)),
        scale: 1.2_f64.powi(i32::from(k)),
        angle: 0.3 * f32::from(k),
        polarity: Polarity::ALL[usize::from(k % 2)],
        descriptor: Descriptor([u64::from(k).wrapping_mul(0x9e37_79b9_7f4a_7c15); 4]),
    };
    let anchors = vec![(0..4).map(|k| Anchor::at([5 + 3 * k, 6 + k], 0)).collect()];
    let tilted = view_shapes().enumerate().map(|(view, _)| (4..4 + 7 * u8::from(view == 5)).map(feature).collect()).collect();
    ViewBank { frontal: (0..7).map(feature).collect(), tilted, anchors }
}

const SIZE: (u32, u32) = (40, 30);
const KEY: BankKey = BankKey([7; KEY_BYTES]);

/// Recomputes the digest, as a forger would.
fn resealed(mut bytes: Vec<u8>) -> Vec<u8> {
    let content = bytes.len().saturating_sub(KEY_BYTES);
    let digest = digest([&bytes[..content]]);
    bytes.truncate(content);
    bytes.extend_from_slice(&digest);
    bytes
}

proptest! {
    #[test]
    fn changed_bank_bytes_are_rejected(changes in proptest::collection::vec((any::<prop::sample::Index>(), 1..=255u8), 1..6)) {
        let whole = few().to_bytes(&KEY);
        let mut bytes = whole.clone();
        changes.iter().for_each(|(at, change)| bytes[at.index(whole.len())] ^= change);
        prop_assume!(bytes != whole);
        prop_assert_eq!(ViewBank::from_bytes(&bytes, &KEY, SIZE), None);
    }

    #[test]
    fn other_lengths_are_rejected(length in any::<prop::sample::Index>(), more in proptest::collection::vec(any::<u8>(), 1..200)) {
        let whole = few().to_bytes(&KEY);
        let cut = &whole[..length.index(whole.len())];
        for bytes in [cut.to_vec(), resealed(cut.to_vec()), [cut, &more].concat(), [whole.as_slice(), &more].concat()] {
            prop_assert_eq!(ViewBank::from_bytes(&bytes, &KEY, SIZE), None);
        }
    }

    /// With a valid digest, any bank that parses is one that a picture may have, and serialises to
    /// the same bytes.
    #[test]
    fn accepted_forged_bytes_form_a_valid_bank(
        changes in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        length in any::<prop::sample::Index>(),
        is_cut in any::<bool>(),
    ) {
        let mut bytes = few().to_bytes(&KEY);
        let count = bytes.len();
        changes.iter().for_each(|(at, change)| bytes[at.index(count)] = *change);
        if is_cut {
            bytes.truncate(length.index(count));
        }
        let bytes = resealed(bytes);
        if let Some(bank) = ViewBank::from_bytes(&bytes, &KEY, SIZE) {
            prop_assert_eq!(bank.to_bytes(&KEY), bytes);
            let is_possible = |f: &Feature| f.position.x < 40.0 && f.position.min() >= 0.0 && f.position.y < 30.0 && f.scale > 0.0;
            prop_assert!(bank.frontal.iter().chain(bank.tilted.iter().flatten()).all(is_possible));
        }
    }

    #[test]
    fn any_bytes_are_read_without_harm(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        prop_assert_eq!(ViewBank::from_bytes(&resealed(bytes), &KEY, SIZE), None);
    }
}

#[test]
fn intact_bank_bytes_are_accepted_for_their_key_only() {
    let bytes = few().to_bytes(&KEY);
    assert_eq!(ViewBank::from_bytes(&bytes, &KEY, SIZE), Some(few()));
    assert_eq!(ViewBank::from_bytes(&bytes, &BankKey([8; KEY_BYTES]), SIZE), None);
    assert_eq!(ViewBank::from_bytes(&bytes, &KEY, (20, 30)), None);
    // An anchor at the border, and more anchors than allowed.
    let mut outside = few();
    outside.anchors[0][0] = Anchor::at([4, 6], 0);
    assert_eq!(ViewBank::from_bytes(&outside.to_bytes(&KEY), &KEY, SIZE), None);
    outside.anchors[0] = vec![Anchor::at([7, 7], 0); SCENE_TUNING.max_octave_anchors + 1];
    assert_eq!(ViewBank::from_bytes(&outside.to_bytes(&KEY), &KEY, SIZE), None);
    // A huge feature count must not cause an allocation.
    let mut many = bytes;
    let count = MAGIC.len() + 4 + KEY_BYTES;
    many[count..count + 4].copy_from_slice(&u32::MAX.to_le_bytes());
    assert_eq!(ViewBank::from_bytes(&resealed(many), &KEY, SIZE), None);
}
