//! A take: the records of contract C3 as runs of poses.
//!
//! Only records in state `tracking` or `coasting` have a pose. A row without one stays a gap.

use std::collections::BTreeMap;
use std::ops::Range;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use serde::Deserialize;
use serde_json::error::Category;
use thiserror::Error;

use crate::frame::Timestamp;
use crate::geometry::{Body, Camera, Pose, Stage};
use crate::record::State;
use crate::timecode::StampedTimecode;

/// Largest coordinate of a position, metres. No stage is that large. Raised, the single precision
/// of some formats loses millimetres without a message.
const MAX_COORDINATE_M: f64 = 1e5;
/// Largest difference of a quaternion's length from 1. Records have 16 digits; a text edited by
/// hand has at least four. Raised, four numbers that are no rotation pass for one.
const MAX_LENGTH_ERROR: f64 = 1e-3;

/// Maximum length of the parser's reason, characters: it may repeat what a line has. Raised, a
/// wrong file fills the terminal.
const MAX_REASON: usize = 200;

/// A pose of one row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Key<From> {
    /// The row of the clip, from 0.
    pub row: usize,
    /// The record's stamp.
    pub timestamp: Timestamp,
    /// `T_stage_camera` or `T_stage_object`, metres.
    pub pose: Pose<Stage, From>,
}

/// The records of a clip, in order.
#[derive(Debug, Clone, PartialEq)]
pub struct Take {
    text: String,
    rows: Vec<(Range<usize>, Timestamp)>,
    timecodes: Vec<Option<StampedTimecode>>,
    /// The camera's poses, one per row that has one; stamps rise.
    pub camera: Vec<Key<Camera>>,
    /// The objects' poses by name; objects that never have one are included.
    pub objects: BTreeMap<String, Vec<Key<Body>>>,
}

/// Why a text is not a take. Lines are counted from 1.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum TakeError {
    /// There is no record.
    #[error("it holds no record; give the JSON lines that `--poses` wrote")]
    Empty,
    /// The bytes are not UTF-8.
    #[error("line {line} is not text; give the JSON lines that `--poses` wrote")]
    NotText {
        /// The line.
        line: usize,
    },
    /// A record ends early.
    #[error("line {line} is cut off; the file is incomplete: write it again, or delete that line")]
    Cut {
        /// The line.
        line: usize,
    },
    /// A line is not JSON.
    #[error("line {line} is not JSON ({reason}); give the JSON lines that `--poses` wrote")]
    NotJson {
        /// The line.
        line: usize,
        /// The parser's reason.
        reason: String,
    },
    /// A line is JSON, but not a record.
    #[error("line {line} is not a pose record ({reason}); give the JSON lines that `--poses` wrote")]
    NotRecord {
        /// The line.
        line: usize,
        /// The parser's reason, which names the key.
        reason: String,
    },
    /// A pose has impossible numbers.
    #[error("line {line}: `{key}` of {whose} is {value:?}, which is {problem}; write the file again with `replay --poses`")]
    Pose {
        /// The line.
        line: usize,
        /// The key.
        key: &'static str,
        /// `the camera`, or the object's name.
        whose: String,
        /// Its value.
        value: Vec<f64>,
        /// What is wrong with it.
        problem: &'static str,
    },
    /// A pose is not later than the one before.
    #[error(
        "line {line}: its `timestamp_ns` does not follow that of the pose before; the file holds more than one recording, or its lines are out of order: give one recording"
    )]
    Order {
        /// The line.
        line: usize,
    },
    /// No record has a pose.
    #[error("none of its {rows} records has a pose (state `tracking` or `coasting`); `stagepose check --clip` says why")]
    NoPose {
        /// Number of records.
        rows: usize,
    },
}

#[derive(Deserialize)]
#[serde(expecting = "a JSON object")]
struct Record {
    timestamp_ns: i64,
    state: State,
    pose: Option<Placed>,
    #[serde(default)]
    objects: Vec<ObjectRecord>,
}

#[derive(Deserialize)]
struct ObjectRecord {
    name: String,
    state: State,
    pose: Option<Placed>,
}

#[derive(Deserialize)]
struct Placed {
    position_m: [f64; 3],
    orientation_xyzw: [f64; 4],
}

