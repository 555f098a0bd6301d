//! Corners of one pyramid level: FAST-9 (Rosten & Drummond) finds them, the smaller eigenvalue of
//! the structure tensor (Shi & Tomasi) ranks them, and a grid spreads them over the picture.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use image::GrayImage;

use super::kernels::{CIRCLE, CIRCLE_RADIUS, peak_row, score_row};
use super::open_pixels::{LevelMask, OpenRow};
use crate::simd::multiversion;

/// A corner on a pyramid level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Corner {
    /// Column, level pixels.
    pub x: u32,
    /// Row, level pixels.
    pub y: u32,
    /// Smaller eigenvalue of the 7x7 structure tensor, (grey/px)² per pixel (for candidates: the
    /// FAST score).
    pub strength: f32,
}

/// Whether a corner's centre is darker or brighter than its surroundings. A dark corner stays dark
/// from any viewpoint and in any light: over ten clips, 99.8 % of right matches have the same
/// polarity. So corners need to be compared with only half of all others (as Bay et al. 2006 do
/// with the sign of the Laplacian).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Polarity {
    /// Nine consecutive pixels of the FAST circle are brighter than the centre.
    Dark,
    /// Nine consecutive pixels are darker.
    Bright,
}

impl Polarity {
    /// Both polarities.
    pub const ALL: [Self; 2] = [Self::Dark, Self::Bright];
}

/// Returns the polarity of a FAST-9 corner: nine of 16 are a majority.
pub(super) fn polarity(image: &GrayImage, x: u32, y: u32) -> Polarity {
    let width = image.width() as usize;
    let at = y as usize * width + x as usize;
    let (source, middle) = (image.as_raw(), image.as_raw()[at]);
    let brighter = CIRCLE.iter().filter(|(dx, dy)| source[at.wrapping_add_signed(dy * width as isize + dx)] > middle);
    if 2 * brighter.count() > CIRCLE.len() { Polarity::Dark } else { Polarity::Bright }
}

/// Options of corner detection on a level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CornerOptions {
    /// Maximum number of corners.
    pub count: usize,
    /// Usual contrast, grey levels; twice as much is tried first, `least_threshold` last.
    pub threshold: u8,
    /// Lowest contrast.
    pub least_threshold: u8,
    /// Width of the border without corners, pixels (the descriptor's reach).
    pub border: u32,
    /// Side of the grid cells among which corners are spread, level pixels.
    pub cell_px: u32,
}

/// Reusable buffers of the detector.
#[derive(Debug, Clone, Default)]
pub struct CornerBuffers {
    rows: [ScoreRow; 3],
    /// Column ranges to search in the next row.
    runs: Vec<Range<usize>>,
    /// See [`LevelMask::find_columns`].
    mask_columns: Vec<u32>,
    peaks: Vec<u8>,
    candidates: Vec<Corner>,
    sorted: Vec<Corner>,
    corners: Vec<Corner>,
    ranks: Ranks,
    /// Number of low thresholds that the last picture did not need; the next one skips them at
    /// first. Affects only the time, never the corners.
    spared: Arc<AtomicUsize>,
    /// Contrast the candidates were found with; `None` before the first search.
    found_with: Option<u8>,
}

/// The scores of a row of pixels.
#[derive(Debug, Clone, Default)]
struct ScoreRow {
    /// One pixel longer at each end than the searched columns; 0 outside the runs.
    scores: Vec<u8>,
    /// The searched columns, in picture coordinates.
    runs: Vec<Range<usize>>,
}

impl CornerBuffers {
    /// Creates buffers for pictures that need about the same contrast, such as levels of one
    /// picture: each search starts with the contrast at which the last one on any of them ended.
    pub(super) fn alike(other: &Self) -> Self {
        Self { spared: Arc::clone(&other.spared), ..Self::default() }
    }

    /// Marks the next picture as a new one.
    pub(super) fn forget_picture(&mut self) {
        self.found_with = None;
    }
}

