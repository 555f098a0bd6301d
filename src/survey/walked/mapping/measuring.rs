//! The frame and the scale of a map by points that were clicked in its keyframes: their positions
//! in the stage, and the lengths between them, joined with what configured surfaces say.
//!
//! Each measurement is also tested against all others by its deleted residual, as a survey's
//! (`constraints`).

use nalgebra::{DMatrix, DVector, Matrix3, Point3, Rotation3, UnitQuaternion, Vector2, Vector3};

use super::anchoring::{FREEDOM, Fit, IntoMap, Normal, Score};
use super::views::project;
use crate::camera::{CameraModel, Pixel};
use crate::geometry::robust_kernel::median;
use crate::geometry::three_point::triangle_axes;
use crate::geometry::triangulation::nearest_to_rays;
use crate::geometry::{Body, Camera, Pose, skew};
use crate::survey::named_points::{NamedDistance, NamedPoint, NamedPoints};

/// One sigma of a click along each axis, pixels. Raised, tapes and coordinates count less.
const CLICK_SIGMA_PX: f64 = 1.0;
/// Maximum distance of a click from where the other ones put its point, pixels. Raised, a point
/// clicked on the wrong thing passes; lowered, hasty clicks are refused.
pub const MAX_CLICK_OFF_PX: f64 = 12.0;
/// Steps of a point's refinement, and of the fit.
const STEPS: usize = 20;
/// One sigma of a floor's height at a point, metres: boards and cloth are that even.
const FLOOR_SIGMA_M: f64 = 0.003;
/// One sigma of what nothing measures: metres, radians, and a factor's logarithm. Raised, rounding
/// errors grow; lowered, it pulls at what is measured.
pub const UNKNOWN: f64 = 100.0;
/// Deleted residual, in sigmas, above which a measurement contradicts the rest.
const CONTRADICTION: f64 = 4.0;
/// Minimum sine of the angle at a corner of three points that give a frame.
const MIN_SINE: f64 = 0.05;

/// A click: the pose of its keyframe, and its raw pixel.
pub type SeenFrom = (Pose<Body, Camera>, Vector2<f64>);

/// A clicked point in the map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlacedPoint {
    /// Its place, metres of the map.
    pub place: Vector3<f64>,
    /// Its covariance, with the cameras as they are.
    pub covariance: Matrix3<f64>,
    /// Largest distance of a click from it, pixels.
    pub off_px: f64,
}

/// A measurement as equations of a step of the fit.
struct Rows {
    entry: String,
    /// What it says and what the fit has, metres, if it is a length.
    length_m: Option<f64>,
    /// Residuals in metres of the map, and their derivatives by the step, with the sign of a model.
    residual: DVector<f64>,
    by_step: DMatrix<f64>,
    sigma_m: f64,
    /// Metres of the map per metre.
    scale: f64,
}

/// A measurement that everything else contradicts.
#[derive(Debug, Clone, PartialEq)]
pub struct Contradiction {
    /// Its place in the config.
    pub entry: String,
    /// The length that it states, and the one that everything else says, metres, if it is a length.
    pub lengths_m: Option<[f64; 2]>,
    /// How far it is off from everything else, metres.
    pub off_m: f64,
    /// The same in sigmas.
    pub sigmas: f64,
}

/// Returns a point where the rays of its clicks meet; `None` if they do not determine it.
pub fn placed(clicks: &[SeenFrom], camera: &CameraModel) -> Option<PlacedPoint> {
    let ray = |(pose, pixel): &SeenFrom| Some((pose.translation, pose.rotation * camera.unproject(Pixel(*pixel))?.0.push(1.0).normalize()));
    let mut place = nearest_to_rays(clicks.iter().map(ray).collect::<Option<Vec<_>>>()?)?;
    let mut covariance = Matrix3::zeros();
    for _ in 0..STEPS {
        let (mut normal, mut score) = (Matrix3::zeros(), Vector3::zeros());
        for (pose, pixel) in clicks {
            let (found, by_point) = project(camera, &pose.inverse().transform(&Point3::from(place)).coords)?;
            let by_place = by_point * pose.rotation_matrix().transpose() / CLICK_SIGMA_PX;
            normal += by_place.transpose() * by_place;
            score += by_place.transpose() * (pixel - found) / CLICK_SIGMA_PX;
        }
        covariance = normal.try_inverse()?;
        place += covariance * score;
    }
    let off = |(pose, pixel): &SeenFrom| {
        project(camera, &pose.inverse().transform(&Point3::from(place)).coords).map_or(f64::INFINITY, |(found, _)| (pixel - found).norm())
    };
    let off_px = clicks.iter().map(off).fold(0.0, f64::max);
    place.iter().all(|v| v.is_finite()).then_some(PlacedPoint { place, covariance, off_px })
}

