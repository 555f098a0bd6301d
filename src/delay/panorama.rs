//! Rotations of a camera that films anything, from picture to picture.
//!
//! Corners of successive pictures are matched, and the rotation that most of their rays agree with
//! is refined. What the camera's translation moves in the picture is taken for rotation. On a rig
//! that pans, it is nearly proportional to the rotation, so it appears in the matrix between the
//! cameras, not in the delay.

use image::GrayImage;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::turns::Turn;
use crate::camera::{CameraModel, Pixel};
use crate::features::{ExtractorOptions, Feature, FeatureExtractor, Workers};
use crate::geometry::pose::{quaternion, skew};
use crate::matching::{Match, MatchBuffers, ReferenceIndex};

/// Number of corners in a picture, and of pyramid levels that are searched for them. Raised,
/// rotations are a little more exact and take longer; more levels help blurred pictures.
const CORNERS: usize = 1000;
const LEVELS: usize = 6;
/// Maximum ratio of a match's distance to that of its rival. As Lowe's. Raised, more matches are
/// wrong.
const RATIO: f32 = 0.8;
/// Minimum number of matches that agree with the rotation. Chosen: far more than chance brings
/// together within [`NEAR_PX`]. Lowered, pictures without detail yield rotations.
const MIN_MATCHES: usize = 20;
/// Distance within which a match agrees, pixels of a picture 1000 pixels wide: the noise of corners
/// on coarse levels, plus parallax. Raised, moving people agree.
const NEAR_PX: f64 = 4.0;
/// Number of random pairs of matches that are tried. With a third of right matches, one in nine
/// pairs is right. Raised, it takes longer.
const SAMPLES: usize = 120;
/// Number of refinements; they converge in three or four. Raised, it only takes longer.
const REFINEMENTS: usize = 8;

/// Where in the picture the matches were, on average over all frames.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RowMean {
    sum: f64,
    count: u64,
}

impl RowMean {
    /// Returns the mean row of the matches: -0.5 is the upper edge, 0 the middle, 0.5 the lower
    /// edge. With a rolling shutter, rotations were seen this share of the readout after the stamp.
    pub fn share(&self) -> f64 {
        if self.count == 0 { 0.0 } else { self.sum / self.count as f64 }
    }
}

/// Measures a camera's rotation from each picture to the next.
pub struct Panorama {
    camera: CameraModel,
    mask: Option<GrayImage>,
    extractor: FeatureExtractor,
    workers: Workers,
    before: Option<Shot>,
    buffers: MatchBuffers,
    rows: RowMean,
}

/// A picture's corners.
struct Shot {
    time_s: f64,
    picture: GrayImage,
    features: Vec<Feature>,
}

/// Rays, as unit vectors, to the same point from both pictures.
type RayPair = [Vector3<f64>; 2];

impl Panorama {
    /// Creates one for a camera; the mask is black where pictures are to be ignored.
    pub fn new(camera: CameraModel, mask: Option<GrayImage>) -> Self {
        Self {
            camera,
            mask,
            extractor: FeatureExtractor::default(),
            workers: Workers::of_all_processors(),
            before: None,
            buffers: MatchBuffers::default(),
            rows: RowMean::default(),
        }
    }

    /// Takes the next picture; returns the rotation since the one before, `None` for the first one
    /// and where the pictures do not show it. A picture identical to the one before is ignored:
    /// capture devices repeat frames.
    pub fn take(&mut self, time_s: f64, picture: &GrayImage) -> Option<Turn> {
        if self.before.as_ref().is_some_and(|before| before.picture == *picture) {
            return None;
        }
        let options = ExtractorOptions { count: CORNERS, levels: LEVELS, ..ExtractorOptions::default() };
        let mut features = Vec::new();
        self.extractor.extract(picture, self.mask.as_ref(), &options, &self.workers, &mut features);
        let now = Shot { time_s, picture: picture.clone(), features };
        let before = self.before.replace(now)?;
        let now = self.before.as_ref()?;
        let mut matches = Vec::new();
        let mut index = ReferenceIndex::default();
        index.add(0, &before.features, |position| position, 1.0);
        index.match_features(&now.features, RATIO, &self.workers, &mut self.buffers, &mut matches);
        let (places, rays): (Vec<f64>, Vec<RayPair>) = seen(&self.camera, &before.features, &now.features, &matches).unzip();
        let near = NEAR_PX * f64::from(self.camera.width()) / 1000.0 / self.camera.intrinsics().fx;
        let (rotation, agreeing) = rotation_between(&rays, near)?;
        self.rows.sum += agreeing.iter().map(|k| (places[*k] + 0.5) / f64::from(self.camera.height()) - 0.5).sum::<f64>();
        self.rows.count += agreeing.len() as u64;
        Some(Turn { from_s: before.time_s, to_s: time_s, angle: rotation.scaled_axis() })
    }

    /// Returns where the matches were.
    pub fn rows(&self) -> RowMean {
        self.rows
    }
}

