//! The poster on its page: the picture as large as the paper allows; below it a ruler, the size in
//! words, and the config snippet.

use super::page::{Item, Page, RULER_MM, Style, fitting_size, ruler};
use super::paper::{MARGIN_MM, Paper};

/// Pixels of the picture's shorter side. Its finest marks are 1/500 of that side, so about three
/// pixels. Raised, the file is only larger; lowered, those marks are lost.
const SHORTER_SIDE_PX: f64 = 1700.0;
/// White between the picture and the ruler, millimetres. Raised, the picture is smaller.
const GAP_MM: f64 = 4.0;
/// Height of a line of text, millimetres: the largest type and a third more. Raised, the picture is
/// smaller.
const LINE_MM: f64 = 4.0;
/// Maximum type size, millimetres: readable at arm's length. Longer lines are set smaller. Raised,
/// it needs a larger [`LINE_MM`].
const TYPE_MM: f64 = 3.0;
/// Number of lines below the ruler: two of text, three of the config's snippet. The picture leaves
/// room for them.
const LINES: usize = 5;
/// Width of a letter, ems: above the mean for sans serif, exact for typewriter (Courier). Raised,
/// type is smaller; lowered, lines may run beyond the margin.
const LETTER_EM: [f64; 2] = [0.55, 0.6];

/// Returns the size of the printed picture on a paper, in whole millimetres, which can be checked
/// with a ruler.
pub fn picture_mm(paper: Paper) -> [f64; 2] {
    let [width, height] = paper.printable_mm();
    [width, height - GAP_MM - RULER_MM - LINES as f64 * LINE_MM].map(f64::floor)
}

/// Returns the picture's size in pixels.
pub fn picture_px(paper: Paper) -> [u32; 2] {
    let size = picture_mm(paper);
    let shorter = size[0].min(size[1]);
    size.map(|side| (side / shorter * SHORTER_SIDE_PX).round() as u32)
}

/// Returns the config snippet; `image` is the picture's file, relative to the config's folder.
pub fn snippet(paper: Paper, image: &str) -> String {
    let [width, height] = picture_mm(paper).map(|mm| mm * 1e-3);
    // A TOML string quotes itself; the sizes are whole millimetres.
    let image = toml::Value::String(image.to_owned());
    format!("[[stage.surface]]\nimage = {image}\nsize_m = [{width:.3}, {height:.3}]\n")
}

/// Lays out the page.
pub fn page(paper: Paper, seed: u64, image: &str) -> Page {
    let [width, height] = picture_mm(paper);
    let left = 0.5 * (paper.size_mm[0] - width);
    let room = paper.printable_mm()[0];
    let foot = MARGIN_MM + height + GAP_MM;
    let mut items = vec![Item::Picture { at: [left, MARGIN_MM], size: [width, height] }];
    items.extend(ruler([MARGIN_MM, foot], room));
    let words = [
        format!(
            "stagepose poster, seed {seed}: the picture is {width} x {height} mm between its outer edges. Print at 100 % on matt paper,"
        ),
        "check the ruler, glue it on something flat. If the ruler is off, measure the picture and write what you measured in size_m."
            .to_owned(),
    ];
    let snippet = snippet(paper, image);
    // Printed text is ASCII; other characters stay readable in the snippet that the command prints.
    let ascii = |line: &str| line.chars().map(|c| if c.is_ascii_graphic() || c == ' ' { c } else { '?' }).collect();
    let lines = words.iter().map(|w| (w.as_str(), Style::Plain, LETTER_EM[0]));
    let lines = lines.chain(snippet.lines().map(|l| (l, Style::Typewriter, LETTER_EM[1])));
    for (k, (line, style, em)) in lines.enumerate() {
        let at = [MARGIN_MM, foot + RULER_MM + (k as f64 + 0.8) * LINE_MM];
        items.push(Item::Text { at, size: fitting_size(line, room, TYPE_MM, em), text: ascii(line), style });
    }
    Page { size_mm: paper.size_mm, items }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_config_snippet_states_the_printed_size() {
        for name in ["a0", "a3", "a4", "letter", "500x700 mm", "400x100"] {
            let paper = Paper::parse(name).unwrap();
            let page = page(paper, 1, "a \"b\".png");
            let printed = page.items.iter().find_map(|item| if let Item::Picture { at, size } = item { Some((*at, *size)) } else { None });
            let (at, size) = printed.unwrap();
            let typed: toml::Table = snippet(paper, "a \"b\".png").parse().unwrap();
            let surface = &typed["stage"]["surface"][0];
            assert_eq!(surface["image"].as_str(), Some("a \"b\".png"));
            for side in 0..2 {
                assert!((surface["size_m"][side].as_float().unwrap() * 1e3 - size[side]).abs() < 1e-9);
                assert!(at[side] >= MARGIN_MM && at[side] + size[side] <= paper.size_mm[side] - MARGIN_MM + 1e-9, "{name}");
            }
            let pixels = picture_px(paper).map(f64::from);
            assert!((pixels[0] / pixels[1] / (size[0] / size[1]) - 1.0).abs() < 1e-3, "{name}");
            let lowest =
                page.items.iter().filter_map(|i| if let Item::Text { at, .. } = i { Some(at[1]) } else { None }).fold(0.0, f64::max);
            assert!(lowest <= paper.size_mm[1] - MARGIN_MM, "{name}: {lowest}");
        }
    }
}
