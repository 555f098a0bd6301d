//! The sub-pixel corner: a blurred chessboard corner is drawn, and fitted to the grey levels around the place.
//!
//! The picture of four squares that meet, blurred by a Gaussian, is `a + b erf(d1 / √2σ) erf(d2 / √2σ)` with the
//! distances d1, d2 to the two edges. Position, both directions, blur, the two levels and a slope of the light are
//! fitted together (Levenberg-Marquardt, all analytic). The model and the window are both symmetric about the corner,
//! so that what the model does not know - gamma, sharpening, saturation, motion blur - moves the corner nowhere.

use std::f64::consts::{FRAC_1_SQRT_2, FRAC_2_SQRT_PI};

use nalgebra::{SMatrix, SVector, Vector2};

use super::level::Level;

/// A corner as the fit sees it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CornerFit {
    /// Level pixels.
    pub position: Vector2<f64>,
    /// Standard deviation of the blur, pixels (a pixel's own width included).
    pub blur: f64,
    /// Signed: grey levels from the middle to the squares in the first quadrant, which is negative where they are dark.
    pub contrast: f64,
}

/// One pixel near a corner: where it lies from the window's centre, its grey level and weight.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sample {
    pub offset: Vector2<f64>,
    pub grey: f64,
    pub weight: f64,
}

/// What a fit over samples gives.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SampleFit {
    /// The corner from the window's centre.
    pub offset: Vector2<f64>,
    pub blur: f64,
    pub contrast: f64,
    /// What the model leaves unexplained, as a share of the contrast.
    pub residual: f64,
    /// The edges as long as the steps given: along u and along v.
    pub directions: [Vector2<f64>; 2],
}

const N: usize = 9;
type Normal = SMatrix<f64, N, N>;
type Vector = SVector<f64, N>;

/// Share of a square, from the corner, that the window covers.
pub(crate) const WINDOW: f64 = 0.46;
/// Blur below this cannot be told from none: a pixel's own width is 0.29.
const LEAST_BLUR: f64 = 0.25;
/// Cosine of the largest turn of an edge from the board's direction.
const ALONG: f64 = 0.9;
/// Residuals above this share of the contrast are no chessboard corner.
pub(crate) const LARGEST_RESIDUAL: f64 = 0.35;

/// How far the window reaches, pixels: enough of the edges, and all of the blur.
pub(crate) fn reach(blur: f64) -> f64 {
    (4.0 + 3.0 * blur).clamp(7.0, 14.0)
}

/// The weight of a pixel at (s, t) squares along the two axes and `distance` pixels from the centre: it falls to nothing at
/// the window's rim, so that a pixel more or less changes nothing.
pub(crate) fn window_weight(s: f64, t: f64, distance: f64, reach: f64) -> f64 {
    let fall = |x: f64| 1.0 - (x * x).min(1.0);
    fall(s / WINDOW) * fall(t / WINDOW) * fall(distance / reach)
}

/// Fits a corner near `start`, where one square's step along the board's axes is `u` and `v` (their cross product positive).
/// `None` where there is no such corner.
pub(crate) fn fit_corner(level: &Level, start: Vector2<f64>, u: Vector2<f64>, v: Vector2<f64>, blur: f64) -> Option<CornerFit> {
    let area = u.perp(&v);
    if area.is_nan() || area < 4.0 || !looks_like_a_corner(level, start, u, v) {
        return None;
    }
    let farthest = 0.4 * area / u.norm().max(v.norm());
    let (mut centre, mut blur, mut directions) = (start, blur, [u, v]);
    let mut samples = Vec::with_capacity(512);
    for round in 0..4 {
        gather(level, centre, [u, v], reach(blur), &mut samples);
        let fit = fit_samples(&samples, directions, blur, farthest)?;
        let wide_enough = reach(fit.blur) < reach(blur) + 0.8;
        centre += fit.offset;
        (blur, directions) = (fit.blur, fit.directions);
        if directions[0].dot(&u) < ALONG * u.norm_squared() || directions[1].dot(&v) < ALONG * v.norm_squared() {
            return None;
        }
        if (centre - start).norm() > farthest || !level.has(centre, 2.0) {
            return None;
        }
        // The window must lie around the corner for its symmetry to help.
        if (fit.offset.norm() < 0.1 && wide_enough) || round == 3 {
            let good = fit.residual < LARGEST_RESIDUAL;
            return good.then_some(CornerFit { position: centre, blur, contrast: fit.contrast });
        }
    }
    None
}

