//! A report of the golden pose, for the tests of all encoders.

use std::sync::Arc;

use super::report::{BodyChoice, BodyReport, Report, ReportedTimecode};
use super::rings::Rings;
use crate::frame::Timestamp;
use crate::protocols::golden::golden_camera;
use crate::protocols::to_body_axes;
use crate::record::State;

/// The camera at the golden pose.
pub(crate) fn golden_body(state: State) -> BodyReport {
    BodyReport {
        name: Arc::from("camera"),
        choice: BodyChoice::Camera,
        state,
        withheld: None,
        pose: Some(to_body_axes(&golden_camera())),
        velocity: None,
        held: None,
        is_blended: false,
        is_predicted: false,
        is_passed: true,
    }
}

/// A report of the golden pose.
pub(crate) fn golden_report(state: State) -> Report {
    Report {
        sequence: 17,
        unix: Timestamp::from_ns(1_700_000_000_040_000_000),
        monotonic: Timestamp::from_ns(5_040_000_000),
        sent_monotonic: Timestamp::from_ns(5_052_500_000),
        recorded: None,
        timecode: ReportedTimecode::TimeOfDay,
        rings: Rings::default(),
        clock: None,
        is_on_clock: false,
        rate_hz: 30.0,
        bodies: vec![golden_body(state)],
        sample: None,
        age_ms: 12.5,
        is_test: false,
    }
}