impl Placed {
    fn pose<From>(&self, line: usize, whose: &str) -> Result<Pose<Stage, From>, TakeError> {
        let refuse = |key, value: &[f64], problem| TakeError::Pose { line, key, whose: whose.to_owned(), value: value.to_vec(), problem };
        let [x, y, z, w] = self.orientation_xyzw;
        let q = Quaternion::new(w, x, y, z);
        if !self.position_m.iter().all(|v| (-MAX_COORDINATE_M..=MAX_COORDINATE_M).contains(v)) {
            return Err(refuse("position_m", &self.position_m, "farther away than any stage"));
        }
        if !(1.0 - MAX_LENGTH_ERROR..=1.0 + MAX_LENGTH_ERROR).contains(&q.norm()) {
            return Err(refuse("orientation_xyzw", &self.orientation_xyzw, "not a unit quaternion"));
        }
        Ok(Pose::new(UnitQuaternion::new_normalize(q), Vector3::from(self.position_m)))
    }
}

/// Whether a state has a pose to use.
fn has_pose(state: State) -> bool {
    matches!(state, State::Tracking | State::Coasting)
}

impl Take {
    /// Reads JSON lines.
    ///
    /// # Errors
    /// The first line that is no record, poses out of order, or no pose at all.
    pub fn parse(bytes: Vec<u8>) -> Result<Self, TakeError> {
        let text = String::from_utf8(bytes).map_err(|e| {
            let before = &e.as_bytes()[..e.utf8_error().valid_up_to()];
            TakeError::NotText { line: 1 + before.iter().filter(|b| **b == b'\n').count() }
        })?;
        let mut take = Self { text: String::new(), rows: Vec::new(), timecodes: Vec::new(), camera: Vec::new(), objects: BTreeMap::new() };
        let mut begin = 0;
        for (k, line) in text.split_inclusive('\n').enumerate() {
            let content = line.trim_end();
            if !content.is_empty() {
                take.rows.push((begin..begin + content.len(), Timestamp::default()));
                take.add(content, k + 1)?;
            }
            begin += line.len();
        }
        take.text = text;
        match (take.rows.len(), take.camera.is_empty()) {
            (0, _) => Err(TakeError::Empty),
            (rows, true) => Err(TakeError::NoPose { rows }),
            _ => Ok(take),
        }
    }

    /// Adds the record of the last row.
    fn add(&mut self, content: &str, line: usize) -> Result<(), TakeError> {
        let record: Record = serde_json::from_str(content).map_err(|e| refusal(&e, line))?;
        let (row, timestamp) = (self.rows.len() - 1, Timestamp::from_ns(record.timestamp_ns));
        self.rows[row].1 = timestamp;
        if let Some(placed) = record.pose.filter(|_| has_pose(record.state)) {
            if self.camera.last().is_some_and(|last| last.timestamp >= timestamp) {
                return Err(TakeError::Order { line });
            }
            self.camera.push(Key { row, timestamp, pose: placed.pose(line, "the camera")? });
        }
        for object in record.objects {
            let pose = object.pose.filter(|_| has_pose(object.state)).map(|placed| placed.pose(line, &object.name)).transpose()?;
            let keys = self.objects.entry(object.name).or_default();
            if let Some(pose) = pose {
                if keys.last().is_some_and(|last: &Key<Body>| last.timestamp >= timestamp) {
                    return Err(TakeError::Order { line });
                }
                keys.push(Key { row, timestamp, pose });
            }
        }
        Ok(())
    }

    /// Asks for the timecode of every row's stamp.
    pub fn add_timecode(&mut self, of: impl Fn(Timestamp) -> Option<StampedTimecode>) {
        self.timecodes = self.rows.iter().map(|(_, stamp)| of(*stamp)).collect();
    }

    /// Returns the rows that have a timecode, with their stamps.
    pub fn timecodes(&self) -> impl Iterator<Item = (usize, Timestamp, &StampedTimecode)> {
        let known = self.timecodes.iter().zip(&self.rows).enumerate();
        known.filter_map(|(row, (timecode, (_, stamp)))| Some((row, *stamp, timecode.as_ref()?)))
    }

    /// Returns the number of rows.
    pub fn rows(&self) -> usize {
        self.rows.len()
    }

    /// Returns the records as they were read, with their stamps.
    pub fn lines(&self) -> impl Iterator<Item = (&str, Timestamp)> {
        self.rows.iter().map(|(range, timestamp)| (&self.text[range.clone()], *timestamp))
    }

    /// Returns the stamp of a row; that of the last row beyond it.
    pub fn stamp(&self, row: usize) -> Timestamp {
        self.rows.get(row).or(self.rows.last()).map_or(Timestamp::default(), |(_, timestamp)| *timestamp)
    }
}

