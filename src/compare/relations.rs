//! Estimates the relations of two pictures from matches: searches, refines, tests against chance
//! and compares them; then derives the camera's motion.

use nalgebra::Matrix3;

use super::{CameraMove, CompareOptions, Model, Relation};
use crate::camera::CameraModel;
use crate::geometry::PointPair;
use crate::geometry::distances::squared_sampson;
use crate::geometry::homography::Homography;
use crate::geometry::ransac::Order;
use crate::geometry::relative_pose::{RayPair, TwoViewMotion};
use crate::geometry::robust::{RobustModel, RobustOptions};
use crate::geometry::robust_homography::robust_homography;
use crate::geometry::robust_kernel::median;
use crate::geometry::two_views::distances::squared_sampson_of_homography;
use crate::geometry::two_views::false_alarms::{chance_at_a_line, chance_at_a_point, ln_false_alarms};
use crate::geometry::two_views::homography_decomposition::{PlanarMotion, decompose_homography};
use crate::geometry::two_views::judged_motion::JudgedMotion;
use crate::geometry::two_views::marginal_homography::homography_of_unknown_noise;
use crate::geometry::two_views::model_choice::{EpipolarKind, TwoViewModel, choose_model};
use crate::geometry::two_views::robust_essential::robust_essential;
use crate::geometry::two_views::robust_fundamental::robust_fundamental;

#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Found {
    pub homography: Option<Relation>,
    pub fundamental: Option<Relation>,
    pub essential: Option<Relation>,
    pub camera_move: Option<CameraMove>,
    pub model: Option<Model>,
}

/// Maximum natural logarithm of the false alarms: unrelated pictures pass in at most one of a
/// thousand pairs. Raised, unrelated pictures are related now and then; lowered, pictures with
/// little in common are not.
const MAX_LN_FALSE_ALARMS: f64 = -7.0;
/// Matches closer together than this in both pictures, in thresholds, count once in the chance
/// test, e.g. a blob with two orientations. Raised, dense matches count less.
const SAME_PLACE: f64 = 2.0;
/// Distance from the homography at which a match always agrees, in thresholds: it has two noisy
/// coordinates where a distance from a line has one (the roots of chi square's 95 % points, 2.45
/// and 1.96). Raised, more wrong matches agree.
const HOMOGRAPHY_THRESHOLD: f64 = 1.25;
/// Number of samples until all matches are drawn uniformly. Raised, the search stays longer with
/// the best ones, which in scenes with many look-alikes are on one thing; lowered, models with few
/// inliers are found later.
const EVEN_AFTER: usize = 2000;
/// Relief that a flat scene may have, in thresholds of the homography (1.5 pixels each by default).
/// Raised, shallow scenes count as flat; lowered, real walls and pictures of uncalibrated cameras
/// seem to have depth.
const RELIEF: f64 = 3.0;
/// Factor by which the essential matrix must have more inliers than the plane's motion to be used
/// for a nearly flat scene. Raised, shallow relief is not used; lowered to 1, chance decides on a
/// plane, where the essential matrix has a second solution.
const CLEARLY_MORE: f64 = 1.05;
/// Maximum noise of a match in the homography search, in thresholds: 3 pixels by default. Raised,
/// bent surfaces are fitted as a whole and nearby wrong matches count; lowered, only the flattest
/// part of a bent surface is fitted.
const MAX_NOISE: f64 = 2.5;
/// Threshold of McNemar's statistic (chi square's 99.9 % point with one degree of freedom) above
/// which the matches that agree with only one of a plane's two motions decide between them. Raised,
/// little relief is not used; lowered, mismatches decide.
const NOT_EVEN: f64 = 10.83;
/// Minimum parallax for a meaningful direction, in standard deviations of a ray. Raised, small
/// motions get no direction; lowered, their direction is noise.
const MIN_PARALLAX: f64 = 3.0;

