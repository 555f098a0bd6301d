//! The last seconds on disk, as a series of short clips whose oldest is removed.
//!
//! Each is a valid clip by itself, so that a killed daemon leaves them readable. Saving joins them
//! into one clip.

use std::collections::VecDeque;
use std::io;
use std::path::{Path, PathBuf};

use super::clip_folder::{ClipFolder, INDEX_HEAD, Recorded};
use super::disk::Disk;
use crate::frame::Timestamp;
use crate::timecode::side_file;
use crate::track::LearntCamera;

struct Segment {
    clip: ClipFolder,
    first: Timestamp,
    learnt: LearntCamera,
}

/// A ring of short clips.
pub(super) struct Ring {
    folder: PathBuf,
    length_ns: i64,
    segments: VecDeque<Segment>,
    made: u64,
}

/// Segments per requested duration. The ring is longer than that by up to one segment. Raised, it
/// is cut more closely and more folders are created and removed.
const SEGMENTS: i64 = 8;
/// The marker file of this program's rings: only marked folders are moved or removed.
const MARK: &str = ".stagepose-ring";

/// Whether a folder may be moved and removed: it has the marker, or is empty. A link is not a
/// folder.
fn is_own(folder: &Path) -> io::Result<bool> {
    if !folder.symlink_metadata()?.is_dir() {
        return Ok(false);
    }
    Ok(folder.join(MARK).symlink_metadata().is_ok() || std::fs::read_dir(folder)?.next().is_none())
}

/// Refuses an existing path that is not a ring of this program.
fn refuse_foreign(folder: &Path) -> io::Result<()> {
    match is_own(folder) {
        Ok(true) => Ok(()),
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(e) => Err(e),
        Ok(false) => Err(io::Error::other(format!(
            "{} exists and is not a ring of stagepose, so it is left alone; move it away, or give another folder in [recorder]",
            folder.display()
        ))),
    }
}

impl Ring {
    /// Starts a ring in `folder`/ring; what a killed daemon left there is kept as
    /// `folder`/ring-before, once.
    pub fn create(folder: &Path, seconds: f64, disk: &mut dyn Disk) -> io::Result<Self> {
        let (ring, before) = (folder.join("ring"), folder.join("ring-before"));
        [&ring, &before].into_iter().try_for_each(|folder| refuse_foreign(folder))?;
        if ring.exists() {
            let _ = std::fs::remove_dir_all(&before);
            std::fs::rename(&ring, &before)?;
        }
        disk.make_folder(&ring)?;
        disk.write_file(&ring.join(MARK), b"")?;
        Ok(Self { folder: ring, length_ns: (seconds * 1e9) as i64, segments: VecDeque::new(), made: 0 })
    }

    /// Writes a row to the newest segment and removes segments that are too old.
    pub fn push(&mut self, row: &Recorded, disk: &mut dyn Disk) -> io::Result<()> {
        let age = |segment: &Segment| row.timestamp.ns_since(segment.first);
        if self.segments.back().is_none_or(|s| age(s) >= self.length_ns / SEGMENTS) {
            let clip = ClipFolder::create(&self.folder.join(format!("{:08}", self.made)), disk)?;
            self.made += 1;
            self.segments.push_back(Segment { clip, first: row.timestamp, learnt: row.learnt });
        }
        // The oldest may go when the later ones cover the duration.
        while self.segments.get(1).is_some_and(|second| age(second) >= self.length_ns) {
            if let Some(oldest) = self.segments.pop_front() {
                disk.let_go(&oldest.clip.folder);
                std::fs::remove_dir_all(&oldest.clip.folder)?;
            }
        }
        self.segments.back_mut().map_or(Ok(()), |newest| newest.clip.push(row, disk))
    }

    /// Ends the ring and returns its folder.
    pub fn into_folder(self) -> PathBuf {
        self.folder
    }

    /// Whether there is nothing to save.
    pub fn is_empty(&self) -> bool {
        self.segments.is_empty()
    }

    /// Moves the segments into a clip and starts anew; returns the first row's stamp, and what was
    /// known of the camera before it.
    pub fn save(&mut self, clip: &Path, disk: &mut dyn Disk) -> io::Result<(Timestamp, LearntCamera)> {
        disk.make_folder(&clip.join("frames"))?;
        let first = self.segments.front().map(|s| (s.first, s.learnt)).unwrap_or_default();
        let (mut index, mut poses, mut timecode) = (INDEX_HEAD.to_vec(), Vec::new(), Vec::new());
        for segment in std::mem::take(&mut self.segments) {
            let from = &segment.clip.folder;
            disk.let_go(from);
            let name = from.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
            std::fs::rename(from.join("frames"), clip.join("frames").join(&name))?;
            let lines = std::fs::read_to_string(from.join("timestamps.csv"))?;
            for (stamp, file) in lines.lines().skip(1).filter_map(|line| line.split_once(',')) {
                index.extend_from_slice(format!("{stamp},{name}/{file}\n").as_bytes());
            }
            poses.extend(std::fs::read(from.join("poses.jsonl"))?);
            match std::fs::read(from.join(side_file::NAME)) {
                Ok(lines) => timecode.extend(lines),
                Err(e) if e.kind() == io::ErrorKind::NotFound => {}
                Err(e) => return Err(e),
            }
            std::fs::remove_dir_all(from)?;
        }
        disk.write_file(&clip.join("timestamps.csv"), &index)?;
        disk.write_file(&clip.join("poses.jsonl"), &poses)?;
        if !timecode.is_empty() {
            disk.write_file(&clip.join(side_file::NAME), &timecode)?;
        }
        Ok(first)
    }
}
