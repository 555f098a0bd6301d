//! Where the daemon keeps what it learns beside its config: the service's own folder, else the user's.

use std::path::PathBuf;

/// systemd's `StateDirectory=`, else `stagepose` below the user's state folder (XDG), else the folder that the program runs in.
pub fn state_folder() -> PathBuf {
    let of = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    // A service may have several, with colons between them.
    let of_service = of("STATE_DIRECTORY").and_then(|folders| std::env::split_paths(&folders).next());
    let of_user = || Some(of("XDG_STATE_HOME").or_else(|| Some(of("HOME")?.join(".local/state")))?.join("stagepose"));
    of_service.or_else(of_user).unwrap_or_else(|| PathBuf::from(".stagepose"))
}
