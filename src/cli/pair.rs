//! `pair`: prints the code that lets a browser on another machine in.

use std::path::{Path, PathBuf};

use super::failure::Failure;
use super::output_file::print;
use crate::daemon::state_folder;
use crate::safe_file;
use crate::web::code_file;

/// Maximum bytes read of the code file, more than a code has. Raised, a wrong file is read further.
const MAX_BYTES: u64 = 64;

/// Print the code that lets a browser on another machine change things.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  stagepose pair\n\n\
    Run it on the daemon's machine, as the daemon's user or as root, and type the code into the page. Each code is used once.")]
pub(super) struct PairArguments {
    /// The port of the daemon's server
    #[arg(long, value_name = "N", default_value_t = 8090)]
    port: u16,
    /// The daemon's state folder [default: the service's /var/lib/stagepose if it has a code there,
    /// else this user's]
    #[arg(long, value_name = "FOLDER")]
    state: Option<PathBuf>,
}

pub(super) fn run(arguments: &PairArguments) -> Result<(), Failure> {
    let of_service = || Some(PathBuf::from("/var/lib/stagepose")).filter(|folder| code_file(folder, arguments.port).exists());
    let folder = arguments.state.clone().or_else(of_service).unwrap_or_else(state_folder);
    let file = code_file(&folder, arguments.port);
    let bytes = safe_file::read(&file, MAX_BYTES).map_err(|e| missing(&file, &e))?;
    let code: String = bytes.iter().map(|b| char::from(*b)).filter(char::is_ascii_digit).collect();
    print(format!("{} {}\n", code.get(..4).unwrap_or(""), code.get(4..).unwrap_or("")).as_bytes())
}

fn missing(file: &Path, error: &std::io::Error) -> Failure {
    let hint = "start the daemon with [http] in its config, and run this as its user or as root, with its --port";
    Failure::Pairing(format!("no code is kept in {} ({error}); {hint}", file.display()))
}
