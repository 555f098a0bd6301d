//! The config after everything in it has been checked and every file it names has been read.

use std::collections::BTreeMap;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use image::GrayImage;
use image::imageops::{FilterType, resize};
use toml::Spanned;
use tracing::level_filters::LevelFilter;

use super::as_typed;
use super::bodies::{BodyReader, refuse_many};
use super::filter::filter;
use super::fixed::fixed;
use super::http::{HostName, HttpSettings};
use super::lens::{self, LensSource, lens};
use super::measured::measured;
use super::mount::mount;
use super::named_files::named_files;
use super::named_points::named_points;
use super::origin::Origin;
use super::other_tracker::{OtherTrackerSettings, other_tracker};
use super::outputs::{OUTPUT, OutputReader, safety};
use super::protocols::address;
use super::shutter::shutter;
use super::source::{ConfigSource, read_text};
use super::timecode::{TimecodeSettings, timecode};
use super::transfer::transfer;
use super::values::Section;
use super::{ConfigError, Problem};
use crate::camera::{CameraModel, KnownShutter};
use crate::capture::camera::PixelLayout;
use crate::geometry::{Body, Pose, SurfaceFrame};
use crate::light::Transfer;
use crate::pose::{FilterSettings, FixedCamera};
use crate::publish::{MountSettings, OutputSettings, SafetySettings};
use crate::survey::measured::Constraint;
use crate::survey::named_points::NamedPoints;
use crate::track::{BodySpec, TrackerSettings};
use crate::tracker::TrackerSetup;

/// A checked config.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Settings {
    /// The config file.
    pub file: PathBuf,
    /// The config's text and the files it names, as they were read.
    pub source: ConfigSource,
    /// Line of the calibration, counted from 1; without one, the line of its section.
    pub(crate) calibration_line: usize,
    /// The source of the camera's parameters.
    pub(crate) lens: LensSource,
    /// The camera at the calibration's picture size (any size, for a guess);
    /// [`camera_for`](Self::camera_for) fits it to a clip.
    pub camera: CameraModel,
    /// What is known of its shutter.
    pub shutter: KnownShutter,
    /// Black where the camera's picture is to be ignored; it has the calibration's aspect ratio.
    pub mask: Option<GrayImage>,
    /// How to open the camera, for the commands that do.
    pub(crate) device: DeviceSettings,
    /// The stage.
    pub stage: BodySpec,
    /// The first surface's pose in the config, before `[stage] origin` moved it.
    pub(crate) first_as_typed: Pose<Body, SurfaceFrame>,
    /// The tracked objects, in the order of the file.
    pub objects: Vec<BodySpec>,
    /// A camera that stands still; `None`: its pose is measured.
    pub fixed: Option<FixedCamera>,
    /// Measurements on the stage, for a survey.
    pub(crate) measured: Vec<Constraint>,
    /// Points of the set that give a map its frame and scale.
    pub(crate) named_points: NamedPoints,
    /// The filming camera on the rig; `None` without `[mount]`.
    pub(crate) mount: Option<MountSettings>,
    /// The tracker's tunables.
    pub tracker: TrackerSettings,
    /// Where timecode comes from; `None` without `[timecode]`.
    pub(crate) timecode: Option<TimecodeSettings>,
    /// Another tracker beside this one; `None` without `[other_tracker]`.
    pub(crate) other_tracker: Option<OtherTrackerSettings>,
    /// What is recorded while tracking.
    pub(crate) recorder: RecorderSettings,
    /// How the measured pose is filtered before it is reported.
    pub filter: FilterSettings,
    /// Limits for every output.
    pub(crate) safety: SafetySettings,
    /// Where poses go, in the order of the file.
    pub(crate) outputs: Vec<OutputSettings>,
    /// The HTTP server; `None` without `[http]`.
    pub(crate) http: Option<HttpSettings>,
    /// What is logged, and how.
    pub(crate) log: LogSettings,
    /// Every file that was read: the config and the files it names.
    pub files: Vec<PathBuf>,
    /// Assumptions and oddities, one sentence each; `check` prints them.
    pub notes: Vec<String>,
    /// Parts of the config that were left out, and unusual numbers, one sentence each; every
    /// command warns of them.
    pub warnings: Vec<String>,
}

