//! Tests of the program from outside (commands, files, exit codes, results on whole clips), of the
//! tracker as a library on rendered frames, and of live cameras that fail.

mod calibrate;
mod cli;
mod clips;
mod compare;
mod delay;
mod live;
mod mount;
mod network;
mod outputs;
mod pipeline;
mod structure;
mod survey;

use std::path::Path;
use std::process::Command;
use std::sync::OnceLock;

/// Returns a command that starts the program with a view cache that all tests of this binary share:
/// preparing a picture takes longer than most commands here need for the rest. The cache begins
/// empty. `cli::kept_views` checks that results are the same without it.
fn program() -> Command {
    static CACHE: OnceLock<&Path> = OnceLock::new();
    let cache = CACHE.get_or_init(|| {
        let folder = Path::new(concat!(env!("CARGO_TARGET_TMPDIR"), "/views"));
        let _ = std::fs::remove_dir_all(folder);
        std::fs::create_dir_all(folder).expect("the build's folder can be written");
        folder
    });
    let mut command = Command::new(env!("CARGO_BIN_EXE_stagepose"));
    command.env("CACHE_DIRECTORY", cache);
    command
}
