//! Sentences for sets of pictures that make no calibration.

use super::super::board::Board;
use super::super::session::Inspected;

/// The size of board that most pictures show instead, and in how many.
fn usual_other_size(pictures: &[Inspected]) -> Option<((u32, u32), usize)> {
    let sizes: Vec<(u32, u32)> = pictures.iter().filter_map(|p| p.other_size).collect();
    let count = |size: &(u32, u32)| sizes.iter().filter(|s| *s == size).count();
    let most = sizes.iter().max_by_key(|size| (count(size), **size))?;
    Some((*most, count(most)))
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
        return format!("none of the {} pictures can be read{seen}; give PNG, JPEG or PGM pictures", pictures.len());
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
        None => format!("the others show the same view again; {same}"),
    }
}

/// The views do not tell the lens.
pub(crate) fn one_direction() -> String {
    "the pictures do not determine the camera: they show the board from one direction only; take some with each side of the board in turn 20 to 45 \
     degrees away from the camera"
        .to_owned()
}
