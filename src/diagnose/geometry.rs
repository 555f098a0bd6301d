//! Compares the configured lens, shapes and positions with how the surfaces are seen, and names and
//! tries what would fit.

use nalgebra::Vector2;

use super::corners::{begun_at, corners_of, top_left};
use super::finding::{Finding, known_to, list, written};
use super::fit::{AS_CONFIGURED, CUT, Found, Shape, Views};
use super::{Shown, Trial};
use crate::camera::{CameraModel, Intrinsics, LensGuess};
use crate::frame::Frame;
use crate::geometry::robust_kernel::median;
use crate::geometry::{Body, Pose, SurfaceFrame};
use crate::track::{SurfaceSpec, SurfaceView};
use crate::tracker::TrackerSetup;

/// Maximum number of views used per surface. Chosen for time, which grows with each. Raised,
/// factors are known better.
const MAX_VIEWS: usize = 10;
/// Maximum excess over the free homographies for a trial to fit: in squared sigmas per match, and
/// as a fraction of the homographies' own residual. Chosen, not tuned. Raised, wrong shapes fit;
/// lowered, right ones do not fit if the cloth has folds.
const SLACK: (f64, f64) = (0.12, 0.2);
/// Minimum deviation of a ratio and of a focal length from the config's (fractions, and in sigmas)
/// to be reported. Chosen: a tape measure and a calibration are better than the first two. Raised,
/// smaller mistakes pass; lowered, right configs are doubted.
const NEAR_RATIO: f64 = 0.025;
const NEAR_FOCAL: f64 = 0.05;
const SIGMAS: f64 = 4.0;
/// Minimum gain per match, in squared sigmas, for a better ratio or focal length to be reported if
/// the config's fits already. Chosen, not tuned. Raised, only larger mistakes are reported;
/// lowered, right configs are doubted.
const MIN_GAIN: f64 = 0.06;
/// Logarithm of a factor above which neither folds of a cloth nor an ordinary calibration error
/// explain it, so the finding is a doubt instead of a warning. Chosen, not tuned. Raised, more are
/// warnings.
const LARGE_FACTOR: f64 = 0.08;
/// Difference of residuals, squared sigmas per match, by which one of two explanations is clearly
/// better. Raised, more are treated as equal.
const CLEARLY: f64 = 0.02;
/// Minimum fraction of the best factor's gain that a swap of width and height must reach to be the
/// cause. Lowered, other mistakes pass for a swap.
const SWAPPED: f64 = 0.8;
/// Logarithm of the pixel ratio below which pixels count as square, as a lens may cause it. Raised,
/// slightly stretched clips pass.
const MIN_STRETCH: f64 = 0.03;
/// Maximum logarithm of the pixel ratio: 2.2 times. Anamorphic lenses squeeze by 2, programs by
/// 1.33. Raised, a wrong size passes for a stretched clip.
const MAX_STRETCH: f64 = 0.79;
/// Minimum |ln(width / height)| for a swap of width and height to be considered: a nearly square
/// surface looks the same when swapped. Chosen, not tuned. Raised, fewer nearly square surfaces can
/// be reported as swapped; lowered, a coincidence may be reported.
const SAME_RATIO: f64 = 0.06;
/// Minimum displacement of a surface to be reported: as a fraction of the camera's distance, and in
/// degrees. Chosen: far beyond the errors of a pose. Raised, misplaced surfaces pass; lowered,
/// right ones are called misplaced.
const MAX_SHIFT: f64 = 0.1;
const MAX_ROTATION_DEG: f64 = 12.0;
/// Maximum scatter of the displacement between frames, as a fraction of it. Raised, wrong matches
/// pass for a displaced surface; lowered, a displaced one that appears small is not reported.
const MAX_SCATTER: f64 = 0.3;

