//! Reads YUV4MPEG2 (.y4m): a text header, then frames of raw planes. The luma is returned
//! unchanged; the chroma is skipped unless colours are requested.

use std::io::{self, BufRead, Read};

use image::{GrayImage, RgbImage};

use super::colour::Chroma;
use super::grey::check_size;
use super::rate::FrameRate;
use crate::camera::size::MAX_SIDE;

/// A .y4m stream.
#[derive(Debug)]
pub struct Y4mReader<R> {
    input: R,
    width: u32,
    height: u32,
    rate: Option<FrameRate>,
    pixel_shape: Option<(u32, u32)>,
    chroma: Chroma,
    chroma_bytes: u64,
    header_bytes: u64,
    frames_read: u64,
    ended: bool,
    /// The last frame's chroma planes, if they are kept.
    kept: Option<Vec<u8>>,
}

/// Maximum length of a header line, bytes: more than any in use, so that a file of another format
/// is refused at once (a round figure).
const MAX_LINE: u64 = 4096;

impl<R: BufRead> Y4mReader<R> {
    /// Reads the stream's header.
    ///
    /// # Errors
    /// One sentence, if the header is broken, or the stream is interlaced or deeper than 8 bits.
    pub fn new(mut input: R) -> Result<Self, String> {
        let line = read_line(&mut input).map_err(|e| format!("the y4m header cannot be read ({e}); make the clip again"))?;
        let line = line.ok_or("the y4m header line has no end; make the clip again")?;
        let header_bytes = line.len() as u64 + 1;
        let mut words = line.split(' ');
        if words.next() != Some("YUV4MPEG2") {
            return Err("this is not a y4m stream: it does not begin with YUV4MPEG2; make the clip again".to_owned());
        }
        let (mut width, mut height, mut rate, mut chroma, mut full_range) = (None, None, None, "420", false);
        let mut pixel_shape = None;
        for word in words.filter(|w| !w.is_empty()) {
            let (tag, value) = word.split_at(word.chars().next().map_or(0, char::len_utf8));
            match tag {
                "W" => width = side(value),
                "H" => height = side(value),
                "F" => rate = FrameRate::from_ratio(value),
                "C" => chroma = value,
                "A" => pixel_shape = value.split_once(':').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?))),
                "X" if value == "COLORRANGE=FULL" => full_range = true,
                "I" if !matches!(value, "p" | "?" | "") => {
                    return Err(format!("the y4m stream is interlaced (I{value}); deinterlace the clip"));
                }
                _ => {}
            }
        }
        let (Some(width), Some(height)) = (width, height) else {
            return Err(format!("the y4m header has no picture size of 1 to {MAX_SIDE} pixels (W, H); make the clip again"));
        };
        check_size(width, height).map_err(|e| e.to_string())?;
        let (chroma, planes) = chroma_form(chroma, full_range)?;
        let chroma_bytes = planes * chroma.plane_bytes((width, height));
        let pixel_shape = pixel_shape.filter(|(w, h): &(u32, u32)| *w > 0 && *h > 0 && w != h);
        Ok(Self { input, width, height, rate, pixel_shape, chroma, chroma_bytes, header_bytes, frames_read: 0, ended: false, kept: None })
    }

    /// Returns width and height of a pixel as a ratio, if the header states that they differ.
    pub(super) fn pixel_shape(&self) -> Option<(u32, u32)> {
        self.pixel_shape
    }

    /// Returns the frame rate from the header, if it states one.
    pub fn rate(&self) -> Option<FrameRate> {
        self.rate
    }

    /// Returns the number of frames in a stream of this many bytes; `None` if it is cut off or its
    /// frames carry parameters.
    pub fn frames_in(&self, stream_bytes: u64) -> Option<u64> {
        let frame_bytes = 6 + u64::from(self.width) * u64::from(self.height) + self.chroma_bytes;
        let bytes = stream_bytes.checked_sub(self.header_bytes)?;
        (bytes % frame_bytes == 0).then_some(bytes / frame_bytes)
    }

    /// Keeps the chroma planes of all frames from here on, for [`colours`](Self::colours).
    pub(super) fn keep_chroma(&mut self) {
        self.kept = Some(Vec::new());
    }

    /// Returns the last frame in colour, given its luma; `None` if its planes are not kept.
    pub(super) fn colours(&self, luma: &GrayImage) -> Option<RgbImage> {
        self.chroma.colours(luma, self.kept.as_ref()?)
    }

    /// Returns the next frame's luma, or an error sentence for a frame that is cut off or damaged.
    /// The stream ends after an error.
    pub fn next_luma(&mut self) -> Option<Result<GrayImage, String>> {
        if self.ended {
            return None;
        }
        let frame = self.read_frame().transpose();
        self.ended = !matches!(frame, Some(Ok(_)));
        self.frames_read += 1;
        frame
    }

    fn read_frame(&mut self) -> Result<Option<GrayImage>, String> {
        let number = self.frames_read;
        let unreadable = |e: io::Error| format!("frame {number} cannot be read: {e}");
        if self.input.fill_buf().map_err(unreadable)?.is_empty() {
            return Ok(None);
        }
        let line = read_line(&mut self.input).map_err(unreadable)?;
        if !line.is_some_and(|l| l == "FRAME" || l.starts_with("FRAME ")) {
            return Err(format!("the stream is damaged: frame {number} does not begin with FRAME"));
        }
        let wanted = u64::from(self.width) * u64::from(self.height);
        let mut luma = Vec::with_capacity(wanted.min(1 << 24) as usize);
        (&mut self.input).take(wanted).read_to_end(&mut luma).map_err(unreadable)?;
        let mut rest = (&mut self.input).take(self.chroma_bytes);
        let passed = match &mut self.kept {
            None => io::copy(&mut rest, &mut io::sink()).map_err(unreadable)?,
            Some(kept) => {
                kept.clear();
                rest.read_to_end(kept).map_err(unreadable)? as u64
            }
        };
        let whole = passed == self.chroma_bytes;
        let image = GrayImage::from_raw(self.width, self.height, luma).filter(|_| whole);
        image.map(Some).ok_or_else(|| format!("the stream ends in the middle of frame {number}"))
    }
}

