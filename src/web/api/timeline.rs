//! A recording's states and fit over time, condensed to as many columns as a screen has.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{self, BufRead, BufReader};
use std::path::Path;

use serde::Deserialize;
use serde_json::{Value, json};

use crate::daemon::live::Event;
use crate::safe_file;
use crate::web::events::level_and_message;

/// Maximum number of events, the first ones: a list that a person reads. Raised, larger answers.
const MAX_EVENTS: usize = 2000;

/// The fields of a record that a timeline needs.
#[derive(Debug, PartialEq, Deserialize)]
struct Row<'a> {
    timestamp_ns: i64,
    #[serde(borrow)]
    state: Cow<'a, str>,
    rms_px: Option<f64>,
}

impl<'a> Row<'a> {
    /// Parses a line; returns `None` if it is not a record.
    fn of(line: &'a str) -> Option<Self> {
        Self::at_its_places(line).or_else(|| serde_json::from_str(line).ok())
    }

    /// Parses only the positions where this program writes the fields, which is fast: a record has
    /// a hundred numbers, and an hour a hundred thousand records.
    fn at_its_places(line: &'a str) -> Option<Self> {
        let (_, rest) = line.strip_suffix('}')?.strip_prefix("{\"sequence\":")?.split_once(",\"timestamp_ns\":")?;
        let (stamp, rest) = rest.split_once(",\"state\":\"")?;
        let (state, _) = rest.split_once('"')?;
        let (_, fit) = line.rsplit_once(",\"rms_px\":")?;
        let (fit, _) = fit.split_once([',', '}'])?;
        let rms_px = if fit == "null" { None } else { Some(fit.parse().ok()?) };
        Some(Self { timestamp_ns: stamp.parse().ok()?, state: state.into(), rms_px })
    }
}

/// Several adjacent rows combined.
#[derive(Debug, Default)]
struct Column {
    rows: u64,
    states: BTreeMap<String, u64>,
    rms_px: Option<f64>,
}

/// States, worst first: a single lost frame shows among hundreds of tracked ones.
const WORST_FIRST: [&str; 4] = ["lost", "searching", "coasting", "tracking"];

impl Column {
    fn add(&mut self, row: &Row<'_>) {
        self.rows += 1;
        self.rms_px = [self.rms_px, row.rms_px].into_iter().flatten().reduce(f64::max);
        match self.states.get_mut(&*row.state) {
            Some(count) => *count += 1,
            None => _ = self.states.insert(row.state.to_string(), 1),
        }
    }

    fn join(&mut self, other: Self) {
        self.rows += other.rows;
        self.rms_px = [self.rms_px, other.rms_px].into_iter().flatten().reduce(f64::max);
        other.states.into_iter().for_each(|(state, n)| *self.states.entry(state).or_default() += n);
    }
}

/// Returns the timeline of a clip's file of records, with its events; it ends at the first
/// unreadable record.
pub(super) fn timeline(clip: &Path, poses: &str, points: usize) -> io::Result<Value> {
    let (mut columns, mut of_each): (Vec<Column>, u64) = (Vec::new(), 1);
    let (mut stamps, mut rows): (Vec<i64>, u64) = (Vec::new(), 0);
    let (mut reader, mut line) = (BufReader::with_capacity(1 << 18, safe_file::open_below(clip, Path::new(poses))?), String::new());
    loop {
        line.clear();
        if reader.read_line(&mut line).is_ok_and(|length| length == 0) {
            break;
        }
        let Some(row) = Row::of(line.trim_end()) else { break };
        rows += 1;
        stamps.push(row.timestamp_ns);
        match columns.last_mut().filter(|column| column.rows < of_each) {
            Some(column) => column.add(&row),
            None => {
                // At twice the wanted number, adjacent columns are joined in pairs.
                if columns.len() >= 2 * points {
                    columns = joined(columns);
                    of_each *= 2;
                }
                let mut column = Column::default();
                column.add(&row);
                columns.push(column);
            }
        }
    }
    while columns.len() > points {
        columns = joined(columns);
    }
    let mut first_row = 0;
    let column_values: Vec<Value> = columns
        .into_iter()
        .map(|column| {
            let state = WORST_FIRST.into_iter().find(|state| column.states.contains_key(*state));
            let value = json!({"row": first_row, "rows": column.rows, "state": state, "rms_px": column.rms_px, "states": column.states});
            first_row += column.rows;
            value
        })
        .collect();
    let ends = (stamps.first().copied(), stamps.last().copied());
    Ok(json!({"frames": rows, "first_ns": ends.0, "last_ns": ends.1, "columns": column_values, "events": with_rows(clip, &stamps)}))
}

