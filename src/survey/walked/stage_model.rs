//! The model of a survey, and the index of every unknown in one vector.
//!
//! Unknown are the shape of every surface (a height and a stretch at each knot), the poses of all
//! surfaces but the first, the stage's size if something was measured, and, if requested, the lens
//! and the readout. The camera's motions are not included: they are eliminated frame by frame
//! (`normal_equations`).

use std::sync::Arc;

use nalgebra::{DVector, UnitQuaternion, Vector1, Vector2, Vector3};

use crate::camera::{CameraModel, Intrinsics};
use crate::geometry::bspline::BicubicSpline;
use crate::geometry::{Body, Camera, Pose, skew};
use crate::track::{BentShape, SurfaceShape, SurfaceSpec};

/// Number of unknown lens parameters: fx, fy, cx, cy, k1, k2, p1, p2. The skew is fixed, and so is
/// k3, which a stage cannot separate from k2.
pub const LENS_NUMBERS: usize = 8;
/// The same as columns of `Intrinsics::by_numbers`.
pub const LENS_COLUMNS: [usize; LENS_NUMBERS] = [0, 1, 2, 3, 5, 6, 7, 8];
/// Number of intervals of the heights along the longest side of all surfaces. Chosen: folds of a
/// fifth of the width are fitted to a hundredth of their height. Raised, the time grows with the
/// cube of the unknowns; lowered, fine folds stay.
const HEIGHT_INTERVALS: f64 = 26.0;
/// The same for the stretch, which has no folds.
const STRETCH_INTERVALS: f64 = 6.0;
/// Maximum number of knots of all heights; if the surfaces would have more, their intervals are
/// widened. Raised, the time grows with the cube.
const MAX_KNOTS: usize = 900;

/// The current estimate of stage and lens.
#[derive(Debug, Clone)]
pub struct StageModel {
    /// The lens.
    pub camera: CameraModel,
    /// The surfaces, all with a bent shape.
    pub surfaces: Vec<SurfaceSpec>,
    /// How much larger the stage is than `size_m` states, as a fraction; every surface's stretch
    /// includes it.
    growth: f64,
    readout_s: f64,
    /// The start of the adjustment.
    start: Start,
    places: Places,
}

#[derive(Debug, Clone)]
struct Start {
    intrinsics: Intrinsics,
    readout_s: f64,
    surfaces: Vec<SurfaceSpec>,
}

/// The indices of the unknowns in the common vector.
#[derive(Debug, Clone, PartialEq)]
pub struct Places {
    /// First index of each surface's heights, one per coefficient.
    pub heights: Vec<usize>,
    /// First index of each surface's stretch, two per coefficient.
    pub stretches: Vec<usize>,
    /// First index of each surface's pose, [δp, δθ] in body axes; `None` for the first.
    pub poses: Vec<Option<usize>>,
    /// Index of the stage's size, if something was measured; see [`StageModel::growth`].
    pub size: Option<usize>,
    /// Index of the readout, if the lens is refined.
    pub readout: Option<usize>,
    /// First index of the lens, the last of all.
    pub lens: Option<usize>,
    /// Number of unknowns.
    pub count: usize,
}

/// A point of a picture, in the stage.
#[derive(Debug, Clone)]
pub struct ModelPoint {
    /// Its position in the stage, metres.
    pub place: Vector3<f64>,
    /// Indices of unknowns, with the point's derivative by each.
    pub by_model: Vec<(usize, Vector3<f64>)>,
}

/// Returns the distance from a camera to the nearest surface's centre, metres.
pub fn distance_m(surfaces: &[SurfaceSpec], pose: &Pose<Body, Camera>) -> f64 {
    surfaces.iter().map(|s| (s.pose.translation - pose.translation).norm()).fold(f64::INFINITY, f64::min)
}

/// Returns a surface's bent shape, which every surface of a survey has.
pub fn bent(surface: &SurfaceSpec) -> Option<&BentShape> {
    match &surface.shape {
        SurfaceShape::Bent(shape) => Some(shape),
        _ => None,
    }
}

