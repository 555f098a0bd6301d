//! The sparse adjustment: the places of the tracked corners and the poses of the cameras, jointly,
//! by minimising robust reprojection errors.
//!
//! Corners do not depend on each other. Each is eliminated by its own 3x3 block, which leaves one
//! dense system with six unknowns per camera (the Schur complement). Start poses that the tracker
//! measured on the configured surfaces are the cameras' priors and fix frame and scale.
//!
//! With a rolling shutter each camera has six more unknowns, its rates: a small poster shows
//! neither where the middle row was nor how fast the camera moved, but the points all over the
//! frame do.

use nalgebra::{DMatrix, DVector, Matrix2x3, Matrix3, Point3, SMatrix, SVector, Vector2, Vector3};

use super::super::dense_system::Factor;
use super::tracks::{Sighting, Track};
use super::views::{Rates, Views, project};
use crate::geometry::robust_kernel::median;
use crate::geometry::triangulation::nearest_to_rays;
use crate::geometry::{Body, Camera, Pose, skew};

/// Number of rounds that are enough: sightings that do not fit are dropped after each. Raised,
/// nothing is gained.
pub const ALL_ROUNDS: usize = 4;
/// Number of steps of a round. Raised, rounds take longer for nothing; lowered, sightings are
/// judged before their points are in place.
const STEPS: usize = 8;
/// Residual at which a sighting counts half (Cauchy), in robust sigmas. Raised, wrong matches pull
/// more; lowered, right ones count less.
const HALF_WEIGHT: f64 = 2.0;
/// Maximum residual of a sighting that is kept, in robust sigmas. Raised, wrong matches stay.
const MAX_SIGMAS: f64 = 5.0;
/// Maximum residual of a sighting at the start, pixels: the start poses are that wrong.
const MAX_START_PX: f64 = 25.0;
/// Minimum number of sightings of a point.
const MIN_SIGHTINGS: usize = 3;
/// Minimum angle between the outermost rays of a point, radians: at less its depth is a guess.
const MIN_PARALLAX: f64 = 0.05;
/// Damping at the start, relative to the diagonal, and its limits.
const DAMPING: f64 = 1e-4;
const MAX_DAMPING: f64 = 1e4;
/// A step that lowers the cost by less than this share ends a round.
const MIN_GAIN: f64 = 1e-4;
/// One sigma of a start pose, metres and radians: what a tracked poster gives at a few metres.
/// Raised, the frame and the scale follow the points' errors; lowered, errors of the start stay.
const START_SIGMA: [f64; 2] = [2e-3, 5e-4];
/// The same with a rolling shutter, and one sigma of start rates, metres and radians per second: a
/// small poster's rows tell little about the middle one. Raised, nothing is gained; lowered, errors
/// of the start stay.
const ROLLING_SIGMA: [f64; 4] = [2e-2, 5e-3, 1.0, 0.5];
/// Unknowns of a camera: its pose, and its rates if the shutter rolls.
const STILL: usize = 6;
const ROLLING: usize = 12;
/// Minimum robust sigma, to divide by, in sigmas of the sightings.
const MIN_SCALE: f64 = 1e-3;

/// A corner of the set.
#[derive(Debug, Clone, PartialEq)]
pub struct CloudPoint {
    /// Its place in the stage, metres.
    pub place: Vector3<f64>,
    /// Where the keyframes show it.
    pub sightings: Vec<Sighting>,
}

/// The adjusted corners and cameras.
#[derive(Debug, Clone, PartialEq)]
pub struct Cloud {
    /// `T_body_camera` of each keyframe.
    pub poses: Vec<Pose<Body, Camera>>,
    /// How each camera moved, as far as known.
    pub rates: Vec<Rates>,
    /// The corners.
    pub points: Vec<CloudPoint>,
    /// Robust scale of the residuals, in sigmas of the sightings.
    pub scale: f64,
}

impl Cloud {
    /// Returns one sigma of a point along the direction in which it is known least, its depth,
    /// metres, with the cameras as they are; `None` if its sightings leave a direction open.
    pub fn depth_sigma_m(&self, views: &Views<'_>, point: &CloudPoint) -> Option<f64> {
        let rows = point.sightings.iter().filter_map(|seen| row(views, self, &point.place, seen));
        let information = rows.map(|row| row.by_point.transpose() * row.by_point).sum::<Matrix3<f64>>();
        let least = information.symmetric_eigenvalues().min();
        (least > f64::EPSILON).then(|| self.scale / least.sqrt())
    }

