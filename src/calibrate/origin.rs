//! Which camera took a picture, and at which focal length, as its file says (EXIF).
//!
//! A calibration is of one camera at one zoom. Pictures of two are the one mistake that the corners themselves hide best: each set fits
//! itself, and both together fit neither.

use std::io::Cursor;

use exif::{Exif, In, Tag, Value};

use super::session::Inspected;
use crate::contain::contained;

/// What a file says of where its picture comes from.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Origin {
    /// Maker and model, such as "Canon EOS R6".
    pub camera: Option<String>,
    /// Focal length of the lens, millimetres.
    pub focal_mm: Option<f64>,
}

/// Focal lengths this near to each other, as a share, are one: files round them.
const SAME_FOCAL: f64 = 0.02;

impl Origin {
    /// Reads it from a picture's bytes; nothing where they say nothing.
    pub fn of_picture(bytes: &[u8]) -> Self {
        let read = || exif::Reader::new().read_from_container(&mut Cursor::new(bytes)).ok();
        contained(read).ok().flatten().map_or_else(Self::default, |exif| Self::of_exif(&exif))
    }

    fn of_exif(exif: &Exif) -> Self {
        let text = |tag: Tag| match &exif.get_field(tag, In::PRIMARY)?.value {
            Value::Ascii(lines) => lines.first().map(|line| String::from_utf8_lossy(line).trim_matches(['\0', ' ']).to_owned()),
            _ => None,
        };
        let (maker, model) = (text(Tag::Make).unwrap_or_default(), text(Tag::Model).unwrap_or_default());
        // Many models begin with their maker's name as it is.
        let first = maker.split_whitespace().next().unwrap_or_default().to_lowercase();
        let camera = if model.to_lowercase().starts_with(&first) { model } else { format!("{maker} {model}").trim().to_owned() };
        let focal_mm = match exif.get_field(Tag::FocalLength, In::PRIMARY).map(|field| &field.value) {
            Some(Value::Rational(values)) => values.first().map(|value| value.to_f64()).filter(|mm| mm.is_finite() && *mm > 0.0),
            _ => None,
        };
        Self { camera: Some(camera).filter(|camera| !camera.is_empty()), focal_mm }
    }
}

/// The camera of all pictures that show the board, where one is named.
pub(crate) fn camera_of(pictures: &[Inspected]) -> Option<String> {
    pictures.iter().filter(|p| p.board.is_ok()).find_map(|p| p.origin.camera.clone())
}

/// Where pictures that show the board come from two cameras, or were taken at two focal lengths: the sentence that says so.
pub(crate) fn mixed(pictures: &[Inspected]) -> Option<String> {
    let shown: Vec<&Inspected> = pictures.iter().filter(|p| p.board.is_ok()).collect();
    let by_camera = parted(&shown, |origin| origin.camera.clone(), |a, b| a == b);
    if let Some((usual, other, count, first)) = by_camera {
        return Some(format!(
            "pictures of two cameras are mixed: most are of {usual}, {count} of {other} (the first: {first}); a calibration is of one camera, so leave \
             out the others"
        ));
    }
    let by_focal = parted(&shown, |origin| origin.focal_mm, |a, b| (a / b - 1.0).abs() < SAME_FOCAL);
    by_focal.map(|(usual, other, count, first)| {
        format!(
            "the zoom was changed between pictures: most were taken at {usual} mm, {count} at {other} mm (the first: {first}); a calibration is of one \
             focal length, so leave out the others and lock the zoom (on a phone: stay with one of its lenses)"
        )
    })
}

