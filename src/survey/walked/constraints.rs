//! Measurements that constrain the adjustment: lengths between points of surfaces, and positions of
//! such points in the stage frame.
//!
//! A camera cannot tell a stage from a smaller, nearer one, so without measurements `size_m` sets
//! the scale. With them the size is an unknown like any other. Each measurement is also tested
//! against all others by its deleted residual: its difference from the prediction without it, in
//! sigmas. Source: Cook and Weisberg, *Residuals and Influence in Regression* (1982), section 2.2.

use nalgebra::{DMatrix, DVector};

use super::stage_model::StageModel;
pub use crate::survey::measured::{Constraint, Measured};

/// Deleted residual, in sigmas, above which a measurement contradicts the rest: exceeded by one
/// correct length in ten thousand, and one correct position in a thousand. Raised, mistakes pass;
/// lowered, correct measurements are refused.
const CONTRADICTION: f64 = 4.0;

/// A measurement compared with the result.
#[derive(Debug, Clone, PartialEq)]
pub struct ConstraintCheck {
    /// The measurement.
    pub constraint: Constraint,
    /// Residual in the survey that includes it, metres; for a length with its sign (measured minus
    /// found).
    pub off_m: f64,
    /// Difference from its prediction by everything else, metres.
    pub off_from_others_m: f64,
    /// The same in sigmas.
    pub sigmas: f64,
}

/// One scalar of a measurement: its residual and its derivative by the unknowns.
#[derive(Debug, Clone, PartialEq)]
pub struct ConstraintRow {
    /// Measured minus modelled, metres.
    pub left: f64,
    /// Indices of unknowns, with the derivative of the modelled value by each.
    pub by_model: Vec<(usize, f64)>,
}

impl Constraint {
    /// Returns its scalars for a model: one for a length, three for a position.
    pub fn rows(&self, model: &StageModel) -> Vec<ConstraintRow> {
        match &self.measured {
            Measured::Distance { between, length_m } => {
                let [from, to] = between.each_ref().map(|point| model.point(point.surface, point.on_picture_m));
                let apart = to.place - from.place;
                let length = apart.norm();
                // Two coinciding points have no direction; their derivative is zero.
                let along = apart / length.max(f64::MIN_POSITIVE);
                let ends =
                    from.by_model.iter().map(|(k, d)| (*k, -along.dot(d))).chain(to.by_model.iter().map(|(k, d)| (*k, along.dot(d))));
                vec![ConstraintRow { left: length_m - length, by_model: ends.collect() }]
            }
            Measured::Place { of, position_m } => {
                let point = model.point(of.surface, of.on_picture_m);
                let row = |axis: usize| ConstraintRow {
                    left: position_m[axis] - point.place[axis],
                    by_model: point.by_model.iter().map(|(k, d)| (*k, d[axis])).collect(),
                };
                (0..3).map(row).collect()
            }
        }
    }

    /// Compares it with a model that includes it. `covariance` is that of the unknowns.
    fn check(&self, model: &StageModel, covariance: &DMatrix<f64>) -> Option<ConstraintCheck> {
        let rows = self.rows(model);
        let left = DVector::from_iterator(rows.len(), rows.iter().map(|row| row.left));
        let share = |a: &ConstraintRow, b: &ConstraintRow| -> f64 {
            a.by_model.iter().flat_map(|(i, x)| b.by_model.iter().map(move |(j, y)| x * y * covariance[(*i, *j)])).sum()
        };
        let explained = DMatrix::from_fn(rows.len(), rows.len(), |i, j| share(&rows[i], &rows[j]) / self.sigma_m.powi(2));
        // If nothing else constrains the value, nothing remains; rounding could make this negative.
        let room = DMatrix::identity(rows.len(), rows.len()) - explained;
        let without = room.lu().solve(&left)?;
        let sigmas = (left.dot(&without).max(0.0)).sqrt() / self.sigma_m;
        let (off_m, off_from_others_m) = match self.measured {
            Measured::Distance { .. } => (left[0], without[0]),
            Measured::Place { .. } => (left.norm(), without.norm()),
        };
        Some(ConstraintCheck { constraint: self.clone(), off_m, off_from_others_m, sigmas })
    }
}

impl ConstraintCheck {
    /// Whether everything else contradicts it.
    pub fn is_contradicted(&self) -> bool {
        self.sigmas > CONTRADICTION
    }

    /// Describes the contradiction in a clause.
    pub fn contradiction(&self) -> String {
        let name = &self.constraint.name;
        match &self.constraint.measured {
            Measured::Distance { length_m, .. } => format!(
                "{name} says {length_m:.4} m where the walk, size_m and the other measurements say {:.4} m ({:.0} sigmas): measure it again, and check \
                 which points it names",
                length_m - self.off_from_others_m,
                self.sigmas
            ),
            Measured::Place { .. } => format!(
                "{name} is {:.1} mm from where the walk, size_m and the other measurements put that point ({:.0} sigmas): measure it \
                 again, and check position_m of the first surface, or set the stage's origin with [stage] origin",
                1e3 * self.off_from_others_m,
                self.sigmas
            ),
        }
    }
}

