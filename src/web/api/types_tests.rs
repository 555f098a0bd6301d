//! `page/types.d.ts`: what the program sends, as types for the page's modules.
//!
//! The types are inferred from answers that the program really serialises. Most answers have no
//! Rust type from which a macro could derive them: they are assembled with `json!` in several
//! places, and some are records of a contract with hand-written serialisers. This way the
//! declarations match what is sent, without another crate. The samples must show each field with a
//! value and, if it may be null, also without: a field that is always null, or a list that is
//! always empty, fails the test. `STAGEPOSE_REMAKE=1 cargo test --lib types_tests` rewrites the
//! file; tests/page/types.test.mjs checks the modules against it.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

use nalgebra::{Matrix3, Matrix6, UnitQuaternion, Vector3};
use serde_json::{Value, json};

use super::tests::{exchange, supervised, whole_server};
use crate::camera::{CameraModel, Intrinsics};
use crate::daemon::live::{Event, EventLog, Job, JobState};
use crate::frame::Timestamp;
use crate::protocols::golden::golden_camera;
use crate::publish::OutputStatistics;
use crate::record::{EssentialMotion, Measurement, ObjectSample, PoseSample, State, TwoViewModel};
use crate::track::{SurfaceSpec, folds};
use crate::tracker::TrackerSetup;
use crate::web::hub::tests::heads;

/// What was seen at one position of the samples.
#[derive(Debug, Default)]
struct Seen {
    is_null: bool,
    is_bool: bool,
    is_number: bool,
    strings: BTreeSet<String>,
    list: Option<Box<Seen>>,
    /// The number of objects, and for each key how many of them have it.
    objects: usize,
    keys: BTreeMap<String, (usize, Seen)>,
}

/// A set of words that becomes a type, for a key of this name whose values are all among them.
struct Words {
    name: &'static str,
    key: &'static str,
    /// A part of the key's path: two sets of words may share a key name.
    within: &'static str,
    words: Vec<&'static str>,
}

/// The declarations file being written.
struct Declarations {
    words: Vec<Words>,
    /// Type names by the form they stand for.
    names: BTreeMap<String, &'static str>,
    text: String,
}

/// Keys whose values may have any form: messages of another program.
const ANY: [&str; 1] = ["last"];

impl Seen {
    fn add(&mut self, value: &Value) {
        match value {
            Value::Null => self.is_null = true,
            Value::Bool(_) => self.is_bool = true,
            Value::Number(_) => self.is_number = true,
            Value::String(text) => _ = self.strings.insert(text.clone()),
            Value::Array(values) => values.iter().for_each(|value| self.list.get_or_insert_default().add(value)),
            Value::Object(fields) => {
                self.objects += 1;
                for (key, value) in fields {
                    let (count, seen) = self.keys.entry(key.clone()).or_default();
                    *count += 1;
                    seen.add(value);
                }
            }
        }
        if value.is_array() {
            self.list.get_or_insert_default();
        }
    }
}

impl Declarations {
    fn words_of(&self, key: &str, at: &str, seen: &BTreeSet<String>) -> String {
        let is_here = |one: &&Words| one.key == key && at.contains(one.within);
        let fitting = self.words.iter().find(|one| is_here(one) && seen.iter().all(|word| one.words.contains(&word.as_str())));
        fitting.map_or("string", |one| one.name).to_owned()
    }

    /// Returns a type as text; `key` is the key that has it.
    fn of(&self, key: &str, seen: &Seen, at: &str) -> String {
        if ANY.contains(&key) {
            return "unknown".to_owned();
        }
        let mut kinds = Vec::new();
        kinds.extend(seen.is_bool.then(|| "boolean".to_owned()));
        kinds.extend(seen.is_number.then(|| "number".to_owned()));
        if !seen.strings.is_empty() {
            kinds.push(self.words_of(key, at, &seen.strings));
        }
        if let Some(list) = &seen.list {
            let item = self.of(key, list, &format!("{at}[]"));
            kinds.push(if item.contains(' ') && !item.starts_with('{') { format!("({item})[]") } else { format!("{item}[]") });
        }
        if seen.objects > 0 {
            let form = self.fields(seen, at);
            let named = self.names.iter().find(|(known, _)| is_of(&form, known)).map(|(_, name)| (*name).to_owned());
            kinds.push(named.unwrap_or(form));
        }
        assert!(!kinds.is_empty(), "the samples never show what {at} is");
        kinds.extend(seen.is_null.then(|| "null".to_owned()));
        kinds.join(" | ")
    }

