//! The comparison as text for the terminal.

use std::fmt::Write as _;

use super::CompareArguments;
use super::pictures::NamedPicture;
use crate::compare::{Comparison, Model, Relation};

/// Describes what was compared, what relates it, and what that means.
pub(super) fn text(made: &Comparison, a: &NamedPicture, b: &NamedPicture, arguments: &CompareArguments) -> String {
    let mut text = String::new();
    let size = |picture: &NamedPicture| format!("{} x {}", picture.picture.width(), picture.picture.height());
    // Writing to a String cannot fail.
    let _ = writeln!(text, "A  {} ({}), {} keypoints", arguments.a.display(), size(a), made.features[0].keypoints.len());
    let _ = writeln!(text, "B  {} ({}), {} keypoints", arguments.b.display(), size(b), made.features[1].keypoints.len());
    let _ = writeln!(text, "{} matches ({}, {})", made.matches.len(), made.settings.detector.name(), made.settings.descriptor.name());
    for note in [a, b].iter().filter_map(|picture| picture.note.as_ref()) {
        let _ = writeln!(text, "note: {note}");
    }
    let models = [
        (Model::Homography, "homography", &made.homography),
        (Model::Fundamental, "fundamental matrix", &made.fundamental),
        (Model::Essential, "essential matrix", &made.essential),
    ];
    if made.model.is_some() {
        let _ = writeln!(text, "\n{:<20}{:>14}{:>14}", "model", "agree", "sigma px");
    }
    for (model, name, relation) in models {
        if let Some(Relation { inliers, sigma_px, .. }) = relation {
            let mark = if made.model == Some(model) { "  explains the pictures best" } else { "" };
            let _ = writeln!(text, "{name:<20}{:>14}{sigma_px:>14.2}{mark}", inliers.len());
        }
    }
    if let Some(t) = made.translation_m() {
        let _ = writeln!(text, "\nmove in metres, axes of B's camera: {:.4} {:.4} {:.4}", t.x, t.y, t.z);
    }
    let _ = writeln!(text, "\n{}", made.sentence());
    made.remarks().iter().for_each(|remark| {
        let _ = writeln!(text, "{remark}");
    });
    text
}