/// Joins what was measured with what the surfaces say, `prior`; without surfaces `first` is the
/// camera whose frame the map has unless points give one. Returns the fit, and the measurement that
/// contradicts the others most, if one does.
pub fn joined(
    prior: Option<&Fit>,
    named: &NamedPoints,
    points: &[PlacedPoint],
    first: &Pose<Body, Camera>,
) -> Option<(Fit, Option<Contradiction>)> {
    let start = match prior {
        Some(fit) => *fit,
        None => Fit { at: start(named, points, first), covariance: Normal::identity() * UNKNOWN * UNKNOWN },
    };
    let rows = |at: &IntoMap| rows(at, named, points, prior.is_none());
    let information = start.covariance.cholesky()?.inverse();
    let mut fit = start;
    for _ in 0..STEPS {
        let mut normal = information;
        let mut score: Score = information * fit.at.step_to(&start.at);
        for rows in rows(&fit.at) {
            let weight = rows.sigma_m.powi(-2);
            let by_step = &rows.by_step;
            normal += (by_step.transpose() * by_step * weight).fixed_view::<FREEDOM, FREEDOM>(0, 0);
            score += (by_step.transpose() * &rows.residual * weight).fixed_rows::<FREEDOM>(0);
        }
        fit.covariance = normal.cholesky()?.inverse();
        fit.at = fit.at.moved(&(fit.covariance * score));
    }
    let contradictions = rows(&fit.at).into_iter().filter_map(|rows| rows.contradiction(&fit.covariance));
    let worst = contradictions.max_by(|a, b| a.sigmas.total_cmp(&b.sigmas));
    fit.at.is_usable().then_some((fit, worst))
}

impl Rows {
    fn contradiction(&self, covariance: &Normal) -> Option<Contradiction> {
        let n = self.residual.len();
        let explained = &self.by_step * covariance * self.by_step.transpose() / self.sigma_m.powi(2);
        let without = (DMatrix::identity(n, n) - explained).lu().solve(&self.residual)?;
        let sigmas = self.residual.dot(&without).max(0.0).sqrt() / self.sigma_m;
        let off_m = without.norm() / self.scale;
        let lengths_m = self.length_m.map(|length| [length, length + without[0] / self.scale]);
        (sigmas > CONTRADICTION && off_m.is_finite()).then(|| Contradiction { entry: self.entry.clone(), lengths_m, off_m, sigmas })
    }
}

