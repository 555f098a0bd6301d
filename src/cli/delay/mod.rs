//! `delay`: measures how much later one camera's stamps are than another's (contract C14), or than
//! the exposure.

mod filmed;
mod filmed_clock;
mod report;

use std::path::{Path, PathBuf};

use super::calibrate::write_whole;
use super::failure::Failure;
use super::interrupt;
use super::logging::{self, LogArguments};
use super::output_file::print;
use super::pose_log::delay_range;
use super::spared::Spared;
use crate::config::Settings;
use crate::delay::{Delay, Side, Undetermined, Verdict, judge, measure_delay};
use crate::frame::Timestamp;
use crate::printable::printable_lines;
use filmed::{Filmed, clip_turns, log_turns};
use report::{Configured, DelayReport, refused_json};

/// Measure how much later one camera's stamps are than another's, from clips of the same pans.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  stagepose delay --config tracking.toml --clip a --with filming.toml --with-clip b\n\nBolt both cameras to \
                        one rig and let both record, with stamps of one clock, while somebody pans back and forth for five to ten seconds: \
                        sharply, with halts of different lengths. A config with a stage and a calibration is tracked; one with only a \
                        lens (a calibration or fov_deg) may film anything. --with-log compares with the log of another tracker instead: \
                        a TUM trajectory (t tx ty tz qx qy qz qw), a pose record (.jsonl), or FreeD packets captured by tcpdump (.pcap).\nPrints the \
                        delay, its uncertainty, and the lines for the configs.\n\n  stagepose delay --config camera.toml --clip a --clock\n\nmeasures \
                        one camera alone: the clip films the clock that the page shows."
)]
pub(super) struct DelayArguments {
    /// The config of the first camera, whose stamps are the reference
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// The first camera's clip
    #[arg(long, value_name = "CLIP")]
    clip: PathBuf,
    /// The config of the second camera, whose delay is measured
    #[arg(long, value_name = "FILE", required_unless_present_any = ["with_log", "clock"], requires = "with_clip")]
    with: Option<PathBuf>,
    /// The second camera's clip
    #[arg(long, value_name = "CLIP", requires = "with")]
    with_clip: Option<PathBuf>,
    /// The log of another tracker, instead of a second clip
    #[arg(long, value_name = "FILE", conflicts_with_all = ["with", "with_clip"])]
    with_log: Option<PathBuf>,
    /// Measure one camera alone: its clip films the page's clock (Health, "Clock to film") on any
    /// screen, for ten seconds or more
    #[arg(long, conflicts_with_all = ["with", "with_clip", "with_log", "range_s"])]
    clock: bool,
    /// The screen's lag from drawing to light, milliseconds [default: 15, with a sigma of 15]
    #[arg(long, value_name = "MS", requires = "clock", value_parser = screen_lag)]
    screen_lag_ms: Option<f64>,
    /// Largest delay that is looked for, in either direction, seconds
    #[arg(long, value_name = "S", default_value_t = 2.0, value_parser = delay_range)]
    range_s: f64,
    /// Write the result as JSON
    #[arg(long, value_name = "OUT.json")]
    json: Option<PathBuf>,
    #[command(flatten)]
    log: LogArguments,
}

/// Reads the lag of a screen.
fn screen_lag(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|ms| (0.0..=500.0).contains(ms)).ok_or_else(|| "give milliseconds from 0 to 500".to_owned())
}

/// The second camera: its config and clip, or the log of another tracker.
enum Second<'a> {
    Clip(&'a Path, Box<Settings>, &'a Path),
    Log(&'a Path),
}

impl<'a> Second<'a> {
    fn of(arguments: &'a DelayArguments) -> Result<Self, Failure> {
        match (&arguments.with, &arguments.with_clip, &arguments.with_log) {
            (Some(config), Some(clip), _) => Ok(Self::Clip(config, Box::new(Settings::load_camera(config)?), clip)),
            (_, _, Some(log)) => Ok(Self::Log(log)),
            _ => Err(Failure::Usage(
                "give the second camera: --with FILE and --with-clip CLIP, or --with-log FILE; or --clock for one camera".to_owned(),
            )),
        }
    }

    fn spared(&self, spared: Spared) -> Spared {
        match self {
            Self::Clip(_, settings, clip) => spared.with_files(&settings.files, "a file of the config").with_clip(clip),
            Self::Log(log) => spared.with_files([&log.to_path_buf()], "the log"),
        }
    }

