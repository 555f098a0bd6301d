//! The hot loops of feature detection, each as a plain function that is also compiled for wider
//! registers and used if the processor has them (detected at run time).

use crate::simd::multiversion;

/// Radius of the FAST circle, pixels (Rosten and Drummond 2006).
pub const CIRCLE_RADIUS: usize = 3;

/// The 16 circle pixels as (dx, dy), clockwise from the top.
pub const CIRCLE: [(isize, isize); 16] = [
    (0, -3),
    (1, -3),
    (2, -2),
    (3, -1),
    (3, 0),
    (3, 1),
    (2, 2),
    (1, 3),
    (0, 3),
    (-1, 3),
    (-2, 2),
    (-3, 1),
    (-3, 0),
    (-3, -1),
    (-2, -2),
    (-1, -3),
];

/// Pixels processed side by side: one AVX2 register of bytes.
const LANES: usize = 32;
type Lanes = [u8; LANES];

multiversion! {
    /// Fills `scores` with the FAST-9 scores of the pixels `start`, `start + 1`, …, whose circles
    /// must be inside `source`; 0 if below `threshold`. `offsets` are the circle's pixels relative
    /// to the centre, as index offsets.
    pub fn score_row(source: &[u8], start: usize, offsets: &[isize; 16], threshold: u8, scores: &mut [u8]);
    ["avx2"] => score_row_blocked, else score_row_blocked
}

/// Blocks of [`LANES`] pixels in registers; rows shorter than one block are padded, or scored pixel
/// by pixel.
#[inline(always)]
fn score_row_blocked(source: &[u8], start: usize, offsets: &[isize; 16], threshold: u8, scores: &mut [u8]) {
    let n = scores.len();
    if n < LANES {
        // A block that reads beyond the row's end, if the picture extends that far.
        let last = offsets.iter().copied().max().unwrap_or(0).max(0) as usize + start + LANES;
        if last > source.len() {
            score_row_plain(source, start, offsets, threshold, scores);
            return;
        }
        let mut block = [0; LANES];
        score_row_blocked_in(source, start, offsets, threshold, &mut block);
        scores.copy_from_slice(&block[..n]);
        return;
    }
    score_row_blocked_in(source, start, offsets, threshold, scores);
}

/// Like [`score_row_blocked`], for a row of at least one block.
#[inline(always)]
fn score_row_blocked_in(source: &[u8], start: usize, offsets: &[isize; 16], threshold: u8, scores: &mut [u8]) {
    let n = scores.len();
    // The last block overlaps the one before, so that no pixel remains.
    for first in (0..n - LANES).step_by(LANES).chain([n - LANES]) {
        let at = start + first;
        let lanes = |offset: isize| -> &Lanes {
            // The slice has exactly this length.
            source[at.wrapping_add_signed(offset)..][..LANES].try_into().unwrap_or(&[0; LANES])
        };
        let centre = lanes(0);
        let (mut high, mut low) = ([0u8; LANES], [0u8; LANES]);
        for x in 0..LANES {
            high[x] = centre[x].saturating_add(threshold);
            low[x] = centre[x].saturating_sub(threshold);
        }
        // Any nine consecutive pixels contain an adjacent pair of compass points: {n, s} with {w,
        // e}.
        let (n, e, s, w) = (lanes(offsets[0]), lanes(offsets[4]), lanes(offsets[8]), lanes(offsets[12]));
        let mut any = 0u8;
        for x in 0..LANES {
            let bright = ((n[x] > high[x]) | (s[x] > high[x])) & ((w[x] > high[x]) | (e[x] > high[x]));
            let dark = ((n[x] < low[x]) | (s[x] < low[x])) & ((w[x] < low[x]) | (e[x] < low[x]));
            any |= u8::from(bright | dark);
        }
        let mut block = [0; LANES];
        if any != 0 {
            score_block(&offsets.map(lanes), centre, threshold, &mut block);
        }
        scores[first..first + LANES].copy_from_slice(&block);
    }
}

