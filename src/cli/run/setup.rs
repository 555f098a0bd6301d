//! `setup`: serves the page for a stage without a valid config. Tracking starts as soon as there is
//! one.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use super::{LiveArguments, live};
use crate::cli::failure::Failure;
use crate::cli::logging::LogArguments;
use crate::config::Settings;

/// Open the page without a config, or with an invalid one; once the page stores a valid config,
/// tracking starts.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  stagepose setup --config stage.toml\n\n\
    It prints the page's address. The page says what is wrong with the config, with file, key and line; once it has a good one, tracking\n\
    begins. For the show: stagepose run --config stage.toml, which refuses a bad config.")]
pub(in crate::cli) struct SetupArguments {
    /// The config file, existing or not; its folder must exist
    #[arg(long, value_name = "FILE", default_value = "stage.toml")]
    config: PathBuf,
    /// The page's address [default: from the config's [http], else 127.0.0.1:8090]
    #[arg(long, value_name = "ADDRESS:PORT")]
    listen: Option<SocketAddr>,
    /// Play a clip as if it were the camera
    #[arg(long, value_name = "CLIP")]
    play: Option<PathBuf>,
    /// Play the clip again and again; each time tracking starts anew
    #[arg(long = "loop", requires = "play")]
    plays_again: bool,
    /// Serve the page from this folder instead of the built-in one, for developing it
    #[arg(long, value_name = "FOLDER")]
    page_dir: Option<PathBuf>,
    #[command(flatten)]
    log: LogArguments,
}

pub(in crate::cli) fn setup(arguments: SetupArguments) -> Result<(), Failure> {
    let SetupArguments { config, listen, play, plays_again, page_dir, log } = arguments;
    let folder = config.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if !folder.is_dir() {
        return Err(Failure::Usage(format!("--config {}: its folder is not there; make it first", config.display())));
    }
    // The address must not change when the config comes: an open page keeps its server.
    let of_config = || Settings::load(&config).ok().and_then(|settings| settings.http);
    let listen = listen.unwrap_or_else(|| of_config().unwrap_or_default().listen);
    let setup = Some(listen);
    live(&LiveArguments { config, poses: None, events: None, threads: None, play, plays_again, seconds: None, page_dir, log, setup }, None)
}
