//! The recordings in a report: the newest clip, and what the ring holds or held.

use std::collections::BTreeMap;
use std::io::{self, BufRead, BufReader, Write};
use std::path::{Path, PathBuf};

use super::bundle::Bundle;
use crate::capture::timestamps::read_timestamps;
use crate::frame::Timestamp;
use crate::safe_file;

/// The text files of a clip that go into a report, if they exist.
const TEXTS: [&str; 5] = ["clip.toml", "events.jsonl", "poses.jsonl", "timestamps.csv", "dropped.csv"];

/// A clip on disk.
pub struct Recording {
    /// Its folder in the report.
    name: String,
    folder: PathBuf,
}

/// Returns the named clip, else the newest in the recorder's folder; then the ring's parts.
pub fn find(named: Option<&Path>, folder: Option<&Path>) -> Vec<Recording> {
    let newest = || folder.and_then(|folder| clips(folder).pop());
    let clip = named.map(Path::to_owned).or_else(newest).map(|folder| Recording { name: "recording".to_owned(), folder });
    let rings = folder.iter().flat_map(|folder| {
        ["ring-before", "ring"].into_iter().flat_map(|ring| {
            let parts = clips(&folder.join(ring)).into_iter().enumerate();
            parts.map(move |(n, folder)| Recording { name: format!("{ring}/{n:02}"), folder }).collect::<Vec<_>>()
        })
    });
    clip.into_iter().chain(rings).collect()
}

/// Returns the clips in a folder, oldest first.
fn clips(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut clips: Vec<_> = entries
        .filter_map(|clip| {
            let begun = clip.join("timestamps.csv").metadata().and_then(|m| m.modified()).ok()?;
            Some((begun, clip))
        })
        .collect();
    clips.sort();
    clips.into_iter().map(|(_, clip)| clip).collect()
}

impl Recording {
    /// Adds texts, counts and, if requested, the last seconds of pictures to the report.
    pub(super) fn add<W: Write>(&self, bundle: &mut Bundle<W>, picture_seconds: Option<f64>) -> io::Result<()> {
        let Self { name, folder } = self;
        for text in TEXTS.iter().filter(|text| folder.join(text).exists()) {
            bundle.add_below(&format!("{name}/{text}"), folder, Path::new(text))?;
        }
        bundle.add(&format!("{name}/summary.json"), self.summary())?;
        for picture in picture_seconds.map(|seconds| self.last_pictures(seconds)).unwrap_or_default() {
            bundle.add_below(&format!("{name}/frames/{picture}"), folder, &Path::new("frames").join(&picture))?;
        }
        Ok(())
    }

    /// Returns the names of the pictures in the last `seconds` of the clip.
    pub fn last_pictures(&self, seconds: f64) -> Vec<String> {
        let Ok(file) = safe_file::open_below(&self.folder, Path::new("timestamps.csv")) else { return Vec::new() };
        let rows = read_timestamps(file).unwrap_or_default();
        let stamped: Vec<(Timestamp, String)> = rows.into_iter().filter_map(|row| Some((row.stamp.ok()?, row.file))).collect();
        let Some(end) = stamped.iter().map(|(stamp, _)| *stamp).max() else { return Vec::new() };
        let since = end.after_s(-seconds);
        // A name that leads out of the clip is not one of its pictures.
        let is_inside = |name: &str| Path::new(name).components().all(|c| matches!(c, std::path::Component::Normal(_)));
        stamped.into_iter().filter(|(stamp, name)| *stamp >= since && is_inside(name)).map(|(_, name)| name).collect()
    }

    /// Counts the records by state.
    fn summary(&self) -> String {
        let mut states: BTreeMap<String, u64> = BTreeMap::new();
        let records = safe_file::open_below(&self.folder, Path::new("poses.jsonl")).map(BufReader::new);
        // Read line by line, as an hour's records do not fit into memory, and stop at an unreadable
        // line, as what follows is unknown.
        for line in records.into_iter().flat_map(BufRead::lines).map_while(Result::ok) {
            let record: Option<serde_json::Value> = serde_json::from_str(&line).ok();
            let state = record.as_ref().and_then(|r| r["state"].as_str()).unwrap_or("not a record");
            *states.entry(state.to_owned()).or_default() += 1;
        }
        let frames: u64 = states.values().sum();
        serde_json::json!({ "folder": self.folder, "frames": frames, "states": states }).to_string() + "\n"
    }
}
