//! The pixels around a corner, and the kernel of the corner fit: the normal equations of the corner
//! model over these pixels.
//!
//! Eight pixels are processed side by side in single precision: sums are accurate to a millionth, a
//! corner to a ten thousandth of a pixel. One body is compiled twice, once for processors with
//! AVX2. Both versions do the same operations in the same order, so a corner is bit-identical on
//! every machine.

use std::f32::consts::{FRAC_1_SQRT_2, FRAC_2_SQRT_PI, LN_2, LOG2_E};

use crate::simd::multiversion;
use nalgebra::{SVector, Vector2};

/// Pixels processed side by side: one AVX2 register of single precision.
pub(super) const LANES: usize = 8;
/// Number of model parameters: position (2), the two edges' angles, ln blur, middle level,
/// contrast.
pub(crate) const N: usize = 7;

pub(super) type Eight = [f32; LANES];

/// One pixel near a corner.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Sample {
    /// Offset from the window's centre, pixels.
    pub offset: Vector2<f64>,
    /// Grey level.
    pub grey: f64,
    /// Weight.
    pub weight: f64,
    /// What the next edges add to the blurred step across u and to the one across v.
    pub beside: [f64; 2],
    /// What the area beyond the board's end adds to the pattern.
    pub beyond: f64,
}

/// The pixels' values, one array per quantity; the arrays are as long as the largest window so far.
#[derive(Debug, Default)]
pub(super) struct Pixels {
    pub x: Vec<f32>,
    pub y: Vec<f32>,
    pub grey: Vec<f32>,
    pub root_weight: Vec<f32>,
    pub beside: [Vec<f32>; 2],
    pub beyond: Vec<f32>,
}

impl Pixels {
    /// Makes room for `count` pixels.
    pub fn reserve(&mut self, count: usize) {
        if self.x.len() < count {
            let Self { x, y, grey, root_weight, beside: [across_u, across_v], beyond } = self;
            for row in [x, y, grey, root_weight, across_u, across_v, beyond] {
                row.resize(count, 0.0);
            }
        }
    }
}

/// Derivatives by the seven parameters, and residuals, of eight pixels, all multiplied by the root
/// of the weight.
type Rows = [Eight; N + 1];

/// The pixels around a corner, and scratch memory for the kernel.
#[derive(Debug, Default)]
pub(crate) struct Window {
    pub(super) pixels: Pixels,
    pub(super) count: usize,
    rows: Vec<Rows>,
}

/// The corner model: position from the window's centre, angles of the edges along u and v, ln blur,
/// middle level, contrast.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Model(pub SVector<f64, N>);

/// Upper triangle of all pairwise products of the derivatives by the seven parameters and the
/// residual.
type Gram = [[f32; N + 1]; N + 1];

/// Weighted cost, normal matrix and gradient.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Linearised {
    pub cost: f64,
    pub normal: [[f64; N]; N],
    pub gradient: [f64; N],
    /// Sum of the weights.
    pub weight: f64,
}

impl Window {
    /// Removes all pixels but keeps the memory.
    pub fn clear(&mut self) {
        self.count = 0;
    }

    /// Adds a pixel.
    pub fn push(&mut self, sample: &Sample) {
        let at = self.count;
        if at.is_multiple_of(LANES) {
            self.pixels.reserve(at + LANES);
            self.pixels.root_weight[at..at + LANES].fill(0.0);
        }
        let to = &mut self.pixels;
        (to.x[at], to.y[at]) = (sample.offset.x as f32, sample.offset.y as f32);
        (to.grey[at], to.root_weight[at]) = (sample.grey as f32, (sample.weight as f32).sqrt());
        (to.beside[0][at], to.beside[1][at]) = (sample.beside[0] as f32, sample.beside[1] as f32);
        to.beyond[at] = sample.beyond as f32;
        self.count += 1;
    }

    /// Returns the number of pixels.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Returns the weighted cost, normal matrix and gradient of the model.
    pub fn linearised(&mut self, model: &Model) -> Linearised {
        linear(&self.gram(model), [0.0, 1.0])
    }

    fn gram(&mut self, model: &Model) -> Gram {
        self.rows.resize(self.count.div_ceil(LANES), [[0.0; LANES]; N + 1]);
        products(&self.pixels, &mut self.rows, &model.0.map(|v| v as f32))
    }

