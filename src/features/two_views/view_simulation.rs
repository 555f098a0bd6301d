//! Features of a picture as it would look from other directions (ASIFT: Morel & Yu, ASIFT: A New
//! Framework for Fully Affine Invariant Image Comparison, SIAM Journal on Imaging Sciences 2009; Yu
//! & Morel, ASIFT: An Algorithm for Fully Affine Invariant Comparison, IPOL 2011).
//!
//! A tilted camera sees a plane compressed along one direction. The compression loses detail, so no
//! normalisation can undo it, but it can be simulated: the picture is rotated, smoothed and
//! compressed, and any detector and descriptor run on the result. If both pictures are treated this
//! way, views far apart become similar.
//!
//! Every place is found in several views with similar descriptors. A ratio test must therefore use
//! the nearest at another place as second nearest; otherwise the place's own other views make its
//! match look ambiguous.

use std::collections::BTreeMap;

use nalgebra::Vector2;

use super::descriptors::Describer;
use super::detectors::Detector;
use super::keypoint::{Descriptors, Features, Keypoint, PictureForms};
use super::watch::Share;
use crate::features::simulated_view::{SimulatedPicture, View};

/// Which views are simulated, and how many of their features are kept.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewSimulation {
    /// Number of tilts beyond the picture itself: sqrt 2, 2, 2 sqrt 2, …. Default 5, the last 4
    /// sqrt 2 (80 degrees from the normal). Each takes about two and a half times as long as the
    /// picture itself.
    pub tilts: u32,
    /// Maximum number of keypoints per view, strongest first. Default 400: about ten thousand
    /// features in all, which exact matching can handle, and a thousand true matches at a tilt of 5
    /// in a picture of a painted wall. Raised, more is found, and matching takes quadratically
    /// longer.
    pub count: usize,
}

impl Default for ViewSimulation {
    fn default() -> Self {
        Self { tilts: 5, count: 400 }
    }
}

/// Maximum number of tilts: the last is 64, where no picture has any detail left.
const MAX_TILTS: u32 = 12;
/// Degrees between two simulated longitudes at tilt 1 (IPOL 2011, section 2.2): a step of 72 / t
/// changes the view equally at any tilt. Raised, fewer views are simulated and places between them
/// are missed.
const LONGITUDE_STEP: f64 = 72.0;
/// Minimum distance of a keypoint from a simulated view's border, in its sigmas: what SIFT reads (6
/// sqrt 2), as in the authors' program. Lowered, descriptors of the border itself are included.
const BORDER_SIGMAS: f64 = 8.5;
/// Features are duplicates if their positions differ by less than this fraction of the smaller
/// region's sigma …
const SAME_PLACE: f64 = 0.5;
/// … and their descriptors by less than this (unit vectors; unrelated ones differ by 1 or more) …
const SAME_VECTOR: f32 = 0.25;
/// … or, for bits, in fewer than this many of 256 (unrelated ones differ in about 128).
const SAME_BITS: u32 = 16;

impl ViewSimulation {
    /// Returns the features of a picture in all views, in the picture's own pixels; keypoints of
    /// simulated views have elliptic regions.
    pub fn features(&self, picture: &PictureForms, detector: &dyn Detector, describer: &dyn Describer) -> Features {
        let views = self.views();
        let at = |done: usize| picture.watch.at(Share { done, of: views.len() + 1 });
        let mut all = self.of_view(&PictureForms::watched(picture.grey, at(0)), detector, describer, |_| true);
        for (k, view) in views.iter().enumerate() {
            let watch = at(k + 1);
            if !watch.goes_on() {
                break;
            }
            let Some(simulated) = SimulatedPicture::of(picture.float(), *view) else { continue };
            let forms = PictureForms::watched(&simulated.pixels, watch);
            let mut found = self.of_view(&forms, detector, describer, |k| simulated.holds(k));
            found.keypoints.iter_mut().for_each(|k| *k = simulated.in_picture(k));
            append(&mut all, found);
        }
        thin(&mut all);
        all
    }

