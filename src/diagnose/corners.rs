//! Derives the shape of a rectangle from its four corners in one photograph and the lens that took
//! it (Zhang and He, 2007), compares it with `size_m`, and checks where the list of corners starts.

use nalgebra::{Vector2, Vector3};

use super::finding::{Finding, Grade, list, written};
use crate::camera::{CameraModel, Pixel};
use crate::geometry::{Homography, PointPair};
use crate::track::{BodySpec, ReferenceKind, SurfaceSpec};

/// Accuracy with which corners are read off a photograph, one sigma, pixels (chosen: a hand on a
/// mouse and a blurred edge). Raised, crooked corners pass unmentioned.
const CORNER_PX: f64 = 1.5;
/// Effect of a roughly known lens on the ratio, one sigma of its logarithm (chosen, not measured).
/// Raised, wrong ratios pass unmentioned.
const LENS: f64 = 0.015;

/// Height over width of the rectangle, and the angle between its sides in degrees.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Rectangle {
    ratio: f64,
    angle_deg: f64,
}

/// Computes the rectangle from the corners' raw pixels, clockwise from the top left.
fn rectangle(camera: &CameraModel, corners: &[Vector2<f64>; 4]) -> Option<Rectangle> {
    let unit = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)].map(|(x, y)| Vector2::new(x, y));
    let mut pairs = [PointPair { from: unit[0], to: unit[0] }; 4];
    for k in 0..4 {
        pairs[k] = PointPair { from: unit[k], to: camera.unproject(Pixel(corners[k]))?.0 };
    }
    let h = Homography::from_four(&pairs)?.0;
    let (across, down): (Vector3<f64>, Vector3<f64>) = (h.column(0).into(), h.column(1).into());
    let ratio = down.norm() / across.norm();
    ratio.is_finite().then(|| Rectangle { ratio, angle_deg: across.angle(&down).to_degrees() })
}

/// Returns one sigma of the ratio's logarithm and of the angle (degrees), for corners read with
/// [`CORNER_PX`].
fn spread(camera: &CameraModel, corners: &[Vector2<f64>; 4], found: &Rectangle) -> (f64, f64) {
    let (mut log, mut angle) = (LENS * LENS, 0.0);
    for k in 0..8 {
        let mut moved = *corners;
        moved[k / 2][k % 2] += CORNER_PX;
        let Some(other) = rectangle(camera, &moved) else { return (f64::INFINITY, f64::INFINITY) };
        log += (other.ratio / found.ratio).ln().powi(2);
        angle += (other.angle_deg - found.angle_deg).powi(2);
    }
    (log.sqrt(), angle.sqrt())
}

/// Returns the raw corners of a photographed surface, as configured, and the photograph's camera.
pub fn corners_of(surface: &SurfaceSpec) -> Option<([Vector2<f64>; 4], &CameraModel)> {
    let ReferenceKind::Photograph { h_photo_artwork, camera, .. } = &surface.kind else { return None };
    let (w, h) = (f64::from(surface.artwork.width()) - 0.5, f64::from(surface.artwork.height()) - 0.5);
    let map = Homography(*h_photo_artwork);
    let mut corners = [Vector2::zeros(); 4];
    for (corner, (x, y)) in corners.iter_mut().zip([(-0.5, -0.5), (w, -0.5), (w, h), (-0.5, h)]) {
        *corner = camera.project(camera.from_undistorted_pixel(map.map(Vector2::new(x, y))?)).0;
    }
    Some((corners, camera))
}

/// Returns the index of the corner that is the top left one in the photograph.
pub fn top_left(corners: &[Vector2<f64>; 4]) -> usize {
    (0..4).min_by(|a, b| corners[*a].sum().total_cmp(&corners[*b].sum())).unwrap_or(0)
}

/// Returns the config line with the list starting at another corner.
pub fn begun_at(corners: &[Vector2<f64>; 4], first: usize) -> String {
    let corner = |k: usize| list(&[0, 1].map(|axis| (corners[(first + k) % 4][axis] * 10.0).round() / 10.0));
    format!("corners_px = [{}, {}, {}, {}]", corner(0), corner(1), corner(2), corner(3))
}

/// Returns the config line with a photographed surface's corners starting at the top left one;
/// `None` if they already do, and for artwork.
pub fn corners_begun_at_top_left(surface: &SurfaceSpec) -> Option<String> {
    let (corners, _) = corners_of(surface)?;
    let first = top_left(&corners);
    (first != 0).then(|| begun_at(&corners, first))
}

/// Compares the corners of the photographed surfaces with their `size_m`. With a guessed lens they
/// are not conclusive, so the finding is only a warning.
pub fn of_corners(body: &BodySpec, is_guess: bool) -> Vec<Finding> {
    let graded = |surface: &SurfaceSpec, f: Finding| match f.grade {
        Grade::Doubt if is_guess || is_assumed(surface) => Finding::warning(f.message),
        _ => f,
    };
    body.surfaces.iter().filter_map(|surface| Some(graded(surface, of_surface(surface)?))).collect()
}