/// Finds at most `options.count` corners, strongest first with an even spread.
pub fn detect_corners(image: &GrayImage, options: &CornerOptions, buffers: &mut CornerBuffers, found: &mut Vec<Corner>) {
    buffers.forget_picture();
    detect_more_corners(image, options, None, buffers, found);
}

/// Like [`detect_corners`], within a mask and on the picture last used with these buffers, with
/// another count: candidates found before with the same mask are reused.
pub(super) fn detect_more_corners(
    image: &GrayImage,
    options: &CornerOptions,
    mask: Option<&LevelMask>,
    buffers: &mut CornerBuffers,
    found: &mut Vec<Corner>,
) {
    found.clear();
    let (w, h) = image.dimensions();
    let border = options.border.max(CIRCLE_RADIUS as u32 + 1);
    if w <= 2 * border || h <= 2 * border {
        return;
    }
    let least = f32::from(candidates_of(image, options, border, mask, buffers));
    let CornerBuffers { candidates, sorted, corners, ranks, .. } = buffers;
    corners.clear();
    corners.extend(candidates.iter().filter(|c| c.strength >= least));
    // The FAST score, which costs nothing extra, preselects corners for the eigenvalue computation.
    sort_by_score(corners, sorted);
    corners.clear();
    spread(sorted, ranks, (w, h), &CornerOptions { count: SHORTLIST * options.count, ..*options }, corners);
    rank(image, corners);
    corners.sort_unstable_by(|a, b| b.strength.total_cmp(&a.strength).then((a.y, a.x).cmp(&(b.y, b.x))));
    spread(corners, ranks, (w, h), options, found);
}

/// Fills `buffers.candidates` with the corners of the highest threshold that yields enough, and
/// possibly weaker ones; returns that threshold.
fn candidates_of(image: &GrayImage, options: &CornerOptions, border: u32, mask: Option<&LevelMask>, buffers: &mut CornerBuffers) -> u8 {
    // High contrast first: a rich picture has enough of it, and low-contrast corners are noise.
    let thresholds = [options.threshold.saturating_mul(2), options.threshold, options.least_threshold];
    // The lowest of the first `count` thresholds.
    let lowest = |count: usize| thresholds[..count].iter().copied().min().unwrap_or(0);
    let mut tried = thresholds.len() - buffers.spared.load(Ordering::Relaxed);
    loop {
        // A corner's score is the highest threshold that it passes, so those of a low threshold
        // include those of higher ones.
        if buffers.found_with.is_none_or(|found_with| found_with > lowest(tried)) {
            find_peaks(image, lowest(tried), border, mask, buffers);
            buffers.found_with = Some(lowest(tried));
        }
        let count = |t: u8| buffers.candidates.iter().filter(|c| c.strength >= f32::from(t)).count();
        let is_enough = |corners: usize| 2 * corners >= 3 * options.count;
        let enough = thresholds[..tried].iter().position(|t| is_enough(count(*t)));
        if enough.is_some() || tried == thresholds.len() {
            let stage = enough.unwrap_or(tried - 1);
            buffers.spared.store(thresholds.len() - 1 - stage, Ordering::Relaxed);
            return thresholds[stage];
        }
        tried = if is_enough(LOWER_CONTRAST_GAIN * count(lowest(tried))) { tried + 1 } else { thresholds.len() };
    }
}

/// Expected growth factor of the number of corners at the next lower contrast. If that would not
/// suffice, the lowest is tried at once. Raised, more pictures are searched a third time; lowered,
/// the lowest contrast is tried where it yields far too many corners.
const LOWER_CONTRAST_GAIN: usize = 4;

/// Corners ranked by eigenvalue per corner wanted. Raised, more eigenvalues are computed; at 1 the
/// FAST score alone decides.
const SHORTLIST: usize = 3;

