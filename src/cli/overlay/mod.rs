//! Draws what the tracker believes on the picture, for people.
//!
//! The outlines of all surfaces are projected with the lens' distortion, so they match the
//! picture's own edges if the pose is right. The border shows the state: green tracking, yellow
//! coasting, red lost, grey searching. Dots show how well the picture fits the pose (`fit`). A
//! panel at the top states state, position, angles and why a frame is not tracked; one at the
//! bottom explains the marks (`caption`).

mod canvas;
mod caption;
mod fit;
mod lettering;

use image::{DynamicImage, RgbImage};
use nalgebra::{Point3, Vector2, Vector3};

use crate::camera::{CameraModel, Normalized};
use crate::frame::Frame;
use crate::geometry::{Body, Camera, Pose};
use crate::record::{PoseSample, State};
use crate::track::{BodySpec, SurfaceSpec, UsedPixel};
use canvas::{Canvas, Colour};

/// Colours of outlines, axes and states: bright, to stand out from the picture.
const RED: Colour = [250, 75, 65];
const GREEN: Colour = [60, 215, 85];
const BLUE: Colour = [95, 150, 255];
const YELLOW: Colour = [250, 210, 60];
const GREY: Colour = [170, 172, 178];
const CYAN: Colour = [70, 220, 235];

/// Points nearer than this, metres, count as behind the camera. It keeps the division by depth
/// finite. No lens sees a stage from so near, so any value below a centimetre would do.
const NEAR_M: f64 = 1e-3;
/// Segments per edge, so that distortion and folds show. Chosen for looks. Raised, edges bend more
/// smoothly and take longer to draw.
const PIECES: u32 = 48;

/// What a picture is drawn from.
pub struct Scene<'a> {
    /// The camera, at the frame's size.
    pub camera: &'a CameraModel,
    /// The stage. Its surfaces are drawn if the sample has its pose.
    pub stage: &'a BodySpec,
    /// The objects, drawn likewise.
    pub objects: &'a [BodySpec],
    /// The pixels that the frame's poses rest on.
    pub pixels: &'a [UsedPixel],
    /// The frame in colour, if the clip has colours.
    pub colours: Option<&'a RgbImage>,
}

/// Draws the state, the fit, the surfaces and the stage's axes on a frame.
pub fn draw(frame: &Frame, sample: &PoseSample, scene: &Scene) -> RgbImage {
    let of_size = scene.colours.filter(|colours| colours.dimensions() == frame.image.dimensions());
    let picture = of_size.cloned().unwrap_or_else(|| DynamicImage::from(frame.image.clone()).into_rgb8());
    let Some(mut canvas) = Canvas::new(&picture) else { return picture };
    let size = canvas.size();
    let thickness = (size[0].min(size[1]) / 400.0).max(1.2);
    fit::draw(&mut canvas, scene.pixels);
    if let Some(t_stage_camera) = sample.pose {
        let t_camera_stage = t_stage_camera.inverse();
        for (body, object) in scene.objects.iter().zip(&sample.objects) {
            if let Some(t_stage_object) = object.pose {
                let colour = if object.state == State::Tracking { CYAN } else { state_colour(object.state) };
                let seen = Seen { camera: scene.camera, t_camera_body: t_camera_stage * t_stage_object };
                seen.outlines(&mut canvas, body, thickness, colour);
                seen.name(&mut canvas, body, colour);
            }
        }
        // The stage is the body whose own frame is the stage frame.
        let seen = Seen { camera: scene.camera, t_camera_body: t_camera_stage.renamed() };
        seen.outlines(&mut canvas, scene.stage, thickness, state_colour(sample.state));
        seen.axes(&mut canvas, scene.stage, 1.4 * thickness);
    }
    let edge = (size[0] / 200.0).max(2.0).round();
    canvas.border(edge, state_colour(sample.state));
    caption::status(&mut canvas, sample, edge);
    caption::legend(&mut canvas, sample, scene, edge);
    canvas.finish()
}

fn state_colour(state: State) -> Colour {
    match state {
        State::Tracking => GREEN,
        State::Coasting => YELLOW,
        State::Lost => RED,
        State::Searching | State::Stale => GREY,
    }
}

/// A body as seen by the camera.
struct Seen<'a> {
    camera: &'a CameraModel,
    t_camera_body: Pose<Camera, Body>,
}

