use std::io::{BufRead, BufReader};
use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};

use nalgebra::{UnitQuaternion, Vector3};

use super::super::ClipStart;
use super::super::clocks::stepped::SteppedClocks;
use super::super::freed::{FreedSettings, Spare};
use super::super::json::JsonSettings;
use super::super::osc::{OscMessageKind, OscSettings};
use super::super::settings::{BlendRates, FixedRate, OnLoss, Rate, TickPhase};
use super::super::transport::UdpSettings;
use super::super::{Placement, opentrackio::*};
use super::*;
use crate::geometry::Pose;
use crate::protocols::freed::FreedPacket;
use crate::protocols::golden::golden_camera;
use crate::protocols::opentrackio::{Encoding, decode};
use crate::publish::transport::StreamSettings;
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

    /// Receives what has already arrived.
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
        delay: Duration::ZERO,
        on_loss: OnLoss::Stop,
        placement: Placement::default(),
        is_guarded: true,
        passes_rings: false,
    }
}

/// Nothing becomes stale within a test that does not ask for it.
fn context(safety: SafetySettings) -> Context {
    let camera = CameraModel::pinhole(640, 480, 600.0, 600.0, 319.5, 239.5).unwrap();
    Context {
        camera,
        objects: vec!["cart".to_owned()],
        mount: None,
        safety,
        stamps: Stamps::Recorded(ClipStart::default()),
        timecode: None,
        frame_rate: Some(30.0),
        rings: None,
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
        timestamp: Timestamp::from_ns(k as i64 * FRAME_NS),
        state,
        pose: is_known.then_some(pose),
        measurement: None,
        objects: vec![ObjectSample { name: "cart".to_owned(), state, pose: is_known.then_some(cart), covariance: None, common: None }],
        reason: None,
        learnt: Default::default(),
        times: StageTimes::default(),
    }
}

/// Tracking, coasting, lost, lost, tracking, at x = 0, 1, 2, 3, 4.
fn story() -> Vec<PoseSample> {
    let states = [State::Tracking, State::Coasting, State::Lost, State::Lost, State::Tracking];
    (0..5).zip(states).map(|(k, state)| sample(k, state, k as f64)).collect()
}

/// Returns (x in millimetres, spare) of every packet that the story produces.
fn received(spare: Spare, on_loss: OnLoss) -> Vec<(f64, u16)> {
    let ear = Ear::new();
    let publisher = start(&[OutputSettings { on_loss, ..output(freed(spare), &ear) }]);
    story().iter().for_each(|s| publisher.send(s));
    let sent = publisher.close()[0].sent;
    (0..sent).map(|_| ear.freed()).map(|p| (p.position_mm[0], p.spare)).collect()
}

#[test]
fn a_loss_is_stopped_held_or_flagged() {
    assert_eq!(received(Spare::Quality, OnLoss::Stop), [(0.0, 1), (1000.0, 2), (4000.0, 1)]);
    assert_eq!(received(Spare::Quality, OnLoss::Hold), [(0.0, 1), (1000.0, 2), (1000.0, 3), (1000.0, 3), (4000.0, 1)]);
    assert_eq!(received(Spare::Quality, OnLoss::Flag), [(0.0, 1), (1000.0, 2), (1000.0, 3), (1000.0, 3), (4000.0, 1)]);
    // A prediction that cannot be marked is not sent.
    assert_eq!(received(Spare::Frame, OnLoss::Stop), [(0.0, 0), (4000.0, 4)]);
    assert_eq!(received(Spare::Frame, OnLoss::Hold), [(0.0, 0), (0.0, 1), (0.0, 2), (0.0, 3), (4000.0, 4)]);
}