fn joined(columns: Vec<Column>) -> Vec<Column> {
    let mut joined: Vec<Column> = Vec::with_capacity(columns.len() / 2 + 1);
    for (k, column) in columns.into_iter().enumerate() {
        match joined.last_mut().filter(|_| k % 2 == 1) {
            Some(before) => before.join(column),
            None => joined.push(column),
        }
    }
    joined
}

/// Returns the events in the order of the file, each with its severity, its sentence, and the first
/// row at or after it.
fn with_rows(clip: &Path, stamps: &[i64]) -> Vec<Value> {
    let Ok(file) = safe_file::open_below(clip, Path::new("events.jsonl")) else { return Vec::new() };
    let lines = BufReader::new(file).lines().map_while(Result::ok);
    let events = lines.filter_map(|line| serde_json::from_str::<Value>(&line).ok()).filter(Value::is_object);
    events
        .take(MAX_EVENTS)
        .map(|mut event| {
            let at = event["timestamp_ns"].as_i64().unwrap_or_default();
            let (level, message) = match serde_json::from_value::<Event>(event.clone()) {
                Ok(event) => level_and_message(&event),
                // An event of another version.
                Err(_) => ("info", event["event"].as_str().unwrap_or("event").replace('_', " ")),
            };
            event["level"] = level.into();
            event["says"] = message.into();
            event["row"] = stamps.partition_point(|stamp| *stamp < at).min(stamps.len().saturating_sub(1)).into();
            event
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(k: i64, state: &str, rms_px: &str) -> String {
        format!("{{\"timestamp_ns\":{},\"state\":\"{state}\",\"rms_px\":{rms_px}}}\n", 100 * k)
    }

    #[test]
    fn fast_record_parsing_equals_full_parsing() {
        let [tracked, mut lost] = crate::web::api::types_tests::samples();
        lost.objects[0].name = "a\",\"rms_px\":7,\"state\":\"tracking".to_owned();
        for sample in [tracked, lost] {
            let line = sample.to_json_line();
            let whole: Row = serde_json::from_str(&line).unwrap();
            assert_eq!(Row::at_its_places(&line), Some(whole), "{line}");
            assert_eq!(Row::of(&line[..line.len() - 1]), None, "a record that is being written is none yet");
        }
    }

    #[test]
    fn timeline_columns_keep_the_worst_and_count_every_row() {
        let folder = tempfile::tempdir().unwrap();
        let (poses, events) = (folder.path().join("poses.jsonl"), folder.path().join("events.jsonl"));
        let text: String =
            (0..1001).map(|k| if k == 700 { line(k, "lost", "null") } else { line(k, "tracking", &format!("0.{k}1")) }).collect();
        std::fs::write(&poses, text).unwrap();
        std::fs::write(&events, "{\"timestamp_ns\":70000,\"event\":\"marked\",\"text\":\"cue 1\"}\nnonsense\n{\"timestamp_ns\":1000000,\"event\":\"no_such_event\"}\n").unwrap();
        for points in [1, 7, 100, 1000, 4000] {
            let answer = timeline(folder.path(), "poses.jsonl", points).unwrap();
            let columns = answer["columns"].as_array().unwrap();
            assert!(columns.len() <= points && columns.len() * 2 + 2 > points.min(1001), "{} of {points}", columns.len());
            assert_eq!(columns.iter().map(|c| c["rows"].as_u64().unwrap()).sum::<u64>(), 1001);
            let lost: Vec<_> = columns.iter().filter(|c| c["state"] == "lost").collect();
            assert_eq!(lost.len(), 1);
            let first = lost[0]["row"].as_u64().unwrap();
            assert!((first..first + lost[0]["rows"].as_u64().unwrap()).contains(&700));
            assert_eq!((&answer["frames"], &answer["last_ns"]), (&1001.into(), &100_000.into()));
            let rows: Vec<_> = answer["events"].as_array().unwrap().iter().map(|e| e["row"].as_u64().unwrap()).collect();
            assert_eq!(rows, [700, 1000]);
            let messages: Vec<_> = answer["events"].as_array().unwrap().iter().map(|e| (e["level"].as_str(), e["says"].as_str())).collect();
            assert_eq!(messages, [(Some("info"), Some("marked: cue 1")), (Some("info"), Some("no such event"))]);
        }
        std::fs::write(&poses, "").unwrap();
        std::fs::remove_file(&events).unwrap();
        assert_eq!(timeline(folder.path(), "poses.jsonl", 10).unwrap()["frames"], 0);
    }
}
