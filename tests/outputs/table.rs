//! The table of docs/protocols.md: what each protocol sends in each state.
//!
//! Every row is played to all columns at once, for the camera and for an object, with clocks that
//! the test advances. What arrives must match the table word for word.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use stagepose::diagnostics::publish::{BlendRates, Clocks, Context, FixedRate, OnLoss, Publisher, Rate, SafetySettings, Stamps, TickPhase};
use stagepose::{CameraModel, ObjectSample, Pose, PoseSample, State, Timestamp};

use super::clocks::SteppedClocks;
use super::decoders::Said;
use super::places::{Place, WAYS};

const DOCUMENT: &str = include_str!("../../docs/protocols.md");
const FRAME_MS: i64 = 33;
/// The body's position before a state, and in it.
const BEFORE_M: f64 = 1.0;
const THEN_M: f64 = 1.5;
/// Outside the permitted box.
const OUTSIDE_M: f64 = 30.0;

/// Parses the document into (row, column) -> cell.
fn table() -> BTreeMap<(String, String), String> {
    let mut cells = BTreeMap::new();
    let mut columns: Option<Vec<String>> = None;
    for line in DOCUMENT.lines() {
        let Some(row) = line.strip_prefix("| ").and_then(|l| l.strip_suffix(" |")) else {
            columns = columns.filter(|_| line.starts_with('|'));
            continue;
        };
        let fields: Vec<String> = row.split(" | ").map(str::to_owned).collect();
        match &columns {
            _ if fields[0] == "state" => columns = Some(fields[1..].to_vec()),
            Some(columns) => {
                assert_eq!(fields.len(), columns.len() + 1, "{line}");
                cells.extend(columns.iter().zip(&fields[1..]).map(|(c, cell)| ((fields[0].clone(), c.clone()), cell.clone())));
            }
            None => {}
        }
    }
    cells
}

/// What is played for a row.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Story {
    Tracking,
    Predicted,
    Coasting,
    Blended,
    Lost(OnLoss),
    Withheld(OnLoss),
    Stale(OnLoss),
    Dead,
}

/// Returns the rows of the table, by their titles.
fn stories() -> Vec<(String, Story)> {
    let before = [Story::Tracking, Story::Predicted, Story::Coasting, Story::Blended];
    let mut stories: Vec<_> = before.map(|story| (format!("{story:?}").to_lowercase(), story)).into();
    for on_loss in [OnLoss::Stop, OnLoss::Hold, OnLoss::Flag] {
        let row = |state: &str| format!("{state}, `{}`", format!("{on_loss:?}").to_lowercase());
        stories.extend([("lost", Story::Lost(on_loss)), ("withheld", Story::Withheld(on_loss))].map(|(state, story)| (row(state), story)));
        stories.push((row("stale"), Story::Stale(on_loss)));
    }
    stories.push(("dead".to_owned(), Story::Dead));
    stories
}

impl Story {
    fn on_loss(self) -> OnLoss {
        match self {
            Self::Lost(on_loss) | Self::Withheld(on_loss) | Self::Stale(on_loss) => on_loss,
            _ => OnLoss::Stop,
        }
    }
}

fn safety() -> SafetySettings {
    SafetySettings {
        permitted_box_m: Some([[-10.0; 3], [10.0; 3]]),
        blend: Some(BlendRates { speed_m_s: 3.0, angular_speed_rad_s: 3.0 }),
        stale_after: Duration::from_millis(500),
        ..SafetySettings::default()
    }
}

/// Returns a current frame with camera and object `x` to the right.
fn sample(sequence: u64, timestamp: Timestamp, state: State, x: f64) -> PoseSample {
    let is_known = matches!(state, State::Tracking | State::Coasting);
    let s = std::f64::consts::FRAC_1_SQRT_2;
    let camera = Pose::new(UnitQuaternion::from_quaternion(Quaternion::new(s, -s, 0.0, 0.0)), Vector3::new(x, -4.0, 0.0));
    let cart = Pose::new(UnitQuaternion::identity(), Vector3::new(x, 0.0, 0.0));
    let mut object = ObjectSample::new("cart", state);
    object.pose = is_known.then_some(cart);
    let mut sample = PoseSample::new(sequence, timestamp, state);
    (sample.pose, sample.objects) = (is_known.then_some(camera), vec![object]);
    sample
}

/// All columns with one story.
struct Show {
    clocks: SteppedClocks,
    publisher: Publisher,
    places: Vec<Place>,
    sequence: u64,
}

