//! Runs the tracker on its own threads and reads its samples in a thread of your program.
//!
//! This example plays a clip, so it must not lose a frame: `Delivery::Blocking` makes capture wait
//! for the tracker, and the tracker for the slowest subscriber. Use `Daemon::live` for cameras: it
//! drops the oldest unread sample instead.
//!
//! ```sh
//! cargo run --example subscribe                                     # fixtures/dolly
//! cargo run --example subscribe -- CLIP CONFIG
//! ```

use std::error::Error;
use std::path::PathBuf;
use std::process::ExitCode;
use std::thread;

use stagepose::{ClipOptions, Daemon, Delivery, Settings, State, Tracker, open_clip};

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            eprintln!("{e}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1).map(PathBuf::from);
    let clip = arguments.next().unwrap_or_else(|| "fixtures/dolly".into());
    let config = arguments.next().unwrap_or_else(|| clip.join("stage.toml"));

    let settings = Settings::load(&config)?;
    let mut options = ClipOptions::default();
    options.calibrated = Some((settings.camera.width(), settings.camera.height()));
    let source = open_clip(&clip, options)?;
    let (width, height) = source.size();
    let (setup, _) = settings.tracker_setup(width, height)?;

    // Subscribe before the start: a subscriber receives only later samples.
    let mut daemon = Daemon::new(source, Tracker::new(setup)?.with_filter(settings.filter), Delivery::Blocking);
    let samples = daemon.subscribe();
    let reader = thread::spawn(move || {
        let (mut tracking, mut all) = (0, 0);
        // The loop ends when the daemon closes the channel.
        for sample in samples {
            all += 1;
            tracking += u32::from(sample.state == State::Tracking);
            if let Some(pose) = &sample.pose {
                let [x, y, z]: [f64; 3] = pose.translation.into();
                println!("frame {:2} {} at [{x:.4}, {y:.4}, {z:.4}] m", sample.sequence, sample.state.word());
            } else {
                println!("frame {:2} {}", sample.sequence, sample.state.word());
            }
        }
        (tracking, all)
    });

    daemon.start()?.join()?;
    let (tracking, all) = reader.join().map_err(|_| "the reader failed")?;
    println!("{tracking} of {all} frames tracked");
    Ok(())
}
