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
    let named = [("--output", &arguments.output), ("--report", &arguments.report), ("--json", &arguments.json)];
    for (flag, file) in named.iter().filter_map(|(flag, file)| Some((flag, file.as_ref()?))) {
        let folder = file.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        if !folder.is_dir() || file.is_dir() {
            let source = std::io::Error::from(if file.is_dir() { std::io::ErrorKind::IsADirectory } else { std::io::ErrorKind::NotFound });
            return Err(Failure::output(file)(source));
        }
        spared.claim(flag, file)?;
    }
    Ok(())
}
