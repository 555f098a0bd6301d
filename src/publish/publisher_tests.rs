use std::io::{BufRead, BufReader};
use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};

use nalgebra::{UnitQuaternion, Vector3};

use super::super::freed::{FreedPacket, FreedSettings, Spare};
use super::super::golden::golden_camera;
use super::super::json::JsonSettings;
use super::super::osc::{OscMessageKind, OscSettings};
use super::super::settings::{BlendRates, FixedRate, OnLoss, Rate, UdpSettings};
use super::super::stamps::ClipStart;
use super::super::{Placement, opentrackio::*};
use super::*;
use crate::geometry::Pose;
use crate::record::{ObjectSample, StageTimes, State};

const FRAME_NS: i64 = 33_333_333;

struct Ear(UdpSocket);

impl Ear {
    fn new() -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        socket.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        Self(socket)
    }

    fn address(&self) -> SocketAddr {
        self.0.local_addr().unwrap()
    }

    fn next(&self) -> Vec<u8> {
        let mut buffer = [0; 4096];
        let length = self.0.recv(&mut buffer).expect("a packet comes");
        buffer[..length].to_vec()
    }

    fn freed(&self) -> FreedPacket {
        FreedPacket::decode(&self.next()).unwrap()
    }

    fn json(&self) -> serde_json::Value {
        serde_json::from_slice(&self.next()).unwrap()
    }

    /// What is there already.
    fn rest(&self) -> usize {
        self.0.set_nonblocking(true).unwrap();
        let mut buffer = [0; 4096];
        std::iter::from_fn(|| self.0.recv(&mut buffer).ok()).count()
    }
}

fn freed(spare: Spare) -> Protocol {
    Protocol::Freed(FreedSettings { camera_id: 1, spare, zoom: None, sensor_width_mm: 4.8, focus: 0 })
}

fn json() -> Protocol {
    Protocol::Json(JsonSettings::default())
}

fn output(protocol: Protocol, ear: &Ear) -> OutputSettings {
    OutputSettings {
        name: "desk".to_owned(),
        enabled: true,
        protocol,
        udp: UdpSettings { to: vec![ear.address()], ..UdpSettings::default() },
        bodies: vec![BodyChoice::Camera],
        rate: Rate::Every(1),
        on_loss: OnLoss::Stop,
        placement: Placement::default(),
        is_guarded: true,
    }
}

/// Nothing becomes stale within a test that does not ask for it.
fn context(safety: SafetySettings) -> Context {
    let camera = CameraModel::pinhole(640, 480, 600.0, 600.0, 319.5, 239.5).unwrap();
    Context {
        camera,
        objects: vec!["cart".to_owned()],
        safety,
        stamps: Stamps::Recorded(ClipStart::default()),
        frame_rate: Some(30.0),
        is_test: false,
    }
}

fn patient() -> SafetySettings {
    SafetySettings { stale_after: Duration::from_secs(60), ..SafetySettings::default() }
}

fn start(outputs: &[OutputSettings]) -> Publisher {
    Publisher::start(outputs, &context(patient())).unwrap()
}

fn sample(k: u64, state: State, x: f64) -> PoseSample {
    let mut pose = golden_camera();
    pose.translation.x = x;
    let is_known = matches!(state, State::Tracking | State::Coasting);
    let cart = Pose::new(UnitQuaternion::identity(), Vector3::new(9.0, 0.0, 0.0));
    PoseSample {
        sequence: k,
        timestamp_ns: k as i64 * FRAME_NS,
        state,
        pose: is_known.then_some(pose),
        measurement: None,
        objects: vec![ObjectSample { name: "cart".to_owned(), state, pose: is_known.then_some(cart), covariance: None }],
        times: StageTimes::default(),
    }
}

/// Tracking, coasting, lost, lost, tracking, at x = 0, 1, 2, 3, 4.
fn story() -> Vec<PoseSample> {
    let states = [State::Tracking, State::Coasting, State::Lost, State::Lost, State::Tracking];
    (0..5).zip(states).map(|(k, state)| sample(k, state, k as f64)).collect()
}

