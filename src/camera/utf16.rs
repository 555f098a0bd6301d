//! Texts that some programs write as UTF-16 (Notepad, PowerShell's redirection), read as if they were UTF-8.

use std::borrow::Cow;

/// The text's bytes in UTF-8 where they are UTF-16, with a byte order mark or without; all others as they are.
///
/// Without a mark, UTF-16 is known by a zero byte in every other place: texts here are mostly ASCII, and UTF-8 has no zero bytes.
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

/// Bytes from the start that are looked at: the first line says enough. Raised, a long text without a mark takes longer.
const LOOKED_AT: usize = 64;

/// Whether the places from `first` on, every other one, hold mostly zeros, and those between hold none.
fn has_zeros(bytes: &[u8], first: usize) -> bool {
    let start = &bytes[..bytes.len().min(LOOKED_AT)];
    let zeros = |from: usize| start.iter().skip(from).step_by(2).filter(|b| **b == 0).count();
    start.len() >= 4 && zeros(first) * 4 >= start.len() && zeros(1 - first) == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn utf_16_of_every_kind_becomes_utf_8_and_all_else_stays() {
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
