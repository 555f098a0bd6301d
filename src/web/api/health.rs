//! `GET /api/v1/health`, `/healthz`, `/metrics`, `outputs`, `log`, `diagnostics`: the state of each
//! part of the daemon in one sentence, with the fix if something is wrong.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use axum::http::Method;
use nix::sys::statvfs::statvfs;
use serde::Serialize;
use serde_json::{Value, json};

use super::findings::of_refused;
use crate::camera::KnownShutter;
use crate::capture::timestamping::monotonic_now;
use crate::daemon::{Mode, Supervisor};
use crate::printable::printable;
use crate::protocols::{freed::FreedPacket, opentrackio, otp::OtpMessage, psn::PsnPacket};
use crate::publish::{ClockQuality, FrameClock, OutputStatistics, Stamps};
use crate::record::State;
use crate::telemetry::{
    BudgetPart, CameraState, Origin, OtherTrackerStatus, Page, RecorderState, Statistics, TimecodeStatus, health, log_tail, metrics,
};
use crate::track::{LearntCamera, LearntTime};
use crate::web::reply::Reply;
use crate::web::routes::{Access, Route};

/// Free disk space below which there is a warning, bytes: an hour of a camera's JPEGs. Raised, it
/// comes earlier.
const LITTLE_ROOM: f64 = 20e9;
/// Free disk space below which there is an error, bytes: minutes of a camera's JPEGs. Raised, it
/// comes earlier.
const NO_ROOM: f64 = 1e9;
/// Maximum number of log lines in one answer: all that are kept. Raised, nothing changes.
const MAX_LINES: u64 = 1000;
/// Bytes of a packet shown as hexadecimal digits. Raised, answers are wider.
const SHOWN_BYTES: usize = 256;

/// A part of the daemon.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
struct Part {
    part: String,
    /// `good`, `warn`, `bad` or `off`.
    level: &'static str,
    sentence: String,
    #[serde(rename = "mend")]
    hint: Option<String>,
}

fn part(part: &str, level: &'static str, sentence: impl Into<String>, hint: Option<&str>) -> Part {
    Part { part: part.to_owned(), level, sentence: sentence.into(), hint: hint.map(str::to_owned) }
}

pub(super) fn routes(supervisor: &Arc<Supervisor>) -> Vec<Route> {
    let of = |supervisor: &Arc<Supervisor>| supervisor.clone();
    let (for_health, for_outputs, for_text) = (of(supervisor), of(supervisor), of(supervisor));
    let rates: Arc<Rates> = Arc::default();
    vec![
        Route::slow(Method::GET, "/api/v1/health", Access::Anyone, move |_| {
            Ok(Reply::json(200, printable(&json!({"parts": parts(&for_health)}).to_string()).into_owned()))
        })
        .probe(),
        Route::slow(Method::GET, "/api/v1/outputs", Access::Anyone, move |_| {
            let outputs: Vec<Value> = rates.of(for_outputs.outputs(), Instant::now()).iter().map(output).collect();
            Ok(Reply::json(200, json!({"outputs": outputs}).to_string()))
        }),
        Route::slow(Method::GET, "/api/v1/log", Access::Paired, |call| {
            let lines = call.queried("lines", 200, 1..=MAX_LINES)?;
            Ok(Reply::text(200, log_tail(lines as usize).concat()))
        }),
        Route::slow(Method::GET, "/api/v1/diagnostics", Access::Paired, move |_| Ok(Reply::text(200, diagnostics(&for_text)))),
    ]
}

/// Returns the routes `/healthz` and `/metrics`, for service managers and Prometheus.
pub(super) fn probes(statistics: &Arc<Statistics>, clock: &Arc<FrameClock>) -> [Route; 2] {
    let (for_health, for_metrics) = ((statistics.clone(), clock.clone()), (statistics.clone(), clock.clone()));
    let reply = |page: Page| Reply::new(page.status, page.content_type, page.body.into_bytes());
    [
        Route::get("/healthz", move || reply(health(&for_health.0, &for_health.1))),
        Route::get("/metrics", move || reply(metrics(&for_metrics.0, &for_metrics.1))),
    ]
}