/// The part of a config needed for sending.
#[derive(Debug, Clone)]
pub struct SendingSettings {
    /// The calibrated camera, if one is named and its file exists.
    pub camera: Option<CameraModel>,
    /// A named calibration whose file is missing: sending a test pose works without.
    pub missing_calibration: Option<PathBuf>,
    /// The outputs.
    pub outputs: Vec<OutputSettings>,
    /// The objects' names.
    pub objects: Vec<String>,
    /// The mount, if there is one.
    pub mount: Option<MountSettings>,
    /// Limits for every output.
    pub safety: SafetySettings,
    /// The HTTP server; `None` without `[http]`.
    pub http: Option<HttpSettings>,
    /// What is logged, and how.
    pub log: LogSettings,
}

/// How to open the camera; `None` leaves the choice to the driver.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DeviceSettings {
    /// Device path, number or name.
    pub device: Option<String>,
    /// Picture width in pixels.
    pub width: Option<u32>,
    /// Picture height in pixels.
    pub height: Option<u32>,
    /// Frames per second.
    pub fps: Option<f64>,
    /// Pixel format.
    pub format: Option<PixelLayout>,
    /// Driver controls by name, set once at the start.
    pub controls: BTreeMap<String, i64>,
    /// How late its pictures are stamped.
    pub latency: Duration,
}

/// The `[recorder]` section.
#[derive(Debug, Clone, PartialEq)]
pub struct RecorderSettings {
    /// Folder for clips, with relative names resolved.
    pub folder: PathBuf,
    /// Whether everything is recorded from the start.
    pub continuous: bool,
    /// Seconds kept on disk for saving later; 0 = none.
    pub ring_s: f64,
}

/// The `[log]` section.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LogSettings {
    /// The minimum severity of messages to write.
    pub level: LevelFilter,
    /// One line of text or one JSON object per message.
    pub format: LogFormat,
}

impl Default for LogSettings {
    fn default() -> Self {
        Self { level: LevelFilter::WARN, format: LogFormat::Text }
    }
}

/// The words for a minimum severity, in config and on the command line.
pub const LOG_LEVELS: [(&str, LevelFilter); 6] = [
    ("off", LevelFilter::OFF),
    ("error", LevelFilter::ERROR),
    ("warn", LevelFilter::WARN),
    ("info", LevelFilter::INFO),
    ("debug", LevelFilter::DEBUG),
    ("trace", LevelFilter::TRACE),
];

/// The format of log messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LogFormat {
    /// A line of text.
    Text,
    /// A JSON object.
    Json,
}

impl Settings {
    /// Reads a config file and every file it names.
    ///
    /// # Errors
    /// The first problem, with its place and its fix.
    pub fn load(file: &Path) -> Result<Self, ConfigError> {
        Self::from_text(&read_text(file)?, file)
    }

    /// As [`load`](Self::load), but the config may lack a stage; it then has no surfaces.
    ///
    /// # Errors
    /// As [`load`](Self::load).
    pub(crate) fn load_camera(file: &Path) -> Result<Self, ConfigError> {
        Self::camera_from_text(&read_text(file)?, file)
    }

    /// As [`load_camera`](Self::load_camera), with the text at hand.
    pub(crate) fn camera_from_text(text: &str, file: &Path) -> Result<Self, ConfigError> {
        Self::read(text, file, false)
    }

    /// As [`load`](Self::load), for a text that is stored in another file than the one it belongs
    /// to.
    pub fn load_as(text: &Path, file: &Path) -> Result<Self, ConfigError> {
        Self::from_text(&read_text(text)?, file)
    }

    /// As [`load`](Self::load), with the text at hand; `file` is its name, to which paths are
    /// relative.
    pub fn from_text(text: &str, file: &Path) -> Result<Self, ConfigError> {
        Self::read(text, file, true)
    }

