//! Poses the frames of a walk in which no configured surface is seen: by the points that frames
//! around them share, again and again, until no more are found.

use std::collections::BTreeMap;

use image::GrayImage;
use nalgebra::{Matrix2, Point3, Vector2, Vector3};
use rayon::prelude::*;

use super::bundle::{self, ALL_ROUNDS, Cloud};
use super::tracks::Recognition;
use super::views::{Rates, View, Views};
use crate::camera::{CameraModel, Pixel, Shutter};
use crate::geometry::ransac::{self, Estimator, Order};
use crate::geometry::resection::{MovingCamera, Observation, resect, squared_residual};
use crate::geometry::three_point::three_point;
use crate::geometry::{Body, Camera, Pose};
use crate::light::CameraCurve;

/// Maximum number of times that frames are posed and everything is adjusted. Raised, longer parts
/// without a surface are posed from their ends; lowered, it takes less time.
const MAX_GROWTHS: usize = 12;
/// Rounds of the adjustment while frames are still added.
const FEW_ROUNDS: usize = 2;
/// Number of posed frames on each side that a frame is compared with. Raised, it takes longer;
/// lowered, frames behind a gap find too few points.
const NEIGHBOURS: usize = 3;
/// Minimum number of points that agree with a pose. Raised, plain parts of the walk are lost;
/// lowered, look-alikes pose frames.
const MIN_AGREEING: usize = 30;
/// The same as a share of the points that were recognised. Raised, frames with many look-alikes are
/// lost; lowered, repeated boards and stones pose frames one board off.
const MIN_SHARE: f64 = 0.3;
/// Maximum distance of a point from where a pose puts it, pixels. Raised, look-alikes agree;
/// lowered, points that are not adjusted yet do not.
const MAX_OFF_PX: f64 = 6.0;
/// Maximum number of samples of three points. Raised, frames with more look-alikes are posed.
const SAMPLES: usize = 1000;
/// Confidence at which sampling ends.
const CONFIDENCE: f64 = 0.9999;
/// Steps of a pose's refinement.
const REFINING_STEPS: usize = 20;
/// Seed of the samples: the result is the same every time.
const SEED: u64 = 0x6772_6f77;

/// A frame of the walk.
#[derive(Debug, Clone, Copy)]
pub struct Shot<'a> {
    /// Its picture.
    pub picture: &'a GrayImage,
    /// Its pose, if it is known already.
    pub start: Option<Pose<Body, Camera>>,
    /// How the camera moved, as far as known.
    pub rates: Rates,
    /// Whether that pose was measured on what gives frame and scale, or is to do so.
    pub is_anchored: bool,
}

/// The camera that took the frames.
#[derive(Debug, Clone)]
pub struct Lens<'a> {
    /// The model.
    pub camera: CameraModel,
    /// Its shutter; a readout of 0 is a global or unknown one.
    pub shutter: Shutter,
    /// The light that its grey levels stand for.
    pub curve: CameraCurve,
    /// Black where its pictures are to be ignored.
    pub mask: Option<&'a GrayImage>,
}

/// The posed frames, and the points that they share.
#[derive(Debug)]
pub struct Grown {
    /// Indices of the posed frames, in order.
    pub frames: Vec<usize>,
    /// Their poses and points.
    pub cloud: Cloud,
}

impl<'a> Lens<'a> {
    /// Returns posed frames as the mapping looks at them.
    pub fn views(&self, views: Vec<View<'a>>) -> Views<'a> {
        Views { views, camera: self.camera, shutter: self.shutter, curve: self.curve.clone(), mask: self.mask }
    }
}

/// Poses frames from those that have a start, and adjusts all poses and points. `None` if the
/// equations have no solution, or the work was stopped.
pub fn grown<'a>(shots: &[Shot<'a>], lens: &Lens<'a>, recognition: &mut Recognition, goes_on: &(dyn Fn() -> bool + Sync)) -> Option<Grown> {
    let mut poses: Vec<Option<Pose<Body, Camera>>> = shots.iter().map(|shot| shot.start).collect();
    let mut rates: Vec<Rates> = shots.iter().map(|shot| shot.rates).collect();
    for growth in 0.. {
        let frames: Vec<usize> = (0..shots.len()).filter(|k| poses[*k].is_some()).collect();
        let view =
            |k: &usize| Some(View { picture: shots[*k].picture, pose: poses[*k]?, rates: rates[*k], is_anchored: shots[*k].is_anchored });
        let views = lens.views(frames.iter().filter_map(view).collect());
        let missing: Vec<usize> = (0..shots.len()).filter(|k| poses[*k].is_none()).collect();
        let is_last = missing.is_empty() || growth == MAX_GROWTHS;
        let tracks = recognition.tracks(&views, &frames, goes_on)?;
        let cloud = bundle::adjusted(&views, tracks, if is_last { ALL_ROUNDS } else { FEW_ROUNDS }, goes_on)?;
        let found = if is_last { Vec::new() } else { posed(&cloud, &frames, &missing, lens, recognition, goes_on)? };
        tracing::debug!(growth, posed = frames.len(), missing = missing.len(), found = found.len(), points = cloud.points.len(), "growth");
        if found.is_empty() {
            return Some(without_weak(Grown { frames, cloud }, shots));
        }
        frames.iter().zip(&cloud.rates).for_each(|(k, found)| rates[*k] = *found);
        // Anchored frames start from what their surfaces gave, which stays their prior.
        for (k, pose) in frames.iter().zip(&cloud.poses).filter(|(k, _)| !shots[**k].is_anchored) {
            poses[*k] = Some(*pose);
        }
        found.into_iter().for_each(|(k, pose)| poses[k] = Some(pose));
    }
    None
}

