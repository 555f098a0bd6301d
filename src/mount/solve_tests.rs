//! The mount's solver on data with known truth: exact, noisy, with outliers, and insufficient.

use nalgebra::{Matrix6, SVector, UnitQuaternion, Vector3, Vector6};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::residual::Unknowns;
use super::solve::{Unsolvable, solve};
use super::views::{Stages, View, ViewPair};
use crate::geometry::{Camera, FilmingCamera, Pose, Stage};

fn random_vector(random: &mut Pcg64Mcg, size: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| random.random_range(-size..=size))
}

fn random_pose<A, B>(random: &mut Pcg64Mcg, shift: f64, rotation: f64) -> Pose<A, B> {
    Pose::new(UnitQuaternion::from_scaled_axis(random_vector(random, rotation)), random_vector(random, shift))
}

/// 0.4 m and 25 degrees apart, as on a typical rig.
fn mount(random: &mut Pcg64Mcg) -> Pose<Camera, FilmingCamera> {
    let along = |random: &mut Pcg64Mcg| random_vector(random, 1.0).normalize();
    Pose::new(UnitQuaternion::from_scaled_axis(along(random) * 25.0_f64.to_radians()), along(random) * 0.4)
}

/// Millimetres in position and tenths of a degree in angle, correlated as in front of a flat
/// picture, where a sideways step looks like a rotation.
fn covariance(random: &mut Pcg64Mcg) -> Matrix6<f64> {
    let root = Matrix6::from_fn(|row, column| {
        let unit = if row < 3 { 2e-3 } else { 8e-4 };
        unit * (f64::from(u8::from(row == column)) + random.random_range(-0.6..0.6))
    });
    root * root.transpose()
}

fn noisy(truth: &Pose<Stage, Camera>, covariance: Matrix6<f64>, random: &mut Pcg64Mcg) -> View {
    // The sum of twelve uniform numbers is normal to good approximation.
    let normal = Vector6::from_fn(|_, _| (0..12).map(|_| random.random_range(-0.5..0.5)).sum::<f64>());
    let step = covariance.cholesky().expect("positive definite").l() * normal;
    let rotation = UnitQuaternion::from_scaled_axis(-Vector3::new(step[3], step[4], step[5]));
    View { pose: Pose::new(rotation * truth.rotation, truth.translation - Vector3::new(step[0], step[1], step[2])), covariance }
}

/// Views of a rig that rotates by up to `rotation` about all axes; the filming camera's stage is
/// `between` away.
fn views(
    n: usize,
    mount: &Pose<Camera, FilmingCamera>,
    between: &Pose<Stage, Stage>,
    noise: f64,
    rotation: Vector3<f64>,
    random: &mut Pcg64Mcg,
) -> Vec<ViewPair> {
    let ahead = UnitQuaternion::from_scaled_axis(Vector3::new(-std::f64::consts::FRAC_PI_2, 0.0, 0.0));
    let pair = |_| {
        let place = Vector3::new(0.0, -4.0, 0.0) + random_vector(random, 1.0);
        let rotated = UnitQuaternion::from_scaled_axis(random_vector(random, 1.0).component_mul(&rotation));
        let tracking = Pose::<Stage, Camera>::new(ahead * rotated, place);
        let filming: Pose<Stage, Camera> = (between.inverse() * tracking * *mount).renamed();
        let covariances = [covariance(random) * (noise * noise), covariance(random) * (noise * noise)];
        if noise == 0.0 {
            let exact = |pose| View { pose, covariance: Matrix6::identity() * 1e-6 };
            return ViewPair { tracking: exact(tracking), filming: exact(filming) };
        }
        ViewPair { tracking: noisy(&tracking, covariances[0], random), filming: noisy(&filming, covariances[1], random) }
    };
    (0..n).map(pair).collect()
}

fn error(found: &Pose<Camera, FilmingCamera>, truth: &Pose<Camera, FilmingCamera>) -> Vector6<f64> {
    let shift = truth.translation - found.translation;
    let rotation = (truth.rotation * found.rotation.inverse()).scaled_axis();
    Vector6::new(shift.x, shift.y, shift.z, rotation.x, rotation.y, rotation.z)
}

const ALL_WAYS: Vector3<f64> = Vector3::new(0.5, 0.6, 0.4);

#[test]
fn exact_views_give_the_exact_mount() {
    let mut random = Pcg64Mcg::seed_from_u64(1);
    for n in [1, 2, 6] {
        let truth = mount(&mut random);
        let pairs = views(n, &truth, &Pose::identity(), 0.0, ALL_WAYS, &mut random);
        let found = solve(&pairs, Stages::Shared).unwrap();
        assert!(error(&found.mount, &truth).norm() < 1e-9 && found.excess == 1.0);
    }
    for n in [3, 4, 8] {
        let (truth, between) = (mount(&mut random), random_pose(&mut random, 2.0, 1.5));
        let pairs = views(n, &truth, &between, 0.0, ALL_WAYS, &mut random);
        let found = solve(&pairs, Stages::Apart).unwrap();
        assert!(error(&found.mount, &truth).norm() < 1e-8, "{n}: {}", error(&found.mount, &truth));
        assert!((found.between.translation - between.translation).norm() < 1e-8 && found.between.angle_to(&between) < 1e-7);
    }
}

