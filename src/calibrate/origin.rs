//! Reads which camera took a picture, and at which focal length, from its file (EXIF).

use std::io::Cursor;

use exif::{Exif, In, Tag, Value};

use crate::contain::contained;

/// What a file states about the origin of its picture.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Origin {
    /// Maker and model, such as "Canon EOS R6".
    pub camera: Option<String>,
    /// Focal length of the lens, millimetres.
    pub focal_mm: Option<f64>,
}

impl Origin {
    /// Reads the origin from a picture's bytes; empty if they state none.
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
        // Many models already begin with their maker's name.
        let first = maker.split_whitespace().next().unwrap_or_default().to_lowercase();
        let camera = if model.to_lowercase().starts_with(&first) { model } else { format!("{maker} {model}").trim().to_owned() };
        let focal_mm = match exif.get_field(Tag::FocalLength, In::PRIMARY).map(|field| &field.value) {
            Some(Value::Rational(values)) => values.first().map(|value| value.to_f64()).filter(|mm| mm.is_finite() && *mm > 0.0),
            _ => None,
        };
        Self { camera: Some(camera).filter(|camera| !camera.is_empty()), focal_mm }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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

    /// The beginning of a JPEG with an EXIF block, as written by cameras.
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
