//! Opens files that others name, without ever blocking on them.
//!
//! Opening a named pipe that nobody writes to blocks, a device may be endless, and a large file may
//! not fit into memory. So the file's type is checked before any byte is read or written.

use std::fs::{File, FileType, OpenOptions};
use std::io::{self, Read, Write as _};
use std::os::fd::OwnedFd;
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::{Component, Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use nix::errno::Errno;
use nix::fcntl::{AtFlags, OFlag, openat};
use nix::libc;
use nix::sys::stat::{Mode, SFlag, fstatat};
use nix::unistd::{AccessFlags, access};

/// Opens a regular file for reading; never blocks.
///
/// # Errors
/// I/O errors, or the path is not a regular file.
pub fn open(path: &Path) -> io::Result<File> {
    looked_at(path, OpenOptions::new().read(true), refuse_others)
}

/// Opens a file without blocking unless `refuse` rejects its type.
fn looked_at(path: &Path, options: &mut OpenOptions, refuse: impl Fn(FileType) -> io::Result<()>) -> io::Result<File> {
    // Checked twice: opening some devices has side effects, and the path may change between check
    // and opening.
    if let Ok(there) = std::fs::metadata(path) {
        refuse(there.file_type())?;
    }
    let file = options.custom_flags(libc::O_NONBLOCK | libc::O_NOCTTY).open(path)?;
    refuse(file.metadata()?.file_type())?;
    Ok(file)
}

/// Reads a regular file of at most `most_bytes`.
///
/// # Errors
/// As [`open`], or the file is larger.
pub fn read(path: &Path, most_bytes: u64) -> io::Result<Vec<u8>> {
    whole(open(path)?, most_bytes)
}

/// Like [`open`], for a name below a folder. Follows no link below the folder, so it never opens
/// anything outside.
///
/// # Errors
/// As [`open`], or the name is or passes through a link, or leaves the folder.
pub fn open_below(folder: &Path, name: &Path) -> io::Result<File> {
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let mut at: OwnedFd = OpenOptions::new().read(true).custom_flags(libc::O_PATH | libc::O_DIRECTORY).open(folder)?.into();
    let mut parts = name.components().peekable();
    let linked = |e: Errno| match e {
        Errno::ELOOP => io::Error::other("it is a link, which is not followed here"),
        _ => e.into(),
    };
    while let Some(part) = parts.next() {
        let Component::Normal(part) = part else { return Err(io::Error::other("it points outside its folder")) };
        let flags = if parts.peek().is_some() {
            OFlag::O_PATH | OFlag::O_DIRECTORY
        } else {
            // Checked first: opening some devices has side effects.
            let mode = fstatat(&at, part, AtFlags::AT_SYMLINK_NOFOLLOW).map_err(linked)?.st_mode;
            let kind = match SFlag::from_bits_truncate(mode & SFlag::S_IFMT.bits()) {
                SFlag::S_IFREG => None,
                SFlag::S_IFLNK => Some("a link, which is not followed here"),
                SFlag::S_IFDIR => Some("a folder"),
                SFlag::S_IFIFO => Some("a named pipe"),
                _ => Some("a device or a socket"),
            };
            if let Some(kind) = kind {
                return Err(io::Error::other(format!("it is {kind}, not a plain file")));
            }
            OFlag::O_RDONLY | OFlag::O_NONBLOCK | OFlag::O_NOCTTY
        };
        at = openat(&at, part, flags | OFlag::O_NOFOLLOW | OFlag::O_CLOEXEC, Mode::empty()).map_err(linked)?;
    }
    let file = File::from(at);
    refuse_others(file.metadata()?.file_type())?;
    Ok(file)
}

/// Like [`read`], for a name below a folder; see [`open_below`].
///
/// # Errors
/// As [`open_below`], or the file is larger.
pub fn read_below(folder: &Path, name: &Path, most_bytes: u64) -> io::Result<Vec<u8>> {
    whole(open_below(folder, name)?, most_bytes)
}

/// Reads all of a file of at most `most_bytes`.
fn whole(file: File, most_bytes: u64) -> io::Result<Vec<u8>> {
    let too_large = || io::Error::other(format!("it has more than {} MB", most_bytes >> 20));
    let length = file.metadata()?.len();
    if length > most_bytes {
        return Err(too_large());
    }
    let mut bytes = Vec::with_capacity(usize::try_from(length).unwrap_or(0));
    file.take(most_bytes + 1).read_to_end(&mut bytes)?;
    // A file may grow while it is read, and files in /proc report length 0.
    if bytes.len() as u64 > most_bytes { Err(too_large()) } else { Ok(bytes) }
}

/// Creates or truncates a regular file for writing; never blocks on a named pipe.
///
/// # Errors
/// I/O errors, or the path is not a regular file.
pub fn replace(path: &Path) -> io::Result<File> {
    looked_at(path, OpenOptions::new().write(true).create(true).truncate(true), refuse_others)
}

/// Number of temporary files created so far; makes their names unique.
static WRITTEN: AtomicU64 = AtomicU64::new(0);

/// Writes a whole file or nothing: writes a temporary file next to it and renames it. Readers of
/// the old file keep reading it. A full disk or a killed process leaves the old file intact.
///
/// # Errors
/// I/O errors.
pub fn write_whole(path: &Path, bytes: &[u8]) -> io::Result<()> {
    write_beside(path, bytes, false)
}

/// Like [`write_whole`], but syncs to disk first: after a power cut, the file is the old one or the
/// new one.
///
/// # Errors
/// I/O errors.
pub fn write_lasting(path: &Path, bytes: &[u8]) -> io::Result<()> {
    write_beside(path, bytes, true)
}

fn write_beside(path: &Path, bytes: &[u8], lasting: bool) -> io::Result<()> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    // Several threads may write the same file at once: the last one wins, and their bytes do not
    // mix.
    let number = WRITTEN.fetch_add(1, Ordering::Relaxed);
    let beside = path.with_file_name(format!(".{name}.{}.{number}", std::process::id()));
    let write = |mut file: File| file.write_all(bytes).and_then(|()| if lasting { file.sync_all() } else { Ok(()) });
    let written = File::create(&beside).and_then(write).and_then(|()| std::fs::rename(&beside, path));
    if written.is_err() {
        let _ = std::fs::remove_file(&beside);
    }
    written
}

