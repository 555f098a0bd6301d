//! Moves an adjusted map into the frame of the configured surfaces, at their scale.
//!
//! In the joint adjustment a poster is a small part of every picture, and a few of its tiles decide
//! on frame and scale. Aligned alone, it has all of a frame's pixels, and the errors of its poses
//! differ from keyframe to keyframe. So the map is moved, turned and scaled as a whole, until its
//! cameras see the surfaces where the poses aligned alone see them. Distances in the frame are the
//! right weights: a small poster shows poorly where a camera is, but well where the poster appears.

use nalgebra::{Point3, SMatrix, SVector, UnitQuaternion, Vector2, Vector3};

use super::views::project;
use crate::camera::CameraModel;
use crate::geometry::robust_kernel::median;
use crate::geometry::{Body, Camera, Pose, skew};

/// Number of rounds of Gauss-Newton with reweighting. Raised, nothing is gained.
const ROUNDS: usize = 20;
/// Distance at which a camera counts half, in the median camera's RMS distances. Raised, badly
/// tracked keyframes pull more; lowered, good ones count less.
const HALF_WEIGHT: f64 = 2.0;
/// Minimum median of the cameras' mean squared distances, pixels², to divide by.
const MIN_SQUARED_PX: f64 = 1e-12;
/// Minimum number of cameras.
const MIN_CAMERAS: usize = 3;
/// Minimum number of points of the surfaces that a camera must show.
const MIN_POINTS: usize = 4;
/// Degrees of freedom of a motion with a scale: a shift, a rotation, the logarithm of the scale.
pub(super) const FREEDOM: usize = 7;

pub(super) type Normal = SMatrix<f64, FREEDOM, FREEDOM>;
pub(super) type Score = SVector<f64, FREEDOM>;

/// A motion and a scale that map one body frame to another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Anchoring {
    /// Factor on all lengths.
    scale: f64,
    rotation: UnitQuaternion<f64>,
    /// Metres, after scaling and rotation.
    shift: Vector3<f64>,
    /// One sigma of the scale, as a fraction.
    pub scale_sigma: f64,
}

/// A camera's pose in the map, and the pixels of the surfaces' points as aligned alone.
struct View {
    in_map: Pose<Body, Camera>,
    seen: Vec<(Vector3<f64>, Vector2<f64>)>,
}

/// The equations of one camera.
struct Equations {
    normal: Normal,
    score: Score,
    /// Mean squared distance in the frame, pixels².
    squared_px: f64,
}

/// From the stage's frame to the map's.
#[derive(Debug, Clone, Copy)]
pub(super) struct IntoMap {
    /// Metres of the map per metre.
    pub(super) scale: f64,
    pub(super) rotation: UnitQuaternion<f64>,
    /// Metres of the map.
    pub(super) shift: Vector3<f64>,
}

/// A fitted motion and scale into the map, with the covariance of a step from it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fit {
    pub(super) at: IntoMap,
    pub(super) covariance: Normal,
}

/// A small motion and growth of the stage about its origin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct FrameWay {
    pub(super) shift: Vector3<f64>,
    /// Radians.
    pub(super) turn: Vector3<f64>,
    /// As a fraction.
    pub(super) growth: f64,
}

impl FrameWay {
    /// Returns how it moves a point of the stage.
    pub(super) fn of(&self, place: &Vector3<f64>) -> Vector3<f64> {
        self.shift + self.turn.cross(place) + place * self.growth
    }
}

impl Fit {
    /// Fits cameras, each by its pose in the map and by the surfaces alone, by where they see the
    /// surfaces' `points`. `None` if too few cameras show enough of them, or do not determine the
    /// scale.
    pub(super) fn of(cameras: &[[Pose<Body, Camera>; 2]], points: &[Vector3<f64>], camera: &CameraModel) -> Option<Self> {
        let views: Vec<View> = cameras.iter().map(|pair| View::new(pair, points, camera)).collect();
        let views: Vec<View> = views.into_iter().filter(|view| view.seen.len() >= MIN_POINTS).collect();
        if views.len() < MIN_CAMERAS {
            return None;
        }
        let mut fit = IntoMap { scale: 1.0, rotation: UnitQuaternion::identity(), shift: Vector3::zeros() };
        let mut covariance = Normal::zeros();
        for _ in 0..ROUNDS {
            let equations = views.iter().map(|view| fit.equations(view, camera)).collect::<Option<Vec<_>>>()?;
            let mut squares: Vec<f64> = equations.iter().map(|camera| camera.squared_px).collect();
            let usual = median(&mut squares)?.max(MIN_SQUARED_PX);
            let weight = |camera: &Equations| 1.0 / (1.0 + camera.squared_px / (HALF_WEIGHT * HALF_WEIGHT * usual));
            let normal: Normal = equations.iter().map(|camera| camera.normal * weight(camera)).sum();
            let score: Score = equations.iter().map(|camera| camera.score * weight(camera)).sum();
            // Distances within a frame share the error of its pose, so that the scatter of
            // whole cameras tells the uncertainty (a sandwich estimator; Huber 1967).
            let scatter: Normal = equations.iter().map(|camera| camera.score * camera.score.transpose() * weight(camera).powi(2)).sum();
            let inverse = normal.cholesky()?.inverse();
            // Few cameras scatter in few directions; the noise of their points covers the others.
            let of_noise = inverse * usual;
            covariance = inverse * scatter * inverse + of_noise;
            fit = fit.moved(&(inverse * score));
        }
        fit.is_usable().then_some(Self { at: fit, covariance })
    }