/// Searches for all relations; `calibrated` has the matches as rays of their cameras. Returns
/// `None` if `goes_on`, called before each search, stopped the work.
pub(super) fn find(
    pairs: &[PointPair],
    calibrated: Option<(&[RayPair], &[CameraModel; 2])>,
    sizes: [(u32, u32); 2],
    options: &CompareOptions,
    goes_on: &dyn Fn() -> bool,
) -> Option<Found> {
    // The best matches may all be on one thing in the picture and agree on a model of it alone, so
    // the search considers all before it ends.
    let order = Order::BestFirst { even_after: EVEN_AFTER, stops_by_best: false, draws_each: 1 };
    let search = RobustOptions { threshold: options.threshold_px, order, seed: options.seed, ..RobustOptions::default() };
    let wide = RobustOptions { threshold: HOMOGRAPHY_THRESHOLD * options.threshold_px, ..search };
    let chance = Chance { pairs, sizes, same_place_px: SAME_PLACE * options.threshold_px };
    if !goes_on() {
        return None;
    }
    let plane =
        homography_of_unknown_noise(pairs, MAX_NOISE * options.threshold_px, &wide).filter(|h| chance.excludes_plane(h, wide.threshold));
    if !goes_on() {
        return None;
    }
    let lines = robust_fundamental(pairs, &search).filter(|f| chance.is_excluded(&f.inliers, Sample::Fundamental(search.threshold)));
    if !goes_on() {
        return None;
    }
    let motion = calibrated.and_then(|(rays, cameras)| {
        let found = robust_essential(rays, focals(cameras), &search)?;
        let matrix = in_pixels(&found.model.motion.essential(), cameras)?;
        chance.is_excluded(&found.inliers, Sample::Essential(search.threshold)).then_some((found, matrix))
    });
    let epipolar = match (&motion, &lines) {
        (Some((found, matrix)), _) => Some((found.clone().map(|_| *matrix), EpipolarKind::Essential)),
        (None, lines) => lines.clone().map(|f| (f, EpipolarKind::Fundamental)),
    };
    // Flatness is tested with a wider threshold, so that a slightly bent plane, or one seen through
    // an uncalibrated lens, still counts as flat.
    let bent = RobustOptions { threshold: RELIEF * wide.threshold, ..wide };
    let nearly_flat = plane.as_ref().and_then(|_| robust_homography(pairs, &bent));
    let model = choose(pairs, nearly_flat.as_ref(), epipolar.as_ref(), search.threshold);
    let (camera_move, essential) = match (calibrated, &plane) {
        (Some((rays, cameras)), Some(plane)) if model == Some(Model::Homography) => {
            let of_plane = of_plane(plane, rays, cameras, &search);
            let flat = of_plane.1.as_ref().map_or(plane.inliers.len(), |relation| relation.inliers.len());
            // Relief determines the motion better than the plane does, if clearly more matches
            // agree with it.
            let better = motion.filter(|(found, _)| found.model.is_clear() && found.inliers.len() as f64 > CLEARLY_MORE * flat as f64);
            better.map_or(of_plane, |(found, _)| of_relief(&found, cameras))
        }
        (Some((_, cameras)), _) => motion.map_or((None, None), |(found, _)| of_relief(&found, cameras)),
        _ => (None, None),
    };
    let found = Found {
        homography: plane.and_then(|h| Some(Relation { matrix: h.model.with_unit_h33()?, inliers: h.inliers, sigma_px: h.sigma })),
        fundamental: lines.map(|f| Relation { matrix: normalised(f.model), inliers: f.inliers, sigma_px: f.sigma }),
        essential,
        camera_move,
        model,
    };
    goes_on().then_some(found)
}

/// Returns the motion for a flat scene, and its essential matrix.
fn of_plane(
    plane: &RobustModel<Homography>,
    rays: &[RayPair],
    cameras: &[CameraModel; 2],
    search: &RobustOptions,
) -> (Option<CameraMove>, Option<Relation>) {
    let Some(k_b_inverse) = cameras[1].k_matrix().try_inverse() else { return (None, None) };
    let between_rays = Homography(k_b_inverse * plane.model.0 * cameras[0].k_matrix());
    let seen: Vec<RayPair> = plane.inliers.iter().map(|k| rays[*k]).collect();
    let motions = decompose_homography(&between_rays, &seen);
    let focal = focals(cameras);
    let agreeing = |motion: &TwoViewMotion| -> Vec<usize> {
        let near = |k: &usize| squared_sampson(&motion.essential(), &rays[*k]) * focal[0] * focal[1] < search.threshold.powi(2);
        (0..rays.len()).filter(near).collect()
    };
    let mut rated: Vec<(Vec<usize>, PlanarMotion)> = motions
        .into_iter()
        .map(|m| {
            let direction = m.translation.try_normalize(1e-12);
            let inliers = direction.map_or(Vec::new(), |direction| agreeing(&TwoViewMotion { rotation: m.rotation, direction }));
            (inliers, m)
        })
        .collect();
    let mut is_undecided = false;
    if let [first, second] = &rated[..] {
        let verdict = verdict_off_the_plane(&first.0, &second.0);
        is_undecided = verdict.is_none();
        // A plane's visible area is proportional to the cosine of its slant: of two equally good
        // explanations, the one seen more squarely is likelier.
        let second_wins = verdict.unwrap_or_else(|| squareness(&second.1, &seen) > squareness(&first.1, &seen));
        if second_wins {
            rated.swap(0, 1);
        }
    }
    let Some((inliers, best)) = rated.first() else { return (None, None) };
    let mut angles: Vec<f64> = seen.iter().map(|r| (best.rotation * r.first.push(1.0)).angle(&r.second.push(1.0))).collect();
    let parallax = median(&mut angles).unwrap_or(0.0);
    let noise = plane.sigma / (focal[0] * focal[1]).sqrt();
    let direction = best.translation.try_normalize(1e-12).filter(|_| parallax > MIN_PARALLAX * noise);
    let is_ambiguous = direction.is_some() && is_undecided;
    let camera_move =
        CameraMove { rotation: best.rotation, direction, in_front: best.in_front, parallax_deg: parallax.to_degrees(), is_ambiguous };
    let essential = direction.map(|direction| {
        let matrix = normalised(TwoViewMotion { rotation: best.rotation, direction }.essential());
        Relation { matrix, inliers: inliers.clone(), sigma_px: plane.sigma }
    });
    (Some(camera_move), essential)
}

