//! Videos as other cameras and programs write them, made by ffmpeg; skipped if it is not installed.

use std::fs;
use std::path::Path;
use std::process::Command;

use image::GrayImage;
use tempfile::TempDir;

use super::super::{ClipEntry, EntryContent, FrameSource, decode_grey};
use super::*;

/// Runs ffmpeg on ten test pictures of 64 x 48; false (with a message) if it is not installed.
fn ffmpeg(arguments: &str, output: &Path) -> bool {
    made_of("testsrc2=s=64x48:r=25:d=0.4", arguments, output)
}

fn made_of(source: &str, arguments: &str, output: &Path) -> bool {
    let before = ["-v", "error", "-y", "-f", "lavfi", "-i", source];
    match Command::new("ffmpeg").args(before).args(arguments.split(' ').filter(|a| !a.is_empty())).arg(output).status() {
        Ok(status) => status.success(),
        Err(_) => {
            eprintln!("skipped: ffmpeg is not installed");
            false
        }
    }
}

fn open_at(path: &Path, calibrated: Option<(u32, u32)>) -> Box<dyn FrameSource> {
    open_clip(path, ClipOptions { calibrated, ..ClipOptions::default() }).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Returns all rows, and the remarks made meanwhile.
fn all(mut source: Box<dyn FrameSource>) -> (Vec<ClipEntry>, String) {
    let rows = std::iter::from_fn(|| source.next_entry()).collect();
    (rows, source.notes().join("\n"))
}

fn read(path: &Path) -> (Vec<ClipEntry>, String) {
    all(open_at(path, None))
}

fn image(row: &ClipEntry) -> &GrayImage {
    if let EntryContent::Frame(frame) = &row.content { &frame.image } else { panic!("{:?}", row.content) }
}

fn kinds(rows: &[ClipEntry]) -> String {
    let kind = |row: &ClipEntry| match &row.content {
        EntryContent::Frame(_) => 'F',
        EntryContent::Undecodable(_) => 'U',
        EntryContent::Skipped(_) => 'S',
    };
    rows.iter().map(kind).collect()
}

#[test]
fn rgb_video_converts_to_grey_like_pictures() {
    let folder = TempDir::new().unwrap();
    let pictures = folder.path().join("%02d.png");
    if !ffmpeg("-pix_fmt rgb24", &pictures) {
        return;
    }
    let picture = |n: usize| decode_grey(&fs::read(folder.path().join(format!("{:02}.png", n + 1))).unwrap()).unwrap();
    let forms = [
        ("png.mov", "-c:v png -pix_fmt rgb24"),
        ("bgr0.mkv", "-c:v ffv1 -pix_fmt bgr0"),
        ("bgr24.avi", "-c:v rawvideo -pix_fmt bgr24"),
        ("rgba.mov", "-c:v png -pix_fmt rgba"),
        ("gbrp.mkv", "-c:v ffv1 -pix_fmt gbrp"),
        ("animation.mov", "-c:v qtrle -pix_fmt rgb24"),
        ("deep.mov", "-c:v png -pix_fmt rgb48be"),
        ("gbrp16.mkv", "-c:v ffv1 -pix_fmt gbrp16le"),
    ];
    for (name, arguments) in forms {
        let path = folder.path().join(name);
        // From exactly the same pixels.
        let source = folder.path().join("%02d.png").display().to_string();
        let before = ["-v", "error", "-y", "-framerate", "25", "-i", &source];
        assert!(Command::new("ffmpeg").args(before).args(arguments.split(' ')).arg(&path).status().unwrap().success(), "{name}");
        let (rows, said) = read(&path);
        assert_eq!((rows.len(), said.as_str()), (10, ""), "{name}");
        for (n, row) in rows.iter().enumerate() {
            let furthest = image(row).iter().zip(picture(n).iter()).map(|(a, b)| a.abs_diff(*b)).max();
            // Eight bits are equal to the level; ffmpeg makes sixteen bits from eight.
            assert!(furthest <= Some(u8::from(name == "deep.mov" || name == "gbrp16.mkv")), "{name} {n}: {furthest:?}");
        }
    }
    let gif = folder.path().join("palette.gif");
    assert!(ffmpeg("", &gif));
    assert_eq!(kinds(&read(&gif).0), "FFFFFFFFFF");
}

#[test]
fn the_luma_plane_stays_as_it_is_in_8_and_10_bits() {
    let folder = TempDir::new().unwrap();
    let plain = folder.path().join("plain.y4m");
    if !ffmpeg("-pix_fmt yuv420p", &plain) {
        return;
    }
    let wanted = read(&plain).0;
    for (name, form) in [("10.mkv", "yuv420p10le"), ("12.mkv", "yuv422p12le"), ("16.mkv", "yuv444p16le"), ("a.mkv", "yuva420p")] {
        let path = folder.path().join(name);
        let before = ["-v", "error", "-y", "-i"];
        let made = Command::new("ffmpeg").args(before).arg(&plain).args(["-c:v", "ffv1", "-pix_fmt", form]).arg(&path).status();
        assert!(made.unwrap().success(), "{name}");
        for (row, wanted) in read(&path).0.iter().zip(&wanted) {
            assert_eq!(image(row), image(wanted), "{name}");
        }
    }
    let deep_grey = folder.path().join("grey.mkv");
    assert!(ffmpeg("-c:v ffv1 -pix_fmt gray16le", &deep_grey));
    let brightest = read(&deep_grey).0.iter().flat_map(|row| image(row).iter().copied().max()).max();
    assert!(brightest >= Some(200), "{brightest:?}");
}

/// Writes an mp4 whose track header has this display matrix.
fn with_matrix(path: &Path, [a, b, c, d]: [i32; 4]) {
    let mut bytes = fs::read(path).unwrap();
    let at = bytes.windows(4).position(|w| w == b"tkhd").unwrap() + 44;
    for (k, value) in [a, b, 0, c, d, 0].into_iter().enumerate() {
        bytes[at + 4 * k..at + 4 * k + 4].copy_from_slice(&(value * 65_536).to_be_bytes());
    }
    fs::write(path, bytes).unwrap();
}

#[test]
fn a_rotated_video_is_read_unrotated_with_a_remark() {
    let folder = TempDir::new().unwrap();
    let (plain, turned) = (folder.path().join("plain.mp4"), folder.path().join("turned.mp4"));
    if !ffmpeg("-c:v mpeg4 -q:v 2", &plain) {
        return;
    }
    let (wanted, said) = read(&plain);
    assert_eq!(said, "");
    let matrices = [
        ([-1, 0, 0, -1], "turned by 180 degrees"),
        ([0, 1, -1, 0], "turned by 90 degrees to the right"),
        ([0, -1, 1, 0], "turned by 90 degrees to the left"),
        ([-1, 0, 0, 1], "mirrored"),
        ([1, 0, 0, -1], "mirrored"),
    ];
    for (matrix, words) in matrices {
        fs::copy(&plain, &turned).unwrap();
        with_matrix(&turned, matrix);
        let (rows, said) = read(&turned);
        assert!(said.contains(&format!("the file says to show its pictures {words} (display matrix)")), "{matrix:?}: {said}");
        assert!(rows.iter().zip(&wanted).all(|(row, wanted)| row.content == wanted.content), "{matrix:?}");
        let mut coloured = open_clip_in_colour(&turned, ClipOptions::default()).unwrap();
        let colours = coloured.next_entry().unwrap().received.and_then(|r| r.colours()).unwrap();
        let grey = image::imageops::grayscale(&*colours);
        let off = grey.iter().zip(image(&wanted[0]).iter()).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / (64.0 * 48.0);
        assert!(off < 25.0, "its colours lie as its luma: {off}");
    }
}

#[test]
fn a_size_change_loses_only_the_rows_of_the_other_size() {
    let folder = TempDir::new().unwrap();
    let part = |name: &str, size: &str| {
        let path = folder.path().join(name);
        made_of(&format!("testsrc2=s={size}:r=25:d=0.4"), "-c:v mpeg2video -q:v 2 -f mpegts", &path).then(|| fs::read(path).unwrap())
    };
    let (Some(large), Some(small), Some(tall)) = (part("a", "64x48"), part("b", "32x32"), part("c", "48x64")) else { return };
    let written = |parts: &[&[u8]]| {
        let path = folder.path().join("joined.ts");
        fs::write(&path, parts.concat()).unwrap();
        path
    };
    for other in [&small, &tall] {
        let (rows, _) = read(&written(&[&large, other]));
        let skipped: Vec<_> = rows.iter().filter(|r| matches!(r.content, EntryContent::Skipped(_))).collect();
        assert!(kinds(&rows).starts_with("FFFFFFFFF") && skipped.len() >= 9, "{}", kinds(&rows));
        let EntryContent::Skipped(reason) = &skipped[0].content else { panic!() };
        let size = if std::ptr::eq(other, &small) { "32 x 32" } else { "48 x 64" };
        assert!(reason.contains(&format!("the picture is {size} pixels, the clip's are 64 x 48")), "{reason}");
        let (rows, _) = read(&written(&[&large, other, &large]));
        let kinds = kinds(&rows);
        assert!(kinds.starts_with("FFFFFFFFF") && kinds.contains("SSSSSSSSS") && kinds.ends_with("FFFFFFFFF"), "{kinds}");
        // The pictures behind the change of size are whole.
        let last = image(rows.last().unwrap());
        let before = image(&rows[kinds.find('S').unwrap() - 1]);
        let off = last.iter().zip(before.iter()).filter(|(a, b)| a.abs_diff(**b) > 20).count();
        assert!(off < 64 * 48 / 4, "{off} pixels of the last picture are elsewhere");
        let (rows, _) = all(open_at(&written(&[other, &large]), Some((64, 48))));
        assert!(rows.len() >= 18, "{}", rows.len());
    }
}

#[test]
fn unusual_video_properties_are_reported() {
    let folder = TempDir::new().unwrap();
    let said = |name: &str, arguments: &str| {
        let path = folder.path().join(name);
        ffmpeg(arguments, &path).then(|| read(&path).1)
    };
    let Some(plain) = said("plain.mkv", "-c:v ffv1") else { return };
    assert_eq!(plain, "");
    let interlaced = said("i.ts", "-c:v mpeg2video -flags +ildct+ilme -top 1 -f mpegts").unwrap();
    assert!(interlaced.contains("the video is interlaced") && interlaced.contains("bwdif"), "{interlaced}");
    for (name, arguments) in [("sar.mkv", "-vf setsar=4/3 -c:v ffv1"), ("sar.y4m", "-vf setsar=4/3 -pix_fmt yuv420p")] {
        let shape = said(name, arguments).unwrap();
        assert!(shape.contains("4:3 as wide as high") && shape.contains("fx / fy = 0.7500"), "{name}: {shape}");
    }
    for (name, arguments, rate) in [
        ("raw.h263", "-vf scale=128:96 -c:v h263 -f h263", "29.97"),
        ("clip.mjpeg", "-c:v mjpeg -f mjpeg", "30"),
        ("parts.bin", "-c:v mjpeg -f mpjpeg", "30"),
    ] {
        let path = folder.path().join(name);
        assert!(ffmpeg(arguments, &path), "{name}");
        let (rows, said) = read(&path);
        assert!(said.contains(&format!("{rate} frames a second are assumed; give --fps")), "{name}: {said}");
        assert_eq!(kinds(&rows), "FFFFFFFFFF", "{name}");
        let given = ClipOptions { fps: Some(25.0), ..ClipOptions::default() };
        assert!(!all(open_clip(&path, given).unwrap()).1.contains("are assumed"), "{name}");
    }
}

#[test]
fn a_truncated_recording_is_reported() {
    let folder = TempDir::new().unwrap();
    let (path, cut) = (folder.path().join("whole.mp4"), folder.path().join("cut.mp4"));
    if !ffmpeg("-c:v mpeg4 -q:v 2", &path) {
        return;
    }
    let whole = fs::read(&path).unwrap();
    fs::write(&cut, &whole[..whole.len() / 2]).unwrap();
    let refused = open_clip(&cut, ClipOptions::default()).err().unwrap();
    assert!(matches!(refused, CaptureError::CutOff { .. }) && refused.to_string().contains("was cut off"), "{refused}");
    assert!(ffmpeg("-c:v mpeg4 -q:v 2 -movflags +faststart", &path));
    let whole = fs::read(&path).unwrap();
    fs::write(&cut, &whole[..whole.len() * 3 / 4]).unwrap();
    let (rows, said) = read(&cut);
    assert!((1..10).contains(&rows.len()) && said.contains("the recording is cut off"), "{} rows: {said}", rows.len());
}

#[test]
fn a_heic_still_is_not_reported_as_a_damaged_video() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("IMG_0001.mp4");
    fs::write(&path, b"\0\0\0\x18ftypheic\0\0\0\0mif1heic\0\0\0\x08free").unwrap();
    let refused = open_clip(&path, ClipOptions::default()).err().unwrap().to_string();
    assert!(refused.contains("HEIC") && refused.contains("heif-convert"), "{refused}");
}
