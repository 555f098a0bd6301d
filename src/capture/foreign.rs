//! Recognises unsupported picture formats by their first bytes, whatever their names, and states
//! how to convert them.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

use crate::safe_file;

/// Conversion hint for formats that ffmpeg reads; many users have it installed.
const BY_FFMPEG: &str = "convert it: ffmpeg -i PICTURE NEW.png";
/// A format: offset of its signature, signature, name, and conversion hint.
type Form = (usize, &'static [u8], &'static str, &'static str);
/// Formats with a signature at a fixed offset.
const FORMS: [Form; 18] = [
    (0, b"BM", "BMP", BY_FFMPEG),
    (0, b"II*\0", "TIFF (or a camera's raw picture)", "convert it: ffmpeg -i PICTURE NEW.png, raw pictures with darktable or dcraw"),
    (0, b"MM\0*", "TIFF (or a camera's raw picture)", "convert it: ffmpeg -i PICTURE NEW.png, raw pictures with darktable or dcraw"),
    (0, b"II+\0", "BigTIFF", "convert it: magick PICTURE NEW.png"),
    (0, b"MM\0+", "BigTIFF", "convert it: magick PICTURE NEW.png"),
    (8, b"WEBP", "WebP", BY_FFMPEG),
    (0, b"GIF8", "GIF", BY_FFMPEG),
    (0, b"\xFF\x0A", "JPEG XL", "convert it: djxl PICTURE NEW.png"),
    (4, b"JXL \r\n\x87\n", "JPEG XL", "convert it: djxl PICTURE NEW.png"),
    (4, b"jP  \r\n\x87\n", "JPEG 2000", BY_FFMPEG),
    (0, b"\xFF\x4F\xFF\x51", "JPEG 2000", BY_FFMPEG),
    (0, b"8BPS", "a Photoshop file", "save a copy as PNG"),
    (0, b"%PDF", "PDF", "convert it: pdftoppm -png -r 200 PICTURE NEW"),
    (0, b"<svg", "SVG", "convert it: rsvg-convert -w 2000 PICTURE -o NEW.png"),
    (0, b"<?xml", "XML (perhaps SVG)", "convert it: rsvg-convert -w 2000 PICTURE -o NEW.png"),
    (0, b"\x76\x2f\x31\x01", "OpenEXR", BY_FFMPEG),
    (0, b"gimp xcf", "a GIMP file", "export it as PNG"),
    (0, b"FUJIFILMCCD-RAW", "a camera's raw picture", "convert it with darktable or dcraw"),
];
/// Brands of the container that HEIC and AVIF share with MP4.
const HEIC_BRANDS: [&[u8; 4]; 9] = [b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1", b"mif2"];
const HEIC_HINT: &str = "convert it: heif-convert PICTURE NEW.png, or set the phone's camera to \"most compatible\" (JPEG)";
const AVIF_HINT: &str = "convert it: avifdec PICTURE NEW.png";
/// Number of leading bytes inspected.
const LOOKED_AT: u64 = 64;

/// Returns the name of an unsupported format and how to convert it; `None` if the bytes match none.
pub fn form_of(bytes: &[u8]) -> Option<(&'static str, &'static str)> {
    if let Some(found) = still_of_a_phone(bytes) {
        return Some(found);
    }
    let text = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    let has = |(at, mark, ..): &&Form| text.get(*at..).is_some_and(|rest| rest.starts_with(mark));
    FORMS.iter().find(has).map(|(.., name, hint)| (*name, *hint))
}

/// Recognises HEIC and AVIF, which ffmpeg takes for damaged videos.
pub(super) fn still_of_a_phone(bytes: &[u8]) -> Option<(&'static str, &'static str)> {
    let brand: &[u8; 4] = bytes.get(8..12)?.try_into().ok()?;
    if bytes.get(4..8)? != b"ftyp" {
        return None;
    }
    match brand {
        b"avif" | b"avis" => Some(("AVIF", AVIF_HINT)),
        brand if HEIC_BRANDS.contains(&brand) => {
            // AVIF uses the general brands, too.
            let is_avif = bytes[..bytes.len().min(LOOKED_AT as usize)].windows(4).any(|w| w == b"avif");
            Some(if is_avif { ("AVIF", AVIF_HINT) } else { ("HEIC", HEIC_HINT) })
        }
        _ => None,
    }
}

/// Counts the unsupported pictures in a folder: "12 HEIC, 1 BMP; convert …"; `None` if there are
/// none.
pub fn in_folder(folder: &Path) -> Option<String> {
    let mut counts: BTreeMap<(&'static str, &'static str), usize> = BTreeMap::new();
    for entry in std::fs::read_dir(folder).ok()?.flatten() {
        if entry.file_type().is_ok_and(|kind| kind.is_file())
            && let Some(form) = safe_file::open(&entry.path()).ok().and_then(first_bytes).and_then(|bytes| form_of(&bytes))
        {
            *counts.entry(form).or_default() += 1;
        }
    }
    let ((_, hint), _) = counts.iter().max_by_key(|(_, count)| **count)?;
    let found: Vec<String> = counts.iter().map(|((form, _), count)| format!("{count} {form}")).collect();
    Some(format!("{}; {hint}", found.join(", ")))
}

fn first_bytes(file: std::fs::File) -> Option<Vec<u8>> {
    let mut bytes = Vec::new();
    file.take(LOOKED_AT).read_to_end(&mut bytes).ok()?;
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn foreign_formats_are_recognised_by_their_first_bytes() {
        let cases: [(&[u8], &str); 12] = [
            (b"\0\0\0\x18ftypheic\0\0\0\0mif1heic", "HEIC"),
            (b"\0\0\0\x18ftypmif1\0\0\0\0mif1heic", "HEIC"),
            (b"\0\0\0\x18ftypavif\0\0\0\0mif1", "AVIF"),
            (b"\0\0\0\x18ftypmif1\0\0\0\0avifmif1", "AVIF"),
            (b"BM\x36\x10\0\0", "BMP"),
            (b"II*\0\x08\0", "TIFF (or a camera's raw picture)"),
            (b"RIFF\x10\0\0\0WEBPVP8 ", "WebP"),
            (b"GIF89a", "GIF"),
            (b"\0\0\0\x0CJXL \r\n\x87\n", "JPEG XL"),
            (b"\xFF\x0A\x10", "JPEG XL"),
            (b"\0\0\0\x0CjP  \r\n\x87\n", "JPEG 2000"),
            (b"<?xml version='1.0'?><svg", "XML (perhaps SVG)"),
        ];
        for (bytes, name) in cases {
            assert_eq!(form_of(bytes).map(|(form, _)| form), Some(name));
        }
        let others: [&[u8]; 6] = [b"", b"hello", b"\0\0\0\x18ftypisom", b"\0\0\0\x18ftypqt  ", b"RIFF\0\0\0\0AVI ", b"\x89PNG"];
        for bytes in others {
            assert_eq!(form_of(bytes), None);
        }
    }

    #[test]
    fn foreign_pictures_are_counted_whatever_their_extension() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(in_folder(folder.path()), None);
        std::fs::write(folder.path().join("a.jpg"), b"BM\x36\x10\0\0").unwrap();
        std::fs::write(folder.path().join("b.bmp"), b"BM\x36\x10\0\0").unwrap();
        std::fs::write(folder.path().join("c"), b"GIF89a").unwrap();
        std::fs::write(folder.path().join("notes.txt"), b"hello").unwrap();
        assert_eq!(in_folder(folder.path()).unwrap(), format!("2 BMP, 1 GIF; {BY_FFMPEG}"));
    }
}
