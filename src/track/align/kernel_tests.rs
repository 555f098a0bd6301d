//! Tests of the kernels: their derivatives against finite differences, and the AVX2 versions
//! against the plain ones.

use nalgebra::{UnitQuaternion, Vector3};

use super::kernel::columns::{BIAS, COLUMNS, GAINS, POSE, PSF_VARIANCE, entry};
use super::kernel::evidence::{RunEvidence, evidence, evidence_lanes};
use super::kernel::noise_sums::{noise_sums, noise_sums_lanes};
use super::kernel::normal::{Residuals, RobustWeighting, RunView, columns, less_step, moments, residuals, robust_cost, weight};
use super::kernel::tile_equations::TileEquations;
use super::kernel::tile_products::{ProductBuffer, tile_equations, tile_equations_lanes};
use super::lanes::{LANES, Lanes, Plain, load_at};
use super::learned::light::{RememberedLight, TileLight};
use super::learned::noise::Noise;
use super::learned::online_calibration::OnlineCalibration;
use super::picture::surface::AlignSurface;
use super::pixels::appearance::{Appearance, Predicted, predict, predict_by_velocity, predict_by_velocity_lanes, predict_lanes};
use super::pixels::level_spec::LevelSpec;
use super::pixels::runs::{Pixels, Run};
use super::pixels::selection::Selector;
use crate::camera::Shutter;
use crate::geometry::robust_kernel::tukey_cost;
use crate::motion::{Motion, MotionError};
use crate::track::frame::frame_levels::FrameLevels;
use crate::track::frame::rays::CameraRays;
use crate::track::scene::shape::tests::folds;
use crate::track::scene::surface::SurfaceSpec;
use crate::track::synthetic::{cloth, facing, lens, view};

struct Scene {
    surfaces: [AlignSurface; 1],
    slow: OnlineCalibration,
    rays: CameraRays,
    motion: Motion,
    pixels: Pixels,
}

impl Scene {
    fn spec(&self) -> LevelSpec<'_> {
        let spec = LevelSpec::new(&self.surfaces, &self.slow, &self.rays, true, 1, &self.motion);
        LevelSpec { count: 3000, side: 3, places: 1, gradient_gain: 1.0, ..spec }
    }
}

/// Returns a moving camera with a rolling shutter, and the pixels that it would use at half size.
fn scene() -> Scene {
    scene_of(cloth(1))
}

/// Returns the same for a flat cloth and for a folded one.
fn scenes() -> [Scene; 2] {
    [scene(), scene_of(SurfaceSpec { shape: folds(), ..cloth(1) })]
}

fn scene_of(surface: SurfaceSpec) -> Scene {
    let pose = facing(0.2, -0.3, Vector3::new(0.1, 0.05, 3.4));
    let motion = Motion {
        velocity: Vector3::new(0.3, -0.2, 0.1),
        angular_velocity: Vector3::new(0.2, -0.4, 0.3),
        acceleration: Vector3::new(1.0, 0.5, -0.5),
        angular_acceleration: Vector3::new(2.0, 1.0, -3.0),
        ..Motion::still(pose.inverse())
    };
    let camera = lens(480, 360);
    let mut levels = FrameLevels::default();
    levels.update(&view(&surface, &pose, &camera));
    let slow = OnlineCalibration::new(Shutter { readout_s: 0.012, exposure_s: 0.01 });
    let (surfaces, rays, pixels) = ([AlignSurface::new(&surface)], CameraRays::new(camera, None), Pixels::default());
    let mut scene = Scene { surfaces, slow, rays, motion, pixels };
    let (mut selector, mut pixels) = (Selector::default(), Pixels::default());
    let chosen = selector.choose(&scene.spec(), &motion);
    assert!((2000..6000).contains(&chosen.len()), "{}", chosen.len());
    pixels.arrange(chosen, &scene.spec(), levels.light(1), &RememberedLight::default());
    pixels.touch(&scene.spec(), &motion);
    assert_eq!(pixels.planes.is_empty(), surface.shape.is_flat());
    scene.pixels = pixels;
    scene
}

