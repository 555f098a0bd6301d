//! `stagepose calibrate`: turns pictures of a chessboard into a camera calibration and says how far
//! to trust it.

mod colours;
mod compare;
mod json;
mod live;
mod numbers;
mod output;
mod panel;
mod pictures;
mod table;

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use super::failure::Failure;
use super::output_file::print;
use crate::calibrate::board::Board;
use crate::calibrate::judge::Verdict;
use crate::calibrate::report::{self, Comparison};
use crate::calibrate::session::{CameraCalibration, calibrate};
use crate::camera::{Calibration, CalibrationForm, IntrinsicsUncertainty, plausible};
use crate::printable::printable_lines;
use crate::utc;
pub(super) use output::write as write_whole;

/// Calibrate a camera from pictures of a chessboard.
#[derive(Debug, Clone, Args)]
#[command(
    after_help = "Examples:\n  stagepose calibrate pictures/*.jpg --board 9x6 --square-mm 25 --output camera.toml --report report.html\n  \
    stagepose calibrate --clip clip.mp4 --board 9x6 --square-mm 25 --output camera.toml\n  \
    stagepose calibrate --device first --save pictures --board 9x6 --square-mm 25 --output camera.toml\n  \
    stagepose calibrate camera.toml --compare other.yaml\n\n\
    Example:\n  stagepose calibrate pictures --board 9x6 --square-mm 25\n\n\
    Take 10 to 25 pictures: the board in every part of the picture, each of its sides in turn 20 to 45 degrees away from the camera. Lock zoom \
    and focus first. Where the verdict is \"do not use\", --output is not written and the exit code is 1."
)]
pub(super) struct CalibrateArguments {
    /// Pictures, or folders of pictures (with --compare also: one calibration file)
    images: Vec<PathBuf>,
    /// A clip to pick the views from
    #[arg(long)]
    clip: Option<PathBuf>,
    /// A camera that takes the pictures by itself while you move the board as it says: a name from
    /// `stagepose devices`, a number, or first
    #[arg(long, value_name = "NAME", conflicts_with_all = ["images", "clip", "play"])]
    device: Option<String>,
    /// Play a clip as if it were the camera
    #[arg(long, value_name = "CLIP", conflicts_with_all = ["images", "clip"])]
    play: Option<PathBuf>,
    /// With --device: size of the pictures, the same as for tracking [default: the camera's best]
    #[arg(long, value_name = "WxH")]
    size: Option<String>,
    /// With --device or --play: stop after this many pictures, or earlier if the set is good
    #[arg(long, value_name = "N", default_value_t = 25, value_parser = clap::value_parser!(u64).range(3..=40))]
    pictures: u64,
    /// With --device or --play: save the pictures in this folder
    #[arg(long, value_name = "FOLDER")]
    save: Option<PathBuf>,
    /// Number of INNER corners of the board along its two sides, such as 9x6
    #[arg(long, value_name = "NxM")]
    board: Option<String>,
    /// Side of a square in millimetres
    #[arg(long, value_name = "MM", allow_negative_numbers = true)]
    square_mm: Option<f64>,
    /// Write the calibration to this file
    #[arg(long, short, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Format of --output [default: by its name: .toml is stagepose's, .yaml and .yml are OpenCV's]
    #[arg(long, value_name = "FORM")]
    format: Option<OutputForm>,
    /// Write a report with figures, one HTML file
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    /// Write everything as JSON
    #[arg(long, value_name = "OUT.json")]
    json: Option<PathBuf>,
    /// `bouguet`: use every corner and picture, and state uncertainties as Bouguet's toolbox does
    #[arg(long, value_name = "NAME")]
    profile: Option<Profile>,
    /// Hold parameters fixed: fx, fy, cx, cy, k1, k2, p1, p2, with =VALUE for a value other than
    /// the default; `aspect` for fx = fy
    #[arg(long, value_name = "NAME[=VALUE]", value_delimiter = ',', allow_hyphen_values = true)]
    fix: Vec<String>,
    /// Also estimate the skew
    #[arg(long)]
    skew: bool,
    /// Also estimate k3 (for lenses wider than about 90 degrees)
    #[arg(long)]
    k3: bool,
    /// Show the difference from another calibration, pixels over the picture
    #[arg(long, value_name = "FILE")]
    compare: Option<PathBuf>,
    /// Write --output even if the verdict is "do not use"
    #[arg(long)]
    write_anyway: bool,
}

/// Formats of a calibration file that can be written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum OutputForm {
    /// stagepose's own TOML
    Stagepose,
    /// OpenCV's YAML
    Opencv,
    /// ROS's camera_info YAML
    Ros,
}

/// Whose defaults to use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Profile {
    /// Bouguet's toolbox
    Bouguet,
}

