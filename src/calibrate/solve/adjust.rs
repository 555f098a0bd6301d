//! Bundle adjustment: estimates the lens and every board's pose together by the Levenberg-Marquardt
//! method.
//!
//! The normal equations have an arrow shape, since the views share only the lens. So each view's
//! six unknowns are eliminated (Schur complement). At most ten unknowns remain, and the covariance
//! of everything follows from the same parts.

use nalgebra::{Matrix6, SMatrix, UnitQuaternion, Vector2, Vector3, Vector6};

use super::super::board::Board;
use super::lens::{FreeNumbers, LENS_NUMBERS, Lens, LensMatrix, LensVector};
use crate::geometry::least_squares::{Damping, Options, Problem, minimise};
use crate::geometry::{Camera, Pose};

/// The board's frame; see `calibrate::board`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BoardFrame {}

/// One corner in one picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Position on the board, metres.
    pub board_m: Vector2<f64>,
    /// Raw pixel.
    pub pixel: Vector2<f64>,
}

/// Returns the observations of corners given in the board's order.
pub fn observations_of(corners: &[Option<Vector2<f64>>], board: &Board) -> Vec<Observation> {
    let seen = corners.iter().enumerate().filter_map(|(k, c)| Some((k, (*c)?)));
    seen.map(|(k, pixel)| Observation { board_m: board.corner(k), pixel }).collect()
}

/// Returns the mean distance between two views' corners, pixels; infinite if no corner is seen in
/// both.
pub fn mean_distance(a: &[Option<Vector2<f64>>], b: &[Option<Vector2<f64>>]) -> f64 {
    let distances: Vec<f64> = a.iter().zip(b).filter_map(|(a, b)| Some(((*a)? - (*b)?).norm())).collect();
    if distances.is_empty() { f64::INFINITY } else { distances.iter().sum::<f64>() / distances.len() as f64 }
}

/// A lens and one pose `T_camera_board` per view.
#[derive(Debug, Clone, PartialEq)]
pub struct Bundle {
    /// The lens.
    pub lens: Lens,
    /// `T_camera_board` of each view, metres.
    pub poses: Vec<Pose<Camera, BoardFrame>>,
}

/// The loss function of the residuals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Loss {
    /// Sum of squares.
    Squares,
    /// Cauchy's loss: a residual of this many pixels has half the weight.
    Cauchy(f64),
}

impl Loss {
    fn cost_and_weight(self, squared: f64) -> (f64, f64) {
        match self {
            Self::Squares => (squared, 1.0),
            Self::Cauchy(scale) => {
                let c2 = scale * scale;
                (c2 * (squared / c2).ln_1p(), 1.0 / (1.0 + squared / c2))
            }
        }
    }
}

type Coupling = SMatrix<f64, LENS_NUMBERS, 6>;

/// One view's part of the normal equations.
struct ViewBlock {
    own: Matrix6<f64>,
    coupling: Coupling,
    gradient: Vector6<f64>,
}

/// The normal equations, linearised at one state.
struct Normal {
    lens: LensMatrix,
    gradient: LensVector,
    views: Vec<ViewBlock>,
}

/// Covariances for residuals of one pixel; see [`Bundle::covariance`].
#[derive(Debug, Clone)]
pub struct BundleCovariance {
    /// Covariance of the ten parameters; rows and columns of parameters that are not estimated are
    /// zero.
    pub lens: LensMatrix,
    /// Covariance of each view's [δθ, δt]: `R_true = Exp(δθ) R`, `t_true = t + δt`, camera axes,
    /// rad and m.
    pub views: Vec<Matrix6<f64>>,
}

/// Cost of a corner behind the camera, pixels squared: larger than any picture, so that no step
/// that puts one there is accepted. Any value above a picture's diagonal squared would do.
const BEHIND: f64 = 1e9;

