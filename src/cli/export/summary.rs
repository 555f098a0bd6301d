//! What the command prints: what was written, what was left out, what the format cannot hold.

use std::fmt::Write;

use super::input::Input;
use super::{ExportArguments, Format};
use crate::camera::Intrinsics;
use crate::export::film::principal_offset_px;
use crate::export::scenery::Sheet;
use crate::export::shot::Shot;

/// Offsets of the principal point up to this many pixels are not mentioned: far less than an
/// alignment shows.
const MAX_UNMENTIONED_OFFSET_PX: f64 = 0.01;
/// Frames that a stamp may be away from its row's place before that is mentioned. A camera's stamps
/// scatter by less.
const MAX_UNMENTIONED_FRAMES: f64 = 0.5;

/// Returns the text.
pub fn text(arguments: &ExportArguments, input: &Input, pictures: &[&Sheet]) -> String {
    let file = arguments.output.display();
    let mut text = String::new();
    if let Some(take) = &input.take {
        let (rows, poses) = (take.rows(), take.camera.len());
        let _ = write!(text, "{file}: {poses} of {rows} frames, {} without a pose", rows - poses);
        // MCAP has stamps only.
        let rate = input.rate.filter(|_| arguments.to != Format::Mcap);
        let _ = writeln!(text, "{}", rate.map_or(String::new(), |rate| format!("; {:.3} frames per second", rate.fps())));
        if let Some((row, _, timecode)) = take.timecodes().next() {
            let place = if arguments.to == Format::Chan { "; not in it, a .chan has no place for it" } else { "" };
            let (code, rate, known) = (timecode.code, timecode.rate, take.timecodes().count());
            let _ = writeln!(text, "  timecode {code} in row {row}, at {rate}; {known} of {rows} frames have one{place}");
        }
        for (name, keys) in &take.objects {
            let place = if arguments.to == Format::Chan { "left out, a .chan has one camera" } else { "written" };
            let _ = writeln!(text, "  {name}: {} of {rows} frames, {place}", keys.len());
        }
    } else {
        let surfaces = input.settings.as_ref().map_or(0, |settings| settings.stage.surfaces.len());
        let _ = writeln!(text, "{file}: the stage, {surfaces} {}", if surfaces == 1 { "surface" } else { "surfaces" });
    }
    if arguments.to == Format::Chan && input.lens.is_none() {
        let _ = writeln!(text, "  without the field of view; --config FILE adds it");
    }
    for sheet in pictures {
        let _ = writeln!(text, "  beside it: {}", sheet.picture);
    }
    for sentence in input.lens.as_ref().map(|lens| not_held(arguments.to, lens)).into_iter().flatten().chain(off_the_grid(arguments, input))
    {
        let _ = writeln!(text, "  {sentence}");
    }
    text
}

/// Returns what of this lens the format cannot hold.
fn not_held(to: Format, lens: &Intrinsics) -> Vec<String> {
    let mut sentences = Vec::new();
    let has_distortion = lens.distortion.iter().any(|k| *k != 0.0);
    match to {
        Format::Mcap | Format::Obj => return sentences,
        Format::Usd if has_distortion => {
            sentences.push("the camera is a pinhole; the distortion stands in its attributes, for undistorted pictures".to_owned());
        }
        _ if has_distortion => sentences.push("not in it: the distortion; it fits undistorted pictures".to_owned()),
        _ => {}
    }
    if lens.skew != 0.0 {
        sentences.push(format!("not in it: the skew, {}", lens.skew));
    }
    let [right, down] = principal_offset_px(lens);
    if matches!(to, Format::Chan | Format::Gltf) && right.abs().max(down.abs()) > MAX_UNMENTIONED_OFFSET_PX {
        sentences.push(format!(
            "not in it: the principal point, {:.2} px {} and {:.2} px {} the picture's centre; usd, blender and ae have it",
            right.abs(),
            if right < 0.0 { "left of" } else { "right of" },
            down.abs(),
            if down < 0.0 { "above" } else { "below" },
        ));
    }
    if to == Format::Chan && lens.fx != lens.fy {
        sentences.push(format!("not in it: fx is {:.6} times fy", lens.fx / lens.fy));
    }
    sentences
}

/// Returns a warning if a row's stamp is elsewhere than its frame.
fn off_the_grid(arguments: &ExportArguments, input: &Input) -> Option<String> {
    let (take, lens, rate) = (input.take.as_ref()?, input.lens.as_ref()?, input.rate.filter(|_| arguments.to.counts_rows())?);
    let shot = Shot { take, lens, rate };
    let off = |row: usize, code: f64| code - row as f64;
    let farthest = take.camera.iter().map(|key| (key.row, off(key.row, shot.code(key.timestamp))));
    let (row, frames) = farthest.max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))?;
    (frames.abs() > MAX_UNMENTIONED_FRAMES).then(|| {
        format!(
            "note: by its stamp, row {row} is {frames:+.1} frames away from its place; pictures are missing from the clip, or --fps is \
             wrong. Every row is one frame here; usd, gltf and mcap follow the stamps"
        )
    })
}
