//! Tracks a recording again with another config, and compares the records row by row.
//!
//! It writes a folder `retracked/` in the recording's folder, with `poses.jsonl` (contract C3),
//! `differences.jsonl` (a line per row) and `compared.json`. The folder is replaced as a whole. Its
//! content is the same to the byte each time, whatever the machine's load.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufRead, BufReader, BufWriter, Write};
use std::path::Path;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::{Progress, kept_views, learnt_of_clip, thread_clock, track_entry};
use crate::capture::{ClipOptions, open_clip};
use crate::config::Settings;
use crate::safe_file;
use crate::tracker::{Tracker, TrackerSetup};

/// The folder's name in the recording's folder.
const FOLDER: &str = "retracked";
/// Maximum size of a recording's `clip.toml`, bytes. Raised, a foreign file takes more memory.
const MAX_ABOUT: u64 = 1 << 20;

/// The compared fields of a record.
#[derive(Debug, Deserialize)]
struct ComparedRecord {
    state: String,
    measured: Option<Placed>,
    rms_px: Option<f64>,
}

#[derive(Debug, Deserialize)]
struct Placed {
    position_m: [f64; 3],
    orientation_xyzw: [f64; 4],
}

/// The difference between a row's two records; fields that one of them lacks are null.
#[derive(Debug, Serialize)]
struct Difference<'a> {
    row: u64,
    recorded: Option<&'a str>,
    retracked: &'a str,
    position_mm: Option<f64>,
    angle_deg: Option<f64>,
    rms_px: [Option<f64>; 2],
}

/// The accumulated differences.
#[derive(Debug, Default)]
struct Compared {
    rows: u64,
    same_record: u64,
    same_state: u64,
    states: [BTreeMap<String, u64>; 2],
    rms_px: [Vec<f64>; 2],
    position_mm: Vec<f64>,
    angle_deg: Vec<f64>,
}

/// Tracks the recording in this folder with this config; returns a sentence on the result.
///
/// # Errors
/// A sentence that says why not; the earlier result then stays.
pub fn retrack(clip: &Path, settings: &Settings, progress: &mut Progress) -> Result<String, String> {
    let options = ClipOptions { calibrated: settings.lens.size(&settings.camera), ..ClipOptions::default() };
    let mut source = open_clip(clip, options).map_err(|e| e.to_string())?;
    source.notes().iter().for_each(|note| tracing::warn!("{}: {note}", clip.display()));
    let (width, height) = source.size();
    let (setup, _) = settings.tracker_setup(width, height).map_err(|e| e.to_string())?;
    let mut setup = TrackerSetup { clock: thread_clock(), store: kept_views(), ..setup };
    // One thread, at low priority; the records do not depend on the number of threads.
    setup.settings.threads = 1;
    setup.learnt = learnt_of_clip(clip).unwrap_or_default();
    setup.shutter.exposure_s = setup.shutter.exposure_s.or_else(|| locked_exposure_s(clip));
    let mut tracker = Tracker::new(setup).map_err(|e| e.to_string())?.with_filter(settings.filter);
    let part = Part::begin(clip).map_err(|e| unwritable(clip, &e))?;
    let (mut poses, mut differences) = part.files().map_err(|e| unwritable(clip, &e))?;
    let recorded = safe_file::open(&clip.join("poses.jsonl")).map_err(|e| format!("its poses.jsonl cannot be read ({e})"))?;
    let mut recorded = BufReader::new(recorded).lines();
    let (mut compared, rows) = (Compared::default(), source.rows());
    while let Some(row) = source.next_entry() {
        let line = track_entry(&mut tracker, &row).to_json_line();
        let before = recorded.next().transpose().map_err(|e| format!("its poses.jsonl cannot be read ({e})"))?;
        let difference = compared.add(before.as_deref(), &line);
        writeln!(poses, "{line}").and_then(|()| writeln!(differences, "{difference}")).map_err(|e| unwritable(clip, &e))?;
        let done = rows.filter(|rows| *rows > 0).map_or(0.0, |rows| (compared.rows as f64 / rows as f64).min(1.0));
        if !progress.report(done) {
            return Err("it was cancelled".to_owned());
        }
    }
    let message = compared.message();
    let written = poses.flush().and_then(|()| differences.flush()).and_then(|()| part.finish(&compared.summary()));
    written.map_err(|e| unwritable(clip, &e)).map(|()| message)
}