#[test]
fn the_mount_jacobian_agrees_with_differences() {
    let mut random = Pcg64Mcg::seed_from_u64(2);
    let (truth, between) = (mount(&mut random), random_pose(&mut random, 2.0, 1.5));
    let pair = views(1, &truth, &between, 0.0, ALL_WAYS, &mut random)[0];
    let at = Unknowns { mount: truth, between };
    let (_, jacobian) = at.residual(&pair);
    for k in 0..12 {
        let residual = |size: f64| {
            let mut step = SVector::<f64, 12>::zeros();
            step[k] = size;
            let mut moved = at;
            moved.step(&step);
            moved.residual(&pair).0
        };
        // The residual moves opposite to the prediction.
        let by_difference = (residual(-1e-5) - residual(1e-5)) / 2e-5;
        assert!((by_difference - jacobian.column(k)).norm() < 1e-8, "{k}: {by_difference} {}", jacobian.column(k));
    }
}

/// Returns the mean NEES over six degrees of freedom: 1 if the covariance is correct.
fn nees(n: usize, stages: Stages, trials: u64) -> f64 {
    let mut sum = 0.0;
    for trial in 0..trials {
        let mut random = Pcg64Mcg::seed_from_u64(100 + trial);
        let truth = mount(&mut random);
        let between = if stages == Stages::Shared { Pose::identity() } else { random_pose(&mut random, 2.0, 1.5) };
        let found = solve(&views(n, &truth, &between, 0.3, ALL_WAYS, &mut random), stages).unwrap();
        let e = error(&found.mount, &truth);
        sum += e.dot(&(found.covariance.try_inverse().unwrap() * e)) / 6.0;
    }
    sum / trials as f64
}

#[test]
fn the_mount_covariance_matches_its_errors() {
    // The mean of 300 trials with 6 degrees of freedom each scatters by 0.033; the excess, which is
    // never below 1, is conservative.
    for (n, stages) in [(1, Stages::Shared), (2, Stages::Shared), (6, Stages::Shared), (4, Stages::Apart), (8, Stages::Apart)] {
        let nees = nees(n, stages, 300);
        assert!((0.7..1.2).contains(&nees), "{n} views, {stages:?}: {nees}");
    }
}

#[test]
fn overconfident_view_covariances_are_scaled_up() {
    let mut sum = 0.0;
    for trial in 0..200 {
        let mut random = Pcg64Mcg::seed_from_u64(900 + trial);
        let truth = mount(&mut random);
        let mut pairs = views(6, &truth, &Pose::identity(), 0.9, ALL_WAYS, &mut random);
        for pair in &mut pairs {
            pair.tracking.covariance /= 9.0;
            pair.filming.covariance /= 9.0;
        }
        let found = solve(&pairs, Stages::Shared).unwrap();
        assert!(found.excess > 1.5, "{}", found.excess);
        let e = error(&found.mount, &truth);
        sum += e.dot(&(found.covariance.try_inverse().unwrap() * e)) / 6.0;
    }
    assert!(sum / 200.0 < 1.6, "{}", sum / 200.0);
}

#[test]
fn a_contradicting_view_is_rejected_and_named() {
    for (n, stages) in [(6, Stages::Shared), (8, Stages::Apart)] {
        for trial in 0..40 {
            let mut random = Pcg64Mcg::seed_from_u64(500 + trial);
            let truth = mount(&mut random);
            let between = if stages == Stages::Shared { Pose::identity() } else { random_pose(&mut random, 2.0, 1.5) };
            let mut pairs = views(n, &truth, &between, 0.3, ALL_WAYS, &mut random);
            // The rig was moved between the two pictures.
            let wrong = random.random_range(0..n);
            let bumped = random_pose::<Stage, Stage>(&mut random, 0.1, 0.1);
            pairs[wrong].filming.pose = bumped * pairs[wrong].filming.pose;
            let found = solve(&pairs, stages).unwrap();
            let left_out: Vec<usize> = (0..n).filter(|k| !found.views[*k].is_used).collect();
            assert_eq!(left_out, [wrong], "trial {trial}, {stages:?}");
            let e = error(&found.mount, &truth);
            assert!(e.dot(&(found.covariance.try_inverse().unwrap() * e)) < 40.0, "trial {trial}, {stages:?}");
        }
    }
}

#[test]
fn separate_boards_need_rotations_about_two_axes() {
    let mut random = Pcg64Mcg::seed_from_u64(7);
    let (truth, between) = (mount(&mut random), random_pose(&mut random, 2.0, 1.5));
    for noise in [0.0, 0.3] {
        let panned = views(8, &truth, &between, noise, Vector3::new(0.0, 0.7, 0.0), &mut random);
        match solve(&panned, Stages::Apart) {
            Err(Unsolvable::OneAxis { axis, .. }) => assert!(axis.y.abs() > 0.999, "{axis}"),
            other => panic!("noise {noise}: {other:?}"),
        }
        let still = views(8, &truth, &between, noise, Vector3::zeros(), &mut random);
        assert!(matches!(solve(&still, Stages::Apart), Err(Unsolvable::NotRotated { .. })));
        // With a shared stage, one view is enough.
        assert!(solve(&views(1, &truth, &Pose::identity(), noise, Vector3::zeros(), &mut random), Stages::Shared).is_ok());
    }
    let two = views(2, &truth, &between, 0.0, ALL_WAYS, &mut random);
    assert_eq!(solve(&two, Stages::Apart), Err(Unsolvable::TooFew { found: 2, wanted: 3 }));
    assert_eq!(solve(&[], Stages::Shared), Err(Unsolvable::TooFew { found: 0, wanted: 1 }));
}

#[test]
fn invalid_numbers_are_refused() {
    let mut random = Pcg64Mcg::seed_from_u64(8);
    let truth = mount(&mut random);
    let mut pairs = views(3, &truth, &Pose::identity(), 0.3, ALL_WAYS, &mut random);
    pairs[1].filming.covariance[(0, 0)] = f64::NAN;
    assert_eq!(solve(&pairs, Stages::Shared), Err(Unsolvable::NoSolution));
}
