//! The program's own folders, apart from the config's: the service's, else the user's.

use std::path::{Path, PathBuf};

use crate::safe_file;

/// Returns the folder for what the program learns: systemd's `StateDirectory=`, else `stagepose` in
/// the user's state folder (XDG), else `.stagepose` in the working directory.
pub fn state_folder() -> PathBuf {
    own_folder("STATE_DIRECTORY", "XDG_STATE_HOME", ".local/state").unwrap_or_else(|| PathBuf::from(".stagepose"))
}

/// Returns the folder for dispensable files: systemd's `CacheDirectory=`, else `stagepose` in the
/// user's cache folder (XDG); `None` without a user.
pub fn cache_folder() -> Option<PathBuf> {
    own_folder("CACHE_DIRECTORY", "XDG_CACHE_HOME", ".cache")
}

/// Returns the folder that the service's variable names, else `stagepose` in the folder that the
/// user's variable names, else `stagepose` in this place in the user's home.
fn own_folder(of_service: &str, of_user: &str, in_home: &str) -> Option<PathBuf> {
    let of = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    // A service may have several folders, separated by colons.
    let of_service = of(of_service).and_then(|folders| std::env::split_paths(&folders).next());
    of_service.or_else(|| Some(of(of_user).or_else(|| Some(of("HOME")?.join(in_home)))?.join("stagepose")))
}

/// Where a daemon stores what changes while it runs: its config, the set, recordings. That is next
/// to the config, or in its own folder if it may not write there (a service whose config belongs to
/// root).
#[derive(Debug, Clone)]
pub struct Keeping {
    config: PathBuf,
    /// Its own folder, if it may not write next to the config.
    own: Option<PathBuf>,
}

impl Keeping {
    /// Decides for this config.
    pub fn of(config: &Path) -> Self {
        // This works even if the config file does not exist yet.
        let may_write = safe_file::may_write(&config.with_file_name(".stagepose-may-write")).is_ok();
        Self::choose(config, may_write, &state_folder())
    }

    fn choose(config: &Path, may_write: bool, state: &Path) -> Self {
        // Two configs in read-only folders must not share a set.
        let name = || format!("of{}", whole(config).to_string_lossy().replace('/', "-"));
        Self { config: config.to_owned(), own: (!may_write).then(|| state.join(name())) }
    }

    /// Returns the folder for the set and recordings.
    pub fn folder(&self) -> PathBuf {
        self.own.clone().unwrap_or_else(|| self.config.parent().unwrap_or(Path::new("")).to_owned())
    }

    /// Whether that is not next to the config.
    pub fn is_elsewhere(&self) -> bool {
        self.own.is_some()
    }

    /// Returns the file for a changed config. Its paths are relative to the original config.
    pub fn changed(&self) -> PathBuf {
        self.folder().join(self.config.file_name().unwrap_or_default())
    }

    /// Returns the file with the current config: the original, or a changed one that is not older.
    pub fn current(&self) -> PathBuf {
        let at = |file: &Path| std::fs::metadata(file).and_then(|about| about.modified()).ok();
        let changed = self.changed();
        let is_newer = self.own.is_some() && at(&changed).is_some_and(|then| at(&self.config).is_none_or(|given| given <= then));
        if is_newer { changed } else { self.config.clone() }
    }
}

/// Returns the absolute path of a file's folder, if possible.
fn whole(file: &Path) -> PathBuf {
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    std::fs::canonicalize(folder).unwrap_or_else(|_| folder.to_owned())
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, SystemTime};

    use super::*;

    #[test]
    fn a_read_only_config_folder_falls_back_to_a_state_folder() {
        let [etc, state] = [(); 2].map(|()| tempfile::tempdir().unwrap());
        let config = etc.path().join("stage.toml");
        std::fs::write(&config, "# given").unwrap();
        let beside = Keeping::choose(&config, true, state.path());
        assert_eq!((beside.folder(), beside.changed(), beside.current()), (etc.path().to_owned(), config.clone(), config.clone()));
        let own = Keeping::choose(&config, false, state.path());
        assert!(own.is_elsewhere() && own.folder().starts_with(state.path()), "{own:?}");
        assert_ne!(own.folder(), Keeping::choose(&state.path().join("stage.toml"), false, state.path()).folder());
        assert_eq!(own.current(), config, "nothing was changed yet");
        std::fs::create_dir_all(own.folder()).unwrap();
        std::fs::write(own.changed(), "# changed").unwrap();
        assert_eq!(own.current(), own.changed());
        // Whoever may write the original config has the last word.
        let later = SystemTime::now() + Duration::from_secs(5);
        std::fs::File::options().write(true).open(&config).unwrap().set_modified(later).unwrap();
        assert_eq!(own.current(), config);
    }
}