    /// Returns the cloud without some of the cameras, and without the points that the others do not
    /// determine. `kept` has the indices of those that stay, in order.
    pub fn of_views(&self, kept: &[usize]) -> Self {
        let (poses, rates): (Vec<_>, Vec<_>) = kept.iter().map(|view| (self.poses[*view], self.rates[*view])).unzip();
        let point = |point: &CloudPoint| {
            let seen = point.sightings.iter().filter_map(|seen| Some(Sighting { view: kept.binary_search(&seen.view).ok()?, ..*seen }));
            CloudPoint { place: point.place, sightings: seen.collect() }
        };
        let points = self.points.iter().map(point).filter(|point| is_determined(&poses, point)).collect();
        Self { poses, rates, points, scale: self.scale }
    }

    /// Returns the cloud with all lengths multiplied by a factor.
    pub fn scaled(&self, factor: f64) -> Self {
        let poses = self.poses.iter().map(|pose| Pose::new(pose.rotation, pose.translation * factor)).collect();
        let rates = self.rates.iter().map(|[velocity, angular_velocity]| [velocity * factor, *angular_velocity]).collect();
        let points = self.points.iter().map(|point| CloudPoint { place: point.place * factor, ..point.clone() }).collect();
        Self { poses, rates, points, scale: self.scale }
    }

    /// Returns how many points each camera sees.
    pub fn seen_by_view(&self) -> Vec<usize> {
        let mut counts = vec![0; self.poses.len()];
        self.points.iter().flat_map(|point| &point.sightings).for_each(|seen| counts[seen.view] += 1);
        counts
    }
}

/// A residual in sigmas, with its derivatives by the camera's shift and rotation
/// ([`Pose::moved`]) and by the point.
pub(super) struct Row {
    residual: Vector2<f64>,
    pub(super) by_pose: SMatrix<f64, 2, 6>,
    by_point: Matrix2x3<f64>,
    /// When the pixel was read, seconds after the middle row.
    pub(super) delay_s: f64,
}

impl Row {
    /// Returns the derivative by the unknowns of the camera.
    fn by_camera<const N: usize>(&self) -> SMatrix<f64, 2, N> {
        SMatrix::from_fn(|i, k| self.by_pose[(i, k % STILL)] * if k < STILL { 1.0 } else { self.delay_s })
    }
}

/// Adjusts tracks and cameras in some rounds. `None` if the equations have no solution, or the work
/// was stopped.
pub fn adjusted(views: &Views<'_>, tracks: Vec<Track>, rounds: usize, goes_on: &dyn Fn() -> bool) -> Option<Cloud> {
    match views.shutter.readout_s == 0.0 {
        true => adjusted_with::<STILL>(views, tracks, rounds, goes_on),
        false => adjusted_with::<ROLLING>(views, tracks, rounds, goes_on),
    }
}

/// Adjusts tracks and cameras that have `N` unknowns each.
fn adjusted_with<const N: usize>(views: &Views<'_>, tracks: Vec<Track>, rounds: usize, goes_on: &dyn Fn() -> bool) -> Option<Cloud> {
    let (poses, rates) = views.views.iter().map(|view| (view.pose, view.rates)).unzip();
    let mut cloud = Cloud { poses, rates, points: Vec::new(), scale: 1.0 };
    cloud.points = tracks.into_iter().filter_map(|track| started(views, track)).collect();
    for round in 0..rounds {
        if cloud.points.is_empty() {
            break;
        }
        cloud.scale = scale(views, &cloud)?;
        let mut damping = DAMPING;
        let mut cost = cost::<N>(views, &cloud);
        for _ in 0..STEPS {
            if !goes_on() {
                return None;
            }
            let Some((next, next_cost)) = lower::<N>(views, &cloud, cost, &mut damping) else { break };
            let is_done = next_cost > (1.0 - MIN_GAIN) * cost;
            (cloud, cost) = (next, next_cost);
            if is_done {
                break;
            }
        }
        cloud.scale = scale(views, &cloud)?;
        drop_outliers(views, &mut cloud);
        tracing::debug!(round, points = cloud.points.len(), scale = cloud.scale, cost, "bundle");
    }
    Some(cloud)
}

