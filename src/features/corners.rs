//! Corners of one pyramid level: FAST-9 (Rosten & Drummond) finds them, the smaller eigenvalue of the
//! structure tensor (Shi & Tomasi) ranks them, and a grid spreads them over the picture.

use image::GrayImage;

use super::kernels::{CIRCLE, CIRCLE_RADIUS, score_row, segment_row};

/// A corner on a pyramid level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Corner {
    /// Column in level pixels.
    pub x: u32,
    /// Row in level pixels.
    pub y: u32,
    /// Smaller eigenvalue of the 7x7 structure tensor, (grey/px)² per pixel (while candidates: FAST's score).
    pub strength: f32,
}

/// What to look for on a level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CornerOptions {
    /// Corners wanted at most.
    pub count: usize,
    /// Usual contrast, grey levels; twice as much is tried first, `least_threshold` last.
    pub threshold: u8,
    /// Lowest contrast.
    pub least_threshold: u8,
    /// Pixels at the border where none is wanted (the descriptor's reach).
    pub border: u32,
    /// Side of the squares that share the corners among them, level pixels.
    pub cell_px: u32,
}

/// Buffers of the detector.
#[derive(Debug, Clone, Default)]
pub struct CornerBuffers {
    marks: Vec<u8>,
    scores: Vec<u8>,
    pending: Vec<(usize, u8)>,
    previous: Vec<(usize, u8)>,
    candidates: Vec<Corner>,
    corners: Vec<Corner>,
    order: Vec<u32>,
    filled: Vec<u32>,
}

/// Finds at most `options.count` corners, strongest first within an even spread; `mask` (if any) tells by level position
/// whether a pixel may be used.
pub fn detect_corners(
    image: &GrayImage,
    options: &CornerOptions,
    mask: impl Fn(u32, u32) -> bool,
    buffers: &mut CornerBuffers,
    found: &mut Vec<Corner>,
) {
    found.clear();
    let (w, h) = image.dimensions();
    let border = options.border.max(CIRCLE_RADIUS as u32 + 1);
    if w <= 2 * border || h <= 2 * border {
        return;
    }
    // High contrast first: a rich picture has enough of it, and each step down costs more than the last.
    for threshold in [2 * options.threshold, options.threshold, options.least_threshold] {
        segment_test(image, threshold, border, buffers);
        if 2 * buffers.candidates.len() >= 3 * options.count {
            break;
        }
    }
    let CornerBuffers { candidates, corners, order, filled, .. } = buffers;
    candidates.retain(|c| mask(c.x, c.y));
    // FAST's score, which costs nothing more, chooses those that are worth an eigenvalue.
    corners.clear();
    spread(candidates, order, filled, (w, h), &CornerOptions { count: SHORTLIST * options.count, ..*options }, corners);
    for corner in corners.iter_mut() {
        corner.strength = smaller_eigenvalue(image, corner.x, corner.y);
    }
    spread(corners, order, filled, (w, h), options, found);
}

/// Corners ranked by eigenvalue for each one wanted. Raised, more eigenvalues are computed; at 1 FAST's score alone would choose.
const SHORTLIST: usize = 3;

/// Leaves in `buffers.candidates` the FAST-9 corners that are the largest of their 3x3 neighbourhood.
fn segment_test(image: &GrayImage, threshold: u8, border: u32, buffers: &mut CornerBuffers) {
    let (w, h) = (image.width() as usize, image.height() as usize);
    let source = image.as_raw();
    let b = border as usize;
    buffers.marks.resize(w - 2 * b, 0);
    // Scores of three rows roll around; row y is complete when row y + 1 was scored.
    buffers.scores.clear();
    buffers.scores.resize(3 * w, 0);
    buffers.candidates.clear();
    let offsets = CIRCLE.map(|(dx, dy)| dy * w as isize + dx);
    let (mut pending, mut previous) = (std::mem::take(&mut buffers.pending), std::mem::take(&mut buffers.previous));
    pending.clear();
    for y in b..=h - b {
        let slot = (y % 3) * w;
        buffers.scores[slot..slot + w].fill(0);
        previous.clear();
        std::mem::swap(&mut previous, &mut pending);
        if y < h - b {
            segment_row(source, y * w + b, &offsets, threshold, &mut buffers.marks);
            let scores = &mut buffers.scores[slot + b..slot + w - b];
            score_row(source, y * w + b, &offsets, &buffers.marks, scores);
            pending.extend(scores.iter().enumerate().filter(|(_, s)| **s != 0).map(|(k, s)| (b + k, *s)));
        }
        for &(x, score) in &previous {
            if is_largest(&buffers.scores, w, y - 1, x, score) {
                buffers.candidates.push(Corner { x: x as u32, y: (y - 1) as u32, strength: f32::from(score) });
            }
        }
    }
    (buffers.pending, buffers.previous) = (pending, previous);
}