    /// Returns the model with the two levels that fit `shape` best, and its
    /// [`linearised`](Self::linearised) equations; `shape` has middle 0 and contrast 1.
    pub fn with_levels(&mut self, shape: &Model) -> Option<(Model, Linearised)> {
        let gram = self.gram(shape);
        // The residual is linear in both levels, so the step to the minimum cost is exact.
        let at = |r: usize, c: usize| f64::from(gram[r][c]);
        let determinant = at(5, 5) * at(6, 6) - at(5, 6) * at(5, 6);
        let middle = -(at(6, 6) * at(5, N) - at(5, 6) * at(6, N)) / determinant;
        let contrast = 1.0 - (at(5, 5) * at(6, N) - at(5, 6) * at(5, N)) / determinant;
        let mut model = *shape;
        (model.0[5], model.0[6]) = (middle, contrast);
        let linearised = linear(&gram, [middle, contrast]);
        (middle.is_finite() && contrast.is_finite() && linearised.cost.is_finite()).then_some((model, linearised))
    }
}

/// Returns the equations of a model with other levels, from the products for middle 0 and contrast
/// 1: its residual and its derivatives are linear in the levels. Levels of 0 and 1 change nothing.
fn linear(gram: &Gram, [middle, contrast]: [f64; 2]) -> Linearised {
    let at = |r: usize, c: usize| f64::from(gram[r.min(c)][r.max(c)]);
    let with_residual = |k: usize| at(k, N) + middle * at(k, 5) + (contrast - 1.0) * at(k, 6);
    let cost = with_residual(N) + middle * with_residual(5) + (contrast - 1.0) * with_residual(6);
    let (mut normal, mut gradient) = ([[0.0; N]; N], [0.0; N]);
    let scale = [contrast, contrast, contrast, contrast, contrast, 1.0, 1.0];
    for r in 0..N {
        gradient[r] = scale[r] * with_residual(r);
        for c in r..N {
            normal[r][c] = scale[r] * scale[c] * f64::from(gram[r][c]);
            normal[c][r] = normal[r][c];
        }
    }
    Linearised { cost: cost.max(0.0), normal, gradient, weight: at(5, 5) }
}

multiversion! {
    /// Returns the sums over all pixels of the pairwise products of the rows' eight columns; the
    /// upper triangle.
    fn products(pixels: &Pixels, rows: &mut [Rows], model: &SVector<f32, N>) -> Gram;
    ["avx2"] => products_lanes, else products_lanes
}

#[inline(always)]
fn products_lanes(pixels: &Pixels, rows: &mut [Rows], model: &SVector<f32, N>) -> Gram {
    let p = model;
    let scale = FRAC_1_SQRT_2 / p[4].exp();
    let ((sin1, cos1), (sin2, cos2)) = (p[2].sin_cos(), p[3].sin_cos());
    // If the edges are not perpendicular, blur carries light across both at once: Mehler's series
    // in the cosine between their normals.
    let (slant, slant_by_turn) = (-(p[2] - p[3]).cos(), (p[2] - p[3]).sin());
    for (chunk, row) in rows.iter_mut().enumerate() {
        let at = LANES * chunk;
        let (px, py, grey, roots) = (eight(&pixels.x, at), eight(&pixels.y, at), eight(&pixels.grey, at), eight(&pixels.root_weight, at));
        let (beside1, beside2, beyond) = (eight(&pixels.beside[0], at), eight(&pixels.beside[1], at), eight(&pixels.beyond, at));
        // By index over all columns of a row at once, so that it compiles to wide registers.
        for k in 0..LANES {
            let (x, y) = (px[k] - p[0], py[k] - p[1]);
            // Distances to the edge along u (positive towards v) and to the edge along v (positive
            // towards u).
            let (z1, z2) = (scale * (cos1 * y - sin1 * x), scale * (sin2 * x - cos2 * y));
            let ((e1, g1), (e2, g2)) = (erf_and_slope(z1), erf_and_slope(z2));
            let (f1, f2) = (e1 + beside1[k], e2 + beside2[k]);
            let (product, h1, h2) = (z1 * z2, 2.0 * z1 * z1 - 1.0, 2.0 * z2 * z2 - 1.0);
            let peak = 0.5 * g1 * g2;
            let series = slant * (1.0 + slant * (product + slant * h1 * h2 * (1.0 / 6.0)));
            let pattern = f1 * f2 + peak * series + beyond[k];
            let root = roots[k];
            let amplitude = p[6] * root;
            let by_series1 = slant * slant * (z2 + slant * z1 * h2 * (2.0 / 3.0)) - 2.0 * z1 * series;
            let by_series2 = slant * slant * (z1 + slant * z2 * h1 * (2.0 / 3.0)) - 2.0 * z2 * series;
            let (by1, by2) = (amplitude * (f2 * g1 + peak * by_series1), amplitude * (f1 * g2 + peak * by_series2));
            let by_slant = amplitude * peak * (1.0 + slant * (2.0 * product + 0.5 * slant * h1 * h2)) * slant_by_turn;
            row[0][k] = scale * (by1 * sin1 - by2 * sin2);
            row[1][k] = scale * (by2 * cos2 - by1 * cos1);
            row[2][k] = by_slant - by1 * scale * (sin1 * y + cos1 * x);
            row[3][k] = by2 * scale * (cos2 * x + sin2 * y) - by_slant;
            row[4][k] = -(by1 * z1 + by2 * z2);
            row[5][k] = root;
            row[6][k] = pattern * root;
            row[7][k] = (p[5] + p[6] * pattern - grey[k]) * root;
        }
    }
    [line::<0>(rows), line::<1>(rows), line::<2>(rows), line::<3>(rows), line::<4>(rows), line::<5>(rows), line::<6>(rows), line::<7>(rows)]
}