fn unwritable(clip: &Path, error: &io::Error) -> String {
    format!("{}: cannot be written ({error}); make room on the disk, or let the daemon write there", clip.join(FOLDER).display())
}

/// Returns the exposure that the camera had locked during the recording, seconds.
fn locked_exposure_s(clip: &Path) -> Option<f64> {
    let text = safe_file::read(&clip.join("clip.toml"), MAX_ABOUT).ok().and_then(|bytes| String::from_utf8(bytes).ok());
    let about: Option<toml::Table> = text.and_then(|text| text.parse().ok());
    let exposure_s = about.as_ref().and_then(|about| about.get("camera")?.get("exposure_s")?.as_float());
    exposure_s.filter(|exposure_s| *exposure_s > 0.0 && *exposure_s <= 1.0)
}

/// The folder while it is incomplete; it is removed unless it is finished.
struct Part<'a> {
    clip: &'a Path,
}

impl<'a> Part<'a> {
    fn path(&self) -> std::path::PathBuf {
        self.clip.join(format!(".{FOLDER}"))
    }

    fn begin(clip: &'a Path) -> io::Result<Self> {
        let part = Self { clip };
        let _ = std::fs::remove_dir_all(part.path());
        std::fs::create_dir(part.path()).map(|()| part)
    }

    fn files(&self) -> io::Result<(BufWriter<File>, BufWriter<File>)> {
        let file = |name: &str| File::create(self.path().join(name)).map(BufWriter::new);
        Ok((file("poses.jsonl")?, file("differences.jsonl")?))
    }

    fn finish(self, compared: &Value) -> io::Result<()> {
        std::fs::write(self.path().join("compared.json"), format!("{compared}\n"))?;
        let whole = self.clip.join(FOLDER);
        match std::fs::remove_dir_all(&whole) {
            Err(e) if e.kind() != io::ErrorKind::NotFound => Err(e),
            _ => std::fs::rename(self.path(), whole),
        }
    }
}

impl Drop for Part<'_> {
    fn drop(&mut self) {
        // After a successful finish nothing is left here.
        let _ = std::fs::remove_dir_all(self.path());
    }
}

impl Compared {
    /// Adds a row's two records and returns the line with their difference.
    fn add(&mut self, recorded: Option<&str>, retracked: &str) -> String {
        let read = |line: &str| serde_json::from_str::<ComparedRecord>(line).ok();
        let records = [recorded.and_then(read), read(retracked)];
        let [before, after] = &records;
        let row = self.rows;
        self.rows += 1;
        self.same_record += u64::from(recorded == Some(retracked));
        let state = |record: &Option<ComparedRecord>| record.as_ref().map(|record| record.state.clone());
        self.same_state += u64::from(state(before).is_some() && state(before) == state(after));
        for (k, record) in records.iter().enumerate() {
            let Some(record) = record else { continue };
            *self.states[k].entry(record.state.clone()).or_default() += 1;
            self.rms_px[k].extend(record.rms_px);
        }
        let placed = |record: &Option<ComparedRecord>| record.as_ref().and_then(|record| record.measured.as_ref()).map(Placed::parts);
        let moved = placed(before).zip(placed(after)).map(|((p, r), (q, s))| ((q - p).norm() * 1e3, r.angle_to(&s).to_degrees()));
        self.position_mm.extend(moved.map(|(mm, _)| mm));
        self.angle_deg.extend(moved.map(|(_, degrees)| degrees));
        let difference = Difference {
            row,
            recorded: before.as_ref().map(|record| record.state.as_str()),
            retracked: after.as_ref().map_or("", |record| record.state.as_str()),
            position_mm: moved.map(|(mm, _)| mm),
            angle_deg: moved.map(|(_, degrees)| degrees),
            rms_px: [before, after].map(|record| record.as_ref().and_then(|record| record.rms_px)),
        };
        // Serialising to a string fails only for non-string map keys, and a difference has none.
        serde_json::to_string(&difference).expect("a difference has only string keys")
    }

