//! Folders of the program's own, beside its config: the service's, else the user's.

use std::path::PathBuf;

/// Where it keeps what it learns: systemd's `StateDirectory=`, else `stagepose` below the user's state folder (XDG), else the folder that the program
/// runs in.
pub fn state_folder() -> PathBuf {
    own_folder("STATE_DIRECTORY", "XDG_STATE_HOME", ".local/state").unwrap_or_else(|| PathBuf::from(".stagepose"))
}

/// Where it keeps what it can do without: systemd's `CacheDirectory=`, else `stagepose` below the user's cache folder (XDG); none where there is no user.
pub fn cache_folder() -> Option<PathBuf> {
    own_folder("CACHE_DIRECTORY", "XDG_CACHE_HOME", ".cache")
}

/// The folder that this variable names to a service, else the program's in the one that another names, or that is at this place in the user's home.
fn own_folder(of_service: &str, of_user: &str, in_home: &str) -> Option<PathBuf> {
    let of = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    // A service may have several, with colons between them.
    let of_service = of(of_service).and_then(|folders| std::env::split_paths(&folders).next());
    of_service.or_else(|| Some(of(of_user).or_else(|| Some(of("HOME")?.join(in_home)))?.join("stagepose")))
}
