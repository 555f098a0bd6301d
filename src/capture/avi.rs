//! Reads Motion JPEG in RIFF (.avi files), including segmented (OpenDML) and unfinished files.
//!
//! The file is a tree of lists of chunks, but the reader does not need the tree. It reads chunks in
//! file order, enters a list by skipping its header, and skips everything that is not a picture of
//! the first video stream.

use std::io::{self, Read};

use super::rate::FrameRate;

/// An .avi stream, positioned at its pictures.
#[derive(Debug)]
pub struct AviReader<R> {
    input: R,
    /// Number of the video stream as written in its chunk ids: `00`, `01` ...
    stream: [u8; 2],
    rate: Option<FrameRate>,
    ended: bool,
}

/// Why an .avi file is not supported.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum AviError {
    /// The pictures use another codec; holds its four-letter code.
    NotMjpeg(String),
    /// The header is broken; one sentence with a hint for the fix.
    Malformed(String),
}

/// Maximum size of a picture, bytes (a round figure); a chunk that claims more is treated as
/// damage. Raising it lets a damaged file request more memory.
const MAX_PICTURE: u32 = 256 << 20;

struct Chunk {
    id: [u8; 4],
    size: u32,
}

/// What the headers state.
#[derive(Default)]
struct Headers {
    streams: u8,
    video: Option<u8>,
    /// Whether the next `strf` chunk describes the video stream.
    at_video: bool,
    codec: Option<[u8; 4]>,
    rate: Option<FrameRate>,
    main_rate: Option<FrameRate>,
}

impl<R: Read> AviReader<R> {
    /// Reads the headers up to the first picture.
    ///
    /// # Errors
    /// When the input is not an AVI file, or has no MJPEG pictures.
    pub fn new(mut input: R) -> Result<Self, AviError> {
        let malformed = |what: &str| AviError::Malformed(format!("the .avi {what}; make the clip again"));
        let mut headers = Headers::default();
        let mut first = true;
        loop {
            let chunk = read_chunk(&mut input).map_err(|e| malformed(&format!("cannot be read ({e})")))?;
            let Some(chunk) = chunk else { return Err(malformed("ends before its first picture")) };
            if first && chunk.id != *b"RIFF" {
                return Err(malformed("does not begin with RIFF"));
            }
            first = false;
            if is_list(&chunk) {
                let kind = read_exactly::<4>(&mut input).map_err(|_| malformed("ends in its header"))?;
                if kind == *b"movi" {
                    break;
                }
            } else {
                let body = read_body(&mut input, &chunk).map_err(|e| malformed(&format!("is damaged in its header ({e})")))?;
                headers.note(&chunk.id, &body);
            }
        }
        let video = headers.video.ok_or_else(|| malformed("has no video stream"))?;
        let codec = headers.codec.ok_or_else(|| malformed("does not state its codec"))?;
        if ![b"MJPG", b"JPEG", b"AVRN", b"DMB1"].iter().any(|c| codec.eq_ignore_ascii_case(*c)) {
            return Err(AviError::NotMjpeg(codec.escape_ascii().to_string()));
        }
        let stream = [b'0' + video / 10, b'0' + video % 10];
        Ok(Self { input, stream, rate: headers.rate.or(headers.main_rate), ended: false })
    }

    /// Returns the frame rate from the headers, if they state one.
    pub fn rate(&self) -> Option<FrameRate> {
        self.rate
    }

    /// Returns the bytes of the next picture (empty for a dropped frame), or an error sentence
    /// where the file is cut off or damaged. After an error the stream ends.
    pub fn next_jpeg(&mut self) -> Option<Result<Vec<u8>, String>> {
        while !self.ended {
            match self.next_of_stream() {
                Ok(Some(picture)) => return Some(Ok(picture)),
                Ok(None) => {}
                Err(reason) => {
                    self.ended = true;
                    return Some(Err(reason));
                }
            }
        }
        None
    }

    /// Reads one chunk: returns a picture, or `None` for anything else.
    fn next_of_stream(&mut self) -> Result<Option<Vec<u8>>, String> {
        let cut_off = |e: io::Error| format!("the file is cut off or unreadable: {e}");
        let Some(chunk) = read_chunk(&mut self.input).map_err(cut_off)? else {
            self.ended = true;
            return Ok(None);
        };
        if is_list(&chunk) {
            read_exactly::<4>(&mut self.input).map_err(cut_off)?;
            return Ok(None);
        }
        if !chunk.id.iter().all(|b| b.is_ascii_graphic() || *b == b' ') {
            return Err("the file is damaged: no chunk begins where one should".to_owned());
        }
        let is_picture = chunk.id[..2] == self.stream && (chunk.id[2..] == *b"dc" || chunk.id[2..] == *b"db");
        if is_picture && chunk.size > MAX_PICTURE {
            return Err(format!("the file is damaged: a picture of {} bytes", chunk.size));
        }
        if is_picture {
            return read_body(&mut self.input, &chunk).map(Some).map_err(cut_off);
        }
        let padded = u64::from(chunk.size) + u64::from(chunk.size % 2);
        io::copy(&mut (&mut self.input).take(padded), &mut io::sink()).map_err(cut_off)?;
        Ok(None)
    }
}

impl Headers {
    fn note(&mut self, id: &[u8; 4], body: &[u8]) {
        let word = |at: usize| Some(u32::from_le_bytes(*body.get(at..)?.first_chunk()?));
        match id {
            b"avih" => self.main_rate = word(0).and_then(|us| FrameRate::new(1e6, us.into())),
            b"strh" => {
                self.at_video = body.starts_with(b"vids") && self.video.is_none();
                if self.at_video {
                    self.video = Some(self.streams.min(99));
                    self.rate = word(24).zip(word(20)).and_then(|(rate, scale)| FrameRate::new(rate.into(), scale.into()));
                }
                self.streams = self.streams.saturating_add(1);
            }
            b"strf" if self.at_video => {
                self.codec = word(16).map(u32::to_le_bytes);
                self.at_video = false;
            }
            _ => {}
        }
    }
}

fn is_list(chunk: &Chunk) -> bool {
    matches!(&chunk.id, b"RIFF" | b"LIST")
}

/// Reads the next chunk's header. Returns `None` at the end of the file, and where only the zeros
/// of a preallocated file follow.
fn read_chunk(input: &mut impl Read) -> io::Result<Option<Chunk>> {
    let mut header = Vec::with_capacity(8);
    input.by_ref().take(8).read_to_end(&mut header)?;
    let Some(&[a, b, c, d, ref size @ ..]) = header.first_chunk::<8>() else { return Ok(None) };
    let chunk = Chunk { id: [a, b, c, d], size: u32::from_le_bytes(*size) };
    Ok((chunk.id != [0; 4]).then_some(chunk))
}

fn read_exactly<const N: usize>(input: &mut impl Read) -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    input.read_exact(&mut bytes)?;
    Ok(bytes)
}

/// Reads a chunk's bytes and skips its padding. Memory grows only with the bytes actually present.
fn read_body(input: &mut impl Read, chunk: &Chunk) -> io::Result<Vec<u8>> {
    let mut body = Vec::new();
    input.by_ref().take(chunk.size.min(MAX_PICTURE).into()).read_to_end(&mut body)?;
    if body.len() < chunk.size as usize {
        return Err(io::ErrorKind::UnexpectedEof.into());
    }
    if chunk.size % 2 == 1 {
        input.by_ref().take(1).read_to_end(&mut Vec::new())?;
    }
    Ok(body)
}

#[cfg(test)]
#[path = "avi_tests.rs"]
mod tests;
