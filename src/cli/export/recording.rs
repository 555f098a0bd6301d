//! A take as MCAP, with the pictures and events of its recording. A file that may be larger than
//! the memory is written as it is made.

use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::ExportArguments;
use super::input::Input;
use crate::capture::{MAX_PICTURE_FILE, read_timestamps};
use crate::cli::failure::Failure;
use crate::export::mcap::{self, Recording};
use crate::export::take::Take;
use crate::frame::Timestamp;
use crate::safe_file;

/// Maximum size of a file of stamps or events, bytes: days. Raised, a foreign file takes more
/// memory.
const MAX_LINES: u64 = 256 << 20;

/// Writes the whole file or nothing: what is begun has another name.
pub(super) fn write_mcap(arguments: &ExportArguments, take: &Take, input: &Input) -> Result<(), Failure> {
    let output = &arguments.output;
    let folder = arguments.poses.as_deref().filter(|poses| poses.is_dir());
    let pictures = folder.map(|folder| pictures(folder, take)).unwrap_or_default();
    let picture = |row: usize| {
        let name = pictures.get(row)?.as_ref()?;
        safe_file::read_below(&folder?.join("frames"), Path::new(name), MAX_PICTURE_FILE).ok()
    };
    let recording = folder.map(|folder| Recording { picture: &picture, events: events(folder) });
    let mut part = output.clone().into_os_string();
    part.push(".part");
    let part = PathBuf::from(part);
    let mut file = BufWriter::new(safe_file::replace(&part).map_err(Failure::output(&part))?);
    let written = mcap::write(take, input.lens.as_ref(), recording.as_ref(), &mut file);
    match written.and_then(|()| file.flush().map_err(mcap::McapError::Write)) {
        Ok(()) => std::fs::rename(&part, output).map_err(Failure::output(output)),
        Err(error) => {
            drop(file);
            // What cannot be removed stays under its other name.
            let _ = std::fs::remove_file(&part);
            Err(match error {
                mcap::McapError::Write(source) => Failure::output(output)(source),
                other => input.refusal(other.to_string()),
            })
        }
    }
}

/// Returns the name of each row's JPEG below `frames`; `None` where the index has another stamp, or
/// the picture is no JPEG. Empty without a readable index.
fn pictures(folder: &Path, take: &Take) -> Vec<Option<String>> {
    let Ok(bytes) = safe_file::read(&folder.join("timestamps.csv"), MAX_LINES) else { return Vec::new() };
    let rows = read_timestamps(&bytes[..]).unwrap_or_default();
    let is_jpeg = |name: &str| [".jpg", ".jpeg"].iter().any(|end| name.to_ascii_lowercase().ends_with(end));
    let stamps = (0..take.rows()).map(|row| take.stamp(row));
    rows.into_iter().zip(stamps).map(|(row, stamp)| (row.stamp == Ok(stamp) && is_jpeg(&row.file)).then_some(row.file)).collect()
}

/// Returns a recording's events with their stamps; a line that is none is left out.
fn events(folder: &Path) -> Vec<(Timestamp, String)> {
    #[derive(Deserialize)]
    struct Line {
        timestamp_ns: Timestamp,
    }
    let Ok(bytes) = safe_file::read(&folder.join("events.jsonl"), MAX_LINES) else { return Vec::new() };
    let text = String::from_utf8_lossy(&bytes);
    let event = |line: &str| Some((serde_json::from_str::<Line>(line).ok()?.timestamp_ns, line.to_owned()));
    let mut events: Vec<_> = text.lines().filter_map(event).collect();
    events.sort_by_key(|(at, _)| *at);
    events
}
