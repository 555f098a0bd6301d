//! Describes a part of the model that does not fit the frames: which one, by how much, and what it
//! costs. Also writes the messages about it.

use crate::track::model_error::tuning::TUNING;
use crate::track::scene::reference::PreparedBody;

/// A part of the model that differs from the config, and by how much.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Part {
    /// The lens.
    Lens {
        /// Error of the focal length, percent of the calibrated one.
        focal_percent: f64,
        /// Error of the principal point, pixels.
        centre_px: [f64; 2],
        /// Error of the first radial coefficient.
        radial: f64,
        /// Largest displacement of a pixel by all of them together, pixels.
        farthest_px: f64,
    },
    /// The shape of a surface.
    Shape {
        /// Index of the surface in the stage.
        surface: usize,
        /// Root mean square height over the configured shape, mm.
        rms_mm: f64,
        /// Maximum height over it, mm.
        most_mm: f64,
    },
    /// The place of a surface among the others.
    Place {
        /// Index of the surface in the stage.
        surface: usize,
        /// Displacement of its centre from the configured place along the stage's x, y and z, mm.
        moved_mm: [f64; 3],
        /// Its rotation from the configured direction, degrees.
        rotation_deg: f64,
    },
    /// The corners of a surface's picture: it is cropped or photographed askew, or hangs sheared.
    Corners {
        /// Index of the surface in the stage.
        surface: usize,
        /// Displacement of the worst corner, pixels of the picture file.
        most_px: f64,
        /// The same on the surface, mm.
        most_mm: f64,
    },
    /// The ratio of a surface's sides.
    Ratio {
        /// Index of the surface in the stage.
        surface: usize,
        /// Excess of its width-to-height ratio over the configured one, percent.
        wider_percent: f64,
    },
}

/// A part that differs from the config, as a study found it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Misfit {
    /// The part.
    pub part: Part,
    /// Fraction of the tiles' squared displacements that it explains.
    pub share: f64,
    /// Root mean square pose error that it causes, mm.
    pub cost_mm: f64,
}

/// A part that differs from the config, with the name of its surface.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelNews {
    /// The part, and by how much it differs.
    pub part: Part,
    /// Name of its surface; `None` for the lens.
    pub surface: Option<String>,
    /// Root mean square pose error that it causes, mm.
    pub cost_mm: f64,
    /// Whether the surface is a facet of a map.
    pub is_mapped: bool,
    /// Whether poses no longer use the surface.
    pub is_left_out: bool,
}

impl ModelNews {
    /// Returns the message: what is wrong, what it costs, and how to fix it.
    pub fn text(&self) -> String {
        let message = self.part.message(self.surface.as_deref().unwrap_or_default());
        // The other surfaces outvote one that was moved, so that poses are not off.
        let costs = match self.part {
            Part::Place { .. } => String::new(),
            _ => format!(", which puts poses {} mm off (rms)", figures(self.cost_mm)),
        };
        let left_out = if self.is_left_out { "; it is left out until the next start" } else { "" };
        format!("{message}{costs}{left_out}: {}", self.hint())
    }

    /// Returns how to fix it.
    pub fn hint(&self) -> &'static str {
        match self.part {
            Part::Place { .. } if self.is_mapped => {
                "put it back, or map the set as it stands: `stagepose map WALK --config FILE --output DIR`"
            }
            part => part.hint(),
        }
    }
}

/// How well the model fits a clip.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ModelReport {
    /// The parts that contradict the frames, the likeliest first.
    pub parts: Vec<ModelNews>,
    /// Root mean square residual of the tiles at the solved poses, pixels.
    pub left_px: f64,
    /// Possible pose error from the misfit, whatever its cause: median sigma over the frames, mm. 0
    /// if the residuals are no more than noise or than motion during readout explains.
    pub doubt_mm: f64,
    /// The same as a fraction of the camera's distance.
    pub doubt_share: f64,
    /// Number of different views in which it was seen.
    pub views: usize,
}

/// Formats a value with three significant digits.
fn figures(value: f64) -> String {
    let digits = if value == 0.0 { 0 } else { (2 - value.abs().log10().floor() as i32).clamp(0, 4) as usize };
    format!("{value:.digits$}")
}

