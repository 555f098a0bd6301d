//! Whole clips on disk, in every format, with their faults.

use std::ffi::OsStr;
use std::fs;
use std::process::Command;

use image::{GrayImage, Luma};
use tempfile::TempDir;

use super::super::{ClipEntry, ClipWriter, EntryContent, PictureFormat, decode_grey};
use super::*;
use crate::frame::{Frame, Timestamp};

fn picture(level: u8) -> GrayImage {
    GrayImage::from_fn(32, 24, |x, y| Luma([level.wrapping_add((x + y) as u8)]))
}

fn frame(n: u8) -> Frame {
    Frame { image: picture(n * 10), timestamp: Timestamp::from_ns(1_000 + i64::from(n) * 40_000_000), sequence: u64::from(n) }
}

fn jpeg(level: u8) -> Vec<u8> {
    let mut bytes = Vec::new();
    picture(level).write_with_encoder(image::codecs::jpeg::JpegEncoder::new(&mut bytes)).unwrap();
    bytes
}

fn rows(path: impl AsRef<Path>, fps: Option<f64>) -> Vec<ClipEntry> {
    let mut clip = open_clip(path, ClipOptions { fps, ..ClipOptions::default() }).unwrap();
    assert_eq!(clip.size(), (32, 24));
    let expected = clip.rows();
    let rows: Vec<ClipEntry> = std::iter::from_fn(|| clip.next_entry()).collect();
    assert!(rows.iter().enumerate().all(|(n, row)| row.sequence == n as u64));
    assert!(expected.is_none_or(|n| n == rows.len() as u64), "{expected:?} rows were promised, {} came", rows.len());
    rows
}

fn refusal(path: impl AsRef<Path>) -> CaptureError {
    open_clip(path, ClipOptions::default()).err().unwrap()
}

/// Returns one letter per row: Frame, Undecodable, Skipped.
fn kinds(rows: &[ClipEntry]) -> String {
    let kind = |r: &ClipEntry| match r.content {
        EntryContent::Frame(_) => 'F',
        EntryContent::Undecodable(_) => 'U',
        EntryContent::Skipped(_) => 'S',
    };
    rows.iter().map(kind).collect()
}

fn stamps(rows: &[ClipEntry]) -> Vec<i64> {
    rows.iter().map(|r| r.timestamp.ns()).collect()
}

fn written(format: PictureFormat) -> TempDir {
    let folder = TempDir::new().unwrap();
    let mut writer = ClipWriter::create(folder.path(), format).unwrap();
    (0..4).for_each(|n| writer.push(&frame(n)).unwrap());
    assert_eq!(writer.finish().unwrap(), 4);
    folder
}

#[test]
fn clips_from_the_clip_writer_are_read() {
    let wanted: Vec<_> = (0..4).map(|n| EntryContent::Frame(frame(n))).collect();
    assert_eq!(rows(written(PictureFormat::Png), None).into_iter().map(|r| r.content).collect::<Vec<_>>(), wanted);
    assert_eq!(stamps(&rows(written(PictureFormat::Jpeg { quality: 90 }), None)), [1_000, 40_001_000, 80_001_000, 120_001_000]);
}

#[test]
fn a_single_picture_is_a_clip_of_one_frame() {
    for format in [PictureFormat::Png, PictureFormat::Jpeg { quality: 90 }] {
        let folder = written(format);
        let picture = std::fs::read_dir(folder.path().join("frames")).unwrap().flatten().map(|entry| entry.path()).max().unwrap();
        // Whatever its name.
        let other = folder.path().join("still");
        std::fs::copy(&picture, &other).unwrap();
        for path in [picture, other] {
            let rows = rows(path, None);
            assert_eq!((kinds(&rows), stamps(&rows)), ("F".to_owned(), vec![0]), "{format:?}");
        }
    }
    let folder = TempDir::new().unwrap();
    let pgm = folder.path().join("still.pgm");
    frame(0).image.save(&pgm).unwrap();
    assert_eq!(rows(pgm, None)[0].content, EntryContent::Frame(Frame { timestamp: Timestamp::default(), ..frame(0) }));
}

