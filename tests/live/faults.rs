//! One fault after another: what subscribers receive, what is reported, that nothing hangs, and
//! that no panic escapes.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use crossbeam_channel::bounded;
use stagepose::diagnostics::live::{AboutClip, Event, LiveLink, LiveStop, RealDisk, Recorder, RecorderPlan, StampedEvent};
use stagepose::{ClipOptions, Daemon, PoseSample, RunningDaemon, Settings, State, Tracker, open_clip, track_entry};

use super::faulty::{Fault, Faulty, source, tracker_setup};

/// The result of a run.
struct Played {
    samples: Vec<PoseSample>,
    events: Vec<StampedEvent>,
    link: LiveLink,
}

/// Joins the daemon; if it hangs, the test fails instead of hanging too.
fn join(running: RunningDaemon) {
    let (done, joined) = bounded(1);
    std::thread::spawn(move || done.send(running.join()));
    joined.recv_timeout(Duration::from_secs(60)).expect("the daemon hangs").expect("no stage panicked");
}

fn daemon(faulty: &Arc<Faulty>, link: &LiveLink) -> (Daemon, LiveStop) {
    let tracker = Tracker::new(tracker_setup()).expect("a setup that fits");
    let source = source(faulty, link);
    let stop = source.stopper();
    let mut daemon = Daemon::live(source, tracker);
    let count = faulty.clone();
    daemon.observe(move |_, _| {
        count.tracked.fetch_add(1, Ordering::Release);
    });
    (daemon, stop)
}

/// Plays a camera to its end.
fn play(faulty: &Arc<Faulty>) -> Played {
    let link = LiveLink::default();
    let events = link.events.listen();
    let (mut daemon, _) = daemon(faulty, &link);
    let samples = daemon.subscribe();
    let running = daemon.start().unwrap();
    let samples = samples.iter().collect();
    join(running);
    link.events.close();
    Played { samples, events: events.iter().collect(), link }
}

impl Played {
    fn rows(&self) -> Vec<&PoseSample> {
        self.samples.iter().filter(|s| s.state != State::Stale).collect()
    }

    fn states_from(&self, first: usize) -> Vec<State> {
        self.rows()[first..].iter().map(|s| s.state).collect()
    }

    fn has(&self, wanted: impl Fn(&Event) -> bool) -> bool {
        self.events.iter().any(|e| wanted(&e.event))
    }
}

#[test]
fn a_camera_that_goes_and_returns_is_tracked_again() {
    let openings = [None, Some(Fault::OpenFails), Some(Fault::OpenPanics), Some(Fault::ModePanics), Some(Fault::OtherSizeAndDropPanics)];
    for fault in [Fault::Gone, Fault::ReadPanics, Fault::DropPanics] {
        let played = play(&Faulty::told(&openings, &[(6, fault)], 12));
        let rows = played.rows();
        assert_eq!(rows.iter().map(|s| s.sequence).collect::<Vec<_>>(), (0..12).collect::<Vec<_>>(), "{fault:?}");
        assert!(played.states_from(1).iter().filter(|s| **s == State::Tracking).count() >= 9, "{fault:?} {:?}", played.states_from(0));
        assert!(
            played.has(|e| matches!(e, Event::CameraLost { .. })) && played.has(|e| matches!(e, Event::CameraOpened { again: true, .. }))
        );
        assert!(played.has(|e| matches!(e, Event::CameraWaiting { reason } if reason.contains("cheese"))));
        assert!(played.has(|e| matches!(e, Event::CameraWaiting { reason } if reason.contains("640 x 480"))));
        assert_eq!(played.link.statistics.reconnects.get(), 1);
    }
}