/// Scores a block. Scoring all lanes costs less than finding out which ones need it.
#[inline(always)]
fn score_block(circle: &[&Lanes; 16], centre: &Lanes, threshold: u8, out: &mut Lanes) {
    for x in 0..LANES {
        let (mut bright, mut dark) = ([0u8; 16], [0u8; 16]);
        for k in 0..16 {
            bright[k] = circle[k][x].saturating_sub(centre[x]);
            dark[k] = centre[x].saturating_sub(circle[k][x]);
        }
        let best = most_of_nine(&bright).max(most_of_nine(&dark));
        // "Brighter by more than t" holds up to t = best - 1.
        out[x] = if best > threshold { best.wrapping_sub(1) } else { 0 };
    }
}

/// Returns the maximum, over all runs of nine of 16 differences, of the run's minimum.
#[inline(always)]
fn most_of_nine(d: &[u8; 16]) -> u8 {
    // The minima of 2, of 4 and of 8 consecutive differences, from each odd index on.
    let (mut two, mut four, mut best) = ([0u8; 8], [0u8; 8], 0);
    for k in 0..8 {
        two[k] = d[2 * k + 1].min(d[(2 * k + 2) % 16]);
    }
    for k in 0..8 {
        four[k] = two[k].min(two[(k + 1) % 8]);
    }
    for k in 0..8 {
        let eight = four[k].min(four[(k + 2) % 8]);
        // Eight from 2k + 1 on make nine with the one before or the one after.
        best = best.max(eight.min(d[2 * k].max(d[(2 * k + 9) % 16])));
    }
    best
}

/// The plain twin of [`score_row`].
fn score_row_plain(source: &[u8], start: usize, offsets: &[isize; 16], threshold: u8, scores: &mut [u8]) {
    for (k, score) in scores.iter_mut().enumerate() {
        let at = start + k;
        let best = fast_score(&offsets.map(|o| source[at.wrapping_add_signed(o)]), source[at]);
        *score = if best >= threshold { best } else { 0 };
    }
}

multiversion! {
    /// Writes to `peaks` the scores of `rows[1]` that are the maximum of their 3x3 neighbourhood,
    /// and 0 elsewhere; on ties the first in reading order wins. The rows are one pixel longer than
    /// `peaks` at either end.
    pub fn peak_row(rows: [&[u8]; 3], peaks: &mut [u8]);
    ["avx2"] => peak_row_blocked, else peak_row_blocked
}

/// Blocks of [`LANES`] pixels in registers; most have no score and are skipped. Rows shorter than
/// one block go pixel by pixel.
#[inline(always)]
fn peak_row_blocked(rows: [&[u8]; 3], peaks: &mut [u8]) {
    let n = peaks.len();
    if n < LANES {
        return peak_row_plain(rows, peaks);
    }
    // The last block overlaps the one before, so that no pixel remains.
    for first in (0..n - LANES).step_by(LANES).chain([n - LANES]) {
        let lanes = |row: &[u8], at: usize| -> Lanes {
            // The slice has exactly this length.
            row[first + at..][..LANES].try_into().unwrap_or([0; LANES])
        };
        let score = lanes(rows[1], 1);
        let mut block = [0; LANES];
        if score.iter().fold(0, |any, s| any | s) != 0 {
            let [above, here, below] = rows;
            let (above_left, above_here, above_right) = (lanes(above, 0), lanes(above, 1), lanes(above, 2));
            let (left, right) = (lanes(here, 0), lanes(here, 2));
            let (below_left, below_here, below_right) = (lanes(below, 0), lanes(below, 1), lanes(below, 2));
            for x in 0..LANES {
                let before = [above_left[x], above_here[x], above_right[x], left[x]];
                block[x] = peak(score[x], before, [right[x], below_left[x], below_here[x], below_right[x]]);
            }
        }
        peaks[first..first + LANES].copy_from_slice(&block);
    }
}

