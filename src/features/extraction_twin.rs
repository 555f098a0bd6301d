//! The plain twin of [`FeatureExtractor`]: each step by its definition, pixel by pixel, with a pass
//! for each threshold. Tests only.

use image::{GrayImage, Luma};
use nalgebra::Vector2;

use super::corners::Polarity;
use super::descriptor::Descriptor;
use super::extractor::{ExtractorOptions, Feature, FeatureExtractor};
use super::kernels::CIRCLE;
use super::pattern::{PAIRS, PATCH_RADIUS};
use super::test_pictures::{Painting, noise, view};
use super::workers::Workers;

const BORDER: u32 = PATCH_RADIUS as u32 + 2;

/// A pixel and its score or strength.
type Ranked = (u32, u32, f32);

fn grey(image: &GrayImage, x: i64, y: i64) -> i32 {
    let inside = |v: i64, n: u32| v.clamp(0, i64::from(n) - 1) as u32;
    i32::from(image.get_pixel(inside(x, image.width()), inside(y, image.height()))[0])
}

/// Bilinear, in steps of 1/128.
fn shrunk(from: &GrayImage, width: u32, height: u32) -> GrayImage {
    let tap = |k: u32, from: u32, to: u32| {
        let c = ((f64::from(k) + 0.5) * f64::from(from) / f64::from(to) - 0.5).clamp(0.0, f64::from(from - 1));
        let i = (c as u32).min(from.saturating_sub(2));
        (i64::from(i), ((c - f64::from(i)) * 128.0).round() as i32)
    };
    GrayImage::from_fn(width, height, |x, y| {
        let ((i, a), (j, b)) = (tap(x, from.width(), width), tap(y, from.height(), height));
        let column = |x: i64| grey(from, x, j) * (128 - b) + grey(from, x, j + 1) * b;
        Luma([((column(i) * (128 - a) + column(i + 1) * a + 8192) >> 14) as u8])
    })
}

fn smoothed(image: &GrayImage) -> GrayImage {
    const WEIGHTS: [i32; 5] = [1, 4, 6, 4, 1];
    GrayImage::from_fn(image.width(), image.height(), |x, y| {
        let term = |k: usize| {
            let (dx, dy) = (k as i64 % 5 - 2, k as i64 / 5 - 2);
            WEIGHTS[k % 5] * WEIGHTS[k / 5] * grey(image, i64::from(x) + dx, i64::from(y) + dy)
        };
        Luma([(((0..25).map(term).sum::<i32>() + 128) >> 8) as u8])
    })
}

/// FAST-9's score if it is at least `threshold`, else 0.
fn score(image: &GrayImage, x: u32, y: u32, threshold: u8) -> i32 {
    let (x, y) = (i64::from(x), i64::from(y));
    let difference = |k: usize| {
        let (dx, dy) = CIRCLE[k % 16];
        grey(image, x + dx as i64, y + dy as i64) - grey(image, x, y)
    };
    let differences: [i32; 24] = std::array::from_fn(difference);
    let best = differences
        .windows(9)
        .map(|nine| nine.iter().copied().fold(i32::MAX, i32::min).max(-nine.iter().copied().fold(i32::MIN, i32::max)))
        .fold(0, i32::max);
    if best > i32::from(threshold) { best - 1 } else { 0 }
}

fn peaks(image: &GrayImage, threshold: u8) -> Vec<Ranked> {
    let (w, h) = image.dimensions();
    let inside = |x: u32, y: u32| (BORDER..w - BORDER).contains(&x) && (BORDER..h - BORDER).contains(&y);
    let scores: Vec<i32> =
        (0..w * h).map(|k| (k % w, k / w)).map(|(x, y)| if inside(x, y) { score(image, x, y, threshold) } else { 0 }).collect();
    let at = |x: u32, y: u32| scores[(y * w + x) as usize];
    let is_peak = |&(x, y): &(u32, u32)| {
        let neighbour = |k: u32| at(x + k % 3 - 1, y + k / 3 - 1);
        at(x, y) > 0 && (0..4).all(|k| neighbour(k) < at(x, y)) && (5..9).all(|k| neighbour(k) <= at(x, y))
    };
    (0..w * h).map(|k| (k % w, k / w)).filter(|(x, y)| inside(*x, *y)).filter(is_peak).map(|(x, y)| (x, y, at(x, y) as f32)).collect()
}