/// Whether opposite quadrants are alike and neighbouring ones are not: a cheap look before the fit.
fn looks_like_a_corner(level: &Level, p: Vector2<f64>, u: Vector2<f64>, v: Vector2<f64>) -> bool {
    let (s, t) = (0.27 * (u + v), 0.27 * (u - v));
    if ![p + s, p - s, p + t, p - t].iter().all(|&q| level.has(q, 1.0)) {
        return false;
    }
    let (a, b) = (level.sample(p + s), level.sample(p - s));
    let (c, d) = (level.sample(p + t), level.sample(p - t));
    let step = (a.min(b) - c.max(d)).max(c.min(d) - a.max(b));
    step > 1.5
}

/// The pixels of the window.
fn gather(level: &Level, centre: Vector2<f64>, [u, v]: [Vector2<f64>; 2], reach: f64, samples: &mut Vec<Sample>) {
    samples.clear();
    let area = u.perp(&v);
    let half = Vector2::new(u.x.abs() + v.x.abs(), u.y.abs() + v.y.abs()).map(|c| (WINDOW * c).min(reach));
    let range =
        |c: f64, half: f64, size: usize| (c - half).ceil().max(0.0) as usize..((c + half).floor() + 1.0).clamp(0.0, size as f64) as usize;
    for y in range(centre.y, half.y, level.height) {
        for x in range(centre.x, half.x, level.width) {
            let offset = Vector2::new(x as f64, y as f64) - centre;
            let (s, t) = (offset.perp(&v) / area, u.perp(&offset) / area);
            if s.abs() < WINDOW && t.abs() < WINDOW && offset.norm() < reach {
                let weight = window_weight(s, t, offset.norm(), reach);
                samples.push(Sample { offset, grey: f64::from(level.grey[y * level.width + x]), weight });
            }
        }
    }
}

/// The model's numbers: position (2), the two edges' angles, ln blur, middle level, contrast, slope of the light (2).
#[derive(Debug, Clone, Copy)]
struct Model(Vector);

/// Least squares of the corner model over a window's samples; `farthest` bounds the corner's offset, pixels.
pub(crate) fn fit_samples(samples: &[Sample], [u, v]: [Vector2<f64>; 2], blur: f64, farthest: f64) -> Option<SampleFit> {
    if samples.len() < 2 * N {
        return None;
    }
    let widest = 0.5 * u.perp(&v) / u.norm().max(v.norm());
    let mut model = Model::start(samples, [u, v], blur.min(widest))?;
    let (mut cost, mut normal, mut gradient) = model.linearised(samples);
    let bounds = [LEAST_BLUR.ln(), widest.max(2.0 * LEAST_BLUR).ln()];
    let mut damping = 1e-4;
    for _ in 0..20 {
        let mut damped = normal;
        let mut downhill = gradient;
        for k in 0..N {
            damped[(k, k)] += damping * normal[(k, k)] + 1e-9;
        }
        // A blur that lies at its bound and wants beyond stays there, or it would spoil the other numbers' step.
        let beyond = (model.0[4] <= bounds[0] && downhill[4] > 0.0) || (model.0[4] >= bounds[1] && downhill[4] < 0.0);
        if beyond {
            damped.row_mut(4).fill(0.0);
            damped.column_mut(4).fill(0.0);
            (damped[(4, 4)], downhill[4]) = (1.0, 0.0);
        }
        let step = damped.cholesky()?.solve(&downhill);
        let mut next = Model(model.0 - step);
        next.0[4] = next.0[4].clamp(bounds[0], bounds[1]);
        let (next_cost, next_normal, next_gradient) = next.linearised(samples);
        if next_cost < cost {
            let gain = cost - next_cost;
            let moved = step.fixed_rows::<2>(0).norm();
            (model, cost, normal, gradient) = (next, next_cost, next_normal, next_gradient);
            damping = (0.1 * damping).max(1e-9);
            if moved < 2e-3 && gain < 1e-3 * cost {
                break;
            }
        } else {
            damping *= 10.0;
            if damping > 1e4 || step.fixed_rows::<2>(0).norm() < 1e-5 {
                break;
            }
        }
        if model.offset().norm() > farthest {
            return None;
        }
    }
    model.judged(samples, [u, v], cost)
}

impl Model {
    fn start(samples: &[Sample], [u, v]: [Vector2<f64>; 2], blur: f64) -> Option<Self> {
        let angle = |d: Vector2<f64>| d.y.atan2(d.x);
        let weight: f64 = samples.iter().map(|s| s.weight).sum();
        let mean = samples.iter().map(|s| s.weight * s.grey).sum::<f64>() / weight;
        let mut model = Self(Vector::from([0.0, 0.0, angle(u), angle(v), blur.max(LEAST_BLUR).ln(), mean, 1.0, 0.0, 0.0]));
        // The best levels for this shape: two numbers, linear.
        let (mut pp, mut pg, mut p1) = (0.0, 0.0, 0.0);
        for s in samples {
            let p = model.pattern(s.offset);
            pp += s.weight * p * p;
            pg += s.weight * p * s.grey;
            p1 += s.weight * p;
        }
        let determinant = pp * weight - p1 * p1;
        let contrast = (pg * weight - p1 * mean * weight) / determinant;
        model.0[6] = contrast;
        model.0[5] = mean - contrast * p1 / weight;
        model.0.iter().all(|v| v.is_finite()).then_some(model)
    }

