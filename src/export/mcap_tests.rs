//! Reads the file back with a small parser of its own.

use super::*;
use crate::export::synthetic;

fn written(take: &Take, lens: Option<&Intrinsics>, recording: Option<&Recording<'_>>) -> Result<Vec<u8>, McapError> {
    let mut bytes = Vec::new();
    write(take, lens, recording, &mut bytes).map(|()| bytes)
}

/// Reads fields from the front of a record.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn take(&mut self, length: usize) -> &'a [u8] {
        let (field, rest) = self.0.split_at(length);
        self.0 = rest;
        field
    }

    fn number(&mut self, length: usize) -> u64 {
        self.take(length).iter().rev().fold(0, |number, byte| number << 8 | u64::from(*byte))
    }

    fn text(&mut self) -> String {
        let length = self.number(4) as usize;
        String::from_utf8(self.take(length).to_vec()).unwrap()
    }
}

/// Returns the records as (opcode, content), and asserts that the file is whole.
fn records(bytes: &[u8]) -> Vec<(u8, &[u8])> {
    let inside = bytes.strip_prefix(MAGIC).and_then(|rest| rest.strip_suffix(MAGIC)).expect("magic at both ends");
    let (mut fields, mut records) = (Fields(inside), Vec::new());
    while !fields.0.is_empty() {
        let opcode = fields.take(1)[0];
        let length = fields.number(8) as usize;
        records.push((opcode, fields.take(length)));
    }
    records
}

#[test]
fn every_record_and_pose_is_a_message_at_its_stamp() {
    let take = synthetic::take();
    let bytes = written(&take, Some(&synthetic::lens()), None).unwrap();
    let all = records(&bytes);
    let codes: Vec<u8> = all.iter().map(|(opcode, _)| *opcode).collect();
    assert_eq!(codes[..7], [HEADER, SCHEMA, CHANNEL, SCHEMA, CHANNEL, SCHEMA, CHANNEL]);
    assert_eq!(codes[codes.len() - 2..], [DATA_END, FOOTER]);
    let mut channels = std::collections::BTreeMap::new();
    for (_, content) in all.iter().filter(|(opcode, _)| *opcode == CHANNEL) {
        let mut fields = Fields(content);
        let [number, schema] = [fields.number(2), fields.number(2)];
        assert_eq!(number, schema);
        channels.insert(number, fields.text());
    }
    let mut messages: Vec<(String, u64, Value)> = Vec::new();
    for (_, content) in all.iter().filter(|(opcode, _)| *opcode == MESSAGE) {
        let mut fields = Fields(content);
        let (channel, _sequence) = (fields.number(2), fields.number(4));
        let [logged, published] = [fields.number(8), fields.number(8)];
        assert_eq!(logged, published);
        messages.push((channels[&channel].clone(), logged, serde_json::from_slice(fields.0).unwrap()));
    }
    let on = |topic: &str| messages.iter().filter(|message| message.0 == topic).collect::<Vec<_>>();
    let lines: Vec<Value> = synthetic::text().lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(on("/stagepose/record").iter().map(|message| message.2.clone()).collect::<Vec<_>>(), lines);
    assert!(on("/stagepose/record").iter().all(|(_, stamp, record)| record["timestamp_ns"] == *stamp));
    let of_camera: Vec<_> = on("/tf").into_iter().filter(|message| message.2["child_frame_id"] == "camera").collect();
    assert_eq!((of_camera.len(), on("/tf").len()), (take.camera.len(), take.camera.len() + 3));
    for ((_, stamp, transform), key) in of_camera.iter().zip(&take.camera) {
        assert_eq!(*stamp, key.timestamp.ns() as u64);
        assert_eq!(transform["timestamp"], json!({"sec": stamp / 1_000_000_000, "nsec": stamp % 1_000_000_000}));
        let position = ["x", "y", "z"].map(|axis| transform["translation"][axis].as_f64().unwrap());
        let q = ["x", "y", "z", "w"].map(|axis| transform["rotation"][axis].as_f64().unwrap());
        assert!((nalgebra::Vector3::from(position) - key.pose.translation).norm() < 1e-12);
        assert!(q.iter().zip(key.pose.orientation_xyzw()).all(|(a, b)| (a - b).abs() < 1e-12));
    }
    assert_eq!(on("/stagepose/camera")[0].2["D"], json!(synthetic::lens().distortion));
}

