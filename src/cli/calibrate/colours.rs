//! Lateral colour: reads the pictures used a second time, in colour, one after the other.

use std::collections::HashMap;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;

use super::CalibrateArguments;
use super::pictures::{LARGE_PIXELS, frame_name};
use crate::calibrate::lateral_colour::{CornerColours, LateralColour, READ_ONCE};
use crate::calibrate::picture::Inspected;
use crate::calibrate::session::CameraCalibration;
use crate::capture::{ClipOptions, MAX_PICTURE_FILE, decode_colours, open_clip_in_colour, picture_size};
use crate::cli::failure::Failure;
use crate::cli::interrupt;
use crate::safe_file;

/// Measures the lateral colour, or returns why it is not measured. Pictures that a camera took are
/// kept in grey, so they have none.
pub(super) fn measured(
    arguments: &CalibrateArguments,
    made: &CameraCalibration,
    pictures: &[Inspected],
) -> Result<Result<LateralColour, &'static str>, Failure> {
    if arguments.device.is_some() || arguments.play.is_some() {
        return Ok(LateralColour::of(&[], made.size));
    }
    let large = Mutex::new(());
    let mut views: Vec<Vec<CornerColours>> = pictures
        .par_iter()
        .enumerate()
        .filter(|(k, _)| made.views[*k].used && !interrupt::is_interrupted())
        .filter_map(|(k, inspected)| of_file(made, k, inspected, &large))
        .collect();
    let clip = arguments.clip.as_deref();
    let in_clip = clip.map(|clip| of_clip(clip, made, pictures));
    let is_lost = in_clip == Some(None);
    views.extend(in_clip.flatten().into_iter().flatten());
    if interrupt::is_interrupted() {
        return Err(Failure::Calibration("interrupted; nothing is written".to_owned()));
    }
    Ok(if is_lost && views.is_empty() { Err(READ_ONCE) } else { LateralColour::of(&views, made.size) })
}

/// Measures a picture file; `None` if it is grey or no longer what it was.
fn of_file(made: &CameraCalibration, view: usize, inspected: &Inspected, large: &Mutex<()>) -> Option<Vec<CornerColours>> {
    // A pipe can be read only once; a clip's frame is no file.
    inspected.file.is_file().then_some(())?;
    let bytes = safe_file::read(&inspected.file, MAX_PICTURE_FILE).ok()?;
    let is_large = picture_size(&bytes).is_some_and(|(w, h)| u64::from(w) * u64::from(h) > LARGE_PIXELS);
    let _alone = is_large.then(|| large.lock().unwrap_or_else(PoisonError::into_inner));
    made.corner_colours(view, inspected, &decode_colours(&bytes)?)
}

/// Measures the used frames of a clip, up to the last of them; `None` if the clip cannot be read
/// again.
fn of_clip(clip: &Path, made: &CameraCalibration, pictures: &[Inspected]) -> Option<Vec<Vec<CornerColours>>> {
    // What a pipe held is gone.
    (clip.as_os_str() != "-" && (clip.is_file() || clip.is_dir())).then_some(())?;
    let used = pictures.iter().enumerate().filter(|(k, _)| made.views[*k].used);
    let mut wanted: HashMap<&Path, usize> = used.map(|(k, inspected)| (inspected.file.as_path(), k)).collect();
    let options = ClipOptions { is_stopped: Some(interrupt::is_interrupted), ..ClipOptions::default() };
    let mut source = open_clip_in_colour(clip, options).ok()?;
    let mut views = Vec::new();
    while let Some(row) = source.next_entry().filter(|_| !wanted.is_empty() && !interrupt::is_interrupted()) {
        let Some(view) = wanted.remove(frame_name(clip, row.sequence).as_path()) else { continue };
        let colours = row.received.and_then(|received| received.colours());
        views.extend(colours.and_then(|colours| made.corner_colours(view, &pictures[view], &colours)));
    }
    Some(views)
}