/// Reads a line without its newline; `None` if there is no newline.
fn read_line(input: &mut impl BufRead) -> io::Result<Option<String>> {
    let mut line = Vec::new();
    input.take(MAX_LINE).read_until(b'\n', &mut line)?;
    Ok((line.pop() == Some(b'\n')).then(|| String::from_utf8_lossy(&line).into_owned()))
}

fn side(text: &str) -> Option<u32> {
    text.parse().ok().filter(|n| (1..=MAX_SIDE).contains(n))
}

/// Returns the layout of the planes behind the luma, and how many planes of that size there are.
fn chroma_form(form: &str, is_full_range: bool) -> Result<(Chroma, u64), String> {
    let (across, down, planes) = match form {
        "420" | "420jpeg" | "420mpeg2" | "420paldv" => (2, 2, 2),
        "422" => (2, 1, 2),
        "444" => (1, 1, 2),
        "444alpha" => (1, 1, 3),
        "411" => (4, 1, 2),
        "410" => (4, 4, 2),
        "440" => (1, 2, 2),
        "mono" => (1, 1, 0),
        deep if deep.contains('p') && deep.starts_with('4') || deep.starts_with("mono") => {
            return Err(format!("the y4m stream has more than 8 bits a sample (C{deep}); convert the clip to 8 bits"));
        }
        other => return Err(format!("the y4m colour form C{other} is not known; convert the clip to C420jpeg")),
    };
    Ok((Chroma { across, down, is_full_range }, planes))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn read(bytes: &[u8]) -> Vec<Result<GrayImage, String>> {
        let mut reader = Y4mReader::new(bytes).unwrap();
        std::iter::from_fn(|| reader.next_luma()).collect()
    }

    /// Builds a stream of 5 x 3 pixel frames, luma = frame number, chroma = 255.
    fn stream(form: &str, chroma: usize, frames: u8) -> Vec<u8> {
        let mut bytes = format!("YUV4MPEG2 W5 H3 F30000:1001 Ip A1:1 {form} XYSCSS=whatever\n").into_bytes();
        for n in 0..frames {
            bytes.extend_from_slice(if n == 1 { b"FRAME Xparameter=1\n" } else { b"FRAME\n" });
            bytes.extend(std::iter::repeat_n(n, 15).chain(std::iter::repeat_n(255, chroma)));
        }
        bytes
    }

    #[test]
    fn every_chroma_format_yields_its_luma() {
        let forms = [
            ("", 12),
            ("C420", 12),
            ("C420jpeg", 12),
            ("C420mpeg2", 12),
            ("C420paldv", 12),
            ("C422", 18),
            ("C444", 30),
            ("C444alpha", 45),
            ("C411", 12),
            ("Cmono", 0),
        ];
        for (form, chroma) in forms {
            let frames = read(&stream(form, chroma, 3));
            assert_eq!(frames.len(), 3, "{form}");
            for (n, frame) in frames.into_iter().enumerate() {
                assert_eq!(frame.unwrap(), GrayImage::from_pixel(5, 3, image::Luma([n as u8])), "{form}");
            }
        }
    }

    #[test]
    fn chroma_is_kept_on_request() {
        let bytes = stream("C420jpeg", 12, 2);
        let mut reader = Y4mReader::new(&bytes[..]).unwrap();
        let plain = reader.next_luma().unwrap().unwrap();
        assert_eq!(reader.colours(&plain), None);
        reader.keep_chroma();
        let luma = reader.next_luma().unwrap().unwrap();
        // Dark, with the maximum of blue and red.
        let [r, g, b] = reader.colours(&luma).unwrap().get_pixel(4, 2).0;
        assert!(r > 150 && g == 0 && b > 150, "{r} {g} {b}");
        assert!(reader.next_luma().is_none());
    }

    #[test]
    fn a_truncated_stream_ends_with_one_undecodable_frame() {
        let bytes = stream("C420", 12, 3);
        let frames = read(&bytes[..bytes.len() - 1]);
        assert_eq!((frames.len(), frames[2].as_ref().unwrap_err().as_str()), (3, "the stream ends in the middle of frame 2"));
    }

    #[test]
    fn unsupported_streams_are_refused_with_the_reason() {
        let refused = |header: &str| Y4mReader::new(header.as_bytes()).unwrap_err();
        assert!(refused("YUV4MPEG2 W4 H4 It\n").contains("interlaced"));
        assert!(refused("YUV4MPEG2 W4 H4 C420p10\n").contains("more than 8 bits"));
        assert!(refused("YUV4MPEG2 W4 H4 Cmono16\n").contains("more than 8 bits"));
        assert!(refused("YUV4MPEG2 W4 H4 Cxyz\n").contains("not known"));
        assert!(refused("YUV4MPEG2 W0 H4\n").contains("picture size"));
        assert!(refused("YUV4MPEG2 W4 H4").contains("no end"));
        assert!(refused("RIFF\n").contains("YUV4MPEG2"));
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..300), header in "YUV4MPEG2( [WHFIC][0-9a-z:]{0,6}){0,6}\n") {
            for bytes in [bytes.clone(), [header.as_bytes(), &bytes].concat()] {
                if let Ok(mut reader) = Y4mReader::new(&bytes[..]) {
                    while reader.next_luma().is_some() {}
                }
            }
        }
    }
}
