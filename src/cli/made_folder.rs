//! The folder of a made stage, a surveyed or a mapped one: written as a whole, or left as it was.

use std::fs;
use std::path::Path;

use super::failure::Failure;
use crate::safe_file;

/// The folders that a command makes, each marked by a file so that another run may replace it.
pub(super) struct MadeFolder {
    /// Name of the marker file.
    mark: &'static str,
    /// What such a folder holds, for messages.
    of: &'static str,
}

/// Folders of `stagepose survey`.
pub(super) const SURVEYED: MadeFolder = MadeFolder { mark: ".stagepose-survey", of: "survey" };
/// Folders of `stagepose map`.
pub(super) const MAPPED: MadeFolder = MadeFolder { mark: ".stagepose-map", of: "map" };

impl MadeFolder {
    /// Refuses a folder that holds anything but an earlier result of the same command.
    pub(super) fn refuse_unusable(&self, folder: &Path) -> Result<(), Failure> {
        match fs::read_dir(folder) {
            Ok(mut entries) => match folder.join(self.mark).exists() || entries.next().is_none() {
                true => Ok(()),
                false => {
                    Err(Failure::Usage(format!("{}: holds files that no earlier {} wrote; give a new folder", folder.display(), self.of)))
                }
            },
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(()),
            Err(e) => Err(Failure::Output { file: folder.to_owned(), source: e }),
        }
    }

    /// Writes the files of a made stage; an earlier one is replaced as a whole.
    pub(super) fn write(&self, folder: &Path, files: Vec<(String, Vec<u8>)>) -> Result<(), Failure> {
        let name = folder.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        let [beside, old] = ["new", "old"].map(|word| folder.with_file_name(format!(".{name}.{word}")));
        let written = (|| {
            put_back(&old, folder)?;
            // Leftovers of a killed run would mix with this run's files.
            remove(&beside)?;
            remove(&old)?;
            fs::create_dir_all(&beside)?;
            for (name, bytes) in files {
                safe_file::write_whole(&beside.join(name), &bytes)?;
            }
            safe_file::write_whole(&beside.join(self.mark), b"")?;
            replace(folder, &beside, &old)
        })();
        if written.is_err() {
            // The leftovers are useless. If even this fails, the first error is the one to report.
            let _ = fs::remove_dir_all(&beside);
        }
        written.map_err(Failure::output(folder))
    }
}

/// Moves the new folder to the place of the earlier one, which is removed only after that has
/// succeeded.
fn replace(folder: &Path, new: &Path, old: &Path) -> std::io::Result<()> {
    if folder.exists() {
        fs::rename(folder, old)?;
    }
    if let Err(e) = fs::rename(new, folder) {
        put_back(old, folder)?;
        return Err(e);
    }
    remove(old)
}

/// Moves an earlier folder back if no new one took its place, as after a run that was killed.
fn put_back(old: &Path, folder: &Path) -> std::io::Result<()> {
    if old.exists() && !folder.exists() { fs::rename(old, folder) } else { Ok(()) }
}

/// Removes a folder if it exists.
fn remove(folder: &Path) -> std::io::Result<()> {
    fs::remove_dir_all(folder).or_else(|e| if e.kind() == std::io::ErrorKind::NotFound { Ok(()) } else { Err(e) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_replacement_restores_the_earlier_folder() {
        let room = tempfile::tempdir().unwrap();
        let [folder, new, old] = ["stage", ".stage.new", ".stage.old"].map(|name| room.path().join(name));
        fs::create_dir(&folder).unwrap();
        fs::write(folder.join("stage.toml"), "earlier").unwrap();
        // There is no new folder.
        assert!(replace(&folder, &new, &old).is_err());
        assert_eq!(fs::read_to_string(folder.join("stage.toml")).unwrap(), "earlier");
        // A run was killed between the two steps.
        fs::rename(&folder, &old).unwrap();
        put_back(&old, &folder).unwrap();
        assert_eq!(fs::read_to_string(folder.join("stage.toml")).unwrap(), "earlier");
        fs::create_dir(&new).unwrap();
        fs::write(new.join("stage.toml"), "new").unwrap();
        replace(&folder, &new, &old).unwrap();
        assert_eq!(fs::read_to_string(folder.join("stage.toml")).unwrap(), "new");
        assert!(!old.exists() && !new.exists());
    }
}