fn parts(supervisor: &Supervisor) -> Vec<Part> {
    let statistics = &supervisor.link.statistics;
    // If a config is in force, tracking continues with it.
    let (level, goes_on) = if supervisor.settings().is_some() { ("warn", "; the previous config stays active") } else { ("bad", "") };
    let of_config = of_refused(supervisor).into_iter().map(|finding| {
        let place = finding.line.map_or_else(String::new, |line| format!("line {line}: "));
        part("config", level, format!("{place}{}{goes_on}", finding.sentence), finding.hint.as_deref())
    });
    let mut parts: Vec<Part> = of_config.collect();
    parts.extend([camera(statistics, supervisor.mode()), tracker(statistics)]);
    parts.extend(supervisor.settings().map(|settings| shutter(&settings.shutter, &statistics.learnt())));
    parts.push(delay(statistics));
    parts.extend(supervisor.outputs().iter().map(of_output));
    parts.push(recorder(statistics, supervisor));
    let folder = supervisor.settings().map(|settings| settings.recorder.folder.clone());
    parts.push(disk(folder.as_deref().unwrap_or(&supervisor.keeping().folder())));
    parts.push(clock(statistics));
    parts.extend(ClockQuality::read().map(system_clock));
    parts.extend(timecode(statistics));
    parts.extend(statistics.other_tracker().as_ref().map(other_tracker));
    parts
}

fn camera(statistics: &Statistics, mode: Mode) -> Part {
    let (name, rate) = (statistics.camera_name(), statistics.rate());
    if mode != Mode::Track {
        return part("camera", "off", "the set-up is using the camera", Some("return to tracking when it is done"));
    }
    match statistics.camera() {
        CameraState::Streaming => part("camera", "good", format!("{name} sends {rate:.1} pictures a second"), None),
        CameraState::Silent => {
            part("camera", "bad", format!("{name} sends no pictures"), Some("check its cable, and that no other program uses it"))
        }
        CameraState::Waiting => part(
            "camera",
            "bad",
            "the camera is missing",
            Some("plug it in; `stagepose devices` lists the cameras, [camera] device selects one"),
        ),
    }
}

fn tracker(statistics: &Statistics) -> Part {
    let (frames, dropped) = (statistics.frames(), statistics.dropped.get());
    let late = format!("{dropped} of {} frames arrived too late", frames + dropped);
    let slow = dropped * 100 > (frames + dropped).max(1);
    match statistics.last_state() {
        _ if frames == 0 => part("tracker", "off", "no frame has come yet", None),
        State::Tracking if slow => {
            part("tracker", "warn", format!("it tracks, but {late}"), Some("raise [tracker] threads, or lower the camera's frame rate"))
        }
        State::Tracking => part("tracker", "good", format!("it tracks, to {:.2} px", statistics.rms_px()), None),
        State::Coasting => part("tracker", "warn", "it briefly predicts the pose", None),
        State::Stale => part("tracker", "bad", "it gets no pictures", Some("check the camera")),
        state => {
            let sentence = format!("it does not find the stage ({})", state.word());
            part("tracker", "bad", sentence, Some("the events say why; `stagepose check --clip` suggests fixes"))
        }
    }
}

/// Reports how fast the rows are read, how long they are exposed, and whether that is configured or
/// learnt.
fn shutter(configured: &KnownShutter, learnt: &LearntCamera) -> Part {
    let time = |time: &LearntTime| format!("{:.1} ms (+- {:.1})", 1e3 * time.seconds, 1e3 * time.sigma_s);
    let exposure = match (configured.exposure_s, &learnt.exposure) {
        (Some(exposure_s), _) => format!("; exposed for {:.1} ms, as configured", 1e3 * exposure_s),
        (None, Some(exposure)) => format!("; exposed for {}, learnt from blur", time(exposure)),
        (None, None) => String::new(),
    };
    let (level, rows, hint) = match (configured.readout_s, &learnt.readout) {
        (Some(0.0), _) => ("good", "all rows are read at once, as configured".to_owned(), None),
        (Some(readout_s), _) => ("good", format!("rows are read in {:.1} ms, as configured", 1e3 * readout_s), None),
        (None, Some(readout)) if readout.seconds == 0.0 => ("good", "all rows are read at once, learnt from motion".to_owned(), None),
        (None, Some(readout)) => ("good", format!("rows are read in {}, learnt from motion", time(readout)), None),
        (None, None) => (
            "off",
            "the readout time is not known yet; poses are less certain while the camera moves".to_owned(),
            Some("move the camera quickly for three seconds with the stage in view: it is then learnt and kept"),
        ),
    };
    part("shutter", level, rows + &exposure, hint)
}

/// The delay budget.
fn delay(statistics: &Statistics) -> Part {
    let budget = statistics.budget();
    let level = if budget.total_s().is_some() { "good" } else { "off" };
    let is_unknown = |part: &BudgetPart| part.origin == Origin::Unknown;
    let hint = budget.0[..2].iter().any(is_unknown).then_some(
        "lock the exposure (`controls`), and move the camera quickly for three seconds: exposure and readout are then known, else the \
         transfer contains them",
    );
    part("delay", level, budget.to_string(), hint)
}

