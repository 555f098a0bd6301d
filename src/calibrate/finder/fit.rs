//! The sub-pixel corner fit: fits a model of a blurred chessboard corner to the grey levels around
//! a position.
//!
//! The image of four squares that meet, blurred by a Gaussian, is
//! `a + b erf(d1 / √2σ) erf(d2 / √2σ)`, where d1 and d2 are the distances to the two edges, plus a
//! small term if the edges are not perpendicular. Position, both edge directions, blur and the two
//! levels are fitted together (Levenberg-Marquardt with analytic derivatives; the kernel is in
//! [`window`](super::window), and [`gather`](super::gather) collects the pixels). Model and window
//! are both symmetric about the corner, so unmodelled effects (gamma, sharpening, saturation,
//! motion blur) do not displace the corner. Two effects are not symmetric and are taken from the
//! neighbouring corners ([`Surroundings`]): the slope of the light, which over a blurred corner
//! looks just like a displacement, and the next edges, where their blur reaches the window.

use nalgebra::{SVector, Vector2};

use super::gather::gather;
use super::level::Level;
use super::step;
use super::surroundings::{Surroundings, reach};
use super::window::{Linearised, Model, N, Window};
use crate::geometry::least_squares::Damping;

/// A fitted corner.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CornerFit {
    /// Position, level pixels.
    pub position: Vector2<f64>,
    /// Standard deviation of the blur, pixels (a pixel's own width included).
    pub blur: f64,
    /// The grey level halfway between dark and light.
    pub middle: f64,
    /// Signed contrast: from the middle level to the squares in the first quadrant, grey levels;
    /// negative if those are dark.
    pub contrast: f64,
    /// Residual of the model, grey levels (rms).
    pub residual: f64,
}

/// The result of a fit over one window.
#[derive(Debug, Clone, Copy)]
pub(crate) struct WindowFit {
    /// The corner's offset from the window's centre, pixels.
    pub offset: Vector2<f64>,
    pub blur: f64,
    pub middle: f64,
    pub contrast: f64,
    /// Residual as a fraction of the contrast.
    pub residual: f64,
    /// The edges along u and v, with the lengths of the given steps.
    pub directions: [Vector2<f64>; 2],
}

/// Upper bound of the fitted blur, as a fraction of a square: above it, nothing of a corner remains
/// between the next edges. Chosen, not tuned. Raised, the model may become flat enough to fit a
/// shadow; lowered, small squares in soft pictures lie at the bound.
const WIDEST_BLUR: f64 = 0.6;
/// Lower bound of the fitted blur, pixels. A pixel's own width is 0.29; sharpened or subsampled
/// pictures with a smaller apparent blur have jagged edges, between whose steps a narrower model
/// would jump. Raised, sharp edges are fitted by wider ones.
const MIN_BLUR: f64 = 0.45;
/// Cosine of the maximum angle between an edge and the board's direction, 26 degrees: more than
/// perspective and distortion cause within a square. Raised, corners of strongly bent boards are
/// lost; lowered, fits that turned onto another edge are kept.
const ALONG: f64 = 0.9;
/// The fit ends with a step that moves the corner by less than this, pixels, and reduces the cost
/// by less than this fraction. That step is still applied, so the remaining error is smaller.
/// Raised, corners are less exact; lowered, each fit takes another iteration.
const LAST_STEP: f64 = 4e-3;
const LAST_GAIN: f64 = 3e-3;
/// Maximum number of windows per corner that are fitted to convergence; the last one's fit counts
/// as it is. Raised, corners that do not converge take longer …
const ROUNDS: usize = 4;
/// … after this many windows whose fit stops after one step, if that step shows that the window
/// must be redrawn. Raised, fits from a poor start may draw more windows; at 0 each window is
/// fitted to convergence before it is redrawn.
const HASTY_ROUNDS: usize = 2;
/// Maximum residual of a chessboard corner, as a fraction of the contrast. Chosen wide, not tuned,
/// since motion blur and sharpening leave residuals too;
/// [`Lattice::drop_disturbed`](super::lattice::Lattice::drop_disturbed) is stricter afterwards.
/// Raised, other crossings pass.
pub(crate) const MAX_RESIDUAL: f64 = 0.35;