fn appearance(scene: &Scene, motion: &Motion, places: usize) -> Appearance {
    let mut out = Appearance::default();
    out.resize(scene.pixels.len());
    predict(&predicted(scene, motion, &LevelSpec { places, ..scene.spec() }), &mut out);
    out
}

fn predicted<'a>(scene: &'a Scene, motion: &'a Motion, spec: &'a LevelSpec<'a>) -> Predicted<'a> {
    Predicted { surface: &scene.surfaces[0], motion, spec, pixels: &scene.pixels, range: [0, scene.pixels.len()] }
}

/// Maximum relative error of gradients fitted over samples against the derivative.
const SLOPE_ERROR: f64 = 0.04;

/// Returns slope and correlation of `y` over `x`.
fn line(x: &[f64], y: &[f64]) -> (f64, f64) {
    let sum = |f: &dyn Fn(f64, f64) -> f64| x.iter().zip(y).map(|(a, b)| f(*a, *b)).sum::<f64>();
    let (xx, yy, xy) = (sum(&|a, _| a * a), sum(&|_, b| b * b), sum(&|a, b| a * b));
    (xy / xx, xy / (xx * yy).sqrt())
}

#[test]
fn derivatives_by_the_pose_agree_with_differences() {
    for (scene, places) in scenes().iter().flat_map(|scene| [(scene, 1), (scene, 5)]) {
        let at = appearance(scene, &scene.motion, places);
        for k in 0..6 {
            let mut step = MotionError::zeros();
            step[k] = if k < 3 { 4e-4 } else { 1e-4 };
            let plus = appearance(scene, &scene.motion.corrected(&step), places);
            let minus = appearance(scene, &scene.motion.corrected(&-step), places);
            let differences: Vec<f64> =
                plus.intensity.iter().zip(&minus.intensity).map(|(p, m)| f64::from(p - m) / (2.0 * step[k])).collect();
            let derivatives: Vec<f64> = at.by_pose[k].iter().map(|v| f64::from(*v)).collect();
            let (slope, correlation) = line(&derivatives, &differences);
            // Derivatives are slopes over a pixel's samples: for the finest detail they are some
            // percent too steep.
            assert!((slope - 1.0).abs() < SLOPE_ERROR && correlation > 0.99, "places {places}, {k}: {slope} {correlation}");
        }
    }
}

#[test]
fn velocity_acts_through_the_time_of_the_row() {
    let scene = scene();
    let at = appearance(&scene, &scene.motion, 1);
    for k in 0..6 {
        let mut step = MotionError::zeros();
        step[6 + k] = if k < 3 { 0.1 } else { 0.03 };
        let plus = appearance(&scene, &scene.motion.corrected(&step), 1);
        let minus = appearance(&scene, &scene.motion.corrected(&-step), 1);
        let differences: Vec<f64> =
            plus.intensity.iter().zip(&minus.intensity).map(|(p, m)| f64::from(p - m) / (2.0 * step[6 + k])).collect();
        let derivatives: Vec<f64> = at.by_pose[k].iter().zip(&scene.pixels.delay_s).map(|(v, t)| f64::from(v * t)).collect();
        let (slope, correlation) = line(&derivatives, &differences);
        assert!((slope - 1.0).abs() < SLOPE_ERROR && correlation > 0.99, "{k}: {slope} {correlation}");
    }
}

/// Returns the prediction with its derivatives by the velocity.
fn appearance_by_velocity(scene: &Scene, places: usize, predict: impl Fn(&Predicted, &mut Appearance)) -> Appearance {
    let mut out = Appearance::default();
    out.resize(scene.pixels.len());
    out.make_room_for_velocity();
    predict(&predicted(scene, &scene.motion, &LevelSpec { places, ..scene.spec() }), &mut out);
    out
}

