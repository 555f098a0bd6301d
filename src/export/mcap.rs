//! MCAP, the container of Foxglove and rerun: every record at its stamp, and the frames they show.
//!
//! Channels: `/stagepose/record`, each record as it was read; `/tf`, poses as
//! `foxglove.FrameTransform` from `stage` to `camera` and to each object; with a lens,
//! `/stagepose/camera`, one `foxglove.CameraCalibration` with its distortion; with timecode,
//! `/stagepose/timecode`, that of each record; of a recording, `/stagepose/image`, its JPEGs as
//! `foxglove.CompressedImage`, and `/stagepose/event`, its events. All are JSON.
//! Foxglove's camera frames have our axes.
//!
//! The file has neither chunks nor a summary: readers go through it once. Source: the MCAP format
//! specification (mcap.dev) and Foxglove's message schemas.

use std::io::{self, Write};

use serde_json::{Value, json};
use thiserror::Error;

use super::take::Take;
use crate::camera::Intrinsics;
use crate::frame::Timestamp;
use crate::geometry::Pose;
use crate::html_page::svg::base64;

/// First and last bytes of a file.
const MAGIC: &[u8; 8] = b"\x89MCAP0\r\n";
/// Opcodes of the records used here.
const HEADER: u8 = 0x01;
const FOOTER: u8 = 0x02;
const SCHEMA: u8 = 0x03;
const CHANNEL: u8 = 0x04;
const MESSAGE: u8 = 0x05;
const DATA_END: u8 = 0x0F;

/// Channels and their schemas, by their numbers in the file.
const RECORDS: u16 = 1;
const TRANSFORMS: u16 = 2;
const CAMERA: u16 = 3;
const TIMECODES: u16 = 4;
const IMAGES: u16 = 5;
const EVENTS: u16 = 6;

/// Why a take cannot be written.
#[derive(Debug, Error)]
pub enum McapError {
    /// A stamp is negative.
    #[error("record {row} (counted from 0) has a `timestamp_ns` below 0, which MCAP cannot hold; export to another format")]
    BeforeZero {
        /// The row.
        row: usize,
    },
    /// The file cannot be written.
    #[error("cannot be written ({0}); give a path with free space")]
    Write(io::Error),
}

/// What a recording has besides its poses.
pub struct Recording<'a> {
    /// Returns the JPEG of a row; `None` if it has none.
    pub picture: &'a dyn Fn(usize) -> Option<Vec<u8>>,
    /// Its events, each one line of JSON, in order of their stamps.
    pub events: Vec<(Timestamp, String)>,
}

/// Writes a take, and what is known of its lens and its recording.
///
/// # Errors
/// A stamp below 0, or `out` fails.
pub fn write(take: &Take, lens: Option<&Intrinsics>, recording: Option<&Recording<'_>>, out: &mut dyn Write) -> Result<(), McapError> {
    let mut file = Mcap { out, failed: None, sent: [0; 7] };
    file.bytes(MAGIC);
    file.record(HEADER, &[string(""), string(concat!("stagepose ", env!("CARGO_PKG_VERSION")))]);
    file.channel(RECORDS, "/stagepose/record", "stagepose.PoseRecord", &record_schema());
    file.channel(TRANSFORMS, "/tf", "foxglove.FrameTransform", &transform_schema());
    if let Some(lens) = lens {
        file.channel(CAMERA, "/stagepose/camera", "foxglove.CameraCalibration", &camera_schema());
        let first = take.lines().next().map_or(0, |(_, stamp)| stamp.ns());
        let stamp = u64::try_from(first).map_err(|_| McapError::BeforeZero { row: 0 })?;
        file.message(CAMERA, stamp, camera(lens, stamp).to_string().as_bytes());
    }
    let mut timecodes = take.timecodes().peekable();
    if timecodes.peek().is_some() {
        file.channel(TIMECODES, "/stagepose/timecode", "stagepose.Timecode", &timecode_schema());
    }
    if recording.is_some() {
        file.channel(IMAGES, "/stagepose/image", "foxglove.CompressedImage", &image_schema());
        file.channel(EVENTS, "/stagepose/event", "stagepose.Event", &event_schema());
    }
    let mut events = recording.map_or(&[][..], |recording| &recording.events).iter().peekable();
    let mut transforms = transforms(take).into_iter().peekable();
    for (row, (line, stamp)) in take.lines().enumerate() {
        while let Some((at, event)) = events.next_if(|(at, _)| *at <= stamp) {
            file.event(*at, event);
        }
        let stamp = u64::try_from(stamp.ns()).map_err(|_| McapError::BeforeZero { row })?;
        if let Some(jpeg) = recording.and_then(|recording| (recording.picture)(row)) {
            file.message(IMAGES, stamp, image(&jpeg, stamp).to_string().as_bytes());
        }
        file.message(RECORDS, stamp, line.as_bytes());
        if let Some((_, _, timecode)) = timecodes.next_if(|(of_row, ..)| *of_row == row) {
            file.message(TIMECODES, stamp, timecode.to_json().as_bytes());
        }
        while let Some((_, mut transform)) = transforms.next_if(|(of_row, _)| *of_row == row) {
            transform["timestamp"] = time(stamp);
            file.message(TRANSFORMS, stamp, transform.to_string().as_bytes());
        }
    }
    events.for_each(|(at, event)| file.event(*at, event));
    // The checksums are zero, which stands for none.
    file.record(DATA_END, &[0_u32.to_le_bytes().to_vec()]);
    file.record(FOOTER, &[vec![0; 8], vec![0; 8], vec![0; 4]]);
    file.bytes(MAGIC);
    file.failed.map_or(Ok(()), |error| Err(McapError::Write(error)))
}

