//! A config as it was read: its text and the bytes of every file it names.
//!
//! A session may outlive its input: the config is edited, a picture repainted, a calibration
//! replaced, long before the next SIGHUP. What is saved of the session must be what it ran with, so
//! nothing is read twice.

use std::borrow::Cow;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::ConfigError;
use crate::camera::{Calibration, CalibrationFileError, parse_calibration, utf16};
use crate::safe_file;

/// A config's text and the files it names, as they were when read.
#[derive(Debug, Clone)]
pub struct ConfigSource {
    pub(super) file: PathBuf,
    pub(super) text: Arc<str>,
    /// By the path under which they were opened.
    pub(super) files: Arc<BTreeMap<PathBuf, Arc<[u8]>>>,
}

impl ConfigSource {
    /// Whether both are the same reading of a config.
    pub fn is_same_reading(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.text, &other.text) && Arc::ptr_eq(&self.files, &other.files)
    }
}

/// Maximum size of a config, bytes. A round figure above any config. Raised, an endless file takes
/// more memory.
const MAX_CONFIG_BYTES: u64 = 4 << 20;

/// Reads a config file's text.
pub(super) fn read_text(file: &Path) -> Result<String, ConfigError> {
    let unreadable = |e: std::io::Error| ConfigError::Unreadable { file: file.to_owned(), reason: e.to_string() };
    let bytes = safe_file::read(file, MAX_CONFIG_BYTES).map_err(unreadable)?;
    if matches!(utf16::as_utf8(&bytes), Cow::Owned(_)) {
        let reason = "the file is UTF-16; save it as UTF-8".to_owned();
        return Err(ConfigError::Syntax { file: file.to_owned(), line: 1, reason });
    }
    String::from_utf8(bytes).map_err(|e| {
        let line = 1 + e.as_bytes()[..e.utf8_error().valid_up_to()].iter().filter(|b| **b == b'\n').count();
        ConfigError::Syntax { file: file.to_owned(), line, reason: "a character is not UTF-8; save the file as UTF-8".to_owned() }
    })
}

/// Reads each file once and keeps its bytes.
#[derive(Debug, Default)]
pub(super) struct FilesRead(RefCell<BTreeMap<PathBuf, Arc<[u8]>>>);

impl FilesRead {
    /// Returns a file's bytes, read with `read` the first time.
    pub fn get<E>(&self, file: &Path, read: impl FnOnce(&Path) -> Result<Vec<u8>, E>) -> Result<Arc<[u8]>, E> {
        if let Some(bytes) = self.0.borrow().get(file) {
            return Ok(bytes.clone());
        }
        let bytes: Arc<[u8]> = read(file)?.into();
        self.0.borrow_mut().insert(file.to_owned(), bytes.clone());
        Ok(bytes)
    }

    /// Returns everything that was read, with the config that named it.
    pub fn with_config(&self, file: &Path, text: &str) -> ConfigSource {
        ConfigSource { file: file.to_owned(), text: text.into(), files: Arc::new(self.0.borrow().clone()) }
    }
}

impl ConfigSource {
    /// Returns the bytes of a file that the config names.
    pub(super) fn bytes(&self, name: &str) -> io::Result<&[u8]> {
        let file = self.file.parent().unwrap_or(Path::new("")).join(name);
        let missing = || io::Error::other(format!("{} was not read with its config", file.display()));
        self.files.get(&file).map(|bytes| &**bytes).ok_or_else(missing)
    }
}

/// Maximum size of a calibration file, bytes. A round figure far above any. Raised, an endless file
/// takes more memory.
const MAX_CALIBRATION_BYTES: u64 = 4 << 20;

/// Reads a calibration file in any format that [`parse_calibration`] knows.
///
/// # Errors
/// When the file cannot be read or is not a calibration; the message names the file, the line and
/// the key.
pub fn read_calibration(path: &Path) -> Result<Calibration, CalibrationFileError> {
    parse_calibration(&calibration_bytes(path)?, path)
}

/// Reads a calibration file's bytes, for [`parse_calibration`].
///
/// # Errors
/// When the file cannot be read or is far too large.
pub(super) fn calibration_bytes(path: &Path) -> Result<Vec<u8>, CalibrationFileError> {
    let unreadable = |source| CalibrationFileError::Unreadable { path: path.to_owned(), source };
    safe_file::read(path, MAX_CALIBRATION_BYTES).map_err(unreadable)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_file_is_named_with_a_hint() {
        let gone = read_calibration(Path::new("does/not/exist.toml")).unwrap_err().to_string();
        assert!(gone.contains("does/not/exist.toml") && gone.contains("check its path"), "{gone}");
    }
}
