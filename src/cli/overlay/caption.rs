//! The overlay's text: state, position and angles at the top, the legend of the marks at the
//! bottom.
//!
//! Phrases flow into as many lines as the picture's width requires, so the same caption is readable
//! at 320 and at 1920 pixels.

use super::canvas::{Canvas, Colour};
use super::fit::{LEFT_OUT, fit_colour};
use super::lettering::{ASCENT, LINE, Lettering};
use super::{CYAN, Scene, state_colour};
use crate::cli::angles::camera_angles;
use crate::record::{PoseSample, State};

/// Text colours: poses and legend, and secondary facts.
const WHITE: Colour = [240, 242, 245];
const PALE: Colour = [186, 192, 200];

/// Type size as a share of the picture's height (or of three quarters of its width if that is
/// smaller). Chosen for looks. Raised, captions hide more of the picture.
const TYPE_SHARE: f32 = 1.0 / 38.0;
/// Minimum readable type size, pixels. Raised, captions hide more of small pictures.
const MIN_TYPE_PX: f32 = 11.0;

/// Returns the type for a picture of this size.
pub(super) fn lettering([width, height]: [f32; 2]) -> Lettering {
    Lettering { size_px: (TYPE_SHARE * height.min(0.75 * width)).max(MIN_TYPE_PX).round() }
}

/// A phrase that is not broken over lines, with its mark in front.
struct Phrase {
    /// Text before the mark.
    lead: &'static str,
    mark: Mark,
    colour: Colour,
    text: String,
}

/// The mark in front of a phrase.
enum Mark {
    None,
    Disc(Colour),
    Line(Colour),
    /// The colour scale from "fits" to "does not fit".
    Scale,
}

impl Phrase {
    fn plain(colour: Colour, text: impl Into<String>) -> Self {
        Self { lead: "", mark: Mark::None, colour, text: text.into() }
    }

    fn marked(mark: Mark, text: &str) -> Self {
        Self { lead: "", mark, colour: WHITE, text: text.to_owned() }
    }

    /// Returns the width of the text before the mark, with the gap after it.
    fn lead_px(&self, lettering: Lettering) -> f32 {
        if self.lead.is_empty() { 0.0 } else { lettering.width_px(self.lead) + 0.4 * lettering.size_px }
    }

    /// Returns the width of the mark, with the gap after it.
    fn mark_px(&self, em: f32) -> f32 {
        match self.mark {
            Mark::None => 0.0,
            Mark::Disc(_) => em,
            Mark::Line(_) => 1.6 * em,
            Mark::Scale => 3.1 * em,
        }
    }

    fn width_px(&self, lettering: Lettering) -> f32 {
        self.lead_px(lettering) + self.mark_px(lettering.size_px) + lettering.width_px(&self.text)
    }
}

/// Draws the upper panel: state and pose, or why there is none.
pub(super) fn status(canvas: &mut Canvas, sample: &PoseSample, edge: f32) {
    let colour = state_colour(sample.state);
    let mut facts = vec![
        Phrase { lead: "", mark: Mark::Disc(colour), colour, text: sample.state.word().to_owned() },
        Phrase::plain(PALE, format!("row {}", sample.sequence)),
    ];
    if let Some(pose) = &sample.pose {
        let [x, y, z] = [pose.translation.x, pose.translation.y, pose.translation.z].map(|metres| signed(metres, 3));
        facts.push(Phrase::plain(WHITE, format!("x {x}  y {y}  z {z} m")));
        let [pan, tilt, roll] = camera_angles(pose).map(|degrees| signed(degrees, 2));
        facts.push(Phrase::plain(WHITE, format!("pan {pan}\u{b0}  tilt {tilt}\u{b0}  roll {roll}\u{b0}")));
    }
    if let Some(rms_px) = sample.measurement.as_ref().and_then(|measurement| measurement.rms_px) {
        facts.push(Phrase::plain(PALE, format!("off by {rms_px:.2} px")));
    }
    for object in sample.objects.iter().filter(|object| object.state != State::Tracking) {
        let colour = state_colour(object.state);
        facts.push(Phrase::plain(colour, format!("{} {}", object.name, object.state.word())));
    }
    let mut paragraphs = vec![facts];
    if let Some(reason) = sample.reason {
        paragraphs.push(reason.message().split_whitespace().map(|word| Phrase::plain(colour, word)).collect());
    }
    Block::of(canvas, &paragraphs, edge).draw(canvas, Anchor::Top);
}

