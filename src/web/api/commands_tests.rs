use std::os::unix::fs::PermissionsExt;

use serde_json::Value;

use super::*;
use crate::web::api::tests::{respond, supervised};

/// A program in place of ours, as a shell script.
fn script(folder: &Path, text: &str) -> PathBuf {
    let file = folder.join("program");
    std::fs::write(&file, format!("#!/bin/sh\n{text}\n")).unwrap();
    std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o755)).unwrap();
    file
}

/// Returns a daemon's supervisor with a recording, `clip-1`.
fn with_a_recording(folder: &Path) -> Arc<Supervisor> {
    let supervisor = supervised(folder);
    let clip = folder.join("recordings/clip-1");
    std::fs::create_dir_all(&clip).unwrap();
    std::fs::write(clip.join("timestamps.csv"), "#timestamp [ns],filename\n").unwrap();
    supervisor
}

/// Returns the routes without rate limits: a test asks more often than people do.
fn unpaced(supervisor: &Arc<Supervisor>) -> Vec<Route> {
    routes(supervisor, &Arc::default()).into_iter().map(|route| Route { pace: None, ..route }).collect()
}

/// Starts a job and returns how it ended.
fn ended(supervisor: &Arc<Supervisor>, routes: &[Route], path: &str, content: &[u8]) -> (String, String) {
    let (status, said) = respond(routes, "POST", path, content);
    assert_eq!(status, 202, "{}", String::from_utf8_lossy(&said));
    let number = serde_json::from_slice::<Value>(&said).unwrap()["job"].as_u64().unwrap();
    loop {
        let job = json!(supervisor.jobs.job(number).unwrap());
        if job["state"] != "running" {
            return (job["state"].as_str().unwrap().to_owned(), job["text"].as_str().unwrap().to_owned());
        }
        std::thread::yield_now();
    }
}

#[test]
fn a_sheet_has_the_name_of_what_it_shows() {
    let found = |name: &str| sheet_arguments(name).map(|arguments| arguments.join(" "));
    assert_eq!(found("poster-a3-7").as_deref(), Some("poster --paper a3 --seed 7"));
    assert_eq!(found("board-9x6-24-a4").as_deref(), Some("board --board 9x6 --square-mm 24 --paper a4"));
    for bad in ["poster", "poster-a3", "poster-a3-x", "poster--1", "poster-a3-1-1", "poster-a3-1.pdf", "board-9x6-a4", "devices-a-1", ""] {
        assert_eq!(found(bad), None, "{bad}");
    }
    let printed = "# poster.pdf: print it\n[[stage.surface]]\nimage = \"a.png\"\nsize_m = [0.277, 0.36]\n";
    assert_eq!(size_m(printed), Some([0.277, 0.36]));
    assert_eq!(size_m("# a board\n"), None);
}

#[test]
fn a_sheet_is_made_once_and_fetched() {
    let folder = tempfile::tempdir().unwrap();
    let supervisor = supervised(folder.path());
    let routes = unpaced(&supervisor);
    assert_eq!(respond(&routes, "PUT", "/api/v1/prints/poster-a3-1", b"").0, 409, "there is no program");
    let text = "for file; do :; done\nprintf pdf > \"$file\"\ncp backdrop.png \"${file%.pdf}-picture.png\"\n\
        echo '[[stage.surface]]'; echo 'size_m = [0.277, 0.36]'";
    supervisor.set_program(Some(script(folder.path(), &format!("cd {}\n{text}", folder.path().display()))));
    assert_eq!(respond(&routes, "GET", "/api/v1/prints/poster-a3-1.pdf", b"").0, 404);
    let (status, said) = respond(&routes, "PUT", "/api/v1/prints/poster-a3-1", b"");
    let said: Value = serde_json::from_slice(&said).unwrap();
    assert_eq!((status, &said["file"], &said["size_m"]), (200, &"prints/poster-a3-1-picture.png".into(), &json!([0.277, 0.36])), "{said}");
    assert_eq!(respond(&routes, "GET", "/api/v1/prints/poster-a3-1.pdf", b""), (200, b"pdf".to_vec()));
    assert_eq!(respond(&routes, "GET", "/api/v1/prints/poster-a3-1-picture.png", b"").0, 200);
    supervisor.set_program(Some(script(folder.path(), "echo 'stagepose: error: the paper is unknown' >&2; exit 2")));
    assert_eq!(respond(&routes, "PUT", "/api/v1/prints/poster-b9-1", b""), (422, b"the paper is unknown\n".to_vec()));
    assert_eq!(respond(&routes, "PUT", "/api/v1/prints/..%2fposter", b"").0, 400);
}

