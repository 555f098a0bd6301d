//! Nonlinear least squares by Levenberg's and Marquardt's method (Marquardt 1963): one loop for all problems of this crate.
//!
//! A [`Problem`] says what its cost is, linearises itself and takes damped steps; [`minimise`] decides which steps are taken, how the damping
//! follows, and when to stop.

use std::ops::ControlFlow;

/// Something to be minimised.
pub trait Problem {
    /// What is estimated.
    type State;
    /// The normal equations at a state.
    type Normal;

    /// The cost at a state.
    fn cost(&self, state: &Self::State) -> f64;

    /// The normal equations at a state.
    fn linearised(&self, state: &Self::State) -> Self::Normal;

    /// The state after a step with this damping; `None` where the damped equations are singular.
    fn stepped(&self, state: &Self::State, normal: &Self::Normal, damping: f64) -> Option<Self::State>;

    /// Takes note of a state that was taken; gives its cost, where that is not what it was (a scale that is estimated anew), or breaks where
    /// there is nothing more to gain.
    fn taken(&mut self, before: &Self::State, state: &Self::State, cost: f64) -> ControlFlow<f64, f64> {
        let _ = (before, state);
        ControlFlow::Continue(cost)
    }
}

/// When to stop, and how much to damp.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Steps at most, taken or not.
    pub iterations: usize,
    /// How it begins.
    pub damping: Damping,
    /// A step that lowers the cost by less than this share of it is the last.
    pub least_gain: f64,
}

/// [`Options::least_gain`] of a robust fit to pairs. With N pairs the cost is some N variances of noise: what further steps gain is a hundredth of a standard deviation of the
/// model with 500. Raised, the model is less than the pairs tell; lowered, frames cost more: where robust weights change much, steps converge slowly.
pub const LEAST_GAIN_OF_PAIRS: f64 = 1e-7;

/// How much a step is held back: as a share of the normal matrix's diagonal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Damping {
    /// Now.
    pub now: f64,
    /// The least it falls to.
    pub least: f64,
    /// Beyond this no step will do.
    pub most: f64,
}

impl Damping {
    /// After a step that lowered the cost.
    pub fn fall(&mut self) {
        self.now = (self.now * 0.1).max(self.least);
    }

    /// After a step that did not; false where it is hopeless.
    pub fn rise(&mut self) -> bool {
        self.now *= 10.0;
        self.now <= self.most
    }
}

/// The lowest state that is found from `start`, and its cost.
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
    fn the_cost_never_rises_and_no_iteration_is_no_change() {
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
