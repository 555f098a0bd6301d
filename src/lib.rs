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
//! # The map
//! Data moves one way, and a room uses only rooms above it in this list. The core, which is always there:
//!
//! - [`compute_clock`]: how long work kept its thread busy, by a clock that is handed in
//! - [`geometry`]: SE(3), homography, essential matrix, planar pose, resection, robust estimation: pure functions
//! - [`camera`]: the camera model with distortion and its exact inverse; calibration files (feature `calibration-files`)
//! - [`frame`]: a grey picture with its stamp
//! - [`features`]: pyramid, corners, binary descriptors
//! - [`matching`]: which feature is which
//! - [`track`]: surfaces and bodies; acquire, register, verify, align, lock: a frame becomes a [`track::Sighting`]
//! - [`pose`]: a sighting becomes poses in the stage frame, with covariance, or a prediction
//! - [`record`]: [`PoseSample`] and the line it becomes (contract C3)
//! - [`tracker`]: [`Tracker`]: a frame in, a sample out
//!
//! Around it, each with the feature that brings it:
//!
//! - `simulate` (`simulate`): the virtual stage with exact truth
//! - `survey` (`survey`): what a clip of a known stage says of the camera: its shutter
//! - `printable` (`daemon`): text from outside, as a terminal may show it
//! - `safe_file`, `contain` (`capture`): reading files and running decoders that strangers have a hand in
//! - `drop_oldest` (`publish`): the bounded channel that drops its oldest entry
//! - `utc` (`daemon`): dates and times of day
//! - `capture` (`capture`, V4L2 cameras `live`): `FrameSource`: clips of every form, the virtual camera, cameras
//! - `calibrate` (`calibrate`): a chessboard's corners, Zhang's method, bundle adjustment, judgement and report
//! - `targets` (`calibrate`): what to print: the poster and the board, as PDF and SVG
//! - `mount` (`calibrate`): where the filming camera sits on the rig, from views of both cameras
//! - `diagnose` (`daemon`): why a clip is not followed: what may be wrong is tried, and what fits is named
//! - `protocols` (`protocols`): FreeD, OpenTrackIO and PosiStageNet, encoded and decoded
//! - `publish` (`publish`): one file a protocol, one thread an output: FreeD, OpenTrackIO, PosiStageNet, OSC, JSON
//! - `telemetry` (`daemon`): what a running daemon counts, its health and metrics
//! - `config` (`daemon`): as typed, then resolved
//! - `daemon` (`daemon`): the tracker on threads of its own: `Daemon`
//! - `web` (`daemon`, the server `http`): WebSocket, pose and state over HTTP
//! - `cli` (`cli`): one file a command
//!
//! # Two ways to use it
//! [`Tracker::track`] takes a frame and gives a sample, in the calling thread. `Daemon` runs capture, matcher and pose on a
//! thread each, and `Daemon::subscribe` gives every subscriber a channel of its own. `examples/` shows both.
//!
//! Conventions (metres, radians, pixel centres at integers, `T_to_from`) are said where the types are:
//! [`geometry::Stage`], [`geometry::Camera`], [`camera::Pixel`].
#![warn(missing_docs)]

// The core.
pub mod camera;
pub mod compute_clock;
pub mod features;
pub mod frame;
pub mod geometry;
pub mod matching;
pub mod pose;
pub mod record;
pub mod track;
pub mod tracker;

// Around it.
#[cfg(feature = "calibrate")]
pub mod calibrate;
#[cfg(feature = "capture")]
pub mod capture;
#[cfg(feature = "cli")]
pub mod cli;
#[cfg(feature = "daemon")]
pub mod config;
#[cfg(feature = "capture")]
pub mod contain;
#[cfg(feature = "daemon")]
pub mod daemon;
#[cfg(feature = "daemon")]
pub mod diagnose;
#[cfg(any(feature = "publish", feature = "daemon"))]
pub mod drop_oldest;
#[cfg(feature = "calibrate")]
pub mod mount;
#[cfg(feature = "daemon")]
pub mod printable;
#[cfg(feature = "protocols")]
pub mod protocols;
#[cfg(feature = "publish")]
pub mod publish;
#[cfg(any(feature = "capture", feature = "publish"))]
pub mod safe_file;
#[cfg(feature = "simulate")]
pub mod simulate;
#[cfg(feature = "survey")]
pub mod survey;
#[cfg(feature = "calibrate")]
pub mod targets;
#[cfg(feature = "daemon")]
pub mod telemetry;
#[cfg(feature = "daemon")]
pub mod utc;
#[cfg(feature = "daemon")]
pub mod web;

#[cfg(feature = "daemon")]
pub use daemon::Daemon;
pub use record::PoseSample;
pub use tracker::{FrameError, SetupError, Tracker, TrackerSetup};

/// The README's code, which is compiled with the documentation's.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