    fn summary(mut self) -> Value {
        let [recorded_rms, retracked_rms] = self.rms_px.each_mut().map(|all| spread(all));
        let [recorded, retracked] = self.states;
        json!({
            "rows": self.rows, "same_record": self.same_record, "same_state": self.same_state,
            "states": {"recorded": recorded, "retracked": retracked},
            "rms_px": {"recorded": recorded_rms, "retracked": retracked_rms},
            "both_tracked": self.position_mm.len(), "position_mm": spread(&mut self.position_mm), "angle_deg": spread(&mut self.angle_deg),
        })
    }

    fn message(&self) -> String {
        let tracked = |k: usize| self.states[k].get("tracking").copied().unwrap_or(0);
        format!("of {} rows {} were tracked and {} are now", self.rows, tracked(0), tracked(1))
    }
}

impl Placed {
    fn parts(&self) -> (Vector3<f64>, UnitQuaternion<f64>) {
        let [x, y, z, w] = self.orientation_xyzw;
        (self.position_m.into(), UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)))
    }
}

/// Returns median, 95th percentile and maximum; null if there are no values.
fn spread(values: &mut [f64]) -> Value {
    values.sort_by(f64::total_cmp);
    let Some(last) = values.len().checked_sub(1) else { return Value::Null };
    let at = |share: f64| values[(share * last as f64).round() as usize];
    json!({"median": at(0.5), "p95": at(0.95), "max": at(1.0)})
}

/// Returns the result of a comparison without rows: its fields, without numbers.
#[cfg(test)]
pub fn nothing_compared() -> Value {
    Compared::default().summary()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_retracked_row_reports_pose_and_state_changes() {
        let line = |state: &str, x: f64, rms: &str| {
            format!(r#"{{"state":"{state}","measured":{{"position_m":[{x},0,0],"orientation_xyzw":[0,0,0,1]}},"rms_px":{rms}}}"#)
        };
        let lost = r#"{"state":"lost","measured":null,"rms_px":null}"#;
        let mut compared = Compared::default();
        let difference: Value =
            serde_json::from_str(&compared.add(Some(&line("tracking", 1.0, "0.5")), &line("tracking", 1.002, "0.25"))).unwrap();
        assert!((difference["position_mm"].as_f64().unwrap() - 2.0).abs() < 1e-9 && difference["angle_deg"] == 0.0, "{difference}");
        assert_eq!(difference["rms_px"], json!([0.5, 0.25]));
        let difference: Value = serde_json::from_str(&compared.add(Some(lost), &line("tracking", 1.0, "0.3"))).unwrap();
        assert_eq!((&difference["row"], &difference["recorded"], &difference["position_mm"]), (&1.into(), &"lost".into(), &Value::Null));
        compared.add(Some(lost), lost);
        // The recording ended before all its records were written.
        compared.add(None, lost);
        assert_eq!(compared.message(), "of 4 rows 1 were tracked and 2 are now");
        let summary = compared.summary();
        assert_eq!((&summary["same_record"], &summary["same_state"], &summary["both_tracked"]), (&1.into(), &2.into(), &1.into()));
        assert_eq!(summary["states"]["retracked"], json!({"lost": 2, "tracking": 2}));
        assert_eq!(summary["rms_px"]["retracked"]["max"], 0.3);
    }
}
