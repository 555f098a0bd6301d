//! Tracks a clip and prints one line per frame, as `stagepose replay CLIP --config FILE --poses -`
//! does.
//!
//! The config becomes a setup, and the setup a tracker. Every row of the clip gets its record, even
//! a row without a frame.
//!
//! ```sh
//! cargo run --example track_folder                                  # fixtures/dolly
//! cargo run --example track_folder -- CLIP CONFIG
//! ```

use std::error::Error;
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use stagepose::{ClipOptions, Settings, Tracker, open_clip, track_entry};

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
    let mut source = open_clip(&clip, options)?;

    // The calibration is scaled to the size of the clip's pictures; `note` says if that is a guess.
    let (width, height) = source.size();
    let (setup, note) = settings.tracker_setup(width, height)?;
    if let Some(note) = note {
        eprintln!("{note}");
    }
    let mut tracker = Tracker::new(setup)?.with_filter(settings.filter);

    let mut out = std::io::stdout().lock();
    while let Some(row) = source.next_entry() {
        let sample = track_entry(&mut tracker, &row);
        writeln!(out, "{}", sample.to_json_line())?;
    }
    Ok(())
}