impl Show {
    fn new(story: Story, of_object: bool, folder: &std::path::Path) -> Self {
        let clocks = SteppedClocks::new();
        let ways = WAYS.into_iter().filter(|(_, way)| story.on_loss() != OnLoss::Flag || way.can_flag());
        let mut places: Vec<Place> = ways.map(|way| Place::new(way, of_object, folder)).collect();
        let is_fixed = story == Story::Predicted;
        let rate = if is_fixed {
            Rate::Fixed { rate: FixedRate { ticks: 50, per_s: 1 }, delay: Duration::ZERO, phase: TickPhase::FreeRunning }
        } else {
            Rate::Every(1)
        };
        let context = Context {
            camera: CameraModel::pinhole(640, 480, 600.0, 600.0, 319.5, 239.5).unwrap(),
            objects: vec!["cart".to_owned()],
            mount: None,
            // In the predicted row, one frame interval has room for many ticks.
            safety: if is_fixed { SafetySettings { stale_after: Duration::from_secs(60), ..safety() } } else { safety() },
            stamps: Stamps::Live,
            timecode: None,
            frame_rate: Some(if is_fixed { 0.1 } else { 30.0 }),
            rings: None,
            is_test: false,
        };
        let outputs: Vec<_> = places.iter().map(|place| place.output(story.on_loss(), rate)).collect();
        let publisher = Publisher::start_with_clocks(&outputs, &context, Arc::new(clocks.clone())).unwrap();
        places.iter_mut().for_each(Place::connect);
        let mut show = Self { clocks, publisher, places, sequence: 0 };
        show.ask();
        show
    }

    /// Asks the outputs that send nothing unasked, and lets the time pass in which they wait.
    fn ask(&mut self) {
        self.places.iter().for_each(Place::ask);
        self.wait(&|clocks| clocks.advance_ms(100), &Place::is_heard);
        self.clocks.advance_ms(12_000);
        // What was sent meanwhile (that there is no frame) belongs to no state.
        std::thread::sleep(Duration::from_millis(300));
        self.hear();
        self.forget();
    }

    fn frame(&mut self, state: State, x: f64) {
        self.clocks.advance_ms(FRAME_MS);
        self.publisher.send(&sample(self.sequence, self.clocks.read().monotonic, state, x));
        self.sequence += 1;
    }

    fn hear(&mut self) {
        self.places.iter_mut().for_each(Place::hear);
    }

