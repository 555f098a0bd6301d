//! `compare-poses`: how far another tracker's poses are from ours.

mod report;

use std::path::PathBuf;

use super::calibrate::write_whole;
use super::failure::Failure;
use super::logging::{self, LogArguments};
use super::output_file::print;
use super::pose_log::{self, delay_range};
use super::spared::Spared;
use crate::config::LogSettings;
use crate::delay::log::PoseLog;
use crate::delay::{Turns, Verdict, measure_delay};
use crate::other_tracker::{Differences, aligned, judged, pairs};
use crate::printable::printable_lines;
use report::{Clocks, Comparison, Shift};

/// Compare our poses with those of another tracker, after aligning the two.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  stagepose compare-poses poses.jsonl other.pcap --json differences.json\n\nBolt both trackers to one rig, and \
                        move, pan, tilt and roll it while both are logged. Each log is a pose record (.jsonl), a TUM trajectory (t tx ty tz \
                        qx qy qz qw), or a capture of FreeD or OpenTrackIO packets by tcpdump (.pcap).\nThe trackers' frames, and where \
                        each has its sensor, need not be known: both are fitted, and so is the delay between the stamps. Prints the \
                        remaining differences, axis by axis, and how far the trackers agree."
)]
pub(super) struct ComparePosesArguments {
    /// Our poses, from `replay --poses`
    ours: PathBuf,
    /// The other tracker's log
    others: PathBuf,
    /// Take this as the delay of the other's stamps, seconds, instead of measuring it
    #[arg(long, value_name = "S", allow_negative_numbers = true, value_parser = delay)]
    delay_s: Option<f64>,
    /// Largest delay that is looked for, in either direction, seconds
    #[arg(long, value_name = "S", default_value_t = 2.0, value_parser = delay_range)]
    range_s: f64,
    /// Write the result as JSON
    #[arg(long, value_name = "OUT.json")]
    json: Option<PathBuf>,
    #[command(flatten)]
    log: LogArguments,
}

fn delay(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|s: &f64| s.abs() <= 60.0).ok_or_else(|| "give seconds from -60 to 60".to_owned())
}

pub(super) fn run(arguments: &ComparePosesArguments) -> Result<(), Failure> {
    logging::start(&arguments.log, LogSettings::default());
    let mut spared = Spared::default().with_files([&arguments.ours, &arguments.others], "a log");
    if let Some(file) = &arguments.json {
        spared.claim("--json", file)?;
    }
    let read = |file| pose_log::read(file, Failure::PoseComparison);
    let (ours, mut others) = (read(&arguments.ours)?, read(&arguments.others)?);
    let clocks = if ours.is_utc == others.is_utc { Clocks::Same } else { Clocks::Apart };
    // Stamps of two clocks are compared from the first row of each.
    let (first, first_of_others) = (ours.rows[0].at, others.rows[0].at);
    if clocks == Clocks::Apart {
        let ahead_ns = first_of_others.ns_since(first);
        others.rows.iter_mut().for_each(|row| row.at = row.at.after_ns(ahead_ns.saturating_neg()));
    }
    let turns = |log: &PoseLog| Turns::of_orientations(first, log.rows.iter().map(|row| (row.at, row.rotation)));
    let shift = match arguments.delay_s {
        Some(delay_s) => Shift::Given(delay_s),
        None => match measure_delay(&turns(&ours), &turns(&others), arguments.range_s) {
            Ok(delay) => Shift::Measured { delay_s: delay.delay_s, sigma_s: delay.sigma_s },
            Err(why) => Shift::Unknown(why.to_string()),
        },
    };
    let pairs = pairs(&ours.rows, &others.rows, shift.delay_s());
    let alignment = aligned(&pairs).map_err(|why| Failure::PoseComparison(why.to_string()))?;
    let differences = Differences::of(&pairs, &alignment);
    let (verdict, reasons) = judged(&differences);
    let comparison = Comparison {
        files: [arguments.ours.display().to_string(), arguments.others.display().to_string()],
        rows: [ours.rows.len(), others.rows.len()],
        clocks,
        shift,
        alignment,
        differences,
        verdict,
        reasons,
    };
    if let Some(file) = &arguments.json {
        write_whole(file, comparison.json())?;
    }
    print(printable_lines(&comparison.text()).as_bytes())?;
    match comparison.verdict {
        Verdict::DoNotUse => Err(Failure::PoseComparison("the trackers do not agree well enough to stand in for each other".to_owned())),
        _ => Ok(()),
    }
}
