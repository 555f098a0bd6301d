//! A frame as a person wants to see it: what the tracker believes, drawn on the picture.
//!
//! Outlines of all surfaces run through the lens' distortion, so that they lie on the picture's own edges
//! when the pose is right. The border says the state: green tracking, yellow coasting, red lost, grey
//! searching.

use image::{Rgb, RgbImage};
use nalgebra::{Point3, Vector2, Vector3};

use super::text;
use crate::camera::{CameraModel, Normalized};
use crate::frame::Frame;
use crate::geometry::{Body, Camera, Pose};
use crate::record::{PoseSample, State};
use crate::track::{BodySpec, SurfaceSpec, UsedPixel};

const RED: Rgb<u8> = Rgb([235, 60, 50]);
const GREEN: Rgb<u8> = Rgb([60, 210, 80]);
const BLUE: Rgb<u8> = Rgb([80, 130, 255]);
const YELLOW: Rgb<u8> = Rgb([245, 205, 50]);
const GREY: Rgb<u8> = Rgb([150, 150, 150]);
const CYAN: Rgb<u8> = Rgb([70, 220, 230]);

/// Residuals beyond this many sigmas count nothing.
const COUNTS_NOTHING: f32 = 4.7;
/// Nearer than this in metres a point is taken as behind the camera.
const NEAR_M: f64 = 1e-3;
/// Pieces that a straight edge is cut into, so that distortion shows.
const PIECES: u32 = 48;

/// What a picture is drawn from.
pub struct Scene<'a> {
    /// At the frame's size.
    pub camera: &'a CameraModel,
    /// Its surfaces are drawn where the sample has a pose of it.
    pub stage: &'a BodySpec,
    /// Likewise.
    pub objects: &'a [BodySpec],
    /// The pixels that the frame's poses rest on.
    pub pixels: &'a [UsedPixel],
}

/// Draws the state, the used pixels, the surfaces and the stage's axes on a frame.
pub fn draw(frame: &Frame, sample: &PoseSample, scene: &Scene) -> RgbImage {
    let Scene { camera, stage, objects, pixels } = *scene;
    let mut picture = RgbImage::from_fn(frame.image.width(), frame.image.height(), |x, y| {
        let [level] = frame.image.get_pixel(x, y).0;
        Rgb([level; 3])
    });
    let colour = state_colour(sample.state);
    used(&mut picture, pixels);
    if let Some(stage_from_camera) = sample.pose {
        let camera_from_stage = stage_from_camera.inverse();
        for (body, object) in objects.iter().zip(&sample.objects) {
            if let Some(stage_from_object) = object.pose {
                let colour = if object.state == State::Tracking { CYAN } else { state_colour(object.state) };
                body.surfaces.iter().for_each(|s| outline(&mut picture, camera, &(camera_from_stage * stage_from_object), s, colour));
            }
        }
        // The stage is the body whose own frame is the stage frame.
        let camera_from_body = camera_from_stage.renamed();
        stage.surfaces.iter().for_each(|s| outline(&mut picture, camera, &camera_from_body, s, colour));
        axes(&mut picture, camera, &camera_from_body, stage);
    }
    border(&mut picture, colour);
    caption(&mut picture, sample, colour);
    picture
}

/// Each pixel that alignment asked, from green (fits) over yellow to red (counts nothing); grey where its tile shows something else.
fn used(picture: &mut RgbImage, pixels: &[UsedPixel]) {
    let thin = pixels.len() > (picture.width() * picture.height() / 40) as usize;
    for pixel in pixels {
        let share = (pixel.sigmas / COUNTS_NOTHING).clamp(0.0, 1.0);
        let level = |from: f32, to: f32| (from + (to - from) * (2.0 * share).min(1.0)) as u8;
        let colour = match (pixel.takes_part, share < 0.5) {
            (false, _) => GREY,
            (true, true) => Rgb([level(40.0, 245.0), 205, 50]),
            (true, false) => Rgb([245, (205.0 * 2.0 * (1.0 - share)) as u8, 50]),
        };
        let [x, y] = pixel.centre_px.map(f32::floor);
        let ends = if thin { 1 } else { 2 };
        for (dx, dy) in (0..ends * ends).map(|k| (k % ends, k / ends)) {
            let (x, y) = (x as u32 + dx, y as u32 + dy);
            if x < picture.width() && y < picture.height() {
                picture.put_pixel(x, y, colour);
            }
        }
    }
}

