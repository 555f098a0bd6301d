//! Detects pictures of two cameras, or of two focal lengths, in one set.
//!
//! A calibration is valid for one camera at one zoom. Mixing two is the mistake that the corners
//! themselves hide best: each set fits itself, and both together fit neither.

use super::super::origin::Origin;
use super::super::picture::Inspected;

/// Maximum relative difference between focal lengths that count as the same: files round them to
/// about a percent. Raised, a small change of zoom goes unnoticed; lowered, rounding is taken for
/// two zooms, and the set is refused.
const SAME_FOCAL: f64 = 0.02;

/// Returns a sentence if the pictures that show the board come from two cameras, or were taken at
/// two focal lengths.
pub(crate) fn mixed(pictures: &[Inspected]) -> Option<String> {
    let shown: Vec<&Inspected> = pictures.iter().filter(|p| p.board.is_ok()).collect();
    let by_camera = parted(&shown, |origin| origin.camera.clone(), |a, b| a == b);
    if let Some((usual, other, count, first)) = by_camera {
        return Some(format!(
            "pictures of two cameras are mixed: most are of {usual}, {count} of {other} (the first: {first}); a calibration is of one camera, so leave \
             out the others"
        ));
    }
    let by_focal = parted(&shown, |origin| origin.focal_mm, |a, b| (a / b - 1.0).abs() < SAME_FOCAL);
    by_focal.map(|(usual, other, count, first)| {
        format!(
            "the zoom was changed between pictures: most were taken at {usual} mm, {count} at {other} mm (the first: {first}); a calibration is of one \
             focal length, so leave out the others and lock the zoom (on a phone: stay with one of its lenses)"
        )
    })
}

/// Returns the most frequent value, the first value that differs, the number of pictures that
/// differ, and the name of the first of those.
fn parted<T: Clone>(
    pictures: &[&Inspected],
    said: impl Fn(&Origin) -> Option<T>,
    is_same: impl Fn(&T, &T) -> bool,
) -> Option<(T, T, usize, String)> {
    let all: Vec<(T, &Inspected)> = pictures.iter().filter_map(|p| Some((said(&p.origin)?, *p))).collect();
    let count = |value: &T| all.iter().filter(|(other, _)| is_same(other, value)).count();
    // Of equals, the earliest wins.
    let usual = all.iter().rev().map(|(value, _)| value).max_by_key(|value| count(value))?;
    let mut others = all.iter().filter(|(value, _)| !is_same(value, usual));
    let (other, first) = others.next()?;
    Some((usual.clone(), other.clone(), 1 + others.count(), first.file.display().to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::finder::FoundBoard;

    fn picture(file: &str, camera: Option<&str>, focal_mm: Option<f64>) -> Inspected {
        let board = FoundBoard {
            corners: Vec::new(),
            light: Vec::new(),
            blur_px: 0.5,
            contrast: 80.0,
            margin: 1.0,
            dark_origin: true,
            square_px: 30.0,
        };
        let origin = Origin { camera: camera.map(str::to_owned), focal_mm };
        Inspected {
            file: file.into(),
            size: Some((640, 480)),
            board: Ok(board),
            other_size: None,
            other_target: None,
            patch: None,
            thumbnail: None,
            origin,
        }
    }

    #[test]
    fn two_cameras_and_two_zooms_are_named() {
        let (a, b) = (picture("a.jpg", Some("Canon EOS R6"), Some(24.0)), picture("b.jpg", Some("Canon EOS R6"), Some(24.2)));
        let unsaid = picture("u.png", None, None);
        assert_eq!(mixed(&[a.clone(), b.clone(), unsaid.clone()]), None);
        let phone = picture("p.jpg", Some("Pixel 7"), Some(6.8));
        let said = mixed(&[phone.clone(), a.clone(), b.clone(), unsaid]).unwrap();
        assert!(said.contains("most are of Canon EOS R6, 1 of Pixel 7 (the first: p.jpg)"), "{said}");
        let said = mixed(&[a.clone(), b.clone(), picture("c.jpg", Some("Canon EOS R6"), Some(35.0))]).unwrap();
        assert!(said.contains("at 24 mm, 1 at 35 mm (the first: c.jpg)"), "{said}");
        // A picture without the board does not count, whichever camera took it.
        assert_eq!(mixed(&[a, Inspected { board: Err("no board".to_owned()), ..phone }]), None);
    }
}
