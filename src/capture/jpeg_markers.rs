//! Finds where a JPEG ends by walking its markers.
//!
//! Searching for the bytes of EOI would stop inside an EXIF thumbnail. The walk skips whole
//! segments instead, and inside entropy-coded data it handles stuffed bytes and restart markers. It
//! can be resumed as bytes arrive.

/// Second bytes of JPEG's markers (ITU-T T.81, table B.1): frames from baseline to progressive,
/// restart interval, Huffman tables, start and end of the picture, start of a scan.
const SOF0: u8 = 0xC0;
const SOF2: u8 = 0xC2;
const DRI: u8 = 0xDD;
const DHT: u8 = 0xC4;
const SOI: u8 = 0xD8;
const EOI: u8 = 0xD9;
const SOS: u8 = 0xDA;

/// A walk over the markers of one JPEG that starts at byte 0.
#[derive(Debug, Default, Clone)]
pub(super) struct JpegWalk {
    position: usize,
    in_entropy_data: bool,
    /// Offset of the first scan's SOS marker.
    pub first_scan: Option<usize>,
    scans: usize,
    restarts: bool,
    is_sequential: bool,
    /// Sampling factors per component, horizontal and vertical in one byte.
    sampling: Vec<u8>,
    /// Whether Huffman tables precede the first scan.
    pub has_huffman_tables: bool,
}

/// How far a walk has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Walked {
    /// It reached the end of the bytes; more are needed.
    Unfinished,
    /// The picture is whole and ends before this offset.
    Whole(usize),
    /// The picture is damaged: an invalid marker stands at this offset.
    Damaged(usize),
}

impl JpegWalk {
    /// Continues over `bytes`, which must begin with those of earlier calls.
    pub fn advance(&mut self, bytes: &[u8]) -> Walked {
        loop {
            if self.in_entropy_data {
                let Some(rest) = bytes.get(self.position..) else { return Walked::Unfinished };
                let Some(skip) = memchr::memchr(0xFF, rest) else {
                    self.position = bytes.len();
                    return Walked::Unfinished;
                };
                self.position += skip;
            }
            let (Some(&mark), Some(&code)) = (bytes.get(self.position), bytes.get(self.position + 1)) else {
                return Walked::Unfinished;
            };
            match (mark, code) {
                (0xFF, 0x00) if self.in_entropy_data => self.position += 2,
                (0xFF, 0xFF) => self.position += 1,
                (0xFF, 0x01 | 0xD0..=0xD7) => self.position += 2,
                (0xFF, SOI) if self.position == 0 => self.position += 2,
                (0xFF, EOI) if self.position > 0 => return Walked::Whole(self.position + 2),
                (0xFF, 0x00 | SOI) => return Walked::Damaged(self.position),
                (0xFF, _) if self.position > 0 => {
                    let Some(&[high, low]) = bytes.get(self.position + 2..self.position + 4) else { return Walked::Unfinished };
                    let length = usize::from(u16::from_be_bytes([high, low]));
                    if length < 2 {
                        return Walked::Damaged(self.position);
                    }
                    self.enter(code, length, bytes);
                }
                _ => return Walked::Damaged(self.position),
            }
        }
    }

    /// Whether the picture, walked to its end, is one plain run of data: sequential, one scan, no
    /// restarts, and with a usual sampling (grey, 4:4:4, 4:2:2 or 4:2:0).
    pub fn is_one_plain_scan(&self) -> bool {
        let usual = matches!(
            *self.sampling,
            [0x11] | [0x11 | 0x21 | 0x22, 0x11, 0x11] | [0x12 | 0x22, 0x12, 0x12] // the last two: ffmpeg's 4:4:4 and 4:2:2
        );
        self.scans == 1 && self.is_sequential && usual && !self.restarts
    }

    /// Whether a unit of the picture is taller than wide.
    pub fn has_tall_units(&self) -> bool {
        let largest = |part: fn(u8) -> u8| self.sampling.iter().map(|s| part(*s)).max().unwrap_or(1);
        largest(|s| s & 15) > largest(|s| s >> 4)
    }

