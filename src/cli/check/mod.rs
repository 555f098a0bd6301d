//! `check`: reads a config and everything it names, tries its camera, and reports what it found and
//! what will happen.

use std::fmt::Write as _;
use std::path::PathBuf;

use image::GrayImage;

use super::angles::surface_angles;
use super::calibrate::write_whole;
use super::clip_timecode::timecode_in_words;
use super::failure::Failure;
use super::learnt::LearntArguments;
use super::logging::{self, LogArguments};
use super::output_file::print;
use super::spared::Spared;
use crate::camera::{CameraModel, Normalized, Pixel};
use crate::config::{LensSource, Settings};
use crate::diagnose::{self, Finding, Grade};
use crate::printable::printable_lines;
use crate::publish::{OnLoss, OutputSettings, Protocol, Rate, TickPhase};
use crate::track::{BodySpec, ReferenceKind, SurfaceSpec};
use crate::web::{AllowedHosts, page_address};

use ratings::Ratings;

/// Check a config and everything it names.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  stagepose check --config stage.toml --clip clip\n\nWithout --clip the camera is tried that `run` would take: the one that the config names with `device`, else the first."
)]
pub(super) struct CheckArguments {
    /// The config of the camera and the stage
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// A clip to check against the config: it is tracked, and diagnosed if that goes badly; if
    /// shaken by hand, it yields readout_s and exposure_s
    #[arg(long)]
    clip: Option<PathBuf>,
    /// Frames per second of a clip without stamps
    #[arg(long, value_name = "N", value_parser = super::replay::frames_per_second, requires = "clip")]
    fps: Option<f64>,
    /// Do not open the camera
    #[arg(long)]
    no_device: bool,
    /// Write the verdict, the findings and what the clip showed as JSON
    #[arg(long, value_name = "OUT.json")]
    json: Option<PathBuf>,
    /// Write a picture for each surface that shows where it has trackable texture, and print it too
    #[arg(long, value_name = "DIR")]
    ratings: Option<PathBuf>,
    #[command(flatten)]
    learnt: LearntArguments,
    #[command(flatten)]
    log: LogArguments,
}

pub(super) fn run(arguments: &CheckArguments) -> Result<(), Failure> {
    let settings = Settings::load(&arguments.config)?;
    logging::start_for_trials(&arguments.log, settings.log);
    settings.rehearse_outputs()?;
    let mut spared = arguments.clip.iter().fold(Spared::default(), |spared, clip| spared.with_clip(clip));
    if let Some(folder) = &arguments.ratings {
        spared.refuse_within_clip("--ratings", folder)?;
    }
    spared.claim_whole_files(&[("--json", &arguments.json)])?;
    let mut camera = settings.camera;
    let mut findings = of_config(&settings);
    let (mut place, mut shutter_lines, mut is_followed, mut frames) = (None, Vec::new(), true, None);
    if let Some(file) = &arguments.clip {
        let seen = clip::examine(&settings, file, arguments.fps, arguments.learnt.of(file)?.0)?;
        let (scaled, note) = settings.camera_for(seen.size.0, seen.size.1)?;
        camera = scaled;
        // Among findings of one grade, the clip's come first: they were observed, while the config
        // only looks odd.
        findings.splice(0..0, seen.findings);
        findings.extend(note.map(Finding::note));
        is_followed = seen.followed >= pass::FOLLOWED;
        frames = Some(seen.frames);
        place = Some(format!("clip        {}\n            {}", seen.line, seen.counts));
        shutter_lines = match seen.shutter {
            Some(lines) => lines,
            None if seen.followed < pass::WELL_FOLLOWED => {
                vec!["not estimated: the stage is followed in too few of the clip's frames".to_owned()]
            }
            None if seen.is_as_modelled => shutter::lines(&settings, file, arguments.fps)?,
            None => {
                vec!["not estimated: stage or lens differs from the config, which mimics rolling shutter; see above".to_owned()]
            }
        };
    }
    let ratings = Ratings::of(&settings, &camera, arguments.ratings.as_deref())?;
    findings.extend(ratings.findings());
    if arguments.clip.is_none() && !arguments.no_device {
        let (line, finding) = of_camera(&settings.device.device, device::try_camera(&settings));
        place = Some(format!("device      {line}"));
        findings.extend(finding);
    }
    findings.sort_by_key(|f| f.grade);
    let verdict = Verdict::of(&findings, is_followed, arguments.clip.is_some());
    let mut report = report(&settings, &camera, &verdict, &findings, &ratings, place);
    if let Some(file) = &arguments.json {
        write_whole(file, json::text(&verdict, &findings, frames.as_ref(), &shutter_lines))?;
    }
    for (k, line) in shutter_lines.iter().enumerate() {
        let _ = write!(report, "\n{:<11} {line}", if k == 0 { "shutter" } else { "" });
    }
    if let Some(settings) = &settings.timecode {
        let _ = write!(report, "\n{:<11} {}", "timecode", timecode_in_words(settings));
    }
    if let Some(other) = &settings.other_tracker {
        let _ = write!(report, "\n{:<11} {}", "other", other.in_words());
    }
    print(printable_lines(&(report + "\n")).as_bytes())?;
    let file = match verdict {
        Verdict::Good | Verdict::Warned(_) => return Ok(()),
        Verdict::Doubtful(_) => arguments.config.clone(),
        Verdict::NotFollowed => arguments.clip.clone().unwrap_or(arguments.config.clone()),
    };
    let reason = findings.first().map_or_else(|| "the stage is not followed".to_owned(), |f| f.message.clone());
    Err(Failure::Check { file, reason })
}

