//! `mount`: measures where the filming camera sits on the rig, from clips that both cameras took of
//! still views.

mod measure;
mod report;

use std::path::PathBuf;

use nalgebra::Matrix6;

use super::calibrate::write_whole;
use super::failure::Failure;
use super::interrupt;
use super::logging::{self, LogArguments};
use super::output_file::print;
use super::spared::Spared;
use crate::config::Settings;
use crate::mount::{
    ObservationModel, Solution, Stages, StillPair, Unpaired, Unsolvable, Verdict, View, ViewPair, is_doubt_of_lenses, judge, next_view,
    solve, still_pairs,
};
use crate::printable::printable_lines;
use crate::publish::BodyChoice;
use measure::{Measured, measure};
use report::MountReport;

/// Measure where the filming camera sits next to the tracking camera, from still views that both
/// took.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  stagepose mount --config tracking.toml --clip a --with filming.toml --clip b\n\nBolt both cameras to \
                        the rig, put it in five or six places, and let each camera take a picture or a few seconds of film in every \
                        place, the rig standing still. The first --clip is the tracking camera's, the second the filming camera's: \
                        folders of pictures in the same order, or films. Both configs describe the same stage, each with its own camera's \
                        calibration. Where the cameras cannot see one stage, hang a separate board (a poster, say) in front of each, \
                        describe it in that camera's config, and add --own-boards; the rig must then pan, tilt and roll between the \
                        views.\nPrints the [mount] section for the tracking camera's config, and judges the one that is there.")]
pub(super) struct MountArguments {
    /// The tracking camera's config
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// The clips: first the tracking camera's, then the filming camera's
    #[arg(long, value_name = "CLIP", required = true)]
    clip: Vec<PathBuf>,
    /// The filming camera's config
    #[arg(long, value_name = "FILE")]
    with: PathBuf,
    /// Each camera sees its own board: the two configs have different stage frames
    #[arg(long)]
    own_boards: bool,
    /// Write the result as JSON
    #[arg(long, value_name = "OUT.json")]
    json: Option<PathBuf>,
    #[command(flatten)]
    log: LogArguments,
}

pub(super) fn run(arguments: &MountArguments) -> Result<(), Failure> {
    let [clip, other_clip] = &arguments.clip[..] else {
        let hint = "give --clip twice: the tracking camera's clip, then the filming camera's";
        return Err(Failure::Usage(format!("--clip is there {} times; {hint}", arguments.clip.len())));
    };
    let (settings, other) = (Settings::load(&arguments.config)?, Settings::load(&arguments.with)?);
    logging::start_for_trials(&arguments.log, settings.log);
    interrupt::watch();
    let read = settings.files.iter().chain(&other.files).cloned().collect::<Vec<_>>();
    let mut spared = Spared::default().with_files(&read, "a file of the configs").with_clip(clip).with_clip(other_clip);
    if let Some(file) = &arguments.json {
        spared.claim("--json", file)?;
    }
    let tracking = measure(&settings, clip)?;
    let filming = measure(&other, other_clip)?;
    let stages = if arguments.own_boards { Stages::Apart } else { Stages::Shared };
    let pairs = paired(&tracking, &filming, [clip, other_clip])?;
    let complete: Vec<ViewPair> = pairs.iter().filter_map(complete_pair).collect();
    let solution = solve(&complete, stages).map_err(|why| unsolvable(why, &pairs, arguments))?;
    let models = [
        ObservationModel { camera: &tracking.camera, stage: &settings.stage },
        ObservationModel { camera: &filming.camera, stage: &other.stage },
    ];
    // The lenses' uncertainty is common to all views and does not shrink with their number.
    let by_lenses = lens_doubt(models, &complete, &solution);
    let covariance = solution.covariance + by_lenses;
    let (verdict, reasons) = judge(&solution, &by_lenses);
    let is_doubt_of_lenses = is_doubt_of_lenses(&solution, &by_lenses);
    let next = next_view(models, &complete, &solution, stages).filter(|_| !is_doubt_of_lenses);
    let report = MountReport {
        mount: &solution.mount,
        covariance,
        solution: &solution,
        pairs: &pairs,
        verdict,
        reasons,
        next,
        // A mount on an object is a different one.
        typed: settings.mount.as_ref().filter(|typed| typed.mount.carrier == BodyChoice::Camera),
        lens: other.lens.calibration_file(),
        tracking_config: &arguments.config,
    };
    if let Some(file) = &arguments.json {
        write_whole(file, report.json())?;
    }
    print(printable_lines(&(report.text() + "\n")).as_bytes())?;
    match verdict {
        Verdict::DoNotUse if is_doubt_of_lenses => Err(Failure::Mount(
            "the mount is not known well enough to be used, because the lenses are not; calibrate both cameras with `stagepose calibrate`"
                .to_owned(),
        )),
        Verdict::DoNotUse => {
            Err(Failure::Mount("the mount is not known well enough to be used; take the views listed under next".to_owned()))
        }
        Verdict::Good | Verdict::Usable => Ok(()),
    }
}