/// Compares all measurements with a model that includes them.
pub fn check(constraints: &[Constraint], model: &StageModel, covariance: &DMatrix<f64>) -> Vec<ConstraintCheck> {
    constraints.iter().filter_map(|constraint| constraint.check(model, covariance)).collect()
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::camera::CameraModel;
    use crate::survey::measured::PicturePoint;
    use crate::survey::walked::synthetic::{LENS, stage};

    fn point(surface: usize, on_picture_m: [f64; 2]) -> PicturePoint {
        PicturePoint { surface, on_picture_m }
    }

    fn constraints() -> [Constraint; 4] {
        let named = |measured| Constraint { name: "test".to_owned(), measured, sigma_m: 0.002 };
        let distance = |from, to| named(Measured::Distance { between: [from, to], length_m: 2.0 });
        [
            distance(point(0, [-1.9, 1.4]), point(0, [1.8, -1.2])),
            distance(point(0, [-1.9, 1.4]), point(1, [0.2, -0.5])),
            named(Measured::Place { of: point(0, [2.0, 1.5]), position_m: Vector3::new(2.1, 1.4, 0.1) }),
            named(Measured::Place { of: point(1, [-0.3, 0.6]), position_m: Vector3::new(0.4, 0.2, 0.9) }),
        ]
    }

    #[test]
    fn derivatives_by_all_unknowns_agree_with_differences() {
        let flat = StageModel::new(CameraModel::new(LENS).unwrap(), &stage(), true, true);
        let bend = DVector::from_fn(flat.places().count, |k, _| 3e-3 * (k as f64).sin());
        let model = flat.stepped(&bend).unwrap();
        let h = 1e-6;
        for constraint in constraints() {
            let rows = constraint.rows(&model);
            for unknown in 0..model.places().count {
                let mut step = DVector::zeros(model.places().count);
                step[unknown] = h;
                let Some((plus, minus)) = model.stepped(&step).zip(model.stepped(&-step)) else { continue };
                let (plus, minus) = (constraint.rows(&plus), constraint.rows(&minus));
                for (k, row) in rows.iter().enumerate() {
                    let difference = -(plus[k].left - minus[k].left) / (2.0 * h);
                    let found: f64 = row.by_model.iter().filter(|(at, _)| *at == unknown).map(|(_, d)| d).sum();
                    assert!((difference - found).abs() < 1e-6, "{unknown} {k}: {difference} {found}");
                }
            }
        }
    }

    #[test]
    fn a_wrong_length_is_named_with_the_value_of_the_others() {
        // One unknown, the size of the stage, which size_m gives to one part in fifty.
        let model = StageModel::new(CameraModel::new(LENS).unwrap(), &stage(), false, true);
        let size = model.places().size.unwrap();
        let wide = |name: &str, length_m: f64, half: f64| Constraint {
            name: name.to_owned(),
            measured: Measured::Distance { between: [point(0, [-half, 0.0]), point(0, [half, 0.0])], length_m },
            sigma_m: 0.002,
        };
        let all = [wide("a", 4.04, 2.0), wide("b", 3.03, 1.5), wide("c", 2.10, 1.0)];
        let (mut information, mut right) = (0.02_f64.powi(-2), 0.0);
        for constraint in &all {
            for row in constraint.rows(&model) {
                let by_size: f64 = row.by_model.iter().filter(|(at, _)| *at == size).map(|(_, d)| d).sum();
                information += (by_size / constraint.sigma_m).powi(2);
                right += by_size * row.left / constraint.sigma_m.powi(2);
            }
        }
        let n = model.places().count;
        let mut step = DVector::zeros(n);
        step[size] = right / information;
        let mut covariance = DMatrix::zeros(n, n);
        covariance[(size, size)] = 1.0 / information;
        let checks = check(&all, &model.stepped(&step).unwrap(), &covariance);
        let worst = checks.iter().max_by(|a, b| a.sigmas.total_cmp(&b.sigmas)).unwrap();
        assert_eq!(worst.constraint.name, "c");
        assert!(worst.is_contradicted());
        // The other two say that the stage is larger by a hundredth, and size_m hardly contradicts
        // them.
        assert!((worst.off_from_others_m - 0.08).abs() < 2e-4, "{worst:?}");
        assert!(
            worst.contradiction().contains("2.1000 m where the walk, size_m and the other measurements say 2.02"),
            "{}",
            worst.contradiction()
        );
    }
}
