//! A damped Gauss-Newton loop (Nocedal and Wright 2006, sections 3.1 and 10.3), whatever it
//! minimises.
//!
//! A problem is predicted at a state and solved for a step. The next prediction shows what the step
//! was worth. A step that raised the cost is shortened to where a parabola through both costs and
//! the slope has its minimum, until the cost falls. Every solution weighs residuals anew, so costs
//! are compared by the weights of the step in question.

use crate::track::align::tuning::TUNING;

/// Nonlinear least squares with robust weights.
pub trait LeastSquares {
    /// The unknowns.
    type State: Copy;

    /// Predicts at a state. `None` where that is impossible; otherwise whether residuals are those
    /// of the same observations as before.
    fn predict(&mut self, at: &Self::State) -> Option<bool>;

    /// Returns the cost of the prediction by the weights of the last step that was solved.
    fn cost(&mut self) -> f64;

    /// Weighs the residuals and solves for a step from the predicted state. `None` where a
    /// direction is undetermined.
    fn solve(&mut self, at: &Self::State) -> Option<Step<Self::State>>;

    /// Returns the state at a fraction of the last step, and takes all that a solution corrected
    /// along with it.
    fn at_fraction(&mut self, from: &Self::State, fraction: f64) -> Self::State;

    /// Returns why to end with the last step, if so.
    fn end(&mut self) -> Option<End>;
}

/// A step of the linearised problem.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step<S> {
    /// Where it leads.
    pub to: S,
    /// The cost where it begins.
    pub cost: f64,
    /// By how much it lowers the cost if residuals are linear; also half its squared length in
    /// sigmas.
    pub decrease: f64,
}

/// Why a minimisation ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// The last step was small.
    Converged,
    /// The problem gave up.
    Futile,
    /// All rounds were spent.
    OutOfRounds,
    /// Too few observations, or a direction that they do not determine.
    Undetermined,
}

/// The result of a minimisation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Minimum<S> {
    /// The state after the last step.
    pub state: S,
    /// Why it ended there.
    pub end: End,
}

/// A step that was taken.
struct Taken<S> {
    from: S,
    step: Step<S>,
    /// The fraction of the step that was taken.
    fraction: f64,
}

impl<S> Taken<S> {
    /// Returns the fraction of the step to try instead of a fraction that led to a cost; `None`
    /// where that is accepted.
    fn shortened(&self, cost: f64) -> Option<f64> {
        let Self { step, fraction, .. } = self;
        let decrease = step.cost - cost;
        if decrease > 0.0 {
            return None;
        }
        let [least, most] = TUNING.shortened_step_ratios;
        // The cost falls by twice the decrease per step at first: a parabola through that slope and
        // both costs.
        let slope = 2.0 * step.decrease * fraction;
        let lowest = 0.5 * slope / (slope - decrease);
        Some(fraction * if lowest.is_finite() { lowest.clamp(least, most) } else { least })
    }
}

