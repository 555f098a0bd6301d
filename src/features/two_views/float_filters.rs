//! Operations on pictures of grey levels that detectors need: Gaussian smoothing, halving and
//! doubling.

use crate::features::float_image::{BLOCK, FloatImage};
use crate::simd::multiversion;

/// Radius at which a Gaussian is cut off, sigmas; 6e-5 of it is left there. Raised, smoothing takes
/// longer and changes less than rounding does.
const GAUSSIAN_REACH: f64 = 4.0;

impl FloatImage {
    /// Creates an image of zeros.
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, values: vec![0.0; width * height] }
    }

    /// Returns a row.
    pub fn row(&self, y: usize) -> &[f32] {
        &self.values[y * self.width..][..self.width]
    }

    /// Returns the image smoothed by a Gaussian of `sigma` pixels.
    pub fn blurred(&self, sigma: f64) -> Self {
        let mut out = Self::new(self.width, self.height);
        self.blur_into(sigma, &mut out, &mut Vec::new());
        out
    }

    /// Like [`blurred`](Self::blurred), into reusable buffers.
    pub fn blur_into(&self, sigma: f64, out: &mut Self, rows: &mut Vec<f32>) {
        self.blur_and_thin_into([sigma, sigma], [1, 1], out, rows);
    }

    /// Smooths by a Gaussian with separate sigmas along rows and columns, pixels, and keeps only
    /// each `every`-th column and row, from the first. Uses reusable buffers; skipped rows cost
    /// nothing.
    pub fn blur_and_thin_into(&self, sigmas: [f64; 2], every: [usize; 2], out: &mut Self, rows: &mut Vec<f32>) {
        let ([across, down], every) = (sigmas.map(gaussian), every.map(|n| n.max(1)));
        (out.width, out.height) = (self.width.div_ceil(every[0]), self.height.div_ceil(every[1]));
        out.values.resize(out.width * out.height, 0.0);
        if !self.values.is_empty() {
            convolve(self, [&across, &down], every, &mut out.values, rows);
        }
    }

    /// Returns every second pixel of every second row: pixel k of the result is pixel 2 k of this.
    pub fn decimated(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let mut values = Vec::with_capacity(width * height);
        for y in 0..height {
            values.extend((0..width).map(|x| self.values[2 * y * self.width + 2 * x]));
        }
        Self { width, height, values }
    }

    /// Returns the image doubled by bilinear interpolation: pixel k of the result is at (k + 0.5) /
    /// 2 - 0.5 of this.
    pub fn doubled(&self) -> Self {
        let mut out = Self::new(2 * self.width, 2 * self.height);
        if !self.values.is_empty() {
            double(self, &mut out.values, &mut Vec::new());
        }
        out
    }
}

/// Returns half of a Gaussian, centre first; both sides add up to 1.
fn gaussian(sigma: f64) -> Vec<f32> {
    let reach = (GAUSSIAN_REACH * sigma).ceil().max(0.0) as usize;
    let value = |k: usize| if k == 0 { 1.0 } else { (-0.5 * (k as f64 / sigma).powi(2)).exp() };
    let sum = 1.0 + 2.0 * (1..=reach).map(value).sum::<f64>();
    (0..=reach).map(|k| (value(k) / sum) as f32).collect()
}

multiversion! {
    /// Convolves rows with one and columns with another symmetric kernel (given as halves, centre
    /// first), computing only the columns and rows kept.
    fn convolve(source: &FloatImage, halves: [&[f32]; 2], every: [usize; 2], out: &mut [f32], row: &mut Vec<f32>);
    ["avx2"] => convolve_plain, else convolve_plain
}