#[test]
fn every_row_of_a_damaged_folder_keeps_its_number() {
    let folder = written(PictureFormat::Png);
    let frames = folder.path().join("frames");
    let whole = fs::read(frames.join("000001.png")).unwrap();
    fs::write(frames.join("cut.png"), &whole[..whole.len() / 2]).unwrap();
    GrayImage::new(8, 8).save(frames.join("small.png")).unwrap();
    fs::create_dir(folder.path().join("data")).unwrap();
    fs::copy(frames.join("000002.png"), folder.path().join("beside.png")).unwrap();
    fs::copy(frames.join("000003.png"), folder.path().join("data/euroc.png")).unwrap();
    let csv = "#timestamp [ns],filename\nx,000000.png\n10,cut.png\n20,000000.png\n20,000001.png\n15,000001.png\n30,small.png\n\
        40,gone.png\nsoon,000001.png\n50,beside.png\n60,euroc.png\n70\n80,frames/000001.png\n";
    fs::write(folder.path().join("timestamps.csv"), csv).unwrap();
    let rows = rows(&folder, None);
    assert_eq!(kinds(&rows), "SUFSSSUSFFUF");
    assert_eq!(stamps(&rows), [0, 10, 20, 20, 15, 30, 40, 40, 50, 60, 70, 80]);
}

#[test]
fn names_leading_outside_the_clip_are_refused_with_their_line() {
    let folder = written(PictureFormat::Png);
    let outside = TempDir::new().unwrap();
    fs::copy(folder.path().join("frames/000000.png"), outside.path().join("a.png")).unwrap();
    let absolute = outside.path().join("a.png").display().to_string();
    for name in ["../a.png", "frames/../../a.png", &absolute, ".."] {
        fs::write(folder.path().join("timestamps.csv"), format!("#timestamp [ns],filename\n10,000000.png\n\n20,{name}\n")).unwrap();
        let message = refusal(&folder).to_string();
        assert!(message.contains("timestamps.csv line 4 names \"") && message.contains("outside of the clip; name pictures"), "{message}");
    }
    fs::write(folder.path().join("timestamps.csv"), "#timestamp [ns],filename\n10,./000000.png\n20,..png\n").unwrap();
    assert_eq!(kinds(&rows(&folder, None)), "FU");
}

#[test]
fn a_frame_that_is_not_a_plain_file_is_undecodable() {
    let folder = written(PictureFormat::Png);
    let frames = folder.path().join("frames");
    nix::unistd::mkfifo(&frames.join("pipe.png"), nix::sys::stat::Mode::S_IRWXU).unwrap();
    std::os::unix::fs::symlink("/dev/zero", frames.join("zero.png")).unwrap();
    let csv = "#timestamp [ns],filename\n10,pipe.png\n20,000000.png\n30,zero.png\n40,.\n";
    fs::write(folder.path().join("timestamps.csv"), csv).unwrap();
    let rows = rows(&folder, None);
    assert_eq!(kinds(&rows), "UFUU");
    let EntryContent::Undecodable(reason) = &rows[0].content else { panic!("{:?}", rows[0].content) };
    assert!(reason.ends_with("pipe.png cannot be read: it is a named pipe, not a plain file"), "{reason}");
    fs::remove_file(folder.path().join("timestamps.csv")).unwrap();
    nix::unistd::mkfifo(&folder.path().join("timestamps.csv"), nix::sys::stat::Mode::S_IRWXU).unwrap();
    assert!(refusal(&folder).to_string().contains("it is a named pipe, not a plain file; give a clip in plain files"));
}

#[test]
fn an_odd_sized_first_picture_does_not_set_the_clip_size() {
    let folder = written(PictureFormat::Png);
    GrayImage::new(64, 24).save(folder.path().join("frames/000000.png")).unwrap();
    assert_eq!(kinds(&rows(&folder, None)), "SFFF");
    let of = |calibrated| {
        let mut clip = open_clip(&folder, ClipOptions { calibrated, ..ClipOptions::default() }).unwrap();
        (clip.size(), kinds(&std::iter::from_fn(|| clip.next_entry()).collect::<Vec<_>>()))
    };
    assert_eq!(of(Some((64, 24))), ((64, 24), "FSSS".to_owned()), "the calibration's size");
    assert_eq!(of(Some((640, 240))), ((64, 24), "FSSS".to_owned()), "its shape");
    assert_eq!(of(Some((640, 480))), ((32, 24), "SFFF".to_owned()));
}

