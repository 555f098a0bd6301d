//! Time to track whole frames of the rendered dolly, on one thread.
//!
//! `cargo bench --bench frame`

use std::time::{Duration, Instant};

use criterion::{Criterion, criterion_group, criterion_main};
use stagepose::diagnostics::capture::VirtualCamera;
use stagepose::{ClipEntry, Dolly, FrameSource, State, Tracker, TrackerSetup, dolly, track_entry};

/// Frames per pass; every pass starts with a new tracker, whose preparation is not counted.
const FRAMES: u64 = 12;

fn frames(c: &mut Criterion) {
    for (width, height) in [(640, 480), (1280, 720)] {
        let choice = Dolly { width, height, seed: 1, duration_s: 1.0, artwork_width: 1600 };
        let mut camera = VirtualCamera::new(dolly(choice).expect("a scene"), 30.0, FRAMES);
        let rows: Vec<ClipEntry> = std::iter::from_fn(|| camera.next_entry()).collect();
        let setup = TrackerSetup::from(camera.stage());
        c.bench_function(&format!("track a frame {width}x{height}"), |b| {
            b.iter_custom(|iterations| (0..iterations).map(|_| pass(&setup, &rows)).sum::<Duration>() / FRAMES as u32)
        });
    }
}

/// Returns the time to track all rows.
fn pass(setup: &TrackerSetup, rows: &[ClipEntry]) -> Duration {
    let mut tracker = Tracker::new(setup.clone()).expect("a setup that fits");
    let start = Instant::now();
    let tracked = rows.iter().filter(|row| track_entry(&mut tracker, row).state == State::Tracking).count();
    let spent = start.elapsed();
    assert_eq!(tracked as u64, FRAMES - 1, "a lost frame costs less than a tracked one");
    spent
}

criterion_group! {
    name = whole_frames;
    config = Criterion::default().sample_size(10);
    targets = frames
}
criterion_main!(whole_frames);
