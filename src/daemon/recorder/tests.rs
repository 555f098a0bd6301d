//! Tests recordings: that they replay, on disks that fill up, in processes that are killed, and
//! with rings that wrap.

use std::io;

use image::GrayImage;

use super::*;
use crate::capture::camera::{CameraMode, PixelLayout};
use crate::capture::{ClipOptions, open_clip};
use crate::frame::{Frame, Timestamp};
use crate::timecode::side_file::TimecodeRows;
use crate::timecode::{Timecode, TimecodeMark, TimecodeRate, TimecodeSource, TimecodeTrack, TrackSettings};

/// A disk with room for a number of bytes.
struct SmallDisk {
    disk: RealDisk,
    left: usize,
}

impl SmallDisk {
    fn take(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.left = self.left.checked_sub(bytes.len()).ok_or(io::Error::from(io::ErrorKind::StorageFull))?;
        Ok(())
    }
}

impl Disk for SmallDisk {
    fn make_folder(&mut self, folder: &Path) -> io::Result<()> {
        self.disk.make_folder(folder)
    }
    fn write_file(&mut self, file: &Path, bytes: &[u8]) -> io::Result<()> {
        self.take(bytes)?;
        self.disk.write_file(file, bytes)
    }
    fn append(&mut self, file: &Path, bytes: &[u8]) -> io::Result<()> {
        self.take(bytes)?;
        self.disk.append(file, bytes)
    }
    fn sync(&mut self) {}
    fn let_go(&mut self, folder: &Path) {
        self.disk.let_go(folder);
    }
}

fn about() -> AboutClip {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/dolly/stage.toml");
    let config = crate::config::Settings::load(&file).unwrap().source;
    let controls = vec![("gain".to_owned(), 3)];
    let camera =
        CameraMode { name: "Cam".into(), size: (20, 10), layout: PixelLayout::Yuyv, fps: 30.0, exposure_s: None, controls, notes: vec![] };
    AboutClip { camera, config, exposure_s: 0.0 }
}

fn row(sequence: u64) -> (ClipEntry, PoseSample) {
    let timestamp = Timestamp::from_ns(sequence as i64 * 100_000_000);
    let image = GrayImage::from_pixel(20, 10, image::Luma([sequence as u8]));
    let content = match sequence % 7 {
        3 => EntryContent::Undecodable("short".into()),
        _ => EntryContent::Frame(Frame { image, timestamp, sequence }),
    };
    let mut sample = PoseSample::stale(sequence, timestamp, 0.0);
    sample.state = crate::record::State::Searching;
    (ClipEntry { sequence, timestamp, content, decode: Duration::ZERO, repeats: false, received: Some(Received::Raw) }, sample)
}

fn record(plan: RecorderPlan, disk: Box<dyn Disk>, rows: std::ops::Range<u64>) -> LiveLink {
    let link = LiveLink::default();
    let recorder = Recorder::start(plan, &link, disk).unwrap();
    let mut observe = recorder.observer();
    for n in rows {
        let (row, sample) = row(n);
        observe(&row, &sample);
    }
    drop(observe);
    recorder.finish();
    link
}

fn stamps_of(clip: &Path) -> Vec<i64> {
    let mut source = open_clip(clip, ClipOptions::default()).unwrap();
    std::iter::from_fn(|| source.next_entry()).map(|row| row.timestamp.ns()).collect()
}

