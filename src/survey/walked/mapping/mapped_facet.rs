//! A facet as the map has it: in the stage's frame, at its scale, with all that is uncertain about
//! where it stands.

use std::sync::Arc;

use nalgebra::{Point3, Vector1};

use super::anchoring::{Anchoring, FrameWay};
use crate::geometry::bspline::BicubicSpline;
use crate::geometry::{Body, Pose, SurfaceFrame};
use crate::track::{BentShape, Facet, FacetTexture, ShapeWay, SurfaceShape, SurfaceSpec};

/// Factor on the sigma of the map: keyframes share errors of curve, blur and texture, which the
/// adjustment takes to be independent. With 2 the squared errors on a set of planks, brick and
/// crates are a fifth of the covariance. Raised, poses seem less certain than they are; lowered,
/// more.
const SHARED_ERRORS: f64 = 2.0;

/// Returns an adjusted surface as a facet of the stage, with the ways in which frame and scale may
/// be off beside those of the facet itself.
pub fn mapped_facet(surface: &SurfaceSpec, texture: &FacetTexture, anchoring: &Anchoring, ways: &[FrameWay]) -> Facet {
    let (size_m, pose) = (surface.size_m.map(|side| anchoring.length(side)), anchoring.pose(&surface.pose));
    let shape = match &surface.shape {
        SurfaceShape::Bent(shape) => {
            let mut shape = with_shared_errors(&scaled(shape, size_m, anchoring.length(1.0)));
            shape.ways.extend(ways.iter().map(|way| frame_way(way, &shape, &pose)).collect::<Vec<_>>());
            SurfaceShape::Bent(Arc::new(shape))
        }
        shape => shape.clone(),
    };
    Facet { name: surface.name.clone(), size_m, pose, shape, texture: texture.clone() }
}

/// Returns a shape of a surface of this size, with all lengths multiplied by a factor.
fn scaled(shape: &BentShape, size_m: [f64; 2], factor: f64) -> BentShape {
    fn spline<const N: usize>(spline: &BicubicSpline<N>, size_m: [f64; 2], factor: f64) -> BicubicSpline<N> {
        let mut scaled = BicubicSpline::zero(spline.intervals(), size_m);
        scaled.coefficients_mut().iter_mut().zip(spline.coefficients()).for_each(|(own, c)| *own = c * factor);
        scaled
    }
    let way = |way: &ShapeWay| ShapeWay { height: spline(&way.height, size_m, factor), stretch: spline(&way.stretch, size_m, factor) };
    BentShape {
        height: spline(&shape.height, size_m, factor),
        stretch: spline(&shape.stretch, size_m, factor),
        ways: shape.ways.iter().map(way).collect(),
    }
}

/// Returns a way of the whole stage as one of a facet. Its points move linearly over the facet,
/// which the splines repeat exactly.
fn frame_way(way: &FrameWay, shape: &BentShape, pose: &Pose<Body, SurfaceFrame>) -> ShapeWay {
    let moved = |[x, y]: [f64; 2]| pose.rotation.inverse() * way.of(&pose.transform(&Point3::new(x, y, 0.0)).coords);
    let mut out = ShapeWay { height: shape.height.clone(), stretch: shape.stretch.clone() };
    let at = out.height.middles();
    out.height.coefficients_mut().iter_mut().enumerate().for_each(|(n, c)| *c = Vector1::new(moved(at(n)).z));
    let at = out.stretch.middles();
    out.stretch.coefficients_mut().iter_mut().enumerate().for_each(|(n, c)| *c = moved(at(n)).xy());
    out
}

/// Returns a shape with the errors that all keyframes share in its modes of uncertainty.
fn with_shared_errors(shape: &BentShape) -> BentShape {
    let mut shape = shape.clone();
    for way in &mut shape.ways {
        way.height.coefficients_mut().iter_mut().for_each(|c| *c *= SHARED_ERRORS);
        way.stretch.coefficients_mut().iter_mut().for_each(|c| *c *= SHARED_ERRORS);
    }
    shape
}
