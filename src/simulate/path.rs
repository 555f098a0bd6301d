//! Smooth paths: where the virtual camera and the virtual objects are at any time.
//!
//! A path is a few keys (a time and a place) joined by a natural cubic spline, so that speed and
//! acceleration are continuous, as on a dolly. The camera has two: one for its position and one for
//! the point it looks at. A hand-held camera adds a shake: a sum of sines on every axis.

use std::f64::consts::TAU;

use nalgebra::{Point3, UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use thiserror::Error;

use crate::geometry::{Body, Camera, Pose, Stage};

/// Why a list of keys is not a valid path.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum PathError {
    /// There are no keys.
    #[error("the path has no keys; give at least one")]
    Empty,
    /// A key's time is not after that of the key before it, or a number is not finite.
    #[error("key {index} at {time_s} s does not follow the key before it; order the keys by time and use finite numbers")]
    Key {
        /// Its index, 0-based.
        index: usize,
        /// Its time in seconds.
        time_s: f64,
    },
}

/// A natural cubic spline through points in the stage (metres) over time (seconds). Before the
/// first key and after the last it stays at that key's point.
#[derive(Debug, Clone, PartialEq)]
pub struct Spline {
    times: Vec<f64>,
    points: Vec<Vector3<f64>>,
    /// Second derivative at every key; zero at both ends.
    bends: Vec<Vector3<f64>>,
}

impl Spline {
    /// Makes a spline through the keys `(time_s, point)`. One key is a point at rest, two are a
    /// straight line.
    pub fn new(keys: &[(f64, Vector3<f64>)]) -> Result<Self, PathError> {
        if keys.is_empty() {
            return Err(PathError::Empty);
        }
        let follows = |i: usize| i == 0 || keys[i].0 > keys[i - 1].0;
        let finite = |i: usize| keys[i].0.is_finite() && keys[i].1.iter().all(|v| v.is_finite());
        if let Some(index) = (0..keys.len()).find(|&i| !follows(i) || !finite(i)) {
            return Err(PathError::Key { index, time_s: keys[index].0 });
        }
        let (times, points): (Vec<_>, Vec<_>) = keys.iter().copied().unzip();
        let bends = second_derivatives(&times, &points);
        Ok(Self { times, points, bends })
    }

    /// Joins the keys by straight lines: the speed jumps at each key, as when a dolly hits its end
    /// stop.
    pub fn straight(keys: &[(f64, Vector3<f64>)]) -> Result<Self, PathError> {
        let mut path = Self::new(keys)?;
        path.bends.fill(Vector3::zeros());
        Ok(path)
    }

    /// Makes a path that stays at one point.
    pub fn fixed(point: Vector3<f64>) -> Self {
        Self { times: vec![0.0], points: vec![point], bends: vec![Vector3::zeros()] }
    }

    /// Returns the point at a time.
    pub fn at(&self, time_s: f64) -> Vector3<f64> {
        let last = self.times.len() - 1;
        let t = time_s.clamp(self.times[0], self.times[last]);
        let next = self.times.partition_point(|&k| k <= t).clamp(1, last.max(1));
        if last == 0 {
            return self.points[0];
        }
        let i = next - 1;
        let h = self.times[next] - self.times[i];
        let (a, b) = ((self.times[next] - t) / h, (t - self.times[i]) / h);
        let cubic = (a * a * a - a) * self.bends[i] + (b * b * b - b) * self.bends[next];
        a * self.points[i] + b * self.points[next] + cubic * (h * h / 6.0)
    }
}

/// Computes the second derivatives of the natural spline: a tridiagonal system, solved by one
/// forward and one backward sweep.
fn second_derivatives(times: &[f64], points: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let n = times.len();
    let mut bends = vec![Vector3::zeros(); n];
    let mut carry = vec![0.0; n];
    for i in 1..n.saturating_sub(1) {
        let (before, after) = (times[i] - times[i - 1], times[i + 1] - times[i]);
        let share = before / (before + after);
        let pivot = share * carry[i - 1] + 2.0;
        let jump = (points[i + 1] - points[i]) / after - (points[i] - points[i - 1]) / before;
        carry[i] = (share - 1.0) / pivot;
        bends[i] = (jump * (6.0 / (before + after)) - bends[i - 1] * share) / pivot;
    }
    for i in (1..n.saturating_sub(1)).rev() {
        let next = bends[i + 1];
        bends[i] += next * carry[i];
    }
    bends
}

/// A hand's tremor or a shaking rig: sines of random frequency and phase on all six axes.
#[derive(Debug, Clone, PartialEq)]
pub struct Shake {
    /// Amplitude, frequency in Hz and phase in radians of every sine. The first three axes are x,
    /// y, z in metres, the others rotations about x, y, z in radians.
    sines: [Vec<[f64; 3]>; 6],
}