    /// Returns how points of the stage move, one sigma each, as frame and scale may be off. What
    /// nothing measured is a choice, not an error: `unknown` is its sigma.
    pub(super) fn ways(&self, unknown: f64) -> Vec<FrameWay> {
        let eigen = self.covariance.symmetric_eigen();
        let measured = (0..FREEDOM).filter(|k| eigen.eigenvalues[*k].sqrt() < 0.1 * unknown);
        let to_stage = self.at.rotation.inverse();
        let way = |k: usize| {
            let step = eigen.eigenvectors.column(k) * eigen.eigenvalues[k].max(0.0).sqrt();
            let [shift, turn] = [0, 3].map(|first| to_stage * Vector3::new(step[first], step[first + 1], step[first + 2]));
            // A map that is larger than it seems has its points nearer to the origin.
            FrameWay { shift: -shift / self.at.scale, turn: -turn, growth: -step[6] }
        };
        measured.map(way).collect()
    }

    /// Returns the motion and the scale from the map into the stage.
    pub(super) fn anchoring(&self) -> Anchoring {
        let IntoMap { scale, rotation, shift } = self.at;
        let (rotation, scale) = (rotation.inverse(), scale.recip());
        Anchoring { scale, rotation, shift: -(rotation * shift) * scale, scale_sigma: self.covariance[(6, 6)].max(0.0).sqrt() }
    }
}

impl Anchoring {
    /// Returns where a point of the map is.
    fn place(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * point * self.scale + self.shift
    }

    /// Returns where something of the map is.
    pub fn pose<T>(&self, pose: &Pose<Body, T>) -> Pose<Body, T> {
        Pose::new(self.rotation * pose.rotation, self.place(&pose.translation))
    }

    /// Returns it with another scale: with which a length of the map is `wanted` long.
    pub fn with_length(&self, length: f64, wanted: f64) -> Self {
        let factor = wanted / (self.scale * length);
        Self { scale: self.scale * factor, shift: self.shift * factor, ..*self }
    }

    /// Returns how long a length of the map is.
    pub fn length(&self, length: f64) -> f64 {
        self.scale * length
    }
}

impl View {
    fn new([in_map, alone]: &[Pose<Body, Camera>; 2], points: &[Vector3<f64>], camera: &CameraModel) -> Self {
        let to_camera = alone.inverse();
        let seen = |point: &Vector3<f64>| {
            let (pixel, _) = project(camera, &to_camera.transform(&Point3::from(*point)).coords)?;
            let is_inside = (0.0..f64::from(camera.width())).contains(&pixel.x) && (0.0..f64::from(camera.height())).contains(&pixel.y);
            is_inside.then_some((*point, pixel))
        };
        Self { in_map: *in_map, seen: points.iter().filter_map(seen).collect() }
    }
}

impl IntoMap {
    /// Returns a camera's equations of a step of shift, rotation and logarithm of the scale. `None`
    /// if it does not see the points in front of it.
    fn equations(&self, view: &View, camera: &CameraModel) -> Option<Equations> {
        let to_camera = view.in_map.inverse();
        let turn = to_camera.rotation_matrix();
        let mut equations = Equations { normal: Normal::zeros(), score: Score::zeros(), squared_px: 0.0 };
        for (point, seen) in &view.seen {
            let turned = self.rotation * point * self.scale;
            let (pixel, by_point) = project(camera, &to_camera.transform(&Point3::from(turned + self.shift)).coords)?;
            let by_place = by_point * turn;
            let mut by_step = SMatrix::<f64, 2, FREEDOM>::zeros();
            by_step.fixed_columns_mut::<3>(0).copy_from(&by_place);
            by_step.fixed_columns_mut::<3>(3).copy_from(&-(by_place * skew(&turned)));
            by_step.fixed_columns_mut::<1>(6).copy_from(&(by_place * turned));
            let residual = seen - pixel;
            equations.normal += by_step.transpose() * by_step;
            equations.score += by_step.transpose() * residual;
            equations.squared_px += residual.norm_squared() / view.seen.len() as f64;
        }
        Some(equations)
    }

