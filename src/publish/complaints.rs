//! Rate limit for warnings: those that would come with every packet are logged once a minute.

use std::time::{Duration, Instant};

/// Minimum interval between two warnings of one kind (chosen: rare enough not to fill a log).
/// Raised, recurring trouble is logged later.
const PAUSE: Duration = Duration::from_secs(60);

/// One kind of trouble on one output.
#[derive(Debug)]
pub(super) struct Complaints {
    output: String,
    last: Option<Instant>,
    suppressed: u64,
}

impl Complaints {
    pub fn new(output: &str) -> Self {
        Self { output: output.to_owned(), last: None, suppressed: 0 }
    }

    /// Logs the sentence, unless one was logged within the last minute, with the number suppressed
    /// since. Returns whether it was logged.
    pub fn say(&mut self, sentence: impl FnOnce() -> String) -> bool {
        if self.last.is_some_and(|last| last.elapsed() < PAUSE) {
            self.suppressed += 1;
            return false;
        }
        let before = match std::mem::take(&mut self.suppressed) {
            0 => String::new(),
            n => format!(" ({n} more in the last minute)"),
        };
        tracing::warn!("output {}: {}{before}", self.output, sentence());
        self.last = Some(Instant::now());
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn complaints_are_logged_once_a_minute() {
        let mut complaints = Complaints::new("desk");
        let said = (0..1000).filter(|_| complaints.say(|| "unreachable".to_owned())).count();
        assert_eq!((said, complaints.suppressed), (1, 999));
        complaints.last = Instant::now().checked_sub(PAUSE);
        assert!(complaints.say(|| "unreachable".to_owned()) && complaints.suppressed == 0);
    }
}