impl Shake {
    /// Makes a shake whose position scatters by about `amplitude_m` and its orientation by about
    /// `amplitude_rad` (one sigma on each axis). Frequencies range from 0.5 Hz to `highest_hz`;
    /// higher ones have smaller amplitudes.
    pub fn new(amplitude_m: f64, amplitude_rad: f64, highest_hz: f64, seed: u64) -> Self {
        // Sines on each axis: enough that their sum does not seem to repeat and is nearly normal.
        // Raised, rendering takes longer. Any change alters the shake of every seed.
        const SINES: usize = 12;
        let mut random = Pcg64Mcg::seed_from_u64(seed ^ 0x5ba6_e000);
        let sines = std::array::from_fn(|axis| {
            let scale = if axis < 3 { amplitude_m } else { amplitude_rad };
            let mut axis: Vec<[f64; 3]> = (0..SINES)
                .map(|_| {
                    let hz = 0.5 + (highest_hz - 0.5).max(0.0) * random.random::<f64>();
                    [random.random_range(0.5..1.0) / hz.max(1.0), hz, random.random::<f64>() * TAU]
                })
                .collect();
            // A sine of amplitude a has variance a²/2.
            let sigma = axis.iter().map(|s| 0.5 * s[0] * s[0]).sum::<f64>().sqrt();
            axis.iter_mut().for_each(|s| s[0] *= scale / sigma);
            axis
        });
        Self { sines }
    }

    /// Returns the offset in metres and the rotation vector in radians at a time.
    fn at(&self, time_s: f64) -> (Vector3<f64>, Vector3<f64>) {
        let sum = |axis: usize| self.sines[axis].iter().map(|[a, hz, phase]| a * (TAU * hz * time_s + phase).sin()).sum::<f64>();
        (Vector3::new(sum(0), sum(1), sum(2)), Vector3::new(sum(3), sum(4), sum(5)))
    }
}

/// Returns `T_stage_camera` of a camera at `position` that looks at `target`. It is level except
/// for `roll_rad` about its own forward axis (positive turns the camera clockwise as seen by
/// itself).
///
/// If it looks straight up or down, level is undefined and stage x is to the right. If the target
/// is at the camera, it looks upstage.
pub fn look_at(position: Point3<f64>, target: Point3<f64>, roll_rad: f64) -> Pose<Stage, Camera> {
    let forward = (target - position).try_normalize(1e-12).unwrap_or_else(Vector3::y);
    let right = forward.cross(&Vector3::z()).try_normalize(1e-9).unwrap_or_else(Vector3::x);
    let down = forward.cross(&right);
    let level = UnitQuaternion::from_basis_unchecked(&[right, down, forward]);
    Pose::new(level * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll_rad), position.coords)
}

/// Where the camera is and where it looks, at any time.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraPath {
    /// The camera centre in the stage.
    pub position: Spline,
    /// The point of the stage at the centre of the picture.
    pub target: Spline,
    /// Roll about the forward axis, radians.
    pub roll_rad: f64,
    /// Shake added to that, in the camera's own axes.
    pub shake: Option<Shake>,
}

impl CameraPath {
    /// Makes the path of a camera that does not move.
    pub fn fixed(position: Point3<f64>, target: Point3<f64>) -> Self {
        Self { position: Spline::fixed(position.coords), target: Spline::fixed(target.coords), roll_rad: 0.0, shake: None }
    }

    /// Returns `T_stage_camera` at a time.
    pub fn pose(&self, time_s: f64) -> Pose<Stage, Camera> {
        let steady = look_at(self.position.at(time_s).into(), self.target.at(time_s).into(), self.roll_rad);
        let Some(shake) = &self.shake else { return steady };
        let (offset, rotation) = shake.at(time_s);
        steady * Pose::<Camera, Camera>::new(UnitQuaternion::from_scaled_axis(rotation), offset)
    }
}

/// A rotation about the camera's own forward axis over time.
#[derive(Debug, Clone, PartialEq)]
pub struct Roll {
    /// Angle in radians, in the x component.
    angle: Spline,
}

impl Roll {
    /// Makes a roll through the keys `(time_s, roll_rad)`; positive turns the camera clockwise as
    /// seen by itself.
    pub fn new(keys: &[(f64, f64)]) -> Result<Self, PathError> {
        let keys: Vec<_> = keys.iter().map(|(time_s, roll_rad)| (*time_s, Vector3::new(*roll_rad, 0.0, 0.0))).collect();
        Ok(Self { angle: Spline::new(&keys)? })
    }

    /// Returns the rotation at a time, in camera axes.
    pub(super) fn at(&self, time_s: f64) -> UnitQuaternion<f64> {
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.angle.at(time_s).x)
    }
}

/// Where an object is at any time: it moves along a spline and turns about the stage's vertical.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectPath {
    /// The origin of its frame in the stage.
    pub position: Spline,
    /// Rotation about z at time 0, radians; 0 faces the audience.
    pub rotation_rad: f64,
    /// Rotation rate, radians per second.
    pub angular_velocity_rad_s: f64,
}

