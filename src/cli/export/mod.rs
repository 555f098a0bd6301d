//! `stagepose export`: the poses of a take, or the stage itself, for another program (contract
//! C14).

mod input;
mod recording;
mod summary;

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use super::calibrate::write_whole;
use super::failure::Failure;
use super::logging::LogArguments;
use super::output_file::print;
use super::spared::Spared;
use super::stage_files::scenery_with_artwork;
use crate::camera::Intrinsics;
use crate::config::Settings;
use crate::export::rate::Rate;
use crate::export::scenery::Scenery;
use crate::export::shot::Shot;
use crate::export::take::Take;
use crate::export::{after_effects, blender, chan, gltf, obj, usd};
use crate::printable::printable_lines;
use crate::track::BodySpec;
use input::Input;

/// Write the poses of a take, or the stage itself, for another program.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  stagepose export poses.jsonl --to usd --config stage.toml --output take.usda\n  \
    stagepose export take1 --to blender --output take1.py\n  stagepose export --config stage.toml --to gltf --output stage.gltf\n\n\
    Example:\n  stagepose export poses.jsonl --to chan --config stage.toml --output take.chan\n\n\
    POSES is what `replay --poses` wrote, or a recording. usd, chan, blender, ae, mcap and gltf hold its poses; a frame without a pose stays \
    a gap. Without POSES, the stage is written as it hangs, with its artwork: obj, gltf or usd. docs/export.md says what each format holds.")]
pub(super) struct ExportArguments {
    /// Poses (JSON lines of `replay --poses`), or a recording's folder; without, the stage is
    /// written
    poses: Option<PathBuf>,
    /// The format
    #[arg(long, value_enum)]
    to: Format,
    /// The file to write; pictures of the stage go beside it
    #[arg(long, short, value_name = "FILE")]
    output: PathBuf,
    /// The config with which the poses were tracked: its lens and its stage [default: a recording's
    /// own]
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Frames per second, such as 25 or 29.97 [default: the median of the stamps]
    #[arg(long, value_name = "N")]
    fps: Option<f64>,
    /// Size of the clip's pictures [default: the calibration's]
    #[arg(long, value_name = "WxH")]
    size: Option<String>,
    #[command(flatten)]
    log: LogArguments,
}

/// What can be written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    /// USD as text, .usda
    Usd,
    /// Nuke's channel file
    Chan,
    /// A Python script for Blender
    Blender,
    /// A script for After Effects
    Ae,
    /// MCAP, for Foxglove and rerun
    Mcap,
    /// glTF 2.0 in one file
    Gltf,
    /// Wavefront OBJ: the stage only
    Obj,
}

impl Format {
    /// Returns the word for `--to`.
    fn word(self) -> &'static str {
        match self {
            Self::Usd => "usd",
            Self::Chan => "chan",
            Self::Blender => "blender",
            Self::Ae => "ae",
            Self::Mcap => "mcap",
            Self::Gltf => "gltf",
            Self::Obj => "obj",
        }
    }

    /// Returns the endings that programs expect, the usual one first.
    fn endings(self) -> &'static [&'static str] {
        match self {
            Self::Usd => &["usda", "usd"],
            Self::Blender => &["py"],
            Self::Ae => &["jsx"],
            Self::Chan => &["chan"],
            Self::Mcap => &["mcap"],
            Self::Gltf => &["gltf"],
            Self::Obj => &["obj"],
        }
    }

    /// Whether it cannot be written without a lens.
    fn needs_lens(self) -> bool {
        matches!(self, Self::Usd | Self::Blender | Self::Ae | Self::Gltf)
    }

    /// Whether the artwork lies in files beside it.
    fn has_pictures_beside(self) -> bool {
        matches!(self, Self::Usd | Self::Blender | Self::Obj)
    }

    /// Whether it holds the artwork, beside it or inside.
    fn holds_artwork(self) -> bool {
        self.has_pictures_beside() || self == Self::Gltf
    }

    /// Whether its poses stand at the rows of the clip, not at their stamps.
    fn counts_rows(self) -> bool {
        matches!(self, Self::Chan | Self::Blender | Self::Ae)
    }
}