#[test]
fn blur_derivatives_by_velocity_agree_with_differences() {
    for (mut scene, places) in scenes().into_iter().map(|scene| (scene, 5)).chain([3, 9, 15].map(|places| (scene(), places))) {
        // Some pixels of blur. A point that moves this fast and rotates as well follows a curve.
        scene.slow.shutter.exposure_s = 0.04;
        let at = appearance_by_velocity(&scene, places, predict_by_velocity);
        let same = appearance(&scene, &scene.motion, places);
        assert!(at.intensity == same.intensity && at.by_pose == same.by_pose);
        for k in 0..6 {
            let mut step = MotionError::zeros();
            step[6 + k] = if k < 3 { 0.04 } else { 0.01 };
            let plus = appearance(&scene, &scene.motion.corrected(&step), places);
            let minus = appearance(&scene, &scene.motion.corrected(&-step), places);
            // Later rows also see another part of the picture, which is not blur.
            let by_row = at.by_pose[k].iter().zip(&scene.pixels.delay_s).map(|(v, t)| f64::from(v * t));
            let differences = plus.intensity.iter().zip(&minus.intensity).map(|(p, m)| f64::from(p - m) / (2.0 * step[6 + k]));
            let differences: Vec<f64> = differences.zip(by_row).map(|(all, by_row)| all - by_row).collect();
            let derivatives: Vec<f64> = at.by_velocity[k].iter().map(|v| f64::from(*v)).collect();
            let (slope, correlation) = line(&derivatives, &differences);
            // Where a place is sampled along one diagonal only, the other is taken from its
            // neighbours.
            let (slope_error, least) = if places <= 5 { (SLOPE_ERROR, 0.99) } else { (1.7 * SLOPE_ERROR, 0.97) };
            assert!((slope - 1.0).abs() < slope_error && correlation > least, "places {places}, {k}: {slope} {correlation}");
        }
    }
}

#[test]
fn the_scalar_twin_has_the_same_derivatives_by_velocity() {
    for places in [1, 3, 9] {
        let scene = scene();
        let fast = appearance_by_velocity(&scene, places, predict_by_velocity);
        let plain = appearance_by_velocity(&scene, places, predict_by_velocity_lanes::<Plain>);
        let difference = fast.by_velocity[3].iter().zip(&plain.by_velocity[3]).map(|(a, b)| f64::from((a - b).abs())).sum::<f64>();
        let size = plain.by_velocity[3].iter().map(|v| f64::from(v.abs())).sum::<f64>();
        assert!(difference <= 2e-3 * size && (size > 0.0) == (places > 1), "{places}: {difference} of {size}");
    }
}

#[test]
fn gradients_by_pixels_agree_with_differences() {
    let mut scene = scene();
    let at = appearance(&scene, &scene.motion, 1);
    let (x, y) = (scene.pixels.x.clone(), scene.pixels.y.clone());
    let mut shifted = |across: f32, down: f32| {
        for k in 0..x.len() {
            scene.pixels.x[k] = x[k] + scene.pixels.x_across[k] * across + scene.pixels.x_down[k] * down;
            scene.pixels.y[k] = y[k] + scene.pixels.y_across[k] * across + scene.pixels.y_down[k] * down;
        }
        appearance(&scene, &scene.motion, 1).intensity
    };
    for (gradient, plus, minus) in [(&at.across, shifted(0.1, 0.0), shifted(-0.1, 0.0)), (&at.down, shifted(0.0, 0.1), shifted(0.0, -0.1))]
    {
        let differences: Vec<f64> = plus.iter().zip(&minus).map(|(p, m)| f64::from(p - m) / 0.2).collect();
        let gradients: Vec<f64> = gradient.iter().map(|v| f64::from(*v)).collect();
        let (slope, correlation) = line(&gradients, &differences);
        assert!((slope - 1.0).abs() < SLOPE_ERROR && correlation > 0.99, "{slope} {correlation}");
    }
}