    /// Measures its rotations; `first` is the other camera's clip, with its first stamp.
    fn turns(&self, first: &Path, origin: Timestamp) -> Result<Filmed, Failure> {
        match self {
            Self::Clip(_, settings, clip) => clip_turns(settings, clip, Some(origin)),
            Self::Log(log) => log_turns(log, first, origin),
        }
    }

    fn configured(&self) -> Option<Configured<'_>> {
        match self {
            Self::Clip(config, settings, _) => Some(Configured::of(config, settings)),
            Self::Log(_) => None,
        }
    }
}

pub(super) fn run(arguments: &DelayArguments) -> Result<(), Failure> {
    let first = Settings::load_camera(&arguments.config)?;
    let second = if arguments.clock { None } else { Some(Second::of(arguments)?) };
    logging::start_for_trials(&arguments.log, first.log);
    first.warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
    interrupt::watch();
    let spared = Spared::default().with_files(&first.files, "a file of the config").with_clip(&arguments.clip);
    let mut spared = second.iter().fold(spared, |spared, second| second.spared(spared));
    if let Some(file) = &arguments.json {
        spared.claim("--json", file)?;
    }
    let Some(second) = second else { return filmed_clock::run(arguments, &first) };
    let filmed = clip_turns(&first, &arguments.clip, None)?;
    let other = second.turns(&arguments.clip, filmed.origin)?;
    let measured = measure_delay(&filmed.turns, &other.turns, arguments.range_s);
    let delay = measured.map_err(|why| refusal(why, &filmed, &other, arguments))?;
    let delay = of_middle_rows(delay, &filmed, &other);
    let (verdict, reasons) = judge(&delay);
    let report = DelayReport {
        delay: &delay,
        verdict,
        reasons,
        filmed: [&filmed, &other],
        first: Configured::of(&arguments.config, &first),
        second: second.configured(),
        delay_of_mount: first.mount.as_ref().map(|mount| mount.delay.as_secs_f64()),
    };
    concluded(verdict, &report.text(), report.json(), arguments)
}

/// Prints a measurement, and writes its JSON; the failure of a delay that should not be used.
fn concluded(verdict: Verdict, text: &str, json: String, arguments: &DelayArguments) -> Result<(), Failure> {
    if let Some(file) = &arguments.json {
        write_whole(file, json)?;
    }
    print(printable_lines(text).as_bytes())?;
    match verdict {
        Verdict::DoNotUse => Err(Failure::Delay("the delay is not known well enough to be used; the reasons say what to film".to_owned())),
        Verdict::Good | Verdict::Usable => Ok(()),
    }
}

/// Writes the JSON of a delay that cannot be measured, and returns the failure with this sentence.
fn refused(sentence: String, arguments: &DelayArguments) -> Failure {
    let written = arguments.json.as_ref().map_or(Ok(()), |file| write_whole(file, refused_json(&sentence)));
    written.map_or_else(|failure| failure, |()| Failure::Delay(sentence))
}

/// Returns the delay between the middle rows, to which stamps belong, from that between the rows in
/// which rotations were seen.
fn of_middle_rows(delay: Delay, first: &Filmed, second: &Filmed) -> Delay {
    let [(first_s, first_sigma), (second_s, second_sigma)] = [first.row_delay_s(), second.row_delay_s()];
    let sigma_s = delay.sigma_s.hypot(first_sigma).hypot(second_sigma);
    Delay { delay_s: delay.delay_s + second_s - first_s, sigma_s, ..delay }
}

/// Returns why a delay cannot be measured, with what to do.
fn refusal(why: Undetermined, first: &Filmed, second: &Filmed, arguments: &DelayArguments) -> Failure {
    let of = |side: Side| if side == Side::First { first } else { second };
    let sharply = "pan the rig to and fro sharply for five to ten seconds, at 20 degrees per second or more";
    let fix = match why {
        Undetermined::Nothing(side) => format!("{}; {}", of(side).seen(), of(side).hint()),
        Undetermined::Apart { .. } => "record both with stamps of one clock, at the same time".to_owned(),
        Undetermined::TooFew { .. } => format!("{}; {}; let both record the same five to ten seconds", first.seen(), second.seen()),
        Undetermined::TooSlow { .. } => sharply.to_owned(),
        Undetermined::Unlike { .. } => "check that both cameras are bolted to one rig and recorded the same pans, and give a larger \
                                        --range-s if the delay may be longer"
            .to_owned(),
        Undetermined::AtTheEnd(_) => "give a larger --range-s".to_owned(),
    };
    refused(format!("{why}; {fix}"), arguments)
}
