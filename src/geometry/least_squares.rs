//! Nonlinear least squares by Levenberg-Marquardt (Marquardt 1963): one loop for all problems of
//! this crate.
//!
//! A [`Problem`] computes its cost, linearises itself and takes damped steps. [`minimise`] accepts
//! or rejects steps, adapts the damping, and decides when to stop.

use std::ops::ControlFlow;

/// A problem to minimise.
pub trait Problem {
    /// The estimated parameters.
    type State;
    /// The normal equations at a state.
    type Normal;

    /// Returns the cost at a state.
    fn cost(&self, state: &Self::State) -> f64;

    /// Returns the normal equations at a state.
    fn linearised(&self, state: &Self::State) -> Self::Normal;

    /// Returns the state after a step with this damping; `None` if the damped equations are
    /// singular.
    fn stepped(&self, state: &Self::State, normal: &Self::Normal, damping: f64) -> Option<Self::State>;

    /// Called after each accepted step. Returns the cost, which may have changed (a re-estimated
    /// scale), or breaks when nothing more can be gained.
    fn taken(&mut self, before: &Self::State, state: &Self::State, cost: f64) -> ControlFlow<f64, f64> {
        let _ = (before, state);
        ControlFlow::Continue(cost)
    }
}

/// Stopping criteria and damping.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Maximum number of steps, accepted or not.
    pub iterations: usize,
    /// Initial damping and its limits.
    pub damping: Damping,
    /// Relative cost decrease below which a step is the last.
    pub least_gain: f64,
}

/// [`Options::least_gain`] of a robust fit to pairs. With N pairs the cost is about N noise
/// variances, so with 500 pairs further steps gain a hundredth of a standard deviation of the
/// model. Raised, the fit is less accurate than the pairs allow; lowered, frames cost more: steps
/// converge slowly where robust weights change much.
pub const MIN_GAIN_OF_PAIRS: f64 = 1e-7;

/// Damping of a step, as a fraction of the normal matrix's diagonal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Damping {
    /// Current value.
    pub now: f64,
    /// Minimum.
    pub least: f64,
    /// Maximum; beyond it, the minimiser gives up.
    pub most: f64,
}

impl Damping {
    /// Lowers the damping after a step that lowered the cost.
    pub fn fall(&mut self) {
        self.now = (self.now * 0.1).max(self.least);
    }

    /// Raises the damping after a rejected step; returns whether to continue.
    pub fn rise(&mut self) -> bool {
        self.now *= 10.0;
        self.now <= self.most
    }
}

/// Returns the lowest state found from `start`, and its cost.
pub fn minimise<P: Problem>(problem: &mut P, start: P::State, options: &Options) -> (P::State, f64) {
    let (mut state, mut damping) = (start, options.damping);
    let mut cost = problem.cost(&state);
    let mut normal = None;
    for _ in 0..options.iterations {
        let equations = normal.get_or_insert_with(|| problem.linearised(&state));
        let next = problem.stepped(&state, equations, damping.now).map(|next| (problem.cost(&next), next));
        match next {
            Some((next_cost, next)) if next_cost <= cost => {
                let gain = cost - next_cost;
                let taken = problem.taken(&state, &next, next_cost);
                (state, normal) = (next, None);
                cost = match taken {
                    ControlFlow::Break(cost) => return (state, cost),
                    ControlFlow::Continue(cost) => cost,
                };
                damping.fall();
                if gain < options.least_gain * cost {
                    break;
                }
            }
            _ => {
                if !damping.rise() {
                    break;
                }
            }
        }
    }
    (state, cost)
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix2, Vector2};

    use super::*;

    /// Rosenbrock's valley, as the residuals (1 - x, 10 (y - x²)).
    struct Valley;

    impl Problem for Valley {
        type State = Vector2<f64>;
        type Normal = (Matrix2<f64>, Vector2<f64>);

        fn cost(&self, p: &Vector2<f64>) -> f64 {
            (1.0 - p.x).powi(2) + 100.0 * (p.y - p.x * p.x).powi(2)
        }

        fn linearised(&self, p: &Vector2<f64>) -> Self::Normal {
            let jacobian = Matrix2::new(-1.0, 0.0, -20.0 * p.x, 10.0);
            let residual = Vector2::new(1.0 - p.x, 10.0 * (p.y - p.x * p.x));
            (jacobian.transpose() * jacobian, jacobian.transpose() * residual)
        }

        fn stepped(&self, p: &Vector2<f64>, (normal, gradient): &Self::Normal, damping: f64) -> Option<Vector2<f64>> {
            let damped = normal + Matrix2::from_diagonal(&(normal.diagonal() * damping));
            Some(p - damped.cholesky()?.solve(gradient))
        }
    }

    const OPTIONS: Options = Options { iterations: 100, damping: Damping { now: 1e-3, least: 1e-12, most: 1e8 }, least_gain: 1e-14 };

    #[test]
    fn a_curved_valley_is_followed_to_its_end() {
        for start in [Vector2::new(-1.2, 1.0), Vector2::new(3.0, -2.0), Vector2::new(0.0, 5.0)] {
            let (found, cost) = minimise(&mut Valley, start, &OPTIONS);
            assert!((found - Vector2::new(1.0, 1.0)).norm() < 1e-6 && cost < 1e-12, "{found} {cost}");
        }
    }

    #[test]
    fn the_cost_never_rises_and_zero_iterations_change_nothing() {
        let start = Vector2::new(-1.2, 1.0);
        let mut last = Valley.cost(&start);
        assert_eq!(minimise(&mut Valley, start, &Options { iterations: 0, ..OPTIONS }), (start, last));
        for iterations in 1..30 {
            let (_, cost) = minimise(&mut Valley, start, &Options { iterations, ..OPTIONS });
            assert!(cost <= last);
            last = cost;
        }
    }
}