fn of_output(output: &OutputStatistics) -> Part {
    let (name, failed, sent) = (format!("output {}", output.name), output.failed, output.sent);
    let to = Some("check the address in [[output]], the network and the receiver");
    match (sent, failed) {
        (0, 0) => part(&name, "off", "it has sent nothing yet", None),
        (0, _) => part(&name, "bad", format!("none of its {failed} packets could be sent"), to),
        (_, 0) => part(&name, "good", format!("{sent} packets were sent"), None),
        _ if failed * 100 > sent => part(&name, "warn", format!("{failed} of {} packets could not be sent", sent + failed), to),
        _ => part(&name, "good", format!("{sent} packets were sent, {failed} were not"), None),
    }
}

fn recorder(statistics: &Statistics, supervisor: &Supervisor) -> Part {
    let ring_s = supervisor.settings().map_or(0.0, |settings| settings.recorder.ring_s);
    match statistics.recorder() {
        RecorderState::Off => part("recorder", "off", "nothing is recorded", None),
        RecorderState::Recording if supervisor.recording().is_none() => {
            part("recorder", "good", format!("the last {ring_s} s are kept; no recording runs"), None)
        }
        RecorderState::Recording => part("recorder", "good", format!("{} frames are recorded", statistics.recorded.get()), None),
        RecorderState::Stopped => part(
            "recorder",
            "bad",
            "recording stopped, tracking continues",
            Some("see the recorder's last event; fix the cause, then start a new recording"),
        ),
    }
}

/// Reports the free space where a path is or would be.
fn disk(path: &Path) -> Part {
    let there = path.ancestors().find(|path| path.exists()).map_or_else(|| PathBuf::from("."), Path::to_owned);
    let Ok(about) = statvfs(&there) else { return part("disk", "warn", "the free disk space is unknown", None) };
    let free = about.blocks_available() as f64 * about.fragment_size() as f64;
    let sentence = format!("{:.1} GB are free for recordings", free / 1e9);
    if free < NO_ROOM {
        part("disk", "bad", sentence, Some("delete or move recordings"))
    } else if free < LITTLE_ROOM {
        part("disk", "warn", sentence, Some("move recordings away before the show"))
    } else {
        part("disk", "good", sentence, None)
    }
}

/// Reports whether frames are stamped, and the age of the newest.
fn clock(statistics: &Statistics) -> Part {
    let age = statistics.last_frame_age(&FrameClock::new(Stamps::Live));
    match age {
        None => part("clock", "off", "no frame has been stamped yet", None),
        Some(age) => {
            part("clock", "good", format!("frames have the camera's stamps; the newest is {:.0} ms old", age.as_secs_f64() * 1e3), None)
        }
    }
}

/// Reports whether a time service keeps the system's clock, and how far it may be off.
fn system_clock(quality: ClockQuality) -> Part {
    let ClockQuality { is_synchronised, max_error_s, frequency_ppm, .. } = quality;
    if is_synchronised {
        let sentence = format!("a time service keeps the system's clock, to {:.1} ms ({frequency_ppm:+.1} ppm)", 1e3 * max_error_s);
        return part("system clock", "good", sentence, None);
    }
    let hint = "for stamps that other machines can use, install chrony or a PTP service, and let it set the system's clock";
    part("system clock", "off", "no time service keeps the system's clock: times of day are this machine's own", Some(hint))
}

/// Reports the timecode's state; nothing without `[timecode]`.
fn timecode(statistics: &Statistics) -> Option<Part> {
    let status = TimecodeStatus::of(&*statistics.timecode()?, monotonic_now())?;
    let (code, rate) = (status.timecode.unwrap_or_default(), status.rate.unwrap_or_default());
    let cable = Some("check the cable, `channel` and `file` in [timecode], and the generator's level");
    Some(match (status.state, status.configured_rate) {
        ("locked", Some(configured)) => {
            let sentence = format!("timecode runs at {rate}, but `rate` in [timecode] is {configured}");
            part("timecode", "warn", sentence, Some("set the generator or the config"))
        }
        ("locked", None) => part("timecode", "good", format!("timecode is locked: {code} at {rate}"), None),
        ("free-wheeling", _) => {
            let sentence = format!("no timecode for {:.1} s; it counts on: {code} at {rate}", status.without_s.unwrap_or_default());
            part("timecode", "warn", sentence, cable)
        }
        ("never found", _) => part("timecode", "bad", "no timecode has come yet", cable),
        _ => part("timecode", "bad", "timecode is lost", cable),
    })
}

