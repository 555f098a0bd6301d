//! The keyframes as the mapping looks at them: where a point of the stage is in a keyframe, and how
//! much light came from there.

use image::GrayImage;
use nalgebra::{Matrix2x3, Point3, Vector2, Vector3};

use crate::camera::{CameraModel, Normalized, Pixel, Shutter};
use crate::geometry::{Body, Camera, Pose, catmull_rom};
use crate::light::CameraCurve;

/// A camera's velocity, metres per second, and its angular velocity, radians per second, in the
/// axes of [`Pose::moved`].
pub type Rates = [Vector3<f64>; 2];

/// Border of a picture that is not looked at, pixels: interpolation reaches two pixels out.
const BORDER_PX: f64 = 2.0;

/// A keyframe: its picture, and the camera's pose in the stage.
#[derive(Debug, Clone, Copy)]
pub struct View<'a> {
    /// The picture.
    pub picture: &'a GrayImage,
    /// `T_body_camera`.
    pub pose: Pose<Body, Camera>,
    /// How the camera moved, as far as known.
    pub rates: Rates,
    /// Whether the pose was measured on what gives frame and scale, so that it is a prior.
    pub is_anchored: bool,
}

/// All keyframes, with the camera that took them.
#[derive(Debug, Clone)]
pub struct Views<'a> {
    /// The keyframes, in the walk's order.
    pub views: Vec<View<'a>>,
    /// Their camera.
    pub camera: CameraModel,
    /// Its shutter; the poses are those of the middle row.
    pub shutter: Shutter,
    /// The light that its grey levels stand for.
    pub curve: CameraCurve,
    /// Black where its pictures are to be ignored.
    pub mask: Option<&'a GrayImage>,
}

impl View<'_> {
    /// Returns how a small plane faces the camera: the cosine of the angle between its normal and
    /// the direction to the camera, and the distance, metres.
    pub fn faced_by(&self, place: &Vector3<f64>, normal: &Vector3<f64>) -> (f64, f64) {
        let to_camera = self.pose.translation - place;
        let distance_m = to_camera.norm();
        (to_camera.dot(normal) / distance_m.max(f64::EPSILON), distance_m)
    }
}

impl Views<'_> {
    /// Returns the raw pixel at which keyframe `view` shows a point of the stage; `None` if it does
    /// not.
    pub fn pixel(&self, view: usize, place: &Vector3<f64>) -> Option<Vector2<f64>> {
        let pixel_from = |pose: &Pose<Body, Camera>| {
            let at = pose.inverse().transform(&Point3::from(*place));
            Some(self.camera.project(in_field(&self.camera, &at.coords)?).0)
        };
        let own = &self.views[view].pose;
        let mut pixel = pixel_from(own)?;
        // Its row depends on when it is read, and so on itself: two steps are exact to a
        // thousandth of a pixel.
        for _ in 0..if self.shutter.readout_s == 0.0 { 0 } else { 2 } {
            pixel = pixel_from(&self.pose_at(view, own, pixel))?;
        }
        self.shows(pixel).then_some(pixel)
    }

    /// Returns the direction in the stage, of unit length, into which a pixel of keyframe `view`
    /// looks.
    pub fn direction(&self, view: usize, pixel: Vector2<f64>) -> Option<Vector3<f64>> {
        let ray = self.camera.unproject(Pixel(pixel))?;
        let pose = self.pose_at(view, &self.views[view].pose, pixel);
        Some(pose.rotation * ray.0.push(1.0).normalize())
    }

    /// Returns where keyframe `view`, whose middle row has a pose, was when it read a pixel.
    pub fn pose_at(&self, view: usize, pose: &Pose<Body, Camera>, pixel: Vector2<f64>) -> Pose<Body, Camera> {
        self.carried(pose, &self.views[view].rates, pixel)
    }

    /// Returns where a camera with these rates, whose middle row has a pose, was when it read a
    /// pixel.
    pub fn carried(&self, pose: &Pose<Body, Camera>, [velocity, angular_velocity]: &Rates, pixel: Vector2<f64>) -> Pose<Body, Camera> {
        if self.shutter.readout_s == 0.0 {
            return *pose;
        }
        let delay_s = self.delay_s(pixel);
        pose.moved(&(velocity * delay_s), &(angular_velocity * delay_s))
    }

    /// Returns when a pixel is read, seconds after the middle row.
    pub fn delay_s(&self, pixel: Vector2<f64>) -> f64 {
        self.shutter.delay_s(pixel.y + 0.5, self.camera.height())
    }

    fn shows(&self, pixel: Vector2<f64>) -> bool {
        let (w, h) = (f64::from(self.camera.width()), f64::from(self.camera.height()));
        let is_inside = pixel.x >= BORDER_PX && pixel.y >= BORDER_PX && pixel.x <= w - 1.0 - BORDER_PX && pixel.y <= h - 1.0 - BORDER_PX;
        is_inside && self.mask.is_none_or(|mask| mask.get_pixel(pixel.x.round() as u32, pixel.y.round() as u32)[0] > 0)
    }

    /// Returns the light at a pixel of keyframe `view`, 0 to 255, interpolated by Catmull-Rom
    /// splines; the pixel must be one that [`pixel`](Self::pixel) returned.
    pub fn light(&self, view: usize, pixel: Vector2<f64>) -> f32 {
        let picture = self.views[view].picture;
        let table = self.curve.light();
        let (i, j) = (pixel.x.floor(), pixel.y.floor());
        let (across, down) = (catmull_rom::weights((pixel.x - i) as f32), catmull_rom::weights((pixel.y - j) as f32));
        let (width, first) = (picture.width() as usize, (i as usize - 1, j as usize - 1));
        let raw = picture.as_raw();
        let row = |dy: usize| {
            let start = (first.1 + dy) * width + first.0;
            raw[start..start + 4].iter().zip(across).map(|(grey, w)| w * table[usize::from(*grey)]).sum::<f32>()
        };
        (0..4).map(|dy| down[dy] * row(dy)).sum()
    }
}

/// Projects a point in camera axes, metres, to its raw pixel, with the derivative by the point.
/// `None` if it is not in front of the camera or beyond the lens's field.
pub fn project(camera: &CameraModel, at: &Vector3<f64>) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
    in_field(camera, at)?;
    let (pixel, by_point) = camera.project_point_with_jacobian(at);
    Some((pixel.0, by_point))
}

/// Returns the direction of a point in camera axes, if it is in front of the camera and within the
/// lens's field.
fn in_field(camera: &CameraModel, at: &Vector3<f64>) -> Option<Normalized> {
    let ray = at.xy() / at.z;
    (at.z > f64::EPSILON && ray.norm() < camera.valid_radius()).then_some(Normalized(ray))
}
