//! Catmull-Rom interpolation: a cubic through its four neighbours (Catmull and Rom 1974).

use nalgebra::{RealField, convert};

/// Returns the weights of four neighbours, evenly spaced, for a point between the middle two, at
/// `t` from 0 to 1.
pub fn weights<T: RealField + Copy>(t: T) -> [T; 4] {
    let n = |value: f64| -> T { convert(value) };
    [
        ((n(-0.5) * t + n(1.0)) * t - n(0.5)) * t,
        (n(1.5) * t - n(2.5)) * t * t + n(1.0),
        ((n(-1.5) * t + n(2.0)) * t + n(0.5)) * t,
        (n(0.5) * t - n(0.5)) * t * t,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quadratics_are_interpolated_exactly() {
        let curve = |x: f64| 3.0 - 2.0 * x + 0.7 * x * x;
        for k in 0..=10 {
            let t = 0.1 * f64::from(k);
            let found: f64 = weights(t).iter().zip([-1.0, 0.0, 1.0, 2.0]).map(|(w, x)| w * curve(x)).sum();
            assert!((found - curve(t)).abs() < 1e-12, "{t}: {found}");
            assert!(weights(t as f32).iter().zip(weights(t)).all(|(single, double)| (f64::from(*single) - double).abs() < 1e-6));
        }
    }
}
