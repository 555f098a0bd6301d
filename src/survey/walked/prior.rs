//! The priors of a stage: shapes are smooth, unobserved quantities stay as configured, and the
//! world's frame is fixed.

use nalgebra::{DMatrix, DVector, SVector, Vector2, Vector3};

use super::constraints::Constraint;
use super::stage_model::{LENS_NUMBERS, StageModel};
use crate::geometry::bspline::BicubicSpline;

/// Sigma, metres and radians, of constraints that fix the world's own pose and size: practically
/// zero. (Lower, and the system loses precision.)
const GAUGE_SIGMA: f64 = 1e-6;
/// Points across and down a surface by which its mean plane is defined.
const GAUGE_POINTS: [usize; 2] = [24, 18];
/// Prior of a surface's pose around the configured one, one sigma: metres and radians.
const POSE_SIGMAS: [f64; 2] = [0.3, 0.2];
/// Prior of a point's distance from its surface's plane, one sigma, as a fraction of the longer
/// side: it only keeps parts that no frame shows from being arbitrary.
const HEIGHT_SHARE: f64 = 0.01;
/// Prior of a point's displacement within the plane, as the same fraction: for surfaces that are as
/// long as `size_m` states, and for stretched ones. If all were free, the first surface alone would
/// set the stage's scale.
const RIGID_SHARE: f64 = 1e-6;
const STRETCHED_SHARE: f64 = 0.005;
/// Prior of the change of a stretch along the surface, one sigma, per side of the surface: cloth
/// and prints stretch evenly.
const STRETCH_BEND: f64 = 0.002;

/// Prior of the stage's size around `size_m` if something else was measured, one sigma, as a
/// fraction: tapes are more precise than paint on a cloth. Raised, a single wrong length passes;
/// lowered, `size_m` competes with more precise lengths.
const SIZE_SIGMA: f64 = 0.02;

/// Smoothness of the shapes, one sigma.
#[derive(Debug, Clone, PartialEq)]
pub struct Smoothness {
    /// Curvature of each surface's heights, times its longer side.
    pub curvatures: Vec<f64>,
    /// Whether surfaces may be stretched.
    pub is_stretched: bool,
}

impl Smoothness {
    /// Returns the same smoothness for all surfaces.
    pub fn even(surfaces: usize, curvature: f64) -> Self {
        Self { curvatures: vec![curvature; surfaces], is_stretched: false }
    }

    /// Returns a copy with another curvature for surface `k`.
    pub fn with(&self, k: usize, curvature: f64) -> Self {
        let mut other = self.clone();
        other.curvatures[k] = curvature;
        other
    }
}

/// Adds the priors at a model to its normal equations.
pub fn add(
    model: &StageModel,
    smoothness: &Smoothness,
    lens_sigmas: &[f64; LENS_NUMBERS],
    readout_sigma_s: f64,
    constraints: &[Constraint],
    matrix: &mut DMatrix<f64>,
    right: &mut DVector<f64>,
) {
    let mut system = System { matrix, right };
    let places = model.places();
    for (k, surface) in model.surfaces.iter().enumerate() {
        let Some(shape) = model.shape(k) else { continue };
        let side = surface.size_m[0].max(surface.size_m[1]);
        system.smooth(&shape.height, places.heights[k], smoothness.curvatures[k] / side);
        system.smooth(&shape.stretch, places.stretches[k], STRETCH_BEND / side);
        system.small(&shape.height, places.heights[k], HEIGHT_SHARE * side, |_| SVector::zeros());
        let share = if smoothness.is_stretched { STRETCHED_SHARE } else { RIGID_SHARE };
        let middles = shape.stretch.middles();
        system.small(&shape.stretch, places.stretches[k], share * side, |n| Vector2::from(middles(n)) * model.growth());
        system.gauge(model, k);
        if let Some(at) = places.poses[k] {
            let ([shift, rotation], start) = (model.pose_change(k), model.start_from_first(k));
            for axis in 0..3 {
                // In a larger stage the surfaces are farther apart.
                let by_size = places.size.map(|size| (size, -start[axis]));
                let row: Vec<(usize, f64)> = std::iter::once((at + axis, 1.0)).chain(by_size).collect();
                system.add(&row, shift[axis] - model.growth() * start[axis], POSE_SIGMAS[0]);
                system.add(&[(at + 3 + axis, 1.0)], rotation[axis], POSE_SIGMAS[1]);
            }
        }
    }
    if let Some(at) = places.size {
        system.add(&[(at, 1.0)], model.growth(), SIZE_SIGMA);
    }
    for constraint in constraints {
        for row in constraint.rows(model) {
            system.add(&row.by_model, -row.left, constraint.sigma_m);
        }
    }
    if let Some(at) = places.readout {
        system.add(&[(at, 1.0)], model.readout_change_s(), readout_sigma_s);
    }
    if let Some(at) = places.lens {
        for (k, change) in model.lens_change().into_iter().enumerate() {
            system.add(&[(at + k, 1.0)], change, lens_sigmas[k]);
        }
    }
}