    /// Returns the simulated views besides the picture itself, least tilted first.
    fn views(&self) -> Vec<View> {
        let tilts = (1..=self.tilts.min(MAX_TILTS)).map(|k| (f64::from(k) / 2.0).exp2());
        tilts
            .flat_map(|tilt| {
                let step = LONGITUDE_STEP / tilt;
                // Opposite longitudes see the same; one closer than half a step to half a turn
                // would repeat the first.
                let count = (180.0 / step - 0.5).ceil() as usize;
                (0..count).map(move |k| View { tilt, longitude: (k as f64 * step).to_radians() })
            })
            .collect()
    }

    /// Returns the strongest `usable` features of a view.
    fn of_view(
        &self,
        view: &PictureForms,
        detector: &dyn Detector,
        describer: &dyn Describer,
        usable: impl Fn(&Keypoint) -> bool,
    ) -> Features {
        let mut keypoints = detector.detect(view);
        keypoints.retain(usable);
        keypoints.truncate(self.count);
        describer.describe(view, &keypoints)
    }
}

impl SimulatedPicture {
    /// Whether the pixels that a keypoint's descriptor reads are inside the picture.
    fn holds(&self, keypoint: &Keypoint) -> bool {
        self.holds_ellipse(keypoint.position, &(keypoint.shape * BORDER_SIGMAS))
    }

    fn in_picture(&self, keypoint: &Keypoint) -> Keypoint {
        Keypoint { position: self.place_in_picture(keypoint.position), shape: self.inverse * keypoint.shape, ..*keypoint }
    }
}

/// Keeps the features marked in `kept`.
fn keep(features: &mut Features, kept: &[bool]) {
    let mut flags = kept.iter();
    features.keypoints.retain(|_| flags.next().copied().unwrap_or(false));
    match &mut features.descriptors {
        Descriptors::Vectors { length, values } => {
            let parts = values.chunks_exact((*length).max(1)).zip(kept).filter(|(_, kept)| **kept);
            *values = parts.flat_map(|(part, _)| part.iter().copied()).collect();
        }
        Descriptors::Bits(bits) => {
            let mut flags = kept.iter();
            bits.retain(|_| flags.next().copied().unwrap_or(false));
        }
    }
}

/// Adds features of the same kind.
fn append(all: &mut Features, more: Features) {
    match (&mut all.descriptors, more.descriptors) {
        (Descriptors::Vectors { values, .. }, Descriptors::Vectors { values: more, .. }) => values.extend(more),
        (Descriptors::Bits(bits), Descriptors::Bits(more)) => bits.extend(more),
        // A describer returns only one kind.
        _ => return,
    }
    all.keypoints.extend(more.keypoints);
}

/// Side of the grid cells for finding duplicates, pixels: only features in the same or a
/// neighbouring cell can be duplicates. Raised, more pairs are compared.
const CELL_PX: f64 = 8.0;

/// Keeps the first of features at the same place with similar descriptors.
fn thin(features: &mut Features) {
    let cell = |place: Vector2<f64>| place.map(|c| (c / CELL_PX).floor() as i64);
    let mut cells: BTreeMap<(i64, i64), Vec<usize>> = BTreeMap::new();
    let mut kept = vec![true; features.keypoints.len()];
    for (k, keypoint) in features.keypoints.iter().enumerate() {
        let own = cell(keypoint.position);
        let near = (-1..=1).flat_map(|i| (-1..=1).map(move |j| (own.y + i, own.x + j)));
        let mut earlier = near.filter_map(|key| cells.get(&key)).flatten();
        if earlier.any(|&e| same_place(&features.keypoints[e], keypoint) && alike(&features.descriptors, e, k)) {
            kept[k] = false;
        } else {
            cells.entry((own.y, own.x)).or_default().push(k);
        }
    }
    keep(features, &kept);
}

fn same_place(a: &Keypoint, b: &Keypoint) -> bool {
    let limit = (SAME_PLACE * a.scale().min(b.scale())).min(CELL_PX);
    (a.position - b.position).norm() < limit
}

fn alike(descriptors: &Descriptors, a: usize, b: usize) -> bool {
    match descriptors {
        Descriptors::Vectors { length, values } => {
            let [a, b] = [a, b].map(|k| &values[k * length..][..*length]);
            a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f32>() < SAME_VECTOR * SAME_VECTOR
        }
        Descriptors::Bits(bits) => bits[a].distance(&bits[b]) < SAME_BITS,
    }
}

