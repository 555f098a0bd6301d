//! The result as text, as lines for the configs, and as JSON.

use std::fmt::Write as _;
use std::path::Path;

use serde_json::{Value, json};

use super::filmed::Filmed;
use crate::config::Settings;
use crate::delay::{Delay, Rival, Verdict};

/// Largest `[mount] delay_s` and `[camera] latency_s` that a config accepts, seconds.
const LONGEST_OF_MOUNT_S: f64 = 0.5;
const LONGEST_LATENCY_S: f64 = 2.0;
/// Difference from a configured delay that is reported: in sigmas, and seconds at least. Raised,
/// wrong values in configs go unmentioned.
const SAME_SIGMAS: f64 = 3.0;
const SAME_S: f64 = 0.001;

/// A camera's config, and the latency that it states: its clips are corrected by that already.
#[derive(Clone, Copy)]
pub(super) struct Configured<'a> {
    pub config: &'a Path,
    pub latency_s: f64,
}

impl<'a> Configured<'a> {
    pub fn of(config: &'a Path, settings: &Settings) -> Self {
        Self { config, latency_s: settings.device.latency.as_secs_f64() }
    }
}

/// The measurement, ready to print.
pub(super) struct DelayReport<'a> {
    pub delay: &'a Delay,
    pub verdict: Verdict,
    pub reasons: Vec<String>,
    /// The first and the second camera.
    pub filmed: [&'a Filmed; 2],
    /// Their configs; the second is `None` for a log.
    pub first: Configured<'a>,
    pub second: Option<Configured<'a>>,
    /// The delay in the first config's `[mount]`, seconds; `None` without one.
    pub delay_of_mount: Option<f64>,
}

impl DelayReport<'_> {
    pub fn text(&self) -> String {
        let Delay { delay_s, sigma_s, unexplained, used, left_out, span_s, rates, .. } = self.delay;
        let mut text = String::new();
        for (word, filmed, rate) in [("first", self.filmed[0], rates[0]), ("second", self.filmed[1], rates[1])] {
            let _ = writeln!(text, "{word:<9} {}, turning at up to {:.0} degrees per second", filmed.seen(), rate.to_degrees());
        }
        let which = if *delay_s < 0.0 { "first" } else { "second" };
        let _ = writeln!(text, "delay     {:+.2} ms: the {which} camera's stamps are later", delay_s * 1e3);
        let _ = writeln!(text, "  sigma   {:.2} ms", sigma_s * 1e3);
        let left = if *left_out > 0 { format!(", {left_out} left out") } else { String::new() };
        let share = (1.0 - unexplained) * 100.0;
        let _ = writeln!(text, "agreement {share:.2} % of the rotation, {used} frame intervals in {span_s:.1} s{left}");
        let _ = writeln!(text, "verdict   {}", self.verdict);
        self.reasons.iter().for_each(|reason| {
            let _ = writeln!(text, "          {reason}");
        });
        // A log is of another camera than the one on air.
        if let Some(typed) = self.delay_of_mount.filter(|_| self.second.is_some()) {
            let _ = writeln!(text, "config    {}", self.judged(typed));
        }
        if self.verdict != Verdict::DoNotUse {
            text.push_str(&self.sections());
        }
        text
    }

    /// Compares the config's delay with the measured one.
    fn judged(&self, typed: f64) -> String {
        let off = typed - self.delay.delay_s;
        if off.abs() <= SAME_S.max(SAME_SIGMAS * self.delay.sigma_s) {
            return "the delay_s of its [mount] agrees with the measurement".to_owned();
        }
        format!("the delay_s of its [mount], {typed} s, differs from the measurement by {:+.1} ms", off * 1e3)
    }

    /// Returns the lines for the configs, with what each is for. A latency that a config states is
    /// in the clip's stamps, so the new one is added to it.
    fn sections(&self) -> String {
        let (delay_s, mut text) = (self.delay.delay_s, String::new());
        if self.second.is_some() && (0.0..=LONGEST_OF_MOUNT_S).contains(&delay_s) {
            let _ = write!(
                text,
                "\n# for {}, if the second clip is the picture on air as the receiver gets it: poses are\n# sent that much \
                 later\n[mount]\ndelay_s = {delay_s:.4}\n\n# or, to correct the stamps of the cameras:\n",
                self.first.config.display()
            );
        }
        match self.second {
            Some(second) if second.latency_s + delay_s >= 0.0 => text.push_str(latency_section(second, delay_s).trim_start()),
            None if delay_s >= 0.0 => {
                text.push_str("\nthe log is that late: set it as the other tracker's delay where its poses are received\n")
            }
            _ => text.push_str(&latency_section(self.first, -delay_s)),
        }
        text
    }

    pub fn json(&self) -> String {
        let delay = self.delay;
        let rival = |rival: &Rival| json!({"delay_s": rival.delay_s, "unexplained_factor": rival.factor});
        let json = json!({
            "delay_s": delay.delay_s,
            "sigma_s": delay.sigma_s,
            "verdict": self.verdict.to_string(),
            "reasons": self.reasons,
            "unexplained": delay.unexplained,
            "gain": delay.gain,
            "rotation_first_second_xyzw": delay.rotation.map(|r| r.coords.as_slice().to_vec()),
            "intervals": delay.used,
            "left_out": delay.left_out,
            "span_s": delay.span_s,
            "rates_deg_per_s": delay.rates.map(f64::to_degrees),
            "drift_s": delay.drift_s.map(|drift| drift[0]),
            "drift_sigma_s": delay.drift_s.map(|drift| drift[1]),
            "others": delay.rivals.iter().map(rival).collect::<Vec<Value>>(),
        });
        format!("{json:#}\n")
    }
}

/// Returns the lines for the config of a camera whose stamps are later by `more_s` seconds than its
/// config corrects.
pub(super) fn latency_section(camera: Configured<'_>, more_s: f64) -> String {
    let Configured { config, latency_s } = camera;
    let seconds = latency_s + more_s;
    if seconds > LONGEST_LATENCY_S {
        return "\nthe stamps are of different clocks: no camera is that late\n".to_owned();
    }
    format!("\n# for {}: that camera's pictures are stamped that much earlier\n[camera]\nlatency_s = {seconds:.4}\n", config.display())
}

/// Returns the JSON of a delay that could not be measured.
pub(super) fn refused_json(reason: &str) -> String {
    format!("{:#}\n", json!({"delay_s": null, "sigma_s": null, "verdict": Verdict::DoNotUse.to_string(), "reasons": [reason]}))
}
