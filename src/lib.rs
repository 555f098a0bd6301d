//! stagepose tells where a stage camera is. It compares every frame with a picture of the stage and
//! returns the camera's metric 6-DoF pose in the stage frame, with its uncertainty.
//!
//! ```text
//!  clip on disk ┐
//!  virtual stage┴> capture ─Entry──> matcher ──FrameObservation──> pose ──PoseSample──> crossbeam channels
//!                  thread           (features, matches,   (stage frame,        (one a subscriber)
//!                                   candidates, verified) prediction)
//! ```
//!
//! # What is public The types at the root are what a program needs to build a [`TrackerSetup`],
//! feed frames and read samples. Features add clips (`capture`), the config and the `Daemon`
//! (`daemon`), calibration files (`calibration-files`), the virtual stage (`simulate`) and shutter
//! estimation from a clip (`survey`). The module `protocols` (`protocols`) has the codecs of FreeD,
//! OpenTrackIO, PosiStageNet and OTP. The module `two_views` (`two-views`) has features, matching
//! and geometry of two pictures. [`diagnostics`] exposes internals to studies, benches and tests,
//! without any stability promise. The crates whose types appear in signatures are re-exported:
//! [`nalgebra`], [`image`], [`crossbeam_channel`], and with `protocols` also `serde_json`.
//!
//! # Map of the modules
//! Data flows one way. A module (a folder or file of `src/`) uses only modules above it in this
//! list. The core is always compiled:
//!
//! - `compute_clock`: how long work kept its thread busy, by a clock the caller passes in
//! - `simd`: kernels also compiled for wider registers
//! - `fingerprint`: a hash that tells versions of bytes apart
//! - `geometry`: SE(3), homography, essential matrix, planar pose, resection, robust estimation;
//!   pure functions
//! - `camera`: the camera model with distortion and its exact inverse; calibration files (feature
//!   `calibration-files`)
//! - `frame`: a grey picture with its stamp
//! - `features`: pyramid, corners, binary descriptors
//! - `light`: the curves between light and grey levels; averages of light
//! - `matching`: which features correspond
//! - `motion`: the motion model: following, coasting, prediction, resampling
//! - `track`: surfaces and bodies; acquire, register, verify, align: turns a frame into an
//!   observation
//! - `pose`: turns an observation into poses in the stage frame, with covariance, or into a
//!   prediction
//! - `record`: [`PoseSample`] and its JSON line (contract C3)
//! - `tracker`: [`Tracker`]: a frame in, a sample out
//!
//! Around it, each with the feature that enables it:
//!
//! - `simulate` (`simulate`): the virtual stage with exact ground truth
//! - `survey` (`survey`): shutter estimation from a clip of a known stage
//! - `printable` (`daemon`): escaping of external text for terminals
//! - `safe_file`, `contain` (`capture`): reading untrusted files and running decoders on them
//! - `drop_oldest` (`publish`): the bounded channel that drops its oldest entry
//! - `utc` (`daemon`): dates and times of day
//! - `timecode` (`publish`): linear timecode from sound, and which timecode a stamp has
//! - `html_page` (`capture`): the page and figures shared by the reports
//! - `refine` (`cli`): poses of a recorded take, each from the frames before and after it
//! - `export` (`cli`): takes and stages for other programs: USD, Nuke, Blender, After Effects,
//!   glTF, MCAP, OBJ
//! - `capture` (`capture`, V4L2 cameras `live`): `FrameSource`: clips of all formats, the virtual
//!   camera, cameras
//! - `calibrate` (`calibrate`): chessboard corners, Zhang's method, bundle adjustment, assessment
//!   and report
//! - `targets` (`calibrate`): printable targets: the poster and the board, as PDF and SVG
//! - `mount` (`calibrate`): where the filming camera sits on the rig, from views of both cameras
//! - `compare` (`compare`): two pictures: how points of one map to the other, and how the camera
//!   moved between them
//! - `diagnose` (`daemon`): why a clip is not tracked: tries likely mistakes and names what fits
//! - `protocols` (`protocols`): encoding and decoding of FreeD, OpenTrackIO, PosiStageNet
//!   and OTP
//! - `delay` (`cli`): how much later one camera's stamps are than another's, from their turn rates
//! - `other_tracker` (`cli`): another tracker beside this one: alignment, differences, verdict
//! - `publish` (`publish`): one file per protocol, one thread per output: FreeD, OpenTrackIO,
//!   PosiStageNet, OTP, OSC, JSON
//! - `telemetry` (`daemon`): counters, health and metrics of a running daemon
//! - `config` (`daemon`): the config as typed, then resolved
//! - `daemon` (`daemon`): the tracker on its own threads: `Daemon`
//! - `web` (`daemon`, the server `http`): WebSocket, pose and state over HTTP
//! - `cli` (`cli`): one file per command
//! - `two_views` (`two-views`): what relates two pictures, for programs that use the crate as a
//!   library: re-exports the modules `two_views` of `geometry` and `features` and
//!   `matching::exact`, which only this feature compiles
//! - [`diagnostics`]: a view of all internals
//!
//! # Two ways to use it
//! [`Tracker::track`] takes a frame and returns a sample, on the calling thread. `Daemon` runs
//! capture, matcher and pose on one thread each, and `Daemon::subscribe` gives every subscriber its
//! own channel. `examples/` shows both.
//!
//! Conventions (metres, radians, pixel centres at integers, `T_to_from`) are documented with the
//! types: [`Stage`], [`Camera`], [`Pixel`].
#![warn(missing_docs)]

