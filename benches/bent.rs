//! Cost of a bent surface relative to a flat one. One thread tracks the same dolly past the same
//! pictures twice: flat, and hung in folds of known shape. The two take turns frame by frame, so
//! that other load on the machine affects both.
//!
//! `cargo bench --bench bent`; `-- --check` ends with 1 if a bent frame costs more than 1.25 times
//! a flat one.

use std::process::ExitCode;
use std::sync::Arc;
use std::time::Instant;

use stagepose::diagnostics::capture::VirtualCamera;
use stagepose::diagnostics::geometry::BicubicSpline;
use stagepose::diagnostics::track::{BentShape, ShapeWay, SurfaceShape};
use stagepose::nalgebra::{Vector1, Vector2};
use stagepose::{ClipEntry, Dolly, FrameSource, State, Tracker, TrackerSetup, VirtualStage, dolly, track_entry};

/// Frames per pass, and number of passes. Raised, the ratio scatters less; rendering a frame of
/// bent cloth takes seconds.
const FRAMES: u64 = 14;
const PASSES: usize = 6;
/// Uncounted frames at the start of a pass, in which the tracker finds the stage and its buffers
/// grow.
const FIRST: usize = 3;
/// Maximum cost of a bent frame, in flat frames.
const MOST: f64 = 1.25;
/// Knot spacing of the heights and of the stretch, metres, and the number of modes in which a shape
/// may be off; both as in a survey.
const KNOT_M: [f64; 2] = [0.154, 0.67];
const WAYS: usize = 24;

fn main() -> ExitCode {
    let choice = Dolly { width: 1280, height: 720, seed: 1, duration_s: 2.0, artwork_width: 1600 };
    let flat = dolly(choice).expect("a scene");
    let mut bent = flat.clone();
    for surface in &mut bent.stage.surfaces {
        surface.shape = folds(surface.size_m);
    }
    let [flat, bent] = [flat, bent].map(Filmed::new);
    let (mut flat_ms, mut bent_ms) = (Vec::new(), Vec::new());
    for _ in 0..PASSES {
        let mut trackers = [&flat, &bent].map(Filmed::tracker);
        for k in 0..FRAMES as usize {
            for ((film, tracker), times) in [&flat, &bent].iter().zip(&mut trackers).zip([&mut flat_ms, &mut bent_ms]) {
                let start = Instant::now();
                let sample = track_entry(tracker, &film.rows[k]);
                let spent_ms = 1e3 * start.elapsed().as_secs_f64();
                if k >= FIRST {
                    assert_eq!(sample.state, State::Tracking, "a lost frame costs less than a tracked one");
                    times.push(spent_ms);
                }
            }
        }
    }
    let [flat_ms, bent_ms] = [median(flat_ms), median(bent_ms)];
    let ratio = bent_ms / flat_ms;
    println!("a flat frame {flat_ms:.2} ms, a bent one {bent_ms:.2} ms (medians): {ratio:.3} times");
    let is_checked = std::env::args().any(|a| a == "--check");
    if is_checked && ratio > MOST { ExitCode::FAILURE } else { ExitCode::SUCCESS }
}

/// A stage with its frames.
struct Filmed {
    setup: TrackerSetup,
    rows: Vec<ClipEntry>,
}

impl Filmed {
    fn new(stage: VirtualStage) -> Self {
        let setup = TrackerSetup::from(&stage);
        let mut camera = VirtualCamera::new(stage, 30.0, FRAMES);
        Self { setup, rows: std::iter::from_fn(|| camera.next_entry()).collect() }
    }

    fn tracker(&self) -> Tracker {
        Tracker::new(self.setup.clone()).expect("a setup that fits")
    }
}

/// Folds of at most 18 mm with some stretch, and modes in which they may be off by tenths of a
/// millimetre.
fn folds(size_m: [f64; 2]) -> SurfaceShape {
    let [knots, coarse] = KNOT_M.map(|knot_m| size_m.map(|side| (side / knot_m).ceil() as usize));
    let height = |at_mm: &dyn Fn(f64, f64) -> f64| {
        let mut out = BicubicSpline::zero(knots, size_m);
        let middle = out.middles();
        for (k, c) in out.coefficients_mut().iter_mut().enumerate() {
            let [x, y] = middle(k);
            *c = Vector1::new(1e-3 * at_mm(x, y));
        }
        out
    };
    let stretch = |at_mm: &dyn Fn(f64, f64) -> [f64; 2]| {
        let mut out = BicubicSpline::zero(coarse, size_m);
        let middle = out.middles();
        for (k, c) in out.coefficients_mut().iter_mut().enumerate() {
            let [x, y] = middle(k);
            *c = Vector2::from(at_mm(x, y)) * 1e-3;
        }
        out
    };
    let way = |k: usize| {
        let rate = 0.3 * k as f64;
        ShapeWay {
            height: height(&|x, y| 0.2 * (rate * x + 0.7 * y).sin()),
            stretch: stretch(&|x, y| [0.05 * (rate * y).sin(), 0.05 * (rate * x).cos()]),
        }
    };
    SurfaceShape::Bent(Arc::new(BentShape {
        height: height(&|x, y| 12.0 * (9.0 * x + 0.8 * y).sin() + 6.0 * (2.3 * y - 0.7 * x).cos()),
        stretch: stretch(&|x, y| [2.0 * (1.5 * x + y).sin(), 1.5 * (1.3 * y - x).sin()]),
        ways: (0..WAYS).map(way).collect(),
    }))
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