#[test]
fn the_scalar_twin_predicts_the_same() {
    for (scene, places) in scenes().iter().flat_map(|scene| [1, 3, 9].map(|places| (scene, places))) {
        let fast = appearance(scene, &scene.motion, places);
        let mut plain = Appearance::default();
        plain.resize(scene.pixels.len());
        predict_lanes::<Plain>(&predicted(scene, &scene.motion, &LevelSpec { places, ..scene.spec() }), &mut plain);
        let largest = fast.intensity.iter().zip(&plain.intensity).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(largest < 0.1, "{largest}");
        let mean = fast.by_pose[3].iter().zip(&plain.by_pose[3]).map(|(a, b)| f64::from((a - b).abs())).sum::<f64>();
        assert!(mean < 1e-3 * plain.by_pose[3].iter().map(|v| f64::from(v.abs())).sum::<f64>());
    }
}

#[test]
fn scalar_twins_and_column_products_give_the_same_sums() {
    let scene = scene();
    let at = appearance(&scene, &scene.motion, 1);
    let noise = Noise { dark: 0.6, per_intensity: 0.01, model_px: 0.01 };
    let mut found = Residuals::default();
    found.resize(scene.pixels.len());
    let weighting = RobustWeighting { residual_sigma: 3.0, is_first_pass: false, stride: 1 };
    let mut step = [0.0; COLUMNS];
    step[BIAS] = 0.5;
    let mut products = Box::<ProductBuffer>::default();
    for run in scene.pixels.runs() {
        let tile = scene.pixels.light_of(run);
        residuals(&scene.pixels, run, &at, &tile, &noise, &mut found);
        let view = RunView { pixels: &scene.pixels, run, appearance: &at, light: &tile, residuals: &found };
        let fast = tile_equations(&view, None, &step, &weighting, &mut products);
        let plain = tile_equations_lanes::<Plain>(&view, None, &step, &weighting, &mut products);
        assert!(fast.rows.is_none() && plain.rows.is_none());
        for (i, j) in (0..=COLUMNS).flat_map(|i| (i..=COLUMNS).map(move |j| (i, j))) {
            let size = (plain.sums.product(i, i) * plain.sums.product(j, j)).sqrt();
            assert!((fast.sums.product(i, j) - plain.sums.product(i, j)).abs() < 1e-3 * size + 1e-3, "{i} {j}");
        }
        assert_products(&view, 0.0, &step, &weighting, &plain);
        let (fast, plain) = (evidence(&view, &step, &weighting), evidence_lanes::<Plain>(&view, &step, &weighting));
        let all = |e: &RunEvidence| [&[e.count, e.inliers, e.squared_px][..], &e.moments, &e.shift, &e.place, &e.blur].concat();
        assert_near(&all(&fast), &all(&plain));
        let (fast, plain) = (noise_sums(&view, &step, &weighting), noise_sums_lanes::<Plain>(&view, &step, &weighting));
        assert_near(&fast.map(f64::from), &plain.map(f64::from));
        let squared = run.range().map(|k| f64::from(found.intensity[k].powi(2) * found.information[k] / 9.0));
        let in_plain: f64 = squared.zip(&scene.pixels.counts[run.range()]).map(|(s, n)| f64::from(*n) * tukey_cost(Some(s), 1.0)).sum();
        assert_near(&[robust_cost(&scene.pixels, run, &found, 3.0)], &[in_plain]);
        let n = moments(&scene.pixels, run, &at)[0];
        assert!(n <= f64::from(run.end - run.start) && n > 0.0);
    }
}