/// A finite difference of neighbouring coefficients: offsets of columns and rows with weights; how
/// many it spans; the unit of the derivative.
type Difference = (&'static [(usize, usize, f64)], [usize; 2], f64);

struct System<'a> {
    matrix: &'a mut DMatrix<f64>,
    right: &'a mut DVector<f64>,
}

impl System<'_> {
    /// Constrains a sum of unknowns, which is `now` before the step, to zero with a sigma.
    fn add(&mut self, row: &[(usize, f64)], now: f64, sigma: f64) {
        let information = sigma.powi(-2);
        for (i, a) in row {
            self.right[*i] -= a * now * information;
            for (j, b) in row.iter().filter(|(j, _)| j <= i) {
                self.matrix[(*i, *j)] += a * b * information;
            }
        }
    }

    /// Constrains second differences along both axes and mixed, as second derivatives.
    fn smooth<const N: usize>(&mut self, field: &BicubicSpline<N>, first: usize, sigma: f64) {
        let [columns, rows] = field.columns_and_rows();
        let [dx, dy] = field.spacing();
        let differences: [Difference; 3] = [
            (&[(0, 0, 1.0), (1, 0, -2.0), (2, 0, 1.0)], [3, 1], dx * dx),
            (&[(0, 0, 1.0), (0, 1, -2.0), (0, 2, 1.0)], [1, 3], dy * dy),
            (&[(0, 0, 1.0), (1, 0, -1.0), (0, 1, -1.0), (1, 1, 1.0)], [2, 2], dx * dy / std::f64::consts::SQRT_2),
        ];
        for (stencil, [across, up], unit) in differences {
            for (i, j, n) in (0..columns + 1 - across).flat_map(|i| (0..rows + 1 - up).flat_map(move |j| (0..N).map(move |n| (i, j, n)))) {
                let at = |(a, b, w): &(usize, usize, f64)| ((j + b) * columns + i + a, w / unit);
                let now: f64 = stencil.iter().map(at).map(|(k, w)| field.coefficients()[k][n] * w).sum();
                let row: Vec<(usize, f64)> = stencil.iter().map(at).map(|(k, w)| (first + N * k + n, w)).collect();
                self.add(&row, now, sigma);
            }
        }
    }

    /// Constrains coefficients to those that `expected` returns for their index.
    fn small<const N: usize>(&mut self, field: &BicubicSpline<N>, first: usize, sigma: f64, expected: impl Fn(usize) -> SVector<f64, N>) {
        for (k, c) in field.coefficients().iter().enumerate() {
            let off = c - expected(k);
            for n in 0..N {
                self.add(&[(first + N * k + n, 1.0)], off[n], sigma);
            }
        }
    }

    /// Fixes the surface's own frame: its mean plane, its centre and its axes. For the first
    /// surface also the size, since no camera can tell a stage from a smaller, nearer one.
    fn gauge(&mut self, model: &StageModel, k: usize) {
        let (surface, places) = (&model.surfaces[k], model.places());
        let Some(shape) = model.shape(k) else { return };
        let share = |n: usize, of: usize| (n as f64 + 0.5) / of as f64 - 0.5;
        let points: Vec<[f64; 2]> = (0..GAUGE_POINTS[0] * GAUGE_POINTS[1])
            .map(|n| {
                [
                    share(n % GAUGE_POINTS[0], GAUGE_POINTS[0]) * surface.size_m[0],
                    share(n / GAUGE_POINTS[0], GAUGE_POINTS[1]) * surface.size_m[1],
                ]
            })
            .collect();
        let radius = 0.5 * surface.size_m[0].hypot(surface.size_m[1]);
        // How a point's shift (right, up, out) contributes to the shift, rotation and growth of the
        // whole surface.
        let ways: [fn(f64, f64) -> Vector3<f64>; 7] = [
            |_, _| Vector3::z(),
            |x, _| Vector3::z() * x,
            |_, y| Vector3::z() * y,
            |_, _| Vector3::x(),
            |_, _| Vector3::y(),
            |x, y| Vector3::new(-y, x, 0.0),
            |x, y| Vector3::new(x, y, 0.0),
        ];
        for way in &ways[..if k == 0 { 7 } else { 6 }] {
            let mut row = vec![0.0; places.count];
            let mut now = 0.0;
            for &point in &points {
                let by = way(point[0] / radius, point[1] / radius) / points.len() as f64;
                let height = shape.height.at(point).value;
                let stretch = shape.stretch.at(point).value - Vector2::from(point) * model.growth();
                now += by.z * height.x + by.x * stretch.x + by.y * stretch.y;
                for (n, w) in shape.height.support(point).weights() {
                    row[places.heights[k] + n] += by.z * w;
                }
                for (n, w) in shape.stretch.support(point).weights() {
                    row[places.stretches[k] + 2 * n] += by.x * w;
                    row[places.stretches[k] + 2 * n + 1] += by.y * w;
                }
            }
            let row: Vec<(usize, f64)> = row.into_iter().enumerate().filter(|(_, w)| *w != 0.0).collect();
            self.add(&row, now, GAUGE_SIGMA);
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};

    use super::*;
    use crate::camera::{CameraModel, Intrinsics};
    use crate::geometry::Pose;
    use crate::motion::Motion;
    use crate::survey::measured::{Measured, PicturePoint};
    use crate::survey::walked::normal_equations::{FrameRows, NormalEquations};
    use crate::survey::walked::synthetic::{LENS, camera_poses, observed, stage};
    use crate::track::SurfaceSpec;

    /// Noise of a tile, one sigma along each axis, pixels.
    const NOISE_PX: f64 = 0.002;
    /// Priors of an unknown lens.
    const SIGMAS: [f64; LENS_NUMBERS] = [50.0, 50.0, 40.0, 40.0, 0.3, 0.3, 0.01, 0.01];

    fn lens(change: f64) -> CameraModel {
        let [k1, k2, p1, p2, k3] = LENS.distortion;
        CameraModel::new(Intrinsics {
            fx: LENS.fx * (1.0 + change),
            cx: LENS.cx + 200.0 * change,
            distortion: [k1 - change, k2, p1, p2, k3],
            ..LENS
        })
        .unwrap()
    }

    /// A stage with folds of a centimetre, whose flat stands 20 mm and a degree off its configured
    /// pose.
    fn truth() -> StageModel {
        let flat = StageModel::new(lens(0.0), &stage(), true, false);
        let places = flat.places().clone();
        let columns = flat.shape(0).unwrap().height.columns_and_rows()[0];
        let mut step = DVector::zeros(places.count);
        for n in 0..flat.shape(0).unwrap().height.coefficients().len() {
            let (i, j) = ((n % columns) as f64, (n / columns) as f64);
            step[places.heights[0] + n] = 0.01 * (0.5 * i).sin() * (0.3 * j).cos();
        }
        let at = places.poses[1].unwrap();
        for (k, v) in [0.012, -0.008, 0.02, 0.01, -0.015, 0.005].into_iter().enumerate() {
            step[at + k] = v;
        }
        flat.stepped(&step).unwrap()
    }

    /// Cameras that stand still.
    fn still() -> Vec<Motion> {
        camera_poses(24).into_iter().map(Motion::still).collect()
    }

    /// Runs Gauss-Newton on tiles of cameras with these motions, observed anew in every round;
    /// returns the model and its covariance. `readout_sigma_s` is the prior of the readout.
    fn adjusted(
        motions: &[Motion],
        start: StageModel,
        readout_sigma_s: f64,
        truth: &StageModel,
        constraints: &[Constraint],
        rounds: usize,
    ) -> (StageModel, DMatrix<f64>) {
        let mut model = start;
        let smoothness = Smoothness { is_stretched: true, ..Smoothness::even(2, 3.0) };
        let mut covariance = DMatrix::zeros(0, 0);
        for _ in 0..rounds {
            // Linearised at the true poses, which the equations leave free.
            let frames = observed(truth, &model, motions, NOISE_PX, 7);
            let rows: Vec<FrameRows> = frames.iter().map(|f| FrameRows::new(f, &model, 3.0, |_| false)).collect();
            let mut equations = NormalEquations::new(&rows, model.places().count, &[1e3; 2], true).unwrap();
            // The large scale keeps all tiles in; undo its effect on the information.
            equations.matrix *= 1e6;
            equations.right *= 1e6;
            add(&model, &smoothness, &SIGMAS, readout_sigma_s, constraints, &mut equations.matrix, &mut equations.right);
            equations.matrix.fill_upper_triangle_with_lower_triangle();
            let factor = equations.matrix.clone().cholesky().unwrap();
            model = model.stepped(&factor.solve(&equations.right)).unwrap();
            covariance = factor.inverse();
        }
        (model, covariance)
    }

    #[test]
    fn shape_layout_and_lens_are_found_from_exact_tiles() {
        let truth = truth();
        let start = StageModel::new(lens(0.01), &stage(), true, false);
        let (found, covariance) = adjusted(&still(), start, 1e-6, &truth, &[], 6);
        let (lens, real) = (found.camera.intrinsics(), truth.camera.intrinsics());
        assert!((lens.fx / real.fx - 1.0).abs() < 1e-4 && (lens.cx - real.cx).abs() < 0.1, "{lens:?}");
        let at = found.places().lens.unwrap();
        let sigma = covariance[(at, at)].sqrt();
        assert!((lens.fx - real.fx).abs() < 5.0 * sigma && sigma < 1e-4 * real.fx, "{} {sigma}", lens.fx - real.fx);
        // Heights where the walk sees them, relative to the plane that the gauge defines as the
        // surface's own.
        let mut worst = 0.0_f64;
        for (i, j) in (-6..=6).flat_map(|i| (-4..=4).map(move |j| (i, j))) {
            let point = [0.25 * f64::from(i), 0.25 * f64::from(j)];
            let off = found.shape(0).unwrap().height.at(point).value.x - truth.shape(0).unwrap().height.at(point).value.x;
            worst = worst.max(off.abs());
        }
        println!("heights {worst}");
        assert!(worst < 2e-3, "{worst}");
    }

    #[test]
    fn an_unconfigured_readout_is_estimated_with_the_lens() {
        let truth = truth().with_readout(0.018);
        let moving = |(k, pose): (usize, Pose<_, _>)| {
            let t = k as f64;
            let velocity = Vector3::new((1.3 * t).sin(), (2.1 * t).cos(), (0.7 * t).sin()) * 0.4;
            let angular_velocity = Vector3::new((1.9 * t).cos(), (1.1 * t).sin(), (2.7 * t).sin()) * 0.2;
            Motion { velocity, angular_velocity, ..Motion::still(pose) }
        };
        let motions: Vec<Motion> = camera_poses(24).into_iter().enumerate().map(moving).collect();
        let start = StageModel::new(lens(0.01), &stage(), true, false);
        let (found, covariance) = adjusted(&motions, start, 0.02, &truth, &[], 8);
        let at = found.places().readout.unwrap();
        let sigma_s = covariance[(at, at)].sqrt();
        assert!((found.readout_s() - 0.018).abs() < 1e-4 && sigma_s < 1e-4, "{} {sigma_s}", found.readout_s());
        let fx = [&found, &truth].map(|model| model.camera.intrinsics().fx);
        assert!((fx[0] / fx[1] - 1.0).abs() < 1e-4, "{fx:?}");
    }

    #[test]
    fn a_measured_length_corrects_the_scale_of_a_stage() {
        // As configured, everything is two hundredths smaller than it is.
        let real = stage();
        let typed: Vec<SurfaceSpec> = real
            .iter()
            .map(|s| SurfaceSpec {
                size_m: s.size_m.map(|side| side / 1.02),
                pose: Pose::new(s.pose.rotation, s.pose.translation / 1.02),
                ..s.clone()
            })
            .collect();
        let truth = {
            let start = StageModel::new(lens(0.0), &typed, false, true);
            let mut step = DVector::zeros(start.places().count);
            step[start.places().size.unwrap()] = 0.02;
            let at = start.places().poses[1].unwrap();
            for axis in 0..3 {
                step[at + axis] = real[1].pose.translation[axis] - typed[1].pose.translation[axis];
            }
            start.stepped(&step).unwrap()
        };
        let corner = |surface: usize, right: f64, up: f64| PicturePoint {
            surface,
            on_picture_m: [right * typed[surface].size_m[0], up * typed[surface].size_m[1]],
        };
        let between = [corner(0, -0.5, 0.5), corner(1, 0.5, -0.5)];
        let [from, to] = between.each_ref().map(|p| truth.point(p.surface, p.on_picture_m).place);
        let length = Constraint {
            name: "length".to_owned(),
            measured: Measured::Distance { between, length_m: (to - from).norm() },
            sigma_m: 0.001,
        };
        let (found, covariance) = adjusted(&still(), StageModel::new(lens(0.0), &typed, false, true), 1e-6, &truth, &[length], 6);
        let size = found.places().size.unwrap();
        assert!((found.growth() - 0.02).abs() < 1e-5, "{}", found.growth());
        assert!(covariance[(size, size)].sqrt() < 1e-3);
        let off = found.surfaces[1].pose.translation - real[1].pose.translation;
        assert!(off.norm() < 1e-4, "{off}");
        let place = found.point(0, corner(0, 0.5, 0.5).on_picture_m).place;
        // The corner's height depends on its bend, which few tiles show there; the stage's size
        // does not.
        assert!((place.xy() - Vector2::new(2.0, 1.5)).norm() < 1e-4 && place.z.abs() < 1e-3, "{place}");
    }
}