/// Drops frames that were posed by points of which too few remained.
fn without_weak(grown: Grown, shots: &[Shot<'_>]) -> Grown {
    let seen = grown.cloud.seen_by_view();
    let is_kept = |view: &usize| shots[grown.frames[*view]].is_anchored || seen[*view] >= MIN_AGREEING;
    let kept: Vec<usize> = (0..grown.frames.len()).filter(is_kept).collect();
    if kept.len() == grown.frames.len() {
        return grown;
    }
    Grown { frames: kept.iter().map(|view| grown.frames[*view]).collect(), cloud: grown.cloud.of_views(&kept) }
}

/// Returns the poses of those missing frames that show enough of the points.
pub(super) fn posed(
    cloud: &Cloud,
    frames: &[usize],
    missing: &[usize],
    lens: &Lens<'_>,
    recognition: &mut Recognition,
    goes_on: &(dyn Fn() -> bool + Sync),
) -> Option<Vec<(usize, Pose<Body, Camera>)>> {
    let neighbours: Vec<Vec<usize>> = missing.iter().map(|k| around(frames, *k)).collect();
    let pairs = missing.iter().zip(&neighbours).flat_map(|(k, near)| near.iter().map(move |view| (*k, frames[*view])));
    recognition.compare(pairs.map(|(a, b)| (a.min(b), a.max(b))), goes_on)?;
    let mut point_of: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    for (index, point) in cloud.points.iter().enumerate() {
        point_of.extend(point.sightings.iter().map(|seen| ((seen.view, seen.feature), index)));
    }
    let recognition = &*recognition;
    let pose = |(k, near): (&usize, &Vec<usize>)| -> Option<(usize, Pose<Body, Camera>)> {
        let mut seen: BTreeMap<usize, usize> = BTreeMap::new();
        for view in near.iter().filter(|_| goes_on()) {
            for [own, other] in recognition.alike(*k, frames[*view]) {
                seen.extend(point_of.get(&(*view, other)).map(|point| (*point, own)));
            }
        }
        let sightings: Vec<Seen> = seen
            .into_iter()
            .filter_map(|(point, feature)| {
                let (pixel, sigma_px) = recognition.place(*k, feature);
                Seen::new(cloud.points[point].place, pixel, sigma_px, &lens.camera)
            })
            .collect();
        Some((*k, resected(&sightings, &lens.camera)?))
    };
    let found = missing.par_iter().zip(&neighbours).map(pose).collect::<Vec<_>>();
    goes_on().then(|| found.into_iter().flatten().collect())
}

/// Returns the views nearest to a frame in the walk, on both sides of it.
fn around(frames: &[usize], k: usize) -> Vec<usize> {
    let at = frames.partition_point(|frame| *frame < k);
    (at.saturating_sub(NEIGHBOURS)..frames.len().min(at + NEIGHBOURS)).collect()
}

/// A point that a frame shows.
struct Seen {
    place: Vector3<f64>,
    pixel: Vector2<f64>,
    sigma_px: f64,
    /// Its direction in camera axes, of unit length.
    ray: Vector3<f64>,
}

impl Seen {
    fn new(place: Vector3<f64>, pixel: Vector2<f64>, sigma_px: f64, camera: &CameraModel) -> Option<Self> {
        Some(Self { place, pixel, sigma_px, ray: camera.unproject(Pixel(pixel))?.0.push(1.0).normalize() })
    }
}

/// The search for a pose.
struct Poses<'a> {
    seen: &'a [Seen],
    /// Maximum distance between directions of unit length, squared.
    most: f64,
}

impl Poses<'_> {
    fn squared_off(&self, pose: &Pose<Camera, Body>, seen: &Seen) -> f64 {
        (pose.transform(&Point3::from(seen.place)).coords.normalize() - seen.ray).norm_squared()
    }
}

