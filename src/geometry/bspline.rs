//! Uniform bicubic B-splines over a rectangle: smooth fields with few parameters.
//!
//! A field is a sum of bumps, one per coefficient, each four intervals wide. It has continuous
//! second derivatives, and each value depends on only sixteen coefficients.
//!
//! Source: de Boor, *A Practical Guide to Splines* (1978), chapter IX; here with uniform knots.

use nalgebra::SVector;

/// Number of coefficients along each axis that a point depends on; fixed by the cubic degree.
pub const SUPPORT: usize = 4;

/// A grid of coefficients over a rectangle, `N` values each.
#[derive(Debug, Clone, PartialEq)]
pub struct BicubicSpline<const N: usize> {
    /// Number of knot intervals, across and up.
    intervals: [usize; 2],
    /// Size of the rectangle, which is centred at the origin.
    size: [f64; 2],
    /// Row by row, from the lower left: intervals + 3 along each axis.
    coefficients: Vec<SVector<f64, N>>,
}

/// A field and its derivatives at a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SplineValue<const N: usize> {
    /// The field.
    pub value: SVector<f64, N>,
    /// Its derivative along x.
    pub by_x: SVector<f64, N>,
    /// Its derivative along y.
    pub by_y: SVector<f64, N>,
}

/// The sixteen coefficients that a point depends on, and their weights.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Support {
    /// Index of the first one; the others follow along x, row by row.
    first: usize,
    stride: usize,
    across: Basis,
    up: Basis,
}

/// The four basis functions at a position between two knots.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Basis {
    weights: [f64; SUPPORT],
    /// Derivatives by the coordinate, not by the fraction of the interval.
    slopes: [f64; SUPPORT],
}

impl Basis {
    /// Evaluates the basis at `t`, 0 to 1, within an interval. `per_unit`: intervals per unit of
    /// length.
    fn at(t: f64, per_unit: f64) -> Self {
        let s = 1.0 - t;
        let (t2, s2) = (t * t, s * s);
        Self {
            weights: [s2 * s / 6.0, (3.0 * t2 * t - 6.0 * t2 + 4.0) / 6.0, (3.0 * s2 * s - 6.0 * s2 + 4.0) / 6.0, t2 * t / 6.0],
            slopes: [-0.5 * s2, 1.5 * t2 - 2.0 * t, 2.0 * s - 1.5 * s2, 0.5 * t2].map(|slope| slope * per_unit),
        }
    }
}

impl Support {
    /// Returns index and weight of each coefficient.
    pub fn weights(&self) -> [(usize, f64); SUPPORT * SUPPORT] {
        std::array::from_fn(|k| {
            let (i, j) = (k % SUPPORT, k / SUPPORT);
            (self.first + j * self.stride + i, self.across.weights[i] * self.up.weights[j])
        })
    }
}

impl<const N: usize> BicubicSpline<N> {
    /// Creates a field that is zero everywhere, with at least one interval along each axis.
    pub fn zero(intervals: [usize; 2], size: [f64; 2]) -> Self {
        let intervals = intervals.map(|n| n.max(1));
        let coefficients = vec![SVector::zeros(); (intervals[0] + 3) * (intervals[1] + 3)];
        Self { intervals, size, coefficients }
    }

    /// Creates a field from coefficients; `None` if their number does not match the grid or any
    /// value is invalid.
    pub fn from_coefficients(intervals: [usize; 2], size: [f64; 2], coefficients: Vec<SVector<f64, N>>) -> Option<Self> {
        let fits = intervals.iter().all(|n| *n >= 1)
            && coefficients.len() == (intervals[0] + 3) * (intervals[1] + 3)
            && size.iter().all(|side| side.is_finite() && *side > 0.0)
            && coefficients.iter().flatten().all(|v| v.is_finite());
        fits.then_some(Self { intervals, size, coefficients })
    }

    /// Returns the number of intervals, across and up.
    pub fn intervals(&self) -> [usize; 2] {
        self.intervals
    }

    /// Returns the distance between knots, across and up.
    pub fn spacing(&self) -> [f64; 2] {
        [0, 1].map(|axis| self.size[axis] / self.intervals[axis] as f64)
    }

    /// Returns the number of coefficients, across and up.
    pub fn columns_and_rows(&self) -> [usize; 2] {
        self.intervals.map(|n| n + 3)
    }

    /// Returns the coefficients, row by row from the lower left.
    pub fn coefficients(&self) -> &[SVector<f64, N>] {
        &self.coefficients
    }

    /// Like [`coefficients`](Self::coefficients), mutable.
    pub fn coefficients_mut(&mut self) -> &mut [SVector<f64, N>] {
        &mut self.coefficients
    }

