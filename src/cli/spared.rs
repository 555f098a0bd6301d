//! Ensures that a command never overwrites its inputs and that no two of its outputs go to the same
//! file.
//!
//! Names are not enough: there are links, several names for one file, and `./` prefixes. So files
//! are compared by device and inode, and files that do not exist yet by folder and name.

use std::collections::HashMap;
use std::ffi::OsString;
use std::fs::Metadata;
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::path::{Path, PathBuf};

use super::failure::Failure;
use super::output_file::{OutputFile, STDOUT};
use crate::publish::{JsonSettings, OutputSettings, Protocol, StreamSettings};

/// A file's identity.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
enum Place {
    /// An existing file: device and inode.
    File(u64, u64),
    /// A file yet to be created: its folder's device and inode, and its name.
    Name(u64, u64, OsString),
}

/// Why a file may not be written.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Taken {
    /// It is an input; holds a description.
    Input(String),
    /// It is another output; holds the argument that names it.
    Output(String),
}

/// Files that must not be overwritten.
#[derive(Debug, Default)]
pub(super) struct Spared {
    taken: HashMap<Place, Taken>,
    /// Clips that are folders. They are searched only if an output exists already.
    clips: Vec<PathBuf>,
}

impl Spared {
    /// Protects these files, described by `what`.
    pub fn with_files<'a>(mut self, files: impl IntoIterator<Item = &'a PathBuf>, what: &str) -> Self {
        for file in files {
            self.take(file, what);
        }
        self
    }

    /// Protects a clip: the file, or the folder and its content.
    pub fn with_clip(mut self, clip: &Path) -> Self {
        if clip.as_os_str() != STDOUT {
            self.take(clip, "the clip");
        }
        if clip.is_dir() {
            self.clips.push(clip.to_owned());
        }
        self
    }

    fn take(&mut self, file: &Path, what: &str) {
        if let Ok(about) = std::fs::metadata(file) {
            self.taken.entry(Place::File(about.dev(), about.ino())).or_insert_with(|| Taken::Input(what.to_owned()));
        }
    }

    /// Opens an output if one is wanted; `flag` is its argument.
    ///
    /// # Errors
    /// [`Failure::Usage`] if it would overwrite something, and the errors of [`OutputFile::open`].
    pub fn open(&mut self, flag: &str, file: Option<&Path>) -> Result<Option<OutputFile>, Failure> {
        let Some(file) = file else { return Ok(None) };
        let was_there = std::fs::metadata(file).is_ok();
        if !was_there {
            // Another output may have claimed the name and not created the file yet.
            self.claim(flag, file)?;
        }
        let output = OutputFile::open(file)?;
        let about = output.file().metadata().map_err(Failure::output(file))?;
        self.claim_file(flag, file, &about, was_there)?;
        Ok(Some(output))
    }

    /// Claims a file for an output that is opened later or replaced as a whole.
    ///
    /// # Errors
    /// [`Failure::Usage`] if it would overwrite something.
    pub fn claim(&mut self, flag: &str, file: &Path) -> Result<(), Failure> {
        if file == Path::new(STDOUT) {
            return Ok(());
        }
        if let Ok(about) = std::fs::metadata(file) {
            return self.claim_file(flag, file, &about, true);
        }
        let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let (Ok(folder), Some(name)) = (std::fs::metadata(folder), file.file_name()) else { return Ok(()) };
        self.claim_place(flag, file, Place::Name(folder.dev(), folder.ino(), name.to_owned()))
    }

    /// Claims outputs that are written as whole files, each in an existing folder.
    ///
    /// # Errors
    /// As [`claim`](Self::claim), and [`Failure::Output`] if the folder is missing or the file is a
    /// folder.
    pub fn claim_whole_files(&mut self, named: &[(&str, &Option<PathBuf>)]) -> Result<(), Failure> {
        for (flag, file) in named.iter().filter_map(|(flag, file)| Some((flag, file.as_ref()?))) {
            let folder = file.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
            if !folder.is_dir() || file.is_dir() {
                let source =
                    std::io::Error::from(if file.is_dir() { std::io::ErrorKind::IsADirectory } else { std::io::ErrorKind::NotFound });
                return Err(Failure::output(file)(source));
            }
            self.claim(flag, file)?;
        }
        Ok(())
    }

    /// Refuses a folder for pictures that belongs to a clip or holds a protected file.
    ///
    /// # Errors
    /// [`Failure::Usage`].
    pub fn claim_folder(&mut self, flag: &str, folder: &Path) -> Result<(), Failure> {
        self.look_through_clips();
        let own = |file: &Path| std::fs::metadata(file).ok().and_then(|about| self.taken.get(&Place::File(about.dev(), about.ino())));
        if let Some(what) = own(folder) {
            return Err(refusal(flag, folder, what));
        }
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            if let Some(what) = own(&entry.path()) {
                return Err(refusal(flag, &entry.path(), what));
            }
        }
        Ok(())
    }

    /// Claims the files that the config's outputs write.
    ///
    /// # Errors
    /// As [`claim`](Self::claim).
    pub fn claim_outputs(&mut self, outputs: &[OutputSettings]) -> Result<(), Failure> {
        for output in outputs.iter().filter(|output| output.enabled) {
            if let Protocol::Json(JsonSettings { stream: StreamSettings { file: Some(file), .. }, .. }) = &output.protocol {
                self.claim("`file` of an [[output]] of the config:", file)?;
            }
        }
        Ok(())
    }

    /// Refuses a folder that is one of these clips or lies within a clip: files written there would
    /// later be read as part of it.
    ///
    /// # Errors
    /// [`Failure::Usage`].
    pub fn refuse_within_clip(&self, flag: &str, folder: &Path) -> Result<(), Failure> {
        let absolute = std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
        let there = absolute.ancestors().find_map(|part| part.canonicalize().ok()).unwrap_or_default();
        let is_clip = |part: &Path| self.clips.iter().any(|clip| clip.canonicalize().is_ok_and(|clip| clip == part));
        // A recording's pictures lie at most two folders below its index.
        let recording = there.ancestors().take(3).find(|part| part.join("timestamps.csv").is_file());
        match there.ancestors().find(|part| is_clip(part)).or(recording) {
            Some(clip) => Err(Failure::Usage(format!(
                "{flag} {}: it is inside the clip {}, to which nothing is added; give another folder",
                folder.display(),
                clip.display()
            ))),
            None => Ok(()),
        }
    }

    fn claim_file(&mut self, flag: &str, file: &Path, about: &Metadata, was_there: bool) -> Result<(), Failure> {
        // A character device stores nothing that could be lost: two outputs may both go to
        // /dev/null.
        if about.file_type().is_char_device() {
            return Ok(());
        }
        if was_there {
            self.look_through_clips();
        }
        self.claim_place(flag, file, Place::File(about.dev(), about.ino()))
    }

    fn claim_place(&mut self, flag: &str, file: &Path, place: Place) -> Result<(), Failure> {
        match self.taken.get(&place) {
            Some(what) => Err(refusal(flag, file, what)),
            None => {
                self.taken.insert(place, Taken::Output(flag.to_owned()));
                Ok(())
            }
        }
    }

    /// Protects every file and folder of the clips; links are followed.
    fn look_through_clips(&mut self) {
        let mut folders = std::mem::take(&mut self.clips);
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(&folder).into_iter().flatten().flatten() {
                let path = entry.path();
                let Ok(about) = std::fs::metadata(&path) else { continue };
                let what = if about.is_dir() { "a folder of the clip" } else { "a file of the clip" };
                let place = Place::File(about.dev(), about.ino());
                let is_new = !self.taken.contains_key(&place);
                if is_new && (about.is_dir() || is_input(&path, &folder)) {
                    self.taken.insert(place, Taken::Input(what.to_owned()));
                }
                // Each folder is entered once, so that links to a parent folder terminate.
                if about.is_dir() && is_new && is_of_clip(&folder, &path) {
                    folders.push(path);
                }
            }
        }
    }
}