impl StageModel {
    /// Creates the model of a stage as configured. Flat surfaces become bent ones with zero bend.
    /// `has_measurements` tells whether anything other than `size_m` determines the stage's size.
    pub fn new(camera: CameraModel, surfaces: &[SurfaceSpec], refines_lens: bool, has_measurements: bool) -> Self {
        let longest = surfaces.iter().flat_map(|s| s.size_m).fold(0.0, f64::max);
        let intervals = |surface: &SurfaceSpec, spacing: f64| surface.size_m.map(|side| (side / spacing).round().max(2.0) as usize);
        let mut spacing = longest / HEIGHT_INTERVALS;
        let knots = |spacing: f64| surfaces.iter().map(|s| intervals(s, spacing)).map(|[a, b]| (a + 3) * (b + 3)).sum::<usize>();
        // Each step widens them by a tenth, until nothing is left to widen.
        while knots(spacing) > MAX_KNOTS && spacing < longest {
            spacing *= 1.1;
        }
        let grids = |surface: &SurfaceSpec| [intervals(surface, spacing), intervals(surface, longest / STRETCH_INTERVALS)];
        Self::with_grids(camera, surfaces, grids, refines_lens, has_measurements)
    }

    /// Creates the model of a stage whose surfaces stay flat; only their poses are unknown. Their
    /// splines have the fewest coefficients possible, for the modes of the poses' uncertainty.
    pub fn flat(camera: CameraModel, surfaces: &[SurfaceSpec]) -> Self {
        Self::with_grids(camera, surfaces, |_| [[1, 1]; 2], false, false)
    }

    /// Creates a model; `grids` returns the intervals of a surface's height and stretch.
    fn with_grids(
        camera: CameraModel,
        surfaces: &[SurfaceSpec],
        grids: impl Fn(&SurfaceSpec) -> [[usize; 2]; 2],
        refines_lens: bool,
        has_measurements: bool,
    ) -> Self {
        let model = |surface: &SurfaceSpec| {
            let [of_height, of_stretch] = grids(surface);
            let shape = BentShape {
                height: BicubicSpline::zero(of_height, surface.size_m),
                stretch: BicubicSpline::zero(of_stretch, surface.size_m),
                ways: Vec::new(),
            };
            let mut surface = surface.clone();
            surface.shape = SurfaceShape::Bent(Arc::new(shape));
            surface
        };
        let surfaces: Vec<SurfaceSpec> = surfaces.iter().map(model).collect();
        let places = Places::of(&surfaces, refines_lens, has_measurements);
        let start = Start { intrinsics: *camera.intrinsics(), readout_s: 0.0, surfaces: surfaces.clone() };
        Self { camera, growth: 0.0, readout_s: 0.0, start, surfaces, places }
    }

    /// Sets the readout time, as far as known.
    pub fn with_readout(mut self, readout_s: f64) -> Self {
        (self.readout_s, self.start.readout_s) = (readout_s, readout_s);
        self
    }

    /// Returns the readout time from the first row to the last, seconds; negative if the rows are
    /// read from the bottom up.
    pub fn readout_s(&self) -> f64 {
        self.readout_s
    }

    /// Returns the change of the readout since the start, seconds.
    pub fn readout_change_s(&self) -> f64 {
        self.readout_s - self.start.readout_s
    }

    /// Returns the indices of the unknowns.
    pub fn places(&self) -> &Places {
        &self.places
    }

    /// Returns the shape of surface `k`.
    pub fn shape(&self, k: usize) -> Option<&BentShape> {
        bent(&self.surfaces[k])
    }

    /// Returns how much larger the stage is than `size_m` states, as a fraction.
    pub fn growth(&self) -> f64 {
        self.growth
    }

