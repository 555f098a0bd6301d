//! A picture of grey levels as `f32`, with the operations detectors need: Gaussian smoothing,
//! interpolation, halving and doubling.

use image::GrayImage;

use crate::simd::multiversion;

/// Grey levels, row-major; pixel centres at integers. The border values repeat outside.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FloatImage {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `width` x `height` values.
    pub values: Vec<f32>,
}

/// Radius at which a Gaussian is cut off, sigmas; 6e-5 of it is left there. Raised, smoothing takes
/// longer and changes less than rounding does.
const GAUSSIAN_REACH: f64 = 4.0;

impl FloatImage {
    /// Creates an image of zeros.
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, values: vec![0.0; width * height] }
    }

    /// Converts the grey levels 0 to 255 of a picture.
    pub fn from_grey(picture: &GrayImage) -> Self {
        let values = picture.as_raw().iter().map(|v| f32::from(*v)).collect();
        Self { width: picture.width() as usize, height: picture.height() as usize, values }
    }

    /// Returns a row.
    pub fn row(&self, y: usize) -> &[f32] {
        &self.values[y * self.width..][..self.width]
    }

    /// Returns the value of a pixel; outside, that of the nearest border pixel.
    pub fn at(&self, x: isize, y: isize) -> f32 {
        let clamp = |v: isize, n: usize| v.clamp(0, n as isize - 1) as usize;
        self.values[clamp(y, self.height) * self.width + clamp(x, self.width)]
    }

    /// Returns the bilinearly interpolated value between pixels.
    pub fn bilinear(&self, x: f32, y: f32) -> f32 {
        let (left, top) = (x.floor(), y.floor());
        let (a, b) = (x - left, y - top);
        let (i, k) = (left as isize, top as isize);
        let [p, q, r, s] = if i >= 0 && k >= 0 && i + 1 < self.width as isize && k + 1 < self.height as isize {
            let at = k as usize * self.width + i as usize;
            [self.values[at], self.values[at + 1], self.values[at + self.width], self.values[at + self.width + 1]]
        } else {
            [self.at(i, k), self.at(i + 1, k), self.at(i, k + 1), self.at(i + 1, k + 1)]
        };
        let (upper, lower) = (p + a * (q - p), r + a * (s - r));
        upper + b * (lower - upper)
    }

    /// Samples a straight line bilinearly, from `start` in steps of `step` (column and row,
    /// pixels).
    pub fn sample_line(&self, start: [f32; 2], step: [f32; 2], out: &mut [f32]) {
        if self.width > 1 && self.height > 1 {
            sample_wide(self, start, step, out);
        } else {
            let at = |i: usize, k: usize| start[k] + i as f32 * step[k];
            out.iter_mut().enumerate().for_each(|(i, value)| *value = self.bilinear(at(i, 0), at(i, 1)));
        }
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

multiversion! {
    /// Like [`FloatImage::sample_line`], for a picture of at least two columns and rows.
    fn sample_wide(image: &FloatImage, start: [f32; 2], step: [f32; 2], out: &mut [f32]);
    ["avx2"] => sample_wide_plain, else sample_wide_plain
}

#[inline(always)]
fn sample_wide_plain(image: &FloatImage, start: [f32; 2], step: [f32; 2], out: &mut [f32]) {
    let width = image.width;
    // Outside, the border values repeat: clamp to the nearest place inside.
    let ends = [width, image.height].map(|side| side as f32 - 1.0);
    let lasts = [width, image.height].map(|side| side as i32 - 2);
    for (k, out) in out.chunks_mut(BLOCK).enumerate() {
        // In three loops, of which only the middle one, which reads the pixels, is not vectorised.
        let (mut places, mut shares, mut pixels) = ([0u32; BLOCK], [[0.0f32; BLOCK]; 2], [[0.0f32; BLOCK]; 4]);
        for i in 0..BLOCK {
            let along = (k * BLOCK + i) as f32;
            let (x, y) = (start[0] + along * step[0], start[1] + along * step[1]);
            let (x, y) = (x.max(0.0).min(ends[0]), y.max(0.0).min(ends[1]));
            // For non-negative numbers truncation is the floor. Signed integers convert in one
            // instruction.
            let (column, row) = ((x as i32).min(lasts[0]), (y as i32).min(lasts[1]));
            (shares[0][i], shares[1][i]) = (x - column as f32, y - row as f32);
            places[i] = row as u32 * width as u32 + column as u32;
        }
        for (i, place) in places.iter().enumerate().take(out.len()) {
            let Some(rows) = image.values.get(*place as usize..).and_then(|v| v.get(..width + 2)) else { continue };
            (pixels[0][i], pixels[1][i]) = (rows[0], rows[1]);
            (pixels[2][i], pixels[3][i]) = (rows[width], rows[width + 1]);
        }
        for (i, value) in out.iter_mut().enumerate() {
            let [a, b] = [shares[0][i], shares[1][i]];
            let [p, q, r, s] = [pixels[0][i], pixels[1][i], pixels[2][i], pixels[3][i]];
            let (upper, lower) = (p + a * (q - p), r + a * (s - r));
            *value = upper + b * (lower - upper);
        }
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

/// Number of pixels summed in registers at once: four AVX2 registers. Raised, they no longer fit
/// beside the operands.
const BLOCK: usize = 32;

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
    fn interpolation_is_exact_on_a_ramp() {
        let ramp = FloatImage { width: 8, height: 6, values: (0..48).map(|k| (k % 8) as f32 + 10.0 * (k / 8) as f32).collect() };
        assert!((ramp.bilinear(2.25, 3.5) - 37.25).abs() < 1e-5);
        assert_eq!(ramp.bilinear(-5.0, 100.0), 50.0);
        // Lines inside, along the border, and outside.
        for (start, step) in [([1.2, 1.1], [0.7, 0.3]), ([6.9, 4.8], [-0.7, -0.4]), ([0.0, 0.0], [1.0, 0.7]), ([-3.0, 9.0], [2.1, -1.9])] {
            let mut line = [0.0; 8];
            ramp.sample_line(start, step, &mut line);
            for (i, value) in line.iter().enumerate() {
                assert!((value - ramp.bilinear(start[0] + i as f32 * step[0], start[1] + i as f32 * step[1])).abs() < 1e-4);
            }
        }
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