/// Opens or creates a file for output, keeping its content. Devices such as /dev/null and named
/// pipes with a reader are allowed. The file is non-blocking: when a pipe is full, writing fails
/// with `WouldBlock`.
///
/// # Errors
/// I/O errors, a named pipe without a reader, or a type that no output belongs in: folders, disks,
/// sockets.
pub fn open_output(path: &Path) -> io::Result<File> {
    // A disk is a file too, and its content is worth more than any output.
    let refuse_wrong = |found: FileType| {
        let is_wrong = found.is_block_device() || found.is_socket() || found.is_dir();
        if is_wrong { Err(io::Error::other(format!("it is {}", kind(found)))) } else { Ok(()) }
    };
    let opened = looked_at(path, OpenOptions::new().write(true).create(true).truncate(false), refuse_wrong);
    opened.map_err(|e| match e.raw_os_error() {
        Some(libc::ENXIO) => io::Error::other("it is a named pipe that nobody reads; start its reader first"),
        _ => e,
    })
}

/// Checks whether a file can be written, or created if missing; opens and creates nothing.
///
/// # Errors
/// I/O errors of the file, or of the folder it would be created in.
pub fn may_write(path: &Path) -> io::Result<()> {
    let is_there = path.symlink_metadata().is_ok();
    if is_there {
        return Ok(access(path, AccessFlags::W_OK)?);
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let in_folder = |e: io::Error| io::Error::new(e.kind(), format!("the folder {}: {e}", folder.display()));
    if !std::fs::metadata(folder).map_err(in_folder)?.is_dir() {
        return Err(io::Error::other(format!("{} is not a folder", folder.display())));
    }
    access(folder, AccessFlags::W_OK | AccessFlags::X_OK).map_err(|e| in_folder(e.into()))
}

/// Returns the first of these names that already exists in the folder and so would be overwritten.
/// Dangling links count.
pub fn first_taken<N: AsRef<Path>>(folder: &Path, names: impl IntoIterator<Item = N>) -> Option<PathBuf> {
    names.into_iter().map(|name| folder.join(name)).find(|path| path.symlink_metadata().is_ok())
}

/// Describes, in words, a file type that is not a regular file.
pub fn kind(of: FileType) -> &'static str {
    if of.is_dir() {
        "a folder"
    } else if of.is_fifo() {
        "a named pipe"
    } else if of.is_socket() {
        "a socket"
    } else {
        "a device"
    }
}