/// Returns the line and the finding for the camera that `run` would open. A camera named in the
/// config must be there. If none is named, `run` waits for the first one, and a machine that only
/// replays clips needs none.
fn of_camera(named: &Option<String>, tried: Result<String, String>) -> (String, Option<Finding>) {
    match (named, tried) {
        (Some(_), Ok(seen)) => (seen, None),
        (Some(_), Err(problem)) => (problem.clone(), Some(Finding::fault(format!("the camera: {problem}")))),
        (None, Ok(seen)) => {
            (format!("{seen}\n            the config names no camera with `device`: `run` takes the first one, which is this"), None)
        }
        (None, Err(problem)) => (format!("the config names no camera with `device`: `run` waits for the first one ({problem})"), None),
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Verdict {
    Good,
    /// It works; this many things should be looked at.
    Warned(usize),
    /// This many things are almost certainly wrong, though the stage may be followed.
    Doubtful(usize),
    /// Something must be fixed before the clip can be followed.
    NotFollowed,
}

impl Verdict {
    fn of(findings: &[Finding], is_followed: bool, has_clip: bool) -> Self {
        let count = |grade: Grade| findings.iter().filter(|f| f.grade == grade).count();
        match (count(Grade::Fault), count(Grade::Doubt), count(Grade::Warning)) {
            (faults, ..) if has_clip && (faults > 0 || !is_followed) => Self::NotFollowed,
            (0, 0, 0) => Self::Good,
            (0, 0, warnings) => Self::Warned(warnings),
            (faults, doubts, _) => Self::Doubtful(faults + doubts),
        }
    }

    fn words(self) -> String {
        match self {
            Self::Good => "good".to_owned(),
            Self::Warned(1) => "can be used, with 1 thing to look at".to_owned(),
            Self::Warned(n) => format!("can be used, with {n} things to look at"),
            Self::Doubtful(1) => "not as it should be: 1 thing to mend".to_owned(),
            Self::Doubtful(n) => format!("not as it should be: {n} things to mend, worst first"),
            Self::NotFollowed => "does not fit the clip; worst first:".to_owned(),
        }
    }
}

/// Share of the picture under the mask above which the mask is probably inverted. Chosen: a speaker
/// and a lectern may hide half, an inverted mask hides most. Raised, some inverted masks pass;
/// lowered, correct ones are doubted.
const MAX_MASK: f64 = 0.6;

/// Returns what is odd about the config itself, without a clip.
fn of_config(settings: &Settings) -> Vec<Finding> {
    let mut findings: Vec<Finding> = settings.notes.iter().map(Finding::note).collect();
    findings.extend(settings.warnings.iter().map(Finding::warning));
    findings.extend(diagnose::of_lens(&settings.camera));
    for body in std::iter::once(&settings.stage).chain(&settings.objects) {
        findings.extend(diagnose::of_layout(body));
        findings.extend(diagnose::of_corners(body, matches!(settings.lens, LensSource::Guess(..))));
    }
    if let Some(share) = settings.mask.as_ref().map(hidden_share).filter(|share| *share > MAX_MASK) {
        let share = 100.0 * share;
        findings.push(Finding::warning(format!(
            "the mask hides {share:.0} % of the picture: black is ignored, white is seen; invert it if it was painted the other way round"
        )));
    }
    if let Some(fps) = settings.device.fps {
        findings.extend(diagnose::of_shutter(&settings.shutter.or_zero(), 1.0 / fps));
    }
    findings
}

/// Returns the share of pixels that a mask hides.
fn hidden_share(mask: &GrayImage) -> f64 {
    mask.as_raw().iter().filter(|&&level| level == 0).count() as f64 / mask.as_raw().len().max(1) as f64
}

fn report(
    settings: &Settings,
    camera: &CameraModel,
    verdict: &Verdict,
    findings: &[Finding],
    ratings: &Ratings,
    place: Option<String>,
) -> String {
    let mut text = format!("{}: {}\n", settings.file.display(), verdict.words());
    let labels = [(Grade::Fault, "mend"), (Grade::Doubt, "mend"), (Grade::Warning, "look at")];
    for (grade, label) in labels {
        for finding in findings.iter().filter(|f| f.grade == grade) {
            let _ = writeln!(text, "{label:<11} {}", finding.message);
        }
    }
    let i = camera.intrinsics();
    let _ = writeln!(text, "camera      {} ({} x {} pixels)", lens::source(&settings.lens), i.width, i.height);
    let _ = writeln!(text, "            focal length {:.1} x {:.1} px, principal point {:.1}, {:.1} px", i.fx, i.fy, i.cx, i.cy);
    for line in lens::doubt(&settings.lens, camera) {
        let _ = writeln!(text, "            {line}");
    }
    let _ = writeln!(text, "            {}", field_of_view(camera));
    let _ = writeln!(text, "            {}", shutter(settings));
    if let Some(mask) = &settings.mask {
        let _ = writeln!(text, "            the mask hides {:.1} % of the picture", 100.0 * hidden_share(mask));
    }
    if let Some(place) = place {
        let _ = writeln!(text, "{place}");
    }
    let mut number = 0;
    body(&mut text, "stage", &settings.stage, camera, ratings, &mut number);
    for object in &settings.objects {
        body(&mut text, &format!("object {}", object.name), object, camera, ratings, &mut number);
    }
    for (k, line) in settings.mount.iter().flat_map(|mount| mount::lines(mount, settings)).enumerate() {
        let _ = writeln!(text, "{:<11} {line}", if k == 0 { "mount" } else { "" });
    }
    for output in &settings.outputs {
        let _ = writeln!(text, "output      {}", output_line(output, settings));
    }
    if let Some(http) = &settings.http {
        let _ = writeln!(text, "page        {}", page_address(http.listen));
        let _ = writeln!(text, "http        http://{0}/api/v1/pose, http://{0}/api/v1/state, ws://{0}/ws", http.listen);
        let _ = writeln!(text, "            answers for the hosts {}", AllowedHosts::new(&http.hosts).listing());
    }
    for note in findings.iter().filter(|f| f.grade == Grade::Note) {
        let _ = writeln!(text, "note        {}", note.message);
    }
    let t = &settings.tracker;
    let _ = write!(
        text,
        "It will look for up to {} corners in every frame on {} thread(s), call a pose `tracking` after {} frames that agree, \
         and predict it for at most {} s when it is lost.",
        t.features, t.threads, t.confirm_frames, t.coast_s
    );
    text
}

fn output_line(output: &OutputSettings, settings: &Settings) -> String {
    let mut to: Vec<String> = output.udp.to.iter().map(ToString::to_string).collect();
    if let Protocol::Json(json) = &output.protocol {
        to.extend(json.stream.tcp_listen.map(|address| format!("clients on {address}")));
        to.extend(json.stream.file.as_ref().map(|file| file.display().to_string()));
    }
    let rate = match output.rate {
        Rate::Every(1) => "every frame".to_owned(),
        Rate::Every(n) => format!("one frame in {n}"),
        Rate::Fixed { rate, delay, phase } => {
            let phase = if phase == TickPhase::Clock { "on the clock's frames" } else { "free-running" };
            format!("{:.2} times a second, {phase}, {} ms late", rate.hz(), delay.as_millis())
        }
    };
    let on_loss = match output.on_loss {
        OnLoss::Stop => "stops on loss",
        OnLoss::Hold => "holds the last pose on loss",
        OnLoss::Flag => "flags a loss",
    };
    let off = if output.enabled { "" } else { " (not enabled)" };
    let late = if matches!(output.rate, Rate::Every(_)) { mount::late(output.delay) } else { String::new() };
    let bodies = mount::bodies(output, settings);
    format!("{}: {}{bodies} to {}, {rate}{late}, {on_loss}{off}", output.name, output.protocol.word(), to.join(", "))
}

/// Returns the angles across the middle of the picture, through the lens' distortion if it can be
/// inverted.
fn field_of_view(camera: &CameraModel) -> String {
    let i = camera.intrinsics();
    let (right, bottom) = (f64::from(i.width) - 0.5, f64::from(i.height) - 0.5);
    let angle = |a: [f64; 2], b: [f64; 2]| -> Option<f64> {
        let ray = |p: [f64; 2]| camera.unproject(Pixel(p.into())).map(|Normalized(n)| n.push(1.0));
        Some(ray(a)?.angle(&ray(b)?).to_degrees())
    };
    match (angle([-0.5, i.cy], [right, i.cy]), angle([i.cx, -0.5], [i.cx, bottom])) {
        (Some(across), Some(down)) => format!("field of view {across:.1} x {down:.1} degrees"),
        _ => "the distortion cannot be inverted at the picture's edges, which are not used".to_owned(),
    }
}

fn shutter(settings: &Settings) -> String {
    let in_ms = |s: Option<f64>| s.map_or("unknown, learnt while the camera moves".to_owned(), |s| format!("{:.1} ms", s * 1e3));
    let readout = match settings.shutter.readout_s {
        Some(0.0) => "global shutter".to_owned(),
        readout_s => format!("readout {}", in_ms(readout_s)),
    };
    format!("exposure {}, {readout}", in_ms(settings.shutter.exposure_s))
}

/// Writes a body's lines. `number` counts surfaces over all bodies: on return it is that of the
/// next body's first surface.
fn body(text: &mut String, title: &str, body: &BodySpec, camera: &CameraModel, ratings: &Ratings, number: &mut usize) {
    for (index, surface) in body.surfaces.iter().enumerate() {
        let label = if index == 0 { title } else { "" };
        let _ = writeln!(text, "{label:<11} {}", surface_line(surface));
        let _ = writeln!(text, "            {}", distance_line(surface, camera));
        for line in ratings.lines(*number) {
            let _ = writeln!(text, "            {line}");
        }
        *number += 1;
    }
}

fn surface_line(surface: &SurfaceSpec) -> String {
    let kind = match surface.kind {
        ReferenceKind::Artwork => "artwork",
        ReferenceKind::Photograph { .. } => "laid flat from a photograph,",
        ReferenceKind::Facet { .. } => "of a map,",
    };
    let (width, height) = surface.artwork.dimensions();
    // Measured places have more digits than mean anything.
    let rounded = |metres: f64| (metres * 1e4).round() / 1e4;
    let [width_m, height_m] = surface.size_m.map(rounded);
    let p = surface.pose.translation.map(rounded);
    let (name, texels) = (&surface.name, texels_per_metre(surface) / 1e3);
    let turned = match surface_angles(&surface.pose) {
        [0.0, 0.0, 0.0] => String::new(),
        [turn, tilt, roll] => format!(", turned {turn}, tilted {tilt}, rolled {roll} degrees"),
    };
    format!(
        "{name}: {kind} {width} x {height} pixels on {width_m} x {height_m} m, {texels:.2} texels a mm, at [{}, {}, {}] m{turned}",
        p.x, p.y, p.z
    )
}

fn texels_per_metre(surface: &SurfaceSpec) -> f64 {
    f64::from(surface.artwork.width()) / surface.size_m[0]
}

fn distance_line(surface: &SurfaceSpec, camera: &CameraModel) -> String {
    let (least, most) = distances(surface, camera);
    format!("best seen head-on from {least:.2} m to {most:.2} m")
}

/// Returns the recommended distances, in metres.
///
/// Nearest: a tenth of the surface's width fills the picture, or a texel covers two pixels,
/// whichever comes first on approach. Farthest: the surface is a tenth of the picture wide.
fn distances(surface: &SurfaceSpec, camera: &CameraModel) -> (f64, f64) {
    let i = camera.intrinsics();
    let (width_m, width_px) = (surface.size_m[0], f64::from(i.width));
    let tenth_of_surface = 0.1 * width_m * i.fx / width_px;
    let coarse_texels = i.fx / (2.0 * texels_per_metre(surface));
    (tenth_of_surface.max(coarse_texels), width_m * i.fx / (0.1 * width_px))
}

mod clip;
mod json;
mod lens;
mod mount;
mod pass;
mod ratings;
mod readout;
mod shutter;

#[cfg(feature = "live")]
mod device;
#[cfg(not(feature = "live"))]
mod device {
    /// Returns the error of a build without cameras.
    pub(super) fn try_camera(_: &crate::config::Settings) -> Result<String, String> {
        Err(crate::cli::run::no_live_feature().to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;

    #[test]
    fn a_clip_with_a_fault_is_never_good() {
        let (fault, doubt, note) = (Finding::fault("a"), Finding::doubt("b"), Finding::note("c"));
        assert_eq!(Verdict::of(std::slice::from_ref(&note), true, true), Verdict::Good);
        assert_eq!(Verdict::of(std::slice::from_ref(&note), false, true), Verdict::NotFollowed);
        assert_eq!(Verdict::of(&[fault.clone(), doubt.clone()], true, true), Verdict::NotFollowed);
        assert_eq!(Verdict::of(&[doubt, note.clone()], true, true), Verdict::Doubtful(1));
        assert_eq!(Verdict::of(&[Finding::warning("d"), note], true, true), Verdict::Warned(1));
        let others = [Verdict::NotFollowed, Verdict::Doubtful(2), Verdict::Warned(1)];
        assert!(others.iter().all(|verdict| !verdict.words().contains("good")));
    }

    #[test]
    fn a_named_camera_must_be_present_and_any_other_is_awaited() {
        let named = Some("front".to_owned());
        let reported = |named: &Option<String>, tried: Result<&str, &str>| {
            let (line, finding) = of_camera(named, tried.map(str::to_owned).map_err(str::to_owned));
            (line, finding.map(|finding| finding.grade))
        };
        assert_eq!(reported(&named, Ok("Cam")), ("Cam".to_owned(), None));
        assert_eq!(reported(&named, Err("gone")), ("gone".to_owned(), Some(Grade::Fault)));
        let (line, grade) = reported(&None, Ok("Cam"));
        assert!(line.starts_with("Cam\n") && line.contains("`run` takes the first one, which is this") && grade.is_none(), "{line}");
        let (line, grade) = reported(&None, Err("gone"));
        assert!(line.contains("`run` waits for the first one (gone)") && grade.is_none(), "{line}");
    }

    #[test]
    fn distances_follow_from_size_and_resolution() {
        let camera = CameraModel::pinhole(1000, 500, 1000.0, 1000.0, 499.5, 249.5).unwrap();
        let mut surface = SurfaceSpec {
            name: "a.png".to_owned(),
            artwork: GrayImage::new(4000, 2000),
            size_m: [4.0, 2.0],
            pose: Pose::identity(),
            kind: ReferenceKind::Artwork,
            shape: crate::track::SurfaceShape::Flat,
            doubt: crate::track::SurfaceDoubt::default(),
            transfer: crate::light::Transfer::default(),
        };
        // A texel covers two pixels at 0.5 m; a tenth of the surface, 0.4 m, fills the picture at
        // 0.4 m.
        assert_eq!(distances(&surface, &camera), (0.5, 40.0));
        surface.artwork = GrayImage::new(8000, 4000);
        assert_eq!(distances(&surface, &camera), (0.4, 40.0));
    }

    #[test]
    fn the_field_of_view_spans_the_outer_edges() {
        let camera = CameraModel::pinhole(1000, 500, 500.0, 500.0, 499.5, 249.5).unwrap();
        assert_eq!(field_of_view(&camera), "field of view 90.0 x 53.1 degrees");
    }
}