#[test]
fn camera_silence_yields_stale_messages_but_no_record() {
    let played = play(&Faulty::told(&[], &[(5, Fault::Stalls)], 10));
    let stale: Vec<&PoseSample> = played.samples.iter().filter(|s| s.state == State::Stale).collect();
    assert!(!stale.is_empty() && stale.iter().all(|s| s.pose.is_none() && s.times.age_ms.is_some()));
    let line = stale[0].to_json_line();
    assert!(line.starts_with(r#"{"state":"stale","pose":null,"age_ms":"#), "{line}");
    assert!(played.has(|e| matches!(e, Event::Stale { .. })) && played.has(|e| matches!(e, Event::Resumed { .. })));
    assert!(played.has(|e| matches!(e, Event::CameraLost { reason } if reason.contains("no picture for"))));
    assert_eq!(played.rows().len(), 10);
}

#[test]
fn a_blocked_camera_read_hangs_nothing() {
    let faulty = Faulty::told(&[], &[(3, Fault::Blocks), (4, Fault::Blocks), (5, Fault::Blocks)], 8);
    let played = play(&faulty);
    assert_eq!(played.rows().len(), 8);
    // The daemon also ends while a reader is blocked.
    let faulty = Faulty::told(&[], &[(2, Fault::Blocks)], u64::MAX);
    let (mut daemon, stop) = daemon(&faulty, &LiveLink::default());
    let samples = daemon.subscribe();
    let running = daemon.start().unwrap();
    samples.iter().find(|s| s.state == State::Stale).expect("a stale message");
    stop.stop();
    join(running);
}

#[test]
fn bad_pictures_and_stamps_lose_only_themselves() {
    let faults = [
        (4, Fault::Truncated),
        (6, Fault::Garbage),
        (8, Fault::Empty),
        (10, Fault::DriverSaysDamaged),
        (12, Fault::StaleBytesBehind),
        (14, Fault::SmallPicture),
        (16, Fault::StampRepeats),
        (18, Fault::StampGoesBack),
        (20, Fault::FramesLostInDevice),
    ];
    let played = play(&Faulty::told(&[], &faults, 24));
    let (rows, s) = (played.rows(), &played.link.statistics);
    assert_eq!((rows.len(), s.undecodable.get(), s.skipped.get(), s.device_dropped.get()), (24, 4, 3, 3));
    for n in [5, 7, 9, 11, 12, 13, 15, 17, 19, 20, 21, 23] {
        assert_eq!(rows[n].state, State::Tracking, "row {n}: {:?}", played.states_from(0));
    }
}

#[test]
fn a_driver_without_stamps_is_reported_once() {
    let played = play(&Faulty::told(&[], &[(0, Fault::NoStamp), (1, Fault::NoStamp)], 3));
    assert_eq!(played.events.iter().filter(|e| matches!(e.event, Event::NoDriverStamp { .. })).count(), 1);
}

#[test]
fn a_stalled_subscriber_loses_the_oldest_and_blocks_nothing() {
    let faulty = Faulty::told(&[], &[], 300);
    let (mut daemon, _) = daemon(&faulty, &LiveLink::default());
    let (stalled, read) = (daemon.subscribe(), daemon.subscribe());
    let running = daemon.start().unwrap();
    let all: Vec<u64> = read.iter().map(|s| s.sequence).collect();
    join(running);
    assert!(all.len() >= 300);
    let late: Vec<u64> = stalled.iter().map(|s| s.sequence).collect();
    assert!(late.len() < 300 && late.last() == Some(&299), "{} samples", late.len());
}

#[test]
fn a_recording_full_of_faults_replays_byte_for_byte() {
    let folder = tempfile::tempdir().unwrap();
    let clip = folder.path().join("take");
    let faulty = Faulty::random(5, 6, 60);
    let tracker = Tracker::new(tracker_setup()).expect("a setup that fits");
    let link = LiveLink::default();
    let mut source = source(&faulty, &link);
    let mode = source.wait_for_camera(|| false).expect("the camera opens");
    let config = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/dolly/stage.toml");
    let config = Settings::load(&config).unwrap().source;
    let plan = RecorderPlan { clip: Some(clip.clone()), ring: None, about: AboutClip { camera: mode, config, exposure_s: 0.0 } };
    let recorder = Recorder::start(plan, &link, Box::<RealDisk>::default()).unwrap();
    let mut daemon = Daemon::live(source, tracker);
    daemon.observe(recorder.observer());
    let count = faulty.clone();
    daemon.observe(move |_, _| {
        count.tracked.fetch_add(1, Ordering::Release);
    });
    join(daemon.start().unwrap());
    recorder.finish();
    let mut tracker = Tracker::new(tracker_setup()).expect("a setup that fits");
    let mut replay = open_clip(&clip, ClipOptions::default()).unwrap();
    let again: String =
        std::iter::from_fn(|| replay.next_entry()).map(|row| track_entry(&mut tracker, &row).to_json_line() + "\n").collect();
    let recorded = std::fs::read_to_string(clip.join("poses.jsonl")).unwrap();
    assert_eq!(recorded.lines().count(), 60);
    assert!(recorded.contains("\"tracking\"") && recorded.contains("\"pose\":null"));
    assert!(again == recorded, "{:?}", again.lines().zip(recorded.lines()).find(|(a, b)| a != b));
}
