//! Finds candidates: points where the picture looks like four squares meeting.
//!
//! Where two dark and two light squares meet, the smoothed picture has a saddle: the determinant of
//! its second derivatives is negative there, whatever the tilt. Each saddle is then checked on a
//! small ring: opposite points of the ring must be alike, and the ring must cross the saddle's own
//! level exactly four times. The crossings are the directions of the two edges.

use std::f64::consts::PI;

use nalgebra::Vector2;

use super::level::Level;

/// A candidate corner on one level.
#[derive(Debug, Clone, Copy)]
pub(super) struct Saddle {
    /// Position, level pixels.
    pub position: Vector2<f64>,
    /// Unit vectors along the two edges: the quadrant from the first to the second at growing angle
    /// is dark.
    pub edges: [Vector2<f64>; 2],
    /// The saddle's own grey level.
    pub middle: f64,
    /// Half the difference between light and dark, grey levels.
    pub contrast: f64,
}

/// Determinant below which a saddle is noise, (grey levels per square pixel) squared: a board of
/// about 2.5 grey levels of contrast on a quiet sensor. Raised, dim boards are missed; lowered,
/// noise produces candidates, each of which costs a ring check.
const MIN_DETERMINANT: f32 = 2.5;
/// Maximum number of candidates kept, the strongest: more than the 10 000 corners of the largest
/// board. Raised, textured pictures take longer; lowered, texture with more contrast crowds out
/// large boards.
const MAX_CANDIDATES: usize = 12_000;
/// Radius of the ring, level pixels: three sigma of the smoothing, so that the quadrants show, and
/// less than a square. Raised, boards with small squares are missed; lowered, the smoothing mixes
/// the quadrants.
const RING_RADIUS: f64 = 3.0;
/// Number of points on half the ring: 0.6 pixels apart, finer than the picture's detail. Raised, a
/// candidate only costs more; lowered, the edges' directions get coarser.
const HALF_RING: usize = 16;

/// Offsets of the ring's points from its centre, x and y.
type Ring = [[f32; 2]; 2 * HALF_RING];

