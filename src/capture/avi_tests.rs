//! Hand-made RIFF files: whole, segmented, unfinished, cut off, and arbitrary bytes.

use proptest::prelude::*;

use super::*;

fn chunk(id: &[u8; 4], body: &[u8]) -> Vec<u8> {
    let padding = if body.len() % 2 == 1 { &[0u8][..] } else { &[] };
    [&id[..], &(body.len() as u32).to_le_bytes(), body, padding].concat()
}

fn list(id: &[u8; 4], kind: &[u8; 4], chunks: &[Vec<u8>]) -> Vec<u8> {
    chunk(id, &[&kind[..], &chunks.concat()].concat())
}

/// Headers of an audio stream 00 and a video stream 01 at 30000/1001 frames per second.
fn headers(codec: &[u8; 4]) -> Vec<u8> {
    let mut strh = vec![0u8; 56];
    strh[..4].copy_from_slice(b"vids");
    strh[20..24].copy_from_slice(&1001u32.to_le_bytes());
    strh[24..28].copy_from_slice(&30_000u32.to_le_bytes());
    let mut strf = vec![0u8; 40];
    strf[16..20].copy_from_slice(codec);
    let audio = list(b"LIST", b"strl", &[chunk(b"strh", b"auds0000"), chunk(b"strf", &[0; 18])]);
    let video = list(b"LIST", b"strl", &[chunk(b"strh", &strh), chunk(b"strf", &strf), chunk(b"indx", &[1; 33])]);
    list(b"LIST", b"hdrl", &[chunk(b"avih", &[0; 56]), audio, video, list(b"LIST", b"odml", &[chunk(b"dmlh", &[9; 4])])])
}

fn file(pictures: &[&[u8]]) -> Vec<u8> {
    let movi: Vec<_> = pictures.iter().flat_map(|p| [chunk(b"00wb", b"sound"), chunk(b"01dc", p)]).collect();
    list(b"RIFF", b"AVI ", &[headers(b"MJPG"), chunk(b"JUNK", &[7; 5]), list(b"LIST", b"movi", &movi), chunk(b"idx1", &[1; 16])])
}

fn read(bytes: &[u8]) -> Vec<Result<Vec<u8>, String>> {
    let mut reader = AviReader::new(bytes).unwrap();
    std::iter::from_fn(|| reader.next_jpeg()).collect()
}

fn pictures(bytes: &[u8]) -> Vec<Vec<u8>> {
    read(bytes).into_iter().map(Result::unwrap).collect()
}

#[test]
fn pictures_are_read_in_order_and_dropped_ones_are_empty() {
    let bytes = file(&[b"one", b"", b"three!"]);
    assert_eq!(pictures(&bytes), [&b"one"[..], b"", b"three!"]);
    assert_eq!(AviReader::new(&bytes[..]).unwrap().rate(), FrameRate::from_ratio("30000:1001"));
}

#[test]
fn rec_lists_and_avix_segments_are_read() {
    let rec = list(b"LIST", b"rec ", &[chunk(b"01db", b"a"), chunk(b"00wb", b"x")]);
    let first = list(b"RIFF", b"AVI ", &[headers(b"mjpg"), list(b"LIST", b"movi", &[rec, chunk(b"ix01", &[0; 9])])]);
    let second = list(b"RIFF", b"AVIX", &[list(b"LIST", b"movi", &[chunk(b"01dc", b"b"), chunk(b"01dc", b"c")])]);
    assert_eq!(pictures(&[first, second].concat()), [b"a", b"b", b"c"]);
}

#[test]
fn a_file_that_was_never_finished_is_read() {
    let mut bytes = file(&[b"one", b"two"]);
    let movi = bytes.windows(4).position(|w| w == b"movi").unwrap();
    bytes[4..8].fill(0);
    bytes[movi - 4..movi].fill(0);
    assert_eq!(pictures(&bytes), [b"one", b"two"]);
    assert_eq!(pictures(&[bytes, vec![0; 1000]].concat()), [b"one", b"two"]);
}

#[test]
fn a_truncated_file_ends_with_a_row_that_reports_it() {
    let bytes = file(&[b"one", b"longer picture"]);
    let cut = bytes.windows(6).position(|w| w == b"longer").unwrap() + 6;
    let rows = read(&bytes[..cut]);
    assert_eq!(rows[0], Ok(b"one".to_vec()));
    assert!(rows.len() == 2 && rows[1].as_ref().unwrap_err().contains("cut off"));
}

#[test]
fn other_codecs_and_broken_headers_get_different_errors() {
    let other = list(b"RIFF", b"AVI ", &[headers(b"XVID"), list(b"LIST", b"movi", &[])]);
    assert_eq!(AviReader::new(&other[..]).unwrap_err(), AviError::NotMjpeg("XVID".to_owned()));
    let no_video = list(b"RIFF", b"AVI ", &[list(b"LIST", b"movi", &[])]);
    for bytes in [&b"RIFF"[..], b"", b"hello, world", &no_video] {
        assert!(matches!(AviReader::new(bytes), Err(AviError::Malformed(_))));
    }
}

proptest! {
    #[test]
    fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..300), cut in 0usize..700) {
        let whole = file(&[b"one", b"two"]);
        let movi = whole.windows(4).position(|w| w == b"movi").unwrap() + 4;
        for start in [&whole[..0], &whole[..4], &whole[..movi], &whole[..cut.min(whole.len())]] {
            if let Ok(mut reader) = AviReader::new(&[start, &bytes].concat()[..]) {
                while reader.next_jpeg().is_some() {}
            }
        }
    }

    #[test]
    fn written_data_reads_back(written in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..50), 0..10)) {
        let slices: Vec<&[u8]> = written.iter().map(Vec::as_slice).collect();
        prop_assert_eq!(pictures(&file(&slices)), written);
    }
}
