//! View banks stored in the cache folder. They only shorten the start, so no failure here is an
//! error.

use std::fs::{self, DirEntry, File};
use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::SystemTime;

use tracing::debug;

use super::own_folders::cache_folder;
use crate::safe_file;
use crate::track::ViewStore;

/// File name extension of a bank, after its key.
const ENDING: &str = ".views";
/// Maximum size of a bank, bytes: a hundred thousand features. The largest bank of a stage with one
/// surface has 0.7 MB. Raised, a foreign file takes more memory.
const MAX_BYTES: u64 = 6 << 20;
/// Maximum number of files; the most recently used ones stay. Chosen: some shows of a dozen
/// pictures each, 10 MB in total. Raised, the folder grows larger; lowered, a start with last
/// week's config takes as long as the first.
const MAX_FILES: usize = 100;
/// Maximum total size, bytes, in case banks are large. Raised, the folder grows larger.
const MAX_BYTES_IN_ALL: u64 = 64 << 20;

/// Returns the store of the service or the user; `None` if neither has a cache folder.
pub fn kept_views() -> Option<Arc<dyn ViewStore>> {
    Some(Arc::new(KeptViews { folder: cache_folder()? }))
}

/// A folder of banks.
#[derive(Debug)]
struct KeptViews {
    folder: PathBuf,
}

impl ViewStore for KeptViews {
    fn load(&self, name: &str) -> Option<Vec<u8>> {
        let path = self.path(name);
        let bytes = safe_file::read(&path, MAX_BYTES).ok()?;
        // A file's modification time records its last use. If it cannot be set, the file is only
        // removed a little early.
        let _ = File::options().append(true).open(&path).and_then(|file| file.set_modified(SystemTime::now()));
        Some(bytes)
    }

    fn store(&self, name: &str, bytes: &[u8]) {
        let path = self.path(name);
        match fs::create_dir_all(&self.folder).and_then(|()| safe_file::write_whole(&path, bytes)).and_then(|()| self.thin_out()) {
            Ok(()) => debug!("{}: views are kept for the next start", path.display()),
            Err(e) => debug!("{}: views are not kept ({e}); the next start takes as long as this one", path.display()),
        }
    }
}

impl KeptViews {
    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(format!("{name}{ENDING}"))
    }

    /// Removes the least recently used files if there are too many, including leftovers of a killed
    /// program.
    fn thin_out(&self) -> io::Result<()> {
        let is_own = |entry: &DirEntry| entry.file_name().to_string_lossy().contains(ENDING);
        let entries = fs::read_dir(&self.folder)?.filter_map(Result::ok).filter(is_own);
        let mut files: Vec<(SystemTime, u64, PathBuf)> = entries
            .filter_map(|entry| {
                let metadata = entry.metadata().ok().filter(fs::Metadata::is_file)?;
                Some((metadata.modified().ok()?, metadata.len(), entry.path()))
            })
            .collect();
        files.sort_unstable_by(|a, b| b.cmp(a));
        let mut bytes = 0;
        for (k, (_, length, path)) in files.iter().enumerate() {
            bytes += length;
            if k >= MAX_FILES || bytes > MAX_BYTES_IN_ALL {
                // Another program may have removed it meanwhile.
                let _ = fs::remove_file(path);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    fn names(folder: &std::path::Path) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn kept_data_reads_back() {
        let folder = tempfile::tempdir().unwrap();
        let kept = KeptViews { folder: folder.path().join("not/there/yet") };
        assert_eq!(kept.load("aa"), None);
        kept.store("aa", b"views");
        kept.store("aa", b"views again");
        assert_eq!(kept.load("aa").as_deref(), Some(b"views again".as_slice()));
        assert_eq!(names(&kept.folder), ["aa.views"]);
    }

    #[test]
    fn the_most_recently_used_files_are_kept() {
        let folder = tempfile::tempdir().unwrap();
        let kept = KeptViews { folder: folder.path().to_owned() };
        fs::write(folder.path().join("of-others"), b"stays").unwrap();
        for k in 0..MAX_FILES as u64 {
            let file = File::create(kept.path(&format!("{k:03}"))).unwrap();
            file.set_modified(SystemTime::UNIX_EPOCH + Duration::from_secs(1000 + k)).unwrap();
        }
        assert!(kept.load("000").is_some());
        kept.store("new", b"views");
        let left = names(folder.path());
        assert_eq!(left.len(), MAX_FILES + 1);
        assert!(["000.views", "002.views", "new.views", "of-others"].iter().all(|name| left.iter().any(|l| l == name)), "{left:?}");
        // A few large files also exceed the limit.
        let large = vec![0; MAX_BYTES as usize];
        for k in 0..=MAX_BYTES_IN_ALL / MAX_BYTES {
            kept.store(&format!("large-{k}"), &large);
        }
        let bytes: u64 = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().metadata().unwrap().len()).sum();
        assert!(bytes <= MAX_BYTES_IN_ALL + 5, "{bytes}");
    }

    #[test]
    fn a_folder_that_cannot_be_written_does_no_harm() {
        let folder = tempfile::tempdir().unwrap();
        // A file in place of the folder stops root as well.
        let file = folder.path().join("a-file");
        fs::write(&file, b"").unwrap();
        for place in [file, "/proc".into(), "/dev/null".into()] {
            let kept = KeptViews { folder: place };
            kept.store("aa", b"views");
            assert_eq!(kept.load("aa"), None);
        }
        // The same if the name is taken by something else.
        let kept = KeptViews { folder: folder.path().to_owned() };
        fs::create_dir(kept.path("aa")).unwrap();
        kept.store("aa", b"views");
        assert_eq!(kept.load("aa"), None);
    }
}
