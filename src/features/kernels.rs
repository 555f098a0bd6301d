//! The hot loops of feature finding, each as a plain function and, where the processor allows it (asked at
//! run time), the same function compiled for wider registers.

/// Radius of FAST's circle in pixels.
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

/// Marks the pixels of one row that may be FAST-9 corners: at least two neighbouring compass points of the circle are all
/// brighter, or all darker, than the centre by more than `threshold`. Rows are those at y-3, y and y+3; all of one length.
pub fn compass_row(above: &[u8], row: &[u8], below: &[u8], threshold: u8, marks: &mut [u8]) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: the processor has AVX2; the function is safe code compiled for it.
        unsafe { compass_row_avx2(above, row, below, threshold, marks) };
        return;
    }
    compass_row_plain(above, row, below, threshold, marks);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn compass_row_avx2(above: &[u8], row: &[u8], below: &[u8], threshold: u8, marks: &mut [u8]) {
    compass_row_plain(above, row, below, threshold, marks);
}

/// The plain twin of [`compass_row`].
#[inline(always)]
pub fn compass_row_plain(above: &[u8], row: &[u8], below: &[u8], threshold: u8, marks: &mut [u8]) {
    let n = row.len();
    if n < 2 * CIRCLE_RADIUS + 1 {
        marks.fill(0);
        return;
    }
    marks[..CIRCLE_RADIUS].fill(0);
    marks[n - CIRCLE_RADIUS..n].fill(0);
    let inner = n - 2 * CIRCLE_RADIUS;
    let (north, south) = (&above[CIRCLE_RADIUS..][..inner], &below[CIRCLE_RADIUS..][..inner]);
    let (west, east) = (&row[..inner], &row[2 * CIRCLE_RADIUS..][..inner]);
    let centre = &row[CIRCLE_RADIUS..][..inner];
    let out = &mut marks[CIRCLE_RADIUS..][..inner];
    for x in 0..inner {
        let high = centre[x].saturating_add(threshold);
        let low = centre[x].saturating_sub(threshold);
        let brighter = |v: u8| u8::from(v > high);
        let darker = |v: u8| u8::from(v < low);
        let (bn, bs, bw, be) = (brighter(north[x]), brighter(south[x]), brighter(west[x]), brighter(east[x]));
        let (dn, ds, dw, de) = (darker(north[x]), darker(south[x]), darker(west[x]), darker(east[x]));
        // A neighbouring pair is one of {n, s} with one of {w, e}.
        out[x] = ((bn | bs) & (bw | be)) | ((dn | ds) & (dw | de));
    }
}

/// FAST-9's score: the largest threshold at which nine contiguous circle pixels are all brighter or all darker than the
/// centre; 0 where there is none.
pub fn fast_score(circle: &[u8; 16], centre: u8) -> u8 {
    let mut difference = [0i16; 24];
    for (k, v) in circle.iter().enumerate() {
        difference[k] = i16::from(*v) - i16::from(centre);
    }
    for k in 0..8 {
        difference[16 + k] = difference[k];
    }
    let mut best = 0;
    for start in 0..16 {
        let arc = &difference[start..start + 9];
        let (mut least, mut most) = (i16::MAX, i16::MIN);
        for d in arc {
            least = least.min(*d);
            most = most.max(*d);
        }
        best = best.max(least).max(-most);
    }
    // "Brighter by more than t" holds up to t = best - 1.
    (best - 1).clamp(0, 255) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn wide_compass_equals_plain(seed in any::<u64>(), n in 0usize..200, threshold in 0u8..80) {
            let byte = |k: usize| (seed.wrapping_mul(6364136223846793005).wrapping_add((k as u64).wrapping_mul(0x9E3779B97F4A7C15)) >> 29) as u8;
            let rows: Vec<Vec<u8>> = (0..3).map(|r| (0..n).map(|k| byte(r * 1000 + k)).collect()).collect();
            let (mut a, mut b) = (vec![9; n], vec![9; n]);
            compass_row(&rows[0], &rows[1], &rows[2], threshold, &mut a);
            compass_row_plain(&rows[0], &rows[1], &rows[2], threshold, &mut b);
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

        #[test]
        fn the_compass_test_never_drops_a_corner(circle in any::<[u8; 16]>(), centre in any::<u8>(), threshold in 1u8..60) {
            if fast_score(&circle, centre) >= threshold {
                let mut rows = [[0u8; 7]; 3];
                rows[1][3] = centre;
                rows[0][3] = circle[0];
                rows[1][6] = circle[4];
                rows[2][3] = circle[8];
                rows[1][0] = circle[12];
                let mut marks = [0; 7];
                compass_row_plain(&rows[0], &rows[1], &rows[2], threshold, &mut marks);
                prop_assert_eq!(marks[3], 1);
            }
        }
    }
}