/// Returns the equations of all measurements. The floor counts only if nothing else gives the
/// frame.
fn rows(at: &IntoMap, named: &NamedPoints, points: &[PlacedPoint], is_alone: bool) -> Vec<Rows> {
    let of_point = |(point, placed): (&NamedPoint, &PlacedPoint)| {
        let (position_m, sigma_m) = point.position_m?;
        let turned = at.turned(&position_m);
        let mut by_step = DMatrix::zeros(3, FREEDOM);
        by_step.view_mut((0, 0), (3, 3)).copy_from(&Matrix3::identity());
        by_step.view_mut((0, 3), (3, 3)).copy_from(&-skew(&turned));
        by_step.view_mut((0, 6), (3, 1)).copy_from(&turned);
        let residual = placed.place - (turned + at.shift);
        let sigma_m = (at.scale * sigma_m).hypot((placed.covariance.trace() / 3.0).sqrt());
        let residual = DVector::from_column_slice(residual.as_slice());
        Some(Rows { entry: point.entry.clone(), length_m: None, residual, by_step, sigma_m, scale: at.scale })
    };
    let of_distance = |distance: &NamedDistance| {
        let [a, b] = distance.between.map(|k| &points[k]);
        let apart = b.place - a.place;
        let along = apart / apart.norm().max(f64::MIN_POSITIVE);
        let wanted = at.scale * distance.length_m;
        let mut by_step = DMatrix::zeros(1, FREEDOM);
        by_step[(0, 6)] = wanted;
        let of_clicks = along.dot(&((a.covariance + b.covariance) * along)).max(0.0).sqrt();
        Rows {
            entry: distance.entry.clone(),
            length_m: Some(distance.length_m),
            residual: DVector::from_element(1, apart.norm() - wanted),
            by_step,
            sigma_m: (at.scale * distance.sigma_m).hypot(of_clicks),
            scale: at.scale,
        }
    };
    let positions = named.points.iter().zip(points).filter_map(of_point);
    let mut all: Vec<Rows> = positions.chain(named.distances.iter().map(of_distance)).collect();
    if let Some(floor) = named.floor.filter(|_| is_alone && positioned(named, points).len() < 3) {
        all.push(of_floor(at, floor.map(|k| &points[k])));
    }
    all
}

/// Returns the equations of a floor: its points have no height.
fn of_floor(at: &IntoMap, floor: [&PlacedPoint; 3]) -> Rows {
    let up = at.rotation * Vector3::z();
    let mut by_step = DMatrix::zeros(3, FREEDOM);
    let heights = floor.map(|point| up.dot(&(point.place - at.shift)));
    for (row, point) in floor.iter().enumerate() {
        // A step turns `up` and shifts the origin; the height falls as the model rises.
        by_step.view_mut((row, 0), (1, 3)).copy_from(&up.transpose());
        by_step.view_mut((row, 3), (1, 3)).copy_from(&(point.place - at.shift).cross(&up).transpose());
    }
    let of_clicks = floor.iter().map(|point| up.dot(&(point.covariance * up)).max(0.0)).fold(0.0, f64::max).sqrt();
    let sigma_m = (at.scale * FLOOR_SIGMA_M).hypot(of_clicks);
    let entry = "`floor` in [map]".to_owned();
    Rows { entry, length_m: None, residual: DVector::from_column_slice(&heights), by_step, sigma_m, scale: at.scale }
}

/// Returns the points with a position: in the stage and in the map.
fn positioned(named: &NamedPoints, points: &[PlacedPoint]) -> Vec<[Vector3<f64>; 2]> {
    named.points.iter().zip(points).filter_map(|(point, placed)| Some([point.position_m?.0, placed.place])).collect()
}

/// Returns a first fit without surfaces: by points with positions, by the floor, or the frame of
/// the first camera; with the scale that the lengths say.
fn start(named: &NamedPoints, points: &[PlacedPoint], first: &Pose<Body, Camera>) -> IntoMap {
    let with_positions = positioned(named, points);
    if let Some(fit) = by_positions(&with_positions) {
        return fit;
    }
    let ratio = |distance: &NamedDistance| {
        let [a, b] = distance.between.map(|k| points[k].place);
        (b - a).norm() / distance.length_m
    };
    let mut ratios: Vec<f64> = named.distances.iter().map(ratio).collect();
    if let [[a, in_map_a], [b, in_map_b]] = with_positions.as_slice() {
        ratios.push((in_map_b - in_map_a).norm() / (b - a).norm().max(f64::MIN_POSITIVE));
    }
    let scale = median(&mut ratios).filter(|s| s.is_finite() && *s > 0.0).unwrap_or(1.0);
    let floor = named.floor.and_then(|floor| Some((triangle_axes(&floor.map(|k| points[k].place), MIN_SINE)?, points[floor[0]].place)));
    let (rotation, origin) = match floor {
        Some((axes, origin)) => {
            // The cameras are above the floor.
            let is_below = axes.column(2).dot(&(first.translation - origin)) < 0.0;
            let half_turn = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
            (quaternion(&(if is_below { axes * half_turn } else { axes })), origin)
        }
        None => (first.rotation, first.translation),
    };
    let fit = IntoMap { scale, rotation, shift: origin };
    let shift = with_positions.first().map_or(origin, |[position, in_map]| in_map - fit.turned(position));
    IntoMap { shift, ..fit }
}