/// Fills `buffers.candidates` with the FAST-9 corners that are maxima of their 3x3 neighbourhood
/// and inside the mask, in reading order.
fn find_peaks(image: &GrayImage, threshold: u8, border: u32, mask: Option<&LevelMask>, buffers: &mut CornerBuffers) {
    let (w, h) = (image.width() as usize, image.height() as usize);
    let source = image.as_raw();
    let b = border as usize;
    let columns = b..w - b;
    let CornerBuffers { rows, runs, mask_columns, peaks, candidates, .. } = buffers;
    for row in rows.iter_mut() {
        row.scores.clear();
        row.scores.resize(columns.len() + 2, 0);
        row.runs.clear();
    }
    peaks.resize(columns.len(), 0);
    candidates.clear();
    let offsets = CIRCLE.map(|(dx, dy)| dy * w as isize + dx);
    runs.clear();
    runs.extend(mask.is_none().then(|| columns.clone()));
    if let Some(mask) = mask {
        mask.find_columns(mask_columns);
    }
    let mut tile_rows = 0..0;
    let [above, here, below] = rows;
    // A rolling window of three score rows; row y is complete once row y + 1 is scored.
    for y in b..=h - b {
        below.scores.fill(0);
        below.runs.clear();
        if y < h - b {
            if let Some(mask) = mask {
                let own = mask.tile_rows(y);
                if own != tile_rows {
                    mask.open_runs(own.clone(), columns.clone(), runs);
                    tile_rows = own;
                }
            }
            for run in &*runs {
                score_row(source, y * w + run.start, &offsets, threshold, &mut below.scores[run.start - b + 1..][..run.len()]);
            }
            below.runs.extend_from_slice(runs);
        }
        let open = mask.map(|mask| mask.open_row(y as u32 - 1, mask_columns));
        for run in &here.runs {
            let peaks = &mut peaks[..run.len()];
            let around = run.start - b..run.end - b + 2;
            peak_row([&above.scores[around.clone()], &here.scores[around.clone()], &below.scores[around]], peaks);
            collect(peaks, run.start, y - 1, open.as_ref(), candidates);
        }
        std::mem::swap(above, here);
        std::mem::swap(here, below);
    }
}

/// Appends the corners of a row that are inside the mask; the row's first pixel is in column
/// `first`.
fn collect(peaks: &[u8], first: usize, y: usize, open: Option<&OpenRow>, candidates: &mut Vec<Corner>) {
    let mut add = |at: usize, score: u8| {
        let x = first + at;
        if open.is_none_or(|open| open.is_open(x)) {
            candidates.push(Corner { x: x as u32, y: y as u32, strength: f32::from(score) });
        }
    };
    // Most pixels have none: eight are checked at once as one word, whose lowest byte is the first
    // pixel.
    let (words, rest) = peaks.as_chunks::<8>();
    for (k, scores) in words.iter().enumerate() {
        let mut word = u64::from_le_bytes(*scores);
        while word != 0 {
            let i = word.trailing_zeros() as usize / 8;
            add(8 * k + i, scores[i]);
            word &= !(0xff << (8 * i));
        }
    }
    rest.iter().enumerate().filter(|(_, score)| **score != 0).for_each(|(i, score)| add(8 * words.len() + i, *score));
}

multiversion! {
    /// Computes the strength that ranks corners.
    fn rank(image: &GrayImage, corners: &mut [Corner]); ["avx2"] => rank_lanes, else rank_lanes
}

#[inline(always)]
fn rank_lanes(image: &GrayImage, corners: &mut [Corner]) {
    for corner in corners {
        corner.strength = smaller_eigenvalue(image, corner.x, corner.y);
    }
}

