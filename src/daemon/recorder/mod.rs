//! Records on its own thread what is tracked: the pictures as received, their stamps, the records,
//! the events.
//!
//! A recording is a clip that replays to the same records byte for byte. It is a valid clip at
//! every moment: a picture is written before its line. A disk that is full or too slow ends the
//! recording and nothing else. The ring keeps the last seconds in the same form, so that a user can
//! save what just happened.

mod about;
mod clip_folder;
mod disk;
mod ring;

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, Sender, TrySendError, bounded, select};

pub use about::AboutClip;
pub use clip_folder::{new_clip_folder, parts, taken_by_earlier};
pub use disk::{Disk, RealDisk};

use super::live::{Event, LiveLink, StampedEvent};
use super::unwritten;
use crate::capture::timestamping::monotonic_now;
use crate::capture::{ClipEntry, EntryContent, Received};
use crate::record::PoseSample;
use crate::telemetry::RecorderState;
use crate::track::LearntCamera;
use clip_folder::{ClipFolder, Picture, Recorded};
use ring::Ring;

/// What to record.
#[derive(Debug, Clone)]
pub struct RecorderPlan {
    /// Everything, to this new folder.
    pub clip: Option<PathBuf>,
    /// The last seconds, in this folder, which also gets saved rings.
    pub ring: Option<(PathBuf, f64)>,
    /// The content of clip.toml.
    pub about: AboutClip,
}

/// Maximum rows waiting for the disk, and their bytes; beyond them the disk is too slow. Chosen: 17
/// seconds at 30 per second, and what a small machine can spare. Raised, longer stalls of a disk
/// lose nothing and take more memory.
const MAX_WAITING: usize = 512;
const MAX_WAITING_BYTES: usize = 256 << 20;
/// Maximum events in a saved ring, the newest. A round figure far above what happens in a ring's
/// time. Raised, only memory.
const RECENT_EVENTS: usize = 4096;

enum Job {
    Entry(Recorded),
    Save,
    /// Start a clip in this new folder.
    Begin(PathBuf),
    /// End the clip.
    End,
}

/// A running recorder.
pub struct Recorder {
    jobs: Sender<Job>,
    queue: Arc<Queue>,
    thread: JoinHandle<Option<String>>,
}

/// What is waiting for the disk.
#[derive(Default)]
struct Queue {
    bytes: AtomicUsize,
    overflown: AtomicBool,
    /// Whether rows are wanted at all.
    wanted: AtomicBool,
}

impl Recorder {
    /// Creates the clip and starts; the disk is a parameter so that a full one can be tested.
    ///
    /// # Errors
    /// When the clip or the ring cannot be created, or the system provides no thread.
    pub fn start(plan: RecorderPlan, link: &LiveLink, mut disk: Box<dyn Disk>) -> std::io::Result<Self> {
        let clip = plan.clip.as_deref().map(|folder| begin_clip(folder, &plan.about, &mut *disk)).transpose()?;
        let ring = plan.ring.as_ref().map(|(folder, seconds)| Ring::create(folder, *seconds, &mut *disk)).transpose()?;
        link.statistics.set_recorder(if clip.is_some() || ring.is_some() { RecorderState::Recording } else { RecorderState::Off });
        let events = link.events.listen();
        if let Some(folder) = &plan.clip {
            link.events.publish(Event::RecorderStarted { clip: folder.display().to_string() });
        }
        let (jobs, to_do) = bounded(MAX_WAITING);
        let queue = Arc::new(Queue::default());
        queue.wanted.store(clip.is_some() || ring.is_some(), Ordering::Relaxed);
        let work = Work {
            plan,
            clip,
            ring,
            disk,
            link: link.clone(),
            queue: queue.clone(),
            recent: VecDeque::new(),
            synced: Instant::now(),
            stopped: None,
        };
        let thread = std::thread::Builder::new().name("recorder".to_owned()).spawn(move || work.run(&to_do, &events))?;
        Ok(Self { jobs, queue, thread })
    }

