//! Writing results: whole files or none.

use std::path::{Path, PathBuf};

use super::CalibrateArguments;
use crate::cli::failure::Failure;

/// Writes a file beside its place and moves it there, so that what was there is replaced by a whole file or not at all.
pub(in crate::cli) fn write(file: &Path, text: &str) -> Result<(), Failure> {
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    let beside = file.with_file_name(format!(".{name}.{}", std::process::id()));
    // What is no plain file - a pipe, /dev/stdout - cannot be replaced, only written to.
    if std::fs::metadata(file).is_ok_and(|m| !m.is_file()) {
        return std::fs::write(file, text).map_err(Failure::output(file));
    }
    let written = std::fs::write(&beside, text).and_then(|()| std::fs::rename(&beside, file));
    if written.is_err() {
        let _ = std::fs::remove_file(&beside);
    }
    written.map_err(Failure::output(file))
}

/// Finds an output's missing folder before the work is done, not after.
pub(super) fn refuse_unwritable(arguments: &CalibrateArguments) -> Result<(), Failure> {
    let files: Vec<&PathBuf> = [&arguments.output, &arguments.report, &arguments.json].into_iter().flatten().collect();
    for file in files {
        let folder = file.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        if !folder.is_dir() || file.is_dir() {
            let source = std::io::Error::from(if file.is_dir() { std::io::ErrorKind::IsADirectory } else { std::io::ErrorKind::NotFound });
            return Err(Failure::output(file)(source));
        }
    }
    Ok(())
}