#[test]
fn a_recording_is_surveyed_and_the_stage_is_taken_over() {
    let folder = tempfile::tempdir().unwrap();
    let supervisor = with_a_recording(folder.path());
    let routes = unpaced(&supervisor);
    let path = "/api/v1/recordings/clip-1/survey";
    assert_eq!(respond(&routes, "GET", path, b"").0, 404);
    assert_eq!(respond(&routes, "POST", &format!("{path}/use"), b"").0, 409);
    for bad in [&b"{"[..], b"[]x", br#"{"lens":1}"#, br#"{"refines_lens":7}"#] {
        assert_eq!(respond(&routes, "POST", path, bad).0, 400, "{}", String::from_utf8_lossy(bad));
    }
    // It writes the config that it got as a made folder has it, and its arguments.
    let own = script(
        folder.path(),
        "shift 1; clip=$1; out=$3; config=$5; result=$7\nmkdir -p \"$out\"\n\
        cp \"$(dirname \"$0\")/backdrop.png\" \"$out/0-backdrop.png\"\n\
        sed 's|image = .*|image = \"0-backdrop.png\"|; s|size_m = .*|size_m = [4.0, 3.01]|' \"$config\" > \"$out/stage.toml\"\n\
        echo \"{\\\"arguments\\\": \\\"$*\\\"}\" > \"$result\"",
    );
    supervisor.set_program(Some(own));
    assert_eq!(ended(&supervisor, &routes, path, br#"{"refines_lens":true}"#), ("done".to_owned(), "done".to_owned()));
    let (status, said) = respond(&routes, "GET", path, b"");
    let said: Value = serde_json::from_slice(&said).unwrap();
    let arguments = said["arguments"].as_str().unwrap();
    assert!(status == 200 && arguments.ends_with("--lens refine") && arguments.contains("recordings/clip-1 --output"), "{arguments}");
    let (status, said) = respond(&routes, "POST", &format!("{path}/use"), b"");
    assert_eq!(status, 200, "{}", String::from_utf8_lossy(&said));
    let config = std::fs::read_to_string(folder.path().join("stage.toml")).unwrap();
    assert!(config.contains("image = \"walks/clip-1-survey/0-backdrop.png\"") && config.contains("[4.0, 3.01]"), "{config}");
    assert!(folder.path().join("former").is_dir(), "the former config is kept");
    assert!(supervisor.take_reload());
}

#[test]
fn a_check_does_not_try_what_the_daemon_has_open() {
    let text = "[camera]\nfov_deg = 60.0\n\n[http]\nlisten = \"127.0.0.1:8090\"\n\n[[output]]\nkind = \"osc\"\n";
    let table: toml::Table = without_receivers(text).parse().unwrap();
    assert_eq!((table.len(), table["camera"]["fov_deg"].as_float()), (1, Some(60.0)));
    assert_eq!(without_receivers("[camera"), "[camera");
}

#[test]
fn a_command_that_fails_says_why_and_leaves_no_former_result() {
    let folder = tempfile::tempdir().unwrap();
    let supervisor = with_a_recording(folder.path());
    let routes = unpaced(&supervisor);
    let path = "/api/v1/recordings/clip-1/check";
    assert_eq!(respond(&routes, "POST", path, b"{}").0, 409, "there is no program");
    // Exit code 1 is a verdict.
    supervisor.set_program(Some(script(folder.path(), "echo '{}' > \"$7\"; exit 1")));
    assert_eq!(ended(&supervisor, &routes, path, b"{}").0, "done");
    assert_eq!(respond(&routes, "GET", path, b"").0, 200);
    supervisor.set_program(Some(script(folder.path(), "echo 'stagepose: error: no frames' >&2; exit 1")));
    assert_eq!(ended(&supervisor, &routes, path, b"{}"), ("failed".to_owned(), "no frames".to_owned()));
    assert_eq!(respond(&routes, "GET", path, b"").0, 404);
    assert_eq!(respond(&routes, "POST", "/api/v1/recordings/clip-2/check", b"{}").0, 404);
    supervisor.set_recording(Some(folder.path().join("recordings/clip-1")));
    assert_eq!(respond(&routes, "POST", path, b"{}").0, 409, "it is being recorded");
}
