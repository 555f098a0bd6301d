//! Reads the time that the code shows in a picture.
//!
//! A frame whose exposure sees the code change has grey cells where the two codes differ. Each of
//! these shows the share of the exposure after the change. The shares must agree, and the two times
//! must be close, or the frame is not read.

use image::GrayImage;

use super::find::Placed;
use super::layout::{BITS, PERIOD_MS, bit_centres, number};

/// Share of a bit's light in its white cell above which the bit is certain. Raised, more frames
/// count as changing, and their noise as shares; lowered, changes at the ends of exposures pass for
/// none.
const CERTAIN_SHARE: f64 = 0.88;
/// Maximum number of grey bits. Raised, frames that see three codes may be read wrongly.
const MAX_GREY_BITS: usize = 8;
/// Maximum time between two codes of a frame, milliseconds. Raised, other patterns pass for a
/// change; lowered, slow screens are not read.
const MAX_STEP_MS: u32 = 120;
/// Maximum difference of the shares that the grey bits of a frame show. Raised, frames with three
/// codes pass; lowered, noise and slow liquid crystals refuse right ones.
const MAX_SHARE_RANGE: f64 = 0.5;
/// Minimum margin of that range between the best two codes and any other two. Near a share of one
/// half, others fit as well. Raised, more frames are not read; lowered, some are read wrongly.
const MIN_RANGE_MARGIN: f64 = 0.12;
/// Exponent of the light per grey level, as of most cameras. Only shares depend on it.
const GAMMA: f64 = 2.2;

/// The time that a frame shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// The code at the begin of the exposure, milliseconds of the screen's clock modulo
    /// [`PERIOD_MS`].
    pub shown_ms: u32,
    /// If the code changed during the exposure: the one that followed, and the share of the
    /// exposure after the change.
    pub change: Option<(u32, f64)>,
    /// The row of the picture at which the bits that change most are seen, pixels.
    pub row_px: f64,
}

/// Reads the code at its place in the picture; `None` where it cannot be read.
pub fn read(image: &GrayImage, placed: &Placed) -> Option<Reading> {
    let light = |grey: f64| (grey / 255.0).powf(GAMMA);
    let [black, white] = placed.levels.map(light);
    let relative = |grey: f64| ((light(grey) - black) / (white - black)).max(0.0);
    let (mut certain, mut grey_bits) = (0_u32, Vec::new());
    for bit in 0..BITS {
        let [own, inverse] = bit_centres(bit);
        let (own, inverse) = (relative(placed.level(image, own)?), relative(placed.level(image, inverse)?));
        // One of the two is white, or both are grey.
        if own + inverse < 0.5 {
            return None;
        }
        match own / (own + inverse) {
            share if share > CERTAIN_SHARE => certain |= 1 << bit,
            share if share < 1.0 - CERTAIN_SHARE => {}
            share => grey_bits.push((bit, share)),
        }
    }
    let row_px = placed.row_px(bit_centres(0)[0])?;
    if grey_bits.is_empty() {
        return Some(Reading { shown_ms: number(certain), change: None, row_px });
    }
    let (shown_ms, change) = changed(certain, &grey_bits)?;
    Some(Reading { shown_ms, change: Some(change), row_px })
}

/// Returns the two codes that differ in the grey bits, with the share of the second; `None` unless
/// two that are close agree about the share.
fn changed(certain: u32, grey_bits: &[(usize, f64)]) -> Option<(u32, (u32, f64))> {
    if grey_bits.len() > MAX_GREY_BITS {
        return None;
    }
    let all: u32 = grey_bits.iter().map(|(bit, _)| 1 << bit).sum();
    let subsets = 0..1_u32 << grey_bits.len();
    let mut fits: Vec<Fit> = subsets.filter_map(|subset| Fit::of(certain, all, grey_bits, subset)).collect();
    fits.sort_by(|a, b| a.range.total_cmp(&b.range));
    let best = fits.first()?;
    let is_clear = fits.get(1).is_none_or(|next| next.range > best.range + MIN_RANGE_MARGIN);
    is_clear.then_some((best.from, (best.to, best.share)))
}

/// Two codes that differ in the grey bits of a frame.
struct Fit {
    from: u32,
    to: u32,
    /// Mean share of the second, and the range of what the bits show.
    share: f64,
    range: f64,
}

