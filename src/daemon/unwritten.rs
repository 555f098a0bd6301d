//! Describes why something could not be written: the system's error, and a fix for its cause.

use std::io::{self, ErrorKind};

/// Returns the error with its fix, for a recording.
pub fn unwritten(error: &io::Error) -> String {
    let hint = match error.kind() {
        ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem => {
            "let this program's user write there, or set `folder` in [recorder] to a folder that it may write"
        }
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded | ErrorKind::FileTooLarge | ErrorKind::WriteZero => "make room on the disk",
        _ => "check that folder and its disk",
    };
    format!("{error}; {hint}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hint_matches_the_cause_of_a_write_error() {
        let explained = |kind: ErrorKind| unwritten(&io::Error::new(kind, "/etc/stagepose/recordings: it failed"));
        assert!(explained(ErrorKind::StorageFull).ends_with("it failed; make room on the disk"));
        for kind in [ErrorKind::PermissionDenied, ErrorKind::ReadOnlyFilesystem] {
            assert!(explained(kind).contains("user write there") && !explained(kind).contains("make room"), "{}", explained(kind));
        }
        assert!(!explained(ErrorKind::NotFound).contains("make room"));
    }
}