impl Seen<'_> {
    fn outlines(&self, canvas: &mut Canvas, body: &BodySpec, thickness: f32, colour: Colour) {
        for surface in &body.surfaces {
            let runs: Vec<_> = (0..4).flat_map(|side| self.line(canvas, |share| along_side(surface, side, share))).collect();
            canvas.lines(&runs, thickness, colour);
        }
    }

    /// Writes the body's name inside the top left corner of its first surface.
    fn name(&self, canvas: &mut Canvas, body: &BodySpec, colour: Colour) {
        let lettering = caption::lettering(canvas.size());
        let corner = body.surfaces.first().and_then(|surface| self.pixel(&self.t_camera_body.transform(&along_side(surface, 0, 0.0))));
        if let Some(at) = corner {
            let em = lettering.size_px;
            canvas.label(lettering, (at.x as f32 + 0.4 * em, at.y as f32 + 1.2 * em), colour, &body.name);
        }
    }

    /// Draws x red, y green, z blue, each a tenth of the first surface's width long, with their
    /// letters.
    fn axes(&self, canvas: &mut Canvas, stage: &BodySpec, thickness: f32) {
        let Some(first) = stage.surfaces.first() else { return };
        let length = 0.1 * first.size_m[0];
        let lettering = caption::lettering(canvas.size());
        for (direction, colour, letter) in [(Vector3::x(), RED, "x"), (Vector3::y(), GREEN, "y"), (Vector3::z(), BLUE, "z")] {
            let axis = |along: f64| Point3::from(direction * (length * along));
            let runs = self.line(canvas, axis);
            canvas.lines(&runs, thickness, colour);
            if let Some(end) = self.pixel(&self.t_camera_body.transform(&axis(1.15))) {
                let em = lettering.size_px;
                canvas.label(lettering, (end.x as f32 - 0.27 * em, end.y as f32 + 0.27 * em), colour, letter);
            }
        }
    }

    /// Projects a line in space, parametrised from 0 to 1: runs of points within the picture.
    fn line(&self, canvas: &Canvas, at: impl Fn(f64) -> Point3<f64>) -> Vec<Vec<Vector2<f64>>> {
        let size = canvas.size().map(f64::from);
        let pixel = |k: u32| self.pixel(&self.t_camera_body.transform(&at(f64::from(k) / f64::from(PIECES))));
        let mut runs: Vec<Vec<Vector2<f64>>> = Vec::new();
        let mut previous = pixel(0);
        for k in 1..=PIECES {
            let next = pixel(k);
            if let Some((a, b)) = previous.zip(next).and_then(|(a, b)| cut(a, b, Vector2::from(size))) {
                match runs.last_mut() {
                    // A piece that starts where the last one ended continues its stroke.
                    Some(run) if run.last() == Some(&a) => run.push(b),
                    _ => runs.push(vec![a, b]),
                }
            }
            previous = next;
        }
        runs
    }

    /// Returns the raw pixel of a point in front of the camera, within the lens' valid field.
    fn pixel(&self, point: &Point3<f64>) -> Option<Vector2<f64>> {
        if point.z.is_nan() || point.z <= NEAR_M {
            return None;
        }
        let n = Vector2::new(point.x / point.z, point.y / point.z);
        let is_seen = n.norm() <= self.camera.valid_radius();
        is_seen.then(|| self.camera.project(Normalized(n)).0).filter(|p| p.iter().all(|v| v.is_finite()))
    }
}

/// Returns a point along a side of a surface as it hangs, in the body's frame. Sides go clockwise
/// from the upper one, which starts at the top left; `share` is from 0 to 1.
fn along_side(surface: &SurfaceSpec, side: usize, share: f64) -> Point3<f64> {
    let [w, h] = surface.size_m.map(|m| m / 2.0);
    let corners = [(-w, h), (w, h), (w, -h), (-w, -h)];
    let ((x, y), (to_x, to_y)) = (corners[side % 4], corners[(side + 1) % 4]);
    let place = surface.shape.at([x + share * (to_x - x), y + share * (to_y - y)]).place;
    surface.pose.transform(&Point3::from(place))
}

