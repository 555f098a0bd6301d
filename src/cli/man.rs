//! `stagepose man`: the manual pages, one per command, from the same texts as `--help`.

use std::fs;
use std::io::{self, Write};
use std::path::PathBuf;

use clap::{Command, CommandFactory};
use clap_mangen::Man;

use super::output_file::print;
use super::{Arguments, Failure};
use crate::safe_file;

/// Write the manual pages, one per command.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  stagepose man ~/.local/share/man/man1 && man stagepose-replay\n\nThe Debian package brings them.")]
pub(super) struct ManArguments {
    /// The folder; it is created if it is missing, and pages of the same names are replaced
    folder: PathBuf,
}

pub(super) fn run(arguments: &ManArguments) -> Result<(), Failure> {
    let folder = &arguments.folder;
    fs::create_dir_all(folder).map_err(Failure::output(folder))?;
    let mut program = Arguments::command().disable_help_subcommand(true);
    program.build();
    let pages = pages(&program).map_err(Failure::output(folder))?;
    for (name, page) in &pages {
        let file = folder.join(name);
        safe_file::replace(&file).and_then(|mut to| to.write_all(page)).map_err(Failure::output(&file))?;
    }
    print(format!("{} pages in {}\n", pages.len(), folder.display()))
}

/// Returns file names and texts: the program's page, then one page per command.
fn pages(program: &Command) -> io::Result<Vec<(String, Vec<u8>)>> {
    let name = program.get_name();
    let mut pages = vec![page(program.clone(), name)?];
    for command in program.get_subcommands().filter(|c| !c.is_hide_set()) {
        pages.push(page(command.clone(), &format!("{name}-{}", command.get_name()))?);
    }
    Ok(pages)
}

fn page(command: Command, name: &str) -> io::Result<(String, Vec<u8>)> {
    let version = concat!("stagepose ", env!("CARGO_PKG_VERSION"));
    let man = Man::new(command).title(name).source(version).manual("stagepose manual");
    let mut text = Vec::new();
    man.render(&mut text)?;
    Ok((format!("{name}.1"), text))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_command_has_a_page_with_its_options_and_its_example() {
        let mut program = Arguments::command().disable_help_subcommand(true);
        program.build();
        let pages = pages(&program).unwrap();
        assert_eq!(pages.len(), 1 + program.get_subcommands().count());
        for (name, text) in &pages {
            let text = String::from_utf8_lossy(text);
            assert!(text.starts_with(".ie") && text.contains(".SH SYNOPSIS"), "{name}");
            assert!(text.contains("Example:"), "{name} has no example");
        }
        let replay = pages.iter().find(|(name, _)| name == "stagepose-replay.1").expect("a page of replay");
        assert!(String::from_utf8_lossy(&replay.1).contains("\\-\\-poses"));
    }
}
