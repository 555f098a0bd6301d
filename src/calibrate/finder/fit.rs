//! The sub-pixel corner: a blurred chessboard corner is drawn, and fitted to the grey levels around the place.
//!
//! The picture of four squares that meet, blurred by a Gaussian, is `a + b erf(d1 / √2σ) erf(d2 / √2σ)` with the
//! distances d1, d2 to the two edges, and a little more where the edges are not square to each other. Position, both directions, blur and the two levels are fitted together
//! (Levenberg-Marquardt, all analytic; the kernel is in [`window`](super::window), and [`gather`](super::gather) takes the pixels). The model and the window are both
//! symmetric about the corner, so that what the model does not know - gamma, sharpening, saturation, motion blur - moves
//! the corner nowhere. Two things are not symmetric, and come from the corner's neighbours ([`Surroundings`]): the slope of
//! the light, which over a blurred corner looks just like a displaced one, and the next edges, where the blur reaches them.

use nalgebra::{SVector, Vector2};

use super::gather::gather;
use super::level::Level;
use super::step;
use super::surroundings::{Surroundings, reach};
use super::window::{Linearised, Model, N, Window};
use crate::geometry::least_squares::Damping;

/// A corner as the fit sees it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CornerFit {
    /// Level pixels.
    pub position: Vector2<f64>,
    /// Standard deviation of the blur, pixels (a pixel's own width included).
    pub blur: f64,
    /// The level half way between dark and light.
    pub middle: f64,
    /// Signed: grey levels from the middle to the squares in the first quadrant, which is negative where they are dark.
    pub contrast: f64,
    /// What the model leaves unexplained, grey levels (rms).
    pub residual: f64,
}

/// What a fit over a window gives.
#[derive(Debug, Clone, Copy)]
pub(crate) struct WindowFit {
    /// The corner from the window's centre.
    pub offset: Vector2<f64>,
    pub blur: f64,
    pub middle: f64,
    pub contrast: f64,
    /// What the model leaves unexplained, as a share of the contrast.
    pub residual: f64,
    /// The edges as long as the steps given: along u and along v.
    pub directions: [Vector2<f64>; 2],
}

/// Bound of the fitted blur, as a share of a square: above it nothing of a corner is left between the next edges. Chosen, not tuned.
/// Raised, the model may grow flat enough to fit a shadow; lowered, small squares of soft pictures lie at the bound.
const WIDEST_BLUR: f64 = 0.6;
/// Bound of the fitted blur, pixels: a pixel's own width is 0.29, and sharpened or thinned-out pictures that seem to have less have jagged
/// edges, between whose steps a narrower model would hop about. Raised, sharp edges are fitted by wider ones.
const LEAST_BLUR: f64 = 0.45;
/// Cosine of the largest turn of an edge from the board's direction, 26 degrees: more than perspective and distortion turn it within a
/// square. Raised, corners of strongly bent boards are lost; lowered, fits that turned onto another edge are kept.
const ALONG: f64 = 0.9;
/// The fit ends with a step of the corner below this, pixels, that gains less than this share of what is left unexplained. The step is
/// still taken, so what remains is smaller. Raised, corners are less exact; lowered, each fit takes another iteration.
const LAST_STEP: f64 = 4e-3;
const LAST_GAIN: f64 = 3e-3;
/// Windows drawn for one corner at most; the last one's fit counts as it is. Raised,
/// corners that do not settle take longer …
const ROUNDS: usize = 4;
/// … after this many that are good for one step only, where that shows that they do not lie around the corner. Raised, fits from a
/// poor start may take more windows in all; at 0 each window is fitted to its end before it is drawn again.
const HASTY_ROUNDS: usize = 2;
/// Residuals above this share of the contrast are no chessboard corner. Chosen wide, not tuned, for motion blur and
/// sharpening leave residuals too; [`Lattice::drop_disturbed`](super::lattice::Lattice::drop_disturbed) is stricter
/// afterwards. Raised, other crossings pass.
pub(crate) const LARGEST_RESIDUAL: f64 = 0.35;

/// Fits a corner near `start`, where one square's step along the board's axes is `u` and `v` (their cross product positive).
/// The window is made for `blur`, and the fit starts from the `guess` of it. `None` where there is no such corner.
pub(crate) fn fit_corner(
    level: &Level,
    start: Vector2<f64>,
    [u, v]: [Vector2<f64>; 2],
    [blur, guess]: [f64; 2],
    around: &Surroundings,
    window: &mut Window,
) -> Option<CornerFit> {
    let area = u.perp(&v);
    if area.is_nan() || area < 4.0 || !looks_like_a_corner(level, start, u, v) {
        return None;
    }
    let farthest = 0.4 * area / u.norm().max(v.norm());
    let (mut centre, mut made_for, mut blur, mut directions) = (start, blur, guess, [u, v]);
    for round in 0..HASTY_ROUNDS + ROUNDS {
        gather(level, centre, [u, v], made_for, around, window);
        let drawn = Drawn { blur: made_for, has_edges: around.edges.is_some() };
        let fit = fit_drawn(window, directions, blur, farthest, (round < HASTY_ROUNDS).then_some(drawn))?;
        centre += fit.offset;
        (blur, made_for, directions) = (fit.blur, fit.blur, fit.directions);
        if directions[0].dot(&u) < ALONG * u.norm_squared() || directions[1].dot(&v) < ALONG * v.norm_squared() {
            return None;
        }
        if (centre - start).norm() > farthest || !level.has(centre, 2.0) {
            return None;
        }
        if drawn.holds_for(fit.offset, fit.blur) || round == HASTY_ROUNDS + ROUNDS - 1 {
            let good = fit.residual < LARGEST_RESIDUAL;
            let residual = fit.residual * fit.contrast.abs();
            return good.then_some(CornerFit { position: centre, blur, middle: fit.middle, contrast: fit.contrast, residual });
        }
    }
    None
}