#[test]
fn a_rotated_picture_is_tracked_unrotated_with_a_remark() {
    let folder = TempDir::new().unwrap();
    let mut bytes = Vec::new();
    let mut encoder = image::codecs::jpeg::JpegEncoder::new(&mut bytes);
    image::ImageEncoder::set_exif_metadata(&mut encoder, crate::capture::grey::tests::exif(6)).unwrap();
    picture(3).write_with_encoder(encoder).unwrap();
    fs::write(folder.path().join("a.jpg"), bytes).unwrap();
    assert_eq!(kinds(&rows(&folder, None)), "F");
    let notes = open_clip(&folder, ClipOptions::default()).unwrap().notes();
    assert!(notes[0].starts_with("row 0: the file says to show its picture turned by 90 degrees (EXIF)"), "{notes:?}");
}

#[test]
fn a_folder_of_pictures_is_read_in_the_order_of_names() {
    let folder = TempDir::new().unwrap();
    for (name, level) in [("b.png", 2), ("a10.png", 1), ("a2.PNG", 3)] {
        picture(level).save_with_format(folder.path().join(name), image::ImageFormat::Png).unwrap();
    }
    fs::write(folder.path().join("notes.txt"), "x").unwrap();
    fs::write(folder.path().join(".hidden.png"), "x").unwrap();
    let read = rows(&folder, None);
    let firsts: Vec<u8> = read.iter().map(|r| if let EntryContent::Frame(f) = &r.content { f.image.as_raw()[0] } else { 0 }).collect();
    assert_eq!((firsts, stamps(&read)), (vec![1, 3, 2], vec![0, 33_333_333, 66_666_667]));
    assert_eq!(stamps(&rows(&folder, Some(50.0))), [0, 20_000_000, 40_000_000]);
}

#[test]
fn repeats_are_marked_in_picture_folders_but_not_in_video() {
    let folder = TempDir::new().unwrap();
    fs::create_dir(folder.path().join("frames")).unwrap();
    let mut index = "#timestamp [ns],filename\n".to_owned();
    for (n, level) in [1, 2, 2, 2, 3].into_iter().enumerate() {
        picture(level).save(folder.path().join(format!("frames/{n}.png"))).unwrap();
        index += &format!("{},{n}.png\n", n * 40_000_000);
    }
    fs::write(folder.path().join("timestamps.csv"), index).unwrap();
    let marked = |rows: &[ClipEntry]| rows.iter().map(|row| row.repeats).collect::<Vec<_>>();
    assert_eq!(marked(&rows(&folder, None)), [false, false, true, true, false]);
    let path = folder.path().join("clip.y4m");
    let mut bytes = b"YUV4MPEG2 W32 H24 F25:1 Ip C420jpeg\n".to_vec();
    [1, 2, 2].into_iter().for_each(|n| bytes.extend([&b"FRAME\n"[..], picture(n).as_raw(), &[128; 384]].concat()));
    fs::write(&path, &bytes).unwrap();
    assert_eq!(marked(&rows(&path, None)), [false; 3]);
}

