//! Writing results: whole files or none.

use std::io::Write;
use std::path::Path;

use super::CalibrateArguments;
use crate::cli::failure::Failure;
use crate::cli::output_file::OutputFile;
use crate::cli::spared::Spared;
use crate::safe_file;

/// Writes a file beside its place and moves it there, so that what was there is replaced by a whole file or not at all.
pub(in crate::cli) fn write(file: &Path, content: impl AsRef<[u8]>) -> Result<(), Failure> {
    let content = content.as_ref();
    // What is no plain file - a pipe, /dev/stdout - cannot be replaced, only written to.
    if std::fs::metadata(file).is_ok_and(|m| !m.is_file()) {
        return OutputFile::open(file)?.write_all(content).map_err(Failure::output(file));
    }
    safe_file::write_whole(file, content).map_err(Failure::output(file))
}

/// Finds an output's missing folder, or that it would be written over what is read, before the work is done, not after.
pub(super) fn refuse_unwritable(arguments: &CalibrateArguments) -> Result<(), Failure> {
    let spared =
        Spared::default().with_files(&arguments.images, "one of the pictures").with_files(&arguments.compare, "the other calibration");
    let folders = arguments.images.iter().filter(|path| path.is_dir()).chain(&arguments.clip).chain(&arguments.play);
    let mut spared = folders.fold(spared, |spared, folder| spared.with_clip(folder));
    spared.claim_whole_files(&[("--output", &arguments.output), ("--report", &arguments.report), ("--json", &arguments.json)])
}