/// Returns the fit of three points or more: their triangle's axes, then least squares from there.
fn by_positions(pairs: &[[Vector3<f64>; 2]]) -> Option<IntoMap> {
    let corners = pairs.first().zip(pairs.get(1))?;
    let third = pairs[2..].iter().find(|third| triangle_axes(&[corners.0[0], corners.1[0], third[0]], MIN_SINE).is_some())?;
    let [in_stage, in_map] = [0, 1].map(|k| triangle_axes(&[corners.0[k], corners.1[k], third[k]], MIN_SINE));
    let rotation = quaternion(&(in_map? * in_stage?.transpose()));
    let side = |k: usize| (corners.1[k] - corners.0[k]).norm() + (third[k] - corners.0[k]).norm();
    let fit = IntoMap { scale: side(1) / side(0), rotation, shift: Vector3::zeros() };
    Some(IntoMap { shift: corners.0[1] - fit.turned(&corners.0[0]), ..fit })
}

fn quaternion(axes: &Matrix3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*axes))
}

#[cfg(test)]
mod tests {
    use super::super::super::synthetic::{LENS, camera_poses};
    use super::*;

    fn camera() -> CameraModel {
        CameraModel::new(LENS).unwrap()
    }

    fn truth() -> IntoMap {
        let rotation = UnitQuaternion::from_euler_angles(0.3, -0.5, 0.8);
        IntoMap { scale: 1.3, rotation, shift: Vector3::new(0.4, -1.0, 2.0) }
    }