/// Runs the command.
///
/// # Errors
/// Bad usage, a bad config, poses that cannot be read, an output that cannot be written.
pub(super) fn run(arguments: &ExportArguments) -> Result<(), Failure> {
    refuse_ending(arguments)?;
    let input = Input::read(arguments)?;
    let scenery = input.settings.as_ref().map_or_else(|| Ok(Scenery::default()), |settings| scenery(settings, arguments))?;
    let mut spared = Spared::default()
        .with_files(input.poses.iter(), "the poses")
        .with_files(input.settings.iter().flat_map(|settings| &settings.files), "a file of the config");
    if let Some(recording) = arguments.poses.as_ref().filter(|poses| poses.is_dir()) {
        spared = spared.with_clip(recording);
    }
    spared.claim_whole_files(&[("--output", &Some(arguments.output.clone()))])?;
    let beside = |name: &str| arguments.output.with_file_name(name);
    let pictures: Vec<_> = scenery.shown(input.take.as_ref()).filter(|_| arguments.to.has_pictures_beside()).collect();
    for sheet in &pictures {
        spared.claim("a picture beside --output:", &beside(&sheet.picture))?;
    }
    let materials = arguments.output.with_extension("mtl");
    if arguments.to == Format::Obj {
        spared.claim("the materials beside --output:", &materials)?;
    }
    let bytes = match &input.take {
        Some(take) => of_take(arguments, take, &input, &scenery)?,
        None => Some(of_stage(arguments, &scenery, &materials)?),
    };
    for sheet in &pictures {
        write_whole(&beside(&sheet.picture), &sheet.png)?;
    }
    if let Some(bytes) = bytes {
        write_whole(&arguments.output, bytes)?;
    }
    print(printable_lines(&summary::text(arguments, &input, &pictures)).as_bytes())
}

fn refuse_ending(arguments: &ExportArguments) -> Result<(), Failure> {
    let (file, to) = (&arguments.output, arguments.to);
    let ending = file.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    if to.endings().contains(&ending.as_str()) {
        return Ok(());
    }
    Err(Failure::Usage(format!(
        "--output is {}; --to {} writes .{}: give a file that ends so",
        file.display(),
        to.word(),
        to.endings().join(" or .")
    )))
}

/// Returns a take in its format; `None` for MCAP, which is written as it is made.
fn of_take(arguments: &ExportArguments, take: &Take, input: &Input, scenery: &Scenery) -> Result<Option<Vec<u8>>, Failure> {
    let lens = input.lens.as_ref();
    let shot = |write: fn(&Shot<'_>, &Scenery) -> String| -> Result<Vec<u8>, Failure> {
        let (lens, rate) = input.lens_and_rate(arguments)?;
        Ok(write(&Shot { take, lens, rate }, scenery).into_bytes())
    };
    let bytes = match arguments.to {
        Format::Usd => shot(|shot, scenery| usd::write(Some(shot), scenery)),
        Format::Gltf => shot(|shot, scenery| gltf::write(Some(shot), scenery)),
        Format::Blender => shot(blender::write),
        Format::Ae => shot(after_effects::write),
        Format::Chan => Ok(chan::write(take, lens).into_bytes()),
        Format::Mcap => return recording::write_mcap(arguments, take, input).map(|()| None),
        Format::Obj => Err(Failure::Usage("--to obj is for the stage itself; omit POSES, or choose another format".to_owned())),
    };
    bytes.map(Some)
}

/// Returns the stage in a format; an OBJ's materials are written to their own file.
fn of_stage(arguments: &ExportArguments, scenery: &Scenery, materials: &Path) -> Result<Vec<u8>, Failure> {
    match arguments.to {
        Format::Usd => Ok(usd::write(None, scenery).into_bytes()),
        Format::Gltf => Ok(gltf::write(None, scenery).into_bytes()),
        _ => {
            let name = materials.file_name().unwrap_or_default().to_string_lossy();
            let [text, mtl] = obj::write(scenery, &name);
            write_whole(materials, mtl)?;
            Ok(text.into_bytes())
        }
    }
}

/// Builds the meshes of a config, with their artwork in colour where the format holds it.
fn scenery(settings: &Settings, arguments: &ExportArguments) -> Result<Scenery, Failure> {
    let ExportArguments { output, to, .. } = arguments;
    let stem = output.file_stem().unwrap_or_default().to_string_lossy();
    if to.holds_artwork() {
        return scenery_with_artwork(settings, &stem).map_err(|e| Failure::output(output)(std::io::Error::other(e)));
    }
    let none = |body: &BodySpec| vec![Vec::new(); body.surfaces.len()];
    Ok(Scenery::new(&settings.stage, &settings.objects, none(&settings.stage), settings.objects.iter().map(none).collect(), &stem))
}

/// The rate that `--fps` asks for.
fn typed_rate(fps: f64) -> Result<Rate, Failure> {
    Rate::new(fps).ok_or_else(|| Failure::Usage(format!("--fps is {fps}; give the clip's frames per second, from 0.1 to 10000")))
}

/// The lens for pictures of a size; see [`ExportArguments::size`].
fn lens_of(settings: &Settings, size: Option<(u32, u32)>) -> Result<Intrinsics, Failure> {
    let Some((width, height)) = size.or(settings.lens.size(&settings.camera)) else {
        return Err(Failure::Usage(format!(
            "{}: its lens is a guess for pictures of any size; add --size WxH with the size of the clip's pictures",
            settings.file.display()
        )));
    };
    Ok(*settings.camera_for(width, height)?.0.intrinsics())
}
