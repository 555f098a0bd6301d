//! Finds the periods of pictures that repeat themselves: windows, tiles, stripes.
//!
//! One period aside, such a picture looks nearly the same; only its grain, a single mark or its
//! border differs. From a start half a period off, alignment finds the wrong pose as readily as the
//! right one, and most of its tiles agree. The periods are therefore found by autocorrelation when
//! the picture is loaded, and a pose that may be off by a period is compared with its neighbours.
//! Other pictures have no period, and nothing is compared.

use crate::track::scene::tuning::TUNING;
use image::GrayImage;
use nalgebra::Vector2;

/// Returns the shortest independent shifts by which a picture is nearly the same, artwork pixels;
/// none for most pictures. `octaves`: the picture, and copies that are each half the size of the
/// one before.
pub fn periods<'a>(octaves: impl Iterator<Item = &'a GrayImage>) -> Vec<Vector2<f64>> {
    let is_small = |image: &GrayImage| image.width() * image.height() <= TUNING.max_autocorrelated_px;
    let Some((k, octave)) = octaves.enumerate().find(|(_, image)| is_small(image)) else { return Vec::new() };
    let detail = Detail::of(octave);
    let mut found = detail.maxima();
    found.sort_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared()));
    let mut kept: Vec<Vector2<f64>> = Vec::new();
    for shift in found {
        let is_new = |other: &Vector2<f64>| shift.perp(other).abs() > TUNING.min_independent_sine * shift.norm() * other.norm();
        if kept.len() < TUNING.max_periods && kept.iter().all(is_new) {
            kept.push(shift);
        }
    }
    kept.iter().map(|shift| shift * f64::from(1_u32 << k)).collect()
}

/// A picture minus its local mean, with the sums that correlations need.
struct Detail {
    width: usize,
    height: usize,
    grey: Vec<f32>,
    /// Per corner: sums over the rectangle above and left of it, of the grey and of its square.
    sums: Vec<[f64; 2]>,
}

impl Detail {
    fn of(image: &GrayImage) -> Self {
        let (width, height) = (image.width() as usize, image.height() as usize);
        let plain: Vec<f32> = image.iter().map(|v| f32::from(*v)).collect();
        let sums = corner_sums(width, &plain);
        let [reach_x, reach_y] = [width, height].map(|side| side / TUNING.local_mean_divisor);
        let mean = |x: usize, y: usize| {
            let (left, right) = (x.saturating_sub(reach_x), (x + reach_x + 1).min(width));
            let (top, bottom) = (y.saturating_sub(reach_y), (y + reach_y + 1).min(height));
            let [sum, _] = within(&sums, width, [left, top], [right, bottom]);
            (sum / ((right - left) * (bottom - top)) as f64) as f32
        };
        let grey: Vec<f32> = plain.iter().enumerate().map(|(k, v)| v - mean(k % width, k / width)).collect();
        let sums = corner_sums(width, &grey);
        Self { width, height, grey, sums }
    }

    /// Returns the correlation of the picture with itself, shifted `dx` pixels to the right and
    /// `dy` down, over their common part.
    fn correlation(&self, dx: i64, dy: i64) -> f32 {
        let (shift_x, shift_y) = (dx.unsigned_abs() as usize, dy.unsigned_abs() as usize);
        let (columns, rows) = (self.width - shift_x, self.height - shift_y);
        let origin = |is_shifted: [bool; 2]| [if is_shifted[0] { shift_x } else { 0 }, if is_shifted[1] { shift_y } else { 0 }];
        let a = origin([dx > 0, dy > 0]);
        let b = origin([dx < 0, dy < 0]);
        let mut both = 0.0;
        for row in 0..rows {
            let line = |[x, y]: [usize; 2]| &self.grey[(y + row) * self.width + x..][..columns];
            both += f64::from(line(a).iter().zip(line(b)).map(|(p, q)| p * q).sum::<f32>());
        }
        let n = (columns * rows) as f64;
        let moments = |from: [usize; 2]| {
            let [sum, squares] = within(&self.sums, self.width, from, [from[0] + columns, from[1] + rows]);
            (sum, squares - sum * sum / n)
        };
        let ((sum_a, variance_a), (sum_b, variance_b)) = (moments(a), moments(b));
        // A plain part (variance below one squared grey level) correlates with nothing.
        let least = n;
        if variance_a < least || variance_b < least {
            return 0.0;
        }
        ((both - sum_a * sum_b / n) / (variance_a * variance_b).sqrt()) as f32
    }

