//! Start-up time and memory of a tracker with four surfaces, with no kept views and with kept views
//! of the pictures.
//!
//! `cargo bench --bench start` paints pictures of 1024 to 2048 pixels; `-- PICTURE...` takes
//! others. Each time is the shortest of five.

use std::collections::BTreeMap;
use std::process::ExitCode;
use std::sync::{Arc, Mutex};
use std::time::Instant;

use image::GrayImage;
use nalgebra::Vector3;
use stagepose::diagnostics::simulate::{artwork_surface, grey, paint, upright};
use stagepose::{BodySpec, CameraModel, Tracker, TrackerSetup, ViewStore};

/// Promised limits: milliseconds with nothing kept, milliseconds with everything kept, megabytes.
const MAX_COLD_MS: f64 = 2000.0;
const MAX_WARM_MS: f64 = 200.0;
const MAX_MB: u64 = 250;
const SIZES: [(u32, u32); 4] = [(2048, 1536), (1800, 1350), (1400, 1050), (1024, 768)];
const ROUNDS: usize = 5;

#[derive(Debug, Default)]
struct Memory(Mutex<BTreeMap<String, Vec<u8>>>);

impl ViewStore for Memory {
    fn load(&self, name: &str) -> Option<Vec<u8>> {
        self.0.lock().ok()?.get(name).cloned()
    }

    fn store(&self, name: &str, bytes: &[u8]) {
        if let Ok(mut kept) = self.0.lock() {
            kept.insert(name.to_owned(), bytes.to_owned());
        }
    }
}

fn setup(pictures: Vec<GrayImage>) -> TrackerSetup {
    let surfaces = pictures.into_iter().enumerate().map(|(k, picture)| {
        let size_m = [4.0, 4.0 * f64::from(picture.height()) / f64::from(picture.width())];
        artwork_surface(&format!("picture {k}"), picture, size_m, upright(Vector3::new(5.0 * k as f64, 0.0, 1.5), 0.0))
    });
    let camera = CameraModel::pinhole(1280, 720, 1000.0, 1000.0, 639.5, 359.5).expect("a pinhole with a focal length");
    TrackerSetup::new(camera, BodySpec::new("stage", surfaces.collect()))
}

/// Returns the duration of a start, milliseconds.
fn started(setup: &TrackerSetup) -> f64 {
    let setup = setup.clone();
    let start = Instant::now();
    let tracker = Tracker::new(setup).expect("a setup that fits");
    let spent = start.elapsed();
    drop(tracker);
    1e3 * spent.as_secs_f64()
}

/// Returns the peak memory of this process since [`forget_peak`], megabytes.
fn peak_mb() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap_or("0");
    line.split_whitespace().next().and_then(|kb| kb.parse::<u64>().ok()).unwrap_or(0) / 1024
}

fn forget_peak() {
    // If the peak cannot be reset, it includes painting the pictures.
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}

fn main() -> ExitCode {
    let files: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    let painted = SIZES.iter().zip(1..).map(|((width, height), seed)| grey(&paint(*width, *height, seed)));
    let pictures: Vec<GrayImage> = match files.as_slice() {
        [] => painted.collect(),
        files => files.iter().map(|file| image::open(file).unwrap_or_else(|e| panic!("{file}: {e}")).to_luma8()).collect(),
    };
    let sizes: Vec<String> = pictures.iter().map(|p| format!("{}x{}", p.width(), p.height())).collect();
    let setup = setup(pictures);
    forget_peak();
    let shortest = |setup: &dyn Fn() -> TrackerSetup| (0..ROUNDS).map(|_| started(&setup())).fold(f64::INFINITY, f64::min);
    let without = shortest(&|| setup.clone());
    let with = |memory: &Arc<Memory>| {
        let mut setup = setup.clone();
        setup.store = Some(memory.clone());
        setup
    };
    let cold = shortest(&|| with(&Arc::default()));
    let memory = Arc::default();
    started(&with(&memory));
    let warm = shortest(&|| with(&memory));
    let bytes: usize = memory.0.lock().map_or(0, |kept| kept.values().map(Vec::len).sum());
    let peak = peak_mb();
    println!(
        "{}: without a store {without:.0} ms, cold {cold:.0} ms, warm {warm:.0} ms; {} kB kept; at most {peak} MB",
        sizes.join(", "),
        bytes >> 10
    );
    let is_kept = cold <= MAX_COLD_MS && warm <= MAX_WARM_MS && peak <= MAX_MB;
    println!("{}: cold {MAX_COLD_MS} ms, warm {MAX_WARM_MS} ms, {MAX_MB} MB at most", if is_kept { "within" } else { "MISSED" });
    ExitCode::from(u8::from(!is_kept))
}
