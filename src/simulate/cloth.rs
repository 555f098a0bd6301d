//! Bent cloth, still or moving, and where rays meet it.
//!
//! A ray meets a plane by one division (`render`). It meets a bent surface where it passes from the
//! front to the back. A ray that is steeper than any slope of the cloth does so once, and Newton's
//! method finds the point. A grazing ray may pass through a fold and meet the next one, so it is
//! followed through the cloth's full depth in small steps, and the first crossing counts.

use std::f64::consts::{PI, TAU};

use nalgebra::{Vector2, Vector3};

use super::stage::Wave;
use crate::track::{ShapePoint, SurfaceShape, SurfaceSpec};

/// A ray this many times steeper than the cloth's steepest slope meets it once, and Newton's method
/// converges; at 1 that is not guaranteed. Raised, more rays are followed in small steps, which is
/// slower.
const STEEPER: f64 = 2.0;
/// Maximum Newton iterations. Convergence is quadratic: five are enough for the deepest folds.
/// Lowered below that, the picture deviates from its ground truth.
const STEPS: usize = 12;
/// Length of the step at which Newton's method stops, metres along the ray. Raised, the picture
/// deviates from its ground truth.
const LAST_STEP_M: f64 = 1e-10;
/// Steps per fold for a grazing ray. Raised, rendering is slower; lowered, the tops of folds that a
/// ray just touches are missed.
const STEPS_PER_FOLD: f64 = 24.0;
/// Maximum steps of a grazing ray. Raised, rendering may be slower; lowered, rays that pass many
/// folds miss some.
const MAX_STEPS: f64 = 2000.0;
/// Bisections of the step that contains the crossing. Raised, rendering is slower; lowered, the
/// crossing is less exact.
const HALVINGS: usize = 50;
/// Iterations that undo the stretch. The stretch is small and smooth, so each reduces the error to
/// about a hundredth. Lowered, the picture deviates from its ground truth.
const UNSTRETCHINGS: usize = 6;
/// Points along each side of a cloth at which its slope is sampled. Lowered, the steepest slope may
/// be missed, for which [`STEEPER`] leaves a margin.
const SLOPES_PER_SIDE: u32 = 40;
/// Margin around the cloth's bounding box, metres, so that no ray starts on the cloth.
const MARGIN_M: f64 = 1e-6;

/// A bent surface, in its own frame: x and y along the picture, z out of its face.
#[derive(Debug)]
pub(super) struct Cloth {
    shape: SurfaceShape,
    waves: Vec<Wave>,
    /// Half the picture's sides, metres.
    half_m: [f64; 2],
    /// Maximum displacement of a point by the stretch, metres.
    farthest_m: f64,
    /// Minimum and maximum height of the cloth, metres.
    heights_m: [f64; 2],
    steepest: f64,
    /// Distance along the picture from the bottom of the narrowest fold to its top, metres.
    narrowest_m: f64,
}

/// Where a ray meets a cloth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Meeting {
    /// Distance along the ray in multiples of its direction vector.
    pub depth: f64,
    /// The point of the picture, metres from its centre.
    pub on_picture_m: [f64; 2],
    /// Normal out of the face. Its length is the cloth's area per area of the picture there.
    pub normal: Vector3<f64>,
}

impl Cloth {
    /// Makes a cloth of a surface with waves over it; returns `None` if it is flat.
    pub fn of(surface: &SurfaceSpec, waves: &[Wave]) -> Option<Self> {
        let half_m = surface.size_m.map(|side| 0.5 * side);
        let mut cloth = Self {
            shape: surface.shape.clone(),
            waves: waves.to_vec(),
            half_m,
            farthest_m: 0.0,
            heights_m: [0.0; 2],
            steepest: 0.0,
            narrowest_m: half_m[0].min(half_m[1]),
        };
        if let SurfaceShape::Bent(shape) = &surface.shape {
            // A spline lies within the range of its coefficients.
            for height in shape.height.coefficients() {
                cloth.heights_m = [cloth.heights_m[0].min(height.x), cloth.heights_m[1].max(height.x)];
            }
            let farthest_m = shape.stretch.coefficients().iter().map(|c| c.norm()).fold(0.0, f64::max);
            let [x, y] = shape.height.spacing();
            (cloth.farthest_m, cloth.narrowest_m) = (farthest_m, cloth.narrowest_m.min(2.0 * x.min(y)));
        }
        let (mut reach_m, mut slope) = (0.0, 0.0);
        for wave in waves {
            let wave_number = Vector2::from(wave.wave_vector).norm();
            (reach_m, slope) = (reach_m + wave.height_m.abs(), slope + wave.height_m.abs() * wave_number);
            cloth.narrowest_m = cloth.narrowest_m.min(PI / wave_number.max(f64::MIN_POSITIVE));
        }
        cloth.heights_m = [cloth.heights_m[0] - reach_m - MARGIN_M, cloth.heights_m[1] + reach_m + MARGIN_M];
        cloth.steepest = cloth.steepest_at_rest() + slope;
        (!surface.shape.is_flat() || !waves.is_empty()).then_some(cloth)
    }