/// (x in millimetres, spare) of every packet that the story makes.
fn told(spare: Spare, on_loss: OnLoss) -> Vec<(f64, u16)> {
    let ear = Ear::new();
    let publisher = start(&[OutputSettings { on_loss, ..output(freed(spare), &ear) }]);
    story().iter().for_each(|s| publisher.send(s));
    let sent = publisher.close()[0].sent;
    (0..sent).map(|_| ear.freed()).map(|p| (p.position_mm[0], p.spare)).collect()
}

#[test]
fn a_loss_is_stopped_held_or_flagged() {
    assert_eq!(told(Spare::Quality, OnLoss::Stop), [(0.0, 1), (1000.0, 2), (4000.0, 1)]);
    assert_eq!(told(Spare::Quality, OnLoss::Hold), [(0.0, 1), (1000.0, 2), (1000.0, 3), (1000.0, 3), (4000.0, 1)]);
    assert_eq!(told(Spare::Quality, OnLoss::Flag), [(0.0, 1), (1000.0, 2), (1000.0, 3), (1000.0, 3), (4000.0, 1)]);
    // A prediction that cannot be marked is not sent.
    assert_eq!(told(Spare::Frame, OnLoss::Stop), [(0.0, 0), (4000.0, 4)]);
    assert_eq!(told(Spare::Frame, OnLoss::Hold), [(0.0, 0), (0.0, 1), (0.0, 2), (0.0, 3), (4000.0, 4)]);
}

#[test]
fn formats_with_a_marker_say_a_loss_once_and_then_are_silent() {
    let (ear, flagged) = (Ear::new(), Ear::new());
    let publisher =
        start(&[output(json(), &ear), OutputSettings { name: "f".to_owned(), on_loss: OnLoss::Flag, ..output(json(), &flagged) }]);
    story().iter().for_each(|s| publisher.send(s));
    let statistics = publisher.close();
    assert_eq!((statistics[0].sent, statistics[1].sent), (4, 5));
    let lines: Vec<_> = (0..4).map(|_| ear.json()).collect();
    let states: Vec<_> =
        lines.iter().map(|l| (l["sequence"].as_u64().unwrap(), l["state"].as_str().unwrap(), l["pose"].is_null())).collect();
    assert_eq!(states, [(0, "tracking", false), (1, "coasting", false), (2, "lost", true), (4, "tracking", false)]);
}

#[test]
fn a_pose_that_is_held_says_so() {
    let ear = Ear::new();
    let publisher = start(&[OutputSettings { on_loss: OnLoss::Hold, ..output(json(), &ear) }]);
    story().iter().for_each(|s| publisher.send(s));
    publisher.close();
    let line = (0..5).map(|_| ear.json()).nth(3).unwrap();
    assert_eq!((&line["state"], &line["held"], &line["pose"]["position_m"][0]), (&"lost".into(), &true.into(), &1.0.into()));
}

#[test]
fn one_frame_in_n_and_the_chosen_body_are_sent() {
    let ear = Ear::new();
    let thinned = OutputSettings { rate: Rate::Every(2), bodies: vec![BodyChoice::Object(0)], ..output(freed(Spare::Frame), &ear) };
    let publisher = start(&[thinned]);
    (0..6).for_each(|k| publisher.send(&sample(k, State::Tracking, 0.0)));
    assert_eq!(publisher.close()[0].sent, 3);
    let told: Vec<_> = (0..3).map(|_| ear.freed()).map(|p| (p.position_mm[0], p.spare)).collect();
    assert_eq!(told, [(9000.0, 0), (9000.0, 2), (9000.0, 4)]);
}

#[test]
fn a_loss_does_not_wait_for_its_turn() {
    let ear = Ear::new();
    let publisher = start(&[OutputSettings { rate: Rate::Every(10), ..output(json(), &ear) }]);
    (0..3).for_each(|k| publisher.send(&sample(k, State::Tracking, 0.0)));
    (3..9).for_each(|k| publisher.send(&sample(k, State::Lost, 0.0)));
    assert_eq!(publisher.close()[0].sent, 2);
    let lines = [ear.json(), ear.json()];
    assert_eq!(lines.each_ref().map(|l| (l["sequence"].clone(), l["pose"].is_null())), [(0.into(), false), (3.into(), true)]);
}