#[test]
fn a_recording_replays_row_by_row() {
    let folder = tempfile::tempdir().unwrap();
    let clip = folder.path().join("take");
    let link = record(RecorderPlan { clip: Some(clip.clone()), ring: None, about: about() }, Box::<RealDisk>::default(), 0..20);
    assert_eq!((link.statistics.recorded.get(), link.statistics.recorder()), (20, RecorderState::Off));
    let mut source = open_clip(&clip, ClipOptions::default()).unwrap();
    for n in 0..20 {
        let (was, is) = (row(n).0, source.next_entry().unwrap());
        assert_eq!((was.sequence, was.timestamp), (is.sequence, is.timestamp));
        match (was.content, is.content) {
            (EntryContent::Frame(was), EntryContent::Frame(is)) => assert_eq!(was, is),
            (EntryContent::Undecodable(_), EntryContent::Undecodable(_)) => {}
            other => panic!("{other:?}"),
        }
    }
    assert!(source.next_entry().is_none());
    let text = |name: &str| std::fs::read_to_string(clip.join(name)).unwrap();
    assert_eq!(text("poses.jsonl").lines().count(), 20);
    assert!(text("clip.toml").contains("gain = 3") && text("clip.toml").contains("utc_ns"), "{}", text("clip.toml"));
    let events = text("events.jsonl");
    assert!(events.contains("recorder_started"), "{events}");
    assert!(events.lines().last().unwrap().contains("\"event\":\"recorder_finished\"") && events.ends_with("\"frames\":20}\n"), "{events}");
    assert!(crate::config::Settings::load(&clip.join("config/stage.toml")).is_ok());
    // An existing clip is not overwritten.
    let again = RecorderPlan { clip: Some(clip), ring: None, about: about() };
    assert!(Recorder::start(again, &LiveLink::default(), Box::<RealDisk>::default()).is_err());
}

#[test]
fn a_full_disk_ends_the_recording_with_a_good_clip() {
    let folder = tempfile::tempdir().unwrap();
    let config: usize = about().config.copy(None).unwrap().iter().map(|(_, bytes)| bytes.len()).sum();
    for left in [900, 1500, 1777, 2001, 3000].map(|left| config + left) {
        let clip = folder.path().join(left.to_string());
        let plan = RecorderPlan { clip: Some(clip.clone()), ring: None, about: about() };
        let link = record(plan, Box::new(SmallDisk { disk: RealDisk::default(), left }), 0..100);
        assert_eq!(link.statistics.recorder(), RecorderState::Stopped);
        let recorded = link.statistics.recorded.get();
        let stamps = stamps_of(&clip);
        assert!(recorded < 100 && stamps.len() as u64 >= recorded && stamps.len() as u64 <= recorded + 1, "{left}: {recorded} {stamps:?}");
    }
}

#[test]
fn a_recording_cut_off_by_a_kill_still_replays() {
    let folder = tempfile::tempdir().unwrap();
    let clip = folder.path().join("take");
    let (link, mut disk) = (LiveLink::default(), RealDisk::default());
    let mut folder = begin_clip(&clip, &about(), &mut disk).unwrap();
    for n in 0..5 {
        let (row, sample) = row(n);
        folder.push(&recorded(&row, &sample), &mut disk).unwrap();
    }
    // Killed between a picture and its line, and in the middle of a line.
    std::fs::write(clip.join("frames/0000/00000005.pgm"), b"P5 20").unwrap();
    disk.append(&clip.join("timestamps.csv"), b"500000000,0000/000").unwrap();
    std::mem::forget((link, disk));
    assert_eq!(stamps_of(&clip), [0, 100_000_000, 200_000_000, 300_000_000, 400_000_000, 500_000_000]);
}

#[test]
fn the_ring_keeps_the_last_seconds_and_saves_them_as_a_clip() {
    let folder = tempfile::tempdir().unwrap();
    let link = LiveLink::default();
    let plan = RecorderPlan { clip: None, ring: Some((folder.path().to_owned(), 2.0)), about: about() };
    let recorder = Recorder::start(plan.clone(), &link, Box::<RealDisk>::default()).unwrap();
    let events = link.events.listen();
    let mut observe = recorder.observer();
    for n in 0..100 {
        let (row, sample) = row(n);
        observe(&row, &sample);
    }
    recorder.saver()();
    let saved = events.iter().find_map(|e| if let Event::RingSaved { clip } = e.event { Some(clip) } else { None }).unwrap();
    let stamps = stamps_of(Path::new(&saved));
    assert_eq!(stamps.last(), Some(&9_900_000_000));
    let span = stamps.last().unwrap() - stamps[0];
    assert!((2_000_000_000..=2_400_000_000).contains(&span), "{span}");
    assert!(stamps.windows(2).all(|w| w[1] == w[0] + 100_000_000));
    assert_eq!(std::fs::read_to_string(Path::new(&saved).join("poses.jsonl")).unwrap().lines().count(), stamps.len());
    // What a killed daemon left of the next ring still exists after the next start.
    let (row, sample) = row(100);
    observe(&row, &sample);
    drop(observe);
    recorder.finish();
    Recorder::start(plan, &LiveLink::default(), Box::<RealDisk>::default()).unwrap().finish();
    assert!(folder.path().join("ring-before/00000009/timestamps.csv").exists() || folder.path().join("ring-before").exists());
}