    fn fields(&self, seen: &Seen, at: &str) -> String {
        let is_by_state = seen.keys.keys().all(|key| State::ALL.iter().any(|state| state.word() == key));
        if is_by_state {
            return "Partial<Record<State, number>>".to_owned();
        }
        let field = |(key, (count, value)): (&String, &(usize, Seen))| {
            let mark = if *count < seen.objects { "?" } else { "" };
            format!("{key}{mark}: {}", self.of(key, value, &format!("{at}.{key}")))
        };
        format!("{{ {} }}", seen.keys.iter().map(field).collect::<Vec<_>>().join("; "))
    }

    fn add_words(&mut self, name: &'static str, [key, within]: [&'static str; 2], words: Vec<&'static str>, doc: &str) {
        let list: Vec<String> = words.iter().map(|word| format!("{word:?}")).collect();
        let _ = write!(self.text, "/** {doc} */\nexport type {name} = {};\n\n", list.join(" | "));
        self.words.push(Words { name, key, within, words });
    }

    fn add<'a>(&mut self, name: &'static str, doc: &str, samples: impl IntoIterator<Item = &'a Value>) {
        let mut seen = Seen::default();
        samples.into_iter().for_each(|sample| seen.add(sample));
        assert!(seen.objects > 0 && seen.list.is_none(), "{name} has no samples, or others than objects");
        let form = self.fields(&seen, name);
        let lines = inner(&form);
        let _ = write!(self.text, "/** {doc} */\nexport type {name} = {{\n");
        for field in top_level(lines) {
            let _ = writeln!(self.text, "  {field};");
        }
        self.text += "};\n\n";
        self.names.insert(form, name);
    }
}

/// Returns an object type on one line without its braces.
fn inner(form: &str) -> &str {
    form.strip_prefix("{ ").and_then(|form| form.strip_suffix(" }")).unwrap_or(form)
}

/// Whether an object of form `form` is of type `other`: it has the same fields, some of which may
/// be nullable only in `other`.
fn is_of(form: &str, other: &str) -> bool {
    let (own, others) = (top_level(inner(form)), top_level(inner(other)));
    own.len() == others.len() && own.iter().zip(others).all(|(own, other)| *own == other || format!("{own} | null") == other)
}

/// Returns the fields of an object type on one line.
fn top_level(text: &str) -> Vec<&str> {
    let (mut fields, mut depth, mut from) = (Vec::new(), 0, 0);
    for (at, letter) in text.char_indices() {
        match letter {
            '{' | '<' | '(' => depth += 1,
            '}' | '>' | ')' => depth -= 1,
            ';' if depth == 0 => {
                fields.push(text[from..at].trim());
                from = at + 1;
            }
            _ => {}
        }
    }
    fields.push(text[from..].trim());
    fields
}

/// Returns all values at a path in the samples; `[]` stands for the items of a list.
fn picked<'a>(samples: &'a [Value], path: &[&str]) -> Vec<&'a Value> {
    path.iter().fold(samples.iter().collect(), |found: Vec<&Value>, key| {
        let below = |value: &'a Value| -> Vec<&'a Value> {
            match *key {
                "[]" => value.as_array().map_or_else(Vec::new, |items| items.iter().collect()),
                key => value.get(key).filter(|value| !value.is_null()).into_iter().collect(),
            }
        };
        found.into_iter().flat_map(below).collect()
    })
}

