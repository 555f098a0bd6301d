//! `GET /api/v1/scene?format=…`: the stage as a file for other programs. What the formats hold is
//! the caller's business; files are made once for each config and format, one at a time.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use super::reply::Reply;

/// Maximum size of a file that is sent, bytes. Chosen: dozens of pictures as PNG. Raised, an answer
/// takes more memory.
const MAX_FILE: usize = 64 << 20;

/// The stage of one config, for other programs.
pub trait StageSource: Send + Sync {
    /// Returns a number that changes with the config; `None` while there is none.
    fn version(&self) -> Option<u64>;

    /// Returns the formats: the word in the query, the MIME type, and the file's name.
    fn formats(&self) -> &'static [(&'static str, &'static str, &'static str)];

    /// Makes the file of one of the formats.
    ///
    /// # Errors
    /// Why it cannot be made.
    fn make(&self, format: &str) -> Result<Vec<u8>, String>;
}

/// The files that were made, of one version.
#[derive(Default)]
struct Made {
    version: u64,
    files: BTreeMap<&'static str, Arc<[u8]>>,
}

/// Answers with the stage's files.
#[derive(Clone)]
pub(super) struct StageFiles {
    source: Arc<dyn StageSource>,
    made: Arc<Mutex<Made>>,
}

impl StageFiles {
    pub fn new(source: Arc<dyn StageSource>) -> Self {
        Self { source, made: Arc::default() }
    }

    /// Returns the file of a format.
    pub fn reply(&self, format: &str) -> Reply {
        let formats = self.source.formats();
        let Some((word, content_type, name)) = formats.iter().find(|(word, ..)| *word == format) else {
            let words: Vec<&str> = formats.iter().map(|(word, ..)| *word).collect();
            return Reply::text(400, format!("format is one of {}; without it the answer is JSON\n", words.join(", ")));
        };
        // Whoever asks meanwhile waits, and finds it made.
        let mut made = self.made.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(version) = self.source.version() else { return Reply::text(503, "there is no config yet, so there is no stage\n") };
        if made.version != version {
            *made = Made { version, files: BTreeMap::new() };
        }
        let file = match made.files.get(word) {
            Some(file) => file.clone(),
            None => match self.source.make(word) {
                Ok(bytes) if bytes.len() > MAX_FILE => {
                    let sentence = format!("the file has {} MB, more than is sent; use `stagepose export`\n", bytes.len() >> 20);
                    return Reply::text(507, sentence);
                }
                Ok(bytes) => made.files.entry(word).or_insert(bytes.into()).clone(),
                Err(reason) => return Reply::text(500, format!("the file cannot be made: {reason}\n")),
            },
        };
        drop(made);
        Reply::new(200, content_type, file.to_vec()).with("content-disposition", &format!("attachment; filename=\"{name}\""))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU64, Ordering};

    use super::*;

    #[derive(Default)]
    struct Source {
        version: AtomicU64,
        times_made: AtomicU64,
    }

    impl StageSource for Source {
        fn version(&self) -> Option<u64> {
            Some(self.version.load(Ordering::Relaxed)).filter(|version| *version > 0)
        }

        fn formats(&self) -> &'static [(&'static str, &'static str, &'static str)] {
            &[("small", "text/plain", "small.txt"), ("large", "text/plain", "large.txt"), ("bad", "text/plain", "bad.txt")]
        }

        fn make(&self, format: &str) -> Result<Vec<u8>, String> {
            self.times_made.fetch_add(1, Ordering::Relaxed);
            match format {
                "small" => Ok(b"stage".to_vec()),
                "large" => Ok(vec![0; MAX_FILE + 1]),
                _ => Err("no memory".to_owned()),
            }
        }
    }

    #[test]
    fn a_file_is_made_once_for_each_config() {
        let source = Arc::new(Source::default());
        let files = StageFiles::new(source.clone());
        assert_eq!(files.reply("small").status, 503);
        source.version.store(7, Ordering::Relaxed);
        for _ in 0..3 {
            let reply = files.reply("small");
            assert_eq!((reply.status, reply.content_type, reply.body.as_slice()), (200, "text/plain", b"stage".as_slice()));
        }
        assert_eq!(source.times_made.load(Ordering::Relaxed), 1);
        source.version.store(8, Ordering::Relaxed);
        assert_eq!((files.reply("small").status, source.times_made.load(Ordering::Relaxed)), (200, 2));
    }

    #[test]
    fn unknown_formats_large_files_and_failures_are_refused_with_the_fix() {
        let source = Arc::new(Source::default());
        source.version.store(1, Ordering::Relaxed);
        let files = StageFiles::new(source);
        for (format, status, part) in
            [("fbx", 400, "small, large, bad"), ("", 400, "JSON"), ("large", 507, "stagepose export"), ("bad", 500, "no memory")]
        {
            let reply = files.reply(format);
            assert!(reply.status == status && String::from_utf8_lossy(&reply.body).contains(part), "{format}: {reply:?}");
        }
    }
}