impl Estimator<3> for Poses<'_> {
    type Model = Pose<Camera, Body>;

    fn count(&self) -> usize {
        self.seen.len()
    }

    fn models(&self, sample: [usize; 3]) -> impl Iterator<Item = Self::Model> {
        three_point(&sample.map(|k| self.seen[k].place), &sample.map(|k| self.seen[k].ray)).into_iter()
    }

    fn score(&self, pose: &Self::Model, bar: f64) -> Option<f64> {
        let mut cost = 0.0;
        for seen in self.seen {
            cost += self.squared_off(pose, seen).min(self.most);
            // The cost can only grow.
            if -cost <= bar {
                return None;
            }
        }
        Some(-cost)
    }

    fn agrees(&self, pose: &Self::Model, datum: usize) -> bool {
        self.squared_off(pose, &self.seen[datum]) < self.most
    }
}

/// Returns the pose of a frame that shows some points, if enough of them agree with it.
fn resected(seen: &[Seen], camera: &CameraModel) -> Option<Pose<Body, Camera>> {
    let most = (MAX_OFF_PX / camera.intrinsics().fx).powi(2);
    let options = ransac::Options {
        samples: SAMPLES,
        confidence: Some(CONFIDENCE),
        order: Order::Even,
        least_score: f64::NEG_INFINITY,
        keep: 1,
        seed: SEED,
    };
    let search = Poses { seen, most };
    let (_, start) = ransac::search(&search, &options).into_iter().next()?;
    let observation = |seen: &Seen| Observation {
        point: seen.place.into(),
        pixel: seen.pixel,
        information: Matrix2::identity() / seen.sigma_px.powi(2),
        delay_s: 0.0,
        group: 0,
    };
    // Look-alikes would widen the scale by which the refinement judges residuals.
    let right: Vec<Observation> = (0..seen.len()).filter(|k| search.agrees(&start, *k)).map(|k| observation(&seen[k])).collect();
    let still = MovingCamera::still(camera);
    let pose = resect(&start, &still, &right, REFINING_STEPS)?.pose;
    let off_px = |seen: &Seen| squared_residual(&pose, &still, &observation(seen)).map(|squared| squared.sqrt() * seen.sigma_px);
    let agreeing = seen.iter().filter(|seen| off_px(seen).is_some_and(|px| px < MAX_OFF_PX)).count();
    (agreeing >= MIN_AGREEING && agreeing as f64 >= MIN_SHARE * seen.len() as f64).then(|| pose.inverse())
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::super::super::synthetic::{LENS, camera_poses};
    use super::*;

    /// Points that a camera sees, some of them taken for others.
    fn seen(pose: &Pose<Body, Camera>, count: usize, wrong: usize) -> Vec<Seen> {
        let camera = CameraModel::new(LENS).unwrap();
        let picture = GrayImage::new(1280, 720);
        let lens = Lens { camera, shutter: Shutter::default(), curve: CameraCurve::default(), mask: None };
        let views = lens.views(vec![View { picture: &picture, pose: *pose, rates: [Vector3::zeros(); 2], is_anchored: false }]);
        let mut random = Pcg64Mcg::seed_from_u64(4);
        let mut seen = Vec::new();
        while seen.len() < count {
            let place = Vector3::new(random.random_range(-1.5..1.5), random.random_range(-1.0..1.0), random.random_range(-0.5..0.5));
            let Some(pixel) = views.pixel(0, &place) else { continue };
            let off = if seen.len() < wrong { 300.0 } else { 0.7 };
            let noisy = pixel + Vector2::from_fn(|_, _| random.random_range(-off..off));
            seen.extend(Seen::new(place, noisy, 0.5, &camera));
        }
        seen
    }

    #[test]
    fn a_frame_is_posed_by_points_of_which_half_are_look_alikes() {
        let camera = CameraModel::new(LENS).unwrap();
        for truth in camera_poses(5) {
            let found = resected(&seen(&truth, 160, 80), &camera).expect("enough agree");
            assert!((found.translation - truth.translation).norm() < 5e-3 && found.rotation.angle_to(&truth.rotation) < 2e-3);
        }
    }

    #[test]
    fn look_alikes_alone_pose_no_frame() {
        let camera = CameraModel::new(LENS).unwrap();
        assert!(resected(&seen(&camera_poses(1)[0], 300, 300), &camera).is_none());
        assert!(resected(&seen(&camera_poses(1)[0], MIN_AGREEING - 1, 0), &camera).is_none());
        assert!(resected(&[], &camera).is_none());
    }

    #[test]
    fn frames_nearest_in_the_walk_pose_a_frame() {
        assert_eq!(around(&[0, 1, 2, 3, 7, 8, 9, 10], 5), [1, 2, 3, 4, 5, 6]);
        assert_eq!(around(&[7, 8], 0), [0, 1]);
        assert!(around(&[], 3).is_empty());
    }
}