/// Returns the smaller eigenvalue of the structure tensor over 7x7 pixels, per pixel. The pixel
/// must be at least 4 from the border.
#[inline(always)]
fn smaller_eigenvalue(image: &GrayImage, x: u32, y: u32) -> f32 {
    let w = image.width() as usize;
    let source = image.as_raw();
    // A row of seven in eight lanes; the last lane is ignored.
    let (mut xx, mut xy, mut yy) = ([0i32; 8], [0i32; 8], [0i32; 8]);
    let eight = |at: usize| -> [u8; 8] {
        // The slice has exactly this length.
        source[at..][..8].try_into().unwrap_or([0; 8])
    };
    for v in y as usize - 3..=y as usize + 3 {
        let at = v * w + x as usize - 3;
        let (left, right, above, below) = (eight(at - 1), eight(at + 1), eight(at - w), eight(at + w));
        for k in 0..8 {
            let gx = i16::from(right[k]) - i16::from(left[k]);
            let gy = i16::from(below[k]) - i16::from(above[k]);
            let (gx, gy) = (i32::from(gx), i32::from(gy));
            xx[k] += gx * gx;
            xy[k] += gx * gy;
            yy[k] += gy * gy;
        }
    }
    let sum = |lanes: [i32; 8]| lanes[..7].iter().sum::<i32>() as f32;
    let (xx, xy, yy) = (sum(xx), sum(xy), sum(yy));
    // Central differences span two pixels, so divide the squares by four, and by the 49 pixels.
    (0.5 * (xx + yy) - (0.25 * (xx - yy).powi(2) + xy * xy).sqrt()) / (4.0 * 49.0)
}

/// Sorts candidates, given in reading order, by FAST score: highest first, ties in reading order.
fn sort_by_score(candidates: &[Corner], sorted: &mut Vec<Corner>) {
    // Start index of each score's corners; scores are whole numbers up to 255.
    let mut begins = [0usize; 256];
    for c in candidates {
        begins[c.strength as usize & 255] += 1;
    }
    let mut sum = 0;
    for begin in begins.iter_mut().rev() {
        sum += std::mem::replace(begin, sum);
    }
    sorted.clear();
    sorted.resize(candidates.len(), Corner { x: 0, y: 0, strength: 0.0 });
    for c in candidates {
        let place = &mut begins[c.strength as usize & 255];
        sorted[*place] = *c;
        *place += 1;
    }
}

/// Reusable buffers of [`spread`].
#[derive(Debug, Clone, Default)]
struct Ranks {
    /// Number of corners so far in each cell.
    filled: Vec<u32>,
    /// Rank of each corner within its cell, from 0.
    of_corner: Vec<u32>,
    /// Start index in the result of each rank's corners.
    begins: Vec<u32>,
}

