//! The command line: one file per command, one sentence per error, one exit code per outcome.
//!
//! Exit codes (contract C1): 0 success, 1 failure, 2 bad usage or config. Results go to stdout,
//! errors to stderr. A reader that closes the pipe is not an error.

mod angles;
mod board;
mod calibrate;
mod check;
mod clip_rows;
mod clip_timecode;
mod compare;
mod compare_poses;
mod completions;
mod delay;
mod demo;
mod detectors;
mod devices;
mod export;
mod failure;
mod freeze;
mod interrupt;
mod layout_figures;
mod learnt;
mod listen;
mod logging;
mod made_folder;
mod man;
mod map;
mod mount;
mod outcome;
mod output_file;
mod outputs;
pub mod overlay;
mod pages;
#[cfg(feature = "http")]
mod pair;
mod pose_log;
mod poster;
mod record;
mod refine;
mod replay;
mod report;
mod run;
mod send_test;
mod spared;
mod stage_files;
mod survey;
mod timecode;
mod walk;
mod walk_file;

use std::io::{self, Write as _};
use std::process::ExitCode;
use std::time::Instant;

use clap::{Parser, Subcommand};

pub use failure::Failure;

use crate::printable::{printable, printable_lines, stands_for_itself};

/// Finds where a stage camera is: metric 6-DoF pose from a picture of the stage.
#[derive(Debug, Parser)]
#[command(
    name = "stagepose",
    version,
    after_help = "Example:\n  stagepose replay clip --config stage.toml --poses poses.jsonl\n\nEach command has a --help with an example."
)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Replay(replay::ReplayArguments),
    Check(check::CheckArguments),
    Compare(compare::CompareArguments),
    Detectors(detectors::DetectorsArguments),
    Demo(demo::DemoArguments),
    Calibrate(calibrate::CalibrateArguments),
    Board(board::BoardArguments),
    Poster(poster::PosterArguments),
    Mount(mount::MountArguments),
    Delay(delay::DelayArguments),
    ComparePoses(compare_poses::ComparePosesArguments),
    Devices(devices::DevicesArguments),
    Run(run::RunArguments),
    #[cfg(feature = "http")]
    Setup(run::SetupArguments),
    Record(record::RecordArguments),
    SendTest(send_test::SendTestArguments),
    Listen(listen::ListenArguments),
    Report(report::ReportArguments),
    #[cfg(feature = "http")]
    Pair(pair::PairArguments),
    Survey(survey::SurveyArguments),
    Map(map::MapArguments),
    Export(export::ExportArguments),
    Refine(refine::RefineArguments),
    Freeze(freeze::FreezeArguments),
    Timecode(timecode::TimecodeArguments),
    Completions(completions::CompletionsArguments),
    Man(man::ManArguments),
}

/// Runs this process's command line; `started` is when the process began.
pub fn run(started: Instant) -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => {
            // Help and version go to stdout with exit code 0, bad usage to stderr with 2, even if
            // the pipe is closed.
            let _ = print_usage(&error);
            return ExitCode::from(if error.use_stderr() { failure::USAGE } else { 0 });
        }
    };
    interrupt::outlive_file_limits();
    let outcome = match arguments.command {
        Command::Replay(arguments) => replay::run(&arguments, started),
        Command::Check(arguments) => check::run(&arguments),
        Command::Compare(arguments) => compare::run(&arguments),
        Command::Detectors(arguments) => detectors::run(&arguments),
        Command::Calibrate(arguments) => calibrate::run(&arguments),
        Command::Board(arguments) => board::run(&arguments),
        Command::Poster(arguments) => poster::run(&arguments),
        Command::Mount(arguments) => mount::run(&arguments),
        Command::Delay(arguments) => delay::run(&arguments),
        Command::ComparePoses(arguments) => compare_poses::run(&arguments),
        Command::Devices(arguments) => devices::run(&arguments),
        Command::Run(arguments) => run::run(&arguments),
        #[cfg(feature = "http")]
        Command::Setup(arguments) => run::setup(arguments),
        Command::Record(arguments) => record::run(&arguments),
        Command::SendTest(arguments) => send_test::run(&arguments),
        Command::Listen(arguments) => listen::run(&arguments),
        Command::Report(arguments) => report::run(&arguments),
        #[cfg(feature = "http")]
        Command::Pair(arguments) => pair::run(&arguments),
        Command::Survey(arguments) => survey::run(&arguments),
        Command::Map(arguments) => map::run(&arguments),
        Command::Export(arguments) => export::run(&arguments),
        Command::Refine(arguments) => refine::run(&arguments),
        Command::Freeze(arguments) => freeze::run(&arguments),
        Command::Timecode(arguments) => timecode::run(&arguments),
        Command::Completions(arguments) => completions::run(&arguments),
        Command::Man(arguments) => man::run(&arguments),
        Command::Demo(arguments) => demo::run(&arguments).map_err(Failure::from),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) if failure.is_closed_pipe() => ExitCode::SUCCESS,
        Err(failure) => {
            // Write it in one piece, and not with eprintln!, which panics if stderr is closed.
            let sentence = format!("stagepose: {}\n", printable(&failure.to_string()));
            let _ = io::stderr().write_all(sentence.as_bytes());
            failure.exit_code()
        }
    }
}

/// Prints help, the version, or the usage error. If an argument has control characters, the text,
/// which may repeat it, is printed without colours and escaped.
fn print_usage(error: &clap::Error) -> io::Result<()> {
    if std::env::args_os().all(|argument| argument.to_string_lossy().chars().all(stands_for_itself)) {
        return error.print();
    }
    let text = error.render().to_string();
    let text = printable_lines(&text);
    if error.use_stderr() { io::stderr().write_all(text.as_bytes()) } else { io::stdout().write_all(text.as_bytes()) }
}