fn refuse_others(found: FileType) -> io::Result<()> {
    if found.is_file() { Ok(()) } else { Err(io::Error::other(format!("it is {}, not a plain file", kind(found)))) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_replaced_whole() {
        let folder = tempfile::tempdir().unwrap();
        let [file, old] = ["a", "old"].map(|name| folder.path().join(name));
        write_whole(&file, b"first").unwrap();
        std::fs::hard_link(&file, &old).unwrap();
        write_whole(&file, b"second, and longer").unwrap();
        // The old file itself was not touched.
        assert_eq!((std::fs::read(&old).unwrap(), std::fs::read(&file).unwrap()), (b"first".to_vec(), b"second, and longer".to_vec()));
        // If the rename fails, no temporary file remains.
        std::fs::create_dir(folder.path().join("taken")).unwrap();
        assert!(write_whole(&folder.path().join("taken"), b"x").is_err());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 3);
    }

    #[test]
    fn non_plain_files_are_refused_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        nix::unistd::mkfifo(&pipe, nix::sys::stat::Mode::S_IRWXU).unwrap();
        for (path, kind) in [(pipe.as_path(), "a named pipe"), (folder.path(), "a folder"), (Path::new("/dev/zero"), "a device")] {
            let message = format!("it is {kind}, not a plain file");
            assert_eq!((read(path, 100).unwrap_err().to_string(), replace(path).unwrap_err().to_string()), (message.clone(), message));
        }
    }

    #[test]
    fn reading_below_a_folder_follows_no_links() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir_all(at("clip/frames/0000")).unwrap();
        std::fs::write(at("secret"), "secret").unwrap();
        for name in ["a", "frames/0000/b.jpg"] {
            std::fs::write(at("clip").join(name), name).unwrap();
            assert_eq!(read_below(&at("clip"), Path::new(name), 100).unwrap(), name.as_bytes());
        }
        std::os::unix::fs::symlink(at("secret"), at("clip/link")).unwrap();
        std::os::unix::fs::symlink(folder.path(), at("clip/out")).unwrap();
        std::os::unix::fs::symlink("a", at("clip/inner")).unwrap();
        for name in ["link", "out/secret", "inner", "../secret", "frames", "none", "/etc/passwd", ""] {
            assert!(read_below(&at("clip"), Path::new(name), 100).is_err(), "{name}");
        }
        // The folder itself may be reached through a link: whoever runs the program chose it.
        std::os::unix::fs::symlink(at("clip"), at("recordings")).unwrap();
        assert_eq!(read_below(&at("recordings"), Path::new("a"), 100).unwrap(), b"a");
    }

    #[test]
    fn a_name_is_taken_even_by_a_dangling_link() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(first_taken(folder.path(), ["a", "b"]), None);
        std::os::unix::fs::symlink("nowhere", folder.path().join("b")).unwrap();
        assert_eq!(first_taken(folder.path(), ["a", "b"]), Some(folder.path().join("b")));
    }

    #[test]
    fn the_size_limit_is_enforced() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), [7; 100]).unwrap();
        assert_eq!(read(file.path(), 100).unwrap(), [7; 100]);
        assert!(read(file.path(), 99).unwrap_err().to_string().contains("more than 0 MB"));
        assert!(read(Path::new("/proc/self/maps"), 1).is_err(), "a file without a length");
        assert!(!read(Path::new("/proc/self/maps"), 1 << 20).unwrap().is_empty());
    }
}