fn other_tracker(status: &OtherTrackerStatus) -> Part {
    let level = match (status.state, status.difference.as_ref().map(|difference| difference.verdict.as_str())) {
        ("heard", Some("do not use")) => "bad",
        ("heard", _) if status.hint.is_none() => "good",
        ("heard" | "no pose" | "stale", _) => "warn",
        _ => "bad",
    };
    part("other tracker", level, status.sentence.clone(), status.hint.as_deref())
}

/// Packets per second of each output, from two readings of its counter.
#[derive(Debug, Default)]
struct Rates(Mutex<Vec<Look>>);

/// An output's counter at its last reading.
#[derive(Debug)]
struct Look {
    name: String,
    sent: u64,
    at: Instant,
    rate: Option<f64>,
}

/// Minimum interval between two readings for a rate, seconds: several pages may ask. Lowered, rates
/// fluctuate more.
const LOOK_S: f64 = 0.5;

impl Rates {
    /// Returns the outputs with their rates; `None` at the first reading.
    fn of(&self, outputs: Vec<OutputStatistics>, now: Instant) -> Vec<(OutputStatistics, Option<f64>)> {
        let mut before = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        before.retain(|look| outputs.iter().any(|output| output.name == look.name));
        let mut with_rates = Vec::new();
        for output in outputs {
            let rate = match before.iter_mut().find(|look| look.name == output.name) {
                None => {
                    before.push(Look { name: output.name.clone(), sent: output.sent, at: now, rate: None });
                    None
                }
                Some(look) => {
                    let seconds = now.duration_since(look.at).as_secs_f64();
                    if seconds >= LOOK_S {
                        // A restarted session counts from zero, so there is no rate.
                        look.rate = output.sent.checked_sub(look.sent).map(|packets| packets as f64 / seconds);
                        (look.sent, look.at) = (output.sent, now);
                    }
                    look.rate
                }
            };
            with_rates.push((output, rate));
        }
        with_rates
    }
}

fn output((output, per_s): &(OutputStatistics, Option<f64>)) -> Value {
    let packet = &output.last_packet;
    let hex: Vec<String> = packet.iter().take(SHOWN_BYTES).map(|byte| format!("{byte:02x}")).collect();
    json!({
        "name": output.name, "protocol": output.protocol, "sent": output.sent, "failed": output.failed, "withheld": output.withheld,
        "dropped": output.dropped, "latency_us": output.latency_us, "per_s": per_s, "last": decoded(output.protocol, packet),
        "last_hex": hex.join(" "),
    })
}

/// Decodes a packet for people; null if it cannot be decoded here.
fn decoded(protocol: &str, packet: &[u8]) -> Value {
    if packet.is_empty() {
        return Value::Null;
    }
    match protocol {
        "freed" => FreedPacket::decode(packet).map_or(Value::Null, |packet| format!("{packet:?}").into()),
        "psn" => PsnPacket::decode(packet).map_or(Value::Null, |packet| format!("{packet:?}").into()),
        "otp" => OtpMessage::decode(packet).map_or(Value::Null, |(_, message)| format!("{message:?}").into()),
        "opentrackio" => opentrackio::decode(packet).map_or(Value::Null, |(_, sample)| sample),
        "json" => serde_json::from_slice(packet).unwrap_or(Value::Null),
        _ => Value::Null,
    }
}