// The core.
mod camera;
mod compute_clock;
mod features;
mod fingerprint;
mod frame;
mod geometry;
mod light;
mod matching;
mod motion;
#[cfg(feature = "cli")]
mod other_tracker;
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
#[cfg(feature = "cli")]
mod delay;
#[cfg(feature = "daemon")]
mod diagnose;
#[cfg(any(feature = "publish", feature = "daemon"))]
mod drop_oldest;
#[cfg(feature = "cli")]
mod export;
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
#[cfg(feature = "cli")]
mod refine;
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
#[cfg(feature = "publish")]
mod timecode;
#[cfg(feature = "daemon")]
mod utc;
#[cfg(feature = "daemon")]
mod web;

pub mod diagnostics;
#[cfg(feature = "two-views")]
pub mod two_views;

// Unit tests share modules with the program's tests, which name the library `stagepose`.
#[cfg(test)]
extern crate self as stagepose;

pub use camera::{
    CameraError, CameraModel, Intrinsics, IntrinsicsUncertainty, KnownShutter, LensDoubt, LensGuess, Normalized, Pixel, Shutter,
};
pub use compute_clock::ComputeClock;
pub use frame::{Frame, Timestamp};
pub use geometry::{Body, Camera, Pose, ReferenceCamera, Stage, SurfaceFrame};
pub use light::Transfer;
pub use pose::{FilterKind, FilterSettings, FixedCamera, KalmanSettings, OneEuroSettings};
pub use record::{EssentialMotion, Measurement, ObjectSample, PoseSample, StageTimes, State, TwoViewModel};
pub use track::{
    BodySpec, Facet, FacetTexture, LearntCamera, LearntError, LearntTime, MapFileError, Reason, ReferenceKind, StageMap, SurfaceError,
    SurfaceSpec, TrackerSettings, ViewStore,
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
    CameraPath, Dolly, DollyError, Draught, LightKey, LightModel, MovingObject, ObjectPath, Occluder, PathError, Person, Renderer, Roll,
    SensorNoise, Shake, Spline, Spot, ToneCurve, VirtualStage, Wave, dolly,
};
#[cfg(feature = "survey")]
pub use survey::shutter::{ShutterEstimate, ShutterTime, estimate_shutter};

// Crates whose types appear in the signatures above.
#[cfg(feature = "protocols")]
pub use serde_json;
pub use {crossbeam_channel, image, nalgebra};

/// The code of the document for programmers, compiled with the doctests.
#[cfg(doctest)]
#[doc = include_str!("../docs/library.md")]
struct LibraryDocument;
