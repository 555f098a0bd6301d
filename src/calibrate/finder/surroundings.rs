//! What lies around a corner and is not symmetric about it: the slope of the light, and the next edges. How far the corner's window
//! reaches into it, and what a single pixel of the window is worth.

use nalgebra::Vector2;

use super::window::{Sample, erf_and_slope};

/// The next edge on one side of a corner.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NextEdge {
    /// Unit normal, pointing along the board's axis.
    pub normal: Vector2<f64>,
    /// Its place along the normal.
    pub place: f64,
    /// The board ends there: what follows is no square.
    pub ends: bool,
}

/// The four next edges: before and after the corner along v (parallel to u), then along u.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NextEdges {
    pub along: [[NextEdge; 2]; 2],
    /// Level of what lies around the board in this corner's pattern: 1 as the squares in its first quadrant, -1 as the others.
    pub beyond: f64,
}

/// What a corner's neighbours tell of the place around it.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Surroundings {
    /// Relative change of the light per pixel.
    pub light: Vector2<f64>,
    /// Places and normals in level pixels; `None` where the blur does not reach them.
    pub edges: Option<NextEdges>,
}

/// Share of a square, from the corner, that the window covers: a little less than half, so that windows of neighbours do not
/// overlap and the next edges stay far. Raised, the next edges disturb the fit; lowered, it has fewer pixels.
const WINDOW: f64 = 0.46;
/// The same where the next edges are drawn too: blurred corners need more room, and the model then knows what
/// lies there. Raised, more of the next squares counts, whose edges are taken as given.
const WIDE_WINDOW: f64 = 0.7;
/// The next edges are drawn where the blur is more than this share of the way to them. At it, they lie four sigma of the blur beyond the
/// window: (1 - [`WINDOW`]) / 0.13. Raised, undrawn edges displace corners; lowered, edges are drawn in vain, which costs time.
pub(crate) const BLUR_REACHES: f64 = 0.13;

/// How far the window reaches, pixels: enough of the edges, and all of the blur.
pub(crate) fn reach(blur: f64) -> f64 {
    (4.0 + 3.0 * blur).clamp(7.0, 14.0)
}

impl Surroundings {
    /// Share of a square that the window covers.
    pub fn window(&self) -> f64 {
        if self.edges.is_some() { WIDE_WINDOW } else { WINDOW }
    }

    /// The pixel at `place` (level pixels, or whatever the edges are in), `offset` from the window's centre and (s, t) squares
    /// along the two axes; `None` outside the window. Its weight falls to nothing at the rim, so that a pixel more or less
    /// changes nothing.
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
    /// What the next edges add to both blurred steps, and to the pattern as a whole.
    fn at(&self, place: Vector2<f64>, blur: f64) -> ([f64; 2], f64) {
        let scale = std::f64::consts::FRAC_1_SQRT_2 / blur;
        let mut on_board = 1.0;
        let beside = self.along.map(|[before, after]| {
            let step = |edge: &NextEdge| {
                let z = scale * (edge.normal.dot(&place) - edge.place);
                if z.abs() > 4.0 { z.signum() } else { f64::from(erf_and_slope(z as f32).0) }
            };
            // How much of what is seen here lies beyond either edge.
            let (past_before, past_after) = (0.5 * (1.0 - step(&before)), 0.5 * (1.0 + step(&after)));
            // The next square has the other colour, which is a step of two; at the board's end only the colour goes.
            let size = |edge: &NextEdge| if edge.ends { 1.0 } else { 2.0 };
            on_board *= 1.0 - if before.ends { past_before } else { 0.0 } - if after.ends { past_after } else { 0.0 };
            size(&before) * past_before - size(&after) * past_after
        });
        (beside, self.beyond * (1.0 - on_board))
    }
}