#[test]
fn a_saved_ring_contains_the_config_that_was_running() {
    let (home, folder) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/dolly");
    for name in ["backdrop.png", "flat.png", "camera.toml", "stage.toml"] {
        std::fs::copy(fixture.join(name), home.path().join(name)).unwrap();
    }
    let file = home.path().join("stage.toml");
    let text = std::fs::read_to_string(&file).unwrap();
    std::fs::write(&file, text.lines().filter(|l| !l.starts_with("exposure_s")).collect::<Vec<_>>().join("\n")).unwrap();
    let was = crate::config::Settings::load(&file).unwrap();
    let about = AboutClip { config: was.source.clone(), exposure_s: 0.0083, ..about() };
    let plan = RecorderPlan { clip: None, ring: Some((folder.path().to_owned(), 2.0)), about };
    let link = LiveLink::default();
    let recorder = Recorder::start(plan, &link, Box::<RealDisk>::default()).unwrap();
    let events = link.events.listen();
    let mut observe = recorder.observer();
    for n in 0..10 {
        let (row, sample) = row(n);
        observe(&row, &sample);
    }
    std::fs::write(&file, "[camera]\ncalibration = \"other.toml\"\n").unwrap();
    std::fs::write(home.path().join("backdrop.png"), b"painted over").unwrap();
    recorder.saver()();
    let saved = events.iter().find_map(|e| if let Event::RingSaved { clip } = e.event { Some(clip) } else { None }).unwrap();
    drop(observe);
    recorder.finish();
    let is = crate::config::Settings::load(&Path::new(&saved).join("config/stage.toml")).unwrap();
    assert_eq!((is.camera, is.shutter.exposure_s), (was.camera, Some(0.0083)));
    assert_eq!(is.stage.surfaces[0].artwork, was.stage.surfaces[0].artwork);
}

#[test]
fn a_recording_states_the_camera_state_learnt_before_it() {
    let folder = tempfile::tempdir().unwrap();
    let clip = folder.path().join("take");
    let link = LiveLink::default();
    let plan = RecorderPlan { clip: Some(clip.clone()), ring: Some((folder.path().to_owned(), 2.0)), about: about() };
    let recorder = Recorder::start(plan, &link, Box::<RealDisk>::default()).unwrap();
    let events = link.events.listen();
    let mut observe = recorder.observer();
    for n in 0..100 {
        let (row, mut sample) = row(n);
        sample.learnt.readout = Some(crate::track::LearntTime { seconds: 1e-3 * (1.0 + n as f64), sigma_s: 1e-4 });
        observe(&row, &sample);
    }
    recorder.saver()();
    let saved = events.iter().find_map(|e| if let Event::RingSaved { clip } = e.event { Some(clip) } else { None }).unwrap();
    drop(observe);
    recorder.finish();
    let known = |clip: &Path| crate::daemon::learnt_of_clip(clip).unwrap().readout.unwrap().seconds;
    assert_eq!(known(&clip), 1e-3);
    let first = stamps_of(Path::new(&saved))[0] / 100_000_000;
    assert!(first > 50, "{first}");
    assert_eq!(known(Path::new(&saved)), 1e-3 * (1.0 + first as f64));
}

