//! Runs the command line; its exit code is the command's.

use std::process::ExitCode;
use std::time::Instant;

fn main() -> ExitCode {
    stagepose::run_command_line(Instant::now())
}
