//! Where in a pixel, and when in the exposure, the pixel's rays are.

use nalgebra::Vector2;

/// Minimum improvement for a swap of two rays, in squared correlations (pixels to the fourth
/// power): rounding alone must not keep the swaps going. Raised, correlations remain; lowered to
/// zero, the loop may not end.
const MIN_GAIN: f64 = 1e-12;

/// One ray's position in its pixel and in the exposure.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    /// Offset from the pixel's centre, pixels, within ±0.5.
    pub offset_px: Vector2<f64>,
    /// Fraction of the exposure from its middle, within ±0.5.
    pub moment: f64,
}

/// Returns rays that fill the pixel and the exposure evenly. Each of the n columns, rows and time
/// slices has one ray (n rooks), so the mean offset is exactly zero and nothing is shifted.
///
/// Each ray has an opposite in place and time, so that all odd moments are zero. If the mean of x²
/// t, for example, were not zero, a moving picture would appear ahead of itself, in proportion to
/// the exposure. Columns, rows and times are as uncorrelated as n slices allow, so that neither the
/// pixel nor the blur is slanted.
pub(super) fn sample_pattern(count: usize) -> Vec<Sample> {
    let slice = |k: usize| (k as f64 + 0.5) / count as f64 - 0.5;
    // The first half's signed offsets are ordered by the plane's best-spread additive sequence,
    // whose steps are irrational; the second half mirrors them.
    let axis = |step: f64| {
        let half = count / 2;
        let value = |k: usize| ((k as f64 + 0.5) * step).fract() - 0.5;
        let mut by_size: Vec<usize> = (0..half).collect();
        by_size.sort_by(|a, b| value(*a).abs().total_cmp(&value(*b).abs()));
        let mut offsets = vec![0.0; count];
        for (rank, k) in by_size.into_iter().enumerate() {
            offsets[k] = slice(count - half + rank).copysign(value(k));
            offsets[count - 1 - k] = -offsets[k];
        }
        offsets
    };
    let mut axes = [axis(0.754_877_666_246_692_7), axis(0.569_840_290_998_053_2), (0..count).map(slice).collect()];
    decorrelate(&mut axes);
    let [columns, rows, moments] = axes;
    (0..count).map(|k| Sample { offset_px: Vector2::new(columns[k], rows[k]), moment: moments[k] }).collect()
}

/// Swaps the columns or rows of two rays, and of their opposites, as long as that brings the axes'
/// correlations nearer to zero; always makes the best swap.
fn decorrelate(axes: &mut [Vec<f64>; 3]) {
    let count = axes[0].len();
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    loop {
        let between = [product(&axes[0], &axes[1]), product(&axes[0], &axes[2]), product(&axes[1], &axes[2])];
        let misfit = |change: [f64; 3]| between.iter().zip(change).map(|(b, c)| (b + c).powi(2)).sum::<f64>();
        let mut best = (misfit([0.0; 3]), None);
        // The ray in the middle is its own opposite and stays.
        let pairs = || (0..count / 2).flat_map(|i| (i + 1..count).filter(move |j| 2 * j + 1 != count).map(move |j| (i, j)));
        for (axis, (i, j)) in (0..2).flat_map(|axis| pairs().map(move |pair| (axis, pair))) {
            let [own, other, moment] = [axis, 1 - axis, 2].map(|a| axes[a][j] - axes[a][i]);
            // The opposites change the products by the same amount, unless the two are each other's
            // opposite.
            let both = if i + j + 1 == count { -own } else { -2.0 * own };
            let with_moment = both * moment;
            let change = if axis == 0 { [both * other, with_moment, 0.0] } else { [both * other, 0.0, with_moment] };
            if misfit(change) < best.0 - MIN_GAIN {
                best = (misfit(change), Some((axis, i, j)));
            }
        }
        let Some((axis, i, j)) = best.1 else { return };
        axes[axis].swap(i, j);
        if i + j + 1 != count {
            axes[axis].swap(count - 1 - i, count - 1 - j);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_sample_the_pixel_and_the_exposure_evenly() {
        for count in [1, 4, 9, 16] {
            let pattern = sample_pattern(count);
            let mean = pattern.iter().map(|s| s.offset_px).sum::<Vector2<f64>>() / count as f64;
            assert!(mean.norm() < 1e-12);
            assert!(pattern.iter().map(|s| s.moment).sum::<f64>().abs() < 1e-12);
            assert!(pattern.iter().all(|s| s.offset_px.amax() < 0.5 && s.moment.abs() < 0.5));
            // One ray in each slice of every axis.
            for axis in [|s: &Sample| s.offset_px.x, |s: &Sample| s.offset_px.y, |s: &Sample| s.moment] {
                let mut slices: Vec<f64> = pattern.iter().map(axis).collect();
                slices.sort_by(f64::total_cmp);
                assert!(slices.windows(2).all(|w| (w[1] - w[0] - 1.0 / count as f64).abs() < 1e-12), "{slices:?}");
            }
        }
    }

    #[test]
    fn rays_favour_no_direction_of_motion() {
        for count in [1, 2, 3, 4, 7, 16, 25, 64] {
            let pattern = sample_pattern(count);
            let moment = |power: [i32; 3]| {
                let of = |s: &Sample| s.offset_px.x.powi(power[0]) * s.offset_px.y.powi(power[1]) * s.moment.powi(power[2]);
                pattern.iter().map(of).sum::<f64>() / count as f64
            };
            // A non-zero odd moment would shift moving things.
            let odd = [[1, 1, 1], [2, 0, 1], [0, 2, 1], [1, 0, 2], [0, 1, 2], [2, 1, 0], [1, 2, 0], [3, 0, 0], [0, 3, 0]];
            assert!(odd.iter().all(|power| moment(*power).abs() < 1e-15), "{count}: {:?}", odd.map(moment));
            // Correlations would slant the pixel and the blur.
            let mixed = [[1, 1, 0], [1, 0, 1], [0, 1, 1]].map(|power| 12.0 * moment(power));
            assert!(count < 16 || mixed.iter().all(|m| m.abs() < 0.03), "{count}: {mixed:?}");
        }
    }
}