/// Returns a score if it is the maximum among its neighbours, else 0; `before` and `after` in
/// reading order.
#[inline(always)]
fn peak(score: u8, before: [u8; 4], after: [u8; 4]) -> u8 {
    let largest = |[a, b, c, d]: [u8; 4]| a.max(b).max(c).max(d);
    if score > largest(before) && score >= largest(after) { score } else { 0 }
}

/// The plain twin of [`peak_row`].
#[inline(always)]
fn peak_row_plain(rows: [&[u8]; 3], peaks: &mut [u8]) {
    let n = peaks.len();
    let [above, here, below] = rows.map(|row| [&row[..n], &row[1..n + 1], &row[2..n + 2]]);
    for (x, out) in peaks.iter_mut().enumerate() {
        *out = peak(here[1][x], [above[0][x], above[1][x], above[2][x], here[0][x]], [here[2][x], below[0][x], below[1][x], below[2][x]]);
    }
}

/// Returns FAST-9's score: the highest threshold at which nine contiguous circle pixels are all
/// brighter or all darker than the centre; 0 if there is none.
fn fast_score(circle: &[u8; 16], centre: u8) -> u8 {
    let least = |s: usize, difference: &dyn Fn(u8) -> u8| (0..9).map(|k| difference(circle[(s + k) % 16])).min().unwrap_or(0);
    let contrast = |s| least(s, &|v| v.saturating_sub(centre)).max(least(s, &|v| centre.saturating_sub(v)));
    // "Brighter by more than t" holds up to t = best - 1.
    (0..16).map(contrast).max().unwrap_or(0).saturating_sub(1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const WIDTH: usize = 120;

    fn offsets() -> [isize; 16] {
        CIRCLE.map(|(dx, dy)| dy * WIDTH as isize + dx)
    }

    proptest! {
        #[test]
        fn simd_corner_scores_equal_scalar_scores(seed in any::<u64>(), contrast in 1u64..256, n in 0usize..110, threshold in 0u8..80) {
            let byte = |k: usize| ((seed.wrapping_mul(6364136223846793005).wrapping_add((k as u64).wrapping_mul(0x9E3779B97F4A7C15)) >> 29) % contrast) as u8;
            let source: Vec<u8> = (0..7 * WIDTH).map(byte).collect();
            let (mut a, mut b) = (vec![9; n], vec![7; n]);
            let start = 3 * WIDTH + 4;
            score_row(&source, start, &offsets(), threshold, &mut a);
            score_row_plain(&source, start, &offsets(), threshold, &mut b);
            prop_assert_eq!(a, b);
        }

        #[test]
        fn peaks_are_the_first_maximum_of_nine(scores in proptest::collection::vec(0u8..4, 3 * 50), n in 0usize..49) {
            let mut peaks = vec![9; n];
            peak_row([&scores[..n + 2], &scores[50..50 + n + 2], &scores[100..100 + n + 2]], &mut peaks);
            for (k, peak) in peaks.iter().enumerate() {
                let score = scores[50 + k + 1];
                let neighbours: Vec<u8> = (0..9).filter(|i| *i != 4).map(|i| scores[i / 3 * 50 + k + i % 3]).collect();
                let wins = neighbours[..4].iter().all(|s| *s < score) && neighbours[4..].iter().all(|s| *s <= score);
                prop_assert_eq!(*peak, if wins { score } else { 0 });
            }
        }

        #[test]
        fn score_is_the_largest_passing_threshold(circle in any::<[u8; 16]>(), centre in any::<u8>()) {
            let passes = |t: i16| (0..16).any(|s| {
                let bright = (0..9).all(|k| i16::from(circle[(s + k) % 16]) > i16::from(centre) + t);
                let dark = (0..9).all(|k| i16::from(circle[(s + k) % 16]) < i16::from(centre) - t);
                bright || dark
            });
            let expected = (0..255).rev().find(|t| passes(*t)).unwrap_or(0);
            prop_assert_eq!(i16::from(fast_score(&circle, centre)), expected);
        }
    }
}
