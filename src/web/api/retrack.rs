//! `POST /api/v1/recordings/ID/retrack` and its results below `retracked`; `GET`,
//! `DELETE /api/v1/jobs/N`: recordings tracked again with the current config.

use std::path::Path;
use std::sync::Arc;

use axum::http::Method;
use serde_json::{Value, json};

use super::failed;
use super::line_index::LineIndex;
use super::recordings::{Folder, MAX_POINTS};
use super::timeline::timeline;
use crate::daemon::{Supervisor, retrack, stand_back};
use crate::safe_file;
use crate::web::call::Call;
use crate::web::reply::Reply;
use crate::web::routes::{Access, Route};

/// Maximum size of a comparison's text, bytes.
const LARGEST: u64 = 1 << 20;

pub(super) fn routes(supervisor: &Arc<Supervisor>, lines: &Arc<LineIndex>) -> Vec<Route> {
    let of = |supervisor: &Arc<Supervisor>| supervisor.clone();
    let (for_start, for_job, for_cancel) = (of(supervisor), of(supervisor), of(supervisor));
    let to_start = Folder::new(supervisor, lines);
    let read = |path, answer: fn(&Folder, &Path, &mut Call) -> Result<Reply, Reply>| {
        let folder = Folder::new(supervisor, lines);
        Route::slow(Method::GET, path, Access::Anyone, move |call| {
            let clip = folder.clip(call)?.path;
            if !clip.join("retracked/compared.json").is_file() {
                return Err(Reply::text(404, "this recording has not been tracked again yet; POST to its retrack\n"));
            }
            answer(&folder, &clip, call)
        })
    };
    let none = || Reply::text(404, "there is no such job; only the last ones are remembered\n");
    vec![
        Route::slow(Method::POST, "/api/v1/recordings/{id}/retrack", Access::Change, move |call| start(&for_start, &to_start, call)),
        read("/api/v1/recordings/{id}/retracked", retracked),
        read("/api/v1/recordings/{id}/retracked/poses", |folder, clip, call| folder.records(clip, "retracked/poses.jsonl", call)),
        read("/api/v1/recordings/{id}/retracked/differences", |folder, clip, call| {
            folder.records(clip, "retracked/differences.jsonl", call)
        }),
        Route::slow(Method::GET, "/api/v1/jobs/{number}", Access::Anyone, move |call| {
            let job = for_job.jobs.job(call.number("number")?).ok_or_else(none)?;
            Ok(Reply::json(200, json!(job).to_string()))
        }),
        Route::slow(Method::DELETE, "/api/v1/jobs/{number}", Access::Change, move |call| {
            let number = call.number("number")?;
            match for_cancel.jobs.cancel(number) {
                true => Ok(Reply::text(202, "the job ends\n")),
                false if for_cancel.jobs.job(number).is_some() => Err(Reply::text(409, "this job is over already\n")),
                false => Err(none()),
            }
        }),
    ]
}

fn start(supervisor: &Arc<Supervisor>, folder: &Folder, call: &Call) -> Result<Reply, Reply> {
    let clip = folder.clip(call)?;
    let settings = supervisor.settings().ok_or_else(|| Reply::text(409, "there is no good config to track with; put one first\n"))?;
    if supervisor.recording().as_deref() == Some(clip.path.as_path()) {
        return Err(Reply::text(409, "this is being recorded; end the recording first\n"));
    }
    let (path, id) = (clip.path, clip.id);
    let work = move |progress: &mut _| {
        stand_back();
        retrack(&path, &settings, progress)
    };
    match supervisor.jobs.start("retrack", id, &supervisor.link.events, work) {
        Ok(number) => Ok(Reply::json(202, json!({"job": number}).to_string())),
        Err(job) => {
            let sentence =
                format!("job {} ({}) is under way; wait for it, or end it by DELETE /api/v1/jobs/{}\n", job.job, job.text, job.job);
            Err(Reply::text(409, sentence))
        }
    }
}