/// Returns eight numbers from index `at` on.
#[inline(always)]
pub(super) fn eight(of: &[f32], at: usize) -> Eight {
    let mut eight = [0.0; LANES];
    eight.copy_from_slice(&of[at..at + LANES]);
    eight
}

/// Returns the products of column K with itself and the columns behind it.
#[inline(always)]
fn line<const K: usize>(rows: &[Rows]) -> [f32; N + 1] {
    let mut sums = [[0.0_f32; LANES]; N + 1];
    for row in rows {
        for l in K..=N {
            for k in 0..LANES {
                sums[l][k] += row[K][k] * row[l][k];
            }
        }
    }
    // Sum in a fixed order, so that the rounding does not depend on how it is compiled.
    sums.map(|s| ((s[0] + s[4]) + (s[1] + s[5])) + ((s[2] + s[6]) + (s[3] + s[7])))
}

/// Returns the error function (Abramowitz & Stegun 7.1.26, 1.5e-7) and its derivative, which share
/// the exponential.
#[inline(always)]
pub(crate) fn erf_and_slope(z: f32) -> (f32, f32) {
    let bell = exp_of_negative(-z * z);
    let t = 1.0 / (1.0 + 0.327_591_1 * z.abs());
    let tail = t * (0.254_829_6 + t * (-0.284_496_72 + t * (1.421_413_8 + t * (-1.453_152_1 + t * 1.061_405_4))));
    ((1.0 - tail * bell).copysign(z), FRAC_2_SQRT_PI * bell)
}

/// Returns e to the power of a number at or below 0, to 2e-7 of its value or 1e-12: an integer
/// power of two times a polynomial for the rest.
#[inline(always)]
fn exp_of_negative(x: f32) -> f32 {
    // 1.5 * 2^23: adding and subtracting it rounds to an integer, which then stands in the lowest
    // bits, since single precision steps by 1 there.
    const ROUND: f32 = 12_582_912.0;
    // Minimum exponent. Products of three such values must stay normal numbers (2^-126); subnormal
    // ones take a hundred times as long. Raised, the tails of blurred edges end too early; lowered,
    // such products underflow.
    const MIN_POWER: f32 = -40.0;
    let power = (x * LOG2_E).max(MIN_POWER);
    let rounded = power + ROUND;
    let rest = power - (rounded - ROUND);
    let whole = f32::from_bits(rounded.to_bits().wrapping_sub(ROUND.to_bits()).wrapping_add(127) << 23);
    // The series of 2^rest for |rest| <= 0.5.
    let series = 1.0
        + rest
            * (LN_2
                + rest
                    * (0.240_226_5 + rest * (0.055_504_11 + rest * (0.009_618_129 + rest * (0.001_333_355_8 + rest * 0.000_154_035_3)))));
    whole * series
}