fn refusal(error: &serde_json::Error, line: usize) -> TakeError {
    let reason = error.to_string();
    // The parser counts lines within the record.
    let reason = reason.rsplit_once(" at line ").map_or(reason.as_str(), |(reason, _)| reason);
    let reason = reason.chars().take(MAX_REASON).collect();
    match error.classify() {
        Category::Eof => TakeError::Cut { line },
        Category::Data => TakeError::NotRecord { line, reason },
        Category::Syntax | Category::Io => TakeError::NotJson { line, reason },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const POSE: &str = r#"{"position_m":[1.0,-4.0,0.5],"orientation_xyzw":[-0.6,0.0,0.0,0.8]}"#;

    fn line(sequence: i64, state: &str, pose: &str) -> String {
        format!(r#"{{"sequence":{sequence},"timestamp_ns":{},"state":"{state}","pose":{pose},"objects":[]}}"#, 40_000_000 * sequence)
    }

    fn parse(lines: &[String]) -> Result<Take, TakeError> {
        Take::parse(lines.join("\n").into_bytes())
    }

    #[test]
    fn only_tracking_and_coasting_have_poses() {
        let states = ["searching", "tracking", "coasting", "lost", "tracking"];
        let lines: Vec<String> = states.iter().enumerate().map(|(k, state)| line(k as i64, state, POSE)).collect();
        let take = parse(&lines).unwrap();
        assert_eq!(take.camera.iter().map(|key| key.row).collect::<Vec<_>>(), [1, 2, 4]);
        assert_eq!((take.rows(), take.stamp(3), take.stamp(9)), (5, Timestamp::from_ns(120_000_000), Timestamp::from_ns(160_000_000)));
        assert_eq!(take.lines().map(|(text, _)| text.to_owned()).collect::<Vec<_>>(), lines);
        assert_eq!(take.camera[0].pose.translation, Vector3::new(1.0, -4.0, 0.5));
    }

    #[test]
    fn the_trackers_own_lines_are_read_as_they_were_meant() {
        let mut sample = crate::record::PoseSample::new(3, Timestamp::from_ns(99), State::Tracking);
        sample.pose = Some(Pose::new(UnitQuaternion::from_euler_angles(0.1, 0.2, 0.3), Vector3::new(0.1, 0.2, 0.3)));
        let mut prop = crate::record::ObjectSample::new("prop", State::Tracking);
        prop.pose = Some(Pose::new(UnitQuaternion::from_euler_angles(0.3, 0.2, 0.1), Vector3::new(0.7, 0.2, 0.3)));
        sample.objects = vec![prop.clone(), crate::record::ObjectSample::new("chair", State::Lost)];
        let take = parse(&[sample.to_json_line()]).unwrap();
        assert!(take.camera[0].pose.angle_to(&sample.pose.unwrap()) < 1e-15);
        assert!(take.objects["prop"][0].pose.angle_to(&prop.pose.unwrap()) < 1e-15);
        assert_eq!(take.objects["chair"], []);
    }

    #[test]
    fn every_fault_names_its_line_and_key() {
        let good = line(0, "tracking", POSE);
        let cut = &line(1, "tracking", POSE)[..60];
        for (text, parts) in [
            (String::new(), vec!["no record"]),
            (format!("{good}\n{cut}"), vec!["line 2 is cut off"]),
            (format!("{good}\n0.0333 1 2 3 0 0 0 1\n"), vec!["line 2 is not a pose record", "expected a JSON object"]),
            (format!("{good}\nxyz\n"), vec!["line 2 is not JSON"]),
            ("{\"width\":640}".to_owned(), vec!["line 1", "timestamp_ns"]),
            (line(0, "dreaming", POSE), vec!["line 1", "dreaming"]),
            (line(0, "tracking", "{\"position_m\":[1,2]}"), vec!["line 1", "length 2"]),
            (line(0, "tracking", &POSE.replace("0.8", "0.9")), vec!["line 1", "`orientation_xyzw` of the camera", "unit quaternion"]),
            (line(0, "tracking", &POSE.replace("1.0", "1e300")), vec!["line 1", "`position_m`"]),
            (format!("{good}\n{good}"), vec!["line 2", "timestamp_ns", "one recording"]),
            (line(0, "lost", "null"), vec!["none of its 1 records"]),
        ] {
            let message = Take::parse(text.clone().into_bytes()).unwrap_err().to_string();
            assert!(parts.iter().all(|part| message.contains(part)), "{text}: {message}");
        }
        assert_eq!(Take::parse(vec![b'{', b'\n', 0xFF]), Err(TakeError::NotText { line: 2 }));
    }
}
