//! What is exported: the poses, and the config they were tracked with.

use std::path::{Path, PathBuf};

use super::{ExportArguments, Format, lens_of, typed_rate};
use crate::camera::Intrinsics;
use crate::cli::clip_timecode::timecode_of_clip;
use crate::cli::failure::Failure;
use crate::cli::logging;
use crate::config::{LogSettings, Settings};
use crate::export::rate::Rate;
use crate::export::take::Take;
use crate::safe_file;

/// Maximum size of a file of poses, bytes: three hours at 60 frames per second. Raised, a wrong
/// file takes more memory.
const MAX_POSES: u64 = 1 << 30;
/// The poses' name in a recording.
const POSES: &str = "poses.jsonl";
/// Maximum side of a picture, pixels; above any camera.
const MAX_SIDE: u32 = 65_535;

/// Everything that was read.
pub struct Input {
    /// The file of poses; `None` for the stage itself.
    pub poses: Option<PathBuf>,
    /// Its records.
    pub take: Option<Take>,
    /// The config, if there is one.
    pub settings: Option<Settings>,
    /// Its lens, if poses are exported.
    pub lens: Option<Intrinsics>,
    /// Frames per second; `None` if nothing states them.
    pub rate: Option<Rate>,
}

impl Input {
    /// Reads what the arguments name.
    ///
    /// # Errors
    /// Arguments that do not fit, a bad config, poses that cannot be read.
    pub fn read(arguments: &ExportArguments) -> Result<Self, Failure> {
        let typed_rate = arguments.fps.map(typed_rate).transpose()?;
        let size = arguments.size.as_deref().map(size).transpose()?;
        let recording = arguments.poses.as_ref().filter(|poses| poses.is_dir());
        if let Some(folder) = recording.filter(|folder| !folder.join(POSES).is_file()) {
            let reason = format!("is no recording: it has no {POSES}; give a recording's folder, or the file that `replay --poses` wrote");
            return Err(Failure::Export { file: folder.clone(), reason });
        }
        let own = recording.map(|folder| folder.join("config/stage.toml")).filter(|file| file.is_file());
        let config = arguments.config.clone().or(own);
        refuse_combinations(arguments, config.as_deref())?;
        let settings = config.map(|config| Settings::load(&config)).transpose()?;
        logging::start(&arguments.log, settings.as_ref().map_or_else(LogSettings::default, |settings| settings.log));
        settings.iter().flat_map(|settings| &settings.warnings).for_each(|warning| tracing::warn!("{warning}"));
        let Some(named) = &arguments.poses else { return Ok(Self { poses: None, take: None, settings, lens: None, rate: None }) };
        let poses = if recording.is_some() { named.join(POSES) } else { named.clone() };
        let lens = settings.as_ref().map(|settings| lens_of(settings, size)).transpose()?;
        let mut take = read_take(&poses)?;
        if let Some(timecode) = timecode_of_clip(settings.as_ref().and_then(|s| s.timecode.as_ref()), poses.parent())? {
            timecode.begin(take.stamp(0));
            take.add_timecode(|stamp| timecode.at(stamp));
        }
        let rate = typed_rate.or_else(|| Rate::of_take(&take));
        Ok(Self { poses: Some(poses), take: Some(take), settings, lens, rate })
    }

    /// Returns the lens and the rate, which some formats need.
    pub fn lens_and_rate(&self, arguments: &ExportArguments) -> Result<(&Intrinsics, Rate), Failure> {
        let lens = self.lens.as_ref().ok_or_else(|| no_lens(arguments.to))?;
        let no_rate = || self.refusal("its stamps give no frame rate; add --fps N with the clip's frames per second".to_owned());
        Ok((lens, self.rate.ok_or_else(no_rate)?))
    }

    /// Returns a failure that names the file of poses.
    pub fn refusal(&self, reason: String) -> Failure {
        Failure::Export { file: self.poses.clone().unwrap_or_default(), reason }
    }
}

fn no_lens(to: Format) -> Failure {
    Failure::Usage(format!("--to {} needs the lens; add --config FILE, the config with which these poses were tracked", to.word()))
}

fn refuse_combinations(arguments: &ExportArguments, config: Option<&Path>) -> Result<(), Failure> {
    let to = arguments.to;
    let refuse = |sentence: String| Err(Failure::Usage(sentence));
    match (&arguments.poses, config) {
        (Some(_), _) if to == Format::Obj => {
            refuse("--to obj is for the stage itself; omit POSES, or give another --to for the poses".to_owned())
        }
        (Some(_), None) if to.needs_lens() => Err(no_lens(to)),
        (Some(_), None) if arguments.size.is_some() => refuse("--size is for a lens; add --config FILE, which has it".to_owned()),
        (None, _) if !matches!(to, Format::Obj | Format::Gltf | Format::Usd) => {
            refuse(format!("--to {} is for poses; give their file, or --to obj, gltf or usd for the stage itself", to.word()))
        }
        (None, None) => refuse("nothing to export; give POSES, or --config FILE for the stage itself".to_owned()),
        (None, _) if arguments.fps.is_some() || arguments.size.is_some() => {
            refuse("--fps and --size are for poses; give their file, or omit them".to_owned())
        }
        _ => Ok(()),
    }
}

fn read_take(file: &Path) -> Result<Take, Failure> {
    let refuse = |reason: String| Failure::Export { file: file.to_owned(), reason };
    let bytes = safe_file::read(file, MAX_POSES)
        .map_err(|e| refuse(format!("cannot be read ({e}); give the JSON lines that `replay --poses` wrote, or a recording's folder")))?;
    Take::parse(bytes).map_err(|e| refuse(e.to_string()))
}

/// Reads a size such as 1920x1080.
fn size(text: &str) -> Result<(u32, u32), Failure> {
    let side = |text: &str| text.trim().parse().ok().filter(|side| (1..=MAX_SIDE).contains(side));
    let sides = text.split_once(['x', 'X']).and_then(|(width, height)| Some((side(width)?, side(height)?)));
    sides.ok_or_else(|| Failure::Usage(format!("--size is {text:?}; give the pictures' size in pixels, such as 1920x1080")))
}