#[cfg(test)]
mod tests {
    use image::{GrayImage, Luma};
    use nalgebra::Matrix2;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::features::two_views::descriptors::SiftDescriber;
    use crate::features::two_views::detectors::SiftDetector;

    /// A Gaussian spot: centre, covariance, contrast in grey levels.
    type Spot = (Vector2<f64>, Matrix2<f64>, f64);

    fn spots(count: usize, side: f64, seed: u64) -> Vec<Spot> {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let mut spot = || {
            let middle = Vector2::new(random.random_range(-side..side), random.random_range(-side..side));
            let size = 2.5 * 2.0_f64.powf(random.random_range(0.0..2.0));
            let (stretch, angle) = (random.random_range(0.5..1.0), random.random_range(0.0..3.0_f64));
            let rotation = Matrix2::new(angle.cos(), -angle.sin(), angle.sin(), angle.cos());
            let shape = rotation * Matrix2::from_diagonal(&Vector2::new(size, size * stretch));
            (middle, shape * shape.transpose(), random.random_range(-90.0..90.0))
        };
        (0..count).map(|_| spot()).collect()
    }

    /// The spots about the picture's centre with `matrix` applied, seen by a camera that blurs by
    /// half a pixel.
    fn picture(spots: &[Spot], matrix: Matrix2<f64>, (width, height): (u32, u32)) -> GrayImage {
        let mut levels = vec![120.0; (width * height) as usize];
        let middle = Vector2::new(f64::from(width - 1), f64::from(height - 1)) / 2.0;
        for (place, covariance, contrast) in spots {
            let seen = matrix * covariance * matrix.transpose() + Matrix2::identity() * 0.25;
            let peak = contrast * (matrix.determinant().powi(2) * covariance.determinant() / seen.determinant()).sqrt();
            let (inverse, place) = (seen.try_inverse().unwrap(), matrix * place + middle);
            for (k, level) in levels.iter_mut().enumerate() {
                let away = Vector2::new((k as u32 % width) as f64, (k as u32 / width) as f64) - place;
                let distance = away.dot(&(inverse * away));
                if distance < 30.0 {
                    *level += peak * (-0.5 * distance).exp();
                }
            }
        }
        GrayImage::from_fn(width, height, |x, y| Luma([levels[(y * width + x) as usize].round().clamp(0.0, 255.0) as u8]))
    }

    fn features(picture: &GrayImage, options: ViewSimulation) -> Features {
        options.features(&PictureForms::new(picture), &SiftDetector::default(), &SiftDescriber::default())
    }

    #[test]
    fn keypoints_of_simulated_views_map_back_to_the_picture() {
        let round = |x: f64, y: f64| (Vector2::new(x, y), Matrix2::identity() * 16.0, 110.0);
        let places = [round(-41.3, -20.8), round(30.7, 33.1), round(44.9, -35.4)];
        let picture = picture(&places, Matrix2::identity(), (301, 281));
        let forms = PictureForms::new(&picture);
        let views = ViewSimulation { tilts: 3, count: 400 }.views();
        let mut errors: Vec<Vector2<f64>> = Vec::new();
        for view in &views {
            let simulated = SimulatedPicture::of(forms.float(), *view).unwrap();
            let found = SiftDetector::default().detect(&PictureForms::new(&simulated.pixels));
            let held = found.iter().filter(|k| simulated.holds(k)).map(|k| simulated.in_picture(k));
            for keypoint in held {
                assert!(!keypoint.is_round() && keypoint.shape.determinant() > 0.0);
                let away = |place: &Vector2<f64>| (keypoint.position - place - Vector2::new(150.0, 140.0)).norm();
                let nearest = places.iter().map(|p| p.0).min_by(|a, b| away(a).total_cmp(&away(b))).unwrap();
                errors.push(keypoint.position - nearest - Vector2::new(150.0, 140.0));
            }
        }
        let mean = errors.iter().sum::<Vector2<f64>>() / errors.len() as f64;
        assert!(errors.len() >= 2 * views.len(), "{} of {} views", errors.len(), views.len());
        assert!(mean.norm() < 0.03 && errors.iter().all(|e| e.norm() < 0.3), "{mean} {errors:?}");
    }