    /// Records the segment at the position and skips it.
    fn enter(&mut self, code: u8, length: usize, bytes: &[u8]) {
        if code == DHT && self.first_scan.is_none() {
            self.has_huffman_tables = true;
        }
        if code == SOS && self.first_scan.is_none() {
            self.first_scan = Some(self.position);
        }
        self.scans += usize::from(code == SOS);
        self.restarts |= code == DRI;
        if matches!(code, SOF0..=SOF2) {
            self.is_sequential = code != SOF2;
            let components = bytes.get(self.position + 9..).unwrap_or_default();
            let count = components.first().map_or(0, |n| usize::from(*n));
            self.sampling = components.iter().skip(2).step_by(3).take(count).copied().collect();
        }
        self.in_entropy_data = code == SOS;
        self.position += 2 + length;
    }
}

/// Returns the standard Huffman tables (ITU-T T.81, tables K.3 to K.6) as one DHT segment.
///
/// Motion JPEG omits them, so a decoder must supply them.
pub(super) fn standard_huffman_tables() -> Vec<u8> {
    let mut segment = vec![0xFF, DHT, 0x01, 0xA2];
    let tables: [(u8, &[u8; 16], &[u8]); 4] = [
        (0x00, &DC_LUMA_COUNTS, &DC_VALUES),
        (0x10, &AC_LUMA_COUNTS, &AC_LUMA_VALUES),
        (0x01, &DC_CHROMA_COUNTS, &DC_VALUES),
        (0x11, &AC_CHROMA_COUNTS, &AC_CHROMA_VALUES),
    ];
    for (class_and_place, counts, values) in tables {
        segment.push(class_and_place);
        segment.extend_from_slice(counts);
        segment.extend_from_slice(values);
    }
    segment
}

/// Standard Huffman tables (ITU-T T.81, K.3 to K.6), which Motion JPEG omits: the number of codes
/// of each length 1..=16, and the values in code order.
const DC_LUMA_COUNTS: [u8; 16] = [0, 1, 5, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0];
const DC_CHROMA_COUNTS: [u8; 16] = [0, 3, 1, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0];
const DC_VALUES: [u8; 12] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11];
const AC_LUMA_COUNTS: [u8; 16] = [0, 2, 1, 3, 3, 2, 4, 3, 5, 5, 4, 4, 0, 0, 1, 0x7D];
const AC_CHROMA_COUNTS: [u8; 16] = [0, 2, 1, 2, 4, 4, 3, 4, 7, 5, 4, 4, 0, 1, 2, 0x77];
/// Values of the luma AC codes (T.81, table K.5).
#[rustfmt::skip]
const AC_LUMA_VALUES: [u8; 162] = [
    0x01, 0x02, 0x03, 0x00, 0x04, 0x11, 0x05, 0x12, 0x21, 0x31, 0x41, 0x06, 0x13, 0x51, 0x61, 0x07, 0x22, 0x71,
    0x14, 0x32, 0x81, 0x91, 0xA1, 0x08, 0x23, 0x42, 0xB1, 0xC1, 0x15, 0x52, 0xD1, 0xF0, 0x24, 0x33, 0x62, 0x72,
    0x82, 0x09, 0x0A, 0x16, 0x17, 0x18, 0x19, 0x1A, 0x25, 0x26, 0x27, 0x28, 0x29, 0x2A, 0x34, 0x35, 0x36, 0x37,
    0x38, 0x39, 0x3A, 0x43, 0x44, 0x45, 0x46, 0x47, 0x48, 0x49, 0x4A, 0x53, 0x54, 0x55, 0x56, 0x57, 0x58, 0x59,
    0x5A, 0x63, 0x64, 0x65, 0x66, 0x67, 0x68, 0x69, 0x6A, 0x73, 0x74, 0x75, 0x76, 0x77, 0x78, 0x79, 0x7A, 0x83,
    0x84, 0x85, 0x86, 0x87, 0x88, 0x89, 0x8A, 0x92, 0x93, 0x94, 0x95, 0x96, 0x97, 0x98, 0x99, 0x9A, 0xA2, 0xA3,
    0xA4, 0xA5, 0xA6, 0xA7, 0xA8, 0xA9, 0xAA, 0xB2, 0xB3, 0xB4, 0xB5, 0xB6, 0xB7, 0xB8, 0xB9, 0xBA, 0xC2, 0xC3,
    0xC4, 0xC5, 0xC6, 0xC7, 0xC8, 0xC9, 0xCA, 0xD2, 0xD3, 0xD4, 0xD5, 0xD6, 0xD7, 0xD8, 0xD9, 0xDA, 0xE1, 0xE2,
    0xE3, 0xE4, 0xE5, 0xE6, 0xE7, 0xE8, 0xE9, 0xEA, 0xF1, 0xF2, 0xF3, 0xF4, 0xF5, 0xF6, 0xF7, 0xF8, 0xF9, 0xFA,
];
/// Values of the chroma AC codes (T.81, table K.6).
#[rustfmt::skip]
const AC_CHROMA_VALUES: [u8; 162] = [
    0x00, 0x01, 0x02, 0x03, 0x11, 0x04, 0x05, 0x21, 0x31, 0x06, 0x12, 0x41, 0x51, 0x07, 0x61, 0x71, 0x13, 0x22,
    0x32, 0x81, 0x08, 0x14, 0x42, 0x91, 0xA1, 0xB1, 0xC1, 0x09, 0x23, 0x33, 0x52, 0xF0, 0x15, 0x62, 0x72, 0xD1,
    0x0A, 0x16, 0x24, 0x34, 0xE1, 0x25, 0xF1, 0x17, 0x18, 0x19, 0x1A, 0x26, 0x27, 0x28, 0x29, 0x2A, 0x35, 0x36,
    0x37, 0x38, 0x39, 0x3A, 0x43, 0x44, 0x45, 0x46, 0x47, 0x48, 0x49, 0x4A, 0x53, 0x54, 0x55, 0x56, 0x57, 0x58,
    0x59, 0x5A, 0x63, 0x64, 0x65, 0x66, 0x67, 0x68, 0x69, 0x6A, 0x73, 0x74, 0x75, 0x76, 0x77, 0x78, 0x79, 0x7A,
    0x82, 0x83, 0x84, 0x85, 0x86, 0x87, 0x88, 0x89, 0x8A, 0x92, 0x93, 0x94, 0x95, 0x96, 0x97, 0x98, 0x99, 0x9A,
    0xA2, 0xA3, 0xA4, 0xA5, 0xA6, 0xA7, 0xA8, 0xA9, 0xAA, 0xB2, 0xB3, 0xB4, 0xB5, 0xB6, 0xB7, 0xB8, 0xB9, 0xBA,
    0xC2, 0xC3, 0xC4, 0xC5, 0xC6, 0xC7, 0xC8, 0xC9, 0xCA, 0xD2, 0xD3, 0xD4, 0xD5, 0xD6, 0xD7, 0xD8, 0xD9, 0xDA,
    0xE2, 0xE3, 0xE4, 0xE5, 0xE6, 0xE7, 0xE8, 0xE9, 0xEA, 0xF2, 0xF3, 0xF4, 0xF5, 0xF6, 0xF7, 0xF8, 0xF9, 0xFA,
];

