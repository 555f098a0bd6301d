//! The few shapes used in figures, as SVG text.

use std::fmt::Write;

use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, GrayImage};

/// A drawing under construction: a view box in its own units.
#[derive(Debug)]
pub struct Drawing {
    width: f64,
    height: f64,
    shapes: String,
}

/// Escapes a text for HTML content and attributes.
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

impl Drawing {
    /// Returns an empty drawing, `width` by `height` units.
    pub fn new(width: f64, height: f64) -> Self {
        Self { width, height, shapes: String::new() }
    }

    fn add(&mut self, shape: std::fmt::Arguments<'_>) {
        // Writing to a String cannot fail.
        let _ = self.shapes.write_fmt(shape);
    }

    /// Draws a line between two points.
    pub fn line(&mut self, [x1, y1]: [f64; 2], [x2, y2]: [f64; 2], colour: &str, width: f64) {
        self.add(format_args!(
            "<line x1=\"{x1:.2}\" y1=\"{y1:.2}\" x2=\"{x2:.2}\" y2=\"{y2:.2}\" stroke=\"{colour}\" stroke-width=\"{width:.2}\"/>"
        ));
    }

    /// Draws a line through many points, closed or not.
    pub fn path(&mut self, points: &[[f64; 2]], closed: bool, stroke: &str, fill: &str, width: f64) {
        let list: Vec<String> = points.iter().map(|[x, y]| format!("{x:.2},{y:.2}")).collect();
        let shape = if closed { "polygon" } else { "polyline" };
        let points = list.join(" ");
        self.add(format_args!(
            "<{shape} points=\"{points}\" stroke=\"{stroke}\" fill=\"{fill}\" stroke-width=\"{width:.2}\" stroke-linejoin=\"round\"/>"
        ));
    }

    /// Draws an upright cross with arms of this length.
    pub fn cross(&mut self, [x, y]: [f64; 2], arm: f64, colour: &str, width: f64) {
        self.line([x - arm, y], [x + arm, y], colour, width);
        self.line([x, y - arm], [x, y + arm], colour, width);
    }

    /// Draws a circle around a point.
    pub fn circle(&mut self, [x, y]: [f64; 2], radius: f64, stroke: &str, fill: &str, width: f64) {
        self.add(format_args!(
            "<circle cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"{radius:.2}\" stroke=\"{stroke}\" fill=\"{fill}\" stroke-width=\"{width:.2}\"/>"
        ));
    }

    /// Draws a rectangle from its upper left corner.
    pub fn rect(&mut self, [x, y]: [f64; 2], [w, h]: [f64; 2], stroke: &str, fill: &str) {
        self.add(format_args!("<rect x=\"{x:.2}\" y=\"{y:.2}\" width=\"{w:.2}\" height=\"{h:.2}\" stroke=\"{stroke}\" fill=\"{fill}\"/>"));
    }

    /// Writes a text; `anchor` is start, middle or end.
    pub fn text(&mut self, [x, y]: [f64; 2], size: f64, anchor: &str, colour: &str, text: &str) {
        let text = escaped(text);
        self.add(format_args!(
            "<text x=\"{x:.2}\" y=\"{y:.2}\" font-size=\"{size:.2}\" text-anchor=\"{anchor}\" fill=\"{colour}\">{text}</text>"
        ));
    }

    /// Draws a picture from a data URI, filling the drawing.
    pub fn picture(&mut self, uri: &str) {
        self.picture_at(uri, [0.0, 0.0], [self.width, self.height]);
    }

    /// Draws a picture from a data URI, from its upper left corner.
    pub fn picture_at(&mut self, uri: &str, [x, y]: [f64; 2], [w, h]: [f64; 2]) {
        self.add(format_args!("<image href=\"{uri}\" x=\"{x}\" y=\"{y}\" width=\"{w}\" height=\"{h}\" preserveAspectRatio=\"none\"/>"));
    }

    /// Returns the finished element; `title` is for screen readers.
    pub fn finish(self, title: &str) -> String {
        let (w, h) = (self.width, self.height);
        let title = escaped(title);
        format!("<svg viewBox=\"0 0 {w:.2} {h:.2}\" role=\"img\" aria-label=\"{title}\"><title>{title}</title>{}</svg>", self.shapes)
    }
}

/// Returns a picture as a JPEG in a data URI; empty if it cannot be encoded.
pub fn data_uri(picture: &GrayImage) -> String {
    let mut bytes = Vec::new();
    let (width, height) = picture.dimensions();
    let encoded = JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY).encode(picture, width, height, ExtendedColorType::L8);
    if encoded.is_err() {
        return String::new();
    }
    format!("data:image/jpeg;base64,{}", base64(&bytes))
}

/// JPEG quality of embedded pictures, 1 to 100: good enough to look at. Raised, a report grows.
const JPEG_QUALITY: u8 = 80;

/// Returns a colour for the k-th of many things: hues are a golden angle apart.
pub fn hue(k: usize) -> String {
    format!("hsl({:.0} 70% 50%)", (k as f64 * 137.508) % 360.0)
}

/// Encodes bytes as base64 (RFC 4648).
pub fn base64(bytes: &[u8]) -> String {
    // The alphabet of RFC 4648, section 4.
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let bits = group.iter().enumerate().fold(0_u32, |bits, (k, b)| bits | u32::from(*b) << (16 - 8 * k));
        for k in 0..4 {
            let digit = DIGITS[(bits >> (18 - 6 * k) & 63) as usize];
            text.push(if k <= group.len() { char::from(digit) } else { '=' });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_follows_the_standard() {
        let cases = [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")];
        for (plain, coded) in cases {
            assert_eq!(base64(plain.as_bytes()), coded);
        }
    }

    #[test]
    fn svg_text_is_escaped() {
        let mut drawing = Drawing::new(10.0, 10.0);
        drawing.text([0.0, 0.0], 3.0, "start", "black", "<b a=\"x\">&");
        let svg = drawing.finish("t");
        assert!(svg.contains("&lt;b a=&quot;x&quot;&gt;&amp;") && !svg.contains("<b a"));
    }
}
