//! The last lines of the log, for those who cannot see the terminal.

use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};

/// Number of lines kept. Chosen: an evening's warnings. Raised, only memory.
const KEPT: usize = 1000;
/// Maximum bytes kept of one line. A round figure. Raised, only memory.
const LONGEST: usize = 1000;

/// The kept lines. It is static because the whole program has one log.
static TAIL: Mutex<VecDeque<String>> = Mutex::new(VecDeque::new());

/// Keeps a line as it was written, with its line end.
pub fn keep_log_line(line: &str) {
    let mut tail = TAIL.lock().unwrap_or_else(PoisonError::into_inner);
    if tail.len() == KEPT {
        tail.pop_front();
    }
    let end = (0..=LONGEST.min(line.len())).rev().find(|end| line.is_char_boundary(*end)).unwrap_or(0);
    tail.push_back(format!("{}\n", line[..end].trim_end()));
}

/// Returns the last lines, oldest first.
pub fn log_tail(lines: usize) -> Vec<String> {
    let tail = TAIL.lock().unwrap_or_else(PoisonError::into_inner);
    tail.iter().skip(tail.len().saturating_sub(lines)).cloned().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_lines_are_kept() {
        (0..KEPT + 5).for_each(|k| keep_log_line(&format!("line {k} of this test\n")));
        keep_log_line(&"ä".repeat(LONGEST));
        let last = log_tail(2);
        assert_eq!(last[0], format!("line {} of this test\n", KEPT + 4));
        assert!(last[1].len() <= LONGEST + 1 && log_tail(usize::MAX).len() <= KEPT);
    }
}