/// Takes the strongest of each cell, then the second strongest of each, and so on, until there are
/// enough. `corners` must be sorted strongest first.
fn spread(corners: &[Corner], ranks: &mut Ranks, (w, h): (u32, u32), options: &CornerOptions, found: &mut Vec<Corner>) {
    found.clear();
    if corners.len() <= options.count {
        found.extend_from_slice(corners);
        return;
    }
    let Ranks { filled, of_corner, begins } = ranks;
    let across = w.div_ceil(options.cell_px) as usize;
    filled.clear();
    filled.resize(across * h.div_ceil(options.cell_px) as usize, 0);
    of_corner.clear();
    begins.clear();
    for c in corners {
        let cell = &mut filled[(c.y / options.cell_px) as usize * across + (c.x / options.cell_px) as usize];
        let rank = *cell as usize;
        *cell += 1;
        of_corner.push(rank as u32);
        if begins.len() == rank {
            begins.push(0);
        }
        begins[rank] += 1;
    }
    let mut sum = 0;
    for begin in begins.iter_mut() {
        sum += std::mem::replace(begin, sum);
    }
    // Sorts by the rank within the cell first, by strength second.
    found.resize(options.count, corners[0]);
    for (corner, rank) in corners.iter().zip(of_corner.iter()) {
        let place = &mut begins[*rank as usize];
        if let Some(slot) = found.get_mut(*place as usize) {
            *slot = *corner;
        }
        *place += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::super::open_pixels::OpenTiles;
    use super::super::pyramid::Pyramid;
    use super::*;

    fn squares() -> GrayImage {
        GrayImage::from_fn(200, 160, |x, y| {
            image::Luma([if (x / 20 + y / 20) % 2 == 0 && (x % 20 < 12) && (y % 20 < 12) { 200 } else { 40 }])
        })
    }

    /// Calls `work` with a mask of the picture that is open in some columns.
    fn with_mask(picture: &GrayImage, is_open: impl Fn(u32) -> bool, work: impl FnOnce(&LevelMask)) {
        let mask = GrayImage::from_fn(picture.width(), picture.height(), |x, _| image::Luma([u8::from(is_open(x))]));
        let (mut tiles, mut pyramid) = (OpenTiles::default(), Pyramid::default());
        tiles.update(&mask);
        work(&LevelMask { mask: &mask, tiles: &tiles, level: &pyramid.build(picture, 1.2, 1, 1)[0] });
    }

    const OPTIONS: CornerOptions = CornerOptions { count: 1000, threshold: 20, least_threshold: 7, border: 8, cell_px: 32 };

    #[test]
    fn corners_of_squares_are_found_near_them() {
        let mut found = Vec::new();
        detect_corners(&squares(), &OPTIONS, &mut CornerBuffers::default(), &mut found);
        for (x, y) in [(40, 40), (51, 40), (40, 51), (51, 51)] {
            assert!(found.iter().any(|c| c.x.abs_diff(x) <= 2 && c.y.abs_diff(y) <= 2), "no corner at {x},{y}");
        }
    }

    #[test]
    fn a_flat_picture_has_none_and_tiny_ones_do_not_panic() {
        let mut found = Vec::new();
        for (w, h) in [(1, 1), (5, 5), (16, 16), (17, 17), (64, 64)] {
            detect_corners(&GrayImage::from_pixel(w, h, image::Luma([90])), &OPTIONS, &mut CornerBuffers::default(), &mut found);
            assert!(found.is_empty());
        }
    }

    #[test]
    fn a_limited_corner_count_is_spread_over_the_picture() {
        let mut found = Vec::new();
        detect_corners(&squares(), &CornerOptions { count: 30, ..OPTIONS }, &mut CornerBuffers::default(), &mut found);
        assert_eq!(found.len(), 30);
        let left = found.iter().filter(|c| c.x < 100).count();
        assert!((8..=22).contains(&left), "{left}");
    }

    /// Faint squares beside bright ones, so that more corners need a lower contrast.
    #[test]
    fn asking_for_more_corners_matches_a_fresh_detection() {
        let picture = GrayImage::from_fn(200, 160, |x, y| {
            let is_square = (x / 20 + y / 20) % 2 == 0 && x % 20 < 12 && y % 20 < 12;
            image::Luma([if is_square { 40 + [9, 25, 70, 160][(x / 50) as usize] } else { 40 }])
        });
        for counts in [[10, 40], [40, 120], [120, 1000], [1000, 10]] {
            let (mut kept, mut more, mut anew) = (CornerBuffers::default(), Vec::new(), Vec::new());
            let [first, second] = counts.map(|count| CornerOptions { count, ..OPTIONS });
            with_mask(
                &picture,
                |x| x > 30,
                |mask| {
                    detect_more_corners(&picture, &first, Some(mask), &mut kept, &mut more);
                    detect_more_corners(&picture, &second, Some(mask), &mut kept, &mut more);
                    detect_more_corners(&picture, &second, Some(mask), &mut CornerBuffers::default(), &mut anew);
                },
            );
            assert!(more == anew && !anew.is_empty(), "{counts:?}: {} and {}", more.len(), anew.len());
        }
    }

    #[test]
    fn dark_and_bright_corners_are_distinguished() {
        let (bright, mut found) = (squares(), Vec::new());
        let mut dark = bright.clone();
        image::imageops::invert(&mut dark);
        for (picture, expected) in [(bright, Polarity::Bright), (dark, Polarity::Dark)] {
            detect_corners(&picture, &OPTIONS, &mut CornerBuffers::default(), &mut found);
            assert!(found.len() > 50 && found.iter().all(|c| polarity(&picture, c.x, c.y) == expected));
        }
    }

    #[test]
    fn a_mask_keeps_corners_out() {
        let (picture, mut found) = (squares(), Vec::new());
        with_mask(
            &picture,
            |x| x < 100,
            |mask| {
                detect_more_corners(&picture, &OPTIONS, Some(mask), &mut CornerBuffers::default(), &mut found);
            },
        );
        assert!(!found.is_empty() && found.iter().all(|c| c.x < 100));
    }
}
