//! The walk read from the clips, stored next to the output folder until the survey or the map is
//! done, so that an interrupted one can continue.
//!
//! The file belongs to one command: its clips, its config and this version of the program. If any
//! of them differs, or the file is damaged, it is ignored.

use std::fs::{self, Metadata};
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::safe_file;
use crate::survey::walked::walk::WalkRecord;
use crate::tracker::TrackerSetup;

/// Maximum file size read, bytes: 160 keyframes of 2000 features take a seventh of it. Raised, a
/// foreign file takes more memory; lowered, a rich stage's record is not read.
const MAX_BYTES: u64 = 128 << 20;

/// A survey's walk file, and the command it belongs to.
pub(super) struct WalkFile {
    file: PathBuf,
    of: String,
}

#[derive(Serialize, Deserialize)]
struct Contents {
    /// The command it belongs to, from [`fingerprint`].
    of: String,
    walk: WalkRecord,
}

impl WalkFile {
    /// Returns the file next to this command's output folder.
    pub(super) fn new(folder: &Path, clips: &[PathBuf], setup: &TrackerSetup, options: &str) -> Self {
        let name = folder.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        Self { file: folder.with_file_name(format!(".{name}.walk")), of: fingerprint(clips, setup, options) }
    }

    /// Returns the walk left by an interrupted run.
    pub(super) fn read(&self) -> Option<WalkRecord> {
        let bytes = safe_file::read(&self.file, MAX_BYTES).ok()?;
        let contents: Contents = ciborium::from_reader(bytes.as_slice()).ok()?;
        (contents.of == self.of).then_some(contents.walk)
    }

    /// Stores a walk. If that fails the work continues: only an interruption would cost more.
    pub(super) fn keep(&self, walk: WalkRecord) {
        let mut bytes = Vec::new();
        let written = ciborium::into_writer(&Contents { of: self.of.clone(), walk }, &mut bytes)
            .map_err(std::io::Error::other)
            .and_then(|()| safe_file::write_whole(&self.file, &bytes));
        if let Err(e) = written {
            tracing::warn!("{}: {e}; if the work is interrupted, it must start again", self.file.display());
        }
    }

    /// Whether there is a file to continue from.
    pub(super) fn is_there(&self) -> bool {
        self.file.exists()
    }

    /// Removes the file: the work is done.
    pub(super) fn remove(&self) {
        // A file that cannot be removed does no harm: only the same command accepts it.
        let _ = fs::remove_file(&self.file);
    }
}

/// Hashes what a walk depends on: the clips by name, length and time, the setup by its content.
fn fingerprint(clips: &[PathBuf], setup: &TrackerSetup, options: &str) -> String {
    let mut hash = Sha256::new();
    let TrackerSetup { camera, shutter, mask, stage, settings, .. } = setup;
    let mut add = |text: String| hash.update(text + "\0");
    add(format!("{} {options} {camera:?} {shutter:?} {settings:?}", env!("CARGO_PKG_VERSION")));
    for clip in clips {
        add(format!("{clip:?}"));
        for (path, metadata) in entries(clip) {
            let time = metadata.modified().ok().and_then(|time| time.duration_since(UNIX_EPOCH).ok());
            add(format!("{path:?} {} {time:?}", metadata.len()));
        }
    }
    for surface in &stage.surfaces {
        add(format!(
            "{} {:?} {:?} {:?} {:?} {:?}",
            surface.name,
            surface.size_m,
            surface.pose,
            surface.kind,
            surface.shape,
            surface.artwork.dimensions()
        ));
    }
    for picture in stage.surfaces.iter().map(|surface| &surface.artwork).chain(mask) {
        hash.update(picture.as_raw());
    }
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Returns a clip's files: itself, or its folders' content, sorted.
fn entries(clip: &Path) -> Vec<(PathBuf, Metadata)> {
    let Ok(metadata) = fs::metadata(clip) else { return Vec::new() };
    if !metadata.is_dir() {
        return vec![(clip.to_owned(), metadata)];
    }
    let mut inside: Vec<PathBuf> = fs::read_dir(clip).into_iter().flatten().filter_map(|entry| Some(entry.ok()?.path())).collect();
    inside.sort();
    inside.iter().flat_map(|path| entries(path)).collect()
}
