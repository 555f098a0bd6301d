//! Arguments to command to exit code, nothing else.

use std::process::ExitCode;
use std::time::Instant;

fn main() -> ExitCode {
    stagepose::run_command_line(Instant::now())
}
