//! Determines which parts of a surface, and which of the camera's picture, a walk left poorly
//! known: what to film again.

use nalgebra::{Matrix2, SMatrix, Vector2};

use super::stage::Survey;
use super::stage_model::{LENS_COLUMNS, LENS_NUMBERS};
use crate::camera::Pixel;

/// Names of the parts of a picture, three across and three down.
const PARTS: [&str; 9] = ["upper left", "top", "upper right", "left", "middle", "right", "lower left", "bottom", "lower right"];
/// Points across and down a part at which it is evaluated. Raised, nothing is gained; lowered, a
/// single spot represents its part.
const POINTS: usize = 6;
/// Points across and down the camera's picture at which the lens is evaluated, including its
/// corners.
const LENS_POINTS: usize = 9;

/// The uncertainty of the parts of a surface.
#[derive(Debug, Clone, PartialEq)]
pub struct SurfaceParts {
    /// Median of one sigma of the heights in each part, metres, in the order of the names.
    sigmas_m: [f64; 9],
}

impl SurfaceParts {
    /// Returns the sigma of the least known part, metres.
    pub fn worst_m(&self) -> f64 {
        self.sigmas_m.iter().copied().fold(0.0, f64::max)
    }

    /// Names the parts whose sigma is larger than the limit; all nine are "everywhere".
    pub fn beyond(&self, limit_m: f64) -> String {
        let names: Vec<&str> = PARTS.iter().zip(self.sigmas_m).filter(|(_, sigma)| *sigma > limit_m).map(|(name, _)| *name).collect();
        if names.len() == PARTS.len() { "everywhere".to_owned() } else { names.join(", ") }
    }
}

/// The pixel at which the lens is known least.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WeakestPixel {
    /// 3 sigma of a point's image position, pixels.
    pub three_sigma_px: f64,
    /// Its part of the picture.
    pub part: &'static str,
}

impl Survey {
    /// Returns the uncertainty of the parts of surface `k`.
    pub fn parts(&self, k: usize) -> SurfaceParts {
        let size = self.surfaces[k].size_m;
        let share = |n: usize| (n as f64 + 0.5) / (3 * POINTS) as f64 - 0.5;
        let of_part = |part: usize| {
            let points = (0..POINTS * POINTS).map(|n| [part % 3 * POINTS + n % POINTS, part / 3 * POINTS + n / POINTS]);
            let mut sigmas: Vec<f64> = points.map(|[i, j]| self.height_sigma_m(k, [share(i) * size[0], -share(j) * size[1]])).collect();
            sigmas.sort_by(f64::total_cmp);
            sigmas[sigmas.len() / 2]
        };
        SurfaceParts { sigmas_m: std::array::from_fn(of_part) }
    }

    /// Returns where a refined lens is known least; `None` if it was not refined.
    pub fn weakest_pixel(&self) -> Option<WeakestPixel> {
        let at = self.places.lens?;
        let covariance: SMatrix<f64, LENS_NUMBERS, LENS_NUMBERS> =
            self.covariance.fixed_view::<LENS_NUMBERS, LENS_NUMBERS>(at, at).into_owned();
        let lens = self.camera.intrinsics();
        let [right, bottom] = [lens.width, lens.height].map(|n| f64::from(n.saturating_sub(1)));
        let step = 1.0 / (LENS_POINTS - 1) as f64;
        let places = (0..LENS_POINTS * LENS_POINTS).map(|n| [n % LENS_POINTS, n / LENS_POINTS].map(|k| k as f64 * step));
        let unsure = places.filter_map(|[x, y]| {
            let n = self.camera.unproject(Pixel(Vector2::new(x * right, y * bottom)))?.0;
            let all = lens.by_numbers(n, lens.distort(n).0);
            let by_numbers = SMatrix::<f64, 2, LENS_NUMBERS>::from_fn(|row, column| all[(row, LENS_COLUMNS[column])]);
            let spread: Matrix2<f64> = by_numbers * covariance * by_numbers.transpose();
            let part = PARTS[[y, x].map(|share| (3.0 * share).min(2.0) as usize).into_iter().fold(0, |index, k| 3 * index + k)];
            Some(WeakestPixel { three_sigma_px: 3.0 * spread.symmetric_eigenvalues().max().max(0.0).sqrt(), part })
        });
        unsure.max_by(|a, b| a.three_sigma_px.total_cmp(&b.three_sigma_px))
    }

    /// Whether lens and shutter were to be refined, too.
    pub fn refines_lens(&self) -> bool {
        self.places.lens.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weak_parts_are_named() {
        let mut parts = SurfaceParts { sigmas_m: [1e-3; 9] };
        assert_eq!(parts.beyond(2e-3), "");
        parts.sigmas_m[2] = 5e-3;
        parts.sigmas_m[7] = 3e-3;
        assert_eq!((parts.beyond(2e-3).as_str(), parts.worst_m()), ("upper right, bottom", 5e-3));
        assert_eq!(parts.beyond(1e-4), "everywhere");
    }
}