/// Returns the timeline of the new records, and how they compare with the recorded ones.
fn retracked(_: &Folder, clip: &Path, call: &mut Call) -> Result<Reply, Reply> {
    let points = call.queried("points", 1000, 1..=MAX_POINTS)?;
    let new_timeline = timeline(clip, "retracked/poses.jsonl", points as usize);
    let mut new_timeline = new_timeline.map_err(|e| failed("what was tracked again cannot be read", &e))?;
    let compared = safe_file::read_below(clip, Path::new("retracked/compared.json"), LARGEST);
    new_timeline["compared"] = compared.ok().and_then(|bytes| serde_json::from_slice::<Value>(&bytes).ok()).unwrap_or(Value::Null);
    Ok(Reply::json(200, new_timeline.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::web::api::tests::{respond, supervised};

    #[test]
    fn retracking_a_recording_reproduces_it() {
        let folder = tempfile::tempdir().unwrap();
        let supervisor = supervised(folder.path());
        let clip = folder.path().join("recordings/clip-1");
        std::fs::create_dir_all(clip.join("frames")).unwrap();
        let picture = image::GrayImage::from_fn(160, 120, |x, y| image::Luma([((x * 37 + y * 91) % 251) as u8]));
        let mut stamps = "#timestamp [ns],filename\n".to_owned();
        for k in 0..5 {
            picture.save(clip.join(format!("frames/{k}.png"))).unwrap();
            stamps += &format!("{},{k}.png\n", 33_000_000 * k);
        }
        std::fs::write(clip.join("timestamps.csv"), stamps).unwrap();
        std::fs::write(clip.join("poses.jsonl"), "").unwrap();
        let ask = |method: &str, path: &str| {
            let (status, content) = respond(&routes(&supervisor, &Arc::default()), method, path, b"");
            (status, String::from_utf8(content).unwrap())
        };
        let again = || {
            assert_eq!(ask("GET", "/api/v1/jobs/77").0, 404);
            let (status, said) = ask("POST", "/api/v1/recordings/clip-1/retrack");
            assert_eq!(status, 202, "{said}");
            let number = serde_json::from_str::<Value>(&said).unwrap()["job"].as_u64().unwrap();
            loop {
                let (_, said) = ask("GET", &format!("/api/v1/jobs/{number}"));
                let job: Value = serde_json::from_str(&said).unwrap();
                if job["state"] != "running" {
                    assert_eq!((&job["state"], &job["kind"]), (&"done".into(), &"retrack".into()), "{job}");
                    break;
                }
            }
            std::fs::read(clip.join("retracked/poses.jsonl")).unwrap()
        };
        assert_eq!(ask("GET", "/api/v1/recordings/clip-1/retracked").0, 404);
        let first = again();
        assert_eq!(first.iter().filter(|byte| **byte == b'\n').count(), 5);
        // Replace the recorded file by the result: now both are the same.
        std::fs::write(clip.join("poses.jsonl"), &first).unwrap();
        assert_eq!(again(), first);
        let (status, timeline) = ask("GET", "/api/v1/recordings/clip-1/retracked?points=10");
        let timeline: Value = serde_json::from_str(&timeline).unwrap();
        assert_eq!((status, &timeline["frames"], &timeline["compared"]["same_record"]), (200, &5.into(), &5.into()), "{timeline}");
        assert_eq!(ask("GET", "/api/v1/recordings/clip-1/retracked/differences?from=4").1.lines().count(), 1);
        assert_eq!(ask("DELETE", "/api/v1/jobs/1").0, 409);
        assert!(!clip.join(".retracked").exists());
        supervisor.set_recording(Some(clip.clone()));
        assert_eq!(ask("POST", "/api/v1/recordings/clip-1/retrack").0, 409);
        supervisor.use_settings(None);
        assert_eq!(ask("POST", "/api/v1/recordings/clip-1/retrack").0, 409);
    }
}
