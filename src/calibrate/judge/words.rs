//! Sentences about sets of pictures that cannot be calibrated from.

use super::super::board::Board;
use super::super::finder::FoundBoard;
use super::super::other_target::Target;
use super::super::picture::Inspected;
use super::super::solve::{Estimate, MIN_VIEWS};
use crate::geometry::robust_kernel::median;

/// Returns the size of board that most pictures show instead, and in how many. A board at the
/// picture's rim may be larger than it seems, so it only counts if other pictures show that size in
/// full.
fn usual_other_size(pictures: &[Inspected]) -> Option<((u32, u32), usize)> {
    let whole = pictures.iter().filter_map(|p| p.other_size.filter(|(_, cut)| !cut)).map(|(size, _)| size);
    let count = |size: (u32, u32)| pictures.iter().filter(|p| p.other_size.is_some_and(|(other, _)| other == size)).count();
    whole.map(|size| (size, count(size))).max_by_key(|(size, count)| (*count, *size))
}

/// Returns a sentence if more pictures show another board than the requested one, which is then
/// probably something in the background.
pub(crate) fn another_board(pictures: &[Inspected], board: &Board) -> Option<String> {
    let found = pictures.iter().filter(|p| p.board.is_ok()).count();
    let all = pictures.len();
    let ((columns, rows), count) = usual_other_size(pictures).filter(|(_, count)| *count > found && 2 * count >= all)?;
    Some(format!(
        "{found} of {all} pictures show a board of {board} inner corners, but {count} one of {columns}x{rows}; give --board {columns}x{rows}, or \
         leave out the pictures of the other board"
    ))
}

/// Describes the target that most pictures show instead of a chessboard.
fn other_target(pictures: &[Inspected]) -> Option<String> {
    let count = |target: Target| pictures.iter().filter(|p| p.other_target == Some(target)).count();
    let (target, count) = Target::ALL.into_iter().map(|target| (target, count(target))).max_by_key(|(_, count)| *count)?;
    (2 * count > pictures.len())
        .then(|| format!("{count} show {}; print a plain chessboard (`stagepose board`) and take the pictures of that", target.words()))
}

/// Describes the case that no picture shows the board.
pub(crate) fn nothing_found(pictures: &[Inspected], board: &Board) -> String {
    let head = format!("none of the {} pictures shows the whole board of {board} inner corners", pictures.len());
    let unreadable = pictures.iter().filter(|p| p.size.is_none()).count();
    if let Some(target) = other_target(pictures) {
        return format!("{head}: {target}");
    }
    if let Some(((columns, rows), count)) = usual_other_size(pictures) {
        let message = format!("{head}: {count} show one of {columns}x{rows} inner corners");
        // What only a few pictures show may be anything: part of the board, a window, tiles.
        return match 2 * count >= pictures.len() {
            true => format!("{message}; give --board {columns}x{rows}"),
            false => format!("{message}, the others none; count the board's INNER corners, and let all of it be in every picture"),
        };
    }
    let first = pictures.iter().find_map(|p| Some((p, p.board.as_ref().err()?)));
    let seen = first.map_or(String::new(), |(p, why)| format!(" (the first, {}: {why})", p.file.display()));
    if unreadable == pictures.len() {
        let all = if unreadable == 1 { "the only picture cannot".to_owned() } else { format!("none of the {unreadable} pictures can") };
        return format!("{all} be read{seen}; give PNG, JPEG or PGM pictures");
    }
    format!("{head}{seen}; --board counts the corners where four squares meet, and all of them must be in the picture")
}

/// Advises what to do if too few pictures can be used.
pub(crate) fn hint_for_few(pictures: &[Inspected], board: &Board) -> String {
    let same = "take at least 10, with the board tilted to every side and in every part of the picture";
    if let Some(((columns, rows), count)) = usual_other_size(pictures).filter(|(_, count)| 2 * count >= pictures.len()) {
        return format!("{count} show a board of {columns}x{rows} inner corners instead of {board}: check --board, or {same}");
    }
    let first = pictures.iter().find_map(|p| Some((p, p.board.as_ref().err()?)));
    match first {
        Some((picture, why)) => format!("{}: {why}; {same}", picture.file.display()),
        None if pictures.len() < MIN_VIEWS => same.to_owned(),
        None => format!("the others show the same view again; {same}"),
    }
}

