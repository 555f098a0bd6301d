//! stagepose tells where a stage camera is: it compares every frame with a picture of the stage and
//! gives the camera's metric 6-DoF pose in the stage frame, with its uncertainty.
//!
//! ```text
//!  clip on disk ┐
//!  virtual stage┴> capture ─Entry──> matcher ──Sighting──> pose ──PoseSample──> crossbeam channels
//!                  thread           (features, matches,   (stage frame,        (one a subscriber)
//!                                   candidates, verified) prediction)
//! ```
//!
//! # What is public
//! The types at the root are what a program needs that builds a [`TrackerSetup`], feeds frames and reads samples; with features come
//! clips (`capture`), the config and the `Daemon` (`daemon`), calibration files (`calibration-files`), the virtual
//! stage (`simulate`) and the shutter from a clip (`survey`). The module `protocols` (`protocols`) has the codecs of FreeD, OpenTrackIO and
//! PosiStageNet. [`two_views`] has features, matching and geometry of two pictures. [`diagnostics`] shows what is inside to studies, benches and tests, without a promise. The crates whose types are in
//! signatures are re-exported: [`nalgebra`], [`image`], [`crossbeam_channel`], and with `protocols` `serde_json`.
//!
//! # The map
//! Data moves one way, and a room (a private module, a folder or file of `src/`) uses only rooms above it in this list. The core, which is
//! always there:
//!
//! - `compute_clock`: how long work kept its thread busy, by a clock that is handed in
//! - `simd`: kernels compiled for wider registers too
//! - `geometry`: SE(3), homography, essential matrix, planar pose, resection, robust estimation: pure functions
//! - `camera`: the camera model with distortion and its exact inverse; calibration files (feature `calibration-files`)
//! - `frame`: a grey picture with its stamp
//! - `features`: pyramid, corners, binary descriptors
//! - `matching`: which feature is which
//! - `motion`: the one motion model: following, coasting, prediction, resampling
//! - `track`: surfaces and bodies; acquire, register, verify, align: a frame becomes a sighting
//! - `pose`: a sighting becomes poses in the stage frame, with covariance, or a prediction
//! - `record`: [`PoseSample`] and the line it becomes (contract C3)
//! - `tracker`: [`Tracker`]: a frame in, a sample out
//!
//! Around it, each with the feature that brings it:
//!
//! - `simulate` (`simulate`): the virtual stage with exact truth
//! - `survey` (`survey`): what a clip of a known stage says of the camera: its shutter
//! - `printable` (`daemon`): text from outside, as a terminal may show it
//! - `safe_file`, `contain` (`capture`): reading files and running decoders that strangers have a hand in
//! - `drop_oldest` (`publish`): the bounded channel that drops its oldest entry
//! - `utc` (`daemon`): dates and times of day
//! - `html_page` (`capture`): what the reports share: the page and the shapes of its figures
//! - `capture` (`capture`, V4L2 cameras `live`): `FrameSource`: clips of every form, the virtual camera, cameras
//! - `calibrate` (`calibrate`): a chessboard's corners, Zhang's method, bundle adjustment, judgement and report
//! - `targets` (`calibrate`): what to print: the poster and the board, as PDF and SVG
//! - `mount` (`calibrate`): where the filming camera sits on the rig, from views of both cameras
//! - `compare` (`compare`): two pictures: how points of the one lie in the other, and how the camera moved between them
//! - `diagnose` (`daemon`): why a clip is not followed: what may be wrong is tried, and what fits is named
//! - `protocols` (`protocols`): FreeD, OpenTrackIO and PosiStageNet, encoded and decoded
//! - `publish` (`publish`): one file a protocol, one thread an output: FreeD, OpenTrackIO, PosiStageNet, OSC, JSON
//! - `telemetry` (`daemon`): what a running daemon counts, its health and metrics
//! - `config` (`daemon`): as typed, then resolved
//! - `daemon` (`daemon`): the tracker on threads of its own: `Daemon`
//! - `web` (`daemon`, the server `http`): WebSocket, pose and state over HTTP
//! - `cli` (`cli`): one file a command
//! - [`two_views`]: what relates two pictures, for programs that use the crate as a library
//! - [`diagnostics`]: a view of all of it
//!
//! # Two ways to use it
//! [`Tracker::track`] takes a frame and gives a sample, in the calling thread. `Daemon` runs capture, matcher and pose on a
//! thread each, and `Daemon::subscribe` gives every subscriber a channel of its own. `examples/` shows both.
//!
//! Conventions (metres, radians, pixel centres at integers, `T_to_from`) are said where the types are:
//! [`Stage`], [`Camera`], [`Pixel`].
#![warn(missing_docs)]
// A build with fewer features leaves unused what the others need; what nothing uses shows in a build of everything.
#![cfg_attr(not(all(feature = "cli", feature = "http", feature = "live")), allow(dead_code, unused_imports))]

