//! `delay --clock`: how late a camera's stamps are, from a clip that films the page's clock.

use std::fmt::Write as _;
use std::path::Path;

use serde_json::json;

use super::filmed::USUAL_READOUT_S;
use super::report::{Configured, latency_section};
use super::{DelayArguments, concluded, refused};
use crate::capture::EntryContent;
use crate::cli::clip_rows::{self, RowCount};
use crate::cli::failure::Failure;
use crate::config::Settings;
use crate::daemon::utc_ahead_of_clip_ns;
use crate::delay::Verdict;
use crate::delay::filmed_clock::{Lateness, Look, MIN_LOOKS, find_code, judge_lateness, measure_lateness, read};

/// Lag of a screen, and its sigma, unless it is entered, seconds: from drawing to light, of usual
/// monitors and tablets.
const USUAL_LAG_S: [f64; 2] = [0.015, 0.015];
/// Sigma of an entered lag, seconds. Raised, screens that were measured are trusted less.
const ENTERED_LAG_SIGMA_S: f64 = 0.0005;

/// What a clip shows of the clock.
struct Filmed {
    rows: usize,
    looks: Vec<Look>,
    /// Sigma of when the code's rows were exposed, seconds.
    row_sigma_s: f64,
    /// Whether the clip says how its clock relates to UTC.
    has_utc: bool,
}

impl Filmed {
    /// Reads a clip.
    fn of(settings: &Settings, clip: &Path) -> Result<Self, Failure> {
        if clip == Path::new("-") {
            return Err(Failure::Usage("the clip is -; it must be a file or a folder".to_owned()));
        }
        let mut source = clip_rows::open(settings, clip, None)?;
        let height = f64::from(source.size().1);
        let ahead_ns = utc_ahead_of_clip_ns(clip);
        let readout_s = settings.shutter.readout_s;
        let (mut count, mut looks, mut share_sum) = (RowCount::default(), Vec::new(), 0.0);
        while let Some(row) = source.next_entry() {
            count.add(&row)?;
            let EntryContent::Frame(frame) = &row.content else { continue };
            let Some(reading) = find_code(&frame.image).and_then(|placed| read(&frame.image, &placed)) else { continue };
            // A stamp is that of the middle row.
            let share = (reading.row_px + 0.5) / height - 0.5;
            share_sum += share;
            let stamp = row.timestamp.after_ns(ahead_ns.unwrap_or(0)).after_s(share * readout_s.unwrap_or(0.0));
            looks.push(Look { stamp_s: stamp.seconds(), reading });
        }
        let mean_share = share_sum / looks.len().max(1) as f64;
        let row_sigma_s = readout_s.map_or(USUAL_READOUT_S * mean_share.abs(), |_| 0.0);
        Ok(Self { rows: count.finish(clip)?, looks, row_sigma_s, has_utc: ahead_ns.is_some() })
    }
}

/// The measurement, ready to print.
struct LatenessReport<'a> {
    filmed: &'a Filmed,
    found: Lateness,
    /// Delay of the stamps after the exposure and its sigma, seconds; `None` without UTC.
    delay_s: Option<[f64; 2]>,
    verdict: Verdict,
    reasons: Vec<String>,
    configured: Configured<'a>,
    clip: &'a Path,
}

impl LatenessReport<'_> {
    fn text(&self) -> String {
        let Self { filmed, found, delay_s, verdict, reasons, .. } = self;
        let mut text = String::new();
        let (looks, rows, clip) = (found.looks, filmed.rows, self.clip.display());
        let _ = writeln!(text, "clock     {clip}: {looks} of {rows} frames show it, {} of them as it changed", found.changes);
        match delay_s {
            Some([delay, sigma]) => {
                let _ = writeln!(text, "delay     {:+.2} ms: stamps are that much later than the exposure", delay * 1e3);
                let _ = writeln!(text, "  sigma   {:.2} ms, with the screen's lag; {:.2} ms without", sigma * 1e3, found.sigma_s * 1e3);
            }
            None => text.push_str("delay     not known\n"),
        }
        let _ = writeln!(text, "spread    {:.2} ms from stamp to stamp", found.spread_s * 1e3);
        let [drift, sigma] = found.drift.map(|per_s| per_s * 6e4);
        let _ = writeln!(text, "drift     {drift:+.2} ms a minute, sigma {sigma:.2} ms");
        let _ = writeln!(text, "late      {} frames that show another time than their stamps say", found.late);
        let _ = writeln!(text, "verdict   {verdict}");
        reasons.iter().for_each(|reason| {
            let _ = writeln!(text, "          {reason}");
        });
        if let (Some([delay, _]), false) = (delay_s, *verdict == Verdict::DoNotUse) {
            // A camera cannot be early: below zero, the screen's lag is smaller than entered.
            text.push_str(&latency_section(self.configured, delay.max(-self.configured.latency_s)));
        }
        text
    }

    fn json(&self) -> String {
        let Self { filmed, found, delay_s, verdict, reasons, .. } = self;
        let json = json!({
            "delay_s": delay_s.map(|[delay, _]| delay),
            "sigma_s": delay_s.map(|[_, sigma]| sigma),
            "verdict": verdict.to_string(),
            "reasons": reasons,
            "spread_s": found.spread_s,
            "drift_s_per_min": found.drift[0] * 60.0,
            "drift_sigma_s_per_min": found.drift[1] * 60.0,
            "frames": filmed.rows,
            "with_clock": found.looks,
            "with_change": found.changes,
            "late": found.late,
            "hold_s": found.hold_s,
        });
        format!("{json:#}\n")
    }
}

/// Measures how late the stamps of a clip are that films the page's clock.
pub(super) fn run(arguments: &DelayArguments, settings: &Settings) -> Result<(), Failure> {
    let filmed = Filmed::of(settings, &arguments.clip)?;
    let Some(found) = measure_lateness(&filmed.looks, settings.shutter.exposure_s) else {
        return Err(refusal(&filmed, arguments));
    };
    let [lag_s, lag_sigma_s] = arguments.screen_lag_ms.map_or(USUAL_LAG_S, |ms| [1e-3 * ms, ENTERED_LAG_SIGMA_S]);
    let sigma_s = found.sigma_s.hypot(lag_sigma_s).hypot(filmed.row_sigma_s);
    let delay_s = filmed.has_utc.then_some([found.delay_s - lag_s, sigma_s]);
    let (verdict, reasons) = judge_lateness(&found, delay_s.map(|[_, sigma]| sigma));
    let configured = Configured::of(&arguments.config, settings);
    let report = LatenessReport { filmed: &filmed, found, delay_s, verdict, reasons, configured, clip: &arguments.clip };
    concluded(verdict, &report.text(), report.json(), arguments)
}

/// Returns why a clip does not show enough, with what to do.
fn refusal(filmed: &Filmed, arguments: &DelayArguments) -> Failure {
    let (looks, rows, clip) = (filmed.looks.len(), filmed.rows, arguments.clip.display());
    let sentence = if looks < MIN_LOOKS {
        format!(
            "{clip}: {looks} of {rows} frames show the clock, {MIN_LOOKS} are needed; open the page's clock on a screen, and film it so that \
             it is sharp and at least a sixth of the picture wide, with its white margin"
        )
    } else {
        format!("{clip}: the clock stands still; film it while the page shows it, for ten seconds or more")
    };
    refused(sentence, arguments)
}