pub(super) fn diagnostics(supervisor: &Supervisor) -> String {
    let mut text = format!("stagepose {}\nconfig {}\n\n", env!("CARGO_PKG_VERSION"), supervisor.file().display());
    for part in parts(supervisor) {
        let hint = part.hint.map_or_else(String::new, |hint| format!("; {hint}"));
        text += &format!("{:<5} {}: {}{hint}\n", part.level, part.part, part.sentence);
    }
    text += "\n";
    text += &metrics(&supervisor.link.statistics, &FrameClock::new(Stamps::Live)).body;
    text += "\n";
    text += &log_tail(MAX_LINES as usize).concat();
    crate::printable::printable_lines(&text).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::timecode::{Timecode, TimecodeMark, TimecodeRate, TimecodeSource, TimecodeTrack, TrackSettings};
    use crate::web::api::tests::{respond, supervised};

    #[test]
    fn timecode_is_a_part_once_it_is_configured() {
        let folder = tempfile::tempdir().unwrap();
        let supervisor = supervised(folder.path());
        let of_timecode = || parts(&supervisor).into_iter().find(|part| part.part == "timecode");
        assert_eq!(of_timecode(), None);
        let settings = TrackSettings { rate: None, free_wheel_s: 60.0 };
        let source = Arc::new(TimecodeSource::live(TimecodeTrack::live(settings)));
        supervisor.link.statistics.set_timecode(Some(source.clone()));
        assert_eq!(of_timecode().unwrap().level, "bad");
        let now = monotonic_now();
        for k in 0..75 {
            let (at, code) = (now.after_s(0.04 * (k - 100) as f64), Timecode::of_number(k, TimecodeRate::Fps25));
            source.with_live(|track| track.push(TimecodeMark { at, code, is_reverse: false }));
        }
        let part = of_timecode().unwrap();
        assert!(part.level == "warn" && part.sentence.contains("it counts on: 00:00:04:"), "{part:?}");
    }

    #[test]
    fn each_part_reports_its_health() {
        let folder = tempfile::tempdir().unwrap();
        let supervisor = supervised(folder.path());
        let levels = |supervisor: &Supervisor| -> Vec<(String, &'static str)> {
            // These two are the machine's.
            let is_own = |part: &Part| !["disk", "system clock"].contains(&part.part.as_str());
            parts(supervisor).into_iter().filter(is_own).map(|part| (part.part, part.level)).collect()
        };
        let expected = |all: [(&str, &'static str); 6]| all.map(|(part, level)| (part.to_owned(), level)).to_vec();
        let off = ["tracker", "shutter", "delay", "recorder", "clock"].map(|part| (part, "off"));
        assert_eq!(levels(&supervisor), expected([("camera", "bad"), off[0], off[1], off[2], off[3], off[4]]));
        let statistics = &supervisor.link.statistics;
        statistics.camera_opened("Cam", false);
        statistics.set_recorder(RecorderState::Stopped);
        assert_eq!(levels(&supervisor)[0].1, "good");
        assert_eq!(levels(&supervisor)[4].1, "bad");
        assert!(parts(&supervisor).iter().all(|part| part.level != "bad" || part.hint.is_some()));
        supervisor.set_mode(Mode::Setup);
        assert_eq!(levels(&supervisor)[0].1, "off");
        let (status, text) = respond(&routes(&supervisor), "GET", "/api/v1/diagnostics", b"");
        assert!(status == 200 && String::from_utf8(text).unwrap().contains("recorder: recording stopped"));
        assert_eq!(respond(&routes(&supervisor), "GET", "/api/v1/log?lines=0", b"").0, 400);
    }

    #[test]
    fn shutter_health_states_configured_learnt_or_unknown() {
        let time = |seconds| LearntTime { seconds, sigma_s: 2e-4 };
        let learnt = LearntCamera { readout: Some(time(0.0201)), exposure: Some(time(0.008)), curve: None };
        let said = |configured: KnownShutter, learnt: LearntCamera| {
            let part = shutter(&configured, &learnt);
            (part.level, part.sentence)
        };
        let unknown = shutter(&KnownShutter::default(), &LearntCamera::default());
        assert!(unknown.level == "off" && unknown.hint.is_some_and(|hint| hint.contains("move the camera")));
        let (level, sentence) = said(KnownShutter::default(), learnt);
        assert_eq!(
            (level, sentence.as_str()),
            ("good", "rows are read in 20.1 ms (+- 0.2), learnt from motion; exposed for 8.0 ms (+- 0.2), learnt from blur")
        );
        let configured = KnownShutter { readout_s: Some(0.016), exposure_s: Some(0.004) };
        assert_eq!(said(configured, learnt).1, "rows are read in 16.0 ms, as configured; exposed for 4.0 ms, as configured");
        let global = KnownShutter { readout_s: Some(0.0), exposure_s: None };
        assert_eq!(said(global, LearntCamera::default()).1, "all rows are read at once, as configured");
    }

    #[test]
    fn packet_rates_are_measured_between_two_requests() {
        let (rates, begun) = (Rates::default(), Instant::now());
        let look = |sent, s: f64| {
            let output = OutputStatistics {
                name: "a".to_owned(),
                protocol: "freed",
                sent,
                failed: 0,
                withheld: 0,
                dropped: 0,
                latency_us: 0,
                greatest_latency_us: 0,
                last_packet: Vec::new(),
            };
            rates.of(vec![output], begun + std::time::Duration::from_secs_f64(s))[0].1
        };
        assert_eq!([look(10, 0.0), look(11, 0.1), look(40, 1.0), look(41, 1.1), look(5, 2.0)], [None, None, Some(30.0), Some(30.0), None]);
    }
}