#[test]
fn no_frame_for_too_long_is_told() {
    let (line, status, held) = (Ear::new(), Ear::new(), Ear::new());
    let osc = Protocol::Osc(OscSettings { prefix: "/s".to_owned(), messages: vec![OscMessageKind::Status], values: Vec::new() });
    let outputs = [
        output(json(), &line),
        OutputSettings { name: "osc".to_owned(), ..output(osc, &status) },
        OutputSettings { name: "freed".to_owned(), on_loss: OnLoss::Flag, ..output(freed(Spare::Quality), &held) },
    ];
    let safety = SafetySettings { stale_after: Duration::from_millis(100), ..SafetySettings::default() };
    let publisher = Publisher::start(&outputs, &context(safety)).unwrap();
    publisher.send(&sample(0, State::Tracking, 0.5));
    let until = |say: &dyn Fn() -> bool| (0..100).any(|_| say());
    assert!(until(&|| line.json()["event"] == "stale"));
    assert!(until(&|| status.next().windows(5).any(|w| w == b"stale")));
    assert!(until(&|| held.freed().spare == 3));
    // It comes back when frames do.
    publisher.send(&sample(1, State::Tracking, 0.5));
    assert!(until(&|| line.json()["state"] == "tracking"));
    assert!(until(&|| held.freed().spare == 1));
    publisher.close();
}

#[test]
fn a_fixed_rate_has_its_own_numbers_and_interpolates() {
    let ear = Ear::new();
    let rate = Rate::Fixed { rate: FixedRate { ticks: 50, per_s: 1 }, delay: Duration::from_millis(80) };
    let publisher = start(&[OutputSettings { rate, ..output(json(), &ear) }]);
    let begun = Instant::now();
    for k in 0..30_u64 {
        std::thread::sleep(Duration::from_nanos(k * FRAME_NS as u64).saturating_sub(begun.elapsed()));
        publisher.send(&sample(k, State::Tracking, k as f64 / 30.0));
    }
    publisher.close();
    let lines: Vec<_> =
        std::iter::from_fn(|| (ear.0.set_nonblocking(true).is_ok() && ear.0.peek(&mut [0; 1]).is_ok()).then(|| ear.json())).collect();
    let poses: Vec<_> = lines.iter().filter(|l| l["state"] == "tracking").collect();
    assert!(poses.len() > 20, "{} of {} lines have a pose", poses.len(), lines.len());
    for line in &poses {
        // The stamp is the tick's on the clip's clock, where x is the time in seconds.
        let at_s = line["timestamp_ns"].as_f64().unwrap() * 1e-9;
        assert!((line["pose"]["position_m"][0].as_f64().unwrap() - at_s).abs() < 1e-6, "{line}");
    }
    for pair in poses.windows(2) {
        let number = |l: &serde_json::Value| l["sequence"].as_f64().unwrap();
        let x = |l: &serde_json::Value| l["pose"]["position_m"][0].as_f64().unwrap();
        // 1 m/s: 20 mm a tick, whenever the samples came.
        let per_tick = (x(pair[1]) - x(pair[0])) / (number(pair[1]) - number(pair[0]));
        assert!((per_tick - 0.02).abs() < 1e-6, "{per_tick}");
    }
}

#[test]
fn limits_hold_for_guarded_outputs_only() {
    let (guarded, free) = (Ear::new(), Ear::new());
    let outputs = [output(json(), &guarded), OutputSettings { name: "log".to_owned(), is_guarded: false, ..output(json(), &free) }];
    let safety = SafetySettings { permitted_box_m: Some([[-1.0, -9.0, -1.0], [1.0, 9.0, 3.0]]), ..patient() };
    let publisher = Publisher::start(&outputs, &context(safety)).unwrap();
    publisher.send(&sample(0, State::Tracking, 0.5));
    publisher.send(&sample(1, State::Tracking, 1.5));
    publisher.send(&sample(2, State::Tracking, 1.6));
    let events = publisher.events().clone();
    let statistics = publisher.close();
    assert_eq!((statistics[0].withheld, statistics[1].withheld), (2, 0));
    // Raised once, when it begins.
    let told: Vec<_> = events.try_iter().map(|e| (e.output, e.body, e.reason.words())).collect();
    assert_eq!(told, [(outputs[0].name.clone(), "camera".to_owned(), "outside the permitted box")]);
    assert_eq!(guarded.json()["pose"]["position_m"][0], 0.5);
    let withheld = guarded.json();
    assert_eq!((&withheld["pose"], &withheld["withheld"]), (&serde_json::Value::Null, &"outside the permitted box".into()));
    free.next();
    assert_eq!(free.json()["pose"]["position_m"][0], 1.5);
}

