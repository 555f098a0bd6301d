//! A part of the model that does not fit what frames show: which, by how much, and what that costs.

use crate::track::scene::reference::PreparedBody;

/// Which part of the model is other than told, and by how much.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Part {
    /// The lens.
    Lens {
        /// Focal length, percent of the calibration's.
        focal_percent: f64,
        /// Principal point, pixels.
        centre_px: [f64; 2],
        /// First radial coefficient.
        radial: f64,
        /// Farthest that a pixel of the picture is displaced by all of them, pixels.
        farthest_px: f64,
    },
    /// The shape of a surface.
    Shape {
        /// Its index in the stage.
        surface: usize,
        /// Root mean square of the heights over the shape that it is told to have, mm.
        rms_mm: f64,
        /// The largest of them, mm.
        most_mm: f64,
    },
    /// Where a surface stands among the others.
    Place {
        /// Its index in the stage.
        surface: usize,
        /// How far its middle is from where it is told to be: along the stage's x, y and z, mm.
        moved_mm: [f64; 3],
        /// By how much it is turned, degrees.
        turned_deg: f64,
    },
    /// The corners of a surface's picture: it is cropped or photographed askew, or hangs sheared.
    Corners {
        /// Its index in the stage.
        surface: usize,
        /// How far the corner that is off most is off: pixels of the picture's file.
        most_px: f64,
        /// The same on the surface, mm.
        most_mm: f64,
    },
    /// The ratio of a surface's sides.
    Ratio {
        /// Its index in the stage.
        surface: usize,
        /// How much wider it is for its height than told, percent.
        wider_percent: f64,
    },
}

/// A part that is other than told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Misfit {
    /// Which.
    pub part: Part,
    /// Share of the squared displacements of the tiles that it explains.
    pub share: f64,
    /// How far poses are off for it, root mean square, mm.
    pub cost_mm: f64,
}

/// A part that is other than told, with the name of its surface.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelNews {
    /// Which part, and by how much.
    pub part: Part,
    /// What its surface is called; `None` for the lens.
    pub surface: Option<String>,
    /// How far poses are off for it, root mean square, mm.
    pub cost_mm: f64,
}

impl ModelNews {
    /// What is the matter, what it costs, and what to do about it.
    pub fn text(&self) -> String {
        let says = self.part.says(self.surface.as_deref().unwrap_or_default());
        // Where other surfaces outvote one that was moved, poses are not off for it.
        let costs = match self.part {
            Part::Place { .. } => String::new(),
            _ => format!(", which puts poses {} mm off (rms)", figures(self.cost_mm)),
        };
        format!("{says}{costs}: {}", self.part.mend())
    }
}

/// How well the model fits what a clip showed.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ModelReport {
    /// The parts that frames spoke against, the likeliest first.
    pub parts: Vec<ModelNews>,
    /// Root mean square of what poses leave of the tiles' displacements, pixels.
    pub left_px: f64,
    /// How far poses may be off for that, whatever its cause: one sigma of most frames, mm, and as a share of the camera's distance. 0 where it is no more than noise, or what a motion while
    /// rows are read explains.
    pub doubt_mm: f64,
    /// See [`doubt_mm`](Self::doubt_mm).
    pub doubt_share: f64,
    /// How many views that differ showed it.
    pub views: usize,
}

/// A focal length and a ratio further off than this, percent, are beyond what small changes of a model describe: whole pictures say that better. Chosen, not tuned. Raised,
/// the linear answer is believed where it is a few percent of itself off.
const SMALL_FOCAL_PERCENT: f64 = 5.0;
const SMALL_RATIO_PERCENT: f64 = 2.5;

/// Three figures, without idle decimals.
fn figures(value: f64) -> String {
    let digits = if value == 0.0 { 0 } else { (2 - value.abs().log10().floor() as i32).clamp(0, 4) as usize };
    format!("{value:.digits$}")
}

