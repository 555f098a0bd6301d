use super::*;
use crate::web::api::tests::{respond, supervised};

/// Makes a recording of three rows: one with a JPEG, one with a grey picture, one without a
/// picture.
pub(in crate::web::api) fn recording(folder: &Path) {
    let clip = folder.join("recordings/clip-1");
    std::fs::create_dir_all(clip.join("frames/0000")).unwrap();
    std::fs::write(clip.join("timestamps.csv"), "#timestamp [ns],filename\n10,0000/a.jpg\n2000000010,0000/b.pgm\n20,../../../stage.toml\n")
        .unwrap();
    let jpeg = crate::web::hub::grey_jpeg(&[7; 64], 8, 8, Vec::new()).unwrap();
    std::fs::write(clip.join("frames/0000/a.jpg"), jpeg).unwrap();
    std::fs::write(clip.join("frames/0000/b.pgm"), b"P5\n2 2\n255\n\x01\x02\x03\x04").unwrap();
    let line = |k: u32| format!("{{\"sequence\":{k},\"timestamp_ns\":{k},\"state\":\"lost\",\"rms_px\":null,\"name\":\"\u{e4}%\"}}\n");
    std::fs::write(clip.join("poses.jsonl"), (0..3).map(line).collect::<String>()).unwrap();
    std::os::unix::fs::symlink("/", folder.join("recordings/root")).unwrap();
}

#[test]
fn a_recording_is_listed_and_its_rows_are_given() {
    let folder = tempfile::tempdir().unwrap();
    recording(folder.path());
    let supervisor = supervised(folder.path());
    let get = |path: &str| respond(&routes(&supervisor, &Arc::default()), "GET", path, b"");
    let listed: Value = serde_json::from_slice(&get("/api/v1/recordings").1).unwrap();
    assert_eq!(listed["recordings"].as_array().unwrap().len(), 1);
    assert_eq!((&listed["recordings"][0]["id"], &listed["recordings"][0]["frames"]), (&"clip-1".into(), &3.into()));
    assert!(get("/api/v1/recordings/clip-1/frame/0").1.starts_with(&[0xFF, 0xD8]));
    assert!(get("/api/v1/recordings/clip-1/frame/1").1.starts_with(&[0xFF, 0xD8]));
    assert_eq!(get("/api/v1/recordings/clip-1/poses?from=1&count=1").1.iter().filter(|b| **b == b'\n').count(), 1);
    let value: Value = serde_json::from_slice(&get("/api/v1/recordings/clip-1/timeline?points=2").1).unwrap();
    assert_eq!(value["frames"], 3);
}

#[test]
fn nothing_outside_of_the_folder_is_given() {
    let folder = tempfile::tempdir().unwrap();
    recording(folder.path());
    let supervisor = supervised(folder.path());
    let status = |path: &str| respond(&routes(&supervisor, &Arc::default()), "GET", path, b"").0;
    assert_eq!(status("/api/v1/recordings/clip-1/frame/2"), 404, "its name leads out");
    for id in ["root", "..", ".", "%2e%2e", "..%2f..", "clip-1%2f..", "a%00b", "%ff", "none"] {
        for below in ["timeline", "frame/0", "poses", "download"] {
            let status = status(&format!("/api/v1/recordings/{id}/{below}"));
            assert!((400..405).contains(&status), "{id}/{below}: {status}");
        }
    }
    for wrong in ["frame/-1", "frame/x", "frame/99999999999999999999", "timeline?points=0", "timeline?points=1e9", "poses?count=-1"] {
        assert_eq!(status(&format!("/api/v1/recordings/clip-1/{wrong}")), 400, "{wrong}");
    }
    assert_eq!(status("/api/v1/recordings/clip-1/frame/3"), 404);
}

#[test]
fn a_download_is_a_zip_of_all_of_it() {
    let folder = tempfile::tempdir().unwrap();
    recording(folder.path());
    let supervisor = supervised(folder.path());
    let (status, zipped) = respond(&routes(&supervisor, &Arc::default()), "GET", "/api/v1/recordings/clip-1/download", b"");
    assert_eq!(status, 200);
    let mut zip = zip::ZipArchive::new(io::Cursor::new(zipped)).unwrap();
    let names: Vec<String> = zip.file_names().map(str::to_owned).collect();
    assert_eq!(names.len(), 4, "{names:?}");
    let mut picture = Vec::new();
    zip.by_name("clip-1/frames/0000/b.pgm").unwrap().read_to_end(&mut picture).unwrap();
    assert_eq!(picture, b"P5\n2 2\n255\n\x01\x02\x03\x04");
}