/// Describes views that do not determine the lens.
pub(crate) fn one_direction() -> String {
    "the pictures do not determine the camera: they show the board from one direction only; take some with each side of the board in turn 20 to 45 \
     degrees away from the camera"
        .to_owned()
}

/// Advises what to do about pictures of two sizes; continues the previous sentence.
pub(crate) fn hint_for_sizes(pictures: &[Inspected], first: (u32, u32), other: (u32, u32)) -> String {
    if first == (other.1, other.0) {
        return " (some were taken with the camera upright; hold it the same way for all)".to_owned();
    }
    let shown = || pictures.iter().filter(|p| p.board.is_ok());
    let count = shown().filter(|p| p.size == Some(first)).count();
    let (fewer, size) = if 2 * count >= shown().count() { (shown().count() - count, first) } else { (count, other) };
    format!(" ({fewer} of {} are not {} x {}; leave them out)", shown().count(), size.0, size.1)
}

/// Standard deviation of blur, pixels, above which a picture may be called blurred; sharp ones have
/// 0.5 to 1. Raised, shaken pictures go unmentioned …
const BLURRED_PX: f64 = 1.5;
/// … if it is also this many times as blurred as the median picture. Raised, only bad ones are
/// mentioned; lowered, so are those slightly out of focus at the edge of the depth of field.
const BLURRED_TIMES: f64 = 1.8;
/// Blur of the median picture, pixels, above which all are called blurred; for pictures wider than
/// 1920 pixels it scales with the width, since large sensors show the lens's own blur. Chosen, not
/// tuned: over twice that of sharp pictures. Raised, an unfocused lens goes unmentioned.
const ALL_BLURRED_PX: f64 = 2.2;

/// Describes a picture that is more blurred than the others. It is used all the same, since its
/// blur is measured together with its corners.
pub(crate) fn blurred(found: &FoundBoard, blurs: &[f64]) -> Option<String> {
    let median = median(&mut blurs.to_vec())?;
    (found.blur_px > BLURRED_PX.max(BLURRED_TIMES * median)).then(|| {
        format!(
            "blurred (by {:.1} px, the median picture by {median:.1}): hold board and camera still, give more light, or take it again",
            found.blur_px
        )
    })
}

/// Describes a set of blurred pictures.
pub(crate) fn all_blurred(blurs: &[f64], (width, height): (u32, u32)) -> Option<String> {
    let median = median(&mut blurs.to_vec())?;
    let limit = ALL_BLURRED_PX * (f64::from(width.max(height)) / 1920.0).max(1.0);
    (median > limit).then(|| {
        format!(
            "most pictures are blurred (by {median:.1} px): focus the lens at the distance of the stage and lock it, then take them again"
        )
    })
}

/// Plausible distances of boards from the camera, metres: nearer, no lens is sharp; farther, no
/// board is large enough. Outside of them the size of the squares is questioned. Wider, squares in
/// centimetres go unnoticed; narrower, large halls cause a false remark.
const PLAUSIBLE_M: [f64; 2] = [0.08, 30.0];

/// Describes a size of squares that puts the boards at implausible distances. The lens does not
/// depend on it; the distances do.
pub(crate) fn implausible_squares(estimate: &Estimate, board: &Board) -> Option<String> {
    let mut distances: Vec<f64> = estimate.bundle.poses.iter().map(|pose| pose.translation.norm()).collect();
    let metres = median(&mut distances)?;
    let square_mm = 1e3 * board.square_m();
    let away = |metres: f64| if metres < 1.0 { format!("{:.1} cm", 100.0 * metres) } else { format!("{metres:.0} m") };
    let times = if metres < PLAUSIBLE_M[0] { 10.0 } else { 0.1 };
    let is_plausible = (PLAUSIBLE_M[0]..=PLAUSIBLE_M[1]).contains(&metres);
    (!is_plausible).then(|| {
        format!(
            "with squares of {} mm the boards were {} from the camera, which is implausible: --square-mm is in millimetres (perhaps {}); \
             the lens comes out the same",
            rounded(square_mm),
            away(metres),
            rounded(times * square_mm)
        )
    })
}

