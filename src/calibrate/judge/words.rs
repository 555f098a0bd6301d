//! Sentences for sets of pictures that make no calibration.

use super::super::board::Board;
use super::super::session::Inspected;
use super::super::solve::LEAST_VIEWS;

/// The size of board that most pictures show instead, and in how many. A board at the picture's rim may be larger than it
/// seems, so it only counts where others show that size in full.
fn usual_other_size(pictures: &[Inspected]) -> Option<((u32, u32), usize)> {
    let whole = pictures.iter().filter_map(|p| p.other_size.filter(|(_, cut)| !cut)).map(|(size, _)| size);
    let count = |size: (u32, u32)| pictures.iter().filter(|p| p.other_size.is_some_and(|(other, _)| other == size)).count();
    whole.map(|size| (size, count(size))).max_by_key(|(size, count)| (*count, *size))
}

/// Where more pictures show another board than the one that was asked for, which will be something in the background.
pub(crate) fn another_board(pictures: &[Inspected], board: &Board) -> Option<String> {
    let found = pictures.iter().filter(|p| p.board.is_ok()).count();
    let ((columns, rows), count) = usual_other_size(pictures).filter(|(_, count)| *count > found)?;
    let all = pictures.len();
    Some(format!(
        "{found} of {all} pictures show a board of {board} inner corners, but {count} one of {columns}x{rows}; give --board {columns}x{rows}, or \
         leave out the pictures of the other board"
    ))
}

/// No picture shows the board.
pub(crate) fn nothing_found(pictures: &[Inspected], board: &Board) -> String {
    let head = format!("none of the {} pictures shows the whole board of {board} inner corners", pictures.len());
    let unreadable = pictures.iter().filter(|p| p.size.is_none()).count();
    if let Some(((columns, rows), count)) = usual_other_size(pictures) {
        return format!("{head}: {count} show one of {columns}x{rows} inner corners; give --board {columns}x{rows}");
    }
    let first = pictures.iter().find_map(|p| Some((p, p.board.as_ref().err()?)));
    let seen = first.map_or(String::new(), |(p, why)| format!(" (the first, {}: {why})", p.file.display()));
    if unreadable == pictures.len() {
        let all = if unreadable == 1 { "the only picture cannot".to_owned() } else { format!("none of the {unreadable} pictures can") };
        return format!("{all} be read{seen}; give PNG, JPEG or PGM pictures");
    }
    format!("{head}{seen}; --board counts the corners where four squares meet, and all of them must be in the picture")
}

/// What to do where too few pictures can be used.
pub(crate) fn mend_for_few(pictures: &[Inspected], board: &Board) -> String {
    let same = "take at least 10, with the board tilted to every side and in every part of the picture";
    if let Some(((columns, rows), count)) = usual_other_size(pictures) {
        return format!("{count} show a board of {columns}x{rows} inner corners instead of {board}: check --board, or {same}");
    }
    let first = pictures.iter().find_map(|p| Some((p, p.board.as_ref().err()?)));
    match first {
        Some((picture, why)) => format!("{}: {why}; {same}", picture.file.display()),
        None if pictures.len() < LEAST_VIEWS => same.to_owned(),
        None => format!("the others show the same view again; {same}"),
    }
}

/// The views do not tell the lens.
pub(crate) fn one_direction() -> String {
    "the pictures do not determine the camera: they show the board from one direction only; take some with each side of the board in turn 20 to 45 \
     degrees away from the camera"
        .to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::finder::FoundBoard;

    fn picture(board: Result<FoundBoard, String>, other_size: Option<((u32, u32), bool)>) -> Inspected {
        Inspected { file: "a.png".into(), size: Some((640, 480)), board, other_size, patch: None, thumbnail: None }
    }

    fn another(size: (u32, u32), cut: bool) -> Inspected {
        picture(Err("another board".to_owned()), Some((size, cut)))
    }

    fn found() -> Inspected {
        let (corners, light) = (Vec::new(), Vec::new());
        picture(Ok(FoundBoard { corners, blur_px: 0.5, contrast: 80.0, light, margin: 1.0, dark_origin: true, square_px: 30.0 }), None)
    }

    #[test]
    fn a_board_in_the_background_is_told_from_the_one_asked_for() {
        let board = Board::new(8, 6, 0.025).unwrap();
        let pictures = [found(), another((9, 6), false), another((9, 6), true), another((7, 5), true)];
        let sentence = another_board(&pictures, &board).unwrap();
        assert!(sentence.contains("1 of 4 pictures") && sentence.contains("2 one of 9x6; give --board 9x6"), "{sentence}");
        // As many of each may be two boards, and boards at the rim alone tell no size.
        assert_eq!(another_board(&[found(), another((9, 6), false)], &board), None);
        assert_eq!(another_board(&[found(), another((9, 6), true), another((9, 6), true)], &board), None);
    }

    #[test]
    fn pictures_that_are_too_few_repeat_nothing() {
        let board = Board::new(8, 6, 0.025).unwrap();
        assert!(!mend_for_few(&[found(), found()], &board).contains("the same view"));
        assert!(mend_for_few(&[found(), found(), found()], &board).contains("the same view again"));
    }
}