/// Decides whether the second of two motions is right, by the matches that agree with only one of
/// them (both lists ascend). Matches on the plane agree with both, mismatches with either by
/// chance, and points off the plane with the true one. `None` if chance explains the difference
/// (McNemar 1947).
fn verdict_off_the_plane(first: &[usize], second: &[usize]) -> Option<bool> {
    let only = |of: &[usize], other: &[usize]| of.iter().filter(|k| other.binary_search(k).is_err()).count() as f64;
    let (first, second) = (only(first, second), only(second, first));
    ((first - second).powi(2) > NOT_EVEN * (first + second)).then_some(second > first)
}

/// Returns how squarely both cameras see a motion's plane: the product of the two mean cosines of
/// slant. 1 head-on, 0 edge-on.
fn squareness(motion: &PlanarMotion, seen: &[RayPair]) -> f64 {
    let Some(normal) = motion.normal else { return 0.0 };
    let rotated = motion.rotation * normal;
    let [first, second] = seen.iter().fold([0.0; 2], |[a, b], pair| {
        [a + normal.dot(&pair.first.push(1.0).normalize()), b + rotated.dot(&pair.second.push(1.0).normalize())]
    });
    first * second / (seen.len() as f64).powi(2)
}

/// Returns the motion for a scene with depth.
fn of_relief(judged: &RobustModel<JudgedMotion>, cameras: &[CameraModel; 2]) -> (Option<CameraMove>, Option<Relation>) {
    let JudgedMotion { motion, in_front, parallax, .. } = judged.model;
    let [a, b] = focals(cameras);
    let has_direction = judged.model.is_clear() && parallax > MIN_PARALLAX * judged.sigma / (a * b).sqrt();
    let camera_move = CameraMove {
        rotation: motion.rotation,
        direction: has_direction.then_some(motion.direction),
        in_front,
        parallax_deg: parallax.to_degrees(),
        is_ambiguous: false,
    };
    let matrix = normalised(motion.essential());
    (Some(camera_move), Some(Relation { matrix, inliers: judged.inliers.clone(), sigma_px: judged.sigma }))
}

/// Geometric means of the focal lengths, pixels.
fn focals(cameras: &[CameraModel; 2]) -> [f64; 2] {
    cameras.each_ref().map(|camera| (camera.intrinsics().fx * camera.intrinsics().fy).abs().sqrt())
}

/// Converts an essential matrix to the fundamental matrix for pixels of these cameras: K2⁻ᵀ E K1⁻¹.
pub(super) fn in_pixels(essential: &Matrix3<f64>, [a, b]: &[CameraModel; 2]) -> Option<Matrix3<f64>> {
    let f = b.k_matrix().try_inverse()?.transpose() * essential * a.k_matrix().try_inverse()?;
    f.iter().all(|v| v.is_finite()).then_some(f)
}

/// Scales to unit norm with a positive largest element, so that equal relations have equal numbers.
fn normalised(matrix: Matrix3<f64>) -> Matrix3<f64> {
    let largest = matrix.iter().copied().max_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap_or(1.0);
    matrix * (largest.signum() / matrix.norm())
}

/// Returns the Sampson distance of a match from a homography or an epipolar relation, pixels.
pub(super) fn error_px(is_flat: bool, matrix: &Matrix3<f64>, pair: &PointPair) -> f64 {
    let squared = if is_flat { squared_sampson_of_homography(&Homography(*matrix), pair) } else { squared_sampson(matrix, pair) };
    squared.sqrt()
}

/// The kind of relation, with its threshold in pixels.
#[derive(Debug, Clone, Copy)]
enum Sample {
    Homography(f64),
    Fundamental(f64),
    Essential(f64),
}

