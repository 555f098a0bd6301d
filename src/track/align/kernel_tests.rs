//! The kernels against differences and against their plain twins.

use nalgebra::{UnitQuaternion, Vector3};

use super::appearance::{Appearance, Predicted, predict, predict_lanes};
use super::evidence::{RunEvidence, evidence, evidence_lanes};
use super::frame_levels::FrameLevels;
use super::lanes::{LANES, Lanes, Plain, load_at};
use super::light::RememberedLight;
use super::motion::{Motion, MotionError};
use super::noise::{Noise, noise_sums, noise_sums_lanes};
use super::normal::{
    COLUMNS, Residuals, RunView, TileSums, Weighing, columns, less_step, moments, residuals, tile_sums, tile_sums_lanes, weight,
};
use super::pixels::{Pixels, Source};
use super::rows::{row_sums, row_sums_lanes};
use super::selection::{Choice, Selector};
use super::tile_equations::entry;
use super::{AlignSurface, Eye, Sensor};
use crate::track::synthetic::{cloth, facing, lens, view};

struct Scene {
    surface: AlignSurface,
    motion: Motion,
    sensor: Sensor,
    pixels: Pixels,
}

/// A moving camera with a rolling shutter, and the pixels that it would ask at half size.
fn scene() -> Scene {
    let pose = facing(0.2, -0.3, Vector3::new(0.1, 0.05, 3.4));
    let motion = Motion {
        velocity: Vector3::new(0.3, -0.2, 0.1),
        turn_rate: Vector3::new(0.2, -0.4, 0.3),
        acceleration: Vector3::new(1.0, 0.5, -0.5),
        turn_acceleration: Vector3::new(2.0, 1.0, -3.0),
        ..Motion::still(pose.inverse())
    };
    let camera = lens(480, 360);
    let frame = view(&cloth(1), &pose, &camera);
    let mut levels = FrameLevels::default();
    levels.update(&frame);
    let eye = Eye::new(camera, None);
    let surface = AlignSurface::new(&cloth(1));
    let sensor = Sensor { readout_s: 0.012, exposure_s: 0.01 };
    let table = eye.tables[1].as_ref().expect("levels above 0 have tables");
    let choice = Choice { camera: &eye.camera, table, level: 1, sensor, blur_px: 0.0, count: 3000, is_dense: false };
    let mut chosen = Vec::new();
    Selector::default().choose(std::slice::from_ref(&surface), &motion, &choice, &mut chosen);
    assert!((2000..6000).contains(&chosen.len()), "{}", chosen.len());
    let mut pixels = Pixels::default();
    pixels.arrange(&chosen, 1, &Source { l: 1, level: levels.level(1), table, sensor: &sensor, height: 360 }, &RememberedLight::default());
    Scene { surface, motion, sensor, pixels }
}

fn appearance(scene: &Scene, motion: &Motion, places: usize) -> Appearance {
    let mut out = Appearance::default();
    out.resize(scene.pixels.len());
    predict(&predicted(scene, motion, places), &mut out);
    out
}

fn predicted<'a>(scene: &'a Scene, motion: &'a Motion, places: usize) -> Predicted<'a> {
    let Scene { surface, sensor, pixels, .. } = scene;
    Predicted { surface, motion, sensor, places, side: 3, is_enlarged: true, slope_share: 1.0, pixels, range: [0, pixels.len()] }
}

/// How far slopes over looks may be from the derivative.
const SLOPE_ERROR: f64 = 0.04;

/// Slope and correlation of `y` over `x`.
fn line(x: &[f64], y: &[f64]) -> (f64, f64) {
    let sum = |f: &dyn Fn(f64, f64) -> f64| x.iter().zip(y).map(|(a, b)| f(*a, *b)).sum::<f64>();
    let (xx, yy, xy) = (sum(&|a, _| a * a), sum(&|_, b| b * b), sum(&|a, b| a * b));
    (xy / xx, xy / (xx * yy).sqrt())
}

