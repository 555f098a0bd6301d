//! The program's own commands at the page's request: each in a process of its own, so that whatever
//! it reads, and however much it takes, the daemon tracks on.
//!
//! A command says how far it is as lines `stagepose: 42 %, …` on its standard error; the job has
//! that as its progress. A cancelled job kills its command.

use std::ffi::OsString;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use super::jobs::Progress;

/// The variable with the seconds between two lines of progress off a terminal.
pub const PROGRESS_EVERY: &str = "STAGEPOSE_PROGRESS_S";
/// Its value for jobs: as often as a page shows it.
const OFTEN: &str = "0.5";
/// Interval of looks at the process. Raised, it is cancelled later.
const LOOKS_EVERY: Duration = Duration::from_millis(50);
/// Maximum bytes of output that are kept. A round figure above any report. Raised, more memory.
const MAX_OUTPUT: u64 = 1 << 20;
/// Maximum length of a line on standard error, bytes; longer ones are cut. Raised, more memory.
const MAX_LINE: u64 = 4096;
/// Share of a job's progress that belongs to its last steps, which do not say how far they are.
const LAST_STEPS: f64 = 0.1;

/// How a command ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Ended {
    /// Exit code; `None` if it was killed.
    pub code: Option<i32>,
    /// What it printed.
    pub output: String,
    /// The last line on its standard error that is no progress, without the program's name.
    pub said: String,
}

/// Runs the program with these arguments, at the calling thread's priority; `progress` is asked
/// whether to go on.
///
/// # Errors
/// If the program cannot be started or watched.
pub fn run_own(program: &Path, arguments: &[OsString], mut progress: Option<&mut Progress>) -> std::io::Result<Ended> {
    let mut command = Command::new(program);
    command.args(arguments).env(PROGRESS_EVERY, OFTEN);
    let mut child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn()?;
    let (output, errors) = (child.stdout.take(), child.stderr.take());
    let percent = AtomicU32::new(0);
    std::thread::scope(|threads| {
        let output = threads.spawn(|| output.map_or_else(String::new, text_of));
        let said = threads.spawn(|| errors.map_or_else(String::new, |errors| followed(errors, &percent)));
        let status = loop {
            if let Some(status) = child.try_wait()? {
                break status;
            }
            let done = (1.0 - LAST_STEPS) * f64::from(percent.load(Ordering::Relaxed)) / 100.0;
            if progress.as_deref_mut().is_some_and(|progress| !progress.report(done)) {
                // It may have ended by itself just now.
                let _ = child.kill();
            }
            std::thread::sleep(LOOKS_EVERY);
        };
        let [output, said] = [output, said].map(|thread| thread.join().unwrap_or_default());
        Ok(Ended { code: status.code(), output, said })
    })
}

/// Returns the first [`MAX_OUTPUT`] bytes as text, and reads the rest, so that the writer goes on.
fn text_of(mut from: impl Read) -> String {
    let mut bytes = Vec::new();
    // What cannot be read any more is not part of the text.
    let _ = (&mut from).take(MAX_OUTPUT).read_to_end(&mut bytes);
    let _ = std::io::copy(&mut from, &mut std::io::sink());
    String::from_utf8_lossy(&bytes).into_owned()
}

/// Follows the lines on standard error until they end: keeps the progress, and returns the last
/// other line.
fn followed(errors: impl Read, percent: &AtomicU32) -> String {
    let (mut lines, mut last) = (BufReader::new(errors), String::new());
    loop {
        let mut line = Vec::new();
        if !matches!((&mut lines).take(MAX_LINE).read_until(b'\n', &mut line), Ok(read) if read > 0) {
            return last;
        }
        let line = String::from_utf8_lossy(&line);
        let line = line.trim().trim_start_matches("stagepose: ");
        match percent_of(line) {
            Some(done) => percent.store(done, Ordering::Relaxed),
            None if !line.is_empty() => last = line.trim_start_matches("error: ").to_owned(),
            None => {}
        }
    }
}

/// Returns the percentage of a line of progress, such as `42 %, 12 of 30 frames`.
fn percent_of(line: &str) -> Option<u32> {
    let (number, _) = line.split_once(" %")?;
    number.parse().ok().filter(|done| *done <= 100)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::daemon::jobs::Jobs;
    use crate::daemon::live::{EventLog, JobState};

    fn shell(text: &str) -> Vec<OsString> {
        vec!["-c".into(), text.into()]
    }

    #[test]
    fn output_progress_and_the_last_word_are_kept_apart() {
        let percent = AtomicU32::new(0);
        let said = followed(&b"stagepose: 7 %, 3 of 40 frames\nstagepose: error: no stage\nstagepose: 55 %\n\n"[..], &percent);
        assert_eq!((said.as_str(), percent.into_inner()), ("no stage", 55));
        for (line, percent) in [("100 %", Some(100)), ("101 %", None), ("the stage is 4 % off", None), ("%", None), ("-1 %", None)] {
            assert_eq!(percent_of(line), percent, "{line}");
        }
        let ended = run_own(Path::new("/bin/sh"), &shell("echo found; echo 'stagepose: error: why' >&2; exit 3"), None).unwrap();
        assert_eq!(ended, Ended { code: Some(3), output: "found\n".to_owned(), said: "why".to_owned() });
        // A command that prints without end does not fill the memory, nor wait for a reader.
        let ended = run_own(Path::new("/bin/sh"), &shell("head -c 3000000 /dev/zero"), None).unwrap();
        assert_eq!((ended.code, ended.output.len() as u64), (Some(0), MAX_OUTPUT));
        assert!(run_own(Path::new("/no/such/program"), &[], None).is_err());
    }

    #[test]
    fn a_cancelled_job_kills_its_command() {
        let (jobs, events) = (Jobs::default(), Arc::new(EventLog::default()));
        let number = jobs.start("test", String::new(), &events, |progress| {
            let ended = run_own(Path::new("/bin/sh"), &shell("exec sleep 600"), Some(progress)).map_err(|e| e.to_string())?;
            Err(format!("{:?}", ended.code))
        });
        let number = number.unwrap();
        assert!(jobs.cancel(number));
        let job = loop {
            match jobs.job(number).unwrap() {
                job if job.state == JobState::Running => std::thread::yield_now(),
                job => break job,
            }
        };
        assert_eq!(job.text, "it was cancelled");
    }
}