fn eigenvalue(image: &GrayImage, x: u32, y: u32) -> f32 {
    let (mut xx, mut xy, mut yy) = (0, 0, 0);
    for (v, u) in (-3..=3).flat_map(|v| (-3..=3).map(move |u| (v + i64::from(y), u + i64::from(x)))) {
        let (gx, gy) = (grey(image, u + 1, v) - grey(image, u - 1, v), grey(image, u, v + 1) - grey(image, u, v - 1));
        (xx, xy, yy) = (xx + gx * gx, xy + gx * gy, yy + gy * gy);
    }
    let (xx, xy, yy) = (xx as f32, xy as f32, yy as f32);
    (0.5 * (xx + yy) - (0.25 * (xx - yy).powi(2) + xy * xy).sqrt()) / (4.0 * 49.0)
}

/// The strongest of each cell, then the second strongest of each, and so on.
fn spread(mut corners: Vec<Ranked>, width: u32, count: usize) -> Vec<Ranked> {
    corners.sort_by(|a, b| b.2.total_cmp(&a.2).then((a.1, a.0).cmp(&(b.1, b.0))));
    if corners.len() <= count {
        return corners;
    }
    let cell = |c: &Ranked| c.1 / 40 * width.div_ceil(40) + c.0 / 40;
    let rank = |k: usize| corners[..k].iter().filter(|c| cell(c) == cell(&corners[k])).count();
    let mut ranked: Vec<_> = (0..corners.len()).map(|k| (rank(k), k)).collect();
    ranked.sort();
    ranked[..count].iter().map(|(_, k)| corners[*k]).collect()
}

/// The corners of a level, and the index of the threshold that yielded them.
fn corners(image: &GrayImage, mask: &dyn Fn(u32, u32) -> bool, count: usize, options: &ExtractorOptions) -> (Vec<Ranked>, usize) {
    let (w, h) = image.dimensions();
    if w <= 2 * BORDER || h <= 2 * BORDER {
        return (Vec::new(), 0);
    }
    let mut stage = 0;
    let mut candidates = Vec::new();
    for (k, threshold) in [2 * options.threshold, options.threshold, options.least_threshold].into_iter().enumerate() {
        stage = k;
        candidates = peaks(image, threshold);
        candidates.retain(|c| mask(c.0, c.1));
        if 2 * candidates.len() >= 3 * count {
            break;
        }
    }
    let mut short = spread(candidates, w, 3 * count);
    short.iter_mut().for_each(|c| c.2 = eigenvalue(image, c.0, c.1));
    (spread(short, w, count), stage)
}

fn described(smooth: &GrayImage, x: u32, y: u32) -> (f32, Descriptor) {
    let (mut mx, mut my) = (0, 0);
    for dy in -PATCH_RADIUS..=PATCH_RADIUS {
        let half = f64::from(PATCH_RADIUS * PATCH_RADIUS - dy * dy).sqrt().round() as i32;
        for dx in -half..=half {
            let v = grey(smooth, i64::from(x) + i64::from(dx), i64::from(y) + i64::from(dy));
            (mx, my) = (mx + dx * v, my + dy * v);
        }
    }
    let angle = (my as f32).atan2(mx as f32);
    let rotation = std::f64::consts::TAU * f64::from((angle / std::f32::consts::TAU * 128.0).round() as i32 & 127) / 128.0;
    let at = |(px, py): (i8, i8)| {
        let ((sin, cos), px, py) = (rotation.sin_cos(), f64::from(px), f64::from(py));
        grey(smooth, i64::from(x) + (cos * px - sin * py).round() as i64, i64::from(y) + (sin * px + cos * py).round() as i64)
    };
    let mut bits = [0; 4];
    for (k, (a, b)) in PAIRS.iter().enumerate() {
        bits[k / 64] |= u64::from(at(*a) < at(*b)) << (k % 64);
    }
    (angle, Descriptor(bits))
}

/// By definition: dark if nine consecutive pixels are brighter than the centre.
fn polarity(image: &GrayImage, x: u32, y: u32) -> Polarity {
    let around = CIRCLE.map(|(dx, dy)| grey(image, i64::from(x) + dx as i64, i64::from(y) + dy as i64));
    let middle = grey(image, i64::from(x), i64::from(y));
    let is_dark = (0..16).any(|start| (0..9).all(|k| around[(start + k) % 16] > middle));
    if is_dark { Polarity::Dark } else { Polarity::Bright }
}

