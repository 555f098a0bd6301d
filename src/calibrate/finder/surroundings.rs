//! The asymmetric surroundings of a corner: the slope of the light, and the next edges. Also
//! defines how far the corner's window extends, and how a single pixel of it is weighted and
//! corrected.

use nalgebra::Vector2;

use super::window::{Sample, erf_and_slope};

/// The next edge on one side of a corner.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NextEdge {
    /// Unit normal, pointing along the board's axis.
    pub normal: Vector2<f64>,
    /// Its coordinate along the normal.
    pub place: f64,
    /// Whether the board ends there, so that no square follows.
    pub ends: bool,
}

/// The four next edges: before and after the corner along v (parallel to u), then along u.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NextEdges {
    pub along: [[NextEdge; 2]; 2],
    /// Level of the area around the board, in this corner's pattern: 1 like the squares in its
    /// first quadrant, -1 like the others.
    pub beyond: f64,
}

/// What a corner's neighbours tell about its surroundings.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Surroundings {
    /// Relative change of the light per pixel.
    pub light: Vector2<f64>,
    /// Coordinates and normals in level pixels; `None` if their blur does not reach the window.
    pub edges: Option<NextEdges>,
}

/// Half width of the window as a fraction of a square: a little less than half, so that neighbours'
/// windows do not overlap and the next edges stay away. Raised, the next edges disturb the fit;
/// lowered, it has fewer pixels.
const WINDOW: f64 = 0.46;
/// The same if the next edges are modelled too: blurred corners need more room, and the model then
/// includes what lies there. Raised, more of the next squares counts, whose edges are assumed
/// known.
const WIDE_WINDOW: f64 = 0.7;
/// Blur, as a fraction of the distance to the next edges, above which they are modelled. At this
/// value they lie four sigma of the blur beyond the window: (1 - [`WINDOW`]) / 0.13. Raised,
/// unmodelled edges displace corners; lowered, edges are modelled in vain, which costs time.
pub(crate) const BLUR_REACHES: f64 = 0.13;

/// Returns the window's radius, pixels: enough of the edges, and all of the blur.
pub(crate) fn reach(blur: f64) -> f64 {
    (4.0 + 3.0 * blur).clamp(7.0, 14.0)
}

impl Surroundings {
    /// Returns the window's half width as a fraction of a square.
    pub fn window(&self) -> f64 {
        if self.edges.is_some() { WIDE_WINDOW } else { WINDOW }
    }

    /// Returns the sample of a pixel at `place` (level pixels, or the unit of the edges), which is
    /// `offset` from the window's centre and (s, t) squares along the two axes; `None` outside the
    /// window. The weight falls to zero at the rim, so that one pixel more or less changes nothing.
    #[inline]
    pub fn sample(
        &self,
        place: Vector2<f64>,
        offset: Vector2<f64>,
        [s, t]: [f64; 2],
        (reach, blur): (f64, f64),
        grey: f64,
    ) -> Option<Sample> {
        let window = self.window();
        if s.abs() >= window || t.abs() >= window || offset.norm_squared() >= reach * reach {
            return None;
        }
        let per_window = 1.0 / (window * window);
        let fall = |square: f64, per: f64| 1.0 - square * per;
        let weight = fall(s * s, per_window) * fall(t * t, per_window) * fall(offset.norm_squared(), 1.0 / (reach * reach));
        let grey = grey / (1.0 + self.light.dot(&offset)).max(0.1);
        let (beside, beyond) = self.edges.map_or(([0.0; 2], 0.0), |edges| edges.at(place, blur));
        Some(Sample { offset, grey, weight, beside, beyond })
    }
}

impl NextEdges {
    /// Returns what the next edges add to both blurred steps, and to the pattern as a whole.
    fn at(&self, place: Vector2<f64>, blur: f64) -> ([f64; 2], f64) {
        let scale = std::f64::consts::FRAC_1_SQRT_2 / blur;
        let mut on_board = 1.0;
        let beside = self.along.map(|[before, after]| {
            let step = |edge: &NextEdge| {
                let z = scale * (edge.normal.dot(&place) - edge.place);
                if z.abs() > 4.0 { z.signum() } else { f64::from(erf_and_slope(z as f32).0) }
            };
            // The fraction of this point's light that comes from beyond either edge.
            let (past_before, past_after) = (0.5 * (1.0 - step(&before)), 0.5 * (1.0 + step(&after)));
            // The next square has the other colour, a step of two; at the board's end the pattern
            // only stops, a step of one.
            let size = |edge: &NextEdge| if edge.ends { 1.0 } else { 2.0 };
            on_board *= 1.0 - if before.ends { past_before } else { 0.0 } - if after.ends { past_after } else { 0.0 };
            size(&before) * past_before - size(&after) * past_after
        });
        (beside, self.beyond * (1.0 - on_board))
    }
}