#[test]
fn schemas_are_json_and_fit_their_messages() {
    let bytes = written(&synthetic::take(), Some(&synthetic::lens()), None).unwrap();
    let mut schemas = std::collections::BTreeMap::new();
    for (opcode, content) in records(&bytes) {
        let mut fields = Fields(content);
        if opcode == SCHEMA {
            let number = fields.number(2);
            assert_eq!((fields.text().contains('.'), fields.text()), (true, "jsonschema".to_owned()));
            schemas.insert(number, serde_json::from_str::<Value>(&fields.text()).unwrap());
        } else if opcode == MESSAGE {
            let schema = &schemas[&fields.number(2)];
            let message: Value = serde_json::from_slice(&fields.0[20..]).unwrap();
            for name in schema["required"].as_array().unwrap() {
                assert!(message.get(name.as_str().unwrap()).is_some(), "{name}");
            }
            for name in message.as_object().unwrap().keys() {
                assert!(schema["properties"].get(name).is_some(), "{name}");
            }
        }
    }
}

#[test]
fn a_stamp_below_zero_is_refused() {
    let text = synthetic::text().replacen("\"timestamp_ns\":5000000000", "\"timestamp_ns\":-5", 1);
    let take = Take::parse(text.into_bytes()).unwrap();
    assert!(matches!(written(&take, None, None), Err(McapError::BeforeZero { row: 0 })));
}

/// Returns the messages as (topic, stamp, JSON).
fn messages(bytes: &[u8]) -> Vec<(String, u64, Value)> {
    let all = records(bytes);
    let mut channels = std::collections::BTreeMap::new();
    for (_, content) in all.iter().filter(|(opcode, _)| *opcode == CHANNEL) {
        let mut fields = Fields(content);
        let [number, _] = [fields.number(2), fields.number(2)];
        channels.insert(number, fields.text());
    }
    let message = |content: &&[u8]| {
        let mut fields = Fields(content);
        let (channel, _, logged, _) = (fields.number(2), fields.number(4), fields.number(8), fields.number(8));
        (channels[&channel].clone(), logged, serde_json::from_slice(fields.0).unwrap())
    };
    all.iter().filter(|(opcode, _)| *opcode == MESSAGE).map(|(_, content)| message(content)).collect()
}

#[test]
fn a_recordings_pictures_and_events_are_in_order_of_time() {
    let take = synthetic::take();
    let (first, last) = (take.stamp(0), take.stamp(take.rows() - 1));
    let event = |at: Timestamp, word: &str| (at, json!({"timestamp_ns": at.ns(), "event": word}).to_string());
    let events = vec![event(first, "tracked"), event(last.after_ns(5), "ended")];
    let picture = |row: usize| (row != 1).then(|| vec![0xFF, 0xD8, row as u8]);
    let bytes = written(&take, None, Some(&Recording { picture: &picture, events })).unwrap();
    let messages = messages(&bytes);
    assert!(messages.is_sorted_by_key(|(_, stamp, _)| *stamp));
    let on = |topic: &str| messages.iter().filter(|message| message.0 == topic).collect::<Vec<_>>();
    let words: Vec<&str> = on("/stagepose/event").iter().map(|message| message.2["event"].as_str().unwrap()).collect();
    assert_eq!(words, ["tracked", "ended"]);
    let images = on("/stagepose/image");
    assert_eq!((images.len(), images[0].1, &images[0].2["data"]), (take.rows() - 1, first.ns() as u64, &json!(base64(&[0xFF, 0xD8, 0]))));
}

#[test]
fn a_full_disk_is_an_error() {
    struct Full;
    impl std::io::Write for Full {
        fn write(&mut self, _: &[u8]) -> std::io::Result<usize> {
            Err(std::io::Error::other("full"))
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }
    assert!(matches!(write(&synthetic::take(), None, None, &mut Full), Err(McapError::Write(_))));
}