/// Returns the number of this process's file descriptors that are open in a folder.
fn open_below(folder: &Path) -> usize {
    let links = std::fs::read_dir("/proc/self/fd").unwrap().flatten().filter_map(|fd| std::fs::read_link(fd.path()).ok());
    links.filter(|to| to.starts_with(folder)).count()
}

#[test]
fn saved_rings_and_ended_recordings_leave_no_file_open() {
    // Far above the limit of open files on small systems, if two stayed open each time.
    const TIMES: u64 = 200;
    let folder = tempfile::tempdir().unwrap();
    let link = LiveLink::default();
    let plan = RecorderPlan { clip: None, ring: Some((folder.path().to_owned(), 2.0)), about: about() };
    let recorder = Recorder::start(plan, &link, Box::<RealDisk>::default()).unwrap();
    let events = link.events.listen();
    let mut observe = recorder.observer();
    let mut rows = 0..;
    let mut some_rows = || {
        for n in rows.by_ref().take(3) {
            let (row, sample) = row(n);
            observe(&row, &sample);
        }
    };
    let wait_for = |is_it: fn(&Event) -> bool| assert!(events.iter().any(|e| is_it(&e.event)), "the recorder ended");
    let mut open = Vec::new();
    for k in 0..TIMES {
        some_rows();
        recorder.saver()();
        wait_for(|e| matches!(e, Event::RingSaved { .. }));
        recorder.begin(folder.path().join(format!("take-{k}")));
        some_rows();
        recorder.end();
        wait_for(|e| matches!(e, Event::RecorderFinished { .. }));
        // The next job starts after this one's files are closed.
        recorder.begin(folder.path().join("take-0"));
        wait_for(|e| matches!(e, Event::RecorderStopped { .. }));
        open.push(open_below(folder.path()));
    }
    drop(observe);
    recorder.finish();
    assert!(open.iter().all(|n| *n <= 2), "files of one ring segment at most: {open:?}");
    assert_eq!(open_below(folder.path()), 0);
}

#[test]
fn a_ring_saved_at_a_recordings_start_gets_its_own_folder() {
    let folder = tempfile::tempdir().unwrap();
    let plan = RecorderPlan { clip: None, ring: Some((folder.path().to_owned(), 2.0)), about: about() };
    let link = LiveLink::default();
    let events = link.events.listen();
    let recorder = Recorder::start(plan, &link, Box::new(RealDisk::default())).unwrap();
    let mut observe = recorder.observer();
    for n in 0..5 {
        let (row, sample) = row(n);
        observe(&row, &sample);
        // Named before the ring is saved, started after it.
        let clip = super::new_clip_folder(folder.path());
        recorder.saver()();
        recorder.begin(clip.clone());
        recorder.end();
        let ended = events.iter().find(|e| matches!(e.event, Event::RecorderFinished { .. } | Event::RecorderStopped { .. })).unwrap();
        assert_eq!(ended.event, Event::RecorderFinished { clip: clip.display().to_string(), frames: 0 });
    }
    drop(observe);
    recorder.finish();
}

#[test]
fn a_recording_without_a_folder_reports_name_and_cause() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("recordings");
    std::fs::write(&file, "no folder").unwrap();
    let clip = super::new_clip_folder(&file);
    assert!(clip.starts_with(&file) && clip != file);
    let link = LiveLink::default();
    let plan = RecorderPlan { clip: Some(clip), ring: None, about: about() };
    assert!(Recorder::start(plan, &link, Box::new(RealDisk::default())).is_err());
}

