//! The hot loops of feature finding, each as a plain function and, where the processor allows it (asked at
//! run time), the same function compiled for wider registers.

use crate::simd::multiversion;

/// Radius of FAST's circle in pixels (Rosten and Drummond 2006).
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

/// Pixels that are tested side by side: one AVX2 register of bytes.
const LANES: usize = 32;

multiversion! {
    /// Marks with 1 the FAST-9 corners among `marks.len()` pixels of a picture: those at `start`, `start + 1`, … whose circles lie
    /// inside `source`. `offsets` are the circle's pixels relative to the centre, in reading steps.
    pub fn segment_row(source: &[u8], start: usize, offsets: &[isize; 16], threshold: u8, marks: &mut [u8]);
    ["avx2"] => segment_row_blocked, else segment_row_blocked
}

/// Blocks of [`LANES`] pixels in registers; rows shorter than one pixel by pixel.
#[inline(always)]
fn segment_row_blocked(source: &[u8], start: usize, offsets: &[isize; 16], threshold: u8, marks: &mut [u8]) {
    let n = marks.len();
    if n < LANES {
        segment_row_plain(source, start, offsets, threshold, marks);
        return;
    }
    // The last block overlaps the one before it, so that no pixel is left over.
    for first in (0..n - LANES).step_by(LANES).chain([n - LANES]) {
        let (at, out) = (start + first, &mut marks[first..first + LANES]);
        let lanes = |offset: isize| -> [u8; LANES] {
            // The slice is exactly this long.
            source[at.wrapping_add_signed(offset)..][..LANES].try_into().unwrap_or([0; LANES])
        };
        let centre = lanes(0);
        let (mut high, mut low) = ([0u8; LANES], [0u8; LANES]);
        for x in 0..LANES {
            high[x] = centre[x].saturating_add(threshold);
            low[x] = centre[x].saturating_sub(threshold);
        }
        // Any nine in a row contain a neighbouring pair of compass points: {n, s} with {w, e}.
        let (n, e, s, w) = (lanes(offsets[0]), lanes(offsets[4]), lanes(offsets[8]), lanes(offsets[12]));
        let mut any = 0u8;
        for x in 0..LANES {
            let bright = ((n[x] > high[x]) | (s[x] > high[x])) & ((w[x] > high[x]) | (e[x] > high[x]));
            let dark = ((n[x] < low[x]) | (s[x] < low[x])) & ((w[x] < low[x]) | (e[x] < low[x]));
            any |= u8::from(bright | dark);
        }
        if any == 0 {
            out.fill(0);
        } else {
            longest_runs(&lanes, offsets, &high, &low, out);
        }
    }
}

/// Marks the lanes whose circle has nine neighbours in a row beyond the limits.
#[inline(always)]
fn longest_runs(lanes: &impl Fn(isize) -> [u8; LANES], offsets: &[isize; 16], high: &[u8; LANES], low: &[u8; LANES], out: &mut [u8]) {
    let (mut bright, mut dark) = ([0u8; LANES], [0u8; LANES]);
    let mut longest = [0u8; LANES];
    for k in 0..24 {
        let v = lanes(offsets[k % 16]);
        for x in 0..LANES {
            // A mask of all ones keeps the run, of zeros ends it.
            let is_bright = 0u8.wrapping_sub(u8::from(v[x] > high[x]));
            let is_dark = 0u8.wrapping_sub(u8::from(v[x] < low[x]));
            bright[x] = (bright[x] + 1) & is_bright;
            dark[x] = (dark[x] + 1) & is_dark;
            longest[x] = longest[x].max(bright[x]).max(dark[x]);
        }
    }
    for x in 0..LANES {
        out[x] = u8::from(longest[x] >= 9);
    }
}

/// The plain twin of [`segment_row`].
fn segment_row_plain(source: &[u8], start: usize, offsets: &[isize; 16], threshold: u8, marks: &mut [u8]) {
    for (k, mark) in marks.iter_mut().enumerate() {
        let at = start + k;
        let circle = offsets.map(|o| source[at.wrapping_add_signed(o)]);
        let high = source[at].saturating_add(threshold);
        let low = source[at].saturating_sub(threshold);
        let nine = |test: &dyn Fn(u8) -> bool| (0..16).any(|s| (0..9).all(|k| test(circle[(s + k) % 16])));
        *mark = u8::from(nine(&|v| v > high) || nine(&|v| v < low));
    }
}

multiversion! {
    /// Scores the marked pixels of a row (see [`segment_row`]) with [`fast_score`]; the others get 0.
    pub fn score_row(source: &[u8], start: usize, offsets: &[isize; 16], marks: &[u8], scores: &mut [u8]);
    ["avx2"] => score_row_plain, else score_row_plain
}

/// The plain twin of [`score_row`].
#[inline(always)]
fn score_row_plain(source: &[u8], start: usize, offsets: &[isize; 16], marks: &[u8], scores: &mut [u8]) {
    for (k, (mark, score)) in marks.iter().zip(scores).enumerate() {
        *score = 0;
        if *mark != 0 {
            let at = start + k;
            let mut circle = [0u8; 16];
            for (value, offset) in circle.iter_mut().zip(offsets) {
                *value = source[at.wrapping_add_signed(*offset)];
            }
            *score = fast_score(&circle, source[at]);
        }
    }
}

/// FAST-9's score: the largest threshold at which nine contiguous circle pixels are all brighter or all darker than the
/// centre; 0 where there is none.
#[inline(always)]
fn fast_score(circle: &[u8; 16], centre: u8) -> u8 {
    // The circle twice round, so that runs need no wrapping.
    let mut least = [0i16; 32];
    for k in 0..32 {
        least[k] = i16::from(circle[k % 16]) - i16::from(centre);
    }
    let once = least;
    let mut most = least;
    // The least (most) of nine in a row by doubling: of 2, of 4, of 8, and one more.
    for step in [1, 2, 4] {
        for k in 0..24 {
            least[k] = least[k].min(least[k + step]);
            most[k] = most[k].max(most[k + step]);
        }
    }
    let (mut brightest, mut darkest) = (i16::MIN, i16::MAX);
    for k in 0..16 {
        brightest = brightest.max(least[k].min(once[k + 8]));
        darkest = darkest.min(most[k].max(once[k + 8]));
    }
    // "Brighter by more than t" holds up to t = best - 1.
    (brightest.max(-darkest) - 1).clamp(0, 255) as u8
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
        fn wide_segment_test_equals_plain(seed in any::<u64>(), contrast in 1u64..256, n in 0usize..110, threshold in 0u8..80) {
            let byte = |k: usize| ((seed.wrapping_mul(6364136223846793005).wrapping_add((k as u64).wrapping_mul(0x9E3779B97F4A7C15)) >> 29) % contrast) as u8;
            let source: Vec<u8> = (0..7 * WIDTH).map(byte).collect();
            let (mut a, mut b) = (vec![9; n], vec![9; n]);
            let start = 3 * WIDTH + 4;
            segment_row(&source, start, &offsets(), threshold, &mut a);
            segment_row_plain(&source, start, &offsets(), threshold, &mut b);
            prop_assert_eq!(a, b);
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
