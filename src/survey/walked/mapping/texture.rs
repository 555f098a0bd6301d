//! Paints a facet from the keyframes, in light.
//!
//! Every texel is the mean of what the keyframes nearest to it and facing it most show there,
//! without those that differ from the median: people in front, reflections. What no keyframes agree
//! on is filled in smoothly, so that it shows no detail to follow.

use nalgebra::Vector3;
use rayon::prelude::*;

use super::outlines::{CELL_M, CellState, Outline};
use super::views::Views;
use crate::track::{FacetTexture, LIGHT_STEPS};

/// Number of keyframes that paint a texel. Raised, it takes longer; lowered, noise stays.
const MAX_VIEWS: usize = 24;
/// Minimum quality of a keyframe (cosine by distance, squared), as a share of the best one's.
/// Raised, few keyframes paint; lowered, far and slanted ones blur.
const MIN_QUALITY: f64 = 0.3;
/// Texels per pixel of the nearest keyframe, along an axis. Raised, the file grows; lowered, detail
/// is lost.
const TEXELS_PER_PIXEL: f64 = 1.2;
/// Minimum side of a texture, texels: the tracker needs 64.
const MIN_SIDE: u32 = 64;
/// Maximum side of a texture, texels. Raised, the file grows.
const MAX_SIDE: u32 = 2048;
/// Maximum difference of a sample from the median: light, and as a share of it.
const MAX_DIFFERENCE: [f32; 2] = [4.0, 0.2];

/// Returns the texture of a facet; `None` if no keyframe faces it.
pub fn painted(views: &Views<'_>, outline: &Outline) -> Option<FacetTexture> {
    let chosen = chosen_views(views, outline);
    let nearest_m = chosen.iter().map(|k| (views.views[*k].pose.translation - outline.pose.translation).norm()).reduce(f64::min)?;
    let texel_m = nearest_m / views.camera.intrinsics().fx / TEXELS_PER_PIXEL;
    let [width, height] = outline.sides.map(|n| ((n as f64 * CELL_M / texel_m).round() as u32).clamp(MIN_SIDE, MAX_SIDE));
    let texel = |n: u32| {
        let [x, y] = [(n % width, width, outline.sides[0]), (n / width, height, outline.sides[1])]
            .map(|(at, of, cells)| (f64::from(at) + 0.5) / f64::from(of) * cells as f64);
        let cell = outline.cells[(y as usize).min(outline.sides[1] - 1) * outline.sides[0] + (x as usize).min(outline.sides[0] - 1)];
        if cell == CellState::Different { None } else { light(views, &chosen, &outline.place(x, y)) }
    };
    let known: Vec<Option<f32>> = (0..width * height).into_par_iter().map(texel).collect();
    let light = filled(known, width as usize, height as usize);
    Some(FacetTexture { width, height, light: light.into_iter().map(|v| (v * LIGHT_STEPS).round().clamp(0.0, 65_535.0) as u16).collect() })
}

/// Returns the keyframes that show a facet best.
fn chosen_views(views: &Views<'_>, outline: &Outline) -> Vec<usize> {
    let normal = outline.pose.rotation * Vector3::z();
    let [columns, rows] = outline.sides.map(|n| n as f64);
    let places: Vec<Vector3<f64>> =
        [0.1, 0.5, 0.9].into_iter().flat_map(|y| [0.1, 0.5, 0.9].map(|x| outline.place(x * columns, y * rows))).collect();
    let quality = |k: usize| {
        let seen = places.iter().filter(|place| views.pixel(k, place).is_some());
        let faced = seen.map(|place| views.views[k].faced_by(place, &normal)).filter(|(cosine, _)| *cosine > 0.0);
        faced.map(|(cosine, distance_m)| (cosine / distance_m).powi(2)).sum::<f64>()
    };
    let mut ranked: Vec<(f64, usize)> = (0..views.views.len()).map(|k| (quality(k), k)).filter(|(quality, _)| *quality > 0.0).collect();
    ranked.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let least = ranked.first().map_or(0.0, |(best, _)| MIN_QUALITY * best);
    ranked.into_iter().take_while(|(quality, _)| *quality >= least).take(MAX_VIEWS).map(|(_, k)| k).collect()
}

/// Returns the light that most keyframes show at a place.
fn light(views: &Views<'_>, chosen: &[usize], place: &Vector3<f64>) -> Option<f32> {
    let mut samples: Vec<f32> = chosen.iter().filter_map(|k| Some(views.light(*k, views.pixel(*k, place)?))).collect();
    if samples.is_empty() {
        return None;
    }
    let middle = samples.len() / 2;
    let (_, median, _) = samples.select_nth_unstable_by(middle, f32::total_cmp);
    let median = *median;
    let within = MAX_DIFFERENCE[0].max(MAX_DIFFERENCE[1] * median);
    let (sum, count) = samples.iter().filter(|v| (**v - median).abs() <= within).fold((0.0, 0.0), |(sum, n), v| (sum + v, n + 1.0));
    Some(sum / count)
}

/// Fills unknown texels smoothly from known ones: from a picture of half the size, filled likewise.
fn filled(known: Vec<Option<f32>>, width: usize, height: usize) -> Vec<f32> {
    if known.iter().all(Option::is_some) || width.min(height) < 2 {
        let n = known.iter().flatten().count().max(1);
        let mean = known.iter().flatten().sum::<f32>() / n as f32;
        return known.into_iter().map(|v| v.unwrap_or(mean)).collect();
    }
    let (half_width, half_height) = (width.div_ceil(2), height.div_ceil(2));
    let of_four = |n: usize| {
        let (x, y) = (2 * (n % half_width), 2 * (n / half_width));
        let four = [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)].into_iter().filter(|(x, y)| *x < width && *y < height);
        let (sum, count) = four.filter_map(|(x, y)| known[y * width + x]).fold((0.0, 0.0), |(sum, n), v| (sum + v, n + 1.0));
        (count > 0.0).then(|| sum / count)
    };
    let half = filled((0..half_width * half_height).map(of_four).collect(), half_width, half_height);
    let smooth = |x: usize, y: usize| {
        let (u, v) = ((0.5 * (x as f32 + 0.5) - 0.5).max(0.0), (0.5 * (y as f32 + 0.5) - 0.5).max(0.0));
        let (i, j) = (u as usize, v as usize);
        let at = |i: usize, j: usize| half[j.min(half_height - 1) * half_width + i.min(half_width - 1)];
        let (s, t) = (u - i as f32, v - j as f32);
        (1.0 - t) * ((1.0 - s) * at(i, j) + s * at(i + 1, j)) + t * ((1.0 - s) * at(i, j + 1) + s * at(i + 1, j + 1))
    };
    known.iter().enumerate().map(|(n, v)| v.unwrap_or_else(|| smooth(n % width, n / width))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknown_texels_lie_between_the_known_ones_around_them() {
        let (width, height) = (33, 20);
        let known = |n: usize| (n % width < 10 || n % width > 22).then_some(if n % width < 10 { 10.0 } else { 30.0 });
        let all = filled((0..width * height).map(known).collect(), width, height);
        assert!(all.iter().enumerate().all(|(n, v)| known(n).is_none_or(|own| own == *v)));
        assert!(all.iter().all(|v| (10.0..=30.0).contains(v)));
        let row = &all[5 * width..6 * width];
        assert!(row.windows(2).all(|pair| pair[1] >= pair[0] - 1.0), "{row:?}");
        assert_eq!(filled(vec![None; 4], 2, 2), [0.0; 4]);
    }
}