/// How a window was drawn.
#[derive(Debug, Clone, Copy)]
struct Drawn {
    blur: f64,
    has_edges: bool,
}

impl Drawn {
    /// Whether it need not be drawn again for a corner with this offset and blur.
    fn holds_for(&self, offset: Vector2<f64>, blur: f64) -> bool {
        let wide_enough = reach(blur) < reach(self.blur) + 0.8;
        // The next edges' share was drawn with the blur as it was before.
        let same_blur = !self.has_edges || (blur / self.blur - 1.0).abs() < 0.03;
        // The window must lie around the corner for its symmetry to help.
        offset.norm() < 0.1 && wide_enough && same_blur
    }

    /// Whether a first step to this model is to be believed, and so much of one that the window must be drawn again anyway.
    fn is_outdated_by(&self, model: &Model, step: &[f64; N]) -> bool {
        let is_sound = step[0].hypot(step[1]) < 0.5 && step[2..5].iter().all(|s| s.abs() < 0.2) && model.0[6].abs() > 1.0;
        is_sound && !self.holds_for(Vector2::new(model.0[0], model.0[1]), model.0[4].exp())
    }
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

/// Least squares of the corner model over a window; `farthest` bounds the corner's offset, pixels.
pub(crate) fn fit_window(window: &mut Window, directions: [Vector2<f64>; 2], blur: f64, farthest: f64) -> Option<WindowFit> {
    fit_drawn(window, directions, blur, farthest, None)
}

/// The same; where `drawn` is given and the first step shows that the window must be drawn again, that step is all.
fn fit_drawn(window: &mut Window, [u, v]: [Vector2<f64>; 2], blur: f64, farthest: f64, drawn: Option<Drawn>) -> Option<WindowFit> {
    if window.len() < 2 * N {
        return None;
    }
    let widest = WIDEST_BLUR * u.perp(&v) / u.norm().max(v.norm());
    let (mut model, mut here) = start(window, [u, v], blur.min(widest))?;
    let bounds = [LEAST_BLUR.ln(), widest.max(2.0 * LEAST_BLUR).ln()];
    let mut damping = Damping { now: 1e-4, least: 1e-9, most: 1e4 };
    for iteration in 0..20 {
        // A blur that lies at its bound and wants beyond stays there, or it would spoil the other numbers' step.
        let downhill = here.gradient[4];
        let beyond = (model.0[4] <= bounds[0] && downhill > 0.0) || (model.0[4] >= bounds[1] && downhill < 0.0);
        let step = step::damped(&here, damping.now, beyond.then_some(4))?;
        let mut next = Model(model.0 - SVector::from(step));
        next.0[4] = next.0[4].clamp(bounds[0], bounds[1]);
        let moved = step[0].hypot(step[1]);
        let gain: f64 = step.iter().zip(&here.gradient).map(|(s, g)| s * g).sum();
        let is_outdated = iteration == 0 && drawn.is_some_and(|drawn| drawn.is_outdated_by(&next, &step));
        // A step this small is as good as the linear model says.
        if is_outdated || (moved < LAST_STEP && gain < LAST_GAIN * here.cost) {
            model = next;
            break;
        }
        let there = window.linearised(&next);
        if there.cost < here.cost {
            (model, here) = (next, there);
            damping.fall();
        } else if !damping.rise() || moved < 5e-5 {
            break;
        }
        if model.0[0].hypot(model.0[1]) > farthest {
            return None;
        }
    }
    judged(&model, &here, [u, v])
}

/// Edges along the board, and the levels that fit best.
fn start(window: &mut Window, [u, v]: [Vector2<f64>; 2], blur: f64) -> Option<(Model, Linearised)> {
    let angle = |d: Vector2<f64>| d.y.atan2(d.x);
    window.with_levels(&Model([0.0, 0.0, angle(u), angle(v), blur.max(LEAST_BLUR).ln(), 0.0, 1.0].into()))
}

/// The result, where the edges stayed near the board's directions.
fn judged(model: &Model, seen: &Linearised, [u, v]: [Vector2<f64>; 2]) -> Option<WindowFit> {
    let direction = |angle: f64, step: Vector2<f64>| Vector2::new(angle.cos(), angle.sin()) * step.norm();
    let directions = [direction(model.0[2], u), direction(model.0[3], v)];
    let straight = directions[0].dot(&u) > ALONG * u.norm_squared() && directions[1].dot(&v) > ALONG * v.norm_squared();
    let (middle, contrast) = (model.0[5], model.0[6]);
    let residual = (seen.cost / seen.weight).sqrt() / contrast.abs();
    let good = straight && contrast.abs() > 1.0 && residual.is_finite();
    let offset = model.0.fixed_rows::<2>(0).into_owned();
    good.then_some(WindowFit { offset, blur: model.0[4].exp(), middle, contrast, residual, directions })
}
