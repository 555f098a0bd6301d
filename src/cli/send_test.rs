//! `send-test`: sends a moving test pose to the configured outputs, to set up the receiving side
//! before there is a camera.
//!
//! The pose moves on an ellipse one metre wide. Pan, tilt and roll change slowly by different
//! amounts, so that swapped or inverted axes are obvious. Outputs whose protocol can mark a test do
//! so.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use nalgebra::{UnitQuaternion, Vector3};

use super::failure::Failure;
use super::interrupt;
use super::logging::{self, LogArguments};
use super::outputs::Outputs;
use crate::camera::CameraModel;
use crate::config::Settings;
use crate::frame::Timestamp;
use crate::geometry::{Body, Pose, Stage};
use crate::printable::printable;
use crate::protocols::{PanTiltRoll, to_camera_axes};
use crate::publish::{ClipStart, Context, Stamps};
use crate::record::{ObjectSample, PoseSample, StageTimes, State};

/// Send a moving test pose to the outputs of a config; needs no camera and no stage.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  stagepose send-test --config stage.toml\n  stagepose listen freed 40000        # on the receiving machine"
)]
pub(super) struct SendTestArguments {
    /// The config with the [[output]] sections
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// Stop after this long [default: at Ctrl-C]
    #[arg(long, value_name = "S", value_parser = seconds)]
    seconds: Option<f64>,
    /// Frames per second
    #[arg(long, value_name = "HZ", default_value = "30", value_parser = rate)]
    fps: f64,
    #[command(flatten)]
    log: LogArguments,
}

fn seconds(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|s| *s > 0.0 && *s <= 1e6).ok_or_else(|| "give seconds above 0".to_owned())
}

/// Reads a frame rate.
pub(super) fn rate(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|hz| (1.0..=1000.0).contains(hz)).ok_or_else(|| "give a number from 1 to 1000".to_owned())
}

pub(super) fn run(arguments: &SendTestArguments) -> Result<(), Failure> {
    let settings = Settings::load_outputs(&arguments.config)?;
    let names: Vec<&str> = settings.outputs.iter().filter(|o| o.enabled).map(|o| o.name.as_str()).collect();
    if names.is_empty() {
        return Err(Failure::Usage(nowhere_to_send(&arguments.config, settings.outputs.len())));
    }
    logging::start(&arguments.log, settings.log);
    interrupt::watch();
    let context = Context {
        camera: settings.camera.unwrap_or_else(any_camera),
        objects: settings.objects.clone(),
        mount: settings.mount.clone(),
        safety: settings.safety,
        stamps: Stamps::Recorded(ClipStart::default()),
        timecode: None,
        frame_rate: Some(arguments.fps),
        rings: None,
        is_test: true,
    };
    let outputs = Outputs::open(&settings.outputs, settings.http.as_ref(), &context)?;
    if let Some(file) = &settings.missing_calibration {
        let line = format!("{} is not there yet: the lens that is sent is made up", file.display());
        writeln!(io::stderr(), "{}", printable(&line)).map_err(Failure::output(Path::new("stderr")))?;
    }
    writeln!(io::stderr(), "sending a test pose to {}; Ctrl-C ends it", names.join(", ")).map_err(Failure::output(Path::new("stderr")))?;
    let begun = Instant::now();
    let mut sequence = 0_u64;
    loop {
        let due = sequence as f64 / arguments.fps;
        if arguments.seconds.is_some_and(|end| due >= end) || !interrupt::wait_until(begun, Duration::from_secs_f64(due)) {
            break;
        }
        outputs.send(&test_sample(sequence, due, &settings.objects));
        // After a pause, continue from now: frames are never sent late in a burst.
        sequence = (sequence + 1).max((begun.elapsed().as_secs_f64() * arguments.fps) as u64);
    }
    outputs.close();
    Ok(())
}

/// Returns the error for a config without an enabled output.
fn nowhere_to_send(config: &Path, switched_off: usize) -> String {
    let file = config.display();
    match switched_off {
        0 => format!("{file}: there is no [[output]] section to send to; add one"),
        n => format!("{file}: all of the {n} [[output]] sections are switched off; write enabled = true in the one to send to"),
    }
}

/// Returns a typical webcam, for a config that names no calibration.
fn any_camera() -> CameraModel {
    CameraModel::pinhole(1280, 720, 1000.0, 1000.0, 639.5, 359.5).expect("these are good intrinsics")
}

/// Returns the test pose at a time; a lap takes twenty seconds.
fn test_pose(seconds: f64) -> Pose<Stage, Body> {
    let (sin, cos) = (std::f64::consts::TAU * seconds / 20.0).sin_cos();
    let angles = PanTiltRoll { pan_deg: 20.0 * sin, tilt_deg: 10.0 * cos, roll_deg: 5.0 * sin };
    Pose::new(angles.rotation(), Vector3::new(0.5 * sin, -4.0 + 0.2 * cos, 1.6 + 0.1 * sin))
}

fn test_sample(sequence: u64, seconds: f64, objects: &[String]) -> PoseSample {
    let object = |(index, name): (usize, &String)| ObjectSample {
        name: name.clone(),
        state: State::Tracking,
        pose: Some(Pose::new(UnitQuaternion::identity(), Vector3::new(index as f64, 0.5 * (seconds / 3.0).sin(), 0.5))),
        covariance: None,
        common: None,
    };
    PoseSample {
        sequence,
        timestamp: Timestamp::from_seconds(seconds),
        state: State::Tracking,
        pose: Some(to_camera_axes(&test_pose(seconds))),
        measurement: None,
        objects: objects.iter().enumerate().map(object).collect(),
        reason: None,
        learnt: Default::default(),
        times: StageTimes::default(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_test_pose_repeats_every_twenty_seconds() {
        assert!((test_pose(0.0).translation - test_pose(20.0).translation).norm() < 1e-9);
        let sample = test_sample(3, 5.0, &["cart".to_owned()]);
        let angles = PanTiltRoll::of_rotation(&test_pose(5.0).rotation, 0.0);
        assert!((angles.pan_deg - 20.0).abs() < 1e-9 && angles.tilt_deg.abs() < 1e-9);
        assert_eq!((sample.timestamp, sample.objects[0].name.as_str()), (Timestamp::from_seconds(5.0), "cart"));
    }
}