    /// Returns what the daemon's pose stage calls with every row; it never waits.
    pub fn observer(&self) -> impl FnMut(&ClipEntry, &PoseSample) + Send + 'static {
        let (jobs, queue) = (self.jobs.clone(), self.queue.clone());
        move |row, sample| {
            if queue.overflown.load(Ordering::Relaxed) || !queue.wanted.load(Ordering::Relaxed) {
                return;
            }
            let recorded = recorded(row, sample);
            let bytes = queue.bytes.fetch_add(recorded.bytes(), Ordering::Relaxed);
            if bytes > MAX_WAITING_BYTES || matches!(jobs.try_send(Job::Entry(recorded)), Err(TrySendError::Full(_))) {
                queue.overflown.store(true, Ordering::Relaxed);
            }
        }
    }

    /// Returns a function that saves the ring, for other threads (an HTTP call).
    pub fn saver(&self) -> impl Fn() + Send + Sync + 'static {
        let jobs = self.jobs.clone();
        move || {
            let _ = jobs.try_send(Job::Save);
        }
    }

    /// Starts a clip in a new folder, in addition to the ring. If one is being recorded already,
    /// nothing happens.
    pub fn begin(&self, folder: PathBuf) {
        if self.jobs.try_send(Job::Begin(folder)).is_ok() {
            self.queue.wanted.store(true, Ordering::Relaxed);
        }
    }

    /// Ends the clip.
    pub fn end(&self) {
        let _ = self.jobs.try_send(Job::End);
    }

    /// Writes what is waiting, ends, and returns why the recording ended early, if it did. The
    /// daemon and its observer must have ended before.
    pub fn finish(self) -> Option<String> {
        let Self { jobs, queue: _, thread } = self;
        drop(jobs);
        thread.join().unwrap_or_else(|_| Some("the recorder failed; please report it".to_owned()))
    }
}

/// Whether recordings in this folder may be written, as far as the system tells before writing.
///
/// # Errors
/// The system's error for the folder, or for its nearest existing parent.
pub fn may_record(folder: &Path) -> std::io::Result<()> {
    let mut file = folder.join("recording");
    while let Some(above) = file.parent().filter(|above| !above.as_os_str().is_empty() && above.symlink_metadata().is_err()) {
        file = above.to_owned();
    }
    crate::safe_file::may_write(&file)
}

fn begin_clip(folder: &Path, about: &AboutClip, disk: &mut dyn Disk) -> std::io::Result<ClipFolder> {
    let begun = ClipFolder::create(folder, disk).and_then(|clip| about.write(folder, &LearntCamera::default(), disk).map(|()| clip));
    if begun.is_err() {
        disk.let_go(folder);
    }
    begun
}

/// Returns what is stored of a row.
fn recorded(row: &ClipEntry, sample: &PoseSample) -> Recorded {
    let picture = match (&row.received, &row.content) {
        (Some(Received::Jpeg(bytes)), _) => Picture::Jpeg(bytes.clone()),
        (Some(Received::Damaged), _) => Picture::Nothing,
        (_, EntryContent::Frame(frame)) => Picture::Grey(frame.image.clone()),
        (_, EntryContent::Undecodable(_) | EntryContent::Skipped(_)) => Picture::Nothing,
    };
    Recorded { timestamp: row.timestamp, picture, line: sample.to_json_line(), learnt: sample.learnt, timecode: None }
}

/// The recorder's thread.
struct Work {
    plan: RecorderPlan,
    clip: Option<ClipFolder>,
    ring: Option<Ring>,
    disk: Box<dyn Disk>,
    link: LiveLink,
    queue: Arc<Queue>,
    recent: VecDeque<StampedEvent>,
    synced: Instant,
    /// Why it gave up.
    stopped: Option<String>,
}

impl Work {
    /// Runs until the jobs' channel closes; returns why it gave up, if it did.
    fn run(mut self, jobs: &Receiver<Job>, events: &Receiver<StampedEvent>) -> Option<String> {
        loop {
            select! {
                recv(jobs) -> job => match job {
                    Ok(Job::Entry(row)) => self.row(&self.with_timecode(row)),
                    Ok(Job::Save) => self.save(),
                    Ok(Job::Begin(folder)) => self.begin(folder),
                    Ok(Job::End) => self.end(),
                    Err(_) => break,
                },
                recv(events) -> event => match event {
                    Ok(event) => self.event(event),
                    // The daemon's event log closes before the recorder ends: rows may still come.
                    Err(_) => std::thread::sleep(Duration::from_millis(1)),
                },
            }
            if self.synced.elapsed() > Duration::from_secs(1) {
                self.synced = Instant::now();
                self.disk.sync();
            }
            if self.queue.overflown.load(Ordering::Relaxed) {
                self.stop("the disk cannot keep up; record to a faster one, or at a lower rate");
            }
        }
        events.try_iter().for_each(|event| self.event(event));
        self.finish_clip();
        if self.link.statistics.recorder() == RecorderState::Recording {
            self.link.statistics.set_recorder(RecorderState::Off);
        }
        self.stopped
    }

    /// Adds the timecode of a row's stamp: by now, more of it has come than when the row did.
    fn with_timecode(&self, row: Recorded) -> Recorded {
        let timecode = self.link.statistics.timecode().and_then(|source| source.at(row.timestamp));
        Recorded { timecode, ..row }
    }