impl Part {
    /// One word, for programs.
    pub fn word(&self) -> &'static str {
        match self {
            Self::Lens { .. } => "lens",
            Self::Shape { .. } => "shape",
            Self::Place { .. } => "layout",
            Self::Corners { .. } => "corners",
            Self::Ratio { .. } => "ratio",
        }
    }

    /// How far its surface is from where it should be, at its edge, metres; 0 of another part.
    pub fn size_m(&self, body: &PreparedBody) -> f64 {
        let Self::Place { surface, moved_mm: [x, y, z], turned_deg } = self else { return 0.0 };
        let [width, height] = body.surfaces[*surface].spec.size_m;
        1e-3 * (x * x + y * y + z * z).sqrt() + 0.5 * width.hypot(height) * turned_deg.to_radians()
    }

    /// Whether it is so little off that small changes of a model describe it.
    pub fn is_small(&self) -> bool {
        match self {
            Self::Lens { focal_percent, .. } => focal_percent.abs() < SMALL_FOCAL_PERCENT,
            Self::Ratio { wider_percent, .. } => wider_percent.abs() < SMALL_RATIO_PERCENT,
            Self::Place { .. } | Self::Shape { .. } | Self::Corners { .. } => true,
        }
    }

    /// The surface that it is a part of; `None` for the lens.
    pub fn surface(&self) -> Option<usize> {
        match self {
            Self::Lens { .. } => None,
            Self::Shape { surface, .. } | Self::Place { surface, .. } | Self::Corners { surface, .. } | Self::Ratio { surface, .. } => {
                Some(*surface)
            }
        }
    }

    /// What is the matter, in a sentence without its full stop. `name`: what its surface is called.
    pub fn says(&self, name: &str) -> String {
        match *self {
            Self::Lens { focal_percent, centre_px: [x, y], radial, farthest_px } => format!(
                "the lens is not as calibrated: a focal length {focal_percent:+.2} % off, a centre {x:+.1}, {y:+.1} px off and a k1 {radial:+.3} off explain how the \
                 stage is seen (up to {} px in the picture)",
                figures(farthest_px)
            ),
            Self::Shape { rms_mm, most_mm, .. } => {
                format!(
                    "{name} is not of the shape that it is told to have: {} mm off (rms), {} mm at most",
                    figures(rms_mm),
                    figures(most_mm)
                )
            }
            Self::Place { moved_mm: [x, y, z], turned_deg, .. } => {
                let far = (x * x + y * y + z * z).sqrt();
                format!(
                    "{name} stands elsewhere than it is told to: {} mm from there, by [{x:.1}, {y:.1}, {z:.1}] mm, turned by {turned_deg:.2} degrees",
                    figures(far)
                )
            }
            Self::Corners { most_px, most_mm, .. } => format!(
                "{name}: its corners are not those of the surface as it hangs: {} px off in the picture, {} mm on the surface",
                figures(most_px),
                figures(most_mm)
            ),
            Self::Ratio { wider_percent, .. } => {
                let (by, is) = (figures(wider_percent.abs()), if wider_percent > 0.0 { "wider" } else { "narrower" });
                format!("{name} is {by} % {is} for its height than size_m says")
            }
        }
    }

    /// What to do about it.
    pub fn mend(&self) -> &'static str {
        match self {
            Self::Lens { .. } => {
                "calibrate the lens as it is now: `stagepose survey WALK --config FILE --lens refine --output DIR`, or `stagepose calibrate`"
            }
            Self::Shape { .. } => "survey it as it hangs: `stagepose survey WALK --config FILE --output DIR`",
            Self::Place { .. } => "put it back, or survey the stage as it stands: `stagepose survey WALK --config FILE --output DIR`",
            Self::Corners { .. } => {
                "check corners_px, or how the picture was cropped and hung, or let `stagepose survey WALK --config FILE --output DIR` find out"
            }
            Self::Ratio { .. } => {
                "measure both its sides and write size_m, or let `stagepose survey WALK --config FILE --output DIR` find out"
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sentences_have_the_size() {
        let lens = Part::Lens { focal_percent: 2.561, centre_px: [10.6, -7.1], radial: -0.19, farthest_px: 41.23 };
        assert!(lens.says("").contains("+2.56 %") && lens.says("").contains("41.2 px") && lens.mend().contains("--lens refine"));
        let place = Part::Place { surface: 2, moved_mm: [3.0, 0.0, -4.0], turned_deg: 0.5 };
        assert!(place.says("tree.png").starts_with("tree.png stands elsewhere") && place.says("tree.png").contains("5.00 mm"));
        let ratio = Part::Ratio { surface: 0, wider_percent: -0.5 };
        assert_eq!(ratio.says("cloth.png"), "cloth.png is 0.500 % narrower for its height than size_m says");
        let corners = Part::Corners { surface: 0, most_px: 1.42, most_mm: 1.57 };
        assert_eq!(
            corners.says("a.jpg"),
            "a.jpg: its corners are not those of the surface as it hangs: 1.42 px off in the picture, 1.57 mm on the surface"
        );
        assert!(corners.mend().contains("corners_px") && corners.surface() == Some(0) && corners.word() == "corners");
        assert_eq!(figures(0.0), "0");
    }
}