    fn read(text: &str, file: &Path, needs_stage: bool) -> Result<Self, ConfigError> {
        let typed = as_typed::Config::parse(text, file)?;
        let origin = Origin::new(file, text);
        refuse_many(&origin, &typed)?;
        let (mut notes, mut warnings) = (Vec::new(), Vec::new());
        let section = Section { origin: &origin, name: "[camera]" };
        let (lens, model) = lens(&section, typed.camera.as_ref())?;
        let none = as_typed::Camera::default();
        let camera = typed.camera.as_ref().map_or(&none, Spanned::get_ref);
        let calibration_line = camera.calibration.as_ref().map(Spanned::span).or(typed.camera.as_ref().map(Spanned::span));
        let calibration_line = calibration_line.map_or(1, |span| origin.line(&span));
        let (shutter, transfer) = (shutter(&section, camera)?, transfer(&section, camera.transfer.as_ref())?);
        let mask = camera.mask.as_ref().map(|m| mask(&section, m, lens.size(&model).map(|_| &model))).transpose()?;
        let mut bodies = BodyReader {
            origin: &origin,
            camera: model,
            lens: &lens,
            transfer,
            notes: &mut notes,
            warnings: &mut warnings,
            first_as_typed: Pose::identity(),
        };
        if let Some(calibration) = &camera.calibration {
            bodies.note_camera(calibration.get_ref(), &model);
        }
        let fixed = camera.pose.as_ref().map(|pose| fixed(&section, pose)).transpose()?;
        // What a fixed camera tracks are objects.
        let needs_stage = needs_stage && (fixed.is_none() || typed.object.is_empty());
        let (stage, objects) = (bodies.stage(typed.stage.as_ref(), needs_stage)?, bodies.objects(&typed.object)?);
        let first_as_typed = bodies.first_as_typed;
        let names: Vec<String> = objects.iter().map(|o| o.name.clone()).collect();
        let mount = mount(&origin, typed.mount.as_ref(), &names, &mut notes)?;
        let outputs =
            OutputReader { origin: &origin, objects: names, mount: mount.as_ref(), has_other_tracker: typed.other_tracker.is_some() };
        let files = files_of(&typed, &origin);
        let (device, safety) = (device(&section, camera)?, safety(&origin, typed.safety.as_ref())?);
        notes.extend(device.fps.and_then(|fps| safety.note_on_rate(fps)));
        refuse_overwriting(&typed, &origin, &files)?;
        notes.append(&mut origin.remarks.borrow_mut());
        warnings.append(&mut origin.warnings.borrow_mut());
        Ok(Self {
            file: file.to_owned(),
            measured: measured(&origin, typed.survey.as_ref(), &stage)?,
            named_points: named_points(&origin, typed.map.as_ref())?,
            source: origin.files.with_config(file, text),
            lens,
            calibration_line,
            camera: model,
            shutter,
            mask,
            device,
            stage,
            first_as_typed,
            objects,
            fixed,
            outputs: outputs.outputs(&typed.output)?,
            mount,
            tracker: tracker(&origin, typed.tracker.as_ref(), transfer)?,
            timecode: typed.timecode.as_ref().map(|typed| timecode(&origin, typed)).transpose()?,
            other_tracker: typed.other_tracker.as_ref().map(|typed| other_tracker(&origin, typed)).transpose()?,
            recorder: recorder(&origin, typed.recorder.as_ref())?,
            filter: filter(&origin, typed.filter.as_ref())?,
            safety,
            http: http(&origin, typed.http.as_ref())?,
            log: log(&origin, typed.log.as_ref())?,
            files,
            notes,
            warnings,
        })
    }