/// Returns a row where everything is known, and one where nothing is.
pub(in crate::web) fn samples() -> [PoseSample; 2] {
    let essential = EssentialMotion { rotation: UnitQuaternion::identity(), translation_direction: Vector3::x(), inliers: 9 };
    let whole = Measurement {
        pose: golden_camera(),
        covariance: Matrix6::identity(),
        common: Matrix6::zeros(),
        model: Some(TwoViewModel::Homography),
        homography: Some(Matrix3::identity()),
        essential: Some(essential),
        inliers: Some(900),
        rms_px: Some(0.21),
    };
    let body = crate::geometry::Pose::new(UnitQuaternion::identity(), Vector3::z());
    let seen = ObjectSample { pose: Some(body), covariance: Some(Matrix6::identity()), ..ObjectSample::new("cart", State::Tracking) };
    let mut tracked = PoseSample::new(1, Timestamp::from_ns(40), State::Tracking);
    (tracked.pose, tracked.measurement) = (Some(golden_camera()), Some(whole));
    tracked.objects = vec![seen];
    let mut lost = PoseSample::new(2, Timestamp::from_ns(80), State::Lost);
    lost.objects = vec![ObjectSample::new("cart", State::Lost)];
    [tracked, lost]
}

fn setup() -> TrackerSetup {
    let folder = tempfile::tempdir().unwrap();
    let settings = supervised(folder.path()).settings().unwrap();
    let intrinsics =
        Intrinsics { width: 64, height: 48, fx: 60.0, fy: 60.0, cx: 31.5, cy: 23.5, skew: 0.0, distortion: [-0.1, 0.0, 0.0, 0.0, 0.0] };
    let mut stage = settings.stage.clone();
    stage.surfaces.push(SurfaceSpec { shape: folds(), ..stage.surfaces[0].clone() });
    let mut setup = TrackerSetup::new(CameraModel::new(intrinsics).unwrap(), stage.clone());
    setup.objects.push(stage);
    setup
}