/// Whether a folder can hold a clip's pictures: frames or data next to its index, or a folder below
/// these.
fn is_of_clip(above: &Path, folder: &Path) -> bool {
    let is_picture_folder = |path: &Path| path.file_name().is_some_and(|name| name == "frames" || name == "data");
    is_picture_folder(folder) || above.ancestors().any(is_picture_folder)
}

/// Whether a file is read as part of a clip. Records next to its pictures are not and may be
/// overwritten.
fn is_input(file: &Path, folder: &Path) -> bool {
    let extension = file.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    let is_picture = ["png", "jpg", "jpeg", "pgm", "ppm", "pnm", "pbm", "csv"].contains(&extension.as_str());
    is_picture || is_of_clip(folder, folder)
}

fn refusal(flag: &str, file: &Path, taken: &Taken) -> Failure {
    let file = file.display();
    Failure::Usage(match taken {
        Taken::Input(what) => format!("{flag} {file}: it is {what}, which would be overwritten; give another name"),
        Taken::Output(other) => format!("{flag} {file}: {other} writes to the same file; give each output its own file"),
    })
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn refused(spared: &mut Spared, file: &Path) -> String {
        let message = spared.open("--poses", Some(file)).map(|_| ()).unwrap_err().to_string();
        assert_eq!(spared.claim("--json", file).unwrap_err().to_string(), message.replacen("--poses", "--json", 1));
        message
    }

    #[test]
    fn a_protected_file_is_recognised_through_links() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::write(at("camera.toml"), "kept").unwrap();
        fs::hard_link(at("camera.toml"), at("hard")).unwrap();
        std::os::unix::fs::symlink("camera.toml", at("soft")).unwrap();
        for name in ["camera.toml", "hard", "soft", "./camera.toml"] {
            let mut spared = Spared::default().with_files(&[at("camera.toml")], "a file of the config");
            let message = refused(&mut spared, &at(name));
            assert!(message.contains("it is a file of the config, which would be overwritten; give another name"), "{message}");
        }
        assert_eq!(fs::read_to_string(at("camera.toml")).unwrap(), "kept");
    }

    #[test]
    fn a_clip_is_protected_but_not_files_beside_it() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::create_dir_all(at("frames/0000")).unwrap();
        for name in ["timestamps.csv", "frames/a.png", "frames/0000/b.jpg", "poses.jsonl"] {
            fs::write(at(name), "kept").unwrap();
        }
        let mut spared = Spared::default().with_clip(folder.path());
        for name in ["timestamps.csv", "frames/a.png", "frames/0000/b.jpg"] {
            assert!(refused(&mut spared, &at(name)).contains("a file of the clip"), "{name}");
        }
        assert!(spared.claim_folder("--overlay", &at("frames")).is_err());
        assert!(spared.claim_folder("--overlay", folder.path()).is_err());
        assert!(spared.open("--poses", Some(&at("poses.jsonl"))).unwrap().is_some());
    }

    #[test]
    fn two_outputs_cannot_share_a_file() {
        let folder = tempfile::tempdir().unwrap();
        let new = folder.path().join("new");
        let mut spared = Spared::default();
        spared.open("--poses", Some(&new)).unwrap();
        let message = spared.open("--tum", Some(&folder.path().join("./new"))).map(|_| ()).unwrap_err().to_string();
        assert!(message.contains("--poses writes to the same file; give each output its own file"), "{message}");
        let mut spared = Spared::default();
        spared.claim("--json", &folder.path().join("later")).unwrap();
        assert!(spared.open("--poses", Some(&folder.path().join("./later"))).is_err());
        assert!(!folder.path().join("later").exists());
        assert!(spared.claim("--report", &folder.path().join("./later")).is_err());
        let null = Path::new("/dev/null");
        spared.open("--poses", Some(null)).unwrap();
        spared.open("--tum", Some(null)).unwrap();
    }
}