    /// Reads only what sending needs: the config may lack a stage or camera.
    ///
    /// # Errors
    /// As [`load`](Self::load), for `[[output]]`, `[safety]`, `[http]`, `[log]` and the objects'
    /// names, and for the calibration if its file exists.
    pub(crate) fn load_outputs(file: &Path) -> Result<SendingSettings, ConfigError> {
        let text = read_text(file)?;
        let (typed, origin) = (as_typed::Config::parse(&text, file)?, Origin::new(file, &text));
        let section = Section { origin: &origin, name: "[camera]" };
        let calibration = typed.camera.as_ref().and_then(|camera| camera.get_ref().calibration.as_ref());
        let missing_calibration = calibration.map(|name| origin.beside(name.get_ref())).filter(|file| !file.exists());
        let camera = typed.camera.as_ref().filter(|_| missing_calibration.is_none());
        let found = camera.map(|camera| lens::found(&section, camera.get_ref())).transpose()?.flatten();
        let names = typed.object.iter().filter_map(|object| object.get_ref().name.as_ref());
        let objects: Vec<String> = names.map(|name| name.get_ref().clone()).collect();
        let mount = mount(&origin, typed.mount.as_ref(), &objects, &mut Vec::new())?;
        let outputs = OutputReader {
            origin: &origin,
            objects: objects.clone(),
            mount: mount.as_ref(),
            has_other_tracker: typed.other_tracker.is_some(),
        };
        Ok(SendingSettings {
            camera: found.map(|(_, camera)| camera),
            missing_calibration,
            outputs: refuse_overwriting(&typed, &origin, &files_of(&typed, &origin)).and_then(|()| outputs.outputs(&typed.output))?,
            objects,
            mount,
            safety: safety(&origin, typed.safety.as_ref())?,
            http: http(&origin, typed.http.as_ref())?,
            log: log(&origin, typed.log.as_ref())?,
        })
    }

    /// Returns the camera for pictures of a size, and a note if the calibration had to be scaled.
    ///
    /// # Errors
    /// [`ConfigError::PictureSize`] if the aspect ratio differs.
    pub fn camera_for(&self, width: u32, height: u32) -> Result<(CameraModel, Option<String>), ConfigError> {
        let (from_width, from_height) = (self.camera.width(), self.camera.height());
        let problem = |problem| ConfigError::PictureSize { file: self.file.clone(), line: self.calibration_line, problem };
        if let LensSource::Guess(guess, None) = self.lens {
            let camera = guess.camera(width, height).map_err(problem)?;
            self.mask_fits(&camera)?;
            return Ok((camera, None));
        }
        if (from_width, from_height) == (width, height) {
            return Ok((self.camera, None));
        }
        let scaled = self.camera.scaled_to(width, height).map_err(problem)?;
        let note = format!("the calibration for {from_width} x {from_height} pixels is scaled to the pictures' {width} x {height}");
        Ok((scaled, Some(note)))
    }

    /// Returns a tracker's setup for pictures of a size, and a note on the camera, if any.
    ///
    /// # Errors
    /// As [`camera_for`](Self::camera_for).
    pub fn tracker_setup(&self, width: u32, height: u32) -> Result<(TrackerSetup, Option<String>), ConfigError> {
        let (camera, note) = self.camera_for(width, height)?;
        let setup = TrackerSetup {
            shutter: self.shutter,
            mask: self.mask_for(width, height),
            objects: self.objects.clone(),
            fixed: self.fixed,
            settings: self.tracker.clone(),
            ..TrackerSetup::new(camera, self.stage.clone())
        };
        Ok((setup, note))
    }

    /// Checks a mask whose camera was not known when the config was read.
    fn mask_fits(&self, camera: &CameraModel) -> Result<(), ConfigError> {
        let Some(mask_size) = self.mask.as_ref().map(GrayImage::dimensions).filter(|(w, h)| camera.scaled_to(*w, *h).is_err()) else {
            return Ok(());
        };
        let text = &self.source.text;
        let (typed, origin) = (as_typed::Config::parse(text, &self.file)?, Origin::new(&self.file, text));
        let typed = typed.camera.and_then(|camera| camera.into_inner().mask);
        let (name, span) = typed.map_or((String::new(), 0..0), |mask| (mask.get_ref().clone(), mask.span()));
        Err(origin.value("[camera]", "mask", &span, mask_size_problem(origin.beside(&name), mask_size, camera)))
    }