#[test]
fn a_report_has_texts_and_pictures_on_request_only() {
    let folder = tempfile::tempdir().unwrap();
    recording(folder.path());
    let supervisor = supervised(folder.path());
    let names = |query: &str| -> Vec<String> {
        let (status, zipped) =
            respond(&routes(&supervisor, &Arc::default()), "GET", &format!("/api/v1/recordings/clip-1/report{query}"), b"");
        assert_eq!(status, 200);
        let zip = zip::ZipArchive::new(io::Cursor::new(zipped)).unwrap();
        zip.file_names().map(str::to_owned).collect()
    };
    let without = names("");
    for wanted in ["about.txt", "config/stage.toml", "config/verdict.txt", "daemon/diagnostics.txt", "recording/poses.jsonl"] {
        assert!(without.iter().any(|name| name == wanted), "{wanted}: {without:?}");
    }
    assert!(!without.iter().any(|name| name.ends_with(".jpg") || name.ends_with(".png")), "{without:?}");
    let with = names("?pictures=600");
    assert!(with.iter().any(|name| name == "recording/frames/0000/b.pgm"), "{with:?}");
}

#[test]
fn no_link_below_a_recording_is_followed() {
    let folder = tempfile::tempdir().unwrap();
    recording(folder.path());
    let supervisor = supervised(folder.path());
    let (clip, secret) = (folder.path().join("recordings/clip-1"), folder.path().join("secret"));
    std::fs::write(&secret, "secret\n").unwrap();
    let grey = folder.path().join("outside");
    std::fs::create_dir(&grey).unwrap();
    std::fs::write(grey.join("b.pgm"), b"P5\n1 1\n255\nS").unwrap();
    let get = |path: &str| respond(&routes(&supervisor, &Arc::default()), "GET", &format!("/api/v1/recordings/clip-1/{path}"), b"");
    let link = |to: &Path, name: &str| {
        let at = clip.join(name);
        let _ = std::fs::remove_file(&at).or_else(|_| std::fs::remove_dir_all(&at));
        std::os::unix::fs::symlink(to, at).unwrap();
    };
    link(&secret, "poses.jsonl");
    link(&secret, "events.jsonl");
    link(&grey, "frames/0000");
    for path in ["poses", "timeline", "frame/0", "frame/1"] {
        let (status, said) = get(path);
        assert_eq!(status, 500, "{path}: {}", String::from_utf8_lossy(&said));
    }
    let (status, zipped) = get("download");
    let zip = zip::ZipArchive::new(io::Cursor::new(zipped)).unwrap();
    assert_eq!((status, zip.file_names().collect::<Vec<_>>()), (200, vec!["clip-1/timestamps.csv"]));
    let (status, zipped) = get("report?pictures=600");
    assert_eq!(status, 200);
    let mut zip = zip::ZipArchive::new(io::Cursor::new(zipped)).unwrap();
    for k in 0..zip.len() {
        let mut text = Vec::new();
        zip.by_index(k).unwrap().read_to_end(&mut text).unwrap();
        assert!(!text.windows(6).any(|part| part == b"secret" || part.ends_with(b"255\nS")), "file {k} of the report");
    }
    link(&secret, "timestamps.csv");
    assert_eq!(get("frame/0").0, 500);
}

#[test]
fn a_picture_beyond_the_limit_is_not_decoded_and_one_within_is() {
    let folder = tempfile::tempdir().unwrap();
    recording(folder.path());
    let supervisor = supervised(folder.path());
    let picture = folder.path().join("recordings/clip-1/frames/0000/b.pgm");
    let get = || respond(&routes(&supervisor, &Arc::default()), "GET", "/api/v1/recordings/clip-1/frame/1", b"");
    let pgm = |width: usize, height: usize| [format!("P5\n{width} {height}\n255\n").into_bytes(), vec![7; width * height]].concat();
    std::fs::write(&picture, pgm(4000, 3000)).unwrap();
    let (status, shown) = get();
    assert!(status == 200 && shown.starts_with(&[0xFF, 0xD8]), "{status}");
    image::GrayImage::new(9000, 9000).save_with_format(&picture, image::ImageFormat::Png).unwrap();
    let (status, said) = get();
    let said = String::from_utf8_lossy(&said).into_owned();
    assert!(status == 413 && said.contains("67 million"), "{status}: {said}");
}