#[test]
fn derivatives_by_the_light_agree_with_differences() {
    let scene = scene();
    let at = appearance(&scene, &scene.motion, 1);
    let noise = Noise { dark: 0.6, per_intensity: 0.01, model_px: 0.01 };
    let mut out = Residuals::default();
    out.resize(scene.pixels.len());
    for run in scene.pixels.runs() {
        let light = TileLight { gains: [0.8, 0.9, 1.1, 1.2], psf_variance: 0.1, bias: 5.0 };
        let mut residual = |change: &dyn Fn(&mut TileLight)| {
            let mut changed = light;
            change(&mut changed);
            residuals(&scene.pixels, run, &at, &changed, &noise, &mut out);
            out.intensity[run.range()].to_vec()
        };
        let step = 0.125;
        let mut difference = |column: usize| {
            let by = |sign: f32| {
                move |light: &mut TileLight| match column {
                    PSF_VARIANCE => light.psf_variance += sign * step,
                    BIAS => light.bias += sign * step,
                    _ => light.gains[column - GAINS] += sign * step,
                }
            };
            let (minus, plus) = (residual(&by(-1.0)), residual(&by(1.0)));
            minus.iter().zip(plus).map(|(minus, plus)| (minus - plus) / (2.0 * step)).collect::<Vec<f32>>()
        };
        for column in POSE..COLUMNS {
            let difference = difference(column);
            for (n, k) in run.range().step_by(LANES).enumerate() {
                let (columns, _) = columns::<Plain>(&scene.pixels, &at, &light, k);
                for (found, expected) in lanes(columns[column]).iter().zip(&difference[n * LANES..]) {
                    assert!((found - expected).abs() < 1e-3 * expected.abs() + 2e-3, "{column}: {found} {expected}");
                }
            }
        }
    }
}

fn assert_near(fast: &[f64], plain: &[f64]) {
    let size = plain.iter().fold(1.0_f64, |most, v| most.max(v.abs()));
    for (n, (f, p)) in fast.iter().zip(plain).enumerate() {
        assert!((f - p).abs() < 2e-3 * p.abs() + 1e-5 * size, "{n}: {f} {p}");
    }
}

/// Compares the sums with their definition, pixel by pixel.
fn assert_products(view: &RunView, delay_s: f64, step: &[f32; COLUMNS], weighting: &RobustWeighting, found: &TileEquations) {
    // Indexed by the power of time.
    let mut sums = [[[0.0; COLUMNS + 1]; COLUMNS + 1]; 3];
    let mut longest = 0.0f64;
    for k in view.run.range().step_by(LANES * weighting.stride) {
        let (columns, _) = columns::<Plain>(view.pixels, view.appearance, view.light, k);
        let r = load_at::<Plain>(&view.residuals.intensity, k);
        let information = load_at::<Plain>(&view.residuals.information, k);
        let after = less_step(r, &columns, step);
        let w = lanes(weight(after.mul(after).mul(information), weighting).mul(information));
        let all: Vec<[f32; LANES]> = columns.into_iter().chain([r]).map(lanes).collect();
        for (lane, w) in w.iter().enumerate() {
            let d = f64::from(view.pixels.delay_s[k + lane]) - delay_s;
            longest = longest.max(d.abs());
            for (i, a) in all.iter().enumerate() {
                for (j, b) in all.iter().enumerate() {
                    let product = f64::from(*w) * f64::from(a[lane]) * f64::from(b[lane]);
                    for (power, sums) in sums.iter_mut().enumerate() {
                        sums[i][j] += product * d.powi(power as i32);
                    }
                }
            }
        }
    }
    let size = |i: usize, j: usize| (sums[0][i][i] * sums[0][j][j]).sqrt();
    for (i, j) in (0..=COLUMNS).flat_map(|i| (0..=COLUMNS).map(move |j| (i, j))) {
        assert!((found.sums.product(i, j) - sums[0][i][j]).abs() < 1e-4 * size(i, j) + 1e-4, "{i} {j}");
    }
    let Some(rows) = &found.rows else { return };
    for (i, j) in (0..6).flat_map(|i| (0..=COLUMNS).map(move |j| (i, j))) {
        let once = if j < 6 { rows.by_time()[entry(i, j)] } else { rows.by_other(i, j) };
        assert!((once - sums[1][i][j]).abs() <= 1e-4 * size(i, j) * longest, "{i} {j}: {once} {}", sums[1][i][j]);
        if j < 6 {
            let twice = rows.by_squared_time()[entry(i, j)];
            assert!((twice - sums[2][i][j]).abs() <= 1e-4 * size(i, j) * longest.powi(2), "{i} {j}: {twice} {}", sums[2][i][j]);
        }
    }
}