/// Returns all candidates of a level; `smooth` is the level after [`Level::smoothed`].
pub(super) fn find_saddles(smooth: &Level) -> Vec<Saddle> {
    let ring: Ring = std::array::from_fn(|k| {
        let (sin, cos) = (k as f64 * PI / HALF_RING as f64).sin_cos();
        [cos * RING_RADIUS, sin * RING_RADIUS].map(|c| c as f32)
    });
    let mut peaks = determinant_peaks(smooth);
    if peaks.len() > MAX_CANDIDATES {
        peaks.select_nth_unstable_by(MAX_CANDIDATES, |a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        peaks.truncate(MAX_CANDIDATES);
        peaks.sort_unstable_by_key(|p| p.1);
    }
    peaks.into_iter().filter_map(|(_, index)| look_at(smooth, index, &ring)).collect()
}

/// Returns the local maxima of Ixy² - Ixx Iyy with their pixel index.
fn determinant_peaks(smooth: &Level) -> Vec<(f32, usize)> {
    let (w, h) = (smooth.width, smooth.height);
    let margin = RING_RADIUS as usize + 2;
    if w < 2 * margin + 3 || h < 2 * margin + 3 {
        return Vec::new();
    }
    let mut determinant = vec![0.0_f32; w * h];
    for y in 1..h - 1 {
        let (a, b, c) = (&smooth.grey[(y - 1) * w..][..w], &smooth.grey[y * w..][..w], &smooth.grey[(y + 1) * w..][..w]);
        let out = &mut determinant[y * w + 1..][..w - 2];
        let rows = out.iter_mut().zip(a.windows(3)).zip(b.windows(3)).zip(c.windows(3));
        for (((out, a), b), c) in rows {
            let xx = b[0] - 2.0 * b[1] + b[2];
            let yy = a[1] - 2.0 * b[1] + c[1];
            let xy = 0.25 * (a[0] + c[2] - a[2] - c[0]);
            *out = xy * xy - xx * yy;
        }
    }
    let mut peaks = Vec::new();
    for y in margin..h - margin {
        let row = &determinant[y * w..][..w];
        for start in (margin..w - margin).step_by(8) {
            // Most pixels are flat: test eight at once.
            let end = (start + 8).min(w - margin);
            if row[start..end].iter().fold(true, |flat, &v| flat & (v < MIN_DETERMINANT)) {
                continue;
            }
            peaks.extend((start..end).map(|x| y * w + x).filter(|&at| is_peak(&determinant, w, at)).map(|at| (determinant[at], at)));
        }
    }
    peaks
}

/// Whether no neighbouring pixel is larger. Of equal ones, the last in a row and the first of the
/// rows is the peak.
fn is_peak(determinant: &[f32], w: usize, index: usize) -> bool {
    let value = determinant[index];
    if value < MIN_DETERMINANT || value <= determinant[index - 1] || value < determinant[index + 1] {
        return false;
    }
    let above = determinant[index - w - 1..=index - w + 1].iter().all(|&v| value > v);
    let below = determinant[index + w - 1..=index + w + 1].iter().all(|&v| value >= v);
    above && below
}

/// Returns the grey levels on the ring around a position. The ring must lie inside the picture, so
/// that its points need no clamping.
fn on_ring(smooth: &Level, position: Vector2<f64>, ring: &Ring) -> [f32; 2 * HALF_RING] {
    let (middle_x, middle_y, w) = (position.x as f32, position.y as f32, smooth.width);
    let mut around = [0.0; 2 * HALF_RING];
    for (grey, [x, y]) in around.iter_mut().zip(ring) {
        let (x, y) = (middle_x + x, middle_y + y);
        let (i, j) = (x as i32, y as i32);
        let (a, b) = (x - i as f32, y - j as f32);
        let first = j as usize * w + i as usize;
        let (top, bottom) = (&smooth.grey[first..][..2], &smooth.grey[first + w..][..2]);
        *grey = (top[0] * (1.0 - a) + top[1] * a) * (1.0 - b) + (bottom[0] * (1.0 - a) + bottom[1] * a) * b;
    }
    around
}

/// Returns the saddle point near a pixel if its ring is that of a chessboard corner.
fn look_at(smooth: &Level, index: usize, ring: &Ring) -> Option<Saddle> {
    let position = saddle_point(smooth, index)?;
    let middle = f64::from(smooth.sample(position));
    let around = on_ring(smooth, position, ring);
    let mut folded = [0.0_f64; HALF_RING];
    let mut asymmetry = 0.0;
    for (k, folded) in folded.iter_mut().enumerate() {
        let (one, two) = (f64::from(around[k]) - middle, f64::from(around[k + HALF_RING]) - middle);
        *folded = 0.5 * (one + two);
        asymmetry += (0.5 * (one - two)).powi(2);
    }
    let light = folded.iter().fold(0.0, |a: f64, &b| a.max(b));
    let dark = -folded.iter().fold(0.0, |a: f64, &b| a.min(b));
    let contrast = 0.5 * (light + dark);
    let uneven = (asymmetry / HALF_RING as f64).sqrt() > 0.45 * contrast;
    if uneven || light.min(dark) < 0.25 * contrast || contrast < 1.0 {
        return None;
    }
    Some(Saddle { position, edges: crossings(&folded)?.map(|angle| Vector2::new(angle.cos(), angle.sin())), middle, contrast })
}

/// Takes one Newton step to the point where the gradient vanishes; `None` if it is more than 1.5
/// pixels away along an axis.
fn saddle_point(smooth: &Level, index: usize) -> Option<Vector2<f64>> {
    let w = smooth.width;
    let at = |dx: isize, dy: isize| f64::from(smooth.grey[(index as isize + dy * w as isize + dx) as usize]);
    let (gx, gy) = (0.5 * (at(1, 0) - at(-1, 0)), 0.5 * (at(0, 1) - at(0, -1)));
    let xx = at(-1, 0) - 2.0 * at(0, 0) + at(1, 0);
    let yy = at(0, -1) - 2.0 * at(0, 0) + at(0, 1);
    let xy = 0.25 * (at(-1, -1) + at(1, 1) - at(-1, 1) - at(1, -1));
    let determinant = xx * yy - xy * xy;
    if determinant >= 0.0 {
        return None;
    }
    let step = Vector2::new(-(yy * gx - xy * gy), -(xx * gy - xy * gx)) / determinant;
    (step.amax() <= 1.5).then(|| Vector2::new((index % w) as f64, (index / w) as f64) + step)
}

/// Returns the two edges' angles from the half ring's signs, which must change exactly once to dark
/// and once to light.
fn crossings(folded: &[f64; HALF_RING]) -> Option<[f64; 2]> {
    let (mut to_dark, mut to_light) = (None, None);
    for k in 0..HALF_RING {
        let (a, b) = (folded[k], folded[(k + 1) % HALF_RING]);
        if (a < 0.0) == (b < 0.0) {
            continue;
        }
        let angle = (k as f64 + a / (a - b)) * PI / HALF_RING as f64;
        let slot = if b < 0.0 { &mut to_dark } else { &mut to_light };
        if slot.replace(angle).is_some() {
            return None;
        }
    }
    Some([to_dark?, to_light?])
}