/// The features, and which thresholds were used.
fn extracted(picture: &GrayImage, mask: Option<&GrayImage>, options: &ExtractorOptions) -> (Vec<Feature>, [bool; 3]) {
    let (w, h) = picture.dimensions();
    let mut levels = vec![(picture.clone(), [1.0, 1.0])];
    for k in 1..options.levels {
        let size = |n: u32| (f64::from(n) * options.factor.powi(-(k as i32))).round() as u32;
        if size(w).min(size(h)) < 2 * BORDER + 8 {
            break;
        }
        let level = shrunk(&levels[k - 1].0, size(w), size(h));
        levels.push((level, [f64::from(size(w)) / f64::from(w), f64::from(size(h)) / f64::from(h)]));
    }
    let share = |scale: [f64; 2]| (scale[0] * scale[1]).powf(options.area_power);
    let total: f64 = levels.iter().map(|(_, scale)| share(*scale)).sum();
    let (mut features, mut stages) = (Vec::new(), [false; 3]);
    for (image, scale) in &levels {
        let place = |x: u32, y: u32| Vector2::new((f64::from(x) + 0.5) / scale[0] - 0.5, (f64::from(y) + 0.5) / scale[1] - 0.5);
        let usable = |x: u32, y: u32| {
            let p = place(x, y);
            mask.is_none_or(|m| m.get_pixel_checked(p.x.round().max(0.0) as u32, p.y.round().max(0.0) as u32).is_some_and(|v| v[0] > 0))
        };
        let quota = (options.count as f64 * share(*scale) / total).round() as usize;
        let (found, stage) = corners(image, &usable, quota, options);
        stages[stage] = true;
        let smooth = smoothed(image);
        features.extend(found.iter().map(|&(x, y, _)| {
            let (angle, descriptor) = described(&smooth, x, y);
            Feature { position: place(x, y), scale: 1.0 / scale[0], angle, polarity: polarity(image, x, y), descriptor }
        }));
    }
    (features, stages)
}

/// Dims a picture to this percentage of its contrast.
fn dimmed(picture: &GrayImage, contrast: u32) -> GrayImage {
    let mut dim = picture.clone();
    dim.iter_mut().for_each(|v| *v = (u32::from(*v) * contrast / 100 + 40) as u8);
    dim
}

#[test]
fn features_match_the_plain_implementation() {
    let painting = Painting::new().seen(&view(0.3, 0.2, 1.0));
    let cut = |w: u32, h: u32| GrayImage::from_fn(w, h, |x, y| *painting.get_pixel(x % 300, y % 300));
    let mut pictures = vec![painting.clone(), noise(150, 130), GrayImage::from_pixel(90, 80, Luma([7]))];
    pictures.extend([60, 30, 12, 3].map(|contrast| dimmed(&painting, contrast)));
    pictures.extend([(1, 1), (300, 2), (34, 35), (35, 35), (35, 120), (37, 67), (70, 44), (141, 90)].map(|(w, h)| cut(w, h)));
    let mut extractor = FeatureExtractor::default();
    let mut stages = [false; 3];
    for (k, picture) in pictures.iter().enumerate() {
        let mask = GrayImage::from_fn(picture.width(), picture.height(), |x, y| Luma([u8::from((x / 50 + y / 30) % 3 != 0)]));
        for (mask, count) in [(None, 500), (None, 60), (Some(&mask), 200)] {
            let options = ExtractorOptions { count, ..Default::default() };
            let (expected, used) = extracted(picture, mask, &options);
            (0..3).for_each(|k| stages[k] |= used[k]);
            // Both after any previous use and with new buffers.
            let (mut warm, mut fresh) = (Vec::new(), Vec::new());
            extractor.extract(picture, mask, &options, &Workers::new(1), &mut warm);
            FeatureExtractor::default().extract(picture, mask, &options, &Workers::new(1), &mut fresh);
            assert!(warm == expected && fresh == expected, "picture {k}, {count} features wanted");
            assert!(k > 0 || expected.len() > 40, "{}", expected.len());
        }
    }
    assert_eq!(stages, [true; 3], "every threshold is used by some level");
}