    fn row(&mut self, row: &Recorded) {
        self.queue.bytes.fetch_sub(row.bytes(), Ordering::Relaxed);
        // What was known before the first row is stated in that row's sample.
        let is_first = self.clip.as_ref().filter(|clip| clip.rows() == 0 && !row.learnt.is_empty()).map(|clip| clip.folder.clone());
        let begun = is_first.map_or(Ok(()), |folder| self.plan.about.write_about(&folder, &row.learnt, &mut *self.disk));
        let to_clip = begun.and(self.clip.as_mut().map_or(Ok(()), |clip| clip.push(row, &mut *self.disk)));
        let to_ring = self.ring.as_mut().map_or(Ok(()), |ring| ring.push(row, &mut *self.disk));
        match to_clip.and(to_ring) {
            Ok(()) if self.clip.is_some() || self.ring.is_some() => self.link.statistics.recorded.add(1),
            Ok(()) => {}
            Err(e) => self.stop(&format!("{}, then start again or send SIGHUP", unwritten(&e))),
        }
    }

    fn event(&mut self, event: StampedEvent) {
        if let Some(clip) = &mut self.clip
            && let Err(e) = clip.event(&event, &mut *self.disk)
        {
            self.stop(&format!("{}, then start again or send SIGHUP", unwritten(&e)));
        }
        if self.ring.is_some() {
            self.recent.truncate(RECENT_EVENTS);
            self.recent.push_front(event);
        }
    }

    fn begin(&mut self, folder: PathBuf) {
        if self.clip.is_some() {
            return;
        }
        match begin_clip(&folder, &self.plan.about, &mut *self.disk) {
            Ok(clip) => {
                self.clip = Some(clip);
                self.link.statistics.set_recorder(RecorderState::Recording);
                self.link.events.publish(Event::RecorderStarted { clip: folder.display().to_string() });
            }
            Err(e) => {
                self.link.statistics.set_recorder(RecorderState::Stopped);
                self.link.events.publish(Event::RecorderStopped { reason: format!("{}, then start again", unwritten(&e)) });
            }
        }
    }

    fn end(&mut self) {
        self.finish_clip();
        let is_wanted = self.ring.is_some();
        self.queue.wanted.store(is_wanted, Ordering::Relaxed);
        if !is_wanted {
            self.link.statistics.set_recorder(RecorderState::Off);
        }
    }

    /// Writes a recording's last line, so that readers know that nothing is missing, and closes its
    /// files.
    fn finish_clip(&mut self) {
        let Some(clip) = &self.clip else { return };
        let event = Event::RecorderFinished { clip: clip.folder.display().to_string(), frames: clip.rows() };
        self.link.events.publish(event.clone());
        self.event(StampedEvent { timestamp: monotonic_now(), event });
        if let Some(clip) = self.clip.take() {
            self.close(&clip.folder);
        }
    }

    /// Syncs a finished clip's files to the medium and closes them.
    fn close(&mut self, clip: &Path) {
        self.disk.sync();
        self.disk.let_go(clip);
    }

    /// Gives up; what is written stays a valid clip.
    fn stop(&mut self, reason: &str) {
        let (clip, ring) = (self.clip.take(), self.ring.take());
        if clip.is_none() && ring.is_none() {
            return;
        }
        for folder in clip.into_iter().map(|clip| clip.folder).chain(ring.map(Ring::into_folder)) {
            self.close(&folder);
        }
        self.stopped = Some(reason.to_owned());
        self.link.statistics.set_recorder(RecorderState::Stopped);
        self.link.events.publish(Event::RecorderStopped { reason: reason.to_owned() });
    }

    fn save(&mut self) {
        let (Some(ring), Some((folder, _))) = (&mut self.ring, &self.plan.ring) else { return };
        if ring.is_empty() {
            tracing::warn!("the ring has nothing to save yet");
            return;
        }
        let clip = new_clip_folder(folder);
        let saved = ring.save(&clip, &mut *self.disk).and_then(|(first, learnt)| {
            self.plan.about.write(&clip, &learnt, &mut *self.disk)?;
            let mut saved = ClipFolder::of(&clip);
            let since = self.recent.iter().rev().filter(|e| e.timestamp >= first);
            since.into_iter().try_for_each(|event| saved.event(event, &mut *self.disk))
        });
        self.close(&clip);
        match saved {
            Ok(()) => self.link.events.publish(Event::RingSaved { clip: clip.display().to_string() }),
            Err(e) => self.stop(&format!("the ring cannot be saved: {}", unwritten(&e))),
        }
    }
}

#[cfg(test)]
mod tests;