    /// Features whose mutually nearest descriptor is at the same place.
    fn true_matches(a: &Features, b: &Features, map: impl Fn(Vector2<f64>) -> Vector2<f64>) -> usize {
        let part = |f: &Features, k: usize| match &f.descriptors {
            Descriptors::Vectors { length, values } => values[k * length..][..*length].to_vec(),
            Descriptors::Bits(_) => Vec::new(),
        };
        let [p, q] = [a, b].map(|f| (0..f.keypoints.len()).map(|k| part(f, k)).collect::<Vec<_>>());
        let alike = |v: &[f32], w: &[f32]| v.iter().zip(w).map(|(v, w)| v * w).sum::<f32>();
        let nearest = |v: &[f32], among: &[Vec<f32>]| (0..among.len()).max_by(|i, k| alike(v, &among[*i]).total_cmp(&alike(v, &among[*k])));
        let matched = |k: usize| {
            let other = nearest(&p[k], &q)?;
            (nearest(&q[other], &p)? == k).then_some(other)
        };
        let right = |k: usize| matched(k).is_some_and(|o| (map(a.keypoints[k].position) - b.keypoints[o].position).norm() < 2.0);
        (0..p.len()).filter(|k| right(*k)).count()
    }

    #[test]
    fn view_simulation_matches_steep_tilts() {
        let spots = spots(260, 130.0, 5);
        let rotation = |a: f64| Matrix2::new(a.cos(), -a.sin(), a.sin(), a.cos());
        let matrix = rotation(0.5) * Matrix2::new(0.25, 0.0, 0.0, 1.0) * rotation(-0.9);
        let [a, b] = [(Matrix2::identity(), (221, 221)), (matrix, (221, 261))].map(|(m, size)| picture(&spots, m, size));
        let map = |p: Vector2<f64>| matrix * (p - Vector2::repeat(110.0)) + Vector2::new(110.0, 130.0);
        let count = |tilts: u32| {
            let options = ViewSimulation { tilts, count: 50 };
            true_matches(&features(&a, options), &features(&b, options), map)
        };
        let (alone, simulated) = (count(0), count(4));
        assert!(simulated >= 30 && simulated > 5 * alone, "{alone} alone, {simulated} with views");
    }

    #[test]
    fn simulated_views_match_the_paper() {
        let views = ViewSimulation::default().views();
        for (tilt, count) in [(2.0_f64.sqrt(), 4), (2.0, 5), (8.0_f64.sqrt(), 7), (4.0, 10), (32.0_f64.sqrt(), 14)] {
            let of_tilt: Vec<&View> = views.iter().filter(|v| (v.tilt - tilt).abs() < 1e-9).collect();
            assert_eq!(of_tilt.len(), count, "{tilt}");
            assert!(of_tilt.windows(2).all(|v| ((v[1].longitude - v[0].longitude).to_degrees() - 72.0 / tilt).abs() < 1e-9));
            assert!(of_tilt.iter().all(|v| v.longitude.to_degrees() < 180.0));
        }
        assert_eq!(views.len(), 40);
    }

    #[test]
    fn a_feature_found_in_two_views_is_kept_once() {
        let picture = picture(&spots(60, 90.0, 8), Matrix2::identity(), (181, 181));
        let found = features(&picture, ViewSimulation { tilts: 2, count: 100 });
        let n = found.keypoints.len();
        assert!(n > 50 && n == found.descriptors.len(), "{n}");
        for k in 0..n {
            assert!((0..k).all(|e| !same_place(&found.keypoints[e], &found.keypoints[k]) || !alike(&found.descriptors, e, k)));
        }
    }

    #[test]
    fn pictures_too_small_have_no_simulated_features() {
        for (width, height) in [(0, 0), (1, 1), (1, 300), (300, 1), (40, 40)] {
            let even = GrayImage::from_pixel(width, height, Luma([90]));
            let found = features(&even, ViewSimulation { tilts: 7, count: 10 });
            assert!(found.keypoints.is_empty() && found.descriptors.is_empty(), "{width} x {height}");
        }
    }
}
