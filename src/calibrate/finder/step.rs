//! The damped Newton step of the corner fit: seven equations, solved in place.

use super::window::{Linearised, N};

/// Returns the step to subtract from the model, with `damping` on the diagonal; parameter `held`
/// stays fixed. `None` if the equations have no solution.
pub(super) fn damped(linearised: &Linearised, damping: f64, held: Option<usize>) -> Option<[f64; N]> {
    let mut a = linearised.normal;
    let mut step = linearised.gradient;
    for (k, row) in a.iter_mut().enumerate() {
        row[k] += damping * row[k] + 1e-9;
    }
    if let Some(k) = held {
        a[k] = [0.0; N];
        a.iter_mut().for_each(|row| row[k] = 0.0);
        (a[k][k], step[k]) = (1.0, 0.0);
    }
    // L D Lᵀ, with the forward substitution through L on the way.
    let (mut inverse, mut lower) = ([0.0; N], [[0.0; N]; N]);
    for c in 0..N {
        let column = a[c];
        if column[c].is_nan() || column[c] <= 0.0 {
            return None;
        }
        inverse[c] = 1.0 / column[c];
        for r in c + 1..N {
            let share = column[r] * inverse[c];
            lower[r][c] = share;
            step[r] -= share * step[c];
            // Whole rows: the part left of the diagonal is not used again.
            for k in 0..N {
                a[r][k] -= share * column[k];
            }
        }
    }
    for c in (0..N).rev() {
        step[c] *= inverse[c];
        for r in c + 1..N {
            step[c] -= lower[r][c] * step[r];
        }
    }
    Some(step)
}

#[cfg(test)]
mod tests {
    use nalgebra::{SMatrix, SVector};
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn it_solves_the_damped_equations(
            rows in proptest::collection::vec(-1.0..1.0_f64, 9 * N),
            right in proptest::collection::vec(-1.0..1.0_f64, N),
            damping in 1e-4..1.0_f64,
            held in proptest::option::of(0..N),
        ) {
            let rows = SMatrix::<f64, 9, N>::from_iterator(rows);
            let (normal, gradient) = (rows.transpose() * rows, SVector::<f64, N>::from_iterator(right));
            let step = damped(&Linearised { cost: 1.0, normal: normal.data.0, gradient: gradient.into(), weight: 1.0 }, damping, held);
            let step = SVector::from(step.expect("the damped matrix is positive definite"));
            let left = normal * step + (normal.diagonal() * damping).component_mul(&step);
            for k in 0..N {
                if held == Some(k) {
                    prop_assert_eq!(step[k], 0.0);
                } else {
                    prop_assert!((left[k] - gradient[k]).abs() < 1e-4, "{} is not {}", left[k], gradient[k]);
                }
            }
        }
    }

    #[test]
    fn unsolvable_damped_equations_return_none() {
        let mut normal = [[0.0; N]; N];
        normal[3][3] = -1.0;
        assert!(damped(&Linearised { cost: 1.0, normal, gradient: [1.0; N], weight: 1.0 }, 0.1, None).is_none());
        normal[3][3] = f64::NAN;
        assert!(damped(&Linearised { cost: 1.0, normal, gradient: [1.0; N], weight: 1.0 }, 0.1, None).is_none());
    }
}