/// Fits a corner near `start`, where `u` and `v` are one square's steps along the board's axes
/// (cross product positive). The window is made for `blur`, and the fit starts from the blur
/// `guess`. Returns `None` if there is no such corner.
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
            let good = fit.residual < MAX_RESIDUAL;
            let residual = fit.residual * fit.contrast.abs();
            return good.then_some(CornerFit { position: centre, blur, middle: fit.middle, contrast: fit.contrast, residual });
        }
    }
    None
}

/// The parameters with which a window was drawn.
#[derive(Debug, Clone, Copy)]
struct Drawn {
    blur: f64,
    has_edges: bool,
}

impl Drawn {
    /// Whether the window is still valid for a corner with this offset and blur.
    fn holds_for(&self, offset: Vector2<f64>, blur: f64) -> bool {
        let wide_enough = reach(blur) < reach(self.blur) + 0.8;
        // The contribution of the next edges was drawn with the previous blur.
        let same_blur = !self.has_edges || (blur / self.blur - 1.0).abs() < 0.03;
        // The window must be centred on the corner for its symmetry to help.
        offset.norm() < 0.1 && wide_enough && same_blur
    }

    /// Whether a first step is plausible, and so large that the window must be redrawn anyway.
    fn is_outdated_by(&self, model: &Model, step: &[f64; N]) -> bool {
        let is_sound = step[0].hypot(step[1]) < 0.5 && step[2..5].iter().all(|s| s.abs() < 0.2) && model.0[6].abs() > 1.0;
        is_sound && !self.holds_for(Vector2::new(model.0[0], model.0[1]), model.0[4].exp())
    }
}

/// Whether opposite quadrants are alike and neighbouring ones differ: a cheap test before the fit.
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

/// Fits the corner model to a window by least squares; `farthest` bounds the corner's offset,
/// pixels.
pub(crate) fn fit_window(window: &mut Window, directions: [Vector2<f64>; 2], blur: f64, farthest: f64) -> Option<WindowFit> {
    fit_drawn(window, directions, blur, farthest, None)
}

/// Does the same; if `drawn` is given and the first step shows that the window must be redrawn,
/// only that step is taken.
fn fit_drawn(window: &mut Window, [u, v]: [Vector2<f64>; 2], blur: f64, farthest: f64, drawn: Option<Drawn>) -> Option<WindowFit> {
    if window.len() < 2 * N {
        return None;
    }
    let widest = WIDEST_BLUR * u.perp(&v) / u.norm().max(v.norm());
    let (mut model, mut here) = start(window, [u, v], blur.min(widest))?;
    let bounds = [MIN_BLUR.ln(), widest.max(2.0 * MIN_BLUR).ln()];
    let mut damping = Damping { now: 1e-4, least: 1e-9, most: 1e4 };
    for iteration in 0..20 {
        // A blur at its bound that would move beyond it is held fixed, or it would spoil the step
        // of the other parameters.
        let downhill = here.gradient[4];
        let beyond = (model.0[4] <= bounds[0] && downhill > 0.0) || (model.0[4] >= bounds[1] && downhill < 0.0);
        let step = step::damped(&here, damping.now, beyond.then_some(4))?;
        let mut next = Model(model.0 - SVector::from(step));
        next.0[4] = next.0[4].clamp(bounds[0], bounds[1]);
        let moved = step[0].hypot(step[1]);
        let gain: f64 = step.iter().zip(&here.gradient).map(|(s, g)| s * g).sum();
        let is_outdated = iteration == 0 && drawn.is_some_and(|drawn| drawn.is_outdated_by(&next, &step));
        // For a step this small the linear model is accurate.
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

/// Returns the start model: edges along the board's directions, and the levels that fit best.
fn start(window: &mut Window, [u, v]: [Vector2<f64>; 2], blur: f64) -> Option<(Model, Linearised)> {
    let angle = |d: Vector2<f64>| d.y.atan2(d.x);
    window.with_levels(&Model([0.0, 0.0, angle(u), angle(v), blur.max(MIN_BLUR).ln(), 0.0, 1.0].into()))
}

/// Returns the result if the edges stayed near the board's directions.
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