/// Returns a track's point where its rays meet best, with the sightings that agree with it.
fn started(views: &Views<'_>, track: Track) -> Option<CloudPoint> {
    let mut point = CloudPoint { place: Vector3::zeros(), sightings: track };
    for _ in 0..2 {
        point.place = meeting(views, &point.sightings)?;
        let place = point.place;
        point.sightings.retain(|seen| views.pixel(seen.view, &place).is_some_and(|pixel| (pixel - seen.pixel).norm() < MAX_START_PX));
    }
    is_determined(&views.views.iter().map(|view| view.pose).collect::<Vec<_>>(), &point).then_some(point)
}

/// Returns the point nearest to the rays of all sightings.
fn meeting(views: &Views<'_>, sightings: &[Sighting]) -> Option<Vector3<f64>> {
    let ray = |seen: &Sighting| {
        let origin = views.pose_at(seen.view, &views.views[seen.view].pose, seen.pixel).translation;
        Some((origin, views.direction(seen.view, seen.pixel)?))
    };
    nearest_to_rays(sightings.iter().map(ray).collect::<Option<Vec<_>>>()?)
}

/// Whether enough sightings from different enough directions determine a point.
fn is_determined(poses: &[Pose<Body, Camera>], point: &CloudPoint) -> bool {
    let directions: Vec<Vector3<f64>> =
        point.sightings.iter().map(|seen| (poses[seen.view].translation - point.place).normalize()).collect();
    let widest = directions.iter().enumerate().flat_map(|(k, a)| directions[..k].iter().map(move |b| a.angle(b))).fold(0.0, f64::max);
    directions.len() >= MIN_SIGHTINGS && widest >= MIN_PARALLAX
}

/// Returns the residual of a point in a camera, in sigmas, with its derivatives; `None` if it is
/// not in front of the camera or beyond the lens's field.
pub(super) fn row(views: &Views<'_>, cloud: &Cloud, place: &Vector3<f64>, seen: &Sighting) -> Option<Row> {
    let pose = views.carried(&cloud.poses[seen.view], &cloud.rates[seen.view], seen.pixel);
    let to_camera = pose.rotation_matrix().transpose();
    let at = pose.inverse().transform(&Point3::from(*place)).coords;
    let (pixel, by_place) = project(&views.camera, &at)?;
    let by_place = by_place / seen.sigma_px;
    let by_point = by_place * to_camera;
    let mut by_pose = SMatrix::<f64, 2, 6>::zeros();
    by_pose.fixed_columns_mut::<3>(0).copy_from(&-by_point);
    by_pose.fixed_columns_mut::<3>(3).copy_from(&(by_place * skew(&at)));
    Some(Row { residual: (pixel - seen.pixel) / seen.sigma_px, by_pose, by_point, delay_s: views.delay_s(seen.pixel) })
}

/// Returns the squared residuals of all sightings.
fn squares<'a>(views: &'a Views<'_>, cloud: &'a Cloud) -> impl Iterator<Item = f64> + 'a {
    let all = cloud.points.iter().flat_map(|point| point.sightings.iter().map(|seen| (point.place, seen)));
    all.filter_map(|(place, seen)| Some(row(views, cloud, &place, seen)?.residual.norm_squared()))
}

/// Returns the robust scale of the residuals.
fn scale(views: &Views<'_>, cloud: &Cloud) -> Option<f64> {
    let mut squares: Vec<f64> = squares(views, cloud).collect();
    // The median of a squared residual of two numbers with unit variance is 2 ln 2.
    median(&mut squares).map(|median| (median / (2.0 * 2.0_f64.ln())).sqrt().max(MIN_SCALE))
}

fn half_weight(scale: f64) -> f64 {
    (HALF_WEIGHT * scale).powi(2)
}

fn cost<const N: usize>(views: &Views<'_>, cloud: &Cloud) -> f64 {
    let of_points: f64 = squares(views, cloud).map(|square| (square / half_weight(cloud.scale)).ln_1p()).sum();
    let of_start = |view: usize| {
        let of = Prior::<N>::of(views, cloud, view);
        let [of_pose, of_rates] = of.squares();
        of_rates + (of_pose / half_weight(1.0)).ln_1p()
    };
    of_points + (0..cloud.poses.len()).map(of_start).sum::<f64>()
}

/// How far a camera is from its start, in sigmas: the pose if it was measured, and the rates.
struct Prior<const N: usize> {
    residual: SVector<f64, N>,
    /// The reciprocals of the sigmas; 0 where nothing is known.
    by_camera: SVector<f64, N>,
}

