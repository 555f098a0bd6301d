//! Converts UTF-16 texts, as written by Notepad or PowerShell redirection, to UTF-8.

use std::borrow::Cow;

/// Converts UTF-16 bytes, with or without a byte order mark, to UTF-8; returns all others
/// unchanged.
///
/// Without a mark, UTF-16 shows by a zero byte in every other position: texts here are mostly
/// ASCII, and UTF-8 text has no zero bytes.
pub fn as_utf8(bytes: &[u8]) -> Cow<'_, [u8]> {
    let (read, body): (fn([u8; 2]) -> u16, _) = match bytes {
        [0xFF, 0xFE, rest @ ..] => (u16::from_le_bytes, rest),
        [0xFE, 0xFF, rest @ ..] => (u16::from_be_bytes, rest),
        _ if has_zeros(bytes, 1) => (u16::from_le_bytes, bytes),
        _ if has_zeros(bytes, 0) => (u16::from_be_bytes, bytes),
        _ => return Cow::Borrowed(bytes),
    };
    let units = body.chunks_exact(2).map(|unit| read([unit[0], unit[1]]));
    let text: String = char::decode_utf16(units).map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER)).collect();
    Cow::Owned(text.into_bytes())
}

/// Number of leading bytes to inspect; the first line suffices. Raised, checking a long text
/// without a mark takes longer.
const LOOKED_AT: usize = 64;

/// Whether every other byte from `first` on is mostly zero and none in between is.
fn has_zeros(bytes: &[u8], first: usize) -> bool {
    let start = &bytes[..bytes.len().min(LOOKED_AT)];
    let zeros = |from: usize| start.iter().skip(from).step_by(2).filter(|b| **b == 0).count();
    start.len() >= 4 && zeros(first) * 4 >= start.len() && zeros(1 - first) == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_utf_16_is_converted_to_utf_8() {
        let text = "image_width: 640 # Bühne 舞台 🎭\n";
        let units: Vec<u16> = text.encode_utf16().collect();
        let bytes = |of: fn(u16) -> [u8; 2], mark: &[u8]| [mark, &units.iter().copied().flat_map(of).collect::<Vec<_>>()].concat();
        for utf16 in [
            bytes(u16::to_le_bytes, &[]),
            bytes(u16::to_be_bytes, &[]),
            bytes(u16::to_le_bytes, &[0xFF, 0xFE]),
            bytes(u16::to_be_bytes, &[0xFE, 0xFF]),
        ] {
            assert_eq!(std::str::from_utf8(&as_utf8(&utf16)), Ok(text));
        }
        for other in [text.as_bytes(), b"", b"a", b"\0\0\0\0", b"f\xfcr B\xfchne", &[0xEF, 0xBB, 0xBF, b'a']] {
            assert_eq!(&*as_utf8(other), other);
        }
    }
}