/// Removes rounding noise from a number.
pub(crate) fn rounded(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::origin::Origin;

    fn picture(board: Result<FoundBoard, String>, other_size: Option<((u32, u32), bool)>) -> Inspected {
        Inspected {
            file: "a.png".into(),
            size: Some((640, 480)),
            board,
            other_size,
            other_target: None,
            patch: None,
            thumbnail: None,
            origin: Origin::default(),
        }
    }

    fn another(size: (u32, u32), cut: bool) -> Inspected {
        picture(Err("another board".to_owned()), Some((size, cut)))
    }

    fn found() -> Inspected {
        let (corners, light) = (Vec::new(), Vec::new());
        picture(Ok(FoundBoard { corners, blur_px: 0.5, contrast: 80.0, light, margin: 1.0, dark_origin: true, square_px: 30.0 }), None)
    }

    #[test]
    fn a_background_board_is_not_mistaken_for_the_requested_one() {
        let board = Board::new(8, 6, 0.025).unwrap();
        let pictures = [found(), another((9, 6), false), another((9, 6), true), another((7, 5), true)];
        let sentence = another_board(&pictures, &board).unwrap();
        assert!(sentence.contains("1 of 4 pictures") && sentence.contains("2 one of 9x6; give --board 9x6"), "{sentence}");
        // Equal counts may mean two boards, and boards at the rim alone do not determine a size.
        assert_eq!(another_board(&[found(), another((9, 6), false)], &board), None);
        assert_eq!(another_board(&[found(), another((9, 6), true), another((9, 6), true)], &board), None);
    }

    #[test]
    fn a_board_size_is_advised_if_most_pictures_show_it() {
        let board = Board::new(9, 6, 0.025).unwrap();
        let none = || picture(Err("no board".to_owned()), None);
        let said = nothing_found(&[another((8, 5), false), another((8, 5), false), none()], &board);
        assert!(said.ends_with("2 show one of 8x5 inner corners; give --board 8x5"), "{said}");
        let said = nothing_found(&[another((3, 3), false), none(), none()], &board);
        assert!(said.contains("1 show one of 3x3 inner corners, the others none") && !said.contains("--board 3x3"), "{said}");
    }

    #[test]
    fn boards_of_other_kinds_are_named() {
        let board = Board::new(9, 6, 0.025).unwrap();
        let of = |target| Inspected { other_target: Some(target), ..picture(Err("no board".to_owned()), None) };
        let said = nothing_found(&[of(Target::Circles), of(Target::Circles), of(Target::Markers)], &board);
        assert!(said.contains("2 show a grid of circles") && said.contains("stagepose board"), "{said}");
    }

    #[test]
    fn blurred_pictures_are_named_where_others_are_sharp() {
        let mut one = found().board.unwrap();
        one.blur_px = 2.4;
        assert!(blurred(&one, &[0.6, 0.7, 2.4]).unwrap().contains("by 2.4 px, the median picture by 0.7"));
        assert_eq!(blurred(&one, &[2.2, 2.4, 2.4]), None);
        one.blur_px = 1.2;
        assert_eq!(blurred(&one, &[0.4, 0.4, 1.2]), None);
        assert!(all_blurred(&[2.6, 2.4, 2.9], (640, 480)).unwrap().contains("focus the lens"));
        assert_eq!(all_blurred(&[2.6, 2.4, 2.9], (4000, 3000)), None);
    }

    #[test]
    fn pictures_of_two_sizes_get_a_fix_hint() {
        let of = |size| Inspected { size: Some(size), ..found() };
        let pictures = [of((640, 480)), of((640, 480)), of((320, 240))];
        assert!(hint_for_sizes(&pictures, (640, 480), (320, 240)).contains("1 of 3 are not 640 x 480"));
        let pictures = [of((640, 480)), of((320, 240)), of((320, 240))];
        assert!(hint_for_sizes(&pictures, (640, 480), (320, 240)).contains("1 of 3 are not 320 x 240"));
        assert!(hint_for_sizes(&pictures, (640, 480), (480, 640)).contains("upright"));
    }

    #[test]
    fn the_repeated_view_hint_needs_three_pictures() {
        let board = Board::new(8, 6, 0.025).unwrap();
        assert!(!hint_for_few(&[found(), found()], &board).contains("the same view"));
        assert!(hint_for_few(&[found(), found(), found()], &board).contains("the same view again"));
    }
}