/// Judges the geometry from the views; `views` holds those of each frame.
pub fn of_views(shown: &Shown<'_>, views: &[Vec<SurfaceView>]) -> Vec<Finding> {
    let Shown { setup, frames, is_followed, is_explained, guess, .. } = *shown;
    let count = |s: usize| views.iter().flatten().filter(|v| v.surface as usize == s).count();
    let Some(main) = (0..setup.stage.surfaces.len()).max_by_key(|s| (count(*s), usize::MAX - s)) else { return Vec::new() };
    let seen = views_of(setup, views, main);
    if seen.views.is_empty() {
        return Vec::new();
    }
    let case = Case { setup, frames, main, spec: &setup.stage.surfaces[main], floor: seen.floor(), seen, guess };
    let left = case.seen.left(AS_CONFIGURED);
    tracing::debug!(left, floor = case.floor, views = case.seen.views.len(), "lens and shape as configured");
    if !case.fits(left) && !is_explained {
        match case.misfit() {
            Some(finding) => return vec![finding],
            // If it is tracked, a misfit that no shape and no lens explains is caused by motion
            // within the frames, not by the config.
            None if !is_followed => return vec![case.no_flat_picture()],
            None => {}
        }
    }
    let mut findings = if is_explained { Vec::new() } else { case.shape_as_seen(left) };
    let others = (0..setup.stage.surfaces.len()).filter(|s| *s != main);
    findings.extend(others.filter_map(|other| case.place_of(views, other)));
    if !is_followed && findings.is_empty() && case.is_on_its_side() {
        findings.push(Finding::doubt(format!("{}: it appears on its side: turn the picture's file by 90 degrees", case.spec.name)));
    }
    findings
}

/// Returns the views of one surface, at most [`MAX_VIEWS`], spread over the frames.
fn views_of<'a>(setup: &TrackerSetup, views: &'a [Vec<SurfaceView>], surface: usize) -> Views<'a> {
    let all: Vec<&SurfaceView> = views.iter().flatten().filter(|v| v.surface as usize == surface).collect();
    let spec = &setup.stage.surfaces[surface];
    let step = all.len().div_ceil(MAX_VIEWS).max(1);
    Views {
        camera: setup.camera,
        size_m: spec.size_m,
        artwork_px: [f64::from(spec.artwork.width()), f64::from(spec.artwork.height())],
        views: all.into_iter().step_by(step).collect(),
    }
}

/// A surface's pose in its body as seen in one frame, and its distance from the camera, metres.
struct Standing {
    pose: Pose<Body, SurfaceFrame>,
    distance: f64,
}

/// Returns how far the frames disagree about a surface's pose, metres and degrees: the median
/// distance of the frames from the one with which the others agree most. 0 for a single frame.
fn scatter(seen: &[Standing]) -> [f64; 2] {
    let shift = |a: &Standing, b: &Standing| (a.pose.translation - b.pose.translation).norm();
    let rotation_deg = |a: &Standing, b: &Standing| a.pose.angle_to(&b.pose).to_degrees();
    let least = |off: &dyn Fn(&Standing, &Standing) -> f64| {
        let from = |a: &Standing| median(&mut seen.iter().map(|b| off(a, b)).collect::<Vec<_>>()).unwrap_or(0.0);
        seen.iter().map(from).fold(f64::INFINITY, f64::min)
    };
    [least(&shift), least(&rotation_deg)]
}

/// The surface with the most views, and those views.
struct Case<'a> {
    setup: &'a TrackerSetup,
    frames: &'a [Frame],
    main: usize,
    spec: &'a SurfaceSpec,
    floor: f64,
    seen: Views<'a>,
    guess: Option<LensGuess>,
}

