//! Opens a clip of any format. The format is determined by the type of file, then its first bytes,
//! then its name.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::os::unix::fs::FileTypeExt;
use std::path::Path;

use super::FrameSource;
use super::avi::{AviError, AviReader};
use super::clip::Clip;
use super::colour::Coloured;
use super::error::CaptureError;
use super::ffmpeg::Ffmpeg;
use super::mjpeg::MjpegReader;
use super::picture_stream::PictureStream;
use super::rate::FrameRate;
use super::remarks;
use super::video::Paced;
use super::waiting::Waiting;
use super::y4m::Y4mReader;
use super::{folder, foreign};
use crate::safe_file;

/// Options for opening a clip.
#[derive(Debug, Clone, Copy, Default)]
#[non_exhaustive]
pub struct ClipOptions {
    /// Frames per second. Overrides a video's own rate. Pictures without stamps and .mjpeg have no
    /// rate; their default is 30. A timestamps.csv keeps its own stamps.
    pub fps: Option<f64>,
    /// Width and height of the camera's calibration. Decides the clip's size if its pictures differ
    /// in size.
    pub calibrated: Option<(u32, u32)>,
    /// Polled while waiting for a pipe; the clip ends once it returns true.
    pub is_stopped: Option<fn() -> bool>,
}

/// Default rate of pictures without one, frames per second: a webcam's. If it is too high, poses
/// seem to move too fast, and the motion model expects that.
const DEFAULT_FPS: f64 = 30.0;

/// Opens a clip: a folder with frames/ and timestamps.csv, a folder of pictures, a .y4m, MJPEG .avi
/// or .mjpeg file, a single picture, `-` for y4m on stdin, or anything that an installed ffmpeg
/// reads.
///
/// Reads ahead to the first frame, which sets the clip's size. Frame n of a clip with a rate is
/// stamped n / rate.
///
/// # Errors
/// When the clip does not exist, is not a clip, or has no row that is a frame: see
/// [`CaptureError`].
pub fn open_clip(clip: impl AsRef<Path>, options: ClipOptions) -> Result<Box<dyn FrameSource>, CaptureError> {
    open(clip.as_ref(), options, false)
}

/// Opens a clip like [`open_clip`], with rows that also carry their pictures' colours in
/// [`ClipEntry::received`](super::ClipEntry::received). The grey frames are bit-identical. It costs
/// memory, and a second ffmpeg process for what ffmpeg reads.
///
/// # Errors
/// As [`open_clip`].
pub fn open_clip_in_colour(clip: impl AsRef<Path>, options: ClipOptions) -> Result<Box<dyn FrameSource>, CaptureError> {
    open(clip.as_ref(), options, true)
}

fn open(path: &Path, options: ClipOptions, colours: bool) -> Result<Box<dyn FrameSource>, CaptureError> {
    let given = match options.fps {
        Some(fps) => Some(FrameRate::new(fps, 1.0).ok_or(CaptureError::Rate { fps })?),
        None => None,
    };
    let default = FrameRate::new(DEFAULT_FPS, 1.0).ok_or(CaptureError::Rate { fps: DEFAULT_FPS })?;
    let (unreadable, is_stopped) = (|e| CaptureError::reading(path, e), options.is_stopped.unwrap_or(|| false));
    let stream = if path.as_os_str() == "-" {
        let stdin = Path::new("standard input");
        let input = Waiting::stdin(is_stopped).map_err(|e| CaptureError::reading(stdin, e))?;
        y4m(BufReader::new(input), stdin, given, (None, colours))?
    } else {
        let kind = std::fs::metadata(path).map_err(unreadable)?.file_type();
        if kind.is_dir() {
            folder::open(path, given, default)?
        } else if kind.is_fifo() {
            // A pipe cannot be rewound, so it must be y4m, which needs no look at its first bytes.
            y4m(BufReader::new(Waiting::named_pipe(path, is_stopped).map_err(unreadable)?), path, given, (None, colours))?
        } else {
            open_file(path, given, default, colours)?
        }
    };
    Ok(Box::new(Clip::new(stream, path, options.calibrated, colours)?))
}