/// Returns answers of a server with all routes of a daemon, by type name.
fn answers() -> BTreeMap<&'static str, Vec<Value>> {
    let folder = tempfile::tempdir().unwrap();
    let supervisor = supervised(folder.path());
    super::recordings::tests::recording(folder.path());
    let [tracked, lost] = samples();
    let clip = folder.path().join("recordings/clip-1");
    std::fs::write(clip.join("poses.jsonl"), format!("{}\n{}\n", tracked.to_json_line(), lost.to_json_line())).unwrap();
    std::fs::write(
        clip.join("events.jsonl"),
        "{\"timestamp_ns\":40,\"event\":\"marked\",\"text\":\"cue 1\"}\n{\"timestamp_ns\":50,\"event\":\"recording_started\"}\n",
    )
    .unwrap();
    std::fs::create_dir(clip.join("retracked")).unwrap();
    std::fs::copy(clip.join("poses.jsonl"), clip.join("retracked/poses.jsonl")).unwrap();
    let server = whole_server(&supervisor, None);
    let mut found: BTreeMap<&'static str, Vec<Value>> = BTreeMap::new();
    let mut ask = |name: &'static str, method: &str, path: &str, content: &[u8]| {
        let answer = exchange(server.address(), method, &format!("/api/v1/{path}"), "Host: localhost\r\nIf-Match: *\r\n", content);
        let said = serde_json::from_slice(&answer.content).unwrap_or_else(|e| panic!("{path}: {e}: {}", answer.text()));
        found.entry(name).or_default().push(said);
    };
    for compared in [
        json!({"rows": 2, "same_record": 1, "same_state": 2, "states": {"recorded": {"tracking": 1}, "retracked": {"lost": 2}},
            "rms_px": {"recorded": {"median": 0.1, "p95": 0.2, "max": 0.3}, "retracked": null}, "both_tracked": 1,
            "position_mm": {"median": 0.1, "p95": 0.2, "max": 0.3}, "angle_deg": {"median": 0.1, "p95": 0.2, "max": 0.3}}),
        json!({"rows": 2, "same_record": 1, "same_state": 2, "states": {"recorded": {"lost": 2}, "retracked": {"tracking": 2}},
            "rms_px": {"recorded": null, "retracked": {"median": 0.1, "p95": 0.2, "max": 0.3}}, "both_tracked": 0,
            "position_mm": null, "angle_deg": null}),
    ] {
        assert_eq!(keys(&compared), keys(&crate::daemon::nothing_compared()), "these samples are not of the comparison");
        std::fs::write(clip.join("retracked/compared.json"), compared.to_string()).unwrap();
        ask("Retracked", "GET", "recordings/clip-1/retracked", b"");
    }
    std::fs::write(clip.join("retracked/compared.json"), "damaged").unwrap();
    ask("Retracked", "GET", "recordings/clip-1/retracked", b"");
    std::fs::write(clip.join("retracked/poses.jsonl"), "").unwrap();
    ask("Retracked", "GET", "recordings/clip-1/retracked", b"");
    ask("Timeline", "GET", "recordings/clip-1/timeline", b"");
    std::fs::write(clip.join("poses.jsonl"), "").unwrap();
    ask("Timeline", "GET", "recordings/clip-1/timeline", b"");
    ask("RecordingList", "GET", "recordings", b"");
    supervisor.set_recording(Some(clip));
    ask("RecordingList", "GET", "recordings", b"");
    ask("Known", "GET", "state", b"");
    server
        .judge_ages(std::sync::Arc::new(crate::publish::FrameClock::new(crate::publish::Stamps::Live)), std::time::Duration::from_secs(1));
    server.publish(&tracked);
    ask("Known", "GET", "state", b"");
    server.show_scene(&setup());
    ask("Scene", "GET", "scene", b"");
    let mut pinhole = setup();
    pinhole.camera = CameraModel::pinhole(64, 48, 60.0, 61.0, 31.5, 23.5).unwrap();
    server.show_scene(&pinhole);
    ask("Scene", "GET", "scene", b"");
    ask("Session", "GET", "session", b"");
    ask("Health", "GET", "health", b"");
    let packet = |sent: u64, last_packet: &[u8]| OutputStatistics {
        name: "a".to_owned(),
        protocol: "json",
        sent,
        failed: 0,
        withheld: 0,
        dropped: 0,
        latency_us: 3,
        greatest_latency_us: 4,
        last_packet: last_packet.to_vec(),
    };
    let outputs = [packet(1, b"{}"), packet(0, b"")];
    supervisor.watch_outputs(Some(std::sync::Arc::new(move || outputs.to_vec())));
    ask("Outputs", "GET", "outputs", b"");
    std::thread::sleep(std::time::Duration::from_millis(600));
    ask("Outputs", "GET", "outputs", b"");
    let config = std::fs::read(supervisor.file()).unwrap();
    ask("Judged", "PUT", "config", b"[camera]\nfov_deg = 600\n");
    ask("Judged", "PUT", "config", b"nothing");
    ask("Kept", "PUT", "pictures/a.png", &std::fs::read(folder.path().join("backdrop.png")).unwrap());
    ask("Kept", "PUT", "calibrations/a.toml", include_bytes!("../../../fixtures/dolly/camera.toml"));
    ask("Judged", "PUT", "config", &config);
    // A config that yields a note.
    let wide = String::from_utf8(config).unwrap().replace("[4.0, 3.0]", "[6.0, 3.0]");
    ask("Judged", "PUT", "config", wide.as_bytes());
    supervisor.refuse("stage.toml: it is refused; mend it".to_owned());
    ask("Session", "GET", "session", b"");
    std::fs::write(supervisor.file(), "[camera]\nfov_deg = 600\n").unwrap();
    ask("Session", "GET", "session", b"");
    found.insert("PoseRecord", samples().iter().map(|sample| serde_json::from_str(&sample.to_json_line()).unwrap()).collect());
    found.insert("Head", heads());
    found.insert("Means", super::setup::tests::samples());
    found.insert("Happening", events());
    found
}

fn keys(value: &Value) -> Vec<&String> {
    value.as_object().map_or_else(Vec::new, |fields| fields.keys().collect())
}

/// Returns lines of /ws/events.
fn events() -> Vec<Value> {
    let log = EventLog::default();
    let listener = log.listen();
    let job = |state| Event::Job(Job { job: 1, kind: "retrack".to_owned(), done: 0.5, state, text: "clip-1".to_owned() });
    for event in [
        Event::Marked { text: "cue 1".to_owned() },
        Event::ConfigRefused { reason: "no".to_owned() },
        job(JobState::Running),
        job(JobState::Done),
        job(JobState::Failed),
    ] {
        log.publish(event);
    }
    listener.try_iter().map(|event| serde_json::from_str(&crate::web::events::line(&event).unwrap()).unwrap()).collect()
}

