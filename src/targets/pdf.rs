//! Writes a page as PDF: vectors, the picture in grey, and the two typefaces that every reader has.

use image::GrayImage;
use pdf_writer::{Content, Filter, Finish, Name, Pdf, Rect, Ref, Str};

use super::page::{Item, LINE_MM, Page, Style};

/// Points per millimetre; PDF's unit is 72 points per inch.
const POINTS_PER_MM: f64 = 72.0 / 25.4;
/// Width of a Helvetica digit, ems, from Adobe's font metrics; used to centre numbers.
const DIGIT_EM: f64 = 0.556;
/// Compression level of the picture, 0 to 10: deflate's default. Raised, writing takes longer and
/// saves little on a picture that is mostly edges.
const COMPRESSION: u8 = 6;
/// Resource names in the page's content: two typefaces and the picture. Any names would do.
const SANS: Name = Name(b"Sans");
const TYPEWRITER: Name = Name(b"Typewriter");
const PICTURE: Name = Name(b"Picture");

/// Returns the page as the bytes of a PDF file.
pub fn write(page: &Page, picture: Option<&GrayImage>) -> Vec<u8> {
    let [catalog, pages, sheet, contents, sans, typewriter, image] = [1, 2, 3, 4, 5, 6, 7].map(Ref::new);
    let [width, height] = page.size_mm.map(points);
    let mut pdf = Pdf::new();
    pdf.catalog(catalog).pages(pages);
    pdf.pages(pages).kids([sheet]).count(1);
    let mut single = pdf.page(sheet);
    single.media_box(Rect::new(0.0, 0.0, width, height)).parent(pages).contents(contents);
    let mut resources = single.resources();
    resources.fonts().pair(SANS, sans).pair(TYPEWRITER, typewriter);
    if picture.is_some() {
        resources.x_objects().pair(PICTURE, image);
    }
    resources.finish();
    single.finish();
    pdf.type1_font(sans).base_font(Name(b"Helvetica"));
    pdf.type1_font(typewriter).base_font(Name(b"Courier"));
    if let Some(picture) = picture {
        let packed = miniz_oxide::deflate::compress_to_vec_zlib(picture.as_raw(), COMPRESSION);
        let mut stream = pdf.image_xobject(image, &packed);
        stream.filter(Filter::FlateDecode);
        stream.width(picture.width() as i32).height(picture.height() as i32);
        stream.color_space().device_gray();
        stream.bits_per_component(8).interpolate(true);
        stream.finish();
    }
    let drawn = drawing(page);
    pdf.stream(contents, &drawn.finish());
    pdf.finish()
}

fn points(mm: f64) -> f32 {
    (mm * POINTS_PER_MM) as f32
}

fn drawing(page: &Page) -> Content {
    let mut content = Content::new();
    // In PDF, y points up from the foot of the page.
    let up = |y: f64| points(page.size_mm[1] - y);
    content.set_line_width(points(LINE_MM));
    for item in &page.items {
        match item {
            Item::Squares { at, side } => {
                for [x, y] in at {
                    content.rect(points(*x), up(y + side), points(*side), points(*side));
                }
                content.fill_nonzero();
            }
            Item::Lines(lines) => {
                for [x, y, u, v] in lines {
                    content.move_to(points(*x), up(*y)).line_to(points(*u), up(*v));
                }
                content.stroke();
            }
            Item::Text { at: [x, y], size, text, style } => {
                let font = if *style == Style::Typewriter { TYPEWRITER } else { SANS };
                let half = if *style == Style::Centred { 0.5 * DIGIT_EM * size * text.len() as f64 } else { 0.0 };
                content.begin_text().set_font(font, points(*size)).next_line(points(x - half), up(*y));
                content.show(Str(text.as_bytes())).end_text();
            }
            Item::Picture { at: [x, y], size: [w, h] } => {
                content.save_state().transform([points(*w), 0.0, 0.0, points(*h), points(*x), up(y + h)]);
                content.x_object(PICTURE).restore_state();
            }
        }
    }
    content
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::targets::paper::Paper;
    use crate::targets::{poster, poster_sheet};

    #[test]
    fn the_page_and_the_picture_have_their_sizes_in_points() {
        let paper = Paper::parse("a3").unwrap();
        let picture = poster::paint(64, 88, 1);
        let bytes = write(&poster_sheet::page(paper, 1, "poster-picture.png"), Some(&picture));
        let text = String::from_utf8_lossy(&bytes);
        assert!(text.starts_with("%PDF-") && text.trim_end().ends_with("%%EOF"));
        let number_after = |key: &str, index: usize| -> f64 {
            let from = text.find(key).unwrap() + key.len();
            text[from..].split_whitespace().nth(index).unwrap().trim_end_matches(']').parse().unwrap()
        };
        assert!((number_after("/MediaBox [", 2) - 297.0 * POINTS_PER_MM).abs() < 0.01);
        assert!((number_after("/MediaBox [", 3) - 420.0 * POINTS_PER_MM).abs() < 0.01);
        // The matrix that places the picture: its width and height on paper.
        let matrix = text[..text.find(" cm\n").unwrap()].lines().last().unwrap();
        let numbers: Vec<f64> = matrix.split_whitespace().map(|n| n.parse().unwrap()).collect();
        let [width, height] = poster_sheet::picture_mm(paper).map(|mm| mm * POINTS_PER_MM);
        assert!((numbers[0] - width).abs() < 0.01 && (numbers[3] - height).abs() < 0.01, "{matrix}");
        assert!(text.contains("/Width 64") && text.contains("/Height 88"));
    }
}
