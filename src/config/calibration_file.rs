//! Calibration files on disk.

use std::path::Path;

use crate::camera::{Calibration, CalibrationFileError, parse_calibration};
use crate::safe_file;

/// Larger than any calibration file by far, small enough to read in one go.
const LARGEST_FILE_BYTES: u64 = 4 << 20;

/// Reads a calibration file in any of the forms that [`parse_calibration`] knows.
///
/// # Errors
/// When the file cannot be read or its text is no calibration; the message names the file, the line and the key.
pub fn read_calibration(path: &Path) -> Result<Calibration, CalibrationFileError> {
    parse_calibration(&calibration_bytes(path)?, path)
}

/// The bytes of a calibration file, for [`parse_calibration`].
///
/// # Errors
/// When the file cannot be read, or is far too large.
pub fn calibration_bytes(path: &Path) -> Result<Vec<u8>, CalibrationFileError> {
    let unreadable = |source| CalibrationFileError::Unreadable { path: path.to_owned(), source };
    safe_file::read(path, LARGEST_FILE_BYTES).map_err(unreadable)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_file_is_named_with_the_mend() {
        let gone = read_calibration(Path::new("does/not/exist.toml")).unwrap_err().to_string();
        assert!(gone.contains("does/not/exist.toml") && gone.contains("check its path"), "{gone}");
    }
}
