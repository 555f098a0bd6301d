//! `stagepose board`: the chessboard to print.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use super::calibrate::write_whole;
use super::failure::Failure;
use crate::calibrate::board::Board;
use crate::calibrate::sheet;

/// Write a chessboard to print, with a ruler to check the printer's scale.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  stagepose board --board 9x6 --square-mm 25 -o board.svg\n\n\
    Print at 100 %, measure the ruler, and glue the sheet on something flat. A board with one odd and one even number (9x6, 8x5) has one \
    origin only; others look the same turned around.")]
pub(super) struct BoardArguments {
    /// INNER corners along its sides
    #[arg(long, value_name = "NxM")]
    board: String,
    /// Side of a square in millimetres
    #[arg(long, value_name = "MM", allow_negative_numbers = true)]
    square_mm: f64,
    /// Write to this file [default: stdout]
    #[arg(long, short, value_name = "FILE.svg")]
    output: Option<PathBuf>,
}

pub(super) fn run(arguments: &BoardArguments) -> Result<(), Failure> {
    let board = Board::parse(&arguments.board, arguments.square_mm).map_err(|e| Failure::Usage(e.to_string()))?;
    let text = sheet::svg(&board);
    match &arguments.output {
        Some(file) => write_whole(file, &text),
        None => io::stdout().write_all(text.as_bytes()).map_err(Failure::output(Path::new("stdout"))),
    }
}
