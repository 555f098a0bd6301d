use nalgebra::{Matrix2, Matrix6, UnitQuaternion, Vector2, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

use super::*;
use crate::geometry::Camera;

const FRAME_NS: i64 = 33_333_333;

fn stamp(frame: i64) -> Timestamp {
    Timestamp::from_ns(frame * FRAME_NS)
}

const SIGMA: f64 = 1e-4;

type Track = Vec<(Pose<Stage, Camera>, Pose<Stage, Camera>)>;

pub(super) fn kalman(predict_s: f64) -> FilterSettings {
    FilterSettings { kind: FilterKind::Kalman(KalmanSettings::default()), predict_s }
}

pub(super) fn one_euro() -> FilterSettings {
    FilterSettings { kind: FilterKind::OneEuro(OneEuroSettings::default()), predict_s: 0.0 }
}

pub(super) fn pose(position: Vector3<f64>, rotation: Vector3<f64>) -> Pose<Stage, Camera> {
    Pose::new(UnitQuaternion::from_scaled_axis(rotation), position)
}

/// The textbook filter along one axis: constant velocity, with an acceleration that is constant
/// within a step and independent between steps. A counterexample: with little noise it takes any
/// surprise for an acceleration since the last frame, doubles the body's velocity, and oscillates.
/// Our tests must reject it.
#[derive(Clone)]
pub(super) struct WhiteAcceleration {
    /// Position and velocity, m and m/s.
    pub state: Vector2<f64>,
    covariance: Matrix2<f64>,
    /// One sigma of the acceleration, m/s².
    acceleration: f64,
}

impl WhiteAcceleration {
    pub fn at_rest(acceleration: f64) -> Self {
        Self { state: Vector2::zeros(), covariance: Matrix2::identity(), acceleration }
    }

    pub fn update(&mut self, step_s: f64, measured: f64, variance: f64) {
        let on = Matrix2::new(1.0, step_s, 0.0, 1.0);
        let by_acceleration = Vector2::new(step_s * step_s / 2.0, step_s) * self.acceleration;
        let covariance = on * self.covariance * on.transpose() + by_acceleration * by_acceleration.transpose();
        let gain = covariance.column(0) / (covariance[(0, 0)] + variance);
        let expected = on * self.state;
        self.state = expected + gain * (measured - expected.x);
        self.covariance = covariance - gain * covariance.row(0);
    }
}

/// Filters `frames` noisy measurements of a path; returns (output, measured) of each frame.
fn filtered(settings: FilterSettings, frames: i64, path: impl Fn(f64) -> Pose<Stage, Camera>) -> Track {
    let mut filter = PoseFilter::new(settings);
    let mut random = Pcg64::seed_from_u64(1);
    let mut normal = move || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
    let noise = Matrix6::identity() * SIGMA * SIGMA;
    let mut step = |k: i64| {
        let truth = path(stamp(k).seconds());
        let mut vector = || Vector3::new(normal(), normal(), normal()) * SIGMA;
        let measured = Pose::new(UnitQuaternion::from_scaled_axis(vector()) * truth.rotation, truth.translation + vector());
        (filter.measured(stamp(k), &measured, &noise), measured)
    };
    (0..frames).map(&mut step).collect()
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let squares: Vec<f64> = values.map(|v| v * v).collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

#[test]
fn filter_off_returns_measurements_bit_for_bit() {
    for (output, measured) in filtered(FilterSettings::default(), 10, |t| pose(Vector3::x() * t, Vector3::z() * t)) {
        assert_eq!(output, measured);
    }
}

#[test]
fn at_rest_the_filter_reduces_scatter_even_with_prediction() {
    let still = |_| pose(Vector3::new(1.0, -4.0, 1.6), Vector3::new(-1.5, 0.1, 0.0));
    for (settings, most) in [(kalman(0.0), 0.8), (one_euro(), 0.5), (kalman(0.033), 1.0)] {
        let track = filtered(settings, 300, still);
        let off = |p: &Pose<Stage, Camera>| (p.translation - still(0.0).translation).norm();
        let ratio = rms(track[60..].iter().map(|(t, _)| off(t))) / rms(track[60..].iter().map(|(_, m)| off(m)));
        assert!(ratio < most, "{settings:?}: {ratio}");
        let rotated = |p: &Pose<Stage, Camera>| p.angle_to(&still(0.0));
        let ratio = rms(track[60..].iter().map(|(t, _)| rotated(t))) / rms(track[60..].iter().map(|(_, m)| rotated(m)));
        assert!(ratio < most, "{settings:?}: {ratio}");
    }
}

#[test]
fn a_prediction_meets_uniform_motion() {
    let path = |t: f64| pose(Vector3::new(0.8 * t, 0.3 * t, 0.0), Vector3::new(0.0, 0.0, 0.7 * t));
    let ahead = 0.05;
    let track = filtered(kalman(ahead), 120, path);
    for (k, (output, measured)) in track.iter().enumerate().skip(30) {
        let truth = path(stamp(k as i64).seconds() + ahead);
        let (error, held) = ((output.translation - truth.translation).norm(), (measured.translation - truth.translation).norm());
        assert!(error < 0.05 * held, "{k}: {error} {held}");
        assert!(output.angle_to(&truth) < 0.05 * measured.angle_to(&truth), "{k}");
    }
}

#[test]
fn the_start_of_a_motion_is_followed_at_once() {
    let path = |t: f64| pose(Vector3::x() * (t - 2.0).max(0.0), Vector3::zeros());
    let track = filtered(kalman(0.0), 90, path);
    // 60 frames at rest, then 1 m/s: a lag of 33 mm per frame if it went unnoticed.
    for (output, measured) in &track[62..] {
        assert!((output.translation - measured.translation).norm() < 0.004, "{}", output.translation - measured.translation);
    }
}

#[test]
fn nothing_is_carried_across_a_loss_or_a_long_gap() {
    let noise = Matrix6::identity() * SIGMA * SIGMA;
    for settings in [kalman(0.03), one_euro()] {
        let mut filter = PoseFilter::new(settings);
        for k in 0..30 {
            filter.measured(stamp(k), &pose(Vector3::x() * k as f64, Vector3::zeros()), &noise);
        }
        let elsewhere = pose(Vector3::new(-7.0, 1.0, 0.0), Vector3::zeros());
        assert_eq!(filter.clone().measured(stamp(60), &elsewhere, &noise).translation, elsewhere.translation);
        filter.reset();
        assert!(filter.predicted(stamp(31)).is_none());
        assert_eq!(filter.measured(stamp(31), &elsewhere, &noise).translation, elsewhere.translation);
    }
}

#[test]
fn without_measurements_the_pose_continues_then_rests() {
    let noise = Matrix6::identity() * SIGMA * SIGMA;
    let mut filter = PoseFilter::new(kalman(0.0));
    for k in 0..60 {
        filter.measured(stamp(k), &pose(Vector3::x() * (k as f64 / 30.0), Vector3::zeros()), &noise);
    }
    let x = |ns: i64| filter.predicted(stamp(59).after_ns(ns)).expect("it is running").translation.x;
    assert!((x(10_000_000) - x(0) - 0.01).abs() < 0.001);
    assert!((x(5_000_000_000) - x(0) - 0.2).abs() < 0.01);
}

#[test]
fn invalid_covariances_do_no_harm() {
    let mut filter = PoseFilter::new(kalman(0.02));
    for (k, scale) in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e300, 1e-300].into_iter().cycle().take(40).enumerate() {
        let given = pose(Vector3::x() * 0.01 * k as f64, Vector3::zeros());
        let output = filter.measured(stamp(k as i64), &given, &(Matrix6::identity() * scale));
        assert!(output.is_finite(), "{k} {scale}: {output:?}");
    }
}
