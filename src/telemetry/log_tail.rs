//! The last lines of the log, for who cannot see the terminal.

use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};

/// Lines that are kept. Chosen: an evening's warnings. Raised, only memory.
const KEPT: usize = 1000;
/// Of one line at most this many bytes are kept. A round figure; raised, only memory.
const LONGEST: usize = 1000;

/// A static, because the log is one for the whole program.
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

/// The last lines, oldest first.
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