/// Returns all poses as transforms, in the order of their rows.
fn transforms(take: &Take) -> Vec<(usize, Value)> {
    fn of<To, From>(child: &str, pose: &Pose<To, From>) -> Value {
        let (p, [x, y, z, w]) = (pose.translation, pose.orientation_xyzw());
        json!({"parent_frame_id": "stage", "child_frame_id": child,
            "translation": {"x": p.x, "y": p.y, "z": p.z}, "rotation": {"x": x, "y": y, "z": z, "w": w}})
    }
    let camera = take.camera.iter().map(|key| (key.row, of("camera", &key.pose)));
    let objects = take.objects.iter().flat_map(|(name, keys)| keys.iter().map(move |key| (key.row, of(name, &key.pose))));
    let mut all: Vec<_> = camera.chain(objects).collect();
    all.sort_by_key(|(row, _)| *row);
    all
}

/// A file that grows.
struct Mcap<'a> {
    out: &'a mut dyn Write,
    /// The first error, after which nothing more is written.
    failed: Option<io::Error>,
    /// Messages per channel so far.
    sent: [u32; 7],
}

impl Mcap<'_> {
    fn bytes(&mut self, bytes: &[u8]) {
        if self.failed.is_none() {
            self.failed = self.out.write_all(bytes).err();
        }
    }

    /// Writes an event; one from before the clock's zero has no place.
    fn event(&mut self, at: Timestamp, line: &str) {
        if let Ok(stamp) = u64::try_from(at.ns()) {
            self.message(EVENTS, stamp, line.as_bytes());
        }
    }

    fn record(&mut self, opcode: u8, parts: &[Vec<u8>]) {
        let length: usize = parts.iter().map(Vec::len).sum();
        self.bytes(&[opcode]);
        self.bytes(&(length as u64).to_le_bytes());
        parts.iter().for_each(|part| self.bytes(part));
    }

    /// Declares a channel and the schema of the same number.
    fn channel(&mut self, number: u16, topic: &str, schema: &str, described: &Value) {
        let number = number.to_le_bytes().to_vec();
        self.record(SCHEMA, &[number.clone(), string(schema), string("jsonschema"), string(&described.to_string())]);
        let no_metadata = 0_u32.to_le_bytes().to_vec();
        self.record(CHANNEL, &[number.clone(), number, string(topic), string("json"), no_metadata]);
    }

    fn message(&mut self, channel: u16, stamp: u64, data: &[u8]) {
        let sent = &mut self.sent[usize::from(channel)];
        let sequence = *sent;
        *sent = sent.wrapping_add(1);
        let stamp = stamp.to_le_bytes().to_vec();
        self.record(MESSAGE, &[channel.to_le_bytes().to_vec(), sequence.to_le_bytes().to_vec(), stamp.clone(), stamp, data.to_vec()]);
    }
}

/// Returns a text as the format has it: its length, then its bytes.
fn string(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes(), text.as_bytes()].concat()
}

fn time(ns: u64) -> Value {
    json!({"sec": ns / 1_000_000_000, "nsec": ns % 1_000_000_000})
}