    /// Waits until every place has what it waits for, and calls `step` between checks.
    fn wait(&mut self, step: &dyn Fn(&SteppedClocks), has: &dyn Fn(&Place) -> bool) {
        let begun = Instant::now();
        loop {
            self.hear();
            let missing: Vec<_> = self.places.iter().filter(|place| !has(place)).map(|place| place.title).collect();
            if missing.is_empty() {
                return;
            }
            assert!(begun.elapsed() < Duration::from_secs(30), "nothing comes from {missing:?}");
            step(&self.clocks);
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    fn forget(&mut self) {
        self.places.iter_mut().for_each(|place| place.said.clear());
    }

    /// Sends a tracked frame and waits until every place has received it.
    fn lead_in(&mut self) {
        self.frame(State::Tracking, BEFORE_M);
        self.wait(&|_| {}, &|place| !place.said.is_empty());
        self.forget();
    }

    /// Closes the outputs and returns what every column received: (title, packets).
    fn end(mut self) -> Vec<(&'static str, Vec<Said>)> {
        drop(self.publisher.close());
        self.places.iter_mut().for_each(Place::hear);
        self.places.into_iter().map(|place| (place.title, place.said)).collect()
    }
}

/// Plays a story and returns what the columns received in its state.
fn played(story: Story, of_object: bool, expects: &dyn Fn(&str) -> bool) -> Vec<(&'static str, Vec<Said>)> {
    let folder = tempfile::tempdir().unwrap();
    let mut show = Show::new(story, of_object, folder.path());
    match story {
        Story::Tracking => {
            show.lead_in();
            show.frame(State::Tracking, THEN_M);
        }
        Story::Predicted => {
            show.frame(State::Tracking, THEN_M);
            show.wait(&|clocks| clocks.advance_ms(5), &|place| place.said.iter().any(|said| said.x.is_some()));
            // What arrived before the frame belongs to another state.
            show.places.iter_mut().for_each(|place| place.said.retain(|said| said.x.is_some()));
        }
        Story::Coasting => {
            show.lead_in();
            show.frame(State::Coasting, THEN_M);
        }
        Story::Blended => {
            show.lead_in();
            show.frame(State::Lost, 0.0);
            show.frame(State::Tracking, THEN_M);
            show.wait(&|_| {}, &|place| place.said.last().is_some_and(|said| said.x.is_some()));
            show.forget();
            show.frame(State::Tracking, THEN_M);
            show.frame(State::Tracking, THEN_M);
        }
        Story::Lost(_) => {
            show.lead_in();
            show.frame(State::Lost, 0.0);
            show.frame(State::Lost, 0.0);
        }
        Story::Withheld(_) => {
            show.lead_in();
            show.frame(State::Tracking, OUTSIDE_M);
            show.frame(State::Tracking, OUTSIDE_M);
        }
        Story::Stale(_) => {
            show.lead_in();
            show.clocks.advance_ms(2500);
            show.wait(&|_| {}, &|place| !expects(place.title) || !place.said.is_empty());
            // A frame from before the silence must change nothing.
            let old = show.clocks.read().monotonic.after_s(-2.0);
            show.publisher.send(&sample(9, old, State::Tracking, THEN_M));
            std::thread::sleep(Duration::from_millis(200));
        }
        Story::Dead => {
            show.lead_in();
            drop(show.publisher.close());
            std::thread::sleep(Duration::from_millis(200));
            show.places.iter_mut().for_each(Place::hear);
            assert!(show.places.iter_mut().all(Place::is_closed));
            return show.places.into_iter().map(|place| (place.title, place.said)).collect();
        }
    }
    show.end()
}

/// Returns a packet in the table's words.
fn cell(said: &Said) -> String {
    let pose = match said.x {
        None => "no pose",
        Some(x) if (x - THEN_M).abs() < 1e-3 => "pose",
        Some(x) if (x - BEFORE_M).abs() < 1e-3 => "last pose",
        Some(x) if x > BEFORE_M && x < THEN_M => "pose on its way",
        Some(x) => panic!("nobody was at {x}"),
    };
    [pose, &said.mark].into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(", ")
}

#[test]
fn every_documented_cell_matches_what_is_sent() {
    let table = table();
    for (row, story) in stories() {
        let wanted = |title: &str| {
            let cell = table.get(&(row.clone(), title.to_owned()));
            cell.unwrap_or_else(|| panic!("docs/protocols.md has no cell {row} / {title}")).as_str()
        };
        for of_object in [false, true] {
            for (title, said) in played(story, of_object, &|title| wanted(title) != "nothing") {
                let mut cells: Vec<String> = said.iter().map(cell).collect();
                cells.dedup();
                let found = if cells.is_empty() { "nothing".to_owned() } else { cells.join(" then ") };
                assert_eq!(found, wanted(title), "{row} / {title}, {}", if of_object { "object" } else { "camera" });
            }
        }
        if story.on_loss() == OnLoss::Flag {
            for (title, _) in WAYS.into_iter().filter(|(_, way)| !way.can_flag()) {
                assert_eq!(wanted(title), "refused", "{row} / {title}");
            }
        }
    }
}

#[test]
fn on_loss_flag_is_refused_without_a_field_to_flag() {
    let scene = crate::cli::scene::Scene::new();
    for kind in [
        "\"freed\"\nspare = \"frame\"",
        "\"freed\"\nspare = \"sony\"",
        "\"freed\"\nspare = \"zero\"",
        "\"osc\"\nmessages = [\"pose\"]",
        "\"otp\"\nlisten = \"127.0.0.1:9\"",
    ] {
        scene.write("outputs.toml", &format!("[[output]]\nkind = {kind}\nto = [\"127.0.0.1:9\"]\non_loss = \"flag\"\n"));
        let run = scene.run(&["send-test", "--config", "outputs.toml", "--seconds", "0.1"]);
        run.assert_refused(2, &["`on_loss` in [[output]], line 5: ", "there is nothing to flag a loss with"]);
    }
}

#[test]
fn opentrackio_never_begins_with_0_which_receivers_drop() {
    let folder = tempfile::tempdir().unwrap();
    let mut show = Show::new(Story::Tracking, false, folder.path());
    show.lead_in();
    let firsts: Vec<u16> = show.places.iter().filter_map(|place| place.sequences.first().copied()).collect();
    assert_eq!(firsts, [1, 1]);
    show.end();
}

#[cfg(feature = "http")]
mod web {
    use std::io::{Read, Write};
    use std::net::{Ipv4Addr, TcpStream};

    use stagepose::diagnostics::publish::FrameClock;
    use stagepose::diagnostics::web::{HttpSettings, Server};

    use super::super::decoders::{json, web_socket_message};
    use super::*;

    fn connect(server: &Server) -> TcpStream {
        let stream = TcpStream::connect(server.address()).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
        stream
    }

    /// Returns the body of the answer to a GET.
    fn get(server: &Server, path: &str) -> String {
        let mut stream = connect(server);
        write!(stream, "GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n").unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
        answer.split_once("\r\n\r\n").unwrap().1.to_owned()
    }

    fn web_socket(server: &Server) -> TcpStream {
        let mut stream = connect(server);
        let request = "GET /ws HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\
            Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n";
        stream.write_all(request.as_bytes()).unwrap();
        let (mut head, mut byte) = (Vec::new(), [0]);
        while !head.ends_with(b"\r\n\r\n") {
            stream.read_exact(&mut byte).unwrap();
            head.push(byte[0]);
        }
        assert!(head.starts_with(b"HTTP/1.1 101"), "{}", String::from_utf8_lossy(&head));
        stream
    }

    /// Returns the frame of a story. Records know neither limits nor `on_loss`.
    fn frame(story: Story) -> (State, f64) {
        match story {
            Story::Coasting => (State::Coasting, THEN_M),
            Story::Lost(_) => (State::Lost, 0.0),
            _ => (State::Tracking, THEN_M),
        }
    }

    #[test]
    fn every_documented_cell_matches_what_is_served() {
        let table = table();
        for (row, story) in stories() {
            let clocks = SteppedClocks::new();
            let server =
                Server::start(&HttpSettings { listen: (Ipv4Addr::LOCALHOST, 0).into(), ..HttpSettings::default() }, Vec::new()).unwrap();
            server.judge_ages(Arc::new(FrameClock::with(Arc::new(clocks.clone()), Stamps::Live)), safety().stale_after);
            let mut stream = web_socket(&server);
            let now = || clocks.read().monotonic;
            // The client may not be subscribed yet, so the lead-in is repeated until it receives
            // something.
            let mut sequence = 0;
            loop {
                clocks.advance_ms(FRAME_MS);
                server.publish(&sample(sequence, now(), State::Tracking, BEFORE_M));
                sequence += 1;
                stream.set_nonblocking(true).unwrap();
                let has_come = stream.peek(&mut [0; 1]).is_ok();
                stream.set_nonblocking(false).unwrap();
                if has_come {
                    break;
                }
                std::thread::sleep(Duration::from_millis(5));
            }
            let (state, x) = frame(story);
            clocks.advance_ms(if matches!(story, Story::Stale(_)) { 2500 } else { FRAME_MS });
            if matches!(story, Story::Stale(_)) {
                // A frame from before the silence must change nothing.
                server.publish(&sample(sequence, now().after_s(-2.0), State::Tracking, THEN_M));
            } else if story != Story::Dead {
                server.publish(&sample(sequence, now(), state, x));
            }
            let found = if story == Story::Dead {
                let address = server.address();
                server.close();
                let is_over = std::iter::from_fn(|| web_socket_message(&mut stream)).count() < 1_000_000;
                assert!(is_over && TcpStream::connect(address).is_err());
                ["closed"; 3].map(str::to_owned)
            } else {
                let pose = cell(&json(&get(&server, "/api/v1/pose"), false));
                let state: serde_json::Value = serde_json::from_str(&get(&server, "/api/v1/state")).unwrap();
                let age_s = state["age_s"].as_f64().unwrap();
                assert_eq!(age_s, if matches!(story, Story::Stale(_)) { 2.0 } else { 0.0 }, "{row}");
                let lead_in = |line: &String| line.contains(r#""position_m":[1.0,"#);
                let line = std::iter::from_fn(|| web_socket_message(&mut stream)).find(|line| !lead_in(line)).unwrap();
                [cell(&json(&line, false)), pose, state["state"].as_str().unwrap().to_owned()]
            };
            for (title, found) in ["`/ws`", "`/api/v1/pose`", "`/api/v1/state`"].into_iter().zip(found) {
                let wanted = table.get(&(row.clone(), title.to_owned()));
                assert_eq!(Some(&found), wanted, "{row} / {title}");
            }
        }
    }
}
