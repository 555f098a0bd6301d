//! `--device`: takes pictures from a live camera whenever a view is useful, and says which views
//! are missing.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use super::CalibrateArguments;
use super::panel::Panel;
use crate::calibrate::board::Board;
use crate::calibrate::pick::{Look, ViewPicker};
use crate::calibrate::picture::Inspected;
use crate::capture::camera::CameraOpener;
use crate::capture::{EntryContent, FrameSource, PlayedClip};
use crate::cli::failure::Failure;
use crate::cli::interrupt;
use crate::daemon::live::{LiveLink, LiveSource, LiveStop, Patience};
use crate::printable::printable;

/// Takes pictures until the set is good, there are enough, or Ctrl-C is pressed.
pub(super) fn taken(arguments: &CalibrateArguments, board: &Board) -> Result<Vec<Inspected>, Failure> {
    let folder = arguments.save.as_deref();
    folder.map(make_folder).transpose()?;
    let opener = opener(arguments)?;
    interrupt::watch();
    let mut source = LiveSource::start(opener, Default::default(), Patience::default(), LiveLink::default());
    let done = AtomicBool::new(false);
    let stop = source.stopper();
    let pictures = std::thread::scope(|threads| {
        // A camera that delivers no pictures must not delay Ctrl-C.
        threads.spawn(|| end_on_interrupt(&stop, &done));
        let pictures = watched(&mut source, board, arguments.pictures as usize, folder);
        done.store(true, Ordering::Relaxed);
        pictures
    })?;
    if pictures.is_empty() {
        return Err(Failure::Calibration(
            "the camera gave no picture of the board held still; hold it still until the picture is taken, or check what the camera shows"
                .to_owned(),
        ));
    }
    Ok(pictures)
}

fn end_on_interrupt(stop: &LiveStop, done: &AtomicBool) {
    while !done.load(Ordering::Relaxed) {
        if interrupt::is_interrupted() {
            stop.stop();
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Offers frame after frame to the picker.
fn watched(source: &mut dyn FrameSource, board: &Board, most: usize, folder: Option<&Path>) -> Result<Vec<Inspected>, Failure> {
    let mut picker = ViewPicker::new(*board);
    let mut panel = Panel::new();
    while let Some(row) = source.next_entry().filter(|_| !interrupt::is_interrupted()) {
        let EntryContent::Frame(frame) = row.content else { continue };
        let file = picture_file(folder, picker.taken().len() + 1);
        let look = picker.look_at(file.clone(), &frame.image);
        panel.show(picker.taken(), &look, most);
        if look != Look::Taken {
            continue;
        }
        if folder.is_some() {
            frame.image.save(&file).map_err(std::io::Error::other).map_err(Failure::output(&file))?;
        }
        if picker.taken().len() >= most || picker.taken().is_good() {
            break;
        }
    }
    Ok(picker.finish())
}

fn picture_file(folder: Option<&Path>, number: usize) -> PathBuf {
    let name = format!("picture-{number:02}.png");
    folder.map_or_else(|| PathBuf::from(&name), |folder| folder.join(&name))
}

/// Creates the folder for the pictures. A folder with content is refused: its pictures may be
/// another camera's.
fn make_folder(folder: &Path) -> Result<(), Failure> {
    std::fs::create_dir_all(folder).map_err(Failure::output(folder))?;
    let mut inside = std::fs::read_dir(folder).map_err(Failure::output(folder))?;
    match inside.next() {
        None => Ok(()),
        Some(_) => Err(Failure::Usage(format!("--save {}: the folder is not empty; give a new one", folder.display()))),
    }
}

/// Returns what opens the camera. A device is opened once here to check that this works.
fn opener(arguments: &CalibrateArguments) -> Result<Arc<dyn CameraOpener>, Failure> {
    match (&arguments.play, &arguments.device) {
        (Some(clip), _) => {
            let played = PlayedClip::open(clip, None)?;
            for line in played.notes() {
                let _ = writeln!(std::io::stderr(), "stagepose: note: {}", printable(line)); // a closed terminal is no reason to stop
            }
            Ok(Arc::new(played))
        }
        (None, name) => {
            let opener = device(name.as_deref().unwrap_or("first"), size_of(arguments)?)?;
            let camera = opener.open().map_err(|fault| Failure::Device(fault.0))?;
            let mode = camera.mode();
            let first = format!("{}, {} x {}", mode.name, mode.size.0, mode.size.1);
            for line in std::iter::once(&first).chain(&mode.notes) {
                // A closed terminal is no reason to stop.
                let _ = writeln!(std::io::stderr(), "{}", printable(line));
            }
            drop(camera);
            Ok(opener)
        }
    }
}

fn size_of(arguments: &CalibrateArguments) -> Result<Option<(u32, u32)>, Failure> {
    let Some(text) = &arguments.size else { return Ok(None) };
    let parsed = text.split_once(['x', 'X']).and_then(|(w, h)| Some((w.trim().parse().ok()?, h.trim().parse().ok()?)));
    let bad = || Failure::Usage(format!("--size is \"{text}\"; give width x height in pixels, such as 1280x720"));
    parsed.map(Some).ok_or_else(bad)
}

#[cfg(feature = "live")]
fn device(name: &str, size: Option<(u32, u32)>) -> Result<Arc<dyn CameraOpener>, Failure> {
    use crate::capture::choice::Wanted;
    let wanted = Wanted { width: size.map(|s| s.0), height: size.map(|s| s.1), ..Wanted::default() };
    Ok(Arc::new(crate::capture::v4l2::V4l2Opener::new(name.to_owned(), wanted, std::collections::BTreeMap::new())))
}

#[cfg(not(feature = "live"))]
fn device(_: &str, _: Option<(u32, u32)>) -> Result<Arc<dyn CameraOpener>, Failure> {
    Err(crate::cli::run::no_live_feature())
}