fn camera(lens: &Intrinsics, stamp: u64) -> Value {
    let skew = lens.fx * lens.skew;
    let k = [lens.fx, skew, lens.cx, 0.0, lens.fy, lens.cy, 0.0, 0.0, 1.0];
    json!({"timestamp": time(stamp), "frame_id": "camera", "width": lens.width, "height": lens.height,
        "distortion_model": "plumb_bob", "D": lens.distortion, "K": k, "R": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "P": [lens.fx, skew, lens.cx, 0.0, 0.0, lens.fy, lens.cy, 0.0, 0.0, 0.0, 1.0, 0.0]})
}

fn image(jpeg: &[u8], stamp: u64) -> Value {
    json!({"timestamp": time(stamp), "frame_id": "camera", "format": "jpeg", "data": base64(jpeg)})
}

fn image_schema() -> Value {
    object_schema(
        "foxglove.CompressedImage",
        json!({"timestamp": time_schema(), "frame_id": {"type": "string"}, "format": {"type": "string"},
            "data": {"type": "string", "contentEncoding": "base64"}}),
    )
}

fn event_schema() -> Value {
    json!({"title": "stagepose.Event", "type": "object", "required": ["timestamp_ns", "event"],
        "properties": {"timestamp_ns": {"type": "integer"}, "event": {"type": "string"}}})
}

/// The schema of an object with these properties, all of them required.
fn object_schema(title: &str, properties: Value) -> Value {
    let required: Vec<&String> = properties.as_object().into_iter().flat_map(|p| p.keys()).collect();
    json!({"title": title, "type": "object", "required": required, "properties": properties})
}

fn numbers_schema(names: &[&str]) -> Value {
    let properties = names.iter().map(|name| ((*name).to_owned(), json!({"type": "number"}))).collect();
    object_schema("numbers", Value::Object(properties))
}

fn time_schema() -> Value {
    let whole = json!({"type": "integer", "minimum": 0});
    object_schema("time", json!({"sec": whole, "nsec": whole}))
}

fn transform_schema() -> Value {
    object_schema(
        "foxglove.FrameTransform",
        json!({"timestamp": time_schema(), "parent_frame_id": {"type": "string"}, "child_frame_id": {"type": "string"},
            "translation": numbers_schema(&["x", "y", "z"]), "rotation": numbers_schema(&["x", "y", "z", "w"])}),
    )
}

fn camera_schema() -> Value {
    let (list, whole) = (json!({"type": "array", "items": {"type": "number"}}), json!({"type": "integer", "minimum": 0}));
    object_schema(
        "foxglove.CameraCalibration",
        json!({"timestamp": time_schema(), "frame_id": {"type": "string"}, "width": whole, "height": whole,
            "distortion_model": {"type": "string"}, "D": list, "K": list, "R": list, "P": list}),
    )
}

fn timecode_schema() -> Value {
    let (word, number) = (json!({"type": "string"}), json!({"type": "number"}));
    json!({"title": "stagepose.Timecode", "type": "object", "required": ["timecode", "fraction", "rate", "state"],
        "properties": {"timecode": word, "fraction": number, "rate": word, "state": word, "without_s": number}})
}

/// The record as `docs/record.md` describes it. Only what every record has is required.
fn record_schema() -> Value {
    let list = json!({"type": ["array", "null"], "items": {"type": "number"}});
    let pose = json!({"type": ["object", "null"], "properties": {"position_m": list, "orientation_xyzw": list}});
    let number = json!({"type": ["number", "null"]});
    let states = json!({"type": "string", "enum": ["searching", "tracking", "coasting", "lost"]});
    let essential = json!({"type": ["object", "null"],
        "properties": {"rotation_xyzw": list, "translation_direction": list, "inliers": number}});
    let object = json!({"type": "object",
        "properties": {"name": {"type": "string"}, "state": states, "pose": pose, "covariance": list}});
    json!({"title": "stagepose.PoseRecord", "type": "object", "required": ["timestamp_ns", "state", "pose"],
        "properties": {"sequence": {"type": "integer"}, "timestamp_ns": {"type": "integer"}, "state": states, "pose": pose, "measured": pose,
            "covariance": list, "model": {"type": ["string", "null"]}, "homography": list, "essential": essential, "inliers": number,
            "rms_px": number, "objects": {"type": "array", "items": object}}})
}

#[cfg(test)]
#[path = "mcap_tests.rs"]
mod tests;
