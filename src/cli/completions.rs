//! `stagepose completions`: scripts for shells to complete commands and options.

use clap::CommandFactory;
use clap_complete::Shell;

use super::output_file::print;
use super::{Arguments, Failure};

/// Print the completion script for a shell.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  stagepose completions bash > ~/.local/share/bash-completion/completions/stagepose\n\n\
    zsh: into a file _stagepose in a folder of $fpath. fish: ~/.config/fish/completions/stagepose.fish.\n\
    The Debian package brings those of bash, zsh and fish.")]
pub(super) struct CompletionsArguments {
    /// The shell
    #[arg(value_enum, value_name = "SHELL", ignore_case = true)]
    shell: Shell,
}

pub(super) fn run(arguments: &CompletionsArguments) -> Result<(), Failure> {
    // Generate into memory first: the generator panics if its output cannot be written, and a
    // closed pipe is not an error.
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut Arguments::command(), "stagepose", &mut script);
    print(script)
}