/// Returns the part of a line inside the picture (Liang and Barsky), so that a far end costs
/// nothing.
fn cut(a: Vector2<f64>, b: Vector2<f64>, size: Vector2<f64>) -> Option<(Vector2<f64>, Vector2<f64>)> {
    let along = b - a;
    let (mut first, mut last) = (0.0_f64, 1.0_f64);
    for axis in 0..2 {
        for (step, room) in [(-along[axis], a[axis] + 1.0), (along[axis], size[axis] - a[axis])] {
            if step == 0.0 {
                if room < 0.0 {
                    return None;
                }
            } else if step < 0.0 {
                first = first.max(room / step);
            } else {
                last = last.min(room / step);
            }
        }
    }
    (first <= last).then(|| (a + along * first, a + along * last))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use image::GrayImage;
    use nalgebra::{Quaternion, UnitQuaternion, Vector1};

    use super::*;
    use crate::camera::Intrinsics;
    use crate::geometry::bspline::BicubicSpline;
    use crate::record::StageTimes;
    use crate::track::{BentShape, ReferenceKind, SurfaceShape};

    /// Upright, facing the audience.
    fn upright() -> UnitQuaternion<f64> {
        UnitQuaternion::from_quaternion(Quaternion::new(1.0, 1.0, 0.0, 0.0))
    }

    fn body(name: &str, size_m: [f64; 2]) -> BodySpec {
        let pose = Pose::new(upright(), Vector3::zeros());
        let surface = SurfaceSpec {
            name: name.to_owned(),
            artwork: GrayImage::new(40, 30),
            size_m,
            pose,
            kind: ReferenceKind::Artwork,
            shape: SurfaceShape::Flat,
            doubt: crate::track::SurfaceDoubt::default(),
            transfer: crate::light::Transfer::default(),
        };
        BodySpec { name: name.to_owned(), surfaces: vec![surface] }
    }

    fn camera(k1: f64) -> CameraModel {
        let distortion = [k1, 0.0, 0.0, 0.0, 0.0];
        CameraModel::new(Intrinsics { width: 640, height: 480, fx: 600.0, fy: 600.0, cx: 320.0, cy: 240.0, skew: 0.0, distortion }).unwrap()
    }

    /// The golden pose: 4 m in front of the origin.
    fn sample(state: State, y: f64) -> PoseSample {
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(1.0, -1.0, 0.0, 0.0));
        let pose = matches!(state, State::Tracking | State::Coasting).then(|| Pose::new(rotation, Vector3::new(0.0, y, 0.0)));
        let times = StageTimes::default();
        PoseSample {
            sequence: 7,
            timestamp: Default::default(),
            state,
            pose,
            measurement: None,
            objects: Vec::new(),
            reason: None,
            learnt: Default::default(),
            times,
        }
    }

    fn drawn(sample: &PoseSample, k1: f64, objects: &[BodySpec]) -> RgbImage {
        let frame = Frame { image: GrayImage::from_pixel(640, 480, image::Luma([100])), timestamp: Default::default(), sequence: 7 };
        draw(&frame, sample, &Scene { camera: &camera(k1), stage: &body("stage", [3.0, 2.0]), objects, pixels: &[], colours: None })
    }

    fn is(picture: &RgbImage, (x, y): (u32, u32), colour: Colour) -> bool {
        picture.get_pixel(x, y).0.iter().zip(colour).all(|(a, b)| a.abs_diff(b) < 12)
    }

    /// Returns the pixels that the panels leave free in a frame of 640 x 480.
    fn inside() -> impl Iterator<Item = (u32, u32)> {
        (5..635).flat_map(|x| (70..440).map(move |y| (x, y)))
    }

    #[test]
    fn the_outline_matches_the_pinhole_projection() {
        let picture = drawn(&sample(State::Tracking, -4.0), 0.0, &[]);
        // 3 x 2 m at 4 m with f = 600: 450 x 300 pixels about the centre.
        for at in [(95, 240), (545, 240), (320, 90), (320, 390)] {
            assert!(is(&picture, at, GREEN), "{at:?} {:?}", picture.get_pixel(at.0, at.1));
        }
        assert_eq!(picture.get_pixel(200, 200).0, [100; 3]);
        // The axes: x to the right, z up, 0.3 m long, that is 45 pixels; y points away from the
        // camera.
        assert!(is(&picture, (355, 240), RED));
        assert!(is(&picture, (320, 205), BLUE));
        assert_eq!(picture.get_pixel(390, 240).0, [100; 3]);
    }

    #[test]
    fn distortion_bends_the_outline() {
        let picture = drawn(&sample(State::Tracking, -4.0), -0.2, &[]);
        let greenness = |x: u32, y: u32| i32::from(picture.get_pixel(x, y).0[1]) - i32::from(picture.get_pixel(x, y).0[0]);
        let left_edge_at = |y: u32| (20..300).max_by_key(|&x| greenness(x, y)).unwrap();
        assert!(left_edge_at(120) > left_edge_at(240) + 1, "{} {}", left_edge_at(120), left_edge_at(240));
    }

    #[test]
    fn the_outline_of_a_bent_surface_follows_its_shape() {
        // A cylinder about the vertical: the middle of the upper side 0.5 m nearer than its ends,
        // which lie in the plane.
        let mut height = BicubicSpline::zero([8, 2], [3.0, 2.0]);
        for k in 0..height.coefficients().len() {
            let [x, _] = height.middles()(k);
            height.coefficients_mut()[k] = Vector1::new(0.5 * (1.0 - (x / 1.5).powi(2)));
        }
        let shape = BentShape { height, stretch: BicubicSpline::zero([2, 2], [3.0, 2.0]), ways: Vec::new() };
        let mut bent = body("stage", [3.0, 2.0]);
        bent.surfaces[0].shape = SurfaceShape::Bent(Arc::new(shape));
        let frame = Frame { image: GrayImage::from_pixel(640, 480, image::Luma([100])), timestamp: Default::default(), sequence: 7 };
        let scene = Scene { camera: &camera(0.0), stage: &bent, objects: &[], pixels: &[], colours: None };
        let picture = draw(&frame, &sample(State::Tracking, -4.0), &scene);
        let greenness = |x: u32, y: u32| i32::from(picture.get_pixel(x, y).0[1]) - i32::from(picture.get_pixel(x, y).0[0]);
        let lower_side_at = |x: u32| (300..430).max_by_key(|&y| greenness(x, y)).unwrap();
        // 1 m below the axis: 171 pixels below it at 3.5 m, 150 at 4 m.
        assert!(lower_side_at(320).abs_diff(411) <= 3, "{}", lower_side_at(320));
        assert!(lower_side_at(105).abs_diff(391) <= 5, "{}", lower_side_at(105));
    }

    #[test]
    fn without_a_pose_only_border_and_panels_are_drawn() {
        let picture = drawn(&sample(State::Lost, -4.0), 0.0, &[]);
        assert_eq!(picture.get_pixel(1, 240).0, RED);
        assert!(inside().all(|(x, y)| picture.get_pixel(x, y).0 == [100; 3]));
        assert_eq!(drawn(&sample(State::Searching, -4.0), 0.0, &[]).get_pixel(1, 240).0, GREY);
        assert_eq!(drawn(&sample(State::Coasting, -4.0), 0.0, &[]).get_pixel(1, 240).0, YELLOW);
    }

    /// Counts the rows that a panel covers, down the left side.
    fn panel_rows(picture: &RgbImage, rows: std::ops::Range<u32>) -> usize {
        rows.filter(|&y| picture.get_pixel(5, y).0.iter().all(|level| *level < 100)).count()
    }

    #[test]
    fn a_frame_without_a_pose_says_why_in_a_line_of_its_own() {
        let unsaid = drawn(&sample(State::Lost, -4.0), 0.0, &[]);
        let said = drawn(&PoseSample { reason: Some(crate::track::Reason::TooDark), ..sample(State::Lost, -4.0) }, 0.0, &[]);
        assert!(panel_rows(&unsaid, 0..240) > 12);
        assert!(panel_rows(&said, 0..240) > panel_rows(&unsaid, 0..240) + 12);
        let lit = said.enumerate_pixels().filter(|(x, y, _)| *x > 5 && (4..60).contains(y) && is(&said, (*x, *y), RED)).count();
        assert!(lit > 150, "{lit}");
    }

    #[test]
    fn every_size_has_its_legend_and_keeps_most_of_the_picture() {
        for (width, height) in [(160, 120), (320, 240), (640, 480), (1920, 1080), (1080, 1920)] {
            for level in [0, 100, 255] {
                let intrinsics = Intrinsics {
                    width,
                    height,
                    fx: 0.9 * f64::from(width),
                    fy: 0.9 * f64::from(width),
                    cx: f64::from(width) / 2.0,
                    cy: f64::from(height) / 2.0,
                    skew: 0.0,
                    distortion: [0.0; 5],
                };
                let camera = CameraModel::new(intrinsics).unwrap();
                let frame =
                    Frame { image: GrayImage::from_pixel(width, height, image::Luma([level])), timestamp: Default::default(), sequence: 7 };
                // Every second pixel of the frame was used.
                let at = |k: u32| [(k % (width / 2) * 2) as f32, (k / (width / 2) * 2) as f32];
                let pixels: Vec<UsedPixel> =
                    (0..width / 2 * (height / 2)).map(|k| UsedPixel { centre_px: at(k), sigmas: 1.0, takes_part: k % 3 != 0 }).collect();
                let scene = Scene { camera: &camera, stage: &body("stage", [3.0, 2.0]), objects: &[], pixels: &pixels, colours: None };
                let picture = draw(&frame, &sample(State::Tracking, -4.0), &scene);
                assert_eq!(picture.dimensions(), (width, height));
                // The legend's scale ends in a red that none of these pixels' marks has.
                let red = fit::fit_colour(1.0);
                let has_scale = picture.enumerate_pixels().any(|(_, y, p)| 2 * y > height && p.0 == red);
                assert!(has_scale, "{width} x {height}");
                let kept = picture.pixels().filter(|p| p.0 == [level; 3]).count() as f64 / f64::from(width * height);
                // Below 320 pixels, readable type hides more.
                let least = match width {
                    ..320 => 0.2,
                    320..640 => 0.6,
                    _ => 0.75,
                };
                assert!(kept > least, "{width} x {height} on {level}: {kept:.3}");
            }
        }
    }

    #[test]
    fn a_clip_in_colour_is_shown_in_colour() {
        let frame = Frame { image: GrayImage::from_pixel(640, 480, image::Luma([100])), timestamp: Default::default(), sequence: 7 };
        let colours = RgbImage::from_pixel(640, 480, image::Rgb([200, 30, 90]));
        let camera = camera(0.0);
        let scene = Scene { camera: &camera, stage: &body("stage", [3.0, 2.0]), objects: &[], pixels: &[], colours: Some(&colours) };
        let other = RgbImage::new(32, 48);
        let with = |colours| draw(&frame, &sample(State::Lost, -4.0), &Scene { colours, ..scene }).get_pixel(600, 300).0;
        assert_eq!(with(Some(&colours)), [200, 30, 90]);
        // Colours of another size belong to another picture.
        assert_eq!(with(Some(&other)), [100; 3]);
        assert_eq!(with(None), [100; 3]);
    }

    #[test]
    fn what_is_behind_the_camera_is_not_drawn() {
        let picture = drawn(&sample(State::Tracking, 4.0), 0.0, &[]);
        assert!(inside().all(|(x, y)| picture.get_pixel(x, y).0 == [100; 3]));
    }

    #[test]
    fn an_object_is_drawn_at_its_own_pose() {
        let mut sample = sample(State::Tracking, -4.0);
        let pose = Some(Pose::new(UnitQuaternion::identity(), Vector3::new(0.5, 0.0, 0.0)));
        sample.objects =
            vec![crate::record::ObjectSample { name: "cart".to_owned(), state: State::Tracking, pose, covariance: None, common: None }];
        let picture = drawn(&sample, 0.0, &[body("cart", [0.4, 0.4])]);
        // The centre is 0.5 m to the right: 75 pixels; half of 0.4 m is 30.
        assert!(is(&picture, (425, 240), CYAN));
        assert!(is(&picture, (395, 210), CYAN));
    }

    #[test]
    fn lines_are_cut_at_the_edges_without_walking_outside() {
        let size = Vector2::new(10.0, 10.0);
        let (a, b) = cut(Vector2::new(-1e12, 5.0), Vector2::new(1e12, 5.0), size).unwrap();
        assert!(a.x >= -1.01 && b.x <= 10.01);
        assert!(cut(Vector2::new(-5.0, -5.0), Vector2::new(-5.0, 50.0), size).is_none());
    }
}
