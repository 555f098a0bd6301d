//! What a survey is to find, and the place of every unknown number in one vector.
//!
//! Unknown are the shape of every surface (a height and a stretch at each knot), the poses of all surfaces but the first, and, if asked, the
//! lens. The camera's motions are no part of it: they are eliminated frame by frame (`normal_equations`).

use std::sync::Arc;

use nalgebra::{DVector, UnitQuaternion, Vector1, Vector2, Vector3};

use crate::camera::{CameraModel, Intrinsics};
use crate::geometry::Pose;
use crate::geometry::bspline::BicubicSpline;
use crate::track::{BentShape, SurfaceShape, SurfaceSpec};

/// Numbers of a lens that are unknown: fx, fy, cx, cy, k1, k2, p1, p2. The skew stays, and so does k3, which no stage tells from k2.
pub const LENS_NUMBERS: usize = 8;
/// The same as columns of `Intrinsics::by_numbers`.
pub const LENS_COLUMNS: [usize; LENS_NUMBERS] = [0, 1, 2, 3, 5, 6, 7, 8];
/// Intervals of the heights along the longest side of all surfaces. Chosen: folds of a fifth of the width are met to a hundredth of their height.
/// Raised, the time grows with the cube of the unknowns; lowered, fine folds stay.
const HEIGHT_INTERVALS: f64 = 26.0;
/// The same of the stretch, which has no folds.
const STRETCH_INTERVALS: f64 = 6.0;
/// Knots of all heights at most; where surfaces have more together, their intervals are wider. Raised, the time grows with the cube.
const MOST_KNOTS: usize = 900;

/// The stage and the lens as they are known by now.
#[derive(Debug, Clone)]
pub struct StageModel {
    /// The lens.
    pub camera: CameraModel,
    /// The surfaces, bent ones all.
    pub surfaces: Vec<SurfaceSpec>,
    /// Where everything began.
    start: Start,
    places: Places,
}

#[derive(Debug, Clone)]
struct Start {
    intrinsics: Intrinsics,
    surfaces: Vec<SurfaceSpec>,
}

/// Where the unknown numbers are in the vector of all.
#[derive(Debug, Clone, PartialEq)]
pub struct Places {
    /// Of each surface's heights, one a coefficient.
    pub heights: Vec<usize>,
    /// Of each surface's stretch, two a coefficient.
    pub stretches: Vec<usize>,
    /// Of each surface's pose, [δp, δθ] in body axes; none of the first.
    pub poses: Vec<Option<usize>>,
    /// Of the lens.
    pub lens: Option<usize>,
    /// How many there are.
    pub count: usize,
}

/// A surface's shape, which a survey always has.
pub fn bent(surface: &SurfaceSpec) -> Option<&BentShape> {
    match &surface.shape {
        SurfaceShape::Bent(shape) => Some(shape),
        _ => None,
    }
}

impl StageModel {
    /// A stage as the config has it. Surfaces that are flat there become bent by nothing.
    pub fn new(camera: CameraModel, surfaces: &[SurfaceSpec], refines_lens: bool) -> Self {
        let longest = surfaces.iter().flat_map(|s| s.size_m).fold(0.0, f64::max);
        let intervals = |surface: &SurfaceSpec, spacing: f64| surface.size_m.map(|side| (side / spacing).round().max(2.0) as usize);
        let mut spacing = longest / HEIGHT_INTERVALS;
        let knots = |spacing: f64| surfaces.iter().map(|s| intervals(s, spacing)).map(|[a, b]| (a + 3) * (b + 3)).sum::<usize>();
        // Each step widens them by a tenth, until nothing is left to widen.
        while knots(spacing) > MOST_KNOTS && spacing < longest {
            spacing *= 1.1;
        }
        let model = |surface: &SurfaceSpec| {
            let shape = BentShape {
                height: BicubicSpline::zero(intervals(surface, spacing), surface.size_m),
                stretch: BicubicSpline::zero(intervals(surface, longest / STRETCH_INTERVALS), surface.size_m),
                ways: Vec::new(),
            };
            let mut surface = surface.clone();
            surface.shape = SurfaceShape::Bent(Arc::new(shape));
            surface
        };
        let surfaces: Vec<SurfaceSpec> = surfaces.iter().map(model).collect();
        let places = Places::of(&surfaces, refines_lens);
        Self { camera, start: Start { intrinsics: *camera.intrinsics(), surfaces: surfaces.clone() }, surfaces, places }
    }