fn lanes(v: Plain) -> [f32; LANES] {
    let mut out = [0.0; LANES];
    v.store(&mut out);
    out
}

#[test]
fn every_run_is_whole_and_no_pixel_comes_twice() {
    let scene = scene();
    let mut seen = std::collections::HashSet::new();
    for run in scene.pixels.runs() {
        assert!((run.tile as usize) < scene.pixels.light().grid().len() && run.start < run.end);
        assert!(run.range().len().is_multiple_of(LANES) && run.start.is_multiple_of(LANES as u32));
        for k in run.start..run.end {
            let is_repeat = scene.pixels.is_repeat(k);
            assert!(seen.insert(scene.pixels.index[k as usize]) != is_repeat);
            assert!(!is_repeat || scene.pixels.counts[k as usize] == 0.0);
        }
    }
    // A camera that faces away sees nothing of the surface.
    let away = Motion::still(crate::geometry::Pose::new(UnitQuaternion::identity(), Vector3::new(0.0, 0.0, 3.0)));
    assert!(Selector::default().choose(&scene.spec(), &away).is_empty());
}

#[test]
fn sums_of_the_rows_are_products_of_the_columns_and_their_times() {
    let scene = scene();
    let at = appearance(&scene, &scene.motion, 1);
    let noise = Noise { dark: 3.0, per_intensity: 0.03, model_px: 0.02 };
    let mut found = Residuals::default();
    found.resize(scene.pixels.len());
    let step = std::array::from_fn(|c| 1e-3 * (c as f32 - 5.0));
    let mut products = Box::<ProductBuffer>::default();
    // Runs of one group, of a chunk, and of more than one: as arranged, and all pixels as one run.
    let all = Run { end: scene.pixels.len() as u32, ..scene.pixels.runs()[0] };
    for run in scene.pixels.runs().iter().chain([&all]) {
        let light = scene.pixels.light_of(run);
        residuals(&scene.pixels, run, &at, &light, &noise, &mut found);
        let view = RunView { pixels: &scene.pixels, run, appearance: &at, light: &light, residuals: &found };
        let delay_s = scene.pixels.delay_s[(run.start as usize + run.end as usize) / 2];
        for stride in [1, 3] {
            let weighting = RobustWeighting { residual_sigma: 1.3, is_first_pass: false, stride };
            let fast = tile_equations(&view, Some(delay_s), &step, &weighting, &mut products);
            assert_products(&view, f64::from(delay_s), &step, &weighting, &fast);
            let plain = tile_equations_lanes::<Plain>(&view, Some(delay_s), &step, &weighting, &mut products);
            assert_products(&view, f64::from(delay_s), &step, &weighting, &plain);
        }
    }
    // Nothing of one run leaks into the next.
    let none = Run { end: all.start, ..all };
    let light = scene.pixels.light_of(&all);
    let view = RunView { pixels: &scene.pixels, run: &none, appearance: &at, light: &light, residuals: &found };
    let weighting = RobustWeighting { residual_sigma: 1.3, is_first_pass: false, stride: 1 };
    assert_products(&view, 0.0, &step, &weighting, &tile_equations(&view, Some(0.0), &step, &weighting, &mut products));
}