#[test]
fn y4m_is_read_at_its_own_rate_or_the_given_one() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("clip.y4m");
    let mut bytes = b"YUV4MPEG2 W32 H24 F25:1 Ip C420jpeg\n".to_vec();
    (0..3).for_each(|n| bytes.extend([&b"FRAME\n"[..], picture(n).as_raw(), &[128; 384]].concat()));
    fs::write(&path, &bytes).unwrap();
    let read = rows(&path, None);
    assert_eq!((kinds(&read).as_str(), stamps(&read)), ("FFF", vec![0, 40_000_000, 80_000_000]));
    assert_eq!(read[1].content, EntryContent::Frame(Frame { image: picture(1), timestamp: Timestamp::from_ns(40_000_000), sequence: 1 }));
    assert_eq!(stamps(&rows(&path, Some(10.0)))[2], 200_000_000);
    fs::write(&path, &bytes[..bytes.len() - 1]).unwrap();
    assert_eq!(kinds(&rows(&path, None)), "FFU");
    fs::write(&path, b"YUV4MPEG2 W32 H24\nFRAME\n").unwrap();
    assert!(matches!(refusal(&path), CaptureError::RateUnknown { .. }));
    fs::write(&path, b"YUV4MPEG2 W32 H24 F25:1\n").unwrap();
    assert!(matches!(refusal(&path), CaptureError::Empty { .. }));
    fs::write(&path, b"not a y4m").unwrap();
    assert!(matches!(refusal(&path), CaptureError::Stream { .. }));
}

#[test]
fn damaged_mjpeg_frames_become_rows_without_a_picture() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("clip.mjpeg");
    let whole = jpeg(3);
    let cut = &whole[..whole.len() - 30];
    fs::write(&path, [cut, &jpeg(1), cut, &jpeg(2)].concat()).unwrap();
    let read = rows(&path, None);
    assert_eq!((kinds(&read).as_str(), stamps(&read)[3]), ("UFUF", 100_000_000));
    fs::write(&path, cut).unwrap();
    let error = refusal(&path);
    assert!(matches!(error, CaptureError::NoFrameReadable { rows: 1, .. }), "{error}");
}

#[test]
fn non_clips_are_refused_with_the_reason() {
    let folder = TempDir::new().unwrap();
    assert!(matches!(refusal(folder.path()), CaptureError::Empty { .. }));
    assert!(matches!(refusal(folder.path().join("gone")), CaptureError::NotFound { .. }));
    fs::write(folder.path().join("timestamps.csv"), "10,a.png\n").unwrap();
    let error = refusal(folder.path());
    assert!(matches!(error, CaptureError::TimestampsHeader { .. }) && error.to_string().contains("timestamps.csv line 1 is \"10,a.png\""));
    fs::write(folder.path().join("timestamps.csv"), "#timestamp [ns],filename\n").unwrap();
    assert!(matches!(refusal(folder.path()), CaptureError::Empty { .. }));
    fs::write(folder.path().join("timestamps.csv"), "#timestamp [ns],filename\n10,a.png\n20,b.png\n").unwrap();
    assert!(matches!(refusal(folder.path()), CaptureError::NoFrameReadable { rows: 2, .. }));
    fs::write(folder.path().join("empty.y4m"), "").unwrap();
    assert!(matches!(refusal(folder.path().join("empty.y4m")), CaptureError::Empty { .. }));
    fs::write(folder.path().join("broken.avi"), b"RIFF\x04\0\0\0AVI ").unwrap();
    assert!(matches!(refusal(folder.path().join("broken.avi")), CaptureError::Stream { .. }));
    let bad_rate = open_clip(folder.path(), ClipOptions { fps: Some(0.0), ..ClipOptions::default() }).err();
    assert!(matches!(bad_rate, Some(CaptureError::Rate { .. })));
}

/// Runs ffmpeg on grey test pictures; false (with a message) if it is not installed.
fn ffmpeg(arguments: &[&str], output: &Path) -> bool {
    let source = ["-v", "error", "-y", "-f", "lavfi", "-i", "testsrc2=s=32x24:r=25:d=0.4"];
    match Command::new("ffmpeg").args(source).args(arguments).arg(output).status() {
        Ok(status) => status.success(),
        Err(_) => {
            eprintln!("skipped: ffmpeg is not installed");
            false
        }
    }
}