    fn steepest_at_rest(&self) -> f64 {
        let along = |k: u32, half: f64| (2.0 * (f64::from(k) + 0.5) / f64::from(SLOPES_PER_SIDE) - 1.0) * half;
        let places = (0..SLOPES_PER_SIDE).flat_map(|i| (0..SLOPES_PER_SIDE).map(move |j| (i, j)));
        let slopes = places.map(|(i, j)| {
            let normal = self.shape.at([along(i, self.half_m[0]), along(j, self.half_m[1])]).normal();
            normal.xy().norm() / normal.z.abs()
        });
        slopes.fold(0.0, f64::max)
    }

    /// Returns where a point of the picture is at a time, and the tangent plane there.
    pub fn at(&self, point: [f64; 2], time_s: f64) -> ShapePoint {
        let mut at = self.shape.at(point);
        for wave in &self.waves {
            let [x, y] = wave.wave_vector;
            let (sin, cos) = (x * point[0] + y * point[1] + TAU * wave.rate_hz * time_s + wave.phase_rad).sin_cos();
            at.place.z += wave.height_m * sin;
            at.by_picture[0].z += wave.height_m * cos * x;
            at.by_picture[1].z += wave.height_m * cos * y;
        }
        at
    }

    /// Returns where a ray first meets the cloth, at a depth of at least `nearest`.
    pub fn meet(&self, eye: &Vector3<f64>, direction: &Vector3<f64>, nearest: f64, time_s: f64) -> Option<Meeting> {
        let [from, to] = self.passage(eye, direction, nearest)?;
        let is_steep = direction.z.abs() > STEEPER * self.steepest * direction.xy().norm();
        if is_steep { self.meet_steeply(eye, direction, nearest, time_s) } else { self.meet_flatly(eye, direction, [from, to], time_s) }
    }

    /// Returns the range of depths in which a ray may meet the cloth: the ray's passage through the
    /// cloth's bounding box.
    fn passage(&self, eye: &Vector3<f64>, direction: &Vector3<f64>, nearest: f64) -> Option<[f64; 2]> {
        let [low, high] = self.heights_m;
        let [x, y] = self.half_m.map(|half| half + self.farthest_m + MARGIN_M);
        let mut within = [nearest, f64::INFINITY];
        for (axis, [low, high]) in [[-x, x], [-y, y], [low, high]].into_iter().enumerate() {
            let [a, b] = [low, high].map(|side| (side - eye[axis]) / direction[axis]);
            // A ray parallel to two sides is always or never between them; 0 / 0 is ignored.
            within = [within[0].max(a.min(b)), within[1].min(a.max(b))];
        }
        (within[0] < within[1] && within[1].is_finite()).then_some(within)
    }

    fn meet_steeply(&self, eye: &Vector3<f64>, direction: &Vector3<f64>, nearest: f64, time_s: f64) -> Option<Meeting> {
        let mut depth = -eye.z / direction.z;
        for _ in 0..STEPS {
            let place = eye + direction * depth;
            let at = self.at(self.beneath(&place, time_s), time_s);
            let normal = at.normal();
            let step = normal.dot(&(at.place - place)) / normal.dot(direction);
            depth += step;
            if step.abs() * direction.norm() < LAST_STEP_M {
                break;
            }
        }
        self.meeting(eye, direction, depth, time_s).filter(|m| m.depth > nearest)
    }

    fn meet_flatly(&self, eye: &Vector3<f64>, direction: &Vector3<f64>, [from, to]: [f64; 2], time_s: f64) -> Option<Meeting> {
        let above = |depth: f64| {
            let place = eye + direction * depth;
            place.z - self.at(self.beneath(&place, time_s), time_s).place.z
        };
        let folds = (to - from) * direction.xy().norm() / self.narrowest_m;
        let steps = (folds * STEPS_PER_FOLD).ceil().clamp(2.0, MAX_STEPS);
        let at_step = |k: f64| from + (to - from) * k / steps;
        let mut before = above(from);
        for k in 1..=steps as u32 {
            let after = above(at_step(f64::from(k)));
            if (before > 0.0) != (after > 0.0) {
                let (mut near, mut far) = (at_step(f64::from(k - 1)), at_step(f64::from(k)));
                for _ in 0..HALVINGS {
                    let middle = 0.5 * (near + far);
                    if (above(middle) > 0.0) == (before > 0.0) { near = middle } else { far = middle }
                }
                let met = self.meeting(eye, direction, 0.5 * (near + far), time_s);
                if met.is_some() {
                    return met;
                }
            }
            before = after;
        }
        None
    }

    /// Returns the point of the picture directly above or below a place.
    fn beneath(&self, place: &Vector3<f64>, time_s: f64) -> [f64; 2] {
        let mut point = place.xy();
        if self.farthest_m > 0.0 {
            for _ in 0..UNSTRETCHINGS {
                point += place.xy() - self.at(point.into(), time_s).place.xy();
            }
        }
        point.into()
    }

    /// Returns the meeting at a depth; `None` beyond the picture's border.
    fn meeting(&self, eye: &Vector3<f64>, direction: &Vector3<f64>, depth: f64, time_s: f64) -> Option<Meeting> {
        let on_picture_m = self.beneath(&(eye + direction * depth), time_s);
        let is_on_it = [0, 1].iter().all(|&axis| on_picture_m[axis].abs() <= self.half_m[axis]);
        is_on_it.then(|| Meeting { depth, on_picture_m, normal: self.at(on_picture_m, time_s).normal() })
    }
}

#[cfg(test)]
#[path = "cloth_tests.rs"]
mod tests;