/// Whether a score at (x, y) beats its eight neighbours; among equals the first in reading order wins.
fn is_largest(scores: &[u8], w: usize, y: usize, x: usize, score: u8) -> bool {
    let row = |y: usize| &scores[(y % 3) * w..][..w];
    let (above, here, below) = (row(y + 2), row(y), row(y + 1));
    let before = above[x - 1].max(above[x]).max(above[x + 1]).max(here[x - 1]);
    let after = here[x + 1].max(below[x - 1]).max(below[x]).max(below[x + 1]);
    score > before && score >= after
}

/// The smaller eigenvalue of the structure tensor over 7x7 pixels, per pixel.
fn smaller_eigenvalue(image: &GrayImage, x: u32, y: u32) -> f32 {
    let w = image.width() as usize;
    let source = image.as_raw();
    let (mut xx, mut xy, mut yy) = (0i32, 0i32, 0i32);
    for v in y as usize - 3..=y as usize + 3 {
        let (above, here, below) = (&source[(v - 1) * w..][..w], &source[v * w..][..w], &source[(v + 1) * w..][..w]);
        for u in x as usize - 3..=x as usize + 3 {
            let gx = i32::from(here[u + 1]) - i32::from(here[u - 1]);
            let gy = i32::from(below[u]) - i32::from(above[u]);
            xx += gx * gx;
            xy += gx * gy;
            yy += gy * gy;
        }
    }
    let (xx, xy, yy) = (xx as f32, xy as f32, yy as f32);
    // Central differences span two pixels: divide the squares by four, and by the 49 pixels.
    (0.5 * (xx + yy) - (0.25 * (xx - yy).powi(2) + xy * xy).sqrt()) / (4.0 * 49.0)
}

/// Takes the strongest of each cell, then the second strongest of each, and so on, until enough are taken.
fn spread(
    corners: &mut [Corner],
    order: &mut Vec<u32>,
    filled: &mut Vec<u32>,
    (w, h): (u32, u32),
    options: &CornerOptions,
    found: &mut Vec<Corner>,
) {
    corners.sort_unstable_by(|a, b| b.strength.total_cmp(&a.strength).then((a.y, a.x).cmp(&(b.y, b.x))));
    if corners.len() <= options.count {
        found.extend_from_slice(corners);
        return;
    }
    let across = w.div_ceil(options.cell_px) as usize;
    let cells = across * h.div_ceil(options.cell_px) as usize;
    filled.clear();
    filled.resize(cells, 0);
    // The rank of a corner within its cell decides first, its strength second.
    order.clear();
    order.extend(corners.iter().map(|c| {
        let cell = (c.y / options.cell_px) as usize * across + (c.x / options.cell_px) as usize;
        filled[cell] += 1;
        filled[cell]
    }));
    let mut rank = 1;
    while found.len() < options.count {
        let before = found.len();
        for (corner, _) in corners.iter().zip(order.iter()).filter(|(_, r)| **r == rank) {
            if found.len() == options.count {
                return;
            }
            found.push(*corner);
        }
        if found.len() == before {
            return;
        }
        rank += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn squares() -> GrayImage {
        GrayImage::from_fn(200, 160, |x, y| {
            image::Luma([if (x / 20 + y / 20) % 2 == 0 && (x % 20 < 12) && (y % 20 < 12) { 200 } else { 40 }])
        })
    }

    const OPTIONS: CornerOptions = CornerOptions { count: 1000, threshold: 20, least_threshold: 7, border: 8, cell_px: 32 };

    #[test]
    fn corners_of_squares_are_found_near_them() {
        let mut found = Vec::new();
        detect_corners(&squares(), &OPTIONS, |_, _| true, &mut CornerBuffers::default(), &mut found);
        for (x, y) in [(40, 40), (51, 40), (40, 51), (51, 51)] {
            assert!(found.iter().any(|c| c.x.abs_diff(x) <= 2 && c.y.abs_diff(y) <= 2), "no corner at {x},{y}");
        }
    }

    #[test]
    fn a_flat_picture_has_none_and_tiny_ones_do_not_panic() {
        let mut found = Vec::new();
        for (w, h) in [(1, 1), (5, 5), (16, 16), (17, 17), (64, 64)] {
            detect_corners(
                &GrayImage::from_pixel(w, h, image::Luma([90])),
                &OPTIONS,
                |_, _| true,
                &mut CornerBuffers::default(),
                &mut found,
            );
            assert!(found.is_empty());
        }
    }

    #[test]
    fn a_limit_spreads_over_the_picture() {
        let mut found = Vec::new();
        detect_corners(&squares(), &CornerOptions { count: 30, ..OPTIONS }, |_, _| true, &mut CornerBuffers::default(), &mut found);
        assert_eq!(found.len(), 30);
        let left = found.iter().filter(|c| c.x < 100).count();
        assert!((8..=22).contains(&left), "{left}");
    }

    #[test]
    fn a_mask_keeps_corners_out() {
        let mut found = Vec::new();
        detect_corners(&squares(), &OPTIONS, |x, _| x < 100, &mut CornerBuffers::default(), &mut found);
        assert!(!found.is_empty() && found.iter().all(|c| c.x < 100));
    }
}