/// Runs the command.
///
/// # Errors
/// Bad usage, pictures that yield no calibration, an output that cannot be written, the verdict "do
/// not use".
pub(super) fn run(arguments: &CalibrateArguments) -> Result<(), Failure> {
    if let Some(own) = compare::two_files(arguments) {
        return compare::run(own, arguments);
    }
    if arguments.device.is_none() && arguments.play.is_none() && (arguments.save.is_some() || arguments.size.is_some()) {
        return Err(Failure::Usage("--save and --size are for pictures from a camera; give --device too".to_owned()));
    }
    let board = board_of(arguments)?;
    let options = numbers::options(arguments)?;
    let other = arguments.compare.as_deref().map(compare::read).transpose()?;
    output::refuse_unwritable(arguments)?;
    let pictures = pictures::inspected(arguments, &board)?;
    let mut made = calibrate(&pictures, &board, &options).map_err(|e| Failure::Calibration(e.to_string()))?;
    let Some(calibration) = calibration_of(&made) else {
        return Err(Failure::Calibration("no plausible camera fits the pictures; take sharper ones with more tilt".to_owned()));
    };
    made.lateral_colour = colours::measured(arguments, &made, &pictures)?;
    let comparison = other.map(|other| compare::between(&calibration.model, &other)).transpose()?;
    let is_readable = plausible::judge(&calibration.model).is_ok();
    let accepted = made.judgement.verdict != Verdict::DoNotUse || (arguments.write_anyway && is_readable);
    let mut text = table::table(&made);
    if let Some(comparison) = &comparison {
        text += &compare::table(comparison);
    }
    print(printable_lines(&text).as_bytes())?;
    write_results(arguments, &made, &calibration, comparison.as_ref(), accepted)?;
    if accepted {
        return Ok(());
    }
    let way = if is_readable { " (--write-anyway writes it)" } else { ", because no command would accept it" };
    let kept = arguments.output.as_ref().map_or(String::new(), |file| format!("; {} is not written{way}", file.display()));
    let next = &made.judgement.next_picture;
    Err(Failure::Calibration(format!("{}{kept}; take next: {next}", made.judgement.sentence())))
}

fn write_results(
    arguments: &CalibrateArguments,
    made: &CameraCalibration,
    calibration: &Calibration,
    comparison: Option<&Comparison>,
    accepted: bool,
) -> Result<(), Failure> {
    if let Some(file) = &arguments.json {
        output::write(file, json::text(made, calibration, comparison))?;
    }
    if let Some(file) = &arguments.report {
        output::write(file, report::html(made, comparison, &utc::report_date()))?;
    }
    if let Some(file) = arguments.output.as_ref().filter(|_| accepted) {
        let text = match form_of(file, arguments.format) {
            OutputForm::Stagepose => calibration.to_toml(),
            OutputForm::Opencv => calibration.to_opencv_yaml(),
            OutputForm::Ros => calibration.to_ros_yaml("camera"),
        };
        output::write(file, &text)?;
    }
    Ok(())
}

fn form_of(file: &Path, asked: Option<OutputForm>) -> OutputForm {
    let extension = file.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    let by_name = if matches!(extension.as_str(), "yaml" | "yml") { OutputForm::Opencv } else { OutputForm::Stagepose };
    asked.unwrap_or(by_name)
}

fn board_of(arguments: &CalibrateArguments) -> Result<Board, Failure> {
    let Some(text) = &arguments.board else {
        return Err(Failure::Usage(
            "--board is missing; give the number of INNER corners along both sides, such as --board 9x6".to_owned(),
        ));
    };
    let Some(square_mm) = arguments.square_mm else {
        return Err(Failure::Usage(
            "--square-mm is missing; measure a square of the board and give its side, such as --square-mm 25".to_owned(),
        ));
    };
    Board::parse(text, square_mm).map_err(|e| Failure::Usage(e.to_string()))
}

/// Returns the file's content; `None` if the numbers are not a valid camera.
fn calibration_of(made: &CameraCalibration) -> Option<Calibration> {
    let model = made.estimate.bundle.lens.model(made.size.0, made.size.1).ok()?;
    let u = made.estimate.lens_uncertainty();
    Some(Calibration {
        model,
        uncertainty: Some(IntrinsicsUncertainty {
            focal_px: [u[0], u[1]],
            centre_px: [u[2], u[3]],
            skew: u[4],
            distortion: std::array::from_fn(|k| u[5 + k]),
        }),
        rms_px: Some(made.estimate.rms_px),
        images: Some(made.views.iter().filter(|v| v.used).count() as u32),
        date: Some(utc::date(utc::now_s())),
        form: CalibrationForm::Stagepose,
        notes: Vec::new(),
    })
}