    /// Returns the shifts of up to half of the picture at which the correlation has a clear
    /// maximum. Of two opposite shifts, only the one that points down, or right, is returned.
    fn maxima(&self) -> Vec<Vector2<f64>> {
        let (most_x, most_y) = ((self.width / 2) as i64, (self.height / 2) as i64);
        let across = (2 * most_x + 1) as usize;
        let place = |dx: i64, dy: i64| dy as usize * across + (dx + most_x) as usize;
        let mut all = vec![0.0; across * (most_y + 1) as usize];
        for dy in 0..=most_y {
            (-most_x..=most_x).for_each(|dx| all[place(dx, dy)] = self.correlation(dx, dy));
        }
        // A shift and its opposite are equivalent.
        let at = |dx: i64, dy: i64| {
            let (dx, dy) = if dy < 0 { (-dx, -dy) } else { (dx, dy) };
            if dx.abs() <= most_x && dy <= most_y { all[place(dx, dy)] } else { 0.0 }
        };
        let mut found = Vec::new();
        for dy in 0..=most_y {
            for dx in -most_x..=most_x {
                let here = at(dx, dy);
                let is_one = dy > 0 || dx > 0;
                if !is_one || here < TUNING.min_period_correlation || dx * dx + dy * dy < TUNING.min_period_px.pow(2) {
                    continue;
                }
                let around = (-2..=2).flat_map(|v| (-2..=2).map(move |u| (u, v))).filter(|offset| *offset != (0, 0));
                let steps = dx.abs().max(dy);
                let on_the_way = (1..steps).map(|k| at((dx * k) / steps, (dy * k) / steps));
                let has_dip = on_the_way.fold(here, f32::min) < here - TUNING.min_dip;
                if has_dip && around.into_iter().all(|(u, v)| at(dx + u, dy + v) <= here) {
                    let peak = |before: f32, after: f32| f64::from(peak_of(before, here, after));
                    let x = dx as f64 + peak(at(dx - 1, dy), at(dx + 1, dy));
                    let y = dy as f64 + peak(at(dx, dy - 1), at(dx, dy + 1));
                    found.push(Vector2::new(x, y));
                }
            }
        }
        found
    }
}

/// Returns the maximum of the parabola through three neighbours, relative to the middle one.
fn peak_of(before: f32, here: f32, after: f32) -> f32 {
    let bend = before - 2.0 * here + after;
    if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 }
}

/// Returns the sums of greys and of their squares over the rectangles from the first pixel to each
/// corner.
fn corner_sums(width: usize, grey: &[f32]) -> Vec<[f64; 2]> {
    let height = grey.len() / width.max(1);
    let mut sums = vec![[0.0; 2]; (width + 1) * (height + 1)];
    for y in 0..height {
        let mut row = [0.0; 2];
        for x in 0..width {
            let g = f64::from(grey[y * width + x]);
            row = [row[0] + g, row[1] + g * g];
            let above = sums[y * (width + 1) + x + 1];
            sums[(y + 1) * (width + 1) + x + 1] = [above[0] + row[0], above[1] + row[1]];
        }
    }
    sums
}

/// Returns the sums over a rectangle: its first column and row, and its ends, exclusive.
fn within(sums: &[[f64; 2]], width: usize, [left, top]: [usize; 2], [right, bottom]: [usize; 2]) -> [f64; 2] {
    let at = |x: usize, y: usize| sums[y * (width + 1) + x];
    [0, 1].map(|k| at(right, bottom)[k] - at(left, bottom)[k] - at(right, top)[k] + at(left, top)[k])
}

#[cfg(test)]
mod tests {
    use image::Luma;

    use super::*;
    use crate::track::synthetic::texture;

    fn periods_of(picture: GrayImage) -> Vec<Vector2<f64>> {
        let octaves: Vec<GrayImage> = std::iter::successors(Some(picture), |image| Some(crate::features::halved(image))).take(5).collect();
        periods(octaves.iter())
    }

    #[test]
    fn windows_on_a_grid_have_both_of_their_periods() {
        let grain = texture(1000, 750, 3);
        let windows = GrayImage::from_fn(1000, 750, |x, y| {
            let base: u32 = if x % 80 < 40 && y % 112 < 60 { 200 } else { 60 };
            Luma([(base + u32::from(grain.get_pixel(x, y)[0]) / 8) as u8])
        });
        let mut found = periods_of(windows);
        found.sort_by(|a, b| a.x.total_cmp(&b.x));
        assert_eq!(found.len(), 2, "{found:?}");
        assert!((found[0] - Vector2::new(0.0, 112.0)).norm() < 4.0 && (found[1] - Vector2::new(80.0, 0.0)).norm() < 4.0, "{found:?}");
    }

    #[test]
    fn stripes_around_a_picture_keep_their_period() {
        let middle = texture(1000, 750, 5);
        let stripes = GrayImage::from_fn(1000, 750, |x, y| {
            let is_middle = (400..600).contains(&x) && (250..500).contains(&y);
            if is_middle { *middle.get_pixel(x, y) } else { Luma([if x % 50 < 25 { 210 } else { 50 }]) }
        });
        let found = periods_of(stripes);
        assert!(found.iter().any(|shift| (shift - Vector2::new(50.0, 0.0)).norm() < 4.0), "{found:?}");
    }

    #[test]
    fn ordinary_pictures_have_no_period() {
        for seed in 0..8 {
            assert_eq!(periods_of(texture(900, 700, seed)), Vec::<Vector2<f64>>::new());
        }
        for (width, height) in [(1, 1), (2, 50), (130, 3), (40, 30)] {
            assert!(periods_of(GrayImage::from_pixel(width, height, Luma([90]))).is_empty());
        }
        // A ramp is the same a little aside, but has no maximum there.
        assert!(periods_of(GrayImage::from_fn(600, 400, |x, _| Luma([(x / 3) as u8]))).is_empty());
    }
}