impl Case<'_> {
    fn fits(&self, left: f64) -> bool {
        left < self.floor + SLACK.0 + SLACK.1 * self.floor
    }

    /// Finds the shape or lens with which a pose would fit, given that none fits as configured.
    fn misfit(&self) -> Option<Finding> {
        let [w, h] = self.spec.size_m;
        let name = &self.spec.name;
        let ratio = self.seen.free_ratio();
        let focal = self.seen.free_focal();
        let pixel = self.seen.free_pixel();
        tracing::debug!(?ratio, ?focal, ?pixel, floor = self.floor, "lens, shape and pixels, each free");
        if let Some(swap) = self.swap([ratio.left, focal.left, pixel.left].into_iter().fold(CUT, f64::min)) {
            return Some(self.swapped(swap));
        }
        let is_stretched = self.fits(pixel.left) && (MIN_STRETCH..MAX_STRETCH).contains(&pixel.shape.pixel.ln().abs());
        let is_pixel = is_stretched && pixel.left < ratio.left.min(focal.left) - CLEARLY;
        if self.fits(ratio.left) && ratio.left <= focal.left + CLEARLY && !is_pixel {
            let known = |side: f64| known_to(side, side * ratio.sigma);
            let size = list(&[w, known(h * ratio.shape.ratio)]);
            let tried = self.tried(ratio.shape);
            let measured = ratio_words(h / w * ratio.shape.ratio, &ratio, h / w);
            let or_stretched = if is_stretched { format!("; where size_m is right, {}", self.pixel_words(&pixel)) } else { String::new() };
            return Some(Finding::fault(format!(
                "{name}: {measured}, so no pose fits: measure it again, and write size_m = {size} if its width is right, {} if its height \
                 is{tried}{or_stretched}",
                list(&[known(w / ratio.shape.ratio), h])
            )));
        }
        if self.fits(focal.left) && !is_pixel {
            return Some(Finding::fault(self.focal_words(&focal, "so no pose fits")));
        }
        if is_stretched {
            return Some(Finding::fault(format!("{}{}", self.pixel_words(&pixel), self.tried(pixel.shape))));
        }
        if let Some(finding) = self.other_distortion() {
            return Some(finding);
        }
        let both = self.seen.free_both();
        tracing::debug!(?both, "lens and shape, both free");
        if self.fits(both.left) {
            let tried = self.tried(both.shape);
            return Some(Finding::fault(format!(
                "{name}: neither size_m nor the lens fits the clip; a size_m of {} with a focal length of {} pixels (the config has {}) \
                 would fit: check both, size_m first, and calibrate this camera at this picture size{tried}",
                list(&[w, h * both.shape.ratio]),
                written(self.setup.camera.intrinsics().fx * both.shape.focal),
                written(self.setup.camera.intrinsics().fx)
            )));
        }
        None
    }

    /// Returns the swap of width and height if it explains nearly all that the best single factor
    /// does (`least` is that factor's residual). Other small errors, such as a roughly read corner,
    /// may remain.
    fn swap(&self, least: f64) -> Option<Shape> {
        let [w, h] = self.spec.size_m;
        let swap = Shape { ratio: (w / h).powi(2), ..AS_CONFIGURED };
        let (left, left_swapped) = (self.seen.left(AS_CONFIGURED), self.seen.left(swap));
        tracing::debug!(left, left_swapped, least, "with width and height swapped");
        let explains = left - left_swapped > SWAPPED * (left - least.min(left_swapped));
        ((w / h).ln().abs() > SAME_RATIO && explains && left - left_swapped > CLEARLY).then_some(swap)
    }

    /// Describes pixels that are not square, and what to do about them.
    fn pixel_words(&self, found: &Found) -> String {
        let i = self.setup.camera.intrinsics();
        let pixel = found.shape.pixel * i.fy / i.fx;
        let even = |side: f64| 2 * (0.5 * side).round() as u32;
        let [width, height] = [f64::from(i.width), f64::from(i.height)];
        let [width, height] = if pixel < 1.0 { [width * pixel, height] } else { [width, height / pixel] };
        format!(
            "the clip's pixels are not square: it fits if they are {pixel:.3} times as wide as high, as in a stretched picture; switch \
             stretching off in the camera or the recording program, or undo it: ffmpeg -i CLIP -vf scale={}:{},setsar=1 out.mp4",
            even(width),
            even(height)
        )
    }

    /// Describes that nothing explains how it is seen.
    fn no_flat_picture(&self) -> Finding {
        let name = &self.spec.name;
        let hint = match corners_of(self.spec) {
            Some((corners, _)) => format!(
                "check that corners_px are the four outer corners of one flat rectangle (now {}), and that the calibration is this \
                 camera's",
                begun_at(&corners, 0)
            ),
            None => {
                "check that `image` is flat artwork, not a photograph taken at an angle (that is `photo` with corners_px), that it hangs \
                     flat, and that the calibration is this camera's"
                    .to_owned()
            }
        };
        Finding::fault(format!(
            "{name}: it is recognised, but no flat picture fits, whatever its shape and the lens's focal length: {hint}"
        ))
    }

    /// Describes swapped sides: in the config, in the order of the corners, or in the picture's
    /// file.
    fn swapped(&self, shape: Shape) -> Finding {
        let [w, h] = self.spec.size_m;
        let name = &self.spec.name;
        let tried = self.tried(shape);
        if let Some((corners, _)) = corners_of(self.spec)
            && top_left(&corners) % 2 == 1
        {
            return Finding::fault(format!(
                "{name}: the corners do not start at the top left, so that width and height are swapped: write {}{tried}",
                begun_at(&corners, top_left(&corners))
            ));
        }
        if self.is_on_its_side() {
            return Finding::fault(format!(
                "{name}: the picture's file lies on its side (EXIF orientation, or turned by 90 degrees): turn it upright, so that its \
                 width matches the first number of size_m{tried}"
            ));
        }
        Finding::fault(format!("{name}: width and height are swapped: write size_m = {}{tried}", list(&[h, w])))
    }

    fn focal_words(&self, found: &Found, consequence: &str) -> String {
        let i = self.setup.camera.intrinsics();
        let focal_px = i.fx * found.shape.focal;
        let fov = 2.0 * (0.5 * f64::from(i.width) / focal_px).atan().to_degrees();
        let spread = (3.0 * found.sigma * focal_px).max(0.01 * focal_px);
        let (whose, hint) = match self.guess {
            None => (
                "the calibration is for another camera, picture size or zoom: it has".to_owned(),
                format!(
                    "calibrate this camera as it is used, or write fx = {} and fy = {} for a first try",
                    written(focal_px),
                    written(i.fy * found.shape.focal)
                ),
            ),
            Some(guess) => {
                let (key, typed, better) = match guess {
                    LensGuess::FieldOfView(degrees) => ("fov_deg", degrees, fov),
                    LensGuess::FilmFocalLength(mm) => ("focal_35mm_mm", mm, mm * found.shape.focal),
                };
                // Only significant digits.
                let better = written(known_to(better, better * found.sigma.max(0.003)));
                (
                    format!("{key} = {} does not match this camera or zoom: it gives", written(typed)),
                    format!("write {key} = {better} for a first try, and calibrate this camera as it is used"),
                )
            }
        };
        format!(
            "{whose} a focal length of {} pixels, the clip indicates {} +- {} ({fov:.0} degrees across), {consequence}: {hint}{}",
            written(i.fx),
            written(focal_px),
            written(spread),
            self.tried(found.shape)
        )
    }

    /// Tries to omit the distortion, or to reorder its parameters as in other programs.
    fn other_distortion(&self) -> Option<Finding> {
        let i = *self.setup.camera.intrinsics();
        let [k1, k2, a, b, c] = i.distortion;
        let orders = [
            ([k1, k2, b, c, a], "if its numbers are in the order k1, k2, k3, p1, p2"),
            ([-k1, -k2, -a, -b, -c], "with the opposite signs, as some programs define them"),
            ([0.0; 5], "with zeros, as for pictures that are already undistorted"),
        ];
        orders.into_iter().filter(|(d, _)| *d != i.distortion).find_map(|(distortion, why)| {
            let camera = CameraModel::new(Intrinsics { distortion, ..i }).ok()?;
            let left = self.seen.left_by(&camera, self.spec.size_m);
            tracing::debug!(left, ?distortion, "another distortion");
            self.fits(left).then(|| {
                Finding::fault(format!(
                    "the calibration's distortion does not fit the clip; it fits {why}: write distortion = {} ([k1, k2, p1, p2, k3])",
                    list(&distortion)
                ))
            })
        })
    }

    /// Checks whether another shape or lens fits clearly better than the config, which fits too.
    fn shape_as_seen(&self, left: f64) -> Vec<Finding> {
        let [w, h] = self.spec.size_m;
        let name = &self.spec.name;
        let (ratio, focal) = (self.seen.free_ratio(), self.seen.free_focal());
        tracing::debug!(?ratio, ?focal, left, "lens and shape, each free");
        let is_off = |log: f64, near: f64, found: &Found| log.abs() > near.max(SIGMAS * found.sigma) && left - found.left > MIN_GAIN;
        let ratio_off = is_off(ratio.shape.ratio.ln(), NEAR_RATIO, &ratio);
        let focal_off = is_off(focal.shape.focal.ln(), NEAR_FOCAL, &focal);
        if ratio_off && (!focal_off || ratio.left <= focal.left) {
            let measured = ratio_words(h / w * ratio.shape.ratio, &ratio, h / w);
            let height = h * ratio.shape.ratio;
            let size = list(&[w, known_to(height, height * ratio.sigma)]);
            let message = format!("{name}: {measured}: measure it again; if its width is right, write size_m = {size}");
            return vec![graded(ratio.shape.ratio, message)];
        }
        if focal_off {
            return vec![graded(focal.shape.focal, self.focal_words(&focal, "and poses are off by the same factor"))];
        }
        if ratio.sigma > 0.1 {
            return Vec::new();
        }
        vec![Finding::note(format!("{name}: {}", ratio_words(h / w * ratio.shape.ratio, &ratio, h / w)))]
    }

    /// Checks whether another surface stands as configured, from frames that show both. A map's
    /// facets are measured where they are: planks and crates that look alike are recognised as each
    /// other, and a piece that was moved is found by alignment.
    fn place_of(&self, views: &[Vec<SurfaceView>], other: usize) -> Option<Finding> {
        let (spec, setup) = (&self.setup.stage.surfaces[other], self.setup);
        if spec.is_facet() {
            return None;
        }
        let (main_views, other_views) = (&self.seen, views_of(setup, views, other));
        let mut seen: Vec<Standing> = Vec::new();
        for frame in views {
            let find = |surface: usize| frame.iter().find(|v| v.surface as usize == surface);
            let (Some(a), Some(b)) = (find(self.main), find(other)) else { continue };
            let Some((_, from)) = main_views.pose_of(a, &setup.camera, self.spec.size_m) else { continue };
            let Some((_, to)) = other_views.pose_of(b, &setup.camera, spec.size_m) else { continue };
            // In the body frame, via the main surface: T_body_main * (T_camera_main)^-1 *
            // T_camera_other.
            let in_main: Pose<SurfaceFrame, SurfaceFrame> =
                from.inverse().renamed::<SurfaceFrame, crate::geometry::Camera>() * to.renamed();
            seen.push(Standing { pose: self.spec.pose * in_main, distance: to.translation.norm() });
        }
        if seen.is_empty() {
            return None;
        }
        let median = |value: &dyn Fn(&Standing) -> f64| median(&mut seen.iter().map(value).collect::<Vec<_>>()).unwrap_or(0.0);
        let place = [0, 1, 2].map(|axis| median(&|s| s.pose.translation[axis]));
        let shift = median(&|s| (s.pose.translation - spec.pose.translation).norm());
        let rotation_deg = median(&|s| s.pose.angle_to(&spec.pose)).to_degrees();
        let distance = median(&|s| s.distance);
        tracing::debug!(surface = %spec.name, shift, turn_deg = rotation_deg, distance, ?place, frames = seen.len(), "where it stands");
        // Wrong matches, and inaccurate poses of small surfaces, put it elsewhere in every frame.
        let [scatter, scatter_deg] = scatter(&seen);
        let is_shifted = shift > MAX_SHIFT * distance && scatter < MAX_SCATTER * shift;
        let is_rotated = rotation_deg > MAX_ROTATION_DEG && scatter_deg < MAX_SCATTER * rotation_deg;
        if !(is_shifted || is_rotated) {
            return None;
        }
        if rotation_deg > 150.0 {
            let (turned, upright) = if top_deg(&other_views).abs() > 90.0 { (spec, self.spec) } else { (self.spec, spec) };
            return Some(Finding::fault(format!(
                "{}: it is upside down relative to {} (turned by {rotation_deg:.0} degrees): turn the picture's file, or set its orientation \
                 accordingly",
                turned.name, upright.name
            )));
        }
        let p = spec.pose.translation;
        let units = [1000.0, 100.0].into_iter().find(|by| [0, 1, 2].iter().all(|k| (p[*k] / by - place[*k]).abs() < MAX_SHIFT * distance));
        let unit = match units {
            Some(1000.0) => " (position_m is in metres, these look like millimetres)",
            Some(_) => " (position_m is in metres, these look like centimetres)",
            None => "",
        };
        let turned = if is_rotated { format!(", turned by {rotation_deg:.0} degrees from its orientation") } else { String::new() };
        Some(Finding::fault(format!(
            "{}: it is not where the config puts it, at {}, but {shift:.1} m from there{turned}: write position_m = {}{unit}, and check \
             its orientation and size_m",
            spec.name,
            list(&[p.x, p.y, p.z]),
            list(&place)
        )))
    }

    /// Whether the picture's top points sideways in the frames.
    fn is_on_its_side(&self) -> bool {
        (45.0..135.0).contains(&top_deg(&self.seen).abs())
    }

    /// Tries a fixed config and describes the result.
    fn tried(&self, shape: Shape) -> String {
        let Some((camera, size_m)) = self.seen.trial(shape) else { return String::new() };
        let mut stage = self.setup.stage.clone();
        stage.surfaces[self.main].size_m = size_m;
        let (verified, tried) = Trial::new(camera, self.setup.mask.clone(), &stage, self.setup).verified(self.frames);
        format!(" (tried: a pose then fits in {verified} of {tried} frames)")
    }
}