#[test]
fn formats_with_a_marker_report_a_loss_once() {
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
fn a_held_pose_is_marked_as_held() {
    let ear = Ear::new();
    let publisher = start(&[OutputSettings { on_loss: OnLoss::Hold, ..output(json(), &ear) }]);
    story().iter().for_each(|s| publisher.send(s));
    publisher.close();
    let line = (0..5).map(|_| ear.json()).nth(3).unwrap();
    assert_eq!((&line["state"], &line["held"], &line["pose"]["position_m"][0]), (&"lost".into(), &true.into(), &1.0.into()));
}

#[test]
fn every_nth_frame_of_the_chosen_body_is_sent() {
    let ear = Ear::new();
    let thinned = OutputSettings { rate: Rate::Every(2), bodies: vec![BodyChoice::Object(0)], ..output(freed(Spare::Frame), &ear) };
    let publisher = start(&[thinned]);
    (0..6).for_each(|k| publisher.send(&sample(k, State::Tracking, 0.0)));
    assert_eq!(publisher.close()[0].sent, 3);
    let received: Vec<_> = (0..3).map(|_| ear.freed()).map(|p| (p.position_mm[0], p.spare)).collect();
    assert_eq!(received, [(9000.0, 0), (9000.0, 2), (9000.0, 4)]);
}

#[test]
fn a_loss_is_sent_without_waiting_for_the_nth_frame() {
    let ear = Ear::new();
    let publisher = start(&[OutputSettings { rate: Rate::Every(10), ..output(json(), &ear) }]);
    (0..3).for_each(|k| publisher.send(&sample(k, State::Tracking, 0.0)));
    (3..9).for_each(|k| publisher.send(&sample(k, State::Lost, 0.0)));
    assert_eq!(publisher.close()[0].sent, 2);
    let lines = [ear.json(), ear.json()];
    assert_eq!(lines.each_ref().map(|l| (l["sequence"].clone(), l["pose"].is_null())), [(0.into(), false), (3.into(), true)]);
}

/// A live camera on clocks that a test steps, with its outputs.
struct Stepped {
    clocks: SteppedClocks,
    publisher: Publisher,
    sequence: u64,
}

impl Stepped {
    fn start(outputs: &[OutputSettings], safety: SafetySettings) -> Self {
        let clocks = SteppedClocks::new();
        let context = Context { stamps: Stamps::Live, ..context(safety) };
        let publisher = Publisher::start_with_clocks(outputs, &context, Arc::new(clocks.clone())).unwrap();
        Self { clocks, publisher, sequence: 0 }
    }

    /// Delivers a frame taken this many milliseconds ago.
    fn frame(&mut self, age_ms: i64, state: State, x: f64) {
        let timestamp = self.clocks.read().monotonic.after_ns(-age_ms * 1_000_000);
        self.publisher.send(&PoseSample { timestamp, ..sample(self.sequence, state, x) });
        self.sequence += 1;
    }
}

fn stale_after(ms: u64) -> SafetySettings {
    SafetySettings { stale_after: Duration::from_millis(ms), ..SafetySettings::default() }
}

fn status() -> Protocol {
    Protocol::Osc(OscSettings { prefix: "/s".to_owned(), messages: vec![OscMessageKind::Status], values: Vec::new() })
}

fn until(say: &dyn Fn() -> bool) -> bool {
    (0..100).any(|_| say())
}

#[test]
fn a_missing_frame_is_reported_as_stale() {
    let (line, word, held) = (Ear::new(), Ear::new(), Ear::new());
    let outputs = [
        output(json(), &line),
        OutputSettings { name: "osc".to_owned(), ..output(status(), &word) },
        OutputSettings { name: "freed".to_owned(), on_loss: OnLoss::Flag, ..output(freed(Spare::Quality), &held) },
    ];
    let mut camera = Stepped::start(&outputs, stale_after(100));
    camera.frame(20, State::Tracking, 0.5);
    assert_eq!((line.json()["state"].as_str(), held.freed().spare), (Some("tracking"), 1));
    camera.clocks.advance_ms(2500);
    let stale = line.json();
    assert_eq!((&stale["event"], &stale["age_ms"]), (&"stale".into(), &2520.0.into()));
    assert!(until(&|| word.next().windows(5).any(|w| w == b"stale")));
    assert_eq!(held.freed().spare, 3);
    // It recovers when frames come again.
    camera.frame(20, State::Tracking, 0.5);
    assert!(until(&|| line.json()["state"] == "tracking"));
    assert!(until(&|| held.freed().spare == 1));
    camera.publisher.close();
}

/// Returns everything received until the outputs are closed, as (x in millimetres, spare).
fn all_freed(ear: &Ear) -> Vec<(f64, u16)> {
    ear.0.set_nonblocking(true).unwrap();
    let mut buffer = [0; 64];
    let packets = std::iter::from_fn(|| ear.0.recv(&mut buffer).ok().map(|n| FreedPacket::decode(&buffer[..n]).unwrap()));
    packets.map(|p| (p.position_mm[0], p.spare)).collect()
}

#[test]
fn an_old_frame_is_never_sent_as_good() {
    let fixed = Rate::Fixed { rate: FixedRate { ticks: 50, per_s: 1 }, delay: Duration::ZERO, phase: TickPhase::FreeRunning };
    for rate in [Rate::Every(1), fixed] {
        for suspends in [false, true] {
            let ear = Ear::new();
            let mut camera = Stepped::start(&[OutputSettings { rate, ..output(freed(Spare::Quality), &ear) }], stale_after(500));
            camera.frame(20, State::Tracking, 0.001);
            assert_eq!(ear.freed().spare, 1);
            // The process is stopped, or the machine suspended, with a frame in progress: what was
            // taken before comes out after.
            let timestamp = camera.clocks.read().monotonic;
            if suspends {
                camera.clocks.suspend_ms(2500)
            } else {
                camera.clocks.advance_ms(2500)
            }
            camera.publisher.send(&PoseSample { timestamp, ..sample(7, State::Tracking, 0.002) });
            // Time enough for both kinds of output to process it.
            std::thread::sleep(Duration::from_millis(150));
            let mut received = all_freed(&ear);
            assert!(received.iter().all(|(_, spare)| *spare != 1), "{rate:?} {suspends}: {received:?}");
            // Frames that are in time are good again.
            for _ in 0..100 {
                camera.clocks.advance_ms(20);
                camera.frame(10, State::Tracking, 0.003);
                std::thread::sleep(Duration::from_millis(20));
                received.extend(all_freed(&ear));
                if received.iter().any(|(_, spare)| *spare == 1) {
                    break;
                }
            }
            camera.publisher.close();
            received.extend(all_freed(&ear));
            let good: Vec<_> = received.iter().filter(|(_, spare)| *spare == 1).collect();
            assert!(!good.is_empty() && good.iter().all(|(x, _)| (x - 3.0).abs() < 0.01), "{rate:?} {suspends}: {received:?}");
        }
    }
}

#[test]
fn an_old_frame_or_clock_step_shifts_no_later_stamp() {
    let ear = Ear::new();
    let mut camera = Stepped::start(&[output(json(), &ear)], patient());
    camera.clocks.advance_ms(60_000);
    camera.frame(11_000, State::Tracking, 0.0);
    let at = |line: &serde_json::Value| (line["age_ms"].as_f64().unwrap(), line["unix_ns"].as_i64().unwrap());
    let now_ns = camera.clocks.read().unix.ns();
    assert_eq!(at(&ear.json()), (11_000.0, now_ns - 11_000_000_000));
    camera.frame(30, State::Tracking, 0.0);
    assert_eq!(at(&ear.json()), (30.0, now_ns - 30_000_000));
    for step_ms in [-3_600_000, 7_200_000] {
        camera.clocks.step_wall_ms(step_ms);
        camera.clocks.advance_ms(33);
        camera.frame(30, State::Tracking, 0.0);
        assert_eq!(at(&ear.json()), (30.0, camera.clocks.read().unix.ns() - 30_000_000));
    }
    camera.publisher.close();
}

#[test]
fn repeated_or_foreign_stamps_are_ignored() {
    let ear = Ear::new();
    let mut camera = Stepped::start(&[OutputSettings { on_loss: OnLoss::Flag, ..output(json(), &ear) }], patient());
    camera.frame(20, State::Tracking, 0.1);
    // The record of a skipped row is `lost`, and tells nothing about the camera.
    camera.frame(20, State::Lost, 0.0);
    camera.frame(30, State::Lost, 0.0);
    camera.frame(-5_000, State::Tracking, 9.0);
    camera.frame(10, State::Tracking, 0.2);
    let sent = camera.publisher.close()[0].sent;
    let received: Vec<_> = (0..sent).map(|_| ear.json()).map(|l| (l["state"].clone(), l["pose"]["position_m"][0].clone())).collect();
    assert_eq!(received, [("tracking".into(), 0.1.into()), ("tracking".into(), 0.2.into())]);
}

#[test]
fn late_ticks_coast_and_are_sent_only_if_it_can_be_marked() {
    let rate = Rate::Fixed { rate: FixedRate { ticks: 50, per_s: 1 }, delay: Duration::ZERO, phase: TickPhase::FreeRunning };
    let (marked, unmarked) = (Ear::new(), Ear::new());
    let outputs = [
        OutputSettings { rate, ..output(freed(Spare::Quality), &marked) },
        OutputSettings { name: "unmarked".to_owned(), rate, ..output(freed(Spare::Zero), &unmarked) },
    ];
    let mut camera = Stepped::start(&outputs, patient());
    camera.frame(0, State::Tracking, 0.0);
    camera.clocks.advance_ms(20);
    assert_eq!(marked.freed().spare, 1);
    unmarked.freed();
    // 40 ms after a frame of a camera at 30 per second.
    camera.clocks.advance_ms(20);
    assert_eq!(marked.freed().spare, 2);
    camera.clocks.advance_ms(200);
    std::thread::sleep(Duration::from_millis(250));
    camera.publisher.close();
    assert_eq!((all_freed(&marked).len(), unmarked.rest()), (0, 0));
}

#[test]
fn a_stale_limit_below_the_frame_interval_freezes_no_blend() {
    let ear = Ear::new();
    let safety = SafetySettings { blend: Some(BlendRates { speed_m_s: 1.0, angular_speed_rad_s: 1.0 }), ..stale_after(100) };
    let mut camera = Stepped::start(&[output(freed(Spare::Quality), &ear)], safety);
    let mut received = Vec::new();
    // Five frames per second, each stale before the next one comes.
    for k in 0..6 {
        camera.frame(20, State::Tracking, if k == 0 { 0.0 } else { 0.3 });
        received.push(ear.freed());
        camera.clocks.advance_ms(200);
        std::thread::sleep(Duration::from_millis(120));
    }
    camera.publisher.close();
    let received: Vec<_> = received.iter().map(|p| (p.position_mm[0].round(), p.spare)).collect();
    assert_eq!(received[..4], [(0.0, 1), (0.0, 2), (200.0, 2), (300.0, 1)]);
}

#[test]
fn poses_out_of_freed_range_are_withheld_not_clamped() {
    let (flagged, stopped) = (Ear::new(), Ear::new());
    let outputs = [
        OutputSettings { on_loss: OnLoss::Flag, ..output(freed(Spare::Quality), &flagged) },
        OutputSettings { name: "frames".to_owned(), ..output(freed(Spare::Zero), &stopped) },
    ];
    let publisher = start(&outputs);
    [1.0, 131.08, 400.0, 2.0].into_iter().zip(0..).for_each(|(x, k)| publisher.send(&sample(k, State::Tracking, x)));
    let events = publisher.events().clone();
    let statistics = publisher.close();
    assert_eq!((statistics[0].withheld, statistics[1].withheld), (2, 2));
    assert_eq!(all_freed(&flagged), [(1000.0, 1), (1000.0, 3), (1000.0, 3), (2000.0, 1)]);
    assert_eq!(all_freed(&stopped), [(1000.0, 0), (2000.0, 0)]);
    assert!(events.try_iter().all(|e| e.reason.words() == "farther than the protocol's numbers reach"));
}

#[test]
fn fixed_rate_samples_are_renumbered_and_interpolated() {
    let ear = Ear::new();
    let rate = Rate::Fixed { rate: FixedRate { ticks: 50, per_s: 1 }, delay: Duration::from_millis(80), phase: TickPhase::FreeRunning };
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
        // 1 m/s: 20 mm per tick, whenever the samples came.
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
    // Raised once, at the beginning.
    let received: Vec<_> = events.try_iter().map(|e| (e.output, e.body, e.reason.words())).collect();
    assert_eq!(received, [(outputs[0].name.clone(), "camera".to_owned(), "outside the permitted box")]);
    assert_eq!(guarded.json()["pose"]["position_m"][0], 0.5);
    let withheld = guarded.json();
    assert_eq!((&withheld["pose"], &withheld["withheld"]), (&serde_json::Value::Null, &"outside the permitted box".into()));
    free.next();
    assert_eq!(free.json()["pose"]["position_m"][0], 1.5);
}

#[test]
fn after_a_loss_a_blended_output_resumes_from_its_last_pose() {
    let ear = Ear::new();
    let safety = SafetySettings { blend: Some(BlendRates { speed_m_s: 3.0, angular_speed_rad_s: 1.0 }), ..patient() };
    let publisher = Publisher::start(&[output(freed(Spare::Quality), &ear)], &context(safety)).unwrap();
    let states = [State::Tracking, State::Lost, State::Tracking, State::Tracking, State::Tracking];
    (0..5).zip(states).for_each(|(k, state)| publisher.send(&sample(k, state, if k < 2 { 0.0 } else { 0.15 })));
    publisher.close();
    let received: Vec<_> = (0..4).map(|_| ear.freed()).map(|p| (p.position_mm[0].round(), p.spare)).collect();
    assert_eq!(received, [(0.0, 1), (0.0, 2), (100.0, 2), (150.0, 1)]);
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
fn a_blocked_output_drops_its_oldest_and_affects_no_other() {
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
fn test_samples_are_marked_as_tests() {
    let ear = Ear::new();
    let otrk = OpenTrackIoSettings {
        encoding: Encoding::Json,
        source_number: 1,
        sensor_width_mm: 4.8,
        principal_point: crate::protocols::opentrackio_lens::PrincipalPoint::Projection,
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
    assert_eq!(Publisher::rehearse(&outputs, &|_| false).err().unwrap().0, 1);
}

#[path = "publisher_mount_tests.rs"]
mod mount;
