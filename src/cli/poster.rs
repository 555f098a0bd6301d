//! `stagepose poster`: a picture to print that is easy to track.

use std::io::{self, Cursor};
use std::path::{Path, PathBuf};

use image::ImageFormat;

use super::calibrate::write_whole;
use super::failure::Failure;
use super::output_file::print;
use crate::targets::paper::Paper;
use crate::targets::{pdf, poster, poster_sheet, svg};

/// Write a picture to print that tracks well from near and far, with a ruler, and print the lines
/// for the config.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  stagepose poster --paper a3 -o poster.pdf\n\n\
    Writes the page to print (poster.pdf) and, beside it, the picture alone (poster-picture.png): the config's `image`. Prints the lines for \
    the config. Print at 100 %, measure the ruler, and glue the sheet on something flat. Each seed is another picture; a stage with two posters \
    needs two seeds.")]
pub(super) struct PosterArguments {
    /// a0 to a5, letter, legal, tabloid, or a size such as "500x700 mm"
    #[arg(long, value_name = "PAPER")]
    paper: String,
    /// Use the paper in landscape orientation
    #[arg(long)]
    landscape: bool,
    /// Seed of the picture: every number gives a different one
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// The page to write: .pdf, or .svg (which needs its picture file next to it)
    #[arg(long, short, value_name = "FILE.pdf|FILE.svg")]
    output: PathBuf,
}

pub(super) fn run(arguments: &PosterArguments) -> Result<(), Failure> {
    let mut paper = Paper::parse(&arguments.paper).map_err(|e| Failure::Usage(e.to_string()))?;
    if arguments.landscape && paper.size_mm[0] < paper.size_mm[1] {
        paper = paper.turned();
    }
    let file = &arguments.output;
    let form = PageForm::of(file)?;
    let beside = file.with_file_name(format!("{}-picture.png", file.file_stem().unwrap_or_default().to_string_lossy()));
    let image = beside.file_name().unwrap_or_default().to_string_lossy();
    let [width, height] = poster_sheet::picture_px(paper);
    let picture = poster::paint(width, height, arguments.seed);
    let mut png = Cursor::new(Vec::new());
    picture.write_to(&mut png, ImageFormat::Png).map_err(io::Error::other).map_err(Failure::output(&beside))?;
    write_whole(&beside, png.get_ref())?;
    let page = poster_sheet::page(paper, arguments.seed, &image);
    match form {
        PageForm::Pdf => write_whole(file, pdf::write(&page, Some(&picture)))?,
        PageForm::Svg => write_whole(file, svg::write(&page, &image))?,
    }
    let [across, down] = poster_sheet::picture_mm(paper);
    let text = format!(
        "# {}: print it at 100 % on paper of {} x {} mm; the picture is then {across} x {down} mm.\n# {} is the picture itself; keep it beside the config.\n{}",
        file.display(),
        paper.size_mm[0],
        paper.size_mm[1],
        beside.display(),
        poster_sheet::snippet(paper, &image),
    );
    print(text)
}

/// File format of a page.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PageForm {
    Pdf,
    Svg,
}

impl PageForm {
    /// Returns the format for a file's extension.
    pub(super) fn of(file: &Path) -> Result<Self, Failure> {
        let extension = file.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
        match extension.as_str() {
            "pdf" => Ok(Self::Pdf),
            "svg" => Ok(Self::Svg),
            _ => Err(Failure::Usage(format!("--output is {}; give a file that ends in .pdf or .svg", file.display()))),
        }
    }
}