#[inline(always)]
fn convolve_plain(source: &FloatImage, [across, down]: [&[f32]; 2], every: [usize; 2], out: &mut [f32], padded: &mut Vec<f32>) {
    let (w, h, reach) = (source.width, source.height, across.len() - 1);
    padded.clear();
    padded.resize(w + 2 * reach, 0.0);
    for (k, row) in out.chunks_exact_mut(w.div_ceil(every[0])).enumerate() {
        let y = k * every[1];
        // Convolve along columns first; the resulting row is still in the nearest cache when it is
        // convolved along itself.
        let pairs = (0..down.len()).map(|k| (source.row(y.saturating_sub(k)), source.row((y + k).min(h - 1))));
        weighted_sum(down, pairs, &mut padded[reach..reach + w]);
        let (first, last) = (padded[reach], padded[reach + w - 1]);
        padded[..reach].fill(first);
        padded[reach + w..].fill(last);
        if every[0] == 1 {
            let pairs = (0..=reach).map(|k| (&padded[reach - k..][..w], &padded[reach + k..][..w]));
            weighted_sum(across, pairs, row);
            continue;
        }
        for (k, out) in row.iter_mut().enumerate() {
            let x = reach + k * every[0];
            *out = across[0] * padded[x] + (1..=reach).map(|k| across[k] * (padded[x - k] + padded[x + k])).sum::<f32>();
        }
    }
}

/// Adds pairs of rows with the weights of a symmetric kernel, in blocks that stay in registers.
#[inline(always)]
fn weighted_sum<'a>(half: &[f32], pairs: impl Iterator<Item = (&'a [f32], &'a [f32])> + Clone, out: &mut [f32]) {
    let width = out.len();
    let mut x = 0;
    while x < width {
        // The last block overlaps the one before; the repeated pixels get the same values.
        if width >= BLOCK {
            x = x.min(width - BLOCK);
            let mut sums = [0.0; BLOCK];
            for (k, ((a, b), weight)) in pairs.clone().zip(half).enumerate() {
                let (Some(a), Some(b)) = (a[x..].first_chunk::<BLOCK>(), b[x..].first_chunk::<BLOCK>()) else { return };
                let weight = if k == 0 { 0.5 * weight } else { *weight };
                for i in 0..BLOCK {
                    sums[i] += weight * (a[i] + b[i]);
                }
            }
            out[x..x + BLOCK].copy_from_slice(&sums);
            x += BLOCK;
        } else {
            let weights = half.iter().enumerate().map(|(k, weight)| if k == 0 { 0.5 * weight } else { *weight });
            out[x] = pairs.clone().zip(weights).map(|((a, b), weight)| weight * (a[x] + b[x])).sum();
            x += 1;
        }
    }
}

multiversion! {
    fn double(source: &FloatImage, out: &mut [f32], row: &mut Vec<f32>); ["avx2"] => double_plain, else double_plain
}

/// A pixel becomes two, a quarter of a pixel before and after it: three quarters of itself plus a
/// quarter of a neighbour.
#[inline(always)]
fn double_plain(source: &FloatImage, out: &mut [f32], padded: &mut Vec<f32>) {
    let (w, h) = (source.width, source.height);
    padded.clear();
    padded.resize(w + 2, 0.0);
    for (y, row) in out.chunks_exact_mut(2 * w).enumerate() {
        let near = y / 2;
        let far = if y % 2 == 0 { near.saturating_sub(1) } else { (near + 1).min(h - 1) };
        for ((o, a), b) in padded[1..].iter_mut().zip(source.row(near)).zip(source.row(far)) {
            *o = 0.75 * a + 0.25 * b;
        }
        padded[0] = padded[1];
        padded[w + 1] = padded[w];
        for (pair, [a, b, c]) in row.as_chunks_mut::<2>().0.iter_mut().zip(triples(padded)) {
            *pair = [0.75 * b + 0.25 * a, 0.75 * b + 0.25 * c];
        }
    }
}