impl ObjectPath {
    /// Returns `T_stage_object` at a time.
    pub fn pose(&self, time_s: f64) -> Pose<Stage, Body> {
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.rotation_rad + self.angular_velocity_rad_s * time_s);
        Pose::new(rotation, self.position.at(time_s))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn looking_upstage_from_the_house_is_the_golden_pose() {
        let pose = look_at(Point3::new(0.0, -4.0, 0.0), Point3::origin(), 0.0);
        let s = std::f64::consts::FRAC_1_SQRT_2;
        let expected = [-s, 0.0, 0.0, s];
        assert!(pose.orientation_xyzw().iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{:?}", pose.orientation_xyzw());
        assert_eq!(pose.translation, Vector3::new(0.0, -4.0, 0.0));
    }

    #[test]
    fn the_target_lies_on_the_forward_axis_and_the_picture_is_level() {
        let (position, target) = (Point3::new(1.0, -3.0, 0.5), Point3::new(-0.4, 0.2, -0.7));
        let seen = look_at(position, target, 0.0).inverse().transform(&target);
        assert!(seen.x.abs() < 1e-12 && seen.y.abs() < 1e-12 && (seen.z - (target - position).norm()).abs() < 1e-12);
        let right = look_at(position, target, 0.0).rotation * Vector3::x();
        assert!(right.z.abs() < 1e-12 && right.x > 0.0);
        // Turned clockwise by 90 degrees, the camera's right axis points down.
        let rolled = look_at(Point3::new(0.0, -4.0, 0.0), Point3::origin(), std::f64::consts::FRAC_PI_2).rotation * Vector3::x();
        assert!((rolled + Vector3::z()).norm() < 1e-12);
    }

    #[test]
    fn a_roll_runs_through_its_keys() {
        let roll = Roll::new(&[(0.0, 0.1), (1.0, 0.7), (2.0, 2.4)]).unwrap();
        assert!(
            [(0.0, 0.1), (1.0, 0.7), (2.0, 2.4)]
                .iter()
                .all(|(t, angle)| (roll.at(*t).scaled_axis() - Vector3::z() * *angle).norm() < 1e-12)
        );
        let level = look_at(Point3::new(0.0, -4.0, 0.0), Point3::origin(), 0.0);
        let rolled = level.rotation * roll.at(1.0);
        assert!(rolled.angle_to(&look_at(Point3::new(0.0, -4.0, 0.0), Point3::origin(), 0.7).rotation) < 1e-12);
    }

    #[test]
    fn looking_straight_down_is_still_a_pose() {
        let pose = look_at(Point3::new(0.0, 0.0, 3.0), Point3::origin(), 0.0);
        assert!(pose.is_finite());
        assert!((pose.rotation * Vector3::z() + Vector3::z()).norm() < 1e-12);
    }

    #[test]
    fn spline_passes_through_its_keys_with_a_continuous_slope() {
        let keys = [0.0, 0.7, 1.5, 3.0].map(|t: f64| (t, Vector3::new(t.sin(), t * t, 1.0)));
        let spline = Spline::new(&keys).unwrap();
        for (t, p) in keys {
            assert!((spline.at(t) - p).norm() < 1e-12);
        }
        let slope = |a: f64, b: f64| (spline.at(b) - spline.at(a)) / (b - a);
        let (step, t) = (1e-5, 0.7);
        assert!((slope(t - step, t) - slope(t, t + step)).norm() < 1e-3);
        assert_eq!(spline.at(-1.0), keys[0].1);
        assert!((spline.at(9.0) - keys[3].1).norm() < 1e-12);
    }

    #[test]
    fn straight_keys_have_corners() {
        let path = Spline::straight(&[(0.0, Vector3::zeros()), (1.0, Vector3::x()), (3.0, Vector3::x())]).unwrap();
        assert!((path.at(0.4) - Vector3::x() * 0.4).norm() < 1e-12 && (path.at(1.5) - Vector3::x()).norm() < 1e-12);
    }

    #[test]
    fn two_keys_are_a_straight_line() {
        let spline = Spline::new(&[(1.0, Vector3::zeros()), (3.0, Vector3::new(2.0, 4.0, 0.0))]).unwrap();
        assert!((spline.at(1.5) - Vector3::new(0.5, 1.0, 0.0)).norm() < 1e-12);
    }

    #[test]
    fn bad_keys_are_named() {
        assert_eq!(Spline::new(&[]), Err(PathError::Empty));
        let keys = [(0.0, Vector3::zeros()), (0.0, Vector3::zeros())];
        assert_eq!(Spline::new(&keys), Err(PathError::Key { index: 1, time_s: 0.0 }));
        assert!(Spline::new(&[(0.0, Vector3::new(f64::NAN, 0.0, 0.0))]).is_err());
    }

    #[test]
    fn shake_has_the_configured_scatter() {
        let shake = Shake::new(0.01, 0.02, 5.0, 3);
        let (mut along_x, mut about_z) = (0.0, 0.0);
        // Number of samples. Lowered, the scatter is less exact.
        const COUNT: i32 = 200_000;
        for k in 0..COUNT {
            let (offset, rotation) = shake.at(f64::from(k) * 0.003);
            along_x += offset.x.powi(2) / f64::from(COUNT);
            about_z += rotation.z.powi(2) / f64::from(COUNT);
        }
        assert!((along_x.sqrt() - 0.01).abs() < 0.0005);
        assert!((about_z.sqrt() - 0.02).abs() < 0.001);
    }
}