    /// Returns the mask at the pictures' size.
    pub(super) fn mask_for(&self, width: u32, height: u32) -> Option<GrayImage> {
        self.mask.as_ref().map(|mask| match mask.dimensions() == (width, height) {
            true => mask.clone(),
            false => resize(mask, width, height, FilterType::Nearest),
        })
    }
}

fn mask_size_problem(file: PathBuf, (width, height): (u32, u32), camera: &CameraModel) -> Problem {
    let (camera_width, camera_height) = (camera.width(), camera.height());
    Problem::MaskSize { file, width, height, camera_width, camera_height }
}

/// Refuses an output's file that is a folder, or a file that the config reads, by whatever name.
fn refuse_overwriting(typed: &as_typed::Config, origin: &Origin<'_>, files: &[PathBuf]) -> Result<(), ConfigError> {
    let identity = |file: &Path| std::fs::metadata(file).ok().map(|about| (about.dev(), about.ino()));
    for file in typed.output.iter().filter_map(|output| output.get_ref().file.as_ref()).filter(|file| file.get_ref() != "-") {
        let path = origin.beside(file.get_ref());
        let Some(own) = identity(&path) else { continue };
        let problem = if path.is_dir() {
            Problem::OutputFile { file: path, reason: "it is a folder".to_owned() }
        } else if files.iter().any(|read| identity(read) == Some(own)) {
            Problem::OutputIsInput(path)
        } else {
            continue;
        };
        return Err(origin.value(OUTPUT, "file", &file.span(), problem));
    }
    Ok(())
}

/// Returns the config file and every file it names.
fn files_of(typed: &as_typed::Config, origin: &Origin<'_>) -> Vec<PathBuf> {
    let named = named_files(typed).into_iter().map(|(name, _)| origin.beside(name.get_ref()));
    std::iter::once(origin.file.to_owned()).chain(named).collect()
}

fn mask(section: &Section<'_>, typed: &Spanned<String>, camera: Option<&CameraModel>) -> Result<GrayImage, ConfigError> {
    let picture = section.raw_picture("mask", typed, "a mask covers")?;
    let file = section.origin.beside(typed.get_ref());
    let (width, height) = picture.dimensions();
    // A mask painted on a scaled picture of the camera is fine.
    if let Some(camera) = camera.filter(|camera| camera.scaled_to(width, height).is_err()) {
        return Err(section.refuse("mask", &typed.span(), mask_size_problem(file, (width, height), camera)));
    }
    if picture.as_raw().iter().all(|&level| level == 0) {
        return Err(section.refuse("mask", &typed.span(), Problem::MaskBlack(file)));
    }
    Ok(picture)
}

fn device(section: &Section<'_>, typed: &as_typed::Camera) -> Result<DeviceSettings, ConfigError> {
    let fps = section.number("fps", typed.fps.as_ref(), 0.0, |v| v > 0.0 && v <= 1000.0, "frames per second, above 0, at most 1000")?;
    let formats = [
        ("mjpeg", Some(PixelLayout::Mjpeg)),
        ("yuyv", Some(PixelLayout::Yuyv)),
        ("nv12", Some(PixelLayout::Nv12)),
        ("grey", Some(PixelLayout::Grey)),
        ("rgb", Some(PixelLayout::Rgb)),
    ];
    let latency = section.number("latency_s", typed.latency_s.as_ref(), 0.0, |v| (0.0..=2.0).contains(&v), "seconds from 0 to 2")?;
    let controls = typed.controls.iter().flatten().map(|(name, value)| (name.clone(), value.get_ref().0)).collect();
    let device = typed.device.as_ref().map(|d| section.text("device", d, "a device such as \"/dev/video0\"")).transpose()?;
    Ok(DeviceSettings {
        device,
        width: section.side("width", typed.width.as_ref())?,
        height: section.side("height", typed.height.as_ref())?,
        fps: typed.fps.as_ref().map(|_| fps),
        format: section.word("format", typed.format.as_ref(), None, &formats, "mjpeg, yuyv, nv12, grey or rgb")?,
        controls,
        latency: Duration::from_secs_f64(latency),
    })
}