fn open_file(path: &Path, given: Option<FrameRate>, default: FrameRate, colours: bool) -> Result<Box<dyn PictureStream>, CaptureError> {
    let unreadable = |e| CaptureError::reading(path, e);
    let mut file = safe_file::open(path).map_err(unreadable)?;
    let mut start = Vec::new();
    (&mut file).take(64).read_to_end(&mut start).map_err(unreadable)?;
    if start.is_empty() {
        return Err(CaptureError::Empty { path: path.to_owned() });
    }
    file.seek(SeekFrom::Start(0)).map_err(unreadable)?;
    let bytes = file.metadata().map_err(unreadable)?.len();
    let input = BufReader::with_capacity(1 << 16, file);
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    match (start.as_slice(), extension.as_str()) {
        ([b'Y', b'U', b'V', b'4', b'M', ..], _) | (_, "y4m") => y4m(input, path, given, (Some(bytes), colours)),
        ([b'R', b'I', b'F', b'F', _, _, _, _, b'A', b'V', b'I', ..], _) => avi(input, path, given, colours),
        // `--` begins the parts of a web camera's stream, each with a header of its own, as a
        // browser or curl saves them.
        ([0xFF, 0xD8, 0xFF, ..], _) | ([b'-', b'-', ..], _) | (_, "mjpeg" | "mjpg") => {
            let note = given.is_none().then(|| remarks::rate_made_up(&DEFAULT_FPS.to_string()));
            Ok(Box::new(Paced::new(MjpegReader::new(input), given.unwrap_or(default), None).with_note(note)))
        }
        // PNG and PNM signatures.
        ([0x89, b'P', b'N', b'G', ..] | [b'P', b'1'..=b'6', b' ' | b'\n' | b'\r' | b'\t' | b'#', ..], _) => {
            Ok(folder::single(path, given.unwrap_or(default)))
        }
        _ if foreign::still_of_a_phone(&start).is_some() => {
            // ffmpeg would report a truncated video.
            let (form, hint) = foreign::still_of_a_phone(&start).unwrap_or_default();
            let reason = format!("it is not a video but a picture in {form}; {hint}");
            Err(CaptureError::Stream { path: path.to_owned(), reason })
        }
        _ => ffmpeg(path, given, colours),
    }
}

fn ffmpeg(path: &Path, given: Option<FrameRate>, colours: bool) -> Result<Box<dyn PictureStream>, CaptureError> {
    let grey = Ffmpeg::open(path, given)?;
    Ok(if colours { Box::new(Coloured::new(grey, Ffmpeg::open_colours(path)?)) } else { Box::new(grey) })
}

fn y4m<R: std::io::BufRead + Send + 'static>(
    input: R,
    path: &Path,
    given: Option<FrameRate>,
    (bytes, colours): (Option<u64>, bool),
) -> Result<Box<dyn PictureStream>, CaptureError> {
    let mut reader = Y4mReader::new(input).map_err(|reason| CaptureError::Stream { path: path.to_owned(), reason })?;
    let rate = given.or(reader.rate()).ok_or_else(|| CaptureError::RateUnknown { path: path.to_owned() })?;
    let total = bytes.and_then(|b| reader.frames_in(b));
    if colours {
        reader.keep_chroma();
    }
    let note = reader.pixel_shape().map(remarks::pixel_shape);
    Ok(Box::new(Paced::new(reader, rate, total).with_note(note)))
}

fn avi(input: BufReader<File>, path: &Path, given: Option<FrameRate>, colours: bool) -> Result<Box<dyn PictureStream>, CaptureError> {
    match AviReader::new(input) {
        Ok(reader) => {
            let rate = given.or(reader.rate()).ok_or_else(|| CaptureError::RateUnknown { path: path.to_owned() })?;
            Ok(Box::new(Paced::new(reader, rate, None)))
        }
        Err(AviError::NotMjpeg(_)) => ffmpeg(path, given, colours),
        Err(AviError::Malformed(reason)) => Err(CaptureError::Stream { path: path.to_owned(), reason }),
    }
}

#[cfg(test)]
#[path = "open_tests.rs"]
mod tests;

#[cfg(test)]
#[path = "ffmpeg_tests.rs"]
mod ffmpeg_tests;