impl Bundle {
    /// Returns the residual, observed minus predicted, pixels; `None` if the corner would lie
    /// behind the camera.
    pub fn residual(&self, view: usize, o: &Observation) -> Option<Vector2<f64>> {
        let p = self.poses[view].rotation * o.board_m.push(0.0) + self.poses[view].translation;
        (p.z > 1e-9).then(|| o.pixel - self.lens.project(p.xy() / p.z))
    }

    /// Returns the residuals of all views' corners, view by view.
    pub fn residuals<'a>(&'a self, views: &'a [Vec<Observation>]) -> impl Iterator<Item = Option<Vector2<f64>>> + 'a {
        views.iter().enumerate().flat_map(move |(v, all)| all.iter().map(move |o| self.residual(v, o)))
    }

    /// Minimises the loss over all free unknowns, from the current state, in at most `iterations`
    /// steps; returns the cost reached.
    pub fn adjust(&mut self, views: &[Vec<Observation>], free: &FreeNumbers, loss: Loss, iterations: usize) -> f64 {
        let options = Options { iterations, damping: Damping { now: 1e-4, least: 1e-12, most: 1e8 }, least_gain: 1e-12 };
        let (found, cost) = minimise(&mut Adjustment { views, free, loss }, self.clone(), &options);
        *self = found;
        cost
    }

    /// Returns the covariances of all unknowns for independent residuals of one pixel along each
    /// axis; multiply by sigma squared for the estimate's. `None` if the views do not determine the
    /// unknowns.
    pub fn covariance(&self, views: &[Vec<Observation>], free: &FreeNumbers) -> Option<BundleCovariance> {
        let normal = Adjustment { views, free, loss: Loss::Squares }.linearised(self);
        let reduced = normal.reduced(0.0)?;
        // Scaled to a unit diagonal, the smallest eigenvalue tells whether the unknowns are
        // determined.
        let scale = LensVector::from_fn(|k, _| 1.0 / reduced.matrix[(k, k)].max(f64::MIN_POSITIVE).sqrt());
        let scaled = LensMatrix::from_fn(|r, c| reduced.matrix[(r, c)] * scale[r] * scale[c]);
        let least = scaled.symmetric_eigenvalues().min();
        if least.is_nan() || least < 1e-12 {
            return None;
        }
        let inverse = scaled.try_inverse()?;
        let mut lens = LensMatrix::from_fn(|r, c| inverse[(r, c)] * scale[r] * scale[c]);
        for k in free.held() {
            lens.row_mut(k).fill(0.0);
            lens.column_mut(k).fill(0.0);
        }
        if free.square_pixels && free.free[0] {
            lens.set_row(1, &lens.row(0).into_owned());
            lens.set_column(1, &lens.column(0).into_owned());
        }
        let views = normal.views.iter().zip(&reduced.inverses).map(|(view, inverse)| {
            let gain = inverse * view.coupling.transpose();
            inverse + gain * lens * gain.transpose()
        });
        Some(BundleCovariance { lens, views: views.collect() })
    }
}

/// The lens's equations after the views' unknowns are eliminated.
struct Reduced {
    matrix: LensMatrix,
    gradient: LensVector,
    inverses: Vec<Matrix6<f64>>,
}

/// The loss of a bundle over all views, as a function of the free unknowns.
struct Adjustment<'a> {
    views: &'a [Vec<Observation>],
    free: &'a FreeNumbers,
    loss: Loss,
}