// The core.
mod camera;
mod compute_clock;
mod features;
mod frame;
mod geometry;
mod matching;
mod motion;
mod pose;
mod record;
mod simd;
mod track;
mod tracker;

// Around it.
#[cfg(feature = "calibrate")]
mod calibrate;
#[cfg(feature = "capture")]
mod capture;
#[cfg(feature = "cli")]
mod cli;
#[cfg(feature = "compare")]
mod compare;
#[cfg(feature = "daemon")]
mod config;
#[cfg(feature = "capture")]
mod contain;
#[cfg(feature = "daemon")]
mod daemon;
#[cfg(feature = "daemon")]
mod diagnose;
#[cfg(any(feature = "publish", feature = "daemon"))]
mod drop_oldest;
#[cfg(feature = "capture")]
mod html_page;
#[cfg(feature = "calibrate")]
mod mount;
#[cfg(feature = "daemon")]
mod printable;
#[cfg(feature = "protocols")]
pub mod protocols;
#[cfg(feature = "publish")]
mod publish;
#[cfg(any(feature = "capture", feature = "publish"))]
mod safe_file;
#[cfg(feature = "simulate")]
mod simulate;
#[cfg(feature = "survey")]
mod survey;
#[cfg(feature = "calibrate")]
mod targets;
#[cfg(feature = "daemon")]
mod telemetry;
#[cfg(feature = "daemon")]
mod utc;
#[cfg(feature = "daemon")]
mod web;

pub mod diagnostics;
pub mod two_views;

// What unit tests and the tests of the program share names the library as both can.
#[cfg(test)]
extern crate self as stagepose;

pub use camera::{
    CameraError, CameraModel, Intrinsics, IntrinsicsUncertainty, KnownShutter, LensDoubt, LensGuess, Normalized, Pixel, Shutter,
};
pub use compute_clock::ComputeClock;
pub use frame::{Frame, Timestamp};
pub use geometry::{Body, Camera, Pose, ReferenceCamera, Stage, SurfaceFrame};
pub use pose::{FilterKind, FilterSettings, KalmanSettings, OneEuroSettings};
pub use record::{EssentialMotion, Measurement, ObjectSample, PoseSample, StageTimes, State, TwoViewModel};
pub use track::{
    BodySpec, LearntCamera, LearntError, LearntTime, Reason, ReferenceKind, SurfaceError, SurfaceSpec, TrackerSettings, ViewStore,
};
pub use tracker::{FrameError, SetupError, Tracker, TrackerSetup};

#[cfg(feature = "calibration-files")]
pub use camera::{Calibration, CalibrationFileError, CalibrationForm, CalibrationProblem, parse_calibration};
#[cfg(feature = "capture")]
pub use capture::{CaptureError, ClipEntry, ClipOptions, DecodeError, EntryContent, FrameSource, Received, decode_grey, open_clip};
#[cfg(feature = "cli")]
pub use cli::run as run_command_line;
#[cfg(feature = "daemon")]
pub use config::{ConfigError, Problem as ConfigProblem, Settings, read_calibration};
#[cfg(feature = "daemon")]
pub use daemon::{Daemon, DaemonError, Delivery, RunningDaemon, thread_clock, track_entry};
#[cfg(feature = "simulate")]
pub use simulate::{
    CameraPath, Dolly, DollyError, Draught, LightKey, MovingObject, ObjectPath, Occluder, PathError, Renderer, SensorNoise, Shake, Spline,
    VirtualStage, Wave, dolly,
};
#[cfg(feature = "survey")]
pub use survey::shutter::{ShutterEstimate, ShutterTime, estimate_shutter};

// Crates whose types are in the signatures above.
#[cfg(feature = "protocols")]
pub use serde_json;
pub use {crossbeam_channel, image, nalgebra};

/// The README's code, which is compiled with the documentation's.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