#[test]
fn an_abandoned_recording_closes_its_files() {
    let folder = tempfile::tempdir().unwrap();
    let config: usize = about().config.copy(None).unwrap().iter().map(|(_, bytes)| bytes.len()).sum();
    let plan = RecorderPlan { clip: Some(folder.path().join("take")), ring: Some((folder.path().to_owned(), 2.0)), about: about() };
    let link = LiveLink::default();
    let disk = SmallDisk { disk: RealDisk::default(), left: config + 2000 };
    let recorder = Recorder::start(plan, &link, Box::new(disk)).unwrap();
    let (events, mut observe) = (link.events.listen(), recorder.observer());
    for n in 0..100 {
        let (row, sample) = row(n);
        observe(&row, &sample);
    }
    assert!(events.iter().any(|e| matches!(e.event, Event::RecorderStopped { .. })));
    assert_eq!(open_below(folder.path()), 0);
    drop(observe);
    recorder.finish();
}

#[test]
fn only_a_ring_of_its_own_is_moved_and_removed() {
    let create = |folder: &Path| ring::Ring::create(folder, 2.0, &mut RealDisk::default()).map(drop);
    for name in ["ring", "ring-before"] {
        let folder = tempfile::tempdir().unwrap();
        let foreign = folder.path().join(name);
        std::fs::create_dir(&foreign).unwrap();
        std::fs::write(foreign.join("wedding.jpg"), "kept").unwrap();
        for _ in 0..3 {
            let said = create(folder.path()).unwrap_err().to_string();
            assert!(said.contains(name) && said.contains("not a ring of stagepose") && said.contains("[recorder]"), "{said}");
        }
        assert_eq!(std::fs::read_to_string(foreign.join("wedding.jpg")).unwrap(), "kept");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
    // A link to a foreign folder, and a file, are also left alone.
    let folder = tempfile::tempdir().unwrap();
    std::os::unix::fs::symlink("/tmp", folder.path().join("ring")).unwrap();
    assert!(create(folder.path()).is_err());
    // An empty folder, and what a killed daemon left, are taken over each time.
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("ring")).unwrap();
    for round in 0..3 {
        create(folder.path()).unwrap();
        std::fs::write(folder.path().join("ring/left"), round.to_string()).unwrap();
    }
    assert_eq!(std::fs::read_to_string(folder.path().join("ring-before/left")).unwrap(), "1");
}

#[test]
fn a_recording_has_the_timecode_of_its_rows() {
    let folder = tempfile::tempdir().unwrap();
    let (clip, link) = (folder.path().join("take"), LiveLink::default());
    let settings = TrackSettings { rate: None, free_wheel_s: 1.0 };
    let source = Arc::new(TimecodeSource::live(TimecodeTrack::live(settings)));
    // From row 4 on.
    let begin = row(4).0.timestamp;
    for k in 0..50 {
        let at = begin.after_ns(40_000_000 * k);
        source.with_live(|track| track.push(TimecodeMark { at, code: Timecode::of_number(k, TimecodeRate::Fps25), is_reverse: false }));
    }
    link.statistics.set_timecode(Some(source.clone()));
    let plan = RecorderPlan { clip: Some(clip.clone()), ring: Some((folder.path().to_owned(), 60.0)), about: about() };
    let recorder = Recorder::start(plan, &link, Box::<RealDisk>::default()).unwrap();
    let mut observe = recorder.observer();
    for n in 0..20 {
        let (row, sample) = row(n);
        observe(&row, &sample);
    }
    recorder.saver()();
    drop(observe);
    recorder.finish();
    let saved = std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().path());
    let saved = saved.filter(|path| path.file_name().unwrap().to_string_lossy().starts_with("clip-"));
    let clips: Vec<_> = saved.chain([clip]).collect();
    assert_eq!(clips.len(), 2);
    for clip in clips {
        let rows = TimecodeRows::parse(&std::fs::read(clip.join("timecode.csv")).unwrap()).unwrap();
        for n in 0..20 {
            let stamp = row(n).0.timestamp;
            let code = |stamped: Option<crate::timecode::StampedTimecode>| stamped.map(|stamped| stamped.code);
            assert_eq!(code(rows.at(stamp)), code(source.at(stamp)), "row {n}");
        }
        assert!(rows.at(row(3).0.timestamp).is_none() && rows.at(row(4).0.timestamp).is_some());
    }
}
