//! Gradients of a row of pixels as length and direction.

use crate::simd::multiversion;

/// Lengths and directions of gradients of neighbouring pixels.
#[derive(Debug, Default)]
pub struct Gradients {
    /// In half grey levels per pixel (differences over two pixels), times the weights.
    pub lengths: Vec<f32>,
    /// Radians from x to y, -pi to pi.
    pub directions: Vec<f32>,
}

impl Gradients {
    /// Computes the gradients of the inner pixels of the middle of three adjacent rows; lengths are
    /// multiplied by each pixel's weight and by `weight`.
    pub fn of_row(&mut self, rows: [&[f32]; 3], weights: &[f32], weight: f32) {
        let n = rows[1].len().saturating_sub(2).min(weights.len());
        self.lengths.resize(n, 0.0);
        self.directions.resize(n, 0.0);
        if n > 0 {
            gradient_row(rows, weights, weight, &mut self.lengths, &mut self.directions);
        }
    }
}

multiversion! {
    fn gradient_row(rows: [&[f32]; 3], weights: &[f32], weight: f32, lengths: &mut [f32], directions: &mut [f32]);
    ["avx2"] => gradient_row_plain, else gradient_row_plain
}

#[inline(always)]
fn gradient_row_plain(rows: [&[f32]; 3], weights: &[f32], weight: f32, lengths: &mut [f32], directions: &mut [f32]) {
    let n = lengths.len();
    let (above, below) = (&rows[0][1..=n], &rows[2][1..=n]);
    let (left, right) = (&rows[1][..n], &rows[1][2..n + 2]);
    let (weights, directions) = (&weights[..n], &mut directions[..n]);
    for i in 0..n {
        let (x, y) = (right[i] - left[i], below[i] - above[i]);
        lengths[i] = (x * x + y * y).sqrt() * (weights[i] * weight);
        directions[i] = direction(x, y);
    }
}

/// Computes atan2(y, x) to 1e-5 radians without branches: Abramowitz & Stegun 4.4.47 for the first
/// eighth of the circle, reflected. Returns 0 for (0, 0).
#[inline(always)]
pub fn direction(x: f32, y: f32) -> f32 {
    let (ax, ay) = (x.abs(), y.abs());
    let (low, high) = if ax < ay { (ax, ay) } else { (ay, ax) };
    let t = low / (high + f32::MIN_POSITIVE);
    let s = t * t;
    let eighth = t * (0.999_866 + s * (-0.330_299_5 + s * (0.180_141 + s * (-0.085_133 + s * 0.020_835_1))));
    let quarter = if ax < ay { std::f32::consts::FRAC_PI_2 - eighth } else { eighth };
    let half = if x < 0.0 { std::f32::consts::PI - quarter } else { quarter };
    if y < 0.0 { -half } else { half }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gradient_directions_match_atan2() {
        for k in 0..=4000_i16 {
            let angle = (f32::from(k) / 2000.0 - 1.0) * 0.999 * std::f32::consts::PI;
            for length in [1e-3, 1.0, 300.0] {
                let (x, y) = (length * angle.cos(), length * angle.sin());
                assert!((direction(x, y) - y.atan2(x)).abs() < 2e-5, "{angle}");
            }
        }
        assert_eq!(direction(0.0, 0.0), 0.0);
    }

    #[test]
    fn a_ramp_has_its_slope_everywhere() {
        for n in [1, 7, 8, 50] {
            let row = |y: f32| (0..n + 2).map(|x| 3.0 * x as f32 + 4.0 * y).collect::<Vec<_>>();
            let (above, middle, below) = (row(0.0), row(1.0), row(2.0));
            let mut gradients = Gradients::default();
            gradients.of_row([&above, &middle, &below], &vec![0.5; n], 2.0);
            assert_eq!(gradients.lengths.len(), n);
            for (length, direction) in gradients.lengths.iter().zip(&gradients.directions) {
                assert!((length - 10.0).abs() < 1e-4 && (direction - 4.0_f32.atan2(3.0)).abs() < 2e-5);
            }
        }
        let mut none = Gradients::default();
        none.of_row([&[], &[], &[]], &[], 1.0);
        assert!(none.lengths.is_empty());
    }
}