/// Returns the row of each match in the second picture, and its rays; without matches outside the
/// lens model's range.
fn seen(camera: &CameraModel, before: &[Feature], now: &[Feature], matches: &[Match]) -> impl Iterator<Item = (f64, RayPair)> {
    let ray = |feature: &Feature| camera.unproject(Pixel(feature.position)).map(|n| n.0.push(1.0).normalize());
    matches.iter().filter_map(move |m| {
        let (before, now) = (&before[m.reference as usize], &now[m.frame as usize]);
        Some((now.position.y, [ray(before)?, ray(now)?]))
    })
}

/// Returns the rotation from the second picture's rays to the first's that most pairs agree with to
/// `near` radians, and which those are.
fn rotation_between(rays: &[RayPair], near: f64) -> Option<(UnitQuaternion<f64>, Vec<usize>)> {
    if rays.len() < MIN_MATCHES {
        return None;
    }
    let off = |rotation: &UnitQuaternion<f64>, [before, now]: &RayPair| (before - rotation * now).norm_squared() / (near * near);
    let cost = |rotation: &UnitQuaternion<f64>| rays.iter().map(|pair| off(rotation, pair).min(1.0)).sum::<f64>();
    let mut random = Pcg64Mcg::seed_from_u64(rays.len() as u64);
    let mut sample = || &rays[random.random_range(0..rays.len())];
    let mut best = UnitQuaternion::identity();
    let mut least = cost(&best);
    for _ in 0..SAMPLES {
        let Some(rotation) = rotation_of_two(sample(), sample()) else { continue };
        let own = cost(&rotation);
        (best, least) = if own < least { (rotation, own) } else { (best, least) };
    }
    for _ in 0..REFINEMENTS {
        best = refined(&best, rays, |pair| 1.0 / (1.0 + 4.0 * off(&best, pair)))?;
    }
    let agreeing: Vec<usize> = (0..rays.len()).filter(|k| off(&best, &rays[*k]) < 1.0).collect();
    (agreeing.len() >= MIN_MATCHES).then_some((best, agreeing))
}

/// Returns the rotation that maps two directions to two others: exactly the first one and the plane
/// of both.
fn rotation_of_two(a: &RayPair, b: &RayPair) -> Option<UnitQuaternion<f64>> {
    let axes = |first: &Vector3<f64>, second: &Vector3<f64>| {
        let across = first.cross(second).try_normalize(1e-3)?;
        Some(Matrix3::from_columns(&[*first, across, first.cross(&across)]))
    };
    Some(quaternion(&(axes(&a[0], &b[0])? * axes(&a[1], &b[1])?.transpose())))
}

/// Takes one weighted least-squares step.
fn refined(rotation: &UnitQuaternion<f64>, rays: &[RayPair], weight: impl Fn(&RayPair) -> f64) -> Option<UnitQuaternion<f64>> {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for pair in rays {
        let mapped = rotation * pair[1];
        // Exp(δ) m = m + δ x m.
        let jacobian = -skew(&mapped);
        let weight = weight(pair);
        normal += jacobian.transpose() * jacobian * weight;
        right += jacobian.transpose() * (pair[0] - mapped) * weight;
    }
    let step = normal.cholesky()?.solve(&right);
    Some(UnitQuaternion::from_rotation_matrix(&Rotation3::from_scaled_axis(step)) * rotation)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rays(rotation: &UnitQuaternion<f64>, n: usize, wrong: usize, noise: f64, seed: u64) -> Vec<RayPair> {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let mut near = |size: f64| random.random_range(-size..=size);
        (0..n)
            .map(|k| {
                let now = Vector3::new(near(0.6), near(0.35), 1.0).normalize();
                let seen = rotation * now + Vector3::new(near(noise), near(noise), 0.0);
                let other = Vector3::new(near(0.6), near(0.35), 1.0);
                [if k < wrong { other } else { seen }.normalize(), now]
            })
            .collect()
    }

    #[test]
    fn the_rotation_is_found_among_wrong_matches() {
        let truth = UnitQuaternion::from_scaled_axis(Vector3::new(0.02, -0.05, 0.01));
        let rays = rays(&truth, 300, 150, 1e-3, 3);
        let (found, agreeing) = rotation_between(&rays, 4e-3).unwrap();
        assert!(found.angle_to(&truth) < 2e-4, "{}", found.angle_to(&truth));
        assert!((150..170).contains(&agreeing.len()) && agreeing.iter().filter(|k| **k < 150).count() < 10, "{}", agreeing.len());
    }

    #[test]
    fn matches_without_a_common_rotation_yield_none() {
        let identity = UnitQuaternion::identity();
        assert_eq!(rotation_between(&rays(&identity, 300, 300, 0.0, 4), 4e-3), None);
        assert_eq!(rotation_between(&rays(&identity, 5, 0, 0.0, 4), 4e-3), None);
    }

    #[test]
    fn repeated_and_empty_pictures_have_no_rotation() {
        let camera = CameraModel::pinhole(320, 240, 300.0, 300.0, 159.5, 119.5).unwrap();
        let picture = GrayImage::from_fn(320, 240, |x, y| image::Luma([((x / 9 * 77) ^ (y / 7 * 131)) as u8]));
        let mut panorama = Panorama::new(camera, None);
        assert_eq!(panorama.take(0.0, &picture), None);
        assert_eq!(panorama.take(0.04, &picture), None);
        assert_eq!(panorama.take(0.08, &GrayImage::new(320, 240)), None);
    }
}