/// What most files say, what the first of the others says, how many say otherwise, and the name of the first that does.
fn parted<T: Clone>(
    pictures: &[&Inspected],
    said: impl Fn(&Origin) -> Option<T>,
    is_same: impl Fn(&T, &T) -> bool,
) -> Option<(T, T, usize, String)> {
    let all: Vec<(T, &Inspected)> = pictures.iter().filter_map(|p| Some((said(&p.origin)?, *p))).collect();
    let count = |value: &T| all.iter().filter(|(other, _)| is_same(other, value)).count();
    // Of equals the earliest.
    let usual = all.iter().rev().map(|(value, _)| value).max_by_key(|value| count(value))?;
    let mut others = all.iter().filter(|(value, _)| !is_same(value, usual));
    let (other, first) = others.next()?;
    Some((usual.clone(), other.clone(), 1 + others.count(), first.file.display().to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::finder::FoundBoard;

    fn picture(file: &str, camera: Option<&str>, focal_mm: Option<f64>) -> Inspected {
        let board = FoundBoard {
            corners: Vec::new(),
            light: Vec::new(),
            blur_px: 0.5,
            contrast: 80.0,
            margin: 1.0,
            dark_origin: true,
            square_px: 30.0,
        };
        let origin = Origin { camera: camera.map(str::to_owned), focal_mm };
        Inspected { file: file.into(), size: Some((640, 480)), board: Ok(board), other_size: None, patch: None, thumbnail: None, origin }
    }

    #[test]
    fn two_cameras_and_two_zooms_are_named() {
        let (a, b) = (picture("a.jpg", Some("Canon EOS R6"), Some(24.0)), picture("b.jpg", Some("Canon EOS R6"), Some(24.2)));
        let unsaid = picture("u.png", None, None);
        assert_eq!(mixed(&[a.clone(), b.clone(), unsaid.clone()]), None);
        let phone = picture("p.jpg", Some("Pixel 7"), Some(6.8));
        let said = mixed(&[phone.clone(), a.clone(), b.clone(), unsaid]).unwrap();
        assert!(said.contains("most are of Canon EOS R6, 1 of Pixel 7 (the first: p.jpg)"), "{said}");
        let said = mixed(&[a.clone(), b.clone(), picture("c.jpg", Some("Canon EOS R6"), Some(35.0))]).unwrap();
        assert!(said.contains("at 24 mm, 1 at 35 mm (the first: c.jpg)"), "{said}");
        // A picture without the board takes no part, whoever took it.
        assert_eq!(mixed(&[a, Inspected { board: Err("no board".to_owned()), ..phone }]), None);
    }

    #[test]
    fn the_camera_is_read_from_the_file() {
        assert_eq!(Origin::of_picture(&jpeg_of("Canon", "Canon EOS R6", Some((240, 10)))), origin("Canon EOS R6", Some(24.0)));
        assert_eq!(Origin::of_picture(&jpeg_of("NIKON CORPORATION", "NIKON Z 6", None)), origin("NIKON Z 6", None));
        assert_eq!(Origin::of_picture(&jpeg_of("Google", "Pixel 7", Some((0, 0)))), origin("Google Pixel 7", None));
        for nothing in [&b""[..], b"\xFF\xD8", b"\x89PNG\r\n\x1a\n", b"P5 1 1 255 x"] {
            assert_eq!(Origin::of_picture(nothing), Origin::default());
        }
    }

    fn origin(camera: &str, focal_mm: Option<f64>) -> Origin {
        Origin { camera: Some(camera.to_owned()), focal_mm }
    }

    /// A JPEG's beginning with an EXIF block, as cameras write it.
    fn jpeg_of(maker: &str, model: &str, focal: Option<(u32, u32)>) -> Vec<u8> {
        let text = |tag: Tag, text: &str| exif::Field { tag, ifd_num: In::PRIMARY, value: Value::Ascii(vec![text.as_bytes().to_vec()]) };
        let mut fields = vec![text(Tag::Make, maker), text(Tag::Model, model)];
        fields.extend(focal.map(|(num, denom)| exif::Field {
            tag: Tag::FocalLength,
            ifd_num: In::PRIMARY,
            value: Value::Rational(vec![exif::Rational { num, denom }]),
        }));
        let mut writer = exif::experimental::Writer::new();
        fields.iter().for_each(|field| writer.push_field(field));
        let mut block = Cursor::new(Vec::new());
        writer.write(&mut block, false).unwrap();
        let block = [b"Exif\0\0", block.into_inner().as_slice()].concat();
        let length = (block.len() as u16 + 2).to_be_bytes();
        [&[0xFF, 0xD8, 0xFF, 0xE1], &length[..], &block, &[0xFF, 0xD9]].concat()
    }
}