fn state_colour(state: State) -> Rgb<u8> {
    match state {
        State::Tracking => GREEN,
        State::Coasting => YELLOW,
        State::Lost => RED,
        State::Searching | State::Stale => GREY,
    }
}

fn outline(picture: &mut RgbImage, camera: &CameraModel, camera_from_body: &Pose<Camera, Body>, surface: &SurfaceSpec, colour: Rgb<u8>) {
    let [w, h] = surface.size_m.map(|m| m / 2.0);
    let corners = [(-w, h), (w, h), (w, -h), (-w, -h)].map(|(x, y)| surface.pose.transform(&Point3::new(x, y, 0.0)));
    for k in 0..4 {
        edge(picture, camera, camera_from_body, (corners[k], corners[(k + 1) % 4]), colour);
    }
}

/// x red, y green, z blue, a tenth of the first surface's width long.
fn axes(picture: &mut RgbImage, camera: &CameraModel, camera_from_stage: &Pose<Camera, Body>, stage: &BodySpec) {
    let Some(first) = stage.surfaces.first() else { return };
    let length = 0.1 * first.size_m[0];
    for (direction, colour) in [(Vector3::x(), RED), (Vector3::y(), GREEN), (Vector3::z(), BLUE)] {
        edge(picture, camera, camera_from_stage, (Point3::origin(), Point3::origin() + direction * length), colour);
    }
}

/// A straight edge in space as the lens shows it.
fn edge(
    picture: &mut RgbImage,
    camera: &CameraModel,
    camera_from_body: &Pose<Camera, Body>,
    (from, to): (Point3<f64>, Point3<f64>),
    colour: Rgb<u8>,
) {
    let (from, to) = (camera_from_body.transform(&from), camera_from_body.transform(&to));
    let pixel = |k: u32| project(camera, &(from + (to - from) * (f64::from(k) / f64::from(PIECES))));
    let mut previous = pixel(0);
    for k in 1..=PIECES {
        let next = pixel(k);
        if let (Some(a), Some(b)) = (previous, next) {
            line(picture, a, b, colour);
        }
        previous = next;
    }
}

/// The raw pixel of a point in front of the camera, within the lens' valid field.
fn project(camera: &CameraModel, point: &Point3<f64>) -> Option<Vector2<f64>> {
    if point.z.is_nan() || point.z <= NEAR_M {
        return None;
    }
    let n = Vector2::new(point.x / point.z, point.y / point.z);
    (n.norm() <= camera.valid_radius()).then(|| camera.project(Normalized(n)).0).filter(|p| p.iter().all(|v| v.is_finite()))
}

/// A line two pixels thick, cut at the picture's edges.
fn line(picture: &mut RgbImage, a: Vector2<f64>, b: Vector2<f64>, colour: Rgb<u8>) {
    let size = Vector2::new(f64::from(picture.width()), f64::from(picture.height()));
    let Some((a, b)) = cut(a, b, size) else { return };
    let steps = (b - a).amax().ceil().max(1.0) as u32;
    for k in 0..=steps {
        let p = a + (b - a) * (f64::from(k) / f64::from(steps));
        for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
            let (x, y) = ((p.x + dx).round(), (p.y + dy).round());
            if x >= 0.0 && y >= 0.0 && x < size.x && y < size.y {
                picture.put_pixel(x as u32, y as u32, colour);
            }
        }
    }
}

/// The part of a line inside of the picture (Liang and Barsky), so that a far end costs nothing.
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

fn border(picture: &mut RgbImage, colour: Rgb<u8>) {
    let (width, height) = picture.dimensions();
    let thickness = (width / 160).max(2);
    for (x, y, pixel) in picture.enumerate_pixels_mut() {
        if x < thickness || y < thickness || x + thickness >= width || y + thickness >= height {
            *pixel = colour;
        }
    }
}