    /// Returns where a point of the stage is in the map, but for the shift.
    pub(super) fn turned(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * point * self.scale
    }

    /// Whether it is a motion and a scale.
    pub(super) fn is_usable(&self) -> bool {
        self.scale.is_finite() && self.scale > 0.0 && self.shift.iter().chain(self.rotation.coords.iter()).all(|x| x.is_finite())
    }

    /// Returns the step that leads to another one ([`moved`](Self::moved)).
    pub(super) fn step_to(&self, other: &Self) -> Score {
        let (shift, turn) = (other.shift - self.shift, (other.rotation * self.rotation.inverse()).scaled_axis());
        Score::from_column_slice(&[shift.x, shift.y, shift.z, turn.x, turn.y, turn.z, (other.scale / self.scale).ln()])
    }

    /// Returns it after a step of shift, rotation and logarithm of the scale.
    pub(super) fn moved(&self, step: &Score) -> Self {
        Self {
            scale: self.scale * step[6].exp(),
            rotation: UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(3).into_owned()) * self.rotation,
            shift: self.shift + step.fixed_rows::<3>(0),
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::super::super::synthetic::camera_poses;
    use super::*;

    fn camera() -> CameraModel {
        CameraModel::pinhole(960, 720, 800.0, 800.0, 479.5, 359.5).expect("a camera")
    }

    /// A poster at the origin, which all cameras look at.
    fn poster() -> Vec<Vector3<f64>> {
        (0..25).map(|k| Vector3::new(0.1 * f64::from(k % 5) - 0.2, 0.1 * f64::from(k / 5) - 0.2, 0.0)).collect()
    }

    fn pulled(point: &Vector3<f64>) -> Vector3<f64> {
        UnitQuaternion::from_euler_angles(0.02, -0.01, 0.03) * point * 0.9997 + Vector3::new(0.1, -0.2, 0.05)
    }

    /// Cameras of a map that is 300 ppm too small, turned and shifted. Each pose by the poster
    /// alone is where noise of `sigma_px` in the poster's corners puts it; some are off by 5 cm.
    fn cameras(sigma_px: f64) -> Vec<[Pose<Body, Camera>; 2]> {
        let mut random = Pcg64Mcg::seed_from_u64(3);
        let turn = UnitQuaternion::from_euler_angles(0.02, -0.01, 0.03);
        let mut normal = move || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        let pair = |(k, truth): (usize, &Pose<Body, Camera>)| {
            let map = Pose::new(turn * truth.rotation, pulled(&truth.translation));
            // The covariance of a pose from corners with this noise.
            let mut information = SMatrix::<f64, 6, 6>::zeros();
            for point in poster() {
                let at = truth.inverse().transform(&Point3::from(point)).coords;
                let (_, by_point) = project(&camera(), &at).expect("in front");
                let mut by_pose = SMatrix::<f64, 2, 6>::zeros();
                by_pose.fixed_columns_mut::<3>(0).copy_from(&-(by_point * truth.rotation_matrix().transpose()));
                by_pose.fixed_columns_mut::<3>(3).copy_from(&(by_point * skew(&at)));
                information += by_pose.transpose() * by_pose;
            }
            let root = information.cholesky().expect("determined").inverse().cholesky().expect("positive").l();
            let off = root * SVector::<f64, 6>::from_fn(|_, _| sigma_px * normal());
            let outlier = Vector3::x() * if k % 10 == 4 { 0.05 } else { 0.0 };
            [map, truth.moved(&(off.fixed_rows::<3>(0) + outlier), &off.fixed_rows::<3>(3).into_owned())]
        };
        camera_poses(60).iter().enumerate().map(pair).collect()
    }

    #[test]
    fn a_turned_shifted_and_scaled_map_is_put_back_despite_outliers() {
        for sigma_px in [0.0, 0.5] {
            let cameras = cameras(sigma_px);
            let found = Fit::of(&cameras, &poster(), &camera()).expect("determined").anchoring();
            let truths = camera_poses(60);
            let off = |pose: &Pose<Body, Camera>, truth: &Pose<Body, Camera>| (pose.translation - truth.translation).norm();
            let mut alone: Vec<f64> = cameras.iter().zip(&truths).map(|([_, alone], truth)| off(alone, truth)).collect();
            let usual = median(&mut alone).expect("cameras");
            let worst = cameras.iter().zip(&truths).map(|([map, _], truth)| off(&found.pose(map), truth)).fold(0.0, f64::max);
            let error = found.length(0.9997) - 1.0;
            println!("{sigma_px} px: {worst:.2e} m, of one pose {usual:.2e} m, scale {error:.1e}, one sigma {:.1e}", found.scale_sigma);
            assert!(worst < 1e-6 + 0.25 * usual, "{sigma_px}: {worst} {usual}");
            assert!(error.abs() < 1e-6 + 4.0 * found.scale_sigma && found.scale_sigma < 1e-6 + 2e-3 * sigma_px, "{error}");
        }
    }

    /// The equations against differences: where the points appear after small steps.
    #[test]
    fn derivatives_agree_with_differences() {
        let view = View::new(&cameras(0.0)[7], &poster(), &camera());
        let at = IntoMap { scale: 0.99, rotation: UnitQuaternion::from_euler_angles(0.1, 0.0, -0.05), shift: Vector3::new(0.02, 0.0, 0.1) };
        let here = at.equations(&view, &camera()).expect("in front");
        for k in 0..FREEDOM {
            let moved = |size: f64| at.moved(&Score::from_fn(|i, _| if i == k { size } else { 0.0 })).equations(&view, &camera());
            let [more, less] = [1e-6, -1e-6].map(|size| moved(size).expect("in front").squared_px * view.seen.len() as f64);
            let slope = (more - less) / 4e-6;
            assert!((slope + here.score[k]).abs() < 1e-4 * (1.0 + here.score.norm()), "{k}: {slope} {}", here.score[k]);
        }
    }

    /// The ways against fits drawn from the covariance: what each does to points of the stage.
    #[test]
    fn ways_scatter_points_as_fits_of_the_covariance_do() {
        let at = IntoMap { scale: 1.3, rotation: UnitQuaternion::from_euler_angles(0.3, -0.5, 0.8), shift: Vector3::new(0.4, -1.0, 2.0) };
        let mut random = Pcg64Mcg::seed_from_u64(3);
        let root = Normal::from_fn(|i, j| if j > i { 0.0 } else { 1e-3 * random.random_range(-1.0..1.0) });
        let fit = Fit { at, covariance: root * root.transpose() };
        let places = [Vector3::new(1.0, -2.0, 0.5), Vector3::new(-0.5, 0.3, 3.0)];
        let stacked = |of: &dyn Fn(&Vector3<f64>) -> Vector3<f64>| {
            let [a, b] = places.each_ref().map(of);
            SVector::<f64, 6>::from_column_slice(&[a.x, a.y, a.z, b.x, b.y, b.z])
        };
        let mut scatter = SMatrix::<f64, 6, 6>::zeros();
        let (draws, here) = (20_000, fit.anchoring());
        let mut normal = move || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        for _ in 0..draws {
            let drawn = Fit { at: at.moved(&(root * Score::from_fn(|_, _| normal()))), ..fit }.anchoring();
            // A point of the map, where the drawn fit puts it.
            let moved = stacked(&|place| drawn.place(&(at.turned(place) + at.shift)) - place);
            scatter += moved * moved.transpose() / f64::from(draws);
        }
        let ways = fit.ways(100.0).into_iter().map(|way| stacked(&|place| way.of(place)));
        let summed = ways.map(|moved| moved * moved.transpose()).sum::<SMatrix<f64, 6, 6>>();
        assert!((summed - scatter).norm() < 0.05 * scatter.norm(), "{summed}{scatter}");
        assert!((here.place(&(at.turned(&places[0]) + at.shift)) - places[0]).norm() < 1e-12);
    }

    #[test]
    fn what_nothing_measures_is_no_error() {
        let at = IntoMap { scale: 1.0, rotation: UnitQuaternion::identity(), shift: Vector3::zeros() };
        let mut covariance = Normal::identity() * 1e4;
        covariance[(6, 6)] = 1e-6;
        let ways = Fit { at, covariance }.ways(100.0);
        assert_eq!(ways.len(), 1);
        assert!(ways[0].shift.norm() < 1e-12 && ways[0].turn.norm() < 1e-12 && (ways[0].growth.abs() - 1e-3).abs() < 1e-12);
    }

    #[test]
    fn cameras_in_one_place_give_no_scale() {
        let pose = camera_poses(1)[0];
        assert!(Fit::of(&[[pose; 2]; 2], &poster(), &camera()).is_none());
        assert!(Fit::of(&[[pose; 2]; 5], &poster()[..3], &camera()).is_none());
    }
}
