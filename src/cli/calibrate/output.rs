//! Writes results: whole files or none.

use std::io::Write;
use std::path::Path;

use super::CalibrateArguments;
use crate::cli::failure::Failure;
use crate::cli::output_file::OutputFile;
use crate::cli::spared::Spared;
use crate::safe_file;

/// Writes a temporary file and renames it, so that an existing file is replaced as a whole or not
/// at all.
pub(in crate::cli) fn write(file: &Path, content: impl AsRef<[u8]>) -> Result<(), Failure> {
    let content = content.as_ref();
    // A pipe or /dev/stdout cannot be replaced, only written to.
    if std::fs::metadata(file).is_ok_and(|m| !m.is_file()) {
        return OutputFile::open(file)?.write_all(content).map_err(Failure::output(file));
    }
    safe_file::write_whole(file, content).map_err(Failure::output(file))
}

/// Checks before the work, not after it, that the outputs' folders exist and that no output
/// overwrites an input.
pub(super) fn refuse_unwritable(arguments: &CalibrateArguments) -> Result<(), Failure> {
    let spared =
        Spared::default().with_files(&arguments.images, "one of the pictures").with_files(&arguments.compare, "the other calibration");
    let folders = arguments.images.iter().filter(|path| path.is_dir()).chain(&arguments.clip).chain(&arguments.play);
    let mut spared = folders.fold(spared, |spared, folder| spared.with_clip(folder));
    spared.claim_whole_files(&[("--output", &arguments.output), ("--report", &arguments.report), ("--json", &arguments.json)])
}