fn tracker(origin: &Origin<'_>, typed: Option<&as_typed::Tracker>, transfer: Option<Transfer>) -> Result<TrackerSettings, ConfigError> {
    let default = TrackerSettings { transfer, ..TrackerSettings::default() };
    let Some(typed) = typed else { return Ok(default) };
    let section = Section { origin, name: "[tracker]" };
    let threads = section.count("threads", typed.threads.as_ref(), default.threads as u64, 1..=64, "1 to 64 threads")?;
    let features = section.count("features", typed.features.as_ref(), default.features as u64, 100..=20_000, "100 to 20000 corners")?;
    let confirm =
        section.count("confirm_frames", typed.confirm_frames.as_ref(), default.confirm_frames.into(), 2..=100, "2 to 100 frames")?;
    let coast = |v: f64| (0.0..=10.0).contains(&v);
    Ok(TrackerSettings {
        threads: threads as usize,
        features: features as usize,
        coast_s: section.number("coast_s", typed.coast_s.as_ref(), default.coast_s, coast, "seconds from 0 to 10")?,
        confirm_frames: confirm as u32,
        seed: section.count("seed", typed.seed.as_ref(), default.seed, 0..=u64::MAX, "a whole number of 0 or more")?,
        ..default
    })
}

fn recorder(origin: &Origin<'_>, typed: Option<&as_typed::Recorder>) -> Result<RecorderSettings, ConfigError> {
    let section = Section { origin, name: "[recorder]" };
    let folder = typed.and_then(|t| t.folder.as_ref());
    let folder = folder.map(|f| section.text("folder", f, "a folder such as \"recordings\"")).transpose()?;
    let within = |v: f64| (0.0..=3600.0).contains(&v);
    let ring_s = section.number("ring_s", typed.and_then(|t| t.ring_s.as_ref()), 0.0, within, "seconds from 0 (no ring) to 3600")?;
    let continuous = typed.and_then(|t| t.continuous).unwrap_or(false);
    Ok(RecorderSettings { folder: origin.beside(folder.as_deref().unwrap_or("recordings")), continuous, ring_s })
}

fn http(origin: &Origin<'_>, typed: Option<&as_typed::Http>) -> Result<Option<HttpSettings>, ConfigError> {
    let Some(typed) = typed.filter(|http| http.enabled.as_ref().is_none_or(|e| *e.get_ref())) else { return Ok(None) };
    let section = Section { origin, name: "[http]" };
    let listen = typed.listen.as_ref().map(|listen| address(&section, "listen", listen)).transpose()?;
    let wanted = "a host name or an IP address without port, such as \"stage.example.org\" (letters beyond ASCII as xn--…)";
    let host = |typed: &Spanned<String>| HostName::parse(typed.get_ref()).ok_or_else(|| section.unusable("hosts", typed, wanted));
    let hosts = typed.hosts.iter().flatten().map(host).collect::<Result<_, _>>()?;
    Ok(Some(HttpSettings { listen: listen.unwrap_or(HttpSettings::default().listen), hosts }))
}

fn log(origin: &Origin<'_>, typed: Option<&as_typed::Log>) -> Result<LogSettings, ConfigError> {
    let default = LogSettings::default();
    let Some(typed) = typed else { return Ok(default) };
    let section = Section { origin, name: "[log]" };
    let formats = [("text", LogFormat::Text), ("json", LogFormat::Json)];
    let levels = "off, error, warn, info, debug or trace";
    Ok(LogSettings {
        level: section.word("level", typed.level.as_ref(), default.level, &LOG_LEVELS, levels)?,
        format: section.word("format", typed.format.as_ref(), default.format, &formats, "text or json")?,
    })
}