/// Whether a photograph's lens looks like the default one: focal length equal to the longer side,
/// and no distortion.
fn is_assumed(surface: &SurfaceSpec) -> bool {
    let ReferenceKind::Photograph { camera, .. } = &surface.kind else { return false };
    let i = camera.intrinsics();
    i.fx == f64::from(i.width.max(i.height)) && i.fx == i.fy && i.distortion == [0.0; 5]
}

fn of_surface(surface: &SurfaceSpec) -> Option<Finding> {
    let (corners, camera) = corners_of(surface)?;
    let found = rectangle(camera, &corners)?;
    let (log_sigma, angle_sigma) = spread(camera, &corners, &found);
    let ratio = surface.size_m[1] / surface.size_m[0];
    let name = &surface.name;
    let measured = format!(
        "{name}: from its corners and the lens, it is {:.3} +- {:.3} times as high as wide",
        found.ratio,
        3.0 * log_sigma * found.ratio
    );
    if !log_sigma.is_finite() {
        return None;
    }
    if (found.angle_deg - 90.0).abs() > (3.0 * angle_sigma).max(4.0) {
        return Some(Finding::doubt(format!(
            "{name}: its corners are not those of a rectangle seen through this lens (its sides meet at {:.0} degrees); check corners_px \
             and photo_calibration",
            found.angle_deg
        )));
    }
    let off = (found.ratio / ratio).ln();
    if off.abs() < 3.0 * log_sigma {
        return Some(Finding::note(format!("{measured}; size_m says {ratio:.3}")));
    }
    let [w, h] = surface.size_m;
    if (found.ratio * ratio).ln().abs() < 3.0 * log_sigma {
        let first = top_left(&corners);
        let hint = match first % 2 {
            1 => format!("the corners do not start at the top left: write {}", begun_at(&corners, first)),
            _ => format!("width and height are swapped: write size_m = {}", list(&[h, w])),
        };
        return Some(Finding::doubt(format!("{measured}; size_m says {ratio:.3}: {hint}")));
    }
    Some(Finding::doubt(
        format!(
            "{measured}; size_m says {ratio:.3}: measure it again, or write size_m = {} if its width is right (a wrong photo_calibration has \
             the same effect)",
            list(&[w, w * found.ratio])
        ) + &format!("; corner 1 is configured at {}", written_corner(&corners[0])),
    ))
}

fn written_corner(corner: &Vector2<f64>) -> String {
    format!("[{}, {}]", written((corner.x * 10.0).round() / 10.0), written((corner.y * 10.0).round() / 10.0))
}

#[cfg(test)]
mod tests {
    use image::{GrayImage, Luma};
    use nalgebra::UnitQuaternion;

    use super::*;
    use crate::camera::Normalized;
    use crate::geometry::{Camera, Pose, SurfaceFrame};

    fn camera() -> CameraModel {
        CameraModel::pinhole(640, 480, 600.0, 600.0, 319.5, 239.5).unwrap()
    }

    /// A rectangle of 2 x 1.5 m, tilted, in front of a chequered wall.
    fn corners() -> [Vector2<f64>; 4] {
        let rotation =
            UnitQuaternion::from_euler_angles(0.3, 0.5, 0.05) * UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0);
        let pose = Pose::<Camera, SurfaceFrame>::new(rotation, Vector3::new(0.0, 0.0, 4.0));
        [(-1.0, 0.75), (1.0, 0.75), (1.0, -0.75), (-1.0, -0.75)].map(|(x, y)| {
            let c = pose.transform(&nalgebra::Point3::new(x, y, 0.0));
            camera().project(Normalized(c.coords.xy() / c.z)).0
        })
    }

    fn said(size_m: [f64; 2], corners: [Vector2<f64>; 4]) -> String {
        let photo = GrayImage::from_fn(640, 480, |x, y| Luma([if (x / 17 + y / 13) % 2 == 0 { 200 } else { 40 }]));
        let spec =
            SurfaceSpec::from_photograph("wall.jpg".to_owned(), &photo, corners.map(Pixel), camera(), size_m, Pose::identity()).unwrap();
        of_corners(&BodySpec::new("stage", vec![spec]), false).pop().unwrap().message
    }

    #[test]
    fn the_aspect_ratio_follows_from_the_corners() {
        let found = rectangle(&camera(), &corners()).unwrap();
        assert!((found.ratio - 0.75).abs() < 1e-9 && (found.angle_deg - 90.0).abs() < 1e-6, "{found:?}");
        assert!(said([2.0, 1.5], corners()).contains("0.750 +- "));
    }

    #[test]
    fn swapped_sides_and_rotated_corners_are_distinguished() {
        assert!(said([1.5, 2.0], corners()).contains("swapped: write size_m = [2.0, 1.5]"));
        let mut turned = corners();
        turned.rotate_left(1);
        let text = said([2.0, 1.5], turned);
        assert!(text.contains("do not start at the top left: write corners_px = [["), "{text}");
        let wrong = said([2.0, 1.0], corners());
        assert!(wrong.contains("size_m = [2.0, 1.5]"), "{wrong}");
    }

    #[test]
    fn corners_of_no_rectangle_are_reported() {
        let mut skewed = corners();
        skewed[0].x -= 120.0;
        skewed[2].x += 90.0;
        assert!(said([2.0, 1.5], skewed).contains("not those of a rectangle"), "{}", said([2.0, 1.5], skewed));
    }
}