/// Minimises from a start, in `max_rounds` predictions at most.
pub fn minimise<P: LeastSquares>(problem: &mut P, start: P::State, max_rounds: usize) -> Minimum<P::State> {
    let mut state = start;
    let mut taken: Option<Taken<P::State>> = None;
    for round in 0..max_rounds {
        let Some(is_same) = problem.predict(&state) else { return Minimum { state, end: End::Undetermined } };
        // The last round is left for a solution.
        if let Some(taken) = taken.as_mut().filter(|_| is_same && round + 1 < max_rounds) {
            let cost = problem.cost();
            if let Some(fraction) = taken.shortened(cost) {
                tracing::trace!(cost, before = taken.step.cost, fraction, "a step raised the cost");
                taken.fraction = fraction;
                state = problem.at_fraction(&taken.from, fraction);
                continue;
            }
        }
        let Some(step) = problem.solve(&state) else { return Minimum { state, end: End::Undetermined } };
        let end = problem.end();
        let from = std::mem::replace(&mut state, step.to);
        if let Some(end) = end {
            return Minimum { state, end };
        }
        taken = Some(Taken { from, step, fraction: 1.0 });
    }
    Minimum { state, end: End::OutOfRounds }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A curve through points: residuals `f(x)` of one unknown, by Gauss-Newton.
    struct Curve {
        residual: fn(f64) -> f64,
        slope: fn(f64) -> f64,
        at: f64,
        last_step: f64,
        /// The costs at all states that were accepted.
        costs: Vec<f64>,
    }

    impl Curve {
        fn new(residual: fn(f64) -> f64, slope: fn(f64) -> f64) -> Self {
            Self { residual, slope, at: f64::NAN, last_step: 0.0, costs: Vec::new() }
        }

        fn half_square(&self) -> f64 {
            0.5 * (self.residual)(self.at).powi(2)
        }
    }

    impl LeastSquares for Curve {
        type State = f64;

        fn predict(&mut self, at: &f64) -> Option<bool> {
            self.at = *at;
            at.is_finite().then_some(true)
        }

        fn cost(&mut self) -> f64 {
            self.half_square()
        }

        fn solve(&mut self, at: &f64) -> Option<Step<f64>> {
            let (residual, slope) = ((self.residual)(*at), (self.slope)(*at));
            self.last_step = -residual / slope;
            self.costs.push(self.half_square());
            self.last_step.is_finite().then(|| Step { to: at + self.last_step, cost: self.half_square(), decrease: 0.5 * residual.powi(2) })
        }

        fn at_fraction(&mut self, from: &f64, fraction: f64) -> f64 {
            from + fraction * self.last_step
        }

        fn end(&mut self) -> Option<End> {
            (self.last_step.abs() < 1e-9).then_some(End::Converged)
        }
    }

    #[test]
    fn a_line_takes_one_step() {
        let mut line = Curve::new(|x| 3.0 * x - 6.0, |_| 3.0);
        assert_eq!(minimise(&mut line, 50.0, 5), Minimum { state: 2.0, end: End::Converged });
        assert_eq!(line.costs.len(), 2);
    }

    /// Undamped steps of the arc tangent diverge from beyond 1.39.
    #[test]
    fn a_step_that_raises_the_cost_is_shortened() {
        for start in [1.0, 1.5, 3.0, 20.0, -200.0] {
            let mut curve = Curve::new(f64::atan, |x| 1.0 / (1.0 + x * x));
            let Minimum { state, end } = minimise(&mut curve, start, 60);
            assert!(end == End::Converged && state.abs() < 1e-9, "{start}: {state} {end:?}");
            assert!(curve.costs.windows(2).all(|pair| pair[1] < pair[0]), "{start}: {:?}", curve.costs);
        }
    }

    /// Two minima, at -1 and 1, with a hump between them.
    #[test]
    fn the_minimum_on_the_side_of_the_start_is_found() {
        for start in [0.2, 0.5, 1.7, 40.0] {
            for side in [-1.0, 1.0] {
                let mut wells = Curve::new(|x| x * x - 1.0, |x| 2.0 * x);
                let Minimum { state, end } = minimise(&mut wells, side * start, 60);
                assert!(end == End::Converged && (state - side).abs() < 1e-9, "{start}: {state}");
                assert!(wells.costs.windows(2).all(|pair| pair[1] <= pair[0]), "{:?}", wells.costs);
            }
        }
        let mut hump = Curve::new(|x| x * x - 1.0, |x| 2.0 * x);
        assert_eq!(minimise(&mut hump, 0.0, 60).end, End::Undetermined);
    }

    #[test]
    fn rounds_are_bounded() {
        let mut curve = Curve::new(f64::atan, |x| 1.0 / (1.0 + x * x));
        assert_eq!(minimise(&mut curve, 1.5, 3).end, End::OutOfRounds);
        assert_eq!(minimise(&mut curve, f64::NAN, 3).end, End::Undetermined);
    }

    /// Shortening needs the cost and the slope, and never ends at no step or at the whole of it.
    #[test]
    fn a_step_is_shortened_to_the_parabolas_minimum() {
        let taken = |fraction| Taken { from: 0.0, step: Step { to: 1.0, cost: 10.0, decrease: 1.0 }, fraction };
        assert_eq!(taken(1.0).shortened(9.99), None);
        // 10 - 2 t + 5 t^2 is 13 at 1, and lowest at 0.2.
        assert!((taken(1.0).shortened(13.0).unwrap() - 0.2).abs() < 1e-12);
        assert!((taken(0.5).shortened(10.25).unwrap() - 0.2).abs() < 1e-12);
        assert_eq!(taken(1.0).shortened(f64::INFINITY), Some(TUNING.shortened_step_ratios[0]));
        assert_eq!(taken(1.0).shortened(f64::NAN), Some(TUNING.shortened_step_ratios[0]));
        assert_eq!(taken(1.0).shortened(10.0), Some(TUNING.shortened_step_ratios[1]));
    }
}
