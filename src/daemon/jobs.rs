//! Long-running work on request: one job at a time, with progress, cancellable.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::live::{Event, EventLog, Job, JobState};
use crate::contain::contained;

/// Number of jobs whose outcome is kept. Chosen: an evening's. Raised, only memory.
const REMEMBERED: usize = 20;
/// Minimum interval between progress messages. Chosen: a progress bar looks smooth. Raised, the bar
/// jumps.
const PROGRESS_INTERVAL: Duration = Duration::from_millis(500);

/// All jobs of a daemon.
#[derive(Debug, Default)]
pub struct Jobs {
    board: Arc<Mutex<Board>>,
}

#[derive(Debug, Default)]
struct Board {
    last: u64,
    jobs: VecDeque<Job>,
    cancelled: Arc<AtomicBool>,
}

impl Board {
    fn job(&mut self, number: u64) -> Option<&mut Job> {
        self.jobs.iter_mut().find(|job| job.job == number)
    }
}

fn held(board: &Mutex<Board>) -> MutexGuard<'_, Board> {
    board.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A job's means to report its progress.
pub struct Progress {
    job: u64,
    board: Arc<Mutex<Board>>,
    events: Arc<EventLog>,
    cancelled: Arc<AtomicBool>,
    reported_at: Instant,
}

impl Progress {
    /// Reports the share done, 0 to 1; returns false if the job was cancelled and should end.
    pub fn report(&mut self, done: f64) -> bool {
        if self.reported_at.elapsed() >= PROGRESS_INTERVAL {
            self.reported_at = Instant::now();
            let changed = held(&self.board).job(self.job).map(|job| {
                job.done = done;
                job.clone()
            });
            changed.into_iter().for_each(|job| self.events.publish(Event::Job(job)));
        }
        !self.cancelled.load(Ordering::Relaxed)
    }

    fn end(&self, outcome: Result<String, String>) {
        let changed = held(&self.board).job(self.job).map(|job| {
            (job.state, job.text) = match outcome {
                Ok(text) => (JobState::Done, text),
                Err(_) if self.cancelled.load(Ordering::Relaxed) => (JobState::Failed, "it was cancelled".to_owned()),
                Err(reason) => (JobState::Failed, reason),
            };
            if job.state == JobState::Done {
                job.done = 1.0;
            }
            job.clone()
        });
        changed.into_iter().for_each(|job| self.events.publish(Event::Job(job)));
    }
}

impl Jobs {
    /// Starts a job on its own thread and returns its number; `work` returns the result, or why it
    /// failed.
    ///
    /// # Errors
    /// The running job, which is not disturbed; or a failed job, if the system provides no thread.
    pub fn start(
        &self,
        kind: &str,
        text: String,
        events: &Arc<EventLog>,
        work: impl FnOnce(&mut Progress) -> Result<String, String> + Send + 'static,
    ) -> Result<u64, Job> {
        let mut progress = {
            let mut board = held(&self.board);
            if let Some(running) = board.jobs.iter().find(|job| job.state == JobState::Running) {
                return Err(running.clone());
            }
            board.last += 1;
            let number = board.last;
            if board.jobs.len() == REMEMBERED {
                board.jobs.pop_front();
            }
            board.jobs.push_back(Job { job: number, kind: kind.to_owned(), done: 0.0, state: JobState::Running, text });
            board.cancelled = Arc::default();
            let (cancelled, board) = (board.cancelled.clone(), self.board.clone());
            Progress { job: number, board, events: events.clone(), cancelled, reported_at: Instant::now() }
        };
        let number = progress.job;
        let run = move || {
            let outcome = contained(|| work(&mut progress));
            progress.end(outcome.unwrap_or_else(|panic| Err(format!("it failed inside the program ({panic}); please report this"))));
        };
        match std::thread::Builder::new().name("job".to_owned()).spawn(run) {
            Ok(_) => Ok(number),
            Err(error) => {
                let mut board = held(&self.board);
                let failed = board.job(number).map(|job| {
                    (job.state, job.text) = (JobState::Failed, format!("cannot start a thread ({error}); close other programs"));
                    job.clone()
                });
                // It was added to the board above.
                Err(failed.unwrap_or(Job { job: number, kind: kind.to_owned(), done: 0.0, state: JobState::Failed, text: String::new() }))
            }
        }
    }

    /// Returns one of the last jobs.
    pub fn job(&self, number: u64) -> Option<Job> {
        held(&self.board).job(number).cloned()
    }

    /// Asks a job to end; returns false if it is not running.
    pub fn cancel(&self, number: u64) -> bool {
        let mut board = held(&self.board);
        let is_running = board.job(number).is_some_and(|job| job.state == JobState::Running);
        if is_running {
            board.cancelled.store(true, Ordering::Relaxed);
        }
        is_running
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ended(jobs: &Jobs, number: u64) -> Job {
        loop {
            match jobs.job(number).unwrap() {
                Job { state: JobState::Running, .. } => std::thread::yield_now(),
                job => return job,
            }
        }
    }

    #[test]
    fn one_job_runs_at_a_time_and_each_reports_its_end() {
        let (jobs, events) = (Jobs::default(), Arc::new(EventLog::default()));
        let received = events.listen();
        let first = jobs.start("test", "a".to_owned(), &events, |progress| {
            while progress.report(0.5) {}
            Err("it ended".to_owned())
        });
        assert_eq!(first, Ok(1));
        let busy = jobs.start("test", "b".to_owned(), &events, |_| Ok(String::new())).unwrap_err();
        assert_eq!((busy.job, busy.state), (1, JobState::Running));
        assert!(jobs.cancel(1) && !jobs.cancel(2));
        assert_eq!((ended(&jobs, 1).text.as_str(), jobs.cancel(1)), ("it was cancelled", false));
        let good = jobs.start("test", "b".to_owned(), &events, |_| Ok("all of it".to_owned())).unwrap();
        let Job { state, text, done, .. } = ended(&jobs, good);
        assert_eq!((state, text.as_str(), done), (JobState::Done, "all of it", 1.0));
        let bad = jobs.start("test", "c".to_owned(), &events, |_| panic!("no luck")).unwrap();
        let Job { state, text, .. } = ended(&jobs, bad);
        assert!(state == JobState::Failed && text.contains("no luck"), "{text}");
        for _ in 0..REMEMBERED {
            let number = jobs.start("test", String::new(), &events, |_| Ok(String::new())).unwrap();
            ended(&jobs, number);
        }
        assert!(jobs.job(bad).is_none());
        events.close();
        let ends = received.iter().filter(|e| matches!(&e.event, Event::Job(job) if job.state != JobState::Running)).count();
        assert_eq!(ends, 3 + REMEMBERED);
    }
}
