//! Internals for studies, benches, tests and overlays, grouped by module. Nothing here is stable:
//! any version may change it.

/// Geometry solvers beyond those of `two_views`.
pub mod geometry {
    pub use crate::geometry::FilmingCamera;
    pub use crate::geometry::bspline::BicubicSpline;
    pub use crate::geometry::essential::essential_candidates;
    pub use crate::geometry::local_affinities::{LocalAffinity, robust_affine};
    pub use crate::geometry::resection::{MovingCamera, Observation, resect};
}

/// Pyramid, corners, descriptors and their matching.
pub mod features {
    pub use crate::features::{
        CornerBuffers, CornerOptions, ExtractorOptions, FeatureExtractor, Pyramid, Workers, describe, detect_corners, orientation,
        smooth_into,
    };
    pub use crate::matching::{MatchBuffers, ReferenceIndex};
}

/// The tracker's matcher, the hot loops of alignment, and surface shapes.
pub mod track {
    pub use crate::track::{AlignKernels, Alignment, BentShape, BodyTracker, ShapeWay, SurfaceShape, TUNING, UsedPixel, UsedPixels};

    /// Returns how many linear systems alignment solved since the tracker began, on all levels,
    /// also for starts that led nowhere: the stage's first, then the objects'.
    pub fn rounds(tracker: &crate::Tracker) -> Vec<u64> {
        tracker.matcher.rounds()
    }
}

/// The tuning constants of `track`, scaled one at a time.
#[cfg(feature = "tuning")]
pub mod tuning {
    pub use crate::track::tuning::study::{Constant, constants, restore, scale};
}

/// The virtual stage: pictures on the cloth and camera paths through the hall.
#[cfg(feature = "simulate")]
pub mod simulate {
    #[cfg(feature = "capture")]
    pub use crate::simulate::through_jpeg;
    pub use crate::simulate::{PoseError, artwork_surface, grey, look_at, paint, paint_boards, percentile, upright};
}

/// Readers of single formats, and virtual cameras for tests.
#[cfg(feature = "capture")]
pub mod capture {
    pub use crate::capture::camera::{Camera, CameraFault, CameraMode, CameraOpener, CapturedPicture, OpenFault, PixelLayout};
    pub use crate::capture::timestamping::{DriverStamp, mid_exposure, monotonic_now};
    pub use crate::capture::{
        AviReader, MjpegReader, VirtualCamera, Y4mReader, decode_on_white, decode_oriented, ffmpeg_account, picture_size, read_timestamps,
    };
}

/// Calibration boards: painting them, finding them, and calibrating from them.
#[cfg(feature = "calibrate")]
pub mod calibrate {
    pub use crate::calibrate::board::Board;
    pub use crate::calibrate::finder::{FoundBoard, find_board};
    pub use crate::calibrate::solve::adjust::{BoardFrame, Observation};
    pub use crate::calibrate::solve::{SolveOptions, estimate};
    pub use crate::targets::poster::paint as paint_poster;
}

/// Logs of other trackers.
#[cfg(feature = "cli")]
pub mod delay {
    pub use crate::delay::log::{LogError, PoseLog, read as read_pose_log};
}

/// Linear timecode, and a generator of it.
#[cfg(feature = "publish")]
pub mod timecode {
    pub use crate::timecode::side_file::TimecodeRows;
    pub use crate::timecode::synthetic::{LtcSignal, wav};
    pub use crate::timecode::{LtcDecoder, LtcFrame, RawFormat, Sound, Timecode, TimecodeRate};
}

/// Outputs, with clocks that the caller passes in.
#[cfg(feature = "publish")]
pub mod publish {
    pub use crate::publish::freed::{FreedSettings, Spare};
    pub use crate::publish::opentrackio::OpenTrackIoSettings;
    pub use crate::publish::osc::{OscMessageKind, OscSettings};
    pub use crate::publish::otp::OtpSettings;
    pub use crate::publish::psn::PsnSettings;
    pub use crate::publish::{
        BlendRates, BodyChoice, ClipStart, Clocks, Context, FixedRate, FrameClock, JsonSettings, OnLoss, OutputSettings, Placement,
        Protocol, Publisher, Rate, Reading, SafetySettings, Stamps, StreamSettings, TickPhase, UdpSettings,
    };
}

/// Camera failures and recovery, and the recorder.
#[cfg(feature = "daemon")]
pub mod live {
    pub use crate::config::ConfigSource;
    pub use crate::daemon::live::{Event, LiveLink, LiveSource, LiveStop, Patience, StampedEvent};
    pub use crate::daemon::recorder::{AboutClip, RealDisk, Recorder, RecorderPlan};
}

/// The HTTP server.
#[cfg(feature = "http")]
pub mod web {
    pub use crate::config::HttpSettings;
    pub use crate::web::{Server, judge_model};
}

/// Escaping of external text for terminals.
#[cfg(feature = "daemon")]
pub mod printable {
    pub use crate::printable::stands_for_itself;
}

/// The reader of pose records that exports begin with.
#[cfg(feature = "cli")]
pub mod export {
    pub use crate::export::take::{Take, TakeError};
}