/// Returns the still views of both clips, paired.
fn paired(tracking: &Measured, filming: &Measured, clips: [&PathBuf; 2]) -> Result<Vec<StillPair>, Failure> {
    still_pairs(&tracking.rows, &filming.rows).map_err(|Unpaired([a, b])| {
        let [clip, other] = clips.map(|clip| clip.display().to_string());
        Failure::Mount(format!(
            "{clip} has {} pictures and {a} standstills of the rig, {other} has {} and {b}; give clips with one picture for each view in \
             the same order, or films of the same standstills, each a second or longer",
            tracking.rows.len(),
            filming.rows.len(),
        ))
    })
}

fn complete_pair(pair: &StillPair) -> Option<ViewPair> {
    let [tracking, filming]: [Option<View>; 2] = pair.views;
    Some(ViewPair { tracking: tracking?, filming: filming? })
}

/// Returns the part of the mount's covariance due to the lenses, as if fully correlated over all
/// views, which is conservative.
fn lens_doubt(models: [ObservationModel<'_>; 2], pairs: &[ViewPair], solution: &Solution) -> Matrix6<f64> {
    let of_pair = |pair: &ViewPair| {
        let doubted = |model: ObservationModel<'_>, view: &View| View { covariance: model.doubt(&view.pose), ..*view };
        let pair = ViewPair { tracking: doubted(models[0], &pair.tracking), filming: doubted(models[1], &pair.filming) };
        pair.mount_covariance(&solution.mount, &solution.between)
    };
    pairs.iter().map(of_pair).sum::<Matrix6<f64>>() / pairs.len().max(1) as f64
}

/// Returns why there is no mount, and what to do.
fn unsolvable(why: Unsolvable, pairs: &[StillPair], arguments: &MountArguments) -> Failure {
    let missing = report::missing(pairs);
    let missing = if missing.is_empty() { String::new() } else { format!(" ({})", missing.join("; ")) };
    let both_see = "or let both cameras see one stage, and omit --own-boards";
    Failure::Mount(match why {
        Unsolvable::TooFew { found, wanted } => format!(
            "both cameras see their stage in {found} of {} pairs of views, {wanted} are needed{missing}; check with `stagepose replay \
             CLIP --config FILE --overlay DIR` what each camera sees",
            pairs.len()
        ),
        Unsolvable::NotRotated { .. } => {
            format!(
                "{why}, which with separate boards does not determine the offset; pan, tilt and roll the rig by 20 degrees or more, \
                 {both_see}"
            )
        }
        Unsolvable::OneAxis { axis, .. } => {
            let (word, others) = report::axis_words(&axis);
            format!(
                "{why} ({word}), which with separate boards does not determine the offset along that axis; add views with the rig \
                 {others} by 20 degrees or more, {both_see}"
            )
        }
        Unsolvable::NoSolution if arguments.own_boards => format!("{why}; check the configs, and that both cameras were bolted to the rig"),
        Unsolvable::NoSolution => format!("{why}; check that both configs describe the same stage frame, or add --own-boards"),
    })
}