/// Grades a deviation: a small one may be cloth in folds or a roughly known lens; a large one is a
/// mistake.
fn graded(factor: f64, message: String) -> Finding {
    if factor.ln().abs() > LARGE_FACTOR { Finding::doubt(message) } else { Finding::warning(message) }
}

/// Returns the median rotation of the picture in the frames, degrees clockwise.
fn top_deg(views: &Views<'_>) -> f64 {
    let [w, h] = views.artwork_px;
    let along = |view: &SurfaceView| {
        let at = |share: f64| view.homography.map(Vector2::new(share * w, 0.5 * h));
        let along = at(0.6)? - at(0.4)?;
        Some(along.y.atan2(along.x).to_degrees())
    };
    let mut angles: Vec<f64> = views.views.iter().filter_map(|v| along(v)).collect();
    angles.iter_mut().filter(|t| **t < -150.0).for_each(|t| *t += 360.0);
    median(&mut angles).unwrap_or(0.0)
}

fn ratio_words(seen: f64, found: &Found, configured: f64) -> String {
    let sigma = (3.0 * found.sigma * seen).max(0.002);
    format!("in the clip it is {seen:.3} +- {sigma:.3} times as high as wide, size_m says {configured:.3}")
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;

    fn standing(x: f64, rotation: f64) -> Standing {
        Standing { pose: Pose::new(UnitQuaternion::from_euler_angles(0.0, rotation, 0.0), Vector3::new(x, 0.0, 0.0)), distance: 3.0 }
    }

    #[test]
    fn scatter_ignores_a_few_outlier_frames() {
        let seen: Vec<Standing> =
            [(1.0, 0.3), (1.01, 0.31), (0.99, 0.3), (7.0, 2.0), (1.0, 0.29)].map(|(x, rotation)| standing(x, rotation)).into();
        let [shift, rotation_deg] = scatter(&seen);
        assert!(shift < 0.02 && rotation_deg < 1.2, "{shift} {rotation_deg}");
        assert_eq!(scatter(&seen[..1]), [0.0; 2]);
    }

    #[test]
    fn wrong_matches_put_a_surface_elsewhere_in_every_frame() {
        let seen: Vec<Standing> = [(1.0, 0.3), (-2.0, 1.0), (4.0, -1.3), (0.2, 2.2)].map(|(x, rotation)| standing(x, rotation)).into();
        let [shift, rotation_deg] = scatter(&seen);
        assert!(shift > 0.7 && rotation_deg > 35.0, "{shift} {rotation_deg}");
    }
}