#[test]
fn after_a_loss_a_blended_output_starts_where_it_stood() {
    let ear = Ear::new();
    let safety = SafetySettings { blend: Some(BlendRates { speed_m_s: 3.0, turn_rad_s: 1.0 }), ..patient() };
    let publisher = Publisher::start(&[output(freed(Spare::Quality), &ear)], &context(safety)).unwrap();
    let states = [State::Tracking, State::Lost, State::Tracking, State::Tracking, State::Tracking];
    (0..5).zip(states).for_each(|(k, state)| publisher.send(&sample(k, state, if k < 2 { 0.0 } else { 0.15 })));
    publisher.close();
    let told: Vec<_> = (0..4).map(|_| ear.freed()).map(|p| (p.position_mm[0].round(), p.spare)).collect();
    assert_eq!(told, [(0.0, 1), (0.0, 2), (100.0, 2), (150.0, 1)]);
}

#[test]
fn a_disabled_output_sends_nothing() {
    let ear = Ear::new();
    let publisher = start(&[OutputSettings { enabled: false, ..output(json(), &ear) }]);
    publisher.send(&sample(0, State::Tracking, 0.0));
    assert!(publisher.close().is_empty());
    assert_eq!(ear.rest(), 0);
}

#[test]
fn an_output_that_stands_still_loses_the_oldest_and_the_others_nothing() {
    let (listener, ear) = (TcpListener::bind("127.0.0.1:0").unwrap(), Ear::new());
    let at = listener.local_addr().unwrap();
    drop(listener);
    let stream = StreamSettings { tcp_listen: Some(at), file: None };
    let tcp =
        OutputSettings { name: "tcp".to_owned(), udp: UdpSettings::default(), ..output(Protocol::Json(JsonSettings { stream }), &ear) };
    let publisher = start(&[tcp, output(freed(Spare::Frame), &ear)]);
    let sleeper = TcpStream::connect(at).unwrap();
    let mut reader = BufReader::new(TcpStream::connect(at).unwrap());
    for k in 0..500 {
        publisher.send(&sample(k, State::Tracking, 0.0));
        assert_eq!(ear.freed().spare, k as u16);
    }
    let statistics = publisher.close();
    assert_eq!((statistics[1].sent, statistics[1].dropped, statistics[1].failed), (500, 0, 0));
    let mut line = String::new();
    reader.read_line(&mut line).unwrap();
    assert!(line.contains(r#""state":"tracking""#), "{line}");
    drop(sleeper);
}

#[test]
fn a_test_says_that_it_is_one() {
    let ear = Ear::new();
    let otrk = OpenTrackIoSettings {
        encoding: Encoding::Json,
        source_number: 1,
        sensor_width_mm: 4.8,
        principal_point: super::super::PrincipalPoint::Projection,
    };
    let test = Context { is_test: true, ..context(patient()) };
    let publisher = Publisher::start(&[output(Protocol::OpenTrackIo(otrk), &ear)], &test).unwrap();
    publisher.send(&sample(0, State::Tracking, 0.0));
    publisher.close();
    assert_eq!(decode(&ear.next()).unwrap().1["tracker"]["status"], "Test Signal");
}

#[test]
fn an_output_that_cannot_be_opened_is_named() {
    let (taken, ear) = (TcpListener::bind("127.0.0.1:0").unwrap(), Ear::new());
    let stream = StreamSettings { tcp_listen: taken.local_addr().ok(), file: None };
    let outputs =
        [output(json(), &ear), OutputSettings { name: "second".to_owned(), ..output(Protocol::Json(JsonSettings { stream }), &ear) }];
    let refusal = Publisher::start(&outputs, &context(patient())).err().unwrap().to_string();
    assert!(refusal.starts_with("output second: cannot wait for clients on 127.0.0.1:"), "{refusal}");
    assert_eq!(Publisher::rehearse(&outputs).err().unwrap().0, 1);
}