    /// Returns a point of the picture of surface `k`, with its derivatives.
    pub fn point(&self, k: usize, on_picture_m: [f64; 2]) -> ModelPoint {
        let surface = &self.surfaces[k];
        let from_centre = surface.pose.rotation * surface.shape.at(on_picture_m).place;
        let axes = surface.pose.rotation_matrix();
        let [across, up, out]: [Vector3<f64>; 3] = std::array::from_fn(|axis| axes.column(axis).into_owned());
        let mut by_model = Vec::with_capacity(16 * 3 + 7 + LENS_NUMBERS);
        if let Some(shape) = self.shape(k) {
            by_model.extend(shape.height.support(on_picture_m).weights().map(|(n, w)| (self.places.heights[k] + n, out * w)));
            for (n, w) in shape.stretch.support(on_picture_m).weights() {
                let at = self.places.stretches[k] + 2 * n;
                by_model.extend([(at, across * w), (at + 1, up * w)]);
            }
        }
        if let Some(at) = self.places.poses[k] {
            let by_rotation = -skew(&from_centre);
            by_model.extend((0..3).map(|axis| (at + axis, Vector3::ith(axis, 1.0))));
            by_model.extend((0..3).map(|axis| (at + 3 + axis, by_rotation.column(axis).into_owned())));
        }
        by_model.extend(self.places.size.map(|at| (at, across * on_picture_m[0] + up * on_picture_m[1])));
        ModelPoint { place: from_centre + surface.pose.translation, by_model }
    }

    /// Returns the start position of surface `k` relative to the first one's centre, metres.
    pub fn start_from_first(&self, k: usize) -> Vector3<f64> {
        self.start.surfaces[k].pose.translation - self.start.surfaces[0].pose.translation
    }

    /// Returns the change of the lens since the start, in the order of [`LENS_COLUMNS`].
    pub fn lens_change(&self) -> [f64; LENS_NUMBERS] {
        let (now, then) = (lens_numbers(self.camera.intrinsics()), lens_numbers(&self.start.intrinsics));
        std::array::from_fn(|k| now[k] - then[k])
    }

    /// Returns the change of surface `k`'s pose since the start: [δp, δθ] in body axes.
    pub fn pose_change(&self, k: usize) -> [Vector3<f64>; 2] {
        let (now, then) = (&self.surfaces[k].pose, &self.start.surfaces[k].pose);
        [now.translation - then.translation, (now.rotation * then.rotation.inverse()).scaled_axis()]
    }

    /// Returns the model after a step; `None` if the camera becomes invalid.
    pub fn stepped(&self, step: &DVector<f64>) -> Option<Self> {
        let mut next = self.clone();
        let growth = self.places.size.map_or(0.0, |at| step[at]);
        next.growth += growth;
        next.readout_s += self.places.readout.map_or(0.0, |at| step[at]);
        for (k, surface) in next.surfaces.iter_mut().enumerate() {
            let mut shape = bent(surface)?.clone();
            for (n, c) in shape.height.coefficients_mut().iter_mut().enumerate() {
                *c += Vector1::new(step[self.places.heights[k] + n]);
            }
            let middles = shape.stretch.middles();
            for (n, c) in shape.stretch.coefficients_mut().iter_mut().enumerate() {
                let at = self.places.stretches[k] + 2 * n;
                *c += Vector2::new(step[at], step[at + 1]) + Vector2::from(middles(n)) * growth;
            }
            surface.shape = SurfaceShape::Bent(Arc::new(shape));
            if let Some(at) = self.places.poses[k] {
                let [shift, rotation] = [0, 3].map(|first| Vector3::new(step[at + first], step[at + first + 1], step[at + first + 2]));
                surface.pose =
                    Pose::new(UnitQuaternion::from_scaled_axis(rotation) * surface.pose.rotation, surface.pose.translation + shift);
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
    fn of(surfaces: &[SurfaceSpec], refines_lens: bool, has_measurements: bool) -> Self {
        let mut places =
            Self { heights: Vec::new(), stretches: Vec::new(), poses: Vec::new(), size: None, readout: None, lens: None, count: 0 };
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
        places.size = has_measurements.then(|| take(1));
        places.readout = refines_lens.then(|| take(1));
        places.lens = refines_lens.then(|| take(LENS_NUMBERS));
        places
    }
}