impl<const N: usize> Prior<N> {
    fn of(views: &Views<'_>, cloud: &Cloud, view: usize) -> Self {
        let (start, sigmas) = (&views.views[view], if N == STILL { [START_SIGMA, [1.0; 2]].concat() } else { ROLLING_SIGMA.to_vec() });
        let [shift, rotation] = start.pose.step_to(&cloud.poses[view]);
        let [velocity, angular_velocity] = [0, 1].map(|k| cloud.rates[view][k] - start.rates[k]);
        let off = [shift, rotation, velocity, angular_velocity];
        let by_camera = SVector::from_fn(|k, _| if k < STILL && !start.is_anchored { 0.0 } else { sigmas[k / 3].recip() });
        Self { residual: SVector::from_fn(|k, _| off[k / 3][k % 3] * by_camera[k]), by_camera }
    }

    /// Returns the squared residuals of the pose, and of the rates.
    fn squares(&self) -> [f64; 2] {
        [self.residual.rows(0, STILL).norm_squared(), self.residual.rows(STILL, N - STILL).norm_squared()]
    }

    /// Returns the information that it adds, and its right side. Wrong poses count less.
    fn equations(&self) -> (SMatrix<f64, N, N>, SVector<f64, N>) {
        let of_pose = 1.0 / (half_weight(1.0) + self.squares()[0]);
        let weight = |k: usize| if k < STILL { of_pose } else { 1.0 };
        let information = SVector::<f64, N>::from_fn(|k, _| self.by_camera[k].powi(2) * weight(k));
        (SMatrix::from_diagonal(&information), SVector::from_fn(|k, _| -self.by_camera[k] * self.residual[k] * weight(k)))
    }
}

/// Takes a step that lowers the cost; `None` if there is none.
fn lower<const N: usize>(views: &Views<'_>, cloud: &Cloud, cost_now: f64, damping: &mut f64) -> Option<(Cloud, f64)> {
    let equations = Equations::<N>::new(views, cloud);
    while *damping < MAX_DAMPING {
        if let Some(next) = equations.stepped(cloud, *damping) {
            let next_cost = cost::<N>(views, &next);
            if next_cost < cost_now {
                *damping *= 0.1;
                return Some((next, next_cost));
            }
        }
        *damping *= 10.0;
    }
    None
}

fn drop_outliers(views: &Views<'_>, cloud: &mut Cloud) {
    let most = (MAX_SIGMAS * cloud.scale).powi(2);
    let mut points = std::mem::take(&mut cloud.points);
    for point in &mut points {
        let place = point.place;
        point.sightings.retain(|seen| row(views, cloud, &place, seen).is_some_and(|row| row.residual.norm_squared() < most));
    }
    points.retain(|point| is_determined(&cloud.poses, point));
    cloud.points = points;
}

/// The normal equations, sorted by their blocks; `N` unknowns for each camera.
struct Equations<const N: usize> {
    /// The block of each camera, and its right side.
    cameras: Vec<(SMatrix<f64, N, N>, SVector<f64, N>)>,
    points: Vec<PointBlock<N>>,
}

/// The equations of a point.
struct PointBlock<const N: usize> {
    own: Matrix3<f64>,
    right: Vector3<f64>,
    /// With each camera that sees it.
    with: Vec<(usize, SMatrix<f64, N, 3>)>,
}

impl<const N: usize> Equations<N> {
    fn new(views: &Views<'_>, cloud: &Cloud) -> Self {
        let mut cameras: Vec<_> = (0..cloud.poses.len()).map(|view| Prior::<N>::of(views, cloud, view).equations()).collect();
        let half = half_weight(cloud.scale);
        let mut points = Vec::with_capacity(cloud.points.len());
        for point in &cloud.points {
            let mut block = PointBlock { own: Matrix3::zeros(), right: Vector3::zeros(), with: Vec::with_capacity(point.sightings.len()) };
            for seen in &point.sightings {
                let Some(row) = row(views, cloud, &point.place, seen) else { continue };
                let weight = 1.0 / (half + row.residual.norm_squared());
                let weighted = row.by_camera::<N>().transpose() * weight;
                let (matrix, right) = &mut cameras[seen.view];
                *matrix += weighted * row.by_camera::<N>();
                *right -= weighted * row.residual;
                block.own += row.by_point.transpose() * row.by_point * weight;
                block.right -= row.by_point.transpose() * row.residual * weight;
                block.with.push((seen.view, weighted * row.by_point));
            }
            points.push(block);
        }
        Self { cameras, points }
    }