/// Tests whether agreement exceeds chance.
struct Chance<'a> {
    pairs: &'a [PointPair],
    sizes: [(u32, u32); 2],
    same_place_px: f64,
}

impl Chance<'_> {
    /// Whether chance does not explain that these matches agree.
    fn is_excluded(&self, inliers: &[usize], sample: Sample) -> bool {
        let all: Vec<usize> = (0..self.pairs.len()).collect();
        let (n, k) = (self.distinct(&all), self.distinct(inliers));
        let size = [self.sizes[1].0, self.sizes[1].1];
        let ln_false_alarms = match sample {
            Sample::Homography(t) => ln_false_alarms(n, k, 4, 1, chance_at_a_point(size, t)),
            Sample::Fundamental(t) => ln_false_alarms(n, k, 7, 3, chance_at_a_line(size, t)),
            Sample::Essential(t) => ln_false_alarms(n, k, 5, 10, chance_at_a_line(size, t)),
        };
        ln_false_alarms <= MAX_LN_FALSE_ALARMS
    }

    /// Whether chance does not explain a homography. Uses the matches mapped to within the inliers'
    /// maximum distance, at least `least_px`, because chance refers to positions in the second
    /// picture.
    fn excludes_plane(&self, plane: &RobustModel<Homography>, least_px: f64) -> bool {
        let distance = |k: &usize| squared_sampson_of_homography(&plane.model, &self.pairs[*k]).sqrt();
        let reach = plane.inliers.iter().map(distance).fold(least_px, f64::max);
        let is_near = |k: &usize| plane.model.squared_error(&self.pairs[*k]) < reach * reach;
        let mapped: Vec<usize> = plane.inliers.iter().copied().filter(is_near).collect();
        self.is_excluded(&mapped, Sample::Homography(reach))
    }

    /// Counts these matches at distinct places.
    fn distinct(&self, which: &[usize]) -> usize {
        let near = self.same_place_px.powi(2);
        let mut kept: Vec<&PointPair> = Vec::new();
        for pair in which.iter().map(|k| &self.pairs[*k]) {
            let is_same = |other: &&PointPair| (other.from - pair.from).norm_squared() < near && (other.to - pair.to).norm_squared() < near;
            if !kept.iter().any(is_same) {
                kept.push(pair);
            }
        }
        kept.len()
    }
}

/// Chooses the relation that explains the matches best.
fn choose(
    pairs: &[PointPair],
    plane: Option<&RobustModel<Homography>>,
    epipolar: Option<&(RobustModel<Matrix3<f64>>, EpipolarKind)>,
    threshold: f64,
) -> Option<Model> {
    let of_kind = |kind: &EpipolarKind| if *kind == EpipolarKind::Essential { Model::Essential } else { Model::Fundamental };
    match (plane, epipolar) {
        (Some(h), Some((f, kind))) => {
            let choice = choose_model(pairs, h, f, *kind, threshold, threshold);
            Some(if choice.model == TwoViewModel::Homography { Model::Homography } else { of_kind(kind) })
        }
        (Some(_), None) => Some(Model::Homography),
        (None, Some((_, kind))) => Some(of_kind(kind)),
        (None, None) => None,
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector2, Vector3};

    use super::*;

    #[test]
    fn only_enough_matches_off_the_plane_decide_the_model() {
        let on_the_plane = 0..200;
        let with = |more: std::ops::Range<usize>| -> Vec<usize> { on_the_plane.clone().chain(more).collect() };
        assert_eq!(verdict_off_the_plane(&with(200..206), &with(206..210)), None);
        assert_eq!(verdict_off_the_plane(&with(200..200), &with(200..200)), None);
        assert_eq!(verdict_off_the_plane(&with(200..230), &with(230..235)), Some(false));
        assert_eq!(verdict_off_the_plane(&with(200..205), &with(205..235)), Some(true));
    }

    #[test]
    fn a_frontal_plane_has_higher_squareness_than_a_steep_one() {
        let seen: Vec<RayPair> = [-0.2, 0.0, 0.2].map(|x| RayPair { first: Vector2::new(x, 0.0), second: Vector2::new(x, 0.0) }).to_vec();
        let with = |normal: Vector3<f64>| {
            let motion = PlanarMotion {
                rotation: UnitQuaternion::identity(),
                translation: Vector3::x(),
                normal: Some(normal.normalize()),
                in_front: 3,
            };
            squareness(&motion, &seen)
        };
        let (square, slanted) = (with(Vector3::z()), with(Vector3::new(1.0, 0.0, 1.0)));
        assert!(square > 0.95 && square <= 1.0 && slanted > 0.3 && slanted < 0.6, "{square} {slanted}");
    }
}