/// Returns each value of a row with both its neighbours.
#[inline(always)]
fn triples(row: &[f32]) -> impl Iterator<Item = [f32; 3]> {
    row.iter().zip(&row[1..]).zip(&row[2..]).map(|((a, b), c)| [*a, *b, *c])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dot() -> FloatImage {
        let mut image = FloatImage::new(61, 51);
        image.values[25 * 61 + 30] = 1.0;
        image
    }

    #[test]
    fn smoothing_adds_the_variance_of_its_kernel_and_keeps_the_sum() {
        for sigma in [0.8, 1.6, 3.0] {
            let blurred = dot().blurred(sigma);
            let sum: f32 = blurred.values.iter().sum();
            let variance = |along: fn(usize) -> f32| blurred.values.iter().enumerate().map(|(k, v)| v * along(k)).sum::<f32>();
            let across = variance(|k| ((k % 61) as f32 - 30.0).powi(2));
            let down = variance(|k| ((k / 61) as f32 - 25.0).powi(2));
            assert!((sum - 1.0).abs() < 1e-4, "{sum}");
            for v in [across, down] {
                assert!((f64::from(v).sqrt() - sigma).abs() < 0.01, "{sigma}: {v}");
            }
        }
    }

    #[test]
    fn a_uniform_picture_stays_uniform_to_its_border() {
        let even = FloatImage { width: 20, height: 9, values: vec![7.0; 180] };
        assert!(even.blurred(4.0).values.iter().all(|v| (v - 7.0).abs() < 1e-4));
        assert_eq!(FloatImage::default().blurred(2.0), FloatImage::default());
    }

    #[test]
    fn halving_and_doubling_keep_a_ramp() {
        let ramp = FloatImage { width: 8, height: 6, values: (0..48).map(|k| (k % 8) as f32 + 10.0 * (k / 8) as f32).collect() };
        let doubled = ramp.doubled();
        assert_eq!((doubled.width, doubled.height), (16, 12));
        assert!((doubled.bilinear(4.5, 6.5) - ramp.bilinear(2.0, 3.0)).abs() < 1e-4);
        assert_eq!(ramp.decimated().row(1), &[20.0, 22.0, 24.0, 26.0]);
    }

    #[test]
    fn convolution_and_doubling_match_their_definitions() {
        for (width, height) in [(1, 1), (1, 40), (2, 3), (31, 5), (32, 9), (33, 8), (97, 30)] {
            let values = (0..width * height).map(|k| ((k * 7919) % 251) as f32).collect();
            let image = FloatImage { width, height, values };
            for sigma in [0.3, 1.2, 3.1] {
                let (half, blurred) = (gaussian(sigma), image.blurred(sigma));
                let reach = half.len() as isize - 1;
                for (k, value) in blurred.values.iter().enumerate() {
                    let (x, y) = ((k % width) as isize, (k / width) as isize);
                    let offsets = (-reach..=reach).flat_map(|j| (-reach..=reach).map(move |i| (i, j)));
                    let weight = |i: isize| f64::from(half[i.unsigned_abs()]);
                    let exact: f64 = offsets.map(|(i, j)| weight(i) * weight(j) * f64::from(image.at(x + i, y + j))).sum();
                    assert!((f64::from(*value) - exact).abs() < 1e-3, "{width} x {height}, {sigma}, {x} {y}: {value} not {exact}");
                }
            }
            for every in [[1, 2], [2, 1], [3, 5]] {
                let (mut thin, blurred) = (FloatImage::default(), image.blurred(1.2));
                image.blur_and_thin_into([1.2, 1.2], every, &mut thin, &mut Vec::new());
                assert_eq!((thin.width, thin.height), (width.div_ceil(every[0]), height.div_ceil(every[1])));
                for (k, value) in thin.values.iter().enumerate() {
                    let at = k / thin.width * every[1] * width + k % thin.width * every[0];
                    assert!((value - blurred.values[at]).abs() < 1e-3, "{width} x {height}, {every:?}, {k}");
                }
            }
            let doubled = image.doubled();
            for (k, value) in doubled.values.iter().enumerate() {
                let [x, y] = [k % (2 * width), k / (2 * width)].map(|c| (c as f32 + 0.5) * 0.5 - 0.5);
                assert!((value - image.bilinear(x, y)).abs() < 1e-3, "{width} x {height}, {x} {y}");
            }
        }
    }
}