impl Problem for Adjustment<'_> {
    type State = Bundle;
    type Normal = Normal;

    fn cost(&self, bundle: &Bundle) -> f64 {
        let squared = bundle.residuals(self.views).map(|r| r.map_or(BEHIND, |r| r.norm_squared()));
        squared.map(|squared| self.loss.cost_and_weight(squared).0).sum()
    }

    fn linearised(&self, bundle: &Bundle) -> Normal {
        let views = Vec::with_capacity(self.views.len());
        let mut normal = Normal { lens: LensMatrix::zeros(), gradient: LensVector::zeros(), views };
        for (pose, observations) in bundle.poses.iter().zip(self.views) {
            normal.add_view(&bundle.lens, pose, observations, self.free, self.loss);
        }
        for k in self.free.held() {
            normal.lens[(k, k)] = 1.0;
        }
        normal
    }

    fn stepped(&self, bundle: &Bundle, normal: &Normal, damping: f64) -> Option<Bundle> {
        let (lens_step, view_steps) = normal.step(damping)?;
        let mut lens = Lens(bundle.lens.0 + lens_step);
        if self.free.square_pixels && self.free.free[0] {
            lens.0[1] = lens.0[0];
        }
        let poses = bundle.poses.iter().zip(view_steps).map(|(pose, step)| {
            let rotation = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(0).into_owned());
            Pose::new(rotation * pose.rotation, pose.translation + step.fixed_rows::<3>(3))
        });
        Some(Bundle { lens, poses: poses.collect() })
    }
}

impl Normal {
    fn add_view(&mut self, lens: &Lens, pose: &Pose<Camera, BoardFrame>, observations: &[Observation], free: &FreeNumbers, loss: Loss) {
        let mut block = ViewBlock { own: Matrix6::zeros(), coupling: Coupling::zeros(), gradient: Vector6::zeros() };
        for o in observations {
            let rotated: Vector3<f64> = pose.rotation * o.board_m.push(0.0);
            let p = rotated + pose.translation;
            if p.z <= 1e-9 {
                continue;
            }
            let point = p.xy() / p.z;
            let (pixel, [by_x, by_y], mut by_lens) = lens.project_with_derivatives(point);
            let residual = o.pixel - pixel;
            let (_, weight) = loss.cost_and_weight(residual.norm_squared());
            let by_point = SMatrix::<f64, 2, 3>::from_columns(&[by_x / p.z, by_y / p.z, -(by_x * point.x + by_y * point.y) / p.z]);
            let mut by_pose = SMatrix::<f64, 2, 6>::zeros();
            by_pose.fixed_columns_mut::<3>(0).copy_from(&(-by_point * rotated.cross_matrix()));
            by_pose.fixed_columns_mut::<3>(3).copy_from(&by_point);
            if free.square_pixels && free.free[0] {
                by_lens.set_column(0, &(by_lens.column(0) + by_lens.column(1)));
            }
            for k in free.held() {
                by_lens.column_mut(k).fill(0.0);
            }
            self.lens += by_lens.transpose() * by_lens * weight;
            self.gradient += by_lens.transpose() * residual * weight;
            block.own += by_pose.transpose() * by_pose * weight;
            block.coupling += by_lens.transpose() * by_pose * weight;
            block.gradient += by_pose.transpose() * residual * weight;
        }
        self.views.push(block);
    }

    fn reduced(&self, damping: f64) -> Option<Reduced> {
        let mut matrix = self.lens;
        for k in 0..LENS_NUMBERS {
            matrix[(k, k)] *= 1.0 + damping;
        }
        let mut gradient = self.gradient;
        let mut inverses = Vec::with_capacity(self.views.len());
        for view in &self.views {
            let mut own = view.own;
            for k in 0..6 {
                own[(k, k)] *= 1.0 + damping;
            }
            let inverse = own.cholesky()?.inverse();
            let gain = view.coupling * inverse;
            matrix -= gain * view.coupling.transpose();
            gradient -= gain * view.gradient;
            inverses.push(inverse);
        }
        Some(Reduced { matrix, gradient, inverses })
    }

    fn step(&self, damping: f64) -> Option<(LensVector, Vec<Vector6<f64>>)> {
        let reduced = self.reduced(damping)?;
        let lens = reduced.matrix.cholesky()?.solve(&reduced.gradient);
        let views = self.views.iter().zip(&reduced.inverses);
        let steps = views.map(|(view, inverse)| inverse * (view.gradient - view.coupling.transpose() * lens));
        Some((lens, steps.collect()))
    }
}