fn declared() -> String {
    let all = answers();
    let mut to = Declarations { words: Vec::new(), names: BTreeMap::new(), text: String::new() };
    to.text += "// What the program sends, as types. Made from its own answers, do not change it by hand:\n";
    to.text += "// `STAGEPOSE_REMAKE=1 cargo test --lib types_tests`.\n\n";
    to.add_words(
        "State",
        ["state", ""],
        State::ALL.map(State::word).to_vec(),
        "How a body stands; `stale` where the camera gives no pictures",
    );
    to.add_words("JobState", ["state", ""], vec!["running", "done", "failed"], "How a job stands");
    to.add_words(
        "Grade",
        ["level", "inding"],
        vec!["error", "warning", "note"],
        "How much a finding matters: with an error a config cannot be used",
    );
    to.add_words("Level", ["level", ""], vec!["error", "warn", "info"], "How much an event matters");
    to.add_words("PartLevel", ["level", ""], vec!["good", "warn", "bad", "off"], "How a part of the daemon stands");
    let (records, heads) = (&all["PoseRecord"], &all["Head"]);
    to.add("Pose", "Where a body is: metres, and a unit quaternion", picked(records, &["pose"]));
    to.add("PoseRecord", "A record, as docs/protocols.md has it", records);
    to.add("Motion", "How the camera moves in its own axes: m/s and rad/s", picked(heads, &["motion"]));
    to.add("Head", "What is said of a frame beside its picture, in /ws/view", heads);
    to.add("Known", "How things stand: /api/v1/state, and between frames in /ws/view", &all["Known"]);
    let scenes = &all["Scene"];
    to.add("Camera", "The lens, as a calibration file has it", picked(scenes, &["camera"]));
    let surfaces: Vec<&Value> =
        [picked(scenes, &["stage", "surfaces", "[]"]), picked(scenes, &["objects", "[]", "surfaces", "[]"])].concat();
    to.add("Surface", "A surface in its body, metres", surfaces);
    to.add("Scene", "Camera and bodies of a session: /api/v1/scene", scenes);
    to.add(
        "Finding",
        "What is to be said of a config",
        [picked(&all["Session"], &["findings", "[]"]), picked(&all["Judged"], &["findings", "[]"])].concat(),
    );
    to.add("Means", "What is there to set a stage up with: /api/v1/setup", &all["Means"]);
    to.add("Kept", "A file that the daemon keeps for the config, as the answer to its upload", &all["Kept"]);
    to.add("Session", "Who is here and may change something: /api/v1/session", &all["Session"]);
    to.add("Part", "A part of the daemon: /api/v1/health", picked(&all["Health"], &["parts", "[]"]));
    to.add("Output", "What an output has sent: /api/v1/outputs", picked(&all["Outputs"], &["outputs", "[]"]));
    to.add("Recording", "A recording in the list", picked(&all["RecordingList"], &["recordings", "[]"]));
    to.add("RecordingList", "What was recorded: /api/v1/recordings", &all["RecordingList"]);
    to.add("Column", "Some rows of a recording", picked(&all["Timeline"], &["columns", "[]"]));
    to.add("Timeline", "A recording over time: /api/v1/recordings/ID/timeline", &all["Timeline"]);
    to.add("Spread", "How far something goes", picked(&all["Retracked"], &["compared", "position_mm"]));
    to.add("Compared", "What was recorded, and what today's config makes of it", picked(&all["Retracked"], &["compared"]));
    to.add("Retracked", "The same recording by today's config: /api/v1/recordings/ID/retracked", &all["Retracked"]);
    let is_job = |event: &&Value| event["event"] == "job";
    to.add("Job", "How far a job is, in /ws/events", all["Happening"].iter().filter(is_job));
    to.add("Happening", "What has happened, in /ws/events", all["Happening"].iter().filter(|event| !is_job(event)));
    to.text.trim_end().to_owned() + "\n"
}

#[test]
fn page_types_match_what_the_program_sends() {
    let wanted = declared();
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/src/web/page/types.d.ts");
    if std::env::var_os("STAGEPOSE_REMAKE").is_some() {
        std::fs::write(path, &wanted).unwrap();
    }
    let found = std::fs::read_to_string(path).unwrap_or_default();
    assert_eq!(found, wanted, "run STAGEPOSE_REMAKE=1 cargo test --lib types_tests");
}
