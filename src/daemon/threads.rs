//! The three stages as threads: capture, matcher, pose.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use thiserror::Error;

use super::entries::{sample, sight};
use super::live::{Event, LiveLink, LiveSource, dropped};
use super::reason_watch::ReasonWatch;
use super::stale::StaleWatch;
use crate::capture::timestamping::monotonic_now;
use crate::capture::{ClipEntry, EntryContent, EntryOrder, FrameSource};
use crate::drop_oldest::{DropOldestSender, drop_oldest};
use crate::record::PoseSample;
use crate::track::{BodyTracker, FrameObservation, Mixture, ModelNews, Reason, ShutterNews};
use crate::tracker::{PoseRecorder, Tracker};

/// What happens when a stage is slower than the one before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Delivery {
    /// The faster one waits; nothing is lost. For replay.
    Blocking,
    /// The oldest unread frame is dropped. For live cameras.
    DropOldest,
}

/// Why the daemon could not run to its end.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum DaemonError {
    /// The system provided no thread.
    #[error("cannot start the {stage} thread: {source}; close other programs or raise the limit of processes")]
    Thread {
        /// The stage.
        stage: &'static str,
        /// The system's error.
        source: std::io::Error,
    },
    /// A stage ended because of a defect in the program.
    #[error("the {0} stage failed; please report this together with the clip")]
    Stage(&'static str),
}

/// Sees every row with its sample on the pose thread: overlays, recorders.
type Observer = Box<dyn FnMut(&ClipEntry, &PoseSample) + Send>;

/// Maximum rows waiting between two stages if none may be lost. Chosen: enough that stages do not
/// wait for each other's slow frames. Raised, more pictures are held in memory.
const QUEUE: usize = 4;
/// Maximum samples waiting for a live subscriber before the oldest is dropped: about 8 seconds at
/// 30 per second. Chosen, not tuned. Raised, it takes more memory, and a subscriber that was held
/// up gets older samples.
const SUBSCRIBER_QUEUE: usize = 256;

/// The tracker on its own threads. Subscribe first, then start.
pub struct Daemon {
    source: Box<dyn FrameSource>,
    tracker: Tracker,
    delivery: Delivery,
    subscribers: Vec<Subscriber>,
    observers: Vec<Observer>,
    stop: Arc<AtomicBool>,
    dropped: Arc<AtomicU64>,
    live: Option<LiveLink>,
}

enum Subscriber {
    Blocking(Sender<PoseSample>),
    Latest(DropOldestSender<PoseSample>),
}

/// A running daemon.
pub struct RunningDaemon {
    stages: Vec<(&'static str, JoinHandle<()>)>,
    stop: Arc<AtomicBool>,
    dropped: Arc<AtomicU64>,
}

impl Daemon {
    /// Returns a daemon that reads from `source`.
    pub fn new(source: Box<dyn FrameSource>, tracker: Tracker, delivery: Delivery) -> Self {
        let (stop, dropped) = (Arc::default(), Arc::default());
        Self { source, tracker, delivery, subscribers: Vec::new(), observers: Vec::new(), stop, dropped, live: None }
    }

    /// Returns a daemon for a camera. It drops the oldest rows, numbers the rows that are tracked,
    /// counts, and sends subscribers a stale message
    /// ([`State::Stale`](crate::record::State::Stale)) when no picture has come for three frame
    /// times. Give the tracker the exposure that the camera's mode states.
    pub fn live(source: LiveSource, tracker: Tracker) -> Self {
        // One switch for both: a source that waits for a picture does not check the daemon's.
        let (live, stop) = (Some(source.link()), source.stop_switch());
        Self { live, stop, ..Self::new(Box::new(source), tracker, Delivery::DropOldest) }
    }

    /// Returns a new subscriber's channel. It ends with the daemon. With [`Delivery::Blocking`] a
    /// subscriber that does not read blocks the daemon; with [`Delivery::DropOldest`] it loses the
    /// oldest samples. Dropping the receiver is harmless.
    pub fn subscribe(&mut self) -> Receiver<PoseSample> {
        match self.delivery {
            Delivery::Blocking => {
                let (sender, receiver) = bounded(QUEUE);
                self.subscribers.push(Subscriber::Blocking(sender));
                receiver
            }
            Delivery::DropOldest => {
                let (sender, receiver) = drop_oldest(SUBSCRIBER_QUEUE);
                self.subscribers.push(Subscriber::Latest(sender));
                receiver
            }
        }
    }

    /// Calls `observer` on the pose thread with every row and its sample, before subscribers get
    /// it.
    pub fn observe(&mut self, observer: impl FnMut(&ClipEntry, &PoseSample) + Send + 'static) {
        self.observers.push(Box::new(observer));
    }