    /// Returns the cloud after a damped step; `None` if the system has no solution.
    fn stepped(&self, cloud: &Cloud, damping: f64) -> Option<Cloud> {
        let n = N * self.cameras.len();
        let (mut matrix, mut right) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for (k, (block, own)) in self.cameras.iter().enumerate() {
            let damped = block + SMatrix::from_diagonal(&(block.diagonal() * damping)) + SMatrix::<f64, N, N>::identity() * f64::EPSILON;
            matrix.fixed_view_mut::<N, N>(N * k, N * k).copy_from(&damped);
            right.fixed_rows_mut::<N>(N * k).copy_from(own);
        }
        let mut inverses = Vec::with_capacity(self.points.len());
        for block in &self.points {
            let inverse = (block.own + Matrix3::from_diagonal(&(block.own.diagonal() * damping))).try_inverse()?;
            for (a, with_a) in &block.with {
                let by_a = with_a * inverse;
                let mut own = right.fixed_rows_mut::<N>(N * a);
                own -= by_a * block.right;
                for (b, with_b) in block.with.iter().filter(|(b, _)| b <= a) {
                    let mut place = matrix.fixed_view_mut::<N, N>(N * a, N * b);
                    place -= by_a * with_b.transpose();
                }
            }
            inverses.push(inverse);
        }
        let step = Factor::of(&matrix)?.solve(&right);
        let part = |view: usize, k: usize| step.fixed_rows::<3>(N * view + 3 * k).into_owned();
        let mut next = cloud.clone();
        for (view, (pose, rates)) in next.poses.iter_mut().zip(&mut next.rates).enumerate() {
            *pose = pose.moved(&part(view, 0), &part(view, 1));
            for (k, rate) in rates.iter_mut().enumerate().filter(|_| N > STILL) {
                *rate += part(view, 2 + k);
            }
        }
        for ((point, block), inverse) in next.points.iter_mut().zip(&self.points).zip(inverses) {
            let by_cameras = block.with.iter().map(|(k, with)| with.transpose() * step.fixed_rows::<N>(N * k)).sum::<Vector3<f64>>();
            point.place += inverse * (block.right - by_cameras);
        }
        next.poses.iter().all(Pose::is_finite).then_some(next)
    }
}

#[cfg(test)]
mod tests {
    use image::GrayImage;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::super::super::synthetic::{LENS, camera_poses};
    use super::super::views::View;
    use super::*;
    use crate::camera::{CameraModel, Shutter};
    use crate::light::CameraCurve;