#[cfg(test)]
mod tests {
    use nalgebra::SMatrix;

    use super::*;

    #[test]
    fn erf_is_within_its_documented_error() {
        // erf(0.5), erf(1), erf(2), erf(3) from tables.
        for (z, erf) in [(0.5, 0.520_499_9), (1.0, 0.842_700_8), (2.0, 0.995_322_3), (3.0, 0.999_977_9), (0.0, 0.0)] {
            for sign in [1.0, -1.0] {
                let (e, slope) = erf_and_slope(sign * z);
                assert!((e - sign * erf).abs() < 4e-7, "erf({z}) is not {e}");
                assert!((slope - FRAC_2_SQRT_PI * (-z * z).exp()).abs() < 4e-7, "slope at {z}");
            }
        }
        assert_eq!(erf_and_slope(50.0).0, 1.0);
    }

    fn drawn() -> (Window, Model) {
        let model = Model(SVector::from([0.3, -0.2, 0.15, 1.75, 0.1, 110.0, -70.0]));
        let mut window = Window::default();
        for k in 0..93 {
            let offset = Vector2::new(f64::from(k % 10) - 4.5, f64::from(k / 10) - 4.6);
            let grey = 110.0 + 60.0 * (offset.x * offset.y).signum() + f64::from(k % 7);
            let beside = [-0.01 * f64::from(k % 3), 0.02 * f64::from(k % 5)];
            window.push(&Sample { offset, grey, weight: 1.0 / (1.0 + 0.1 * f64::from(k)), beside, beyond: 0.005 * f64::from(k % 4) });
        }
        (window, model)
    }

    #[test]
    fn both_kernels_give_the_same_bits() {
        let (mut window, model) = drawn();
        window.rows.resize(window.count.div_ceil(LANES), [[0.0; LANES]; N + 1]);
        let numbers = model.0.map(|v| v as f32);
        let plain = products_lanes(&window.pixels, &mut window.rows, &numbers);
        assert_eq!(products(&window.pixels, &mut window.rows, &numbers).map(|r| r.map(f32::to_bits)), plain.map(|r| r.map(f32::to_bits)));
    }

    #[test]
    fn solved_grey_levels_match_the_drawn_model() {
        let (mut window, mut shape) = drawn();
        (shape.0[5], shape.0[6]) = (0.0, 1.0);
        let (model, found) = window.with_levels(&shape).unwrap();
        let drawn = window.linearised(&model);
        assert!((found.cost - drawn.cost).abs() < 1e-4 * drawn.cost, "{} is not {}", found.cost, drawn.cost);
        let [normal, drawn_normal] = [found, drawn].map(|l| SMatrix::<f64, N, N>::from(l.normal));
        assert!((normal - drawn_normal).amax() < 1e-4 * drawn_normal.amax());
        let [gradient, drawn_gradient] = [found, drawn].map(|l| SVector::<f64, N>::from(l.gradient));
        assert!((gradient - drawn_gradient).amax() < 1e-4 * drawn_gradient.amax());
        assert!(gradient.fixed_rows::<2>(5).amax() < 1e-4 * drawn.cost, "the levels are the best ones: {gradient}");
        assert!((found.weight - (0..93).map(|k| 1.0 / (1.0 + 0.1 * f64::from(k))).sum::<f64>()).abs() < 1e-4);
    }

    #[test]
    fn the_gradient_is_the_costs_slope() {
        let (mut window, model) = drawn();
        let gradient = SVector::<f64, N>::from(window.linearised(&model).gradient);
        for k in 0..N {
            let h = if k < 5 { 4e-3 } else { 0.1 };
            let mut moved = [model, model];
            (moved[0].0[k], moved[1].0[k]) = (model.0[k] - h, model.0[k] + h);
            let [low, high] = moved.map(|m| window.linearised(&m).cost);
            // The cost is the sum of squares, so half its slope is the gradient.
            let slope = (high - low) / (4.0 * h);
            assert!((slope - gradient[k]).abs() < 2e-3 * gradient[k].abs() + 2.0, "number {k}: {slope} is not {}", gradient[k]);
        }
    }
}
