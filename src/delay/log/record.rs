//! Pose records (contract C3), as `replay --poses` writes them: only rows that were tracked.

use serde::Deserialize;

use super::{LogError, LoggedPose, lines, rotation};
use crate::frame::Timestamp;

#[derive(Deserialize)]
struct Line {
    timestamp_ns: Timestamp,
    state: String,
    pose: Option<Oriented>,
    /// Before any filter, which would delay it.
    measured: Option<Oriented>,
}

#[derive(Deserialize)]
struct Oriented {
    position_m: [f64; 3],
    orientation_xyzw: [f64; 4],
}

pub(super) fn read(bytes: &[u8]) -> Result<Vec<LoggedPose>, LogError> {
    let mut rows = Vec::new();
    for (line, text) in lines(bytes) {
        let wrong = |problem: String| LogError::Line { line, problem };
        let read: Line = serde_json::from_slice(text).map_err(|e| wrong(format!("not a pose record ({e})")))?;
        let oriented = read.measured.or(read.pose).filter(|_| read.state == "tracking");
        if let Some(oriented) = oriented {
            let rotation = rotation(oriented.orientation_xyzw).map_err(wrong)?;
            rows.push(LoggedPose { at: read.timestamp_ns, rotation, position: oriented.position_m.into() });
        }
    }
    Ok(rows)
}
