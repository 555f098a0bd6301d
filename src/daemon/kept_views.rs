//! Banks of views as files of the cache folder. Nothing depends on them but how long a start takes, so whatever goes wrong here is no error.

use std::fs::{self, DirEntry, File};
use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::SystemTime;

use tracing::debug;

use super::own_folders::cache_folder;
use crate::safe_file;
use crate::track::ViewStore;

/// The name of each, behind its key.
const ENDING: &str = ".views";
/// Bytes of a bank at most: a hundred thousand features. The largest of a stage of one surface has 0.7 MB.
const MOST_BYTES: u64 = 6 << 20;
/// Files that stay, the last ones that were used. Chosen: some shows of a dozen pictures each, 10 MB in all. Raised, the folder grows larger; lowered, a
/// start with a show's config of last week takes as long as the first.
const MOST_FILES: usize = 100;
/// Bytes that stay, where banks are large.
const MOST_BYTES_IN_ALL: u64 = 64 << 20;

/// The store of the service, or of the user; none where neither has a cache folder.
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
        let bytes = safe_file::read(&path, MOST_BYTES).ok()?;
        // The time of a file says when it was used last. Where it cannot be set, the file is thrown away a little early.
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

    /// Removes those that were not used for longest, where there are too many, with what a killed program left of one.
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
            if k >= MOST_FILES || bytes > MOST_BYTES_IN_ALL {
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
    fn what_is_kept_comes_back() {
        let folder = tempfile::tempdir().unwrap();
        let kept = KeptViews { folder: folder.path().join("not/there/yet") };
        assert_eq!(kept.load("aa"), None);
        kept.store("aa", b"views");
        kept.store("aa", b"views again");
        assert_eq!(kept.load("aa").as_deref(), Some(b"views again".as_slice()));
        assert_eq!(names(&kept.folder), ["aa.views"]);
    }

    #[test]
    fn the_last_ones_that_were_used_stay() {
        let folder = tempfile::tempdir().unwrap();
        let kept = KeptViews { folder: folder.path().to_owned() };
        fs::write(folder.path().join("of-others"), b"stays").unwrap();
        for k in 0..MOST_FILES as u64 {
            let file = File::create(kept.path(&format!("{k:03}"))).unwrap();
            file.set_modified(SystemTime::UNIX_EPOCH + Duration::from_secs(1000 + k)).unwrap();
        }
        assert!(kept.load("000").is_some());
        kept.store("new", b"views");
        let left = names(folder.path());
        assert_eq!(left.len(), MOST_FILES + 1);
        assert!(["000.views", "002.views", "new.views", "of-others"].iter().all(|name| left.iter().any(|l| l == name)), "{left:?}");
        // A few large ones are too much, too.
        let large = vec![0; MOST_BYTES as usize];
        for k in 0..=MOST_BYTES_IN_ALL / MOST_BYTES {
            kept.store(&format!("large-{k}"), &large);
        }
        let bytes: u64 = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().metadata().unwrap().len()).sum();
        assert!(bytes <= MOST_BYTES_IN_ALL + 5, "{bytes}");
    }

    #[test]
    fn a_folder_that_cannot_be_written_does_no_harm() {
        let folder = tempfile::tempdir().unwrap();
        // A file where the folder should be stops root as well.
        let file = folder.path().join("a-file");
        fs::write(&file, b"").unwrap();
        for place in [file, "/proc".into(), "/dev/null".into()] {
            let kept = KeptViews { folder: place };
            kept.store("aa", b"views");
            assert_eq!(kept.load("aa"), None);
        }
        // A name that is taken by something else, too.
        let kept = KeptViews { folder: folder.path().to_owned() };
        fs::create_dir(kept.path("aa")).unwrap();
        kept.store("aa", b"views");
        assert_eq!(kept.load("aa"), None);
    }
}