    /// Returns a function from a coefficient's index to the centre of its basis function.
    /// Coefficients set to a plane's values at these centres reproduce the plane.
    pub fn middles(&self) -> impl Fn(usize) -> [f64; 2] + use<N> {
        let (columns, spacing, intervals) = (self.columns_and_rows()[0], self.spacing(), self.intervals());
        move |n| {
            let place = |index: usize, axis: usize| (index as f64 - 1.0 - 0.5 * intervals[axis] as f64) * spacing[axis];
            [place(n % columns, 0), place(n / columns, 1)]
        }
    }

    /// Returns the coefficients that a point depends on; points outside are clamped to the
    /// rectangle.
    pub fn support(&self, [x, y]: [f64; 2]) -> Support {
        let place = |v: f64, axis: usize| {
            let n = self.intervals[axis] as f64;
            let per_unit = n / self.size[axis];
            // `clamp` keeps NaN; as an index it becomes 0.
            let at = (v * per_unit + 0.5 * n).clamp(0.0, n);
            let interval = (at as usize).min(self.intervals[axis] - 1);
            (interval, Basis::at(at - interval as f64, per_unit))
        };
        let ((column, across), (row, up)) = (place(x, 0), place(y, 1));
        let stride = self.intervals[0] + 3;
        Support { first: row * stride + column, stride, across, up }
    }

    /// Evaluates the field at a point.
    pub fn at(&self, point: [f64; 2]) -> SplineValue<N> {
        let Support { first, stride, across, up } = self.support(point);
        let mut out = SplineValue { value: SVector::zeros(), by_x: SVector::zeros(), by_y: SVector::zeros() };
        for j in 0..SUPPORT {
            let row = &self.coefficients[first + j * stride..][..SUPPORT];
            let (mut value, mut by_x) = (SVector::<f64, N>::zeros(), SVector::<f64, N>::zeros());
            for ((c, weight), slope) in row.iter().zip(across.weights).zip(across.slopes) {
                value += c * weight;
                by_x += c * slope;
            }
            out.value += value * up.weights[j];
            out.by_x += by_x * up.weights[j];
            out.by_y += value * up.slopes[j];
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    fn random_field(seed: u64) -> BicubicSpline<2> {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let mut field = BicubicSpline::zero([5, 3], [4.0, 3.0]);
        for c in field.coefficients_mut() {
            *c = Vector2::new(random.random_range(-1.0..1.0), random.random_range(-1.0..1.0));
        }
        field
    }

    #[test]
    fn coefficients_that_lie_on_a_plane_make_that_plane() {
        let mut field = BicubicSpline::<1>::zero([6, 4], [4.0, 3.0]);
        let middles = field.middles();
        for (k, c) in field.coefficients_mut().iter_mut().enumerate() {
            let [x, y] = middles(k);
            c.x = 0.3 + 0.2 * x - 0.1 * y;
        }
        for (x, y) in [(-2.0, -1.5), (0.13, 0.7), (1.99, 1.5), (0.0, 0.0)] {
            let found = field.at([x, y]);
            assert!((found.value.x - (0.3 + 0.2 * x - 0.1 * y)).abs() < 1e-12);
            assert!((found.by_x.x - 0.2).abs() < 1e-12 && (found.by_y.x + 0.1).abs() < 1e-12);
        }
    }

    #[test]
    fn spline_derivatives_agree_with_differences_across_knots() {
        let field = random_field(1);
        let h = 1e-6;
        for (x, y) in [(0.31, -0.4), (-1.99, 1.2), (0.8, 0.0), (1.2 - 1e-9, 0.5)] {
            let found = field.at([x, y]);
            let by_x = (field.at([x + h, y]).value - field.at([x - h, y]).value) / (2.0 * h);
            let by_y = (field.at([x, y + h]).value - field.at([x, y - h]).value) / (2.0 * h);
            assert!((found.by_x - by_x).norm() < 1e-6 && (found.by_y - by_y).norm() < 1e-6, "{x} {y}");
        }
    }

    #[test]
    fn support_weights_reproduce_the_value() {
        let field = random_field(2);
        for point in [[0.2, 0.3], [2.0, 1.5], [-2.0, -1.5], [9.0, -9.0], [f64::NAN, 0.0]] {
            let by_support = field.support(point).weights().into_iter().map(|(k, w)| field.coefficients()[k] * w).sum::<Vector2<f64>>();
            assert!((by_support - field.at(point).value).norm() < 1e-12 || point[0].is_nan());
            assert!(field.support(point).weights().iter().all(|(k, _)| *k < field.coefficients().len()));
        }
    }

    #[test]
    fn a_grid_of_another_size_is_refused() {
        let field = random_field(3);
        assert_eq!(BicubicSpline::from_coefficients([5, 3], [4.0, 3.0], field.coefficients().to_vec()), Some(field.clone()));
        assert_eq!(BicubicSpline::from_coefficients([4, 3], [4.0, 3.0], field.coefficients().to_vec()), None);
        assert_eq!(BicubicSpline::from_coefficients([5, 3], [4.0, 0.0], field.coefficients().to_vec()), None);
    }
}
