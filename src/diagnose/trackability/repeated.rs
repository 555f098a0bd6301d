//! Pictures that repeat themselves, such as windows, tiles, or squares in rows: finds which of
//! their corners exist only once.

use image::GrayImage;
use nalgebra::Vector2;

use crate::features::{Feature, halved};
use crate::track::periods;

/// Half the side of the area around a corner that is compared with the area one period away, pixels
/// of the corner's pyramid level. Chosen: the area that its descriptor covers. Raised, corners next
/// to something unique count as unique.
const REACH: i32 = 8;
/// Correlation from which two areas are the same. Chosen: below the correlation of copies with
/// noise and uneven light. Raised, noisy copies count as different.
const SAME: f64 = 0.7;

/// The shifts under which a picture is nearly the same; none for most pictures.
pub(super) struct Copies {
    shifts: Vec<Vector2<f64>>,
}

impl Copies {
    pub(super) fn of(picture: &GrayImage) -> Self {
        let smaller = |image: &GrayImage| (image.width().min(image.height()) >= 2).then(|| halved(image));
        let octaves: Vec<GrayImage> = std::iter::successors(Some(picture.clone()), smaller).take(12).collect();
        Self { shifts: periods(octaves.iter()) }
    }

    /// Returns the distance between copies, pixels; `None` without copies.
    pub(super) fn apart_px(&self) -> Option<f64> {
        self.shifts.iter().map(Vector2::norm).reduce(f64::min)
    }

    /// Whether the picture is the same around a corner and one period away.
    pub(super) fn has(&self, picture: &GrayImage, feature: &Feature) -> bool {
        let is_same = |shift: Vector2<f64>| {
            let (here, there) = both(picture, feature, shift);
            here.len() as i32 > (2 * REACH + 1).pow(2) / 2 && correlation(&here, &there) > SAME
        };
        self.shifts.iter().flat_map(|shift| [*shift, -shift]).any(is_same)
    }
}

/// Returns the grey levels around a corner and, in the same order, at a shift from there, where
/// both lie in the picture.
fn both(picture: &GrayImage, feature: &Feature, shift: Vector2<f64>) -> (Vec<f64>, Vec<f64>) {
    let at = |p: Vector2<f64>| {
        let [x, y] = [p.x.round(), p.y.round()];
        let is_inside = x >= 0.0 && y >= 0.0 && x < f64::from(picture.width()) && y < f64::from(picture.height());
        is_inside.then(|| f64::from(picture.get_pixel(x as u32, y as u32)[0]))
    };
    let offsets = (-REACH..=REACH).flat_map(|y| (-REACH..=REACH).map(move |x| Vector2::new(f64::from(x), f64::from(y))));
    let places = offsets.map(|offset| feature.position + offset * feature.scale);
    places.filter_map(|place| Some((at(place)?, at(place + shift)?))).unzip()
}

/// Returns the correlation of equally many grey levels, from -1 to 1; 0 if one of them is constant.
fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let n = a.len() as f64;
    let [mean_a, mean_b] = [a, b].map(|v| v.iter().sum::<f64>() / n);
    let product = |p: &[f64], mean_p: f64, q: &[f64], mean_q: f64| p.iter().zip(q).map(|(x, y)| (x - mean_p) * (y - mean_q)).sum::<f64>();
    let both = (product(a, mean_a, a, mean_a) * product(b, mean_b, b, mean_b)).sqrt();
    if both > 0.0 { product(a, mean_a, b, mean_b) / both } else { 0.0 }
}