    /// Points of the stage; the first three on the floor, the first at the origin, the second along
    /// x.
    fn in_stage() -> Vec<Vector3<f64>> {
        [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.5, 1.5, 0.0], [1.0, 0.7, 1.1]].map(Vector3::from).to_vec()
    }

    fn in_map() -> Vec<PlacedPoint> {
        let at = truth();
        let place = |p: &Vector3<f64>| PlacedPoint { place: at.turned(p) + at.shift, covariance: Matrix3::identity() * 1e-6, off_px: 0.5 };
        in_stage().iter().map(place).collect()
    }

    fn named(positions: &[usize], lengths: &[(usize, usize, f64)], floor: Option<[usize; 3]>) -> NamedPoints {
        let points = in_stage();
        let point = |(k, place): (usize, &Vector3<f64>)| NamedPoint {
            name: format!("{k}"),
            entry: format!("point {k}"),
            seen: Vec::new(),
            position_m: positions.contains(&k).then_some((*place, 0.003)),
        };
        let distance = |(a, b, factor): &(usize, usize, f64)| NamedDistance {
            entry: format!("distance {a} {b}"),
            between: [*a, *b],
            length_m: (points[*a] - points[*b]).norm() * factor,
            sigma_m: 0.003,
        };
        NamedPoints { points: points.iter().enumerate().map(point).collect(), distances: lengths.iter().map(distance).collect(), floor }
    }

    /// A camera above the floor, in the map.
    fn first() -> Pose<Body, Camera> {
        let at = truth();
        Pose::new(UnitQuaternion::identity(), at.turned(&Vector3::new(1.0, -3.0, 1.5)) + at.shift)
    }

    #[test]
    fn clicks_meet_at_their_point() {
        let place = Vector3::new(0.3, -0.2, 0.4);
        let pixel = |pose: &Pose<Body, Camera>| project(&camera(), &pose.inverse().transform(&Point3::from(place)).coords).unwrap().0;
        let clicks: Vec<_> = camera_poses(4).into_iter().map(|pose| (pose, pixel(&pose))).collect();
        let found = placed(&clicks, &camera()).unwrap();
        assert!((found.place - place).norm() < 1e-9 && found.off_px < 1e-6, "{found:?}");
        let mut wrong = clicks.clone();
        wrong[2].1.x += 60.0;
        assert!(placed(&wrong, &camera()).unwrap().off_px > MAX_CLICK_OFF_PX);
        assert!(placed(&[clicks[0], clicks[0]], &camera()).is_none_or(|found| found.covariance.trace() > 1.0));
        assert!(placed(&[], &camera()).is_none());
    }

    #[test]
    fn three_positions_give_frame_and_scale() {
        let (fit, contradiction) = joined(None, &named(&[0, 1, 2, 3], &[(0, 3, 1.0)], None), &in_map(), &first()).unwrap();
        assert_eq!(contradiction, None);
        let step = fit.at.step_to(&truth());
        assert!(step.norm() < 1e-6, "{step}");
        assert!((1e-4..5e-3).contains(&fit.covariance[(6, 6)].sqrt()), "{}", fit.covariance[(6, 6)].sqrt());
    }

    #[test]
    fn floor_and_one_length_give_frame_and_scale() {
        let (fit, contradiction) = joined(None, &named(&[], &[(0, 1, 1.0)], Some([0, 1, 2])), &in_map(), &first()).unwrap();
        assert_eq!(contradiction, None);
        assert!((fit.at.scale / truth().scale - 1.0).abs() < 1e-6, "{}", fit.at.scale);
        for (stage, map) in in_stage().iter().zip(in_map()) {
            let found = (fit.at.rotation.inverse() * (map.place - fit.at.shift)) / fit.at.scale;
            assert!((found - stage).norm() < 1e-5, "{found} {stage}");
        }
    }

    #[test]
    fn a_length_alone_scales_the_first_cameras_frame() {
        let (fit, _) = joined(None, &named(&[], &[(0, 3, 1.0)], None), &in_map(), &first()).unwrap();
        let anchoring = fit.anchoring();
        assert!((anchoring.length(truth().scale) - 1.0).abs() < 1e-6);
        let camera = anchoring.pose(&first());
        assert!(camera.translation.norm() < 1e-6 && camera.rotation.angle() < 1e-6);
        // With nothing measured the scale stays.
        assert!((joined(None, &named(&[], &[], None), &in_map(), &first()).unwrap().0.at.scale - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_wrong_length_is_named_and_right_ones_pass() {
        let prior = Fit { at: truth(), covariance: Normal::identity() * 1e-10 };
        let check = |lengths: &[(usize, usize, f64)]| joined(Some(&prior), &named(&[], lengths, None), &in_map(), &first()).unwrap().1;
        assert_eq!(check(&[(0, 1, 1.002), (1, 2, 0.998)]), None);
        let wrong = check(&[(0, 1, 1.0), (1, 2, 1.02)]).unwrap();
        assert_eq!(wrong.entry, "distance 1 2");
        let [stated, others] = wrong.lengths_m.unwrap();
        assert!((stated / others - 1.02).abs() < 2e-3, "{wrong:?}");
        // Two lengths that contradict each other, without surfaces.
        let alone = joined(None, &named(&[], &[(0, 1, 1.0), (1, 2, 1.05)], None), &in_map(), &first()).unwrap().1;
        assert!(alone.is_some_and(|alone| alone.sigmas > 4.0));
    }

    #[test]
    fn derivatives_agree_with_differences() {
        let named = named(&[0, 1], &[(0, 3, 1.1)], Some([0, 1, 2]));
        let at = truth().moved(&Score::from_fn(|k, _| 0.02 * (k as f64 - 3.0)));
        for (index, own) in rows(&at, &named, &in_map(), true).iter().enumerate() {
            for k in 0..FREEDOM {
                let moved = |size: f64| {
                    let at = at.moved(&Score::from_fn(|i, _| if i == k { size } else { 0.0 }));
                    rows(&at, &named, &in_map(), true)[index].residual.clone()
                };
                let difference = (moved(1e-6) - moved(-1e-6)) / 2e-6;
                let derivative = -own.by_step.column(k);
                assert!(
                    (&difference - &derivative).norm() < 1e-6 * (1.0 + derivative.norm()),
                    "{}: {k}: {difference} {derivative}",
                    own.entry
                );
            }
        }
    }
}