    fn views<'a>(picture: &'a GrayImage, poses: &[Pose<Body, Camera>]) -> Views<'a> {
        let views = poses.iter().map(|pose| View { picture, pose: *pose, rates: [Vector3::zeros(); 2], is_anchored: true }).collect();
        Views { views, camera: CameraModel::new(LENS).unwrap(), shutter: Shutter::default(), curve: CameraCurve::default(), mask: None }
    }

    fn places() -> Vec<Vector3<f64>> {
        let mut random = Pcg64Mcg::seed_from_u64(5);
        (0..200)
            .map(|_| Vector3::new(random.random_range(-1.5..1.5), random.random_range(-1.0..1.0), random.random_range(-0.5..0.8)))
            .collect()
    }

    /// The tracks of points in cameras, with pixel noise.
    fn tracked(truth: &Views<'_>, noise_px: f64) -> Vec<Track> {
        let mut random = Pcg64Mcg::seed_from_u64(6);
        let mut track = |place: &Vector3<f64>| -> Track {
            let seen = (0..truth.views.len()).filter_map(|view| Some((view, truth.pixel(view, place)?)));
            let noisy = seen.map(|(view, pixel)| (view, pixel + Vector2::from_fn(|_, _| noise_px * random.random_range(-1.7..1.7))));
            noisy.map(|(view, pixel)| Sighting { view, feature: 0, pixel, sigma_px: 0.5 }).collect()
        };
        places().iter().map(&mut track).collect()
    }

    #[test]
    fn derivatives_agree_with_differences() {
        let picture = GrayImage::new(1280, 720);
        let poses = camera_poses(3);
        let views = views(&picture, &poses);
        let seen = Sighting { view: 1, feature: 0, pixel: Vector2::new(600.0, 300.0), sigma_px: 0.7 };
        let place = Vector3::new(0.3, -0.2, 0.4);
        let cloud = |pose: Pose<Body, Camera>| {
            let still = [Vector3::zeros(); 2];
            Cloud { poses: vec![poses[0], pose, poses[2]], rates: vec![still; 3], points: Vec::new(), scale: 1.0 }
        };
        let at = |pose: Pose<Body, Camera>, place: &Vector3<f64>| row(&views, &cloud(pose), place, &seen);
        let now = at(poses[1], &place).unwrap();
        let step = 1e-6;
        for axis in 0..3 {
            let along = Vector3::ith(axis, step);
            let moved = [
                (at(poses[1].moved(&along, &Vector3::zeros()), &place), now.by_pose.column(axis).into_owned()),
                (at(poses[1].moved(&Vector3::zeros(), &along), &place), now.by_pose.column(3 + axis).into_owned()),
                (at(poses[1], &(place + along)), now.by_point.column(axis).into_owned()),
            ];
            for (next, derivative) in moved {
                let difference = (next.unwrap().residual - now.residual) / step;
                assert!((difference - derivative).norm() < 1e-3 * derivative.norm().max(1.0), "{axis}: {difference} {derivative}");
            }
        }
    }

    #[test]
    fn exact_tracks_give_back_points_and_cameras() {
        let picture = GrayImage::new(1280, 720);
        let poses = camera_poses(12);
        let truth = views(&picture, &poses);
        let mut tracks = tracked(&truth, 0.0);
        // One sighting in forty shows something else.
        tracks.iter_mut().step_by(8).for_each(|track| track[2].pixel += Vector2::new(14.0, -9.0));
        let mut random = Pcg64Mcg::seed_from_u64(8);
        let mut off = |pose: &Pose<Body, Camera>| {
            let [shift, rotation] = [2e-3, 5e-4].map(|sigma| Vector3::from_fn(|_, _| sigma * random.random_range(-1.7..1.7)));
            pose.moved(&shift, &rotation)
        };
        let start: Vec<_> = poses.iter().map(&mut off).collect();
        let cloud = adjusted(&views(&picture, &start), tracks, ALL_ROUNDS, &|| true).unwrap();
        // What is left is a motion of the whole, within the mean of the start poses' errors.
        let errors = cloud.poses.iter().zip(&poses).map(|(found, true_pose)| (found.translation - true_pose.translation).norm());
        assert!(errors.fold(0.0, f64::max) < 2e-3);
        assert!(cloud.points.len() > 150 && cloud.scale < 0.2, "{} {}", cloud.points.len(), cloud.scale);
        assert!(
            cloud
                .points
                .iter()
                .all(|point| point.sightings.iter().all(|seen| (truth.pixel(seen.view, &point.place).unwrap() - seen.pixel).norm() < 2.0))
        );
    }

    #[test]
    fn noise_is_averaged_over_points() {
        let picture = GrayImage::new(1280, 720);
        let poses = camera_poses(12);
        let truth = views(&picture, &poses);
        let cloud = adjusted(&truth, tracked(&truth, 0.5), ALL_ROUNDS, &|| true).unwrap();
        assert!((0.8..1.2).contains(&cloud.scale), "{}", cloud.scale);
        let errors = cloud.poses.iter().zip(&poses).map(|(found, true_pose)| (found.translation - true_pose.translation).norm());
        assert!(errors.fold(0.0, f64::max) < 2e-3);
    }

    #[test]
    fn a_moving_rolling_shutter_is_undone() {
        let picture = GrayImage::new(1280, 720);
        let poses = camera_poses(12);
        let mut truth = views(&picture, &poses);
        truth.shutter.readout_s = 0.016;
        truth.views.iter_mut().for_each(|view| view.rates = [Vector3::new(0.8, 0.0, 0.1), Vector3::new(0.02, 0.1, -0.05)]);
        let cloud = adjusted(&truth, tracked(&truth, 0.0), ALL_ROUNDS, &|| true).unwrap();
        let errors = cloud.poses.iter().zip(&poses).map(|(found, true_pose)| (found.translation - true_pose.translation).norm());
        assert!(errors.fold(0.0, f64::max) < 1e-3 && cloud.scale < 0.05, "{}", cloud.scale);
    }

    #[test]
    fn points_seen_from_one_place_are_dropped() {
        let picture = GrayImage::new(1280, 720);
        let poses = vec![camera_poses(3)[1]; 4];
        let truth = views(&picture, &poses);
        assert!(adjusted(&truth, tracked(&truth, 0.2), ALL_ROUNDS, &|| true).is_none_or(|cloud| cloud.points.is_empty()));
    }
}