#[test]
fn files_made_by_ffmpeg_are_read() {
    let folder = TempDir::new().unwrap();
    let cases: [(&str, &[&str], i64); 6] = [
        ("mjpeg.avi", &["-c:v", "mjpeg"], 40_000_000),
        ("clip.mjpeg", &["-c:v", "mjpeg", "-f", "mjpeg"], 33_333_333),
        ("clip.y4m", &["-pix_fmt", "yuv422p"], 40_000_000),
        ("mono.y4m", &["-pix_fmt", "gray"], 40_000_000),
        ("other.avi", &["-c:v", "ffv1"], 40_000_000),
        ("clip.mkv", &["-c:v", "ffv1"], 40_000_000),
    ];
    for (name, arguments, second) in cases {
        let path = folder.path().join(name);
        if !ffmpeg(arguments, &path) {
            return;
        }
        let read = rows(&path, None);
        assert_eq!((kinds(&read).as_str(), read[1].timestamp.ns()), ("FFFFFFFFFF", second), "{name}");
        assert_eq!(stamps(&rows(&path, Some(10.0)))[2], 200_000_000, "{name}");
    }
}

/// ffmpeg writes JPEGs with unusual sampling factors, among them 1x2 on all components of 4:4:4.
#[test]
fn jpegs_of_every_sampling_are_whole_or_refused() {
    let folder = TempDir::new().unwrap();
    for form in ["yuvj420p", "yuvj422p", "yuvj444p"] {
        let (path, raw) = (folder.path().join("sampled.avi"), folder.path().join("raw.y4m"));
        if !ffmpeg(&["-pix_fmt", form, "-q:v", "2", "-c:v", "mjpeg"], &path) {
            return;
        }
        // The same file, decoded by ffmpeg itself.
        let arguments = ["-v", "error", "-y", "-i"].map(OsStr::new);
        let planes = ["-vf", "extractplanes=y", "-strict", "-1"].map(OsStr::new);
        let status = Command::new("ffmpeg").args(arguments).arg(&path).args(planes).arg(&raw).status();
        assert!(status.unwrap().success());
        for (ours, theirs) in rows(&path, None).iter().zip(&rows(&raw, None)) {
            let furthest = image(ours).iter().zip(image(theirs).iter()).map(|(a, b)| a.abs_diff(*b)).max();
            assert!(furthest.is_some_and(|d| d <= 2), "{form}: {furthest:?} {:?}", ours.content);
        }
        let still = folder.path().join("still.jpg");
        assert!(ffmpeg(&["-pix_fmt", form, "-frames:v", "1"], &still));
        let bytes = fs::read(&still).unwrap();
        assert!(decode_grey(&bytes).is_ok());
        let early_end = [&bytes[..bytes.len() * 3 / 4], &[0xFF, 0xD9]].concat();
        assert!(decode_grey(&early_end).is_err(), "{form}");
    }
}

/// Returns the picture of a row; 1 x 1 pixel if it has none.
fn image(row: &ClipEntry) -> GrayImage {
    if let EntryContent::Frame(f) = &row.content { f.image.clone() } else { GrayImage::new(1, 1) }
}

#[test]
fn frames_of_uneven_rate_keep_their_stamps_and_their_luma() {
    let folder = TempDir::new().unwrap();
    let (uneven, straight) = (folder.path().join("uneven.mkv"), folder.path().join("straight.y4m"));
    // Frames 0, 1, 4, 5 and 9 at 25 per second.
    let chosen = ["-vf", "select=eq(n\\,0)+eq(n\\,1)+eq(n\\,4)+eq(n\\,5)+eq(n\\,9)", "-vsync", "passthrough", "-c:v", "ffv1"];
    if !ffmpeg(&[&chosen[..], &["-pix_fmt", "yuv420p"]].concat(), &uneven) || !ffmpeg(&["-pix_fmt", "yuv420p"], &straight) {
        return;
    }
    let (read, whole) = (rows(&uneven, None), rows(&straight, None));
    assert_eq!(stamps(&read), [0, 40_000_000, 160_000_000, 200_000_000, 360_000_000]);
    assert_eq!(image(&read[2]), image(&whole[4]), "the luma comes through as it is, limited range and all");
}

#[test]
fn files_ffmpeg_cannot_read_are_refused_with_the_reason() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("noise.mp4");
    fs::write(&path, [7u8; 1000]).unwrap();
    let error = refusal(&path);
    assert!(matches!(error, CaptureError::FfmpegFailed { .. } | CaptureError::FfmpegMissing { .. }), "{error}");
    assert!(!error.to_string().contains('\n'));
}