#[cfg(test)]
mod tests {
    use super::*;

    const WHOLE: [u8; 19] = [
        0xFF, SOI, 0xFF, 0xE1, 0, 6, 0xFF, SOI, 0xFF, EOI, // a thumbnail in APP1
        0xFF, SOS, 0, 2, 7, 0xFF, 0, 0xFF, EOI,
    ];

    #[test]
    fn an_end_mark_inside_a_thumbnail_does_not_end_the_picture() {
        let mut walk = JpegWalk::default();
        assert_eq!(walk.advance(&WHOLE), Walked::Whole(WHOLE.len()));
        assert_eq!((walk.first_scan, walk.has_huffman_tables), (Some(10), false));
    }

    #[test]
    fn an_incremental_walk_ends_where_a_single_pass_does() {
        let mut walk = JpegWalk::default();
        for n in 0..WHOLE.len() {
            assert_eq!(walk.advance(&WHOLE[..n]), Walked::Unfinished, "{n} bytes");
        }
        assert_eq!(walk.advance(&WHOLE), Walked::Whole(WHOLE.len()));
    }

    #[test]
    fn a_new_start_inside_of_the_data_is_damage() {
        let cut = [&WHOLE[..15], &WHOLE[..]].concat();
        assert_eq!(JpegWalk::default().advance(&cut), Walked::Damaged(15));
        assert_eq!(JpegWalk::default().advance(b"no"), Walked::Damaged(0));
    }

    #[test]
    fn the_standard_tables_fill_their_segment() {
        let segment = standard_huffman_tables();
        assert_eq!(segment.len(), 2 + 0x1A2);
        for (counts, values) in [(&AC_LUMA_COUNTS, &AC_LUMA_VALUES), (&AC_CHROMA_COUNTS, &AC_CHROMA_VALUES)] {
            assert_eq!(counts.iter().map(|c| usize::from(*c)).sum::<usize>(), values.len());
        }
    }
}
