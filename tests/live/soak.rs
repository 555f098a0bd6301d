//! Thousands of frames with random faults from a seed: no panic escapes, no pose is wrong, and
//! memory does not grow.
//!
//! `STAGEPOSE_SOAK_FRAMES=10000 cargo test --test stagepose soak -- --nocapture` runs a long
//! version and prints its findings.

use std::sync::atomic::Ordering;

use stagepose::diagnostics::live::LiveLink;
use stagepose::{Daemon, Reason, State, Tracker};

use super::faulty::{Faulty, source, take, tracker_setup};

/// Errors above which a pose is wrong.
const MAX_M: f64 = 0.1;
const MAX_DEG: f64 = 2.0;

/// Returns the resident memory of this process, megabytes.
fn resident_mb() -> f64 {
    let statm = std::fs::read_to_string("/proc/self/statm").unwrap();
    statm.split(' ').nth(1).unwrap().parse::<f64>().unwrap() * 4096.0 / 1e6
}

#[test]
fn soak() {
    let frames: u64 = std::env::var("STAGEPOSE_SOAK_FRAMES").ok().and_then(|n| n.parse().ok()).unwrap_or(400);
    let faulty = Faulty::random(2026, 40, frames);
    let tracker = Tracker::new(tracker_setup()).expect("a setup that fits");
    let link = LiveLink::default();
    let mut daemon = Daemon::live(source(&faulty, &link), tracker);
    // This subscriber never reads: it must cost its queue and no more.
    let stalled = daemon.subscribe();
    let samples = daemon.subscribe();
    let count = faulty.clone();
    daemon.observe(move |_, _| {
        count.tracked.fetch_add(1, Ordering::Release);
    });
    let running = daemon.start().unwrap();
    let (mut tracking, mut stale, mut lens_moved, mut wrong, mut early_mb) = (0_u64, 0_u64, 0_u64, Vec::new(), 0.0);
    for sample in samples {
        lens_moved += u64::from(sample.reason == Some(Reason::LensMoved));
        match sample.state {
            State::Stale => stale += 1,
            State::Tracking => {
                tracking += 1;
                // A stage that the tracker does not know has no ground truth: any pose there is
                // wrong.
                let frame = faulty.shown.lock().unwrap().remove(&sample.timestamp);
                let measurement = sample.measurement.expect("a tracking sample");
                let (measured, measured_by) = (measurement.pose, (measurement.inliers, measurement.rms_px));
                let errors = frame.map(|frame| {
                    let truth = take().truths[frame];
                    ((measured.translation - truth.translation).norm(), measured.angle_to(&truth).to_degrees())
                });
                if errors.is_none_or(|(m, deg)| m > MAX_M || deg > MAX_DEG) {
                    println!(
                        "soak: WRONG POSE in frame {}: {errors:?} m and degrees off, inliers {:?}, rms {:?} px",
                        sample.sequence, measured_by.0, measured_by.1
                    );
                    wrong.push((sample.sequence, errors));
                }
            }
            _ => {
                faulty.shown.lock().unwrap().remove(&sample.timestamp);
            }
        }
        if early_mb == 0.0 && sample.sequence >= frames / 10 {
            early_mb = resident_mb();
        }
        if sample.state != State::Stale && (sample.sequence + 1).is_multiple_of(10_000) {
            println!("soak: {} frames so far, {} wrong poses, {:.1} MB", sample.sequence + 1, wrong.len(), resident_mb());
        }
    }
    running.join().expect("no stage panicked");
    let (s, late_mb) = (&link.statistics, resident_mb());
    let mut faults: Vec<_> = faulty.faults.lock().unwrap().clone().into_iter().collect();
    faults.sort();
    println!(
        "soak: {frames} frames, {tracking} tracking, {stale} stale messages, {} wrong poses, {lens_moved} alarms of the lens",
        wrong.len()
    );
    assert_eq!(lens_moved, 0, "nobody touched the lens");
    println!(
        "soak: {} reconnects, {} panics contained, {} undecodable, {} skipped",
        s.reconnects.get(),
        s.contained_panics.get(),
        s.undecodable.get(),
        s.skipped.get()
    );
    println!("soak: memory {early_mb:.1} MB after a tenth, {late_mb:.1} MB at the end; faults {faults:?}");
    let lost = faulty.lost.load(Ordering::Acquire);
    assert!(
        (frames - lost..=frames).contains(&s.frames()),
        "{} of {frames} frames came out, {lost} were lost with their readers",
        s.frames()
    );
    assert!(wrong.is_empty(), "{wrong:?}");
    assert!(tracking * 10 > frames * 8, "{tracking} of {frames} tracked");
    assert_eq!(stalled.len(), 256);
    // In a short run, other tests share the process.
    if frames >= 10_000 {
        assert!(late_mb - early_mb < 8.0, "memory grew from {early_mb:.1} to {late_mb:.1} MB");
    }
}