impl Fit {
    /// Takes those grey bits as white in the second code that are set in `subset`; `None` unless
    /// the codes are close and the bits agree.
    fn of(certain: u32, all: u32, grey_bits: &[(usize, f64)], subset: u32) -> Option<Self> {
        let second: u32 = grey_bits.iter().enumerate().filter(|(k, _)| subset >> k & 1 == 1).map(|(_, (bit, _))| 1 << bit).sum();
        let [from, to] = [all & !second, second].map(|bits| number(certain | bits));
        let step = to.wrapping_sub(from) % PERIOD_MS;
        let shares = grey_bits.iter().map(|(bit, share)| if second >> bit & 1 == 1 { *share } else { 1.0 - share });
        let [least, most] = shares.clone().fold([1.0_f64, 0.0], |[least, most], share| [least.min(share), most.max(share)]);
        let fit = Self { from, to, share: shares.sum::<f64>() / grey_bits.len() as f64, range: most - least };
        ((1..=MAX_STEP_MS).contains(&step) && fit.range < MAX_SHARE_RANGE).then_some(fit)
    }
}

#[cfg(test)]
mod tests {
    use super::super::find::find_code;
    use super::super::layout::gray;
    use super::super::screen::{Screen, View};
    use super::*;

    #[test]
    fn a_filmed_code_is_read_from_any_side() {
        for (k, view) in View::various().iter().enumerate() {
            let shown_ms = 123_456_789 + 7919 * k as u32;
            let image = Screen::showing(shown_ms).filmed(view);
            let placed = find_code(&image).unwrap_or_else(|| panic!("view {k}"));
            let reading = read(&image, &placed).unwrap_or_else(|| panic!("view {k}: {placed:?}"));
            assert_eq!((reading.shown_ms, reading.change), (shown_ms % PERIOD_MS, None), "view {k}");
        }
    }

    #[test]
    fn a_change_during_the_exposure_shows_its_share() {
        for (k, share) in [0.2, 0.35, 0.65, 0.8].into_iter().enumerate() {
            for step in [8, 16, 17, 33, 50] {
                let first = 86_400_000 + 9973 * k as u32 + step;
                let image = Screen::changing(first, first + step, share).filmed(&View::frontal());
                let reading = find_code(&image).and_then(|placed| read(&image, &placed));
                let Some(Reading { shown_ms, change: Some((second, seen)), .. }) = reading else { panic!("{share} {step}: {reading:?}") };
                assert_eq!((shown_ms, second), (first % PERIOD_MS, (first + step) % PERIOD_MS), "{share} {step}");
                assert!((seen - share).abs() < 0.06, "{share} {step}: {seen}");
            }
        }
    }

    #[test]
    fn a_share_of_one_half_that_fits_other_codes_too_is_not_read() {
        for k in 0..10 {
            let first = 86_400_000 + 9973 * k;
            let image = Screen::changing(first, first + 50, 0.5).filmed(&View::frontal());
            let reading = find_code(&image).and_then(|placed| read(&image, &placed));
            if let Some(Reading { shown_ms, change: Some((second, _)), .. }) = reading {
                assert_eq!((shown_ms, second), (first % PERIOD_MS, (first + 50) % PERIOD_MS));
            }
        }
    }

    #[test]
    fn other_pictures_are_not_read() {
        let texture = GrayImage::from_fn(640, 360, |x, y| image::Luma([((x * 37 + y * 91) ^ (x / 9 * y / 7)) as u8]));
        assert!(find_code(&texture).is_none());
        for grey in [0, 60, 255] {
            assert!(find_code(&GrayImage::from_pixel(320, 240, image::Luma([grey]))).is_none());
        }
        // A frame without a code inside, and one pixel.
        let ring = GrayImage::from_fn(400, 240, |x, y| {
            let depth = x.min(399 - x).min(y).min(239 - y);
            image::Luma([if (20..40).contains(&depth) { 20 } else { 220 }])
        });
        assert!(find_code(&ring).is_none() && find_code(&GrayImage::new(1, 1)).is_none());
    }

    #[test]
    fn three_codes_in_one_exposure_are_mostly_read_as_its_middle() {
        let (mut read, mut wrong) = (0, 0);
        for k in 0..200_u32 {
            let first = 1_000_000 + 331 * k;
            let codes = [first, first + 17, first + 34].map(gray);
            let shares = [0.3, 0.4, 0.3];
            let light =
                |bit: usize| codes.iter().zip(shares).filter(|(code, _)| **code >> bit & 1 == 1).map(|(_, share)| share).sum::<f64>();
            let mut certain = 0;
            let mut grey_bits = Vec::new();
            for bit in 0..BITS {
                match light(bit) {
                    share if share > CERTAIN_SHARE => certain |= 1 << bit,
                    share if share < 1.0 - CERTAIN_SHARE => {}
                    share => grey_bits.push((bit, share)),
                }
            }
            if let Some((from, (to, share))) = changed(certain, &grey_bits) {
                read += 1;
                // What is read lies within the exposure all the same.
                let middle = f64::from(from) + share * f64::from(to - from) - f64::from(first);
                wrong += u32::from(!(0.0..=34.0).contains(&middle));
            }
        }
        // The few are outvoted: `lateness` takes only steps that most frames show.
        assert!(5 * wrong < read, "{read} of 200 are read, {wrong} of them wrongly");
    }
}
