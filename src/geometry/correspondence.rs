//! What solvers and distances need of a correspondence: its position in either picture.

use nalgebra::Vector2;

use super::homography::PointPair;
use super::relative_pose::RayPair;

/// Maximum usable coordinate of a correspondence. No picture comes near it; raised, products of
/// eighth order overflow.
const LARGEST: f64 = 1e12;

/// A point seen in two pictures.
pub trait Correspondence {
    /// Position in the first picture.
    fn first(&self) -> Vector2<f64>;

    /// Position in the second picture.
    fn second(&self) -> Vector2<f64>;

    /// Whether it can be used: all coordinates are finite and not absurdly large.
    fn is_usable(&self) -> bool {
        self.first().iter().chain(self.second().iter()).all(|v| v.abs() <= LARGEST)
    }
}

impl Correspondence for PointPair {
    fn first(&self) -> Vector2<f64> {
        self.from
    }

    fn second(&self) -> Vector2<f64> {
        self.to
    }
}

impl Correspondence for RayPair {
    fn first(&self) -> Vector2<f64> {
        self.first
    }

    fn second(&self) -> Vector2<f64> {
        self.second
    }
}

impl<C: Correspondence> Correspondence for &C {
    fn first(&self) -> Vector2<f64> {
        (*self).first()
    }

    fn second(&self) -> Vector2<f64> {
        (*self).second()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_with_invalid_numbers_are_unusable() {
        let pair = |x: f64| PointPair { from: Vector2::new(x, 1.0), to: Vector2::new(1.0, 1.0) };
        assert!(pair(-1e6).is_usable());
        assert!([f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e200].iter().all(|&x| !pair(x).is_usable()));
        let ray = RayPair { first: Vector2::zeros(), second: Vector2::new(0.0, f64::NAN) };
        assert!(!ray.is_usable());
    }
}