fn caption(picture: &mut RgbImage, sample: &PoseSample, colour: Rgb<u8>) {
    let state = sample.state.word();
    let mut line = format!("{state} #{}", sample.sequence);
    if let Some(pose) = sample.pose {
        let p = pose.translation;
        line += &format!("  x {:+.3} y {:+.3} z {:+.3} m", p.x, p.y, p.z);
    }
    if let Some(measurement) = &sample.measurement {
        line += &format!("  rms {:.2} px", measurement.rms_px);
    }
    let scale = (picture.width() / 640).max(1);
    let margin = (picture.width() / 160).max(2) + 2;
    strip(picture, (margin, margin), scale, colour, &line);
    let Some(reason) = sample.reason else { return };
    // As many lines as the sentence takes.
    let room = ((picture.width() - margin.min(picture.width())) / (text::CELL_PX * scale)).saturating_sub(2).max(8) as usize;
    for (row, line) in (1..).zip(text::wrapped(reason.says(), room)) {
        strip(picture, (margin, margin + row * (text::CELL_PX * scale + 4)), scale, colour, &line);
    }
}

/// A line of text with its top left at a place, on a dark strip.
fn strip(picture: &mut RgbImage, (left, top): (u32, u32), scale: u32, colour: Rgb<u8>, line: &str) {
    let height = text::CELL_PX * scale;
    // A dark strip below the text, so that it reads on any picture.
    let width = line.chars().count() as u32 * text::CELL_PX * scale;
    for y in top..(top + height + 4).min(picture.height()) {
        for x in left..(left + width + 4).min(picture.width()) {
            picture.get_pixel_mut(x, y).0 = picture.get_pixel(x, y).0.map(|level| level / 4);
        }
    }
    text::write(picture, (left + 2, top + 2), scale, colour, line);
}

#[cfg(test)]
mod tests {
    use image::GrayImage;
    use nalgebra::{Quaternion, UnitQuaternion};

    use super::*;
    use crate::camera::Intrinsics;
    use crate::record::StageTimes;
    use crate::track::ReferenceKind;

    /// Upright, facing the audience.
    fn upright() -> UnitQuaternion<f64> {
        UnitQuaternion::from_quaternion(Quaternion::new(1.0, 1.0, 0.0, 0.0))
    }

    fn body(name: &str, size_m: [f64; 2]) -> BodySpec {
        let pose = Pose::new(upright(), Vector3::zeros());
        let surface = SurfaceSpec { name: name.to_owned(), artwork: GrayImage::new(40, 30), size_m, pose, kind: ReferenceKind::Artwork };
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
        PoseSample { sequence: 7, timestamp_ns: 0, state, pose, measurement: None, objects: Vec::new(), reason: None, times }
    }

    fn drawn(sample: &PoseSample, k1: f64, objects: &[BodySpec]) -> RgbImage {
        let frame = Frame { image: GrayImage::from_pixel(640, 480, image::Luma([100])), timestamp_ns: 0, sequence: 7 };
        draw(&frame, sample, &Scene { camera: &camera(k1), stage: &body("stage", [3.0, 2.0]), objects, pixels: &[] })
    }

    #[test]
    fn used_pixels_are_coloured_by_their_residual() {
        let mut picture = RgbImage::new(640, 480);
        let at = |x: f32, sigmas, takes_part| UsedPixel { centre_px: [x, 100.5], sigmas, takes_part };
        used(&mut picture, &[at(10.5, 0.0, true), at(20.5, 9.0, true), at(30.5, 0.0, false), at(639.5, 0.0, true)]);
        for (x, y) in [(10, 100), (11, 101)] {
            assert_eq!(*picture.get_pixel(x, y), Rgb([40, 205, 50]));
        }
        assert_eq!(*picture.get_pixel(20, 100), Rgb([245, 0, 50]));
        assert_eq!(*picture.get_pixel(30, 100), GREY);
        assert_eq!(*picture.get_pixel(12, 100), Rgb([0; 3]));
    }