#[test]
fn derivatives_by_the_pose_agree_with_differences() {
    let scene = scene();
    for places in [1, 5] {
        let at = appearance(&scene, &scene.motion, places);
        for k in 0..6 {
            let mut step = MotionError::zeros();
            step[k] = if k < 3 { 4e-4 } else { 1e-4 };
            let plus = appearance(&scene, &scene.motion.corrected(&step), places);
            let minus = appearance(&scene, &scene.motion.corrected(&-step), places);
            let differences: Vec<f64> = plus.grey.iter().zip(&minus.grey).map(|(p, m)| f64::from(p - m) / (2.0 * step[k])).collect();
            let derivatives: Vec<f64> = at.by_pose[k].iter().map(|v| f64::from(*v)).collect();
            let (slope, correlation) = line(&derivatives, &differences);
            // Derivatives are slopes over a pixel's looks: of the finest detail they are some percent too steep.
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
        let differences: Vec<f64> = plus.grey.iter().zip(&minus.grey).map(|(p, m)| f64::from(p - m) / (2.0 * step[6 + k])).collect();
        let derivatives: Vec<f64> = at.by_pose[k].iter().zip(&scene.pixels.delay_s).map(|(v, t)| f64::from(v * t)).collect();
        let (slope, correlation) = line(&derivatives, &differences);
        assert!((slope - 1.0).abs() < SLOPE_ERROR && correlation > 0.99, "{k}: {slope} {correlation}");
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
        appearance(&scene, &scene.motion, 1).grey
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
fn the_plain_twin_predicts_the_same() {
    let scene = scene();
    for places in [1, 3, 9] {
        let fast = appearance(&scene, &scene.motion, places);
        let mut plain = Appearance::default();
        plain.resize(scene.pixels.len());
        predict_lanes::<Plain>(&predicted(&scene, &scene.motion, places), &mut plain);
        let largest = fast.grey.iter().zip(&plain.grey).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(largest < 0.1, "{largest}");
        let mean = fast.by_pose[3].iter().zip(&plain.by_pose[3]).map(|(a, b)| f64::from((a - b).abs())).sum::<f64>();
        assert!(mean < 1e-3 * plain.by_pose[3].iter().map(|v| f64::from(v.abs())).sum::<f64>());
    }
}

#[test]
fn plain_twins_sum_the_same_and_sums_are_products_of_the_columns() {
    let scene = scene();
    let at = appearance(&scene, &scene.motion, 1);
    let noise = Noise { dark: 0.6, per_grey: 0.01, model_px: 0.01 };
    let mut found = Residuals::default();
    found.resize(scene.pixels.len());
    let weighing = Weighing { scale: 3.0, is_first_look: false, stride: 1 };
    let mut step = [0.0; COLUMNS];
    step[7] = 0.5;
    for run in scene.pixels.runs() {
        let tile = scene.pixels.light_of(run);
        residuals(&scene.pixels, run, &at, &tile, &noise, &mut found);
        let view = RunView { pixels: &scene.pixels, run, appearance: &at, light: &tile, residuals: &found };
        let fast = tile_sums(&view, &step, &weighing);
        let plain = tile_sums_lanes::<Plain>(&view, &step, &weighing);
        for i in 0..=COLUMNS {
            for j in i..=COLUMNS {
                let size = (plain.product(i, i) * plain.product(j, j)).sqrt();
                assert!((fast.product(i, j) - plain.product(i, j)).abs() < 1e-3 * size + 1e-3, "{i} {j}");
            }
        }
        assert_products(&view, &step, &weighing, &plain);
        let (fast, plain) = (evidence(&view, &step, &weighing), evidence_lanes::<Plain>(&view, &step, &weighing));
        let all = |e: &RunEvidence| [&[e.count, e.inliers, e.squared_px][..], &e.moments, &e.shift, &e.place, &e.blur].concat();
        assert_near(&all(&fast), &all(&plain));
        let (fast, plain) = (noise_sums(&view, &step, &weighing), noise_sums_lanes::<Plain>(&view, &step, &weighing));
        assert_near(&fast.map(f64::from), &plain.map(f64::from));
        let n = moments(&scene.pixels, run, &at)[0];
        assert!(n <= f64::from(run.end - run.start) && n > 0.0);
    }
}

fn assert_near(fast: &[f64], plain: &[f64]) {
    let size = plain.iter().fold(1.0_f64, |most, v| most.max(v.abs()));
    for (n, (f, p)) in fast.iter().zip(plain).enumerate() {
        assert!((f - p).abs() < 2e-3 * p.abs() + 1e-5 * size, "{n}: {f} {p}");
    }
}

/// The sums as they are defined: pixel by pixel.
fn assert_products(view: &RunView, step: &[f32; COLUMNS], weighing: &Weighing, found: &TileSums) {
    let mut sums = [[0.0; COLUMNS + 1]; COLUMNS + 1];
    for k in view.run.range().step_by(LANES) {
        let (columns, _) = columns::<Plain>(view.pixels, view.appearance, view.light, k);
        let r = load_at::<Plain>(&view.residuals.grey, k);
        let information = load_at::<Plain>(&view.residuals.information, k);
        let after = less_step(r, &columns, step);
        let w = lanes(weight(after.mul(after).mul(information), weighing).mul(information));
        let all: Vec<[f32; LANES]> = columns.into_iter().chain([r]).map(lanes).collect();
        for (lane, w) in w.iter().enumerate() {
            for (i, a) in all.iter().enumerate() {
                for (j, b) in all.iter().enumerate() {
                    sums[i][j] += f64::from(*w) * f64::from(a[lane]) * f64::from(b[lane]);
                }
            }
        }
    }
    for i in 0..=COLUMNS {
        for j in 0..=COLUMNS {
            let size = (sums[i][i] * sums[j][j]).sqrt();
            assert!((found.product(i, j) - sums[i][j]).abs() < 1e-4 * size + 1e-4, "{i} {j}");
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
    // A camera that turned away sees none of the surface.
    let away = Motion::still(crate::geometry::Pose::new(UnitQuaternion::identity(), Vector3::new(0.0, 0.0, 3.0)));
    let eye = Eye::new(lens(480, 360), None);
    let table = eye.tables[1].as_ref().expect("levels above 0 have tables");
    let choice = Choice { camera: &eye.camera, table, level: 1, sensor: scene.sensor, blur_px: 0.0, count: 3000, is_dense: false };
    let mut chosen = Vec::new();
    Selector::default().choose(std::slice::from_ref(&scene.surface), &away, &choice, &mut chosen);
    assert!(chosen.is_empty());
}

#[test]
fn sums_of_the_rows_are_products_of_the_columns_and_their_times() {
    let scene = scene();
    let at = appearance(&scene, &scene.motion, 1);
    let noise = Noise { dark: 3.0, per_grey: 0.03, model_px: 0.02 };
    let mut found = Residuals::default();
    found.resize(scene.pixels.len());
    let weighing = Weighing { scale: 1.3, is_first_look: false, stride: 1 };
    let step = std::array::from_fn(|c| 1e-3 * (c as f32 - 5.0));
    for run in scene.pixels.runs() {
        let light = scene.pixels.light_of(run);
        residuals(&scene.pixels, run, &at, &light, &noise, &mut found);
        let view = RunView { pixels: &scene.pixels, run, appearance: &at, light: &light, residuals: &found };
        // With the frame's own stamp as the tile's time, times are delays.
        let rows = row_sums(&view, 0.0, &step, &weighing);
        let plain = row_sums_lanes::<Plain>(&view, 0.0, &step, &weighing);
        let mut all = Vec::new();
        for i in 0..6 {
            for c in i..=COLUMNS {
                let of = |sums: &super::rows::RowSums| if c < 6 { sums.by_time()[entry(i, c)] } else { sums.by_other(i, c) };
                all.push((of(&rows), of(&plain)));
                if c < 6 {
                    all.push((rows.by_squared_time()[entry(i, c)], plain.by_squared_time()[entry(i, c)]));
                    assert!(i != c || rows.by_squared_time()[entry(i, c)] >= 0.0);
                }
            }
        }
        let largest = all.iter().map(|(a, _)| a.abs()).fold(0.0, f64::max);
        assert!(all.iter().all(|(a, b)| (a - b).abs() <= 1e-3 * largest), "{all:?}");
    }
    // Where all rows of a run are as late, the sums are those of the tile times the delay.
    let mut late = scene;
    late.pixels.delay_s.fill(0.004);
    let run = late.pixels.runs()[0];
    let light = late.pixels.light_of(&run);
    residuals(&late.pixels, &run, &at, &light, &noise, &mut found);
    let view = RunView { pixels: &late.pixels, run: &run, appearance: &at, light: &light, residuals: &found };
    let (rows, sums) = (row_sums(&view, 0.0, &step, &weighing), tile_sums(&view, &step, &weighing));
    for i in 0..6 {
        let near = |a: f64, b: f64| (a - b).abs() <= 1e-3 * sums.product(i, i).abs() * 0.004 + 1e-4 * b.abs();
        assert!(near(rows.by_time()[entry(i, i)], 0.004 * sums.product(i, i)), "{i}");
        assert!(near(rows.by_squared_time()[entry(i, i)], 0.004f64.powi(2) * sums.product(i, i)), "{i}");
    }
}