    /// Where the unknown numbers are.
    pub fn places(&self) -> &Places {
        &self.places
    }

    /// The shape of surface `k`.
    pub fn shape(&self, k: usize) -> Option<&BentShape> {
        bent(&self.surfaces[k])
    }

    /// How far the lens is from where it began, in the order of [`LENS_COLUMNS`].
    pub fn lens_change(&self) -> [f64; LENS_NUMBERS] {
        let (now, then) = (lens_numbers(self.camera.intrinsics()), lens_numbers(&self.start.intrinsics));
        std::array::from_fn(|k| now[k] - then[k])
    }

    /// How far surface `k` is from where it began: [δp, δθ] in body axes.
    pub fn pose_change(&self, k: usize) -> [Vector3<f64>; 2] {
        let (now, then) = (&self.surfaces[k].pose, &self.start.surfaces[k].pose);
        [now.translation - then.translation, (now.rotation * then.rotation.inverse()).scaled_axis()]
    }

    /// The model after a step; `None` where that is no camera.
    pub fn stepped(&self, step: &DVector<f64>) -> Option<Self> {
        let mut next = self.clone();
        for (k, surface) in next.surfaces.iter_mut().enumerate() {
            let mut shape = bent(surface)?.clone();
            for (n, c) in shape.height.coefficients_mut().iter_mut().enumerate() {
                *c += Vector1::new(step[self.places.heights[k] + n]);
            }
            for (n, c) in shape.stretch.coefficients_mut().iter_mut().enumerate() {
                *c += Vector2::new(step[self.places.stretches[k] + 2 * n], step[self.places.stretches[k] + 2 * n + 1]);
            }
            surface.shape = SurfaceShape::Bent(Arc::new(shape));
            if let Some(at) = self.places.poses[k] {
                let [shift, turn] = [0, 3].map(|first| Vector3::new(step[at + first], step[at + first + 1], step[at + first + 2]));
                surface.pose = Pose::new(UnitQuaternion::from_scaled_axis(turn) * surface.pose.rotation, surface.pose.translation + shift);
            }
        }
        if let Some(at) = self.places.lens {
            let mut i = *self.camera.intrinsics();
            let [k1, k2, p1, p2, _] = &mut i.distortion;
            let numbers: [&mut f64; LENS_NUMBERS] = [&mut i.fx, &mut i.fy, &mut i.cx, &mut i.cy, k1, k2, p1, p2];
            numbers.into_iter().enumerate().for_each(|(k, number)| *number += step[at + k]);
            next.camera = CameraModel::new(i).ok()?;
        }
        Some(next)
    }
}

fn lens_numbers(i: &Intrinsics) -> [f64; LENS_NUMBERS] {
    let [k1, k2, p1, p2, _] = i.distortion;
    [i.fx, i.fy, i.cx, i.cy, k1, k2, p1, p2]
}

impl Places {
    fn of(surfaces: &[SurfaceSpec], refines_lens: bool) -> Self {
        let mut places = Self { heights: Vec::new(), stretches: Vec::new(), poses: Vec::new(), lens: None, count: 0 };
        let mut take = |n: usize| {
            places.count += n;
            places.count - n
        };
        for (k, surface) in surfaces.iter().enumerate() {
            let of = |n: Option<usize>| n.unwrap_or(0);
            places.heights.push(take(of(bent(surface).map(|s| s.height.coefficients().len()))));
            places.stretches.push(take(of(bent(surface).map(|s| 2 * s.stretch.coefficients().len()))));
            places.poses.push((k > 0).then(|| take(6)));
        }
        places.lens = refines_lens.then(|| take(LENS_NUMBERS));
        places
    }
}