    #[test]
    fn the_outline_lies_where_the_pinhole_puts_it() {
        let picture = drawn(&sample(State::Tracking, -4.0), 0.0, &[]);
        // 3 x 2 m at 4 m with f = 600: 450 x 300 pixels about the centre.
        for (x, y) in [(95, 240), (545, 240), (320, 90), (320, 390)] {
            assert_eq!(*picture.get_pixel(x, y), GREEN, "{x} {y}");
        }
        assert_eq!(picture.get_pixel(200, 200).0, [100; 3]);
        // The axes: x to the right, z up, 0.3 m long, that is 45 pixels; y points away from the camera.
        assert_eq!(*picture.get_pixel(355, 240), RED);
        assert_eq!(*picture.get_pixel(320, 205), BLUE);
        assert_eq!(picture.get_pixel(375, 240).0, [100; 3]);
    }

    #[test]
    fn distortion_bends_the_outline() {
        let picture = drawn(&sample(State::Tracking, -4.0), -0.2, &[]);
        let left_edge_at = |y: u32| (20..320).find(|&x| *picture.get_pixel(x, y) == GREEN).unwrap();
        assert!(left_edge_at(120) > left_edge_at(240) + 1, "{} {}", left_edge_at(120), left_edge_at(240));
    }

    #[test]
    fn without_a_pose_only_border_and_caption_are_drawn() {
        let picture = drawn(&sample(State::Lost, -4.0), 0.0, &[]);
        assert_eq!(*picture.get_pixel(1, 240), RED);
        let inside = (100..540).flat_map(|x| (60..470).map(move |y| (x, y)));
        assert!(inside.into_iter().all(|(x, y)| picture.get_pixel(x, y).0 == [100; 3]));
        assert_eq!(*drawn(&sample(State::Searching, -4.0), 0.0, &[]).get_pixel(1, 240), GREY);
        assert_eq!(*drawn(&sample(State::Coasting, -4.0), 0.0, &[]).get_pixel(1, 240), YELLOW);
    }

    #[test]
    fn a_frame_without_a_pose_says_why() {
        let unsaid = drawn(&sample(State::Lost, -4.0), 0.0, &[]);
        let said = drawn(&PoseSample { reason: Some(crate::track::Reason::TooDark), ..sample(State::Lost, -4.0) }, 0.0, &[]);
        // The second line, below the state's.
        let lit = |picture: &RgbImage| {
            (8..300).flat_map(|x| (20..30).map(move |y| (x, y))).filter(|&(x, y)| *picture.get_pixel(x, y) == RED).count()
        };
        assert_eq!(lit(&unsaid), 0);
        assert!(lit(&said) > 200, "{}", lit(&said));
    }

    #[test]
    fn what_is_behind_the_camera_is_not_drawn() {
        let picture = drawn(&sample(State::Tracking, 4.0), 0.0, &[]);
        let inside = (100..540).flat_map(|x| (60..470).map(move |y| (x, y)));
        assert!(inside.into_iter().all(|(x, y)| picture.get_pixel(x, y).0 == [100; 3]));
    }

    #[test]
    fn an_object_is_drawn_at_its_own_pose() {
        let mut sample = sample(State::Tracking, -4.0);
        let pose = Some(Pose::new(UnitQuaternion::identity(), Vector3::new(0.5, 0.0, 0.0)));
        sample.objects = vec![crate::record::ObjectSample { name: "cart".to_owned(), state: State::Tracking, pose, covariance: None }];
        let picture = drawn(&sample, 0.0, &[body("cart", [0.4, 0.4])]);
        // Centre 0.5 m to the right is 75 pixels; half of 0.4 m is 30.
        assert_eq!(*picture.get_pixel(425, 240), CYAN);
        assert_eq!(*picture.get_pixel(395, 210), CYAN);
    }

    #[test]
    fn lines_are_cut_at_the_edges_without_walking_outside() {
        let size = Vector2::new(10.0, 10.0);
        let (a, b) = cut(Vector2::new(-1e12, 5.0), Vector2::new(1e12, 5.0), size).unwrap();
        assert!(a.x >= -1.01 && b.x <= 10.01);
        assert!(cut(Vector2::new(-5.0, -5.0), Vector2::new(-5.0, 50.0), size).is_none());
    }
}