    /// Starts the three stages, or none of them.
    ///
    /// # Errors
    /// When the system provides no thread. The stages started before have then ended, and the
    /// source is closed.
    pub fn start(self) -> Result<RunningDaemon, DaemonError> {
        self.start_with(|stage, run| std::thread::Builder::new().name(stage.to_owned()).spawn(run))
    }

    /// As [`start`](Self::start), with a function that creates threads, so that its failure can be
    /// tested.
    fn start_with(self, mut spawn: impl FnMut(&'static str, Run) -> std::io::Result<JoinHandle<()>>) -> Result<RunningDaemon, DaemonError> {
        let Self { source, tracker, delivery, subscribers, observers, stop, dropped, live } = self;
        let Tracker { matcher, poses, .. } = tracker;
        let (to_matcher, rows) = row_channel(delivery);
        let (to_pose, observations) = bounded(QUEUE);
        let unseen = Unseen { count: dropped.clone(), live: live.clone() };
        let is_over = Arc::<AtomicBool>::default();
        let capture = Capture { source, to_matcher, stop: stop.clone(), is_over: is_over.clone(), unseen: unseen.clone() };
        let order = live.as_ref().map(|_| EntryOrder::default());
        let end = (delivery == Delivery::DropOldest).then(|| End { stop: stop.clone(), is_over, unseen });
        let watch = live.map(|link| StaleWatch::new(link, stop.clone()));
        // Start the last stage first: a stage without input ends by itself, while a source that is
        // being read may not.
        let stages: [(&'static str, Run); 3] = [
            ("pose", Box::new(move || publish(poses, &observations, observers, subscribers, watch))),
            ("matcher", Box::new(move || match_rows(matcher, order, end.as_ref(), &rows, &to_pose))),
            ("capture", Box::new(move || capture.run())),
        ];
        let mut running = RunningDaemon { stages: Vec::new(), stop, dropped };
        let mut waiting = stages.into_iter();
        while let Some((stage, run)) = waiting.next() {
            match spawn(stage, run) {
                Ok(handle) => running.stages.insert(0, (stage, handle)),
                Err(source) => {
                    // This also drops the channel ends of the stages not yet started.
                    drop(waiting);
                    running.stop();
                    let _ = running.join();
                    return Err(DaemonError::Thread { stage, source });
                }
            }
        }
        Ok(running)
    }
}

impl RunningDaemon {
    /// Asks the capture stage to end; the others end after the rows in progress. With
    /// [`Delivery::DropOldest`] a waiting frame is dropped, except the last one of a source that
    /// has ended by itself.
    pub fn stop(&self) {
        // Release: whoever reads it also sees whether the source had ended before.
        self.stop.store(true, Ordering::Release);
    }

    /// Returns a switch that does the same from elsewhere (a signal handler's thread).
    pub fn stop_switch(&self) -> Arc<AtomicBool> {
        self.stop.clone()
    }

    /// Returns the number of frames dropped because the matcher was late.
    pub fn dropped_frames(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Whether a stage has ended: the stream is over, or a stage failed; [`join`](Self::join) tells
    /// which.
    pub fn has_ended(&self) -> bool {
        self.stages.iter().any(|(_, handle)| handle.is_finished())
    }

    /// Waits for the end of the stream.
    pub fn join(self) -> Result<(), DaemonError> {
        let mut failed = None;
        for (stage, handle) in self.stages {
            if handle.join().is_err() {
                failed.get_or_insert(stage);
            }
        }
        failed.map_or(Ok(()), |stage| Err(DaemonError::Stage(stage)))
    }
}

/// A stage's main function.
type Run = Box<dyn FnOnce() + Send>;

enum RowSender {
    Blocking(Sender<ClipEntry>),
    Latest(DropOldestSender<ClipEntry>),
}

fn row_channel(delivery: Delivery) -> (RowSender, Receiver<ClipEntry>) {
    match delivery {
        Delivery::Blocking => {
            let (sender, receiver) = bounded(QUEUE);
            (RowSender::Blocking(sender), receiver)
        }
        // At most one frame waits, the newest.
        Delivery::DropOldest => {
            let (sender, receiver) = drop_oldest(1);
            (RowSender::Latest(sender), receiver)
        }
    }
}

/// Counts the frames that are not tracked.
#[derive(Clone)]
struct Unseen {
    count: Arc<AtomicU64>,
    live: Option<LiveLink>,
}

impl Unseen {
    fn add(&self, row: &ClipEntry) {
        self.count.fetch_add(1, Ordering::Relaxed);
        self.live.iter().for_each(|live| dropped(live, row.timestamp));
    }
}

/// Stops a live daemon: a waiting frame is dropped. On a slow machine a frame takes seconds, and
/// the caller waits.
struct End {
    stop: Arc<AtomicBool>,
    /// Set if the source ended by itself before the stop: its last frame is tracked.
    is_over: Arc<AtomicBool>,
    unseen: Unseen,
}

impl End {
    fn has_come(&self) -> bool {
        self.stop.load(Ordering::Acquire) && !self.is_over.load(Ordering::Relaxed)
    }
}

struct Capture {
    source: Box<dyn FrameSource>,
    to_matcher: RowSender,
    stop: Arc<AtomicBool>,
    /// See [`End`].
    is_over: Arc<AtomicBool>,
    unseen: Unseen,
}

impl Capture {
    fn run(mut self) {
        while !self.stop.load(Ordering::Relaxed) {
            let Some(row) = self.source.next_entry() else {
                self.is_over.store(!self.stop.load(Ordering::Relaxed), Ordering::Relaxed);
                return;
            };
            match &self.to_matcher {
                RowSender::Blocking(sender) => {
                    if sender.send(row).is_err() {
                        return;
                    }
                }
                RowSender::Latest(sender) => {
                    sender.send_dropping(row, |late| self.unseen.add(&late));
                }
            }
        }
    }
}

/// A row, the matcher's result, and the row's age when matching started.
struct Seen {
    row: ClipEntry,
    observation: FrameObservation,
    age_ms: Option<f64>,
}

/// Runs the matcher. `order` numbers a camera's rows as they are tracked, after drops. Without
/// `end` every row is tracked.
fn match_rows(
    mut matcher: BodyTracker,
    mut order: Option<EntryOrder>,
    end: Option<&End>,
    rows: &Receiver<ClipEntry>,
    to_pose: &Sender<Seen>,
) {
    for row in rows {
        if let Some(end) = end.filter(|end| end.has_come()) {
            end.unseen.add(&row);
            continue;
        }
        let age_ms = order.as_ref().map(|_| monotonic_now().ms_since(row.timestamp));
        let row = match &mut order {
            Some(order) => order.admit(row),
            None => row,
        };
        let observation = sight(&mut matcher, &row);
        if to_pose.send(Seen { row, observation, age_ms }).is_err() {
            return;
        }
    }
}

fn publish(
    mut poses: PoseRecorder,
    observations: &Receiver<Seen>,
    mut observers: Vec<Observer>,
    mut subscribers: Vec<Subscriber>,
    mut watch: Option<StaleWatch>,
) {
    let mut reasons = ReasonWatch::default();
    loop {
        let next = match &watch {
            Some(watch) => observations.recv_timeout(watch.wait()),
            None => observations.recv().map_err(RecvTimeoutError::from),
        };
        match next {
            Ok(Seen { row, observation, age_ms }) => {
                let mut sample = sample(&mut poses, &observation, &row);
                sample.times.age_ms = age_ms;
                if let Some(news) = observation.misfit {
                    tell(news, watch.as_ref().map(StaleWatch::link));
                }
                if let Some(mixture) = observation.mixture {
                    tell_mixture(mixture, watch.as_ref().map(StaleWatch::link));
                }
                if let Some(news) = observation.shutter_news {
                    tell_shutter(&news, watch.as_ref().map(StaleWatch::link));
                }
                if let Some(watch) = &mut watch {
                    watch.seen(&sample);
                    count(watch.link(), &row, &sample);
                    if let Some(event) = reasons.seen(&sample) {
                        watch.link().events.publish(event);
                    }
                }
                observers.iter_mut().for_each(|observer| observer(&row, &sample));
                deliver(&mut subscribers, &sample);
            }
            Err(RecvTimeoutError::Timeout) => {
                if let Some(stale) = watch.as_mut().and_then(StaleWatch::check) {
                    deliver(&mut subscribers, &stale);
                }
            }
            Err(RecvTimeoutError::Disconnected) => return,
        }
    }
}

/// Reports which part of the model differs: as an event of a live camera, else to the log.
fn tell(news: ModelNews, live: Option<&LiveLink>) {
    let (part, text) = (news.part.word().to_owned(), news.text());
    match live {
        Some(live) => live.events.publish(Event::ModelDiffers { part, surface: news.surface, text }),
        None => tracing::warn!("{text}"),
    }
}

/// Reports that frames mix two moments, likewise.
fn tell_mixture(mixture: Mixture, live: Option<&LiveLink>) {
    let text = mixture.text();
    match live {
        Some(live) => live.events.publish(Event::NotTracked { reason: Reason::Mixed.word().into(), text: text.to_owned() }),
        None => tracing::warn!("{text}"),
    }
}

/// Reports that the shutter is known, or that frames contradict it: as an event of a live camera,
/// else to the log.
fn tell_shutter(news: &ShutterNews, live: Option<&LiveLink>) {
    match (live, news.is_warning()) {
        (Some(live), true) => live.events.publish(Event::ShutterDiffers { text: news.text() }),
        (Some(live), false) => live.events.publish(Event::ShutterLearnt { text: news.text() }),
        (None, true) => tracing::warn!("{}", news.text()),
        (None, false) => tracing::info!("{}", news.text()),
    }
}

fn count(live: &LiveLink, row: &ClipEntry, sample: &PoseSample) {
    match row.content {
        EntryContent::Frame(_) if sample.reason == Some(Reason::Repeated) => live.statistics.undecodable.add(1),
        EntryContent::Frame(_) => {}
        EntryContent::Undecodable(_) => live.statistics.undecodable.add(1),
        EntryContent::Skipped(_) => live.statistics.skipped.add(1),
    }
    live.statistics.sample(sample);
}

fn deliver(subscribers: &mut Vec<Subscriber>, sample: &PoseSample) {
    subscribers.retain(|s| match s {
        Subscriber::Blocking(sender) => sender.send(sample.clone()).is_ok(),
        Subscriber::Latest(sender) => {
            sender.send(sample.clone());
            true
        }
    });
}

#[cfg(test)]
mod tests {
    use image::GrayImage;

    use super::*;
    use crate::camera::CameraModel;
    use crate::geometry::Pose;
    use crate::track::{BodySpec, ReferenceKind, SurfaceShape, SurfaceSpec};
    use crate::tracker::TrackerSetup;

    /// A source that never ends by itself.
    struct Endless {
        /// Counted while the source lives.
        _probe: Arc<()>,
    }

    impl FrameSource for Endless {
        fn next_entry(&mut self) -> Option<ClipEntry> {
            std::thread::sleep(std::time::Duration::from_millis(1));
            let content = EntryContent::Undecodable("as told".to_owned());
            Some(ClipEntry::new(0, Default::default(), content))
        }

        fn size(&self) -> (u32, u32) {
            (64, 48)
        }

        fn rows(&self) -> Option<u64> {
            None
        }
    }

    fn tracker() -> Tracker {
        let artwork = GrayImage::from_fn(64, 48, |x, y| image::Luma([if (x / 8 + y / 8) % 2 == 0 { 20 } else { 220 }]));
        let name = "plain".to_owned();
        let surface = SurfaceSpec {
            name: name.clone(),
            artwork,
            size_m: [4.0, 3.0],
            pose: Pose::identity(),
            kind: ReferenceKind::Artwork,
            shape: SurfaceShape::Flat,
            doubt: crate::track::SurfaceDoubt::default(),
            transfer: crate::light::Transfer::default(),
        };
        let camera = CameraModel::pinhole(64, 48, 60.0, 60.0, 31.5, 23.5).unwrap();
        Tracker::new(TrackerSetup::new(camera, BodySpec::new(name, vec![surface]))).expect("a setup that fits")
    }

    #[test]
    fn a_failed_thread_spawn_leaves_no_thread_running() {
        for (refused, delivery) in
            [(0, Delivery::DropOldest), (1, Delivery::DropOldest), (2, Delivery::DropOldest), (1, Delivery::Blocking)]
        {
            let probe = Arc::new(());
            let mut daemon = Daemon::new(Box::new(Endless { _probe: probe.clone() }), tracker(), delivery);
            let samples = daemon.subscribe();
            let mut asked = 0;
            let started = daemon.start_with(|_, run| {
                asked += 1;
                if asked > refused { Err(std::io::ErrorKind::WouldBlock.into()) } else { std::thread::Builder::new().spawn(run) }
            });
            let error = started.err().expect("one stage has no thread");
            assert!(error.to_string().contains("raise the limit of processes"), "{error}");
            assert_eq!(Arc::strong_count(&probe), 1, "the source is still read after {refused} threads");
            assert!(samples.iter().next().is_none());
        }
    }

    #[test]
    fn frames_waiting_at_a_stop_are_dropped_if_allowed() {
        for (stopped, is_over, may_drop, looked_at) in
            [(false, false, true, 3), (true, false, false, 3), (true, true, true, 3), (true, false, true, 0)]
        {
            let (to_matcher, rows) = bounded(3);
            let (to_pose, seen) = bounded(3);
            let mut source = Endless { _probe: Arc::default() };
            (0..3).for_each(|_| to_matcher.send(source.next_entry().expect("it is endless")).expect("there is room"));
            drop(to_matcher);
            let unseen = Unseen { count: Arc::default(), live: None };
            let end = may_drop.then(|| End {
                stop: Arc::new(AtomicBool::new(stopped)),
                is_over: Arc::new(AtomicBool::new(is_over)),
                unseen: unseen.clone(),
            });
            match_rows(tracker().matcher, None, end.as_ref(), &rows, &to_pose);
            assert_eq!((seen.len(), unseen.count.load(Ordering::Relaxed)), (looked_at, 3 - looked_at as u64));
        }
    }
}