    fn offset(&self) -> Vector2<f64> {
        self.0.fixed_rows::<2>(0).into_owned()
    }

    /// The product of the two blurred steps at an offset.
    fn pattern(&self, offset: Vector2<f64>) -> f64 {
        let d = offset - self.offset();
        let scale = FRAC_1_SQRT_2 / self.0[4].exp();
        let ((sin1, cos1), (sin2, cos2)) = (self.0[2].sin_cos(), self.0[3].sin_cos());
        erf_and_slope(scale * (cos1 * d.y - sin1 * d.x)).0 * erf_and_slope(scale * (sin2 * d.x - cos2 * d.y)).0
    }

    /// Weighted cost, normal matrix and gradient.
    fn linearised(&self, samples: &[Sample]) -> (f64, Normal, Vector) {
        let p = &self.0;
        let scale = FRAC_1_SQRT_2 / p[4].exp();
        let ((sin1, cos1), (sin2, cos2)) = (p[2].sin_cos(), p[3].sin_cos());
        let (middle, contrast) = (p[5], p[6]);
        let (mut cost, mut normal, mut gradient) = (0.0, [[0.0_f64; N]; N], [0.0_f64; N]);
        for sample in samples {
            let d = sample.offset - Vector2::new(p[0], p[1]);
            // Distances to the edge along u (positive towards v) and to the edge along v (positive towards u).
            let (z1, z2) = (scale * (cos1 * d.y - sin1 * d.x), scale * (sin2 * d.x - cos2 * d.y));
            let ((e1, g1), (e2, g2)) = (erf_and_slope(z1), erf_and_slope(z2));
            let light = 1.0 + p[7] * sample.offset.x + p[8] * sample.offset.y;
            let shape = middle + contrast * e1 * e2;
            let residual = shape * light - sample.grey;
            let (by1, by2) = (contrast * light * e2 * g1, contrast * light * e1 * g2);
            let row = [
                scale * (by1 * sin1 - by2 * sin2),
                scale * (by2 * cos2 - by1 * cos1),
                -by1 * scale * (sin1 * d.y + cos1 * d.x),
                by2 * scale * (cos2 * d.x + sin2 * d.y),
                -(by1 * z1 + by2 * z2),
                light,
                light * e1 * e2,
                shape * sample.offset.x,
                shape * sample.offset.y,
            ];
            let w = sample.weight;
            cost += w * residual * residual;
            for k in 0..N {
                let wk = w * row[k];
                gradient[k] += wk * residual;
                for l in k..N {
                    normal[k][l] += wk * row[l];
                }
            }
        }
        let full = Normal::from_fn(|r, c| if r <= c { normal[r][c] } else { normal[c][r] });
        (cost, full, Vector::from(gradient))
    }

    /// The result, where the edges stayed near the board's directions.
    fn judged(&self, samples: &[Sample], [u, v]: [Vector2<f64>; 2], cost: f64) -> Option<SampleFit> {
        let direction = |angle: f64, step: Vector2<f64>| Vector2::new(angle.cos(), angle.sin()) * step.norm();
        let directions = [direction(self.0[2], u), direction(self.0[3], v)];
        let straight = directions[0].dot(&u) > ALONG * u.norm_squared() && directions[1].dot(&v) > ALONG * v.norm_squared();
        let weight: f64 = samples.iter().map(|s| s.weight).sum();
        let contrast = self.0[6];
        let residual = (cost / weight).sqrt() / contrast.abs();
        let good = straight && contrast.abs() > 1.0 && residual.is_finite();
        good.then_some(SampleFit { offset: self.offset(), blur: self.0[4].exp(), contrast, residual, directions })
    }
}

/// The error function (Abramowitz & Stegun 7.1.26, 1.5e-7) and its derivative: they share the exponential.
fn erf_and_slope(z: f64) -> (f64, f64) {
    let bell = (-z * z).exp();
    let t = 1.0 / (1.0 + 0.327_591_1 * z.abs());
    let tail = t * (0.254_829_592 + t * (-0.284_496_736 + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    ((1.0 - tail * bell).copysign(z), FRAC_2_SQRT_PI * bell)
}
