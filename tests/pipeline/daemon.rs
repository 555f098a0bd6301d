//! The daemon's threads: the same samples as without them, and an end under all circumstances.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use crossbeam_channel::{Receiver, bounded};
use stagepose::diagnostics::capture::VirtualCamera;
use stagepose::{
    ClipEntry, Daemon, Delivery, EntryContent, FrameSource, PoseSample, RunningDaemon, Timestamp, Tracker, TrackerSetup, VirtualStage,
};

use super::scene::{FPS, backdrop, camera, past, quiet, setup, track};

fn scene() -> VirtualStage {
    let mut scene = quiet(camera(320, 240), past(), backdrop());
    scene.blackouts.push(4.5 / FPS..6.5 / FPS);
    scene
}

fn with_threads(threads: usize) -> TrackerSetup {
    let mut setup = setup(&scene());
    setup.settings.threads = threads;
    setup
}

fn daemon(threads: usize, delivery: Delivery, source: impl FrameSource + 'static) -> Daemon {
    Daemon::new(Box::new(source), Tracker::new(with_threads(threads)).expect("a setup that fits"), delivery)
}

fn lines(samples: impl IntoIterator<Item = PoseSample>) -> Vec<String> {
    samples.into_iter().map(|s| s.to_json_line()).collect()
}

/// Joins the daemon; if it hangs, the test fails instead of hanging too.
fn join(running: RunningDaemon) {
    let (done, joined) = bounded(1);
    std::thread::spawn(move || done.send(running.join()));
    joined.recv_timeout(Duration::from_secs(60)).expect("the daemon hangs").expect("no stage panicked");
}

#[test]
fn subscribers_get_the_same_records_on_any_number_of_threads() {
    let alone = lines(track(&scene(), 9));
    assert!(alone.iter().any(|l| l.contains("\"tracking\"")) && alone.iter().any(|l| l.contains("\"coasting\"")));
    for threads in [1, 2] {
        let mut daemon = daemon(threads, Delivery::Blocking, VirtualCamera::new(scene(), FPS, 9));
        let subscribers = [daemon.subscribe(), daemon.subscribe()];
        let running = daemon.start().unwrap();
        let readers = subscribers.map(|s| std::thread::spawn(move || lines(s)));
        for reader in readers {
            assert_eq!(reader.join().unwrap(), alone, "{threads} threads");
        }
        assert_eq!(running.dropped_frames(), 0);
        join(running);
    }
}

/// Rows without a picture. Each one waits until the previous one is published, so that none is
/// dropped on the way.
struct Beats {
    rows: u64,
    next: u64,
    published: Arc<AtomicU64>,
}

impl FrameSource for Beats {
    fn next_entry(&mut self) -> Option<ClipEntry> {
        if self.next >= self.rows {
            return None;
        }
        while self.published.load(Ordering::Acquire) < self.next {
            std::thread::sleep(Duration::from_micros(20));
        }
        let sequence = self.next;
        self.next += 1;
        let content = EntryContent::Undecodable("nothing to see".into());
        Some(ClipEntry::new(sequence, Timestamp::from_ns(sequence as i64 * 33_333_333), content))
    }

    fn size(&self) -> (u32, u32) {
        (320, 240)
    }

    fn rows(&self) -> Option<u64> {
        Some(self.rows)
    }
}

/// Returns a daemon over `rows` beats, and the count of its published samples.
fn beating(rows: u64, delivery: Delivery) -> (Daemon, Arc<AtomicU64>) {
    let published = Arc::new(AtomicU64::new(0));
    let mut daemon = daemon(1, delivery, Beats { rows, next: 0, published: published.clone() });
    let count = published.clone();
    daemon.observe(move |_, _| {
        count.fetch_add(1, Ordering::Release);
    });
    (daemon, published)
}

fn sequences(samples: &Receiver<PoseSample>) -> Vec<u64> {
    samples.iter().map(|s| s.sequence).collect()
}

#[test]
fn a_sleeping_live_subscriber_loses_its_oldest_records() {
    let (mut daemon, published) = beating(400, Delivery::DropOldest);
    let (sleeper, reader) = (daemon.subscribe(), daemon.subscribe());
    let running = daemon.start().unwrap();
    let awake = std::thread::spawn(move || sequences(&reader));
    join(running);
    assert_eq!(published.load(Ordering::Acquire), 400);
    let late = sequences(&sleeper);
    assert!(late.len() < 400 && late.len() > 100, "{}", late.len());
    assert_eq!(late, (400 - late.len() as u64..400).collect::<Vec<_>>());
    // A sleeping reader does not harm one that keeps up.
    let seen = awake.join().unwrap();
    assert!(seen.windows(2).all(|w| w[0] < w[1]) && seen.last() == Some(&399) && seen.len() >= late.len());
}

#[test]
fn late_frames_are_dropped_and_counted() {
    // This source waits for nobody and is far faster than the tracker.
    let mut daemon = daemon(1, Delivery::DropOldest, VirtualCamera::new(scene(), FPS, 40));
    let samples = daemon.subscribe();
    let running = daemon.start().unwrap();
    let seen = sequences(&samples);
    assert_eq!(seen.len() as u64 + running.dropped_frames(), 40);
    assert!(seen.windows(2).all(|w| w[0] < w[1]) && seen.last() == Some(&39), "{seen:?}");
    join(running);
}

#[test]
fn a_dropped_receiver_does_not_stop_the_daemon() {
    for delivery in [Delivery::Blocking, Delivery::DropOldest] {
        let (mut daemon, published) = beating(50, delivery);
        let (gone, left) = (daemon.subscribe(), daemon.subscribe());
        drop(gone);
        let running = daemon.start().unwrap();
        assert_eq!(sequences(&left), (0..50).collect::<Vec<_>>());
        join(running);
        assert_eq!(published.load(Ordering::Acquire), 50);
    }
}

#[test]
fn without_subscribers_it_runs_to_its_end() {
    let (daemon, published) = beating(20, Delivery::Blocking);
    join(daemon.start().unwrap());
    assert_eq!(published.load(Ordering::Acquire), 20);
}

#[test]
fn stop_ends_an_endless_stream() {
    for delivery in [Delivery::Blocking, Delivery::DropOldest] {
        let (mut daemon, published) = beating(u64::MAX, delivery);
        let samples = daemon.subscribe();
        let running = daemon.start().unwrap();
        assert_eq!(samples.recv_timeout(Duration::from_secs(60)).unwrap().sequence, 0);
        running.stop();
        // A frame that is waiting at the stop is dropped, so the source must not wait for its
        // publication.
        published.fetch_add(u64::MAX / 2, Ordering::Release);
        let rest = sequences(&samples);
        assert!(rest.windows(2).all(|w| w[1] == w[0] + 1));
        join(running);
    }
}
