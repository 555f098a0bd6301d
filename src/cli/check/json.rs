//! The check's result as JSON, for programs.

use serde_json::json;

use super::Verdict;
use super::clip::FrameCounts;
use crate::diagnose::{Finding, Grade};

/// Returns the document: the verdict in words, whether nothing must be fixed, the findings worst
/// first, the clip's frames, and what the clip says about the shutter.
pub(super) fn text(verdict: &Verdict, findings: &[Finding], frames: Option<&FrameCounts>, shutter: &[String]) -> String {
    let grade = |grade: Grade| match grade {
        Grade::Fault => "fault",
        Grade::Doubt => "doubt",
        Grade::Warning => "warning",
        Grade::Note => "note",
    };
    let findings: Vec<_> = findings.iter().map(|f| json!({"grade": grade(f.grade), "message": f.message})).collect();
    let frames = frames.map(|frames| json!({"all": frames.all, "found": frames.found, "followed": frames.followed, "given": frames.given}));
    let is_good = matches!(verdict, Verdict::Good | Verdict::Warned(_));
    let document = json!({
        "verdict": verdict.words(), "good": is_good, "findings": findings, "frames": frames, "shutter": shutter,
    });
    format!("{document:#}\n")
}
