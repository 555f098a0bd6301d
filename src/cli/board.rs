//! `stagepose board`: a chessboard to print.

use std::path::PathBuf;

use super::calibrate::write_whole;
use super::failure::Failure;
use super::output_file::print;
use super::poster::PageForm;
use crate::calibrate::board::Board;
use crate::targets::paper::Paper;
use crate::targets::{board_sheet, pdf, svg};

/// Write a chessboard to print, with a ruler to check the printer's scale.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  stagepose board --board 9x6 --square-mm 24 --paper a4 -o board.pdf\n\n\
    Print at 100 %, measure the ruler, and glue the sheet on something flat. A board with one odd and one even number (9x6, 8x5) has one \
    origin only; others look the same turned around.")]
pub(super) struct BoardArguments {
    /// Number of INNER corners along the two sides
    #[arg(long, value_name = "NxM")]
    board: String,
    /// Side of a square in millimetres
    #[arg(long, value_name = "MM", allow_negative_numbers = true)]
    square_mm: f64,
    /// Paper that the board must fit at 100 %, with 10 mm margins: a0 to a5, letter, legal,
    /// tabloid, or a size such as "500x700 mm" [default: just large enough for the board]
    #[arg(long, value_name = "PAPER")]
    paper: Option<String>,
    /// Write to this file, as PDF or SVG [default: SVG to stdout]
    #[arg(long, short, value_name = "FILE.pdf|FILE.svg")]
    output: Option<PathBuf>,
}

pub(super) fn run(arguments: &BoardArguments) -> Result<(), Failure> {
    let board = Board::parse(&arguments.board, arguments.square_mm).map_err(|e| Failure::Usage(e.to_string()))?;
    let usage = |sentence: String| Failure::Usage(sentence);
    let page = match &arguments.paper {
        Some(paper) => {
            let paper = Paper::parse(paper).map_err(|e| usage(e.to_string()))?;
            board_sheet::page_on(&board, paper).map_err(|e| usage(e.to_string()))?
        }
        None => board_sheet::page(&board),
    };
    let svg = || svg::write(&page, "");
    match &arguments.output {
        Some(file) => match PageForm::of(file)? {
            PageForm::Pdf => write_whole(file, pdf::write(&page, None)),
            PageForm::Svg => write_whole(file, svg()),
        },
        None => print(svg()),
    }
}