/// Draws the lower panel: the legend of the marks.
pub(super) fn legend(canvas: &mut Canvas, sample: &PoseSample, scene: &Scene, edge: f32) {
    let mut phrases = vec![Phrase::marked(Mark::Line(state_colour(sample.state)), "stage")];
    if !scene.objects.is_empty() {
        phrases.push(Phrase::marked(Mark::Line(CYAN), "object"));
    }
    phrases.push(Phrase { lead: "fits", ..Phrase::marked(Mark::Scale, "does not fit") });
    phrases.push(Phrase::marked(Mark::Disc(LEFT_OUT), "left out"));
    Block::of(canvas, &[phrases], edge).draw(canvas, Anchor::Bottom);
}

/// Formats a number with its sign; the true minus is as wide as the plus.
fn signed(value: f64, digits: usize) -> String {
    format!("{value:+.digits$}").replace('-', "\u{2212}")
}

enum Anchor {
    Top,
    Bottom,
}

/// Phrases laid out in lines.
struct Block<'a> {
    lettering: Lettering,
    edge: f32,
    /// Each phrase with its left end.
    lines: Vec<Vec<(f32, &'a Phrase)>>,
    width: f32,
}

impl<'a> Block<'a> {
    /// Lays out paragraphs, each on a new line. A sentence's words stand closer together than
    /// facts.
    fn of(canvas: &Canvas, paragraphs: &'a [Vec<Phrase>], edge: f32) -> Self {
        let size = canvas.size();
        let lettering = lettering(size);
        let em = lettering.size_px;
        let room = size[0] - 2.0 * (edge + 0.4 * em);
        let (mut lines, mut widest) = (Vec::new(), 0.0_f32);
        for (k, paragraph) in paragraphs.iter().enumerate() {
            let gap = if k == 0 { em } else { lettering.width_px(" ") };
            let mut line: Vec<(f32, &Phrase)> = Vec::new();
            let mut end = 0.0;
            for phrase in paragraph {
                let width = phrase.width_px(lettering);
                if !line.is_empty() && end + gap + width > room {
                    lines.push(std::mem::take(&mut line));
                }
                let start = if line.is_empty() { 0.0 } else { end + gap };
                end = start + width;
                widest = widest.max(end);
                line.push((start, phrase));
            }
            lines.push(line);
        }
        Self { lettering, edge, lines, width: widest.min(room) }
    }

    fn draw(&self, canvas: &mut Canvas, anchor: Anchor) {
        let em = self.lettering.size_px;
        let (margin, step) = (0.4 * em, (LINE * em).round());
        let height = step * self.lines.len() as f32 + 0.5 * em;
        let top = match anchor {
            Anchor::Top => self.edge,
            Anchor::Bottom => canvas.size()[1] - self.edge - height,
        }
        .round();
        canvas.panel([self.edge, top, (self.width + 2.0 * margin).round(), height.round()]);
        for (row, line) in self.lines.iter().enumerate() {
            let baseline = top + 0.25 * em + step * row as f32 + ASCENT * em;
            for (start, phrase) in line {
                let start = self.edge + margin + start;
                canvas.text(self.lettering, (start, baseline), phrase.colour, phrase.lead);
                let left = start + phrase.lead_px(self.lettering);
                mark(canvas, &phrase.mark, [left, baseline - 0.36 * em], em);
                canvas.text(self.lettering, (left + phrase.mark_px(em), baseline), phrase.colour, &phrase.text);
            }
        }
    }
}

/// Draws a mark with this left end and middle height.
fn mark(canvas: &mut Canvas, mark: &Mark, [left, middle]: [f32; 2], em: f32) {
    let thick = (0.16 * em).max(2.0).round();
    match mark {
        Mark::None => {}
        Mark::Disc(colour) => canvas.disc([left + 0.4 * em, middle], 0.32 * em, 0.0, *colour),
        Mark::Line(colour) => canvas.rect([left, (middle - 0.5 * thick).round(), 1.25 * em, thick], *colour),
        Mark::Scale => {
            /// Number of fields in the legend's colour scale. Raised, it looks smoother.
            const STEPS: u8 = 12;
            let step = 2.7 * em / f32::from(STEPS);
            for k in 0..STEPS {
                let colour = fit_colour(f32::from(k) / f32::from(STEPS - 1));
                canvas.rect([left + step * f32::from(k), (middle - 0.2 * em).round(), step, (0.45 * em).round()], colour);
            }
        }
    }
}