impl Part {
    /// Returns one word for programs.
    pub fn word(&self) -> &'static str {
        match self {
            Self::Lens { .. } => "lens",
            Self::Shape { .. } => "shape",
            Self::Place { .. } => "layout",
            Self::Corners { .. } => "corners",
            Self::Ratio { .. } => "ratio",
        }
    }

    /// Returns how far a displaced surface is off at its edge, metres; 0 for other parts.
    pub fn size_m(&self, body: &PreparedBody) -> f64 {
        let Self::Place { surface, moved_mm: [x, y, z], rotation_deg } = self else { return 0.0 };
        let [width, height] = body.surfaces[*surface].spec.size_m;
        1e-3 * (x * x + y * y + z * z).sqrt() + 0.5 * width.hypot(height) * rotation_deg.to_radians()
    }

    /// Whether the error is small enough for a linear model.
    pub fn is_small(&self) -> bool {
        match self {
            Self::Lens { focal_percent, .. } => focal_percent.abs() < TUNING.small_focal_error_percent,
            Self::Ratio { wider_percent, .. } => wider_percent.abs() < TUNING.small_ratio_error_percent,
            Self::Place { .. } | Self::Shape { .. } | Self::Corners { .. } => true,
        }
    }

    /// Returns the index of its surface; `None` for the lens.
    pub fn surface(&self) -> Option<usize> {
        match self {
            Self::Lens { .. } => None,
            Self::Shape { surface, .. } | Self::Place { surface, .. } | Self::Corners { surface, .. } | Self::Ratio { surface, .. } => {
                Some(*surface)
            }
        }
    }

    /// Returns what is wrong, as a sentence without its full stop. `name`: the name of its surface.
    pub fn message(&self, name: &str) -> String {
        match *self {
            Self::Lens { focal_percent, centre_px: [x, y], radial, farthest_px } => format!(
                "the lens is not as calibrated: a focal length {focal_percent:+.2} % off, a centre {x:+.1}, {y:+.1} px off and a k1 {radial:+.3} off explain how the \
                 stage is seen (up to {} px in the picture)",
                figures(farthest_px)
            ),
            Self::Shape { rms_mm, most_mm, .. } => {
                format!("{name} does not have its configured shape: {} mm off (rms), {} mm at most", figures(rms_mm), figures(most_mm))
            }
            Self::Place { moved_mm: [x, y, z], rotation_deg, .. } => {
                let far = (x * x + y * y + z * z).sqrt();
                format!(
                    "{name} is not at its configured position: {} mm from there, by [{x:.1}, {y:.1}, {z:.1}] mm, turned by \
                     {rotation_deg:.2} degrees",
                    figures(far)
                )
            }
            Self::Corners { most_px, most_mm, .. } => format!(
                "{name}: its corners do not match the surface as it hangs: {} px off in the picture, {} mm on the surface",
                figures(most_px),
                figures(most_mm)
            ),
            Self::Ratio { wider_percent, .. } => {
                let (by, is) = (figures(wider_percent.abs()), if wider_percent > 0.0 { "wider" } else { "narrower" });
                format!("{name} is {by} % {is} for its height than size_m says")
            }
        }
    }

    /// Returns how to fix it.
    pub fn hint(&self) -> &'static str {
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
    fn misfit_sentences_state_the_size() {
        let lens = Part::Lens { focal_percent: 2.561, centre_px: [10.6, -7.1], radial: -0.19, farthest_px: 41.23 };
        assert!(lens.message("").contains("+2.56 %") && lens.message("").contains("41.2 px") && lens.hint().contains("--lens refine"));
        let place = Part::Place { surface: 2, moved_mm: [3.0, 0.0, -4.0], rotation_deg: 0.5 };
        assert!(
            place.message("tree.png").starts_with("tree.png is not at its configured position")
                && place.message("tree.png").contains("5.00 mm")
        );
        let ratio = Part::Ratio { surface: 0, wider_percent: -0.5 };
        assert_eq!(ratio.message("cloth.png"), "cloth.png is 0.500 % narrower for its height than size_m says");
        let corners = Part::Corners { surface: 0, most_px: 1.42, most_mm: 1.57 };
        assert_eq!(
            corners.message("a.jpg"),
            "a.jpg: its corners do not match the surface as it hangs: 1.42 px off in the picture, 1.57 mm on the surface"
        );
        assert!(corners.hint().contains("corners_px") && corners.surface() == Some(0) && corners.word() == "corners");
        assert_eq!(figures(0.0), "0");
    }
}
