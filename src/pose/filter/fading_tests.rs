use nalgebra::{Complex, Matrix2, Matrix3, Vector2, Vector3};

use super::super::tests::WhiteAcceleration;
use super::*;

const UNKNOWN: Unknown = Unknown { velocity: 0.5, acceleration: 30.0 };

/// The propagation of a state error through one step, (I - K H) F, measured from the filter's
/// behaviour: with zero measurements, the update is linear in the state. In units of the step, so
/// that the entries are comparable.
fn error_transition(filter: &Fading<Vector3<f64>>, step_s: f64, memory_s: f64, sigma: f64) -> Matrix3<f64> {
    let units = [1.0, step_s.recip(), step_s.powi(-2)];
    Matrix3::from_fn(|row, column| {
        let mut moved = filter.clone();
        moved.place = Vector3::x() * if column == 0 { 1.0 } else { 0.0 };
        moved.velocity = Vector3::x() * if column == 1 { units[1] } else { 0.0 };
        moved.acceleration = Vector3::x() * if column == 2 { units[2] } else { 0.0 };
        moved.update(step_s, memory_s, &Vector3::zeros(), sigma * sigma);
        [moved.place.x, moved.velocity.x / units[1], moved.acceleration.x / units[2]][row]
    })
}

fn eigenvalues(m: &Matrix3<f64>) -> Vec<Complex<f64>> {
    m.complex_eigenvalues().iter().copied().collect()
}

/// A triple eigenvalue comes out as three, separated by a root of the rounding error.
const ROUNDING: f64 = 0.01;

/// Whether an error oscillates while decaying: it does not if all eigenvalues are real and
/// positive.
fn swings(eigenvalues: &[Complex<f64>]) -> bool {
    eigenvalues.iter().any(|value| value.re < -ROUNDING || value.im.abs() > ROUNDING)
}

#[test]
fn no_steady_state_rings_or_alternates() {
    for rate in [5.0, 12.5, 24.0, 30.0, 60.0, 120.0, 240.0] {
        let step_s = 1.0 / rate;
        for sigma in [1e-6, 1e-5, 1e-4, 1e-3, 1e-2] {
            for memory_s in [0.0005, 0.002, 0.008, 0.03, 0.125, 0.5] {
                let mut filter = Fading::at_rest(Vector3::zeros(), sigma * sigma, &UNKNOWN);
                for _ in 0..(30.0 * memory_s / step_s) as usize + 30 {
                    filter.update(step_s, memory_s, &Vector3::zeros(), sigma * sigma);
                }
                let kept = (-step_s / memory_s).exp().max(MIN_KEPT);
                let found = eigenvalues(&error_transition(&filter, step_s, memory_s, sigma));
                assert!(!swings(&found), "{rate} Hz, {sigma}, {memory_s}: {found:?}");
                for value in found {
                    let off = (value - Complex::new(kept, 0.0)).norm();
                    assert!(off < ROUNDING, "{rate} Hz, {sigma}, {memory_s}: {value} is not {kept}");
                }
            }
        }
    }
}

#[test]
fn an_oscillating_filter_is_recognised_by_its_eigenvalues() {
    for rate in [5.0, 30.0, 60.0] {
        let (step_s, sigma) = (1.0 / rate, 1e-6);
        let mut filter = WhiteAcceleration::at_rest(UNKNOWN.acceleration);
        (0..100).for_each(|_| filter.update(step_s, 0.0, sigma * sigma));
        let column = |state: Vector2<f64>| {
            let mut moved = filter.clone();
            moved.state = state;
            moved.update(step_s, 0.0, sigma * sigma);
            Vector2::new(moved.state.x, moved.state.y * step_s)
        };
        let transition = Matrix2::from_columns(&[column(Vector2::x()), column(Vector2::y() / step_s)]);
        let found: Vec<Complex<f64>> = transition.complex_eigenvalues().iter().copied().collect();
        assert!(swings(&found) && found.iter().any(|value| value.re < -0.9), "{rate} Hz: {found:?}");
    }
}

/// Irregular intervals, dropped frames and changing noise: the propagation of the initial error is
/// a positive number times a matrix of known form, never a power of something that rotates.
#[test]
fn errors_decay_at_any_interval_and_noise() {
    let mut random = (1u64..).map(|k| (k.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40) as f64 / (1u64 << 24) as f64);
    let mut next = || random.next().expect("an endless row");
    for memory_s in [0.002, 0.03, 0.125, 0.5] {
        let mut filter = Fading::at_rest(Vector3::zeros(), 1e-8, &UNKNOWN);
        let mut product = Matrix3::identity();
        let (mut kept, mut seconds) = (1.0, 0.0);
        let begun = filter.information;
        for _ in 0..40 {
            let step_s = (0.004 + 0.2 * next().powi(3)) * if next() < 0.2 { 2.0 } else { 1.0 };
            let sigma = 10f64.powf(-6.0 + 4.0 * next());
            let before = filter.clone();
            filter.update(step_s, memory_s, &Vector3::zeros(), sigma * sigma);
            let units = Matrix3::from_diagonal(&Vector3::new(1.0, step_s.recip(), step_s.powi(-2)));
            let inverse = Matrix3::from_diagonal(&units.diagonal().map(f64::recip));
            product = units * error_transition(&before, step_s, memory_s, sigma) * inverse * product;
            kept *= (-step_s / memory_s).exp().max(MIN_KEPT);
            seconds += step_s;
            let expected = filter.information.try_inverse().expect("positive") * carry(-seconds).transpose() * begun * kept;
            assert!((product - expected).norm() <= 1e-6 * expected.norm() + 1e-9, "{memory_s}: {product} {expected}");
        }
    }
}

#[test]
fn a_parabola_is_followed_without_delay() {
    let at = |t: f64| Vector3::new(0.3 * t + 0.2 * t * t, -t, 0.5 * t * t);
    let mut filter = Fading::at_rest(at(0.0), 1e-8, &UNKNOWN);
    let mut t = 0.0;
    for k in 0..200 {
        let step_s = [0.02, 0.033, 0.01][k % 3];
        t += step_s;
        filter.update(step_s, 0.1, &at(t), 1e-8);
    }
    assert!((filter.place - at(t)).norm() < 1e-9 && (filter.acceleration - Vector3::new(0.4, 0.0, 1.0)).norm() < 1e-5);
}
