use image::Luma;
use nalgebra::{UnitQuaternion, Vector3};

use super::*;
use crate::track::scene::surface::SurfaceSpec;
use crate::track::synthetic::{cloth, facing, lens, prepared, texture, view};

const SIZE: (u32, u32) = (640, 480);

fn truth() -> Pose<Camera, Body> {
    facing(0.2, -0.3, Vector3::new(0.1, 0.05, 3.4))
}

/// Returns the regions of a frame in which a cloth hangs at its known pose.
fn regions(frame: &GrayImage) -> Vec<Region> {
    let (rays, body) = (CameraRays::new(lens(SIZE.0, SIZE.1), None), prepared(vec![cloth(1)]));
    let (mut levels, mut unexplained) = (FrameLevels::default(), Unexplained::default());
    levels.update(frame);
    unexplained.look([(0, &body, truth().inverse())].into_iter(), &mut levels, &rays);
    unexplained.regions
}

fn frame() -> GrayImage {
    view(&cloth(1), &truth(), &lens(SIZE.0, SIZE.1))
}

/// Returns the fraction of a rectangle of the frame that the regions cover.
fn covered(regions: &[Region], [x, y]: [u32; 2], [width, height]: [u32; 2]) -> f64 {
    let is_in = |u: u32, v: u32| {
        let of = |r: &Region| {
            let place = u.checked_sub(r.origin[0]).zip(v.checked_sub(r.origin[1]));
            place.and_then(|(u, v)| r.mask.get_pixel_checked(u, v)).is_some_and(|p| p[0] > 0)
        };
        regions.iter().any(of)
    };
    let inside = (0..width * height).filter(|k| is_in(x + k % width, y + k / width)).count();
    inside as f64 / f64::from(width * height)
}

#[test]
fn a_stage_alone_leaves_nothing_to_search() {
    assert!(regions(&frame()).is_empty(), "{:?}", regions(&frame()).iter().map(|r| (r.origin, r.cells)).collect::<Vec<_>>());
}

#[test]
fn different_lighting_is_not_an_unexplained_region() {
    let dim =
        GrayImage::from_fn(SIZE.0, SIZE.1, |x, y| Luma([(f64::from(frame_at(x, y)) * (0.4 + 0.4 * f64::from(x) / 640.0) + 9.0) as u8]));
    assert!(regions(&dim).is_empty());
}

/// Returns the frame's grey value at a pixel; rendered once.
fn frame_at(x: u32, y: u32) -> u8 {
    static FRAME: std::sync::OnceLock<GrayImage> = std::sync::OnceLock::new();
    FRAME.get_or_init(frame).get_pixel(x, y)[0]
}

#[test]
fn a_prop_in_front_is_a_separate_region() {
    let prop = texture(90, 70, 5);
    let mut frame = frame();
    image::imageops::replace(&mut frame, &prop, 300, 200);
    let found = regions(&frame);
    assert_eq!(found.len(), 1, "{:?}", found.iter().map(|r| (r.origin, r.cells)).collect::<Vec<_>>());
    assert!(covered(&found, [300, 200], [90, 70]) > 0.9, "{}", covered(&found, [300, 200], [90, 70]));
    // Little around it is searched.
    assert!(covered(&found, [0, 0], [640, 480]) < 3.0 * 90.0 * 70.0 / (640.0 * 480.0));
}

#[test]
fn a_plain_card_is_not_worth_a_search() {
    let mut frame = frame();
    image::imageops::replace(&mut frame, &GrayImage::from_pixel(200, 160, Luma([120])), 220, 160);
    // Its border contrasts with the cloth, but its inside has no features.
    assert!(covered(&regions(&frame), [260, 200], [120, 80]) < 0.05);
}

#[test]
fn a_followed_prop_explains_its_own_pixels() {
    let camera = lens(SIZE.0, SIZE.1);
    let own = Pose::new(UnitQuaternion::from_euler_angles(0.1, 0.2, 0.3), Vector3::new(0.4, -0.2, 0.5));
    let prop = SurfaceSpec::from_artwork("prop".into(), texture(200, 200, 5), [0.8, 0.8], own).expect("texture enough");
    let mut frame = frame();
    // Puts the prop's pixels over the cloth: 30 is where the prop is not.
    for (under, over) in frame.pixels_mut().zip(view(&prop, &truth(), &camera).pixels()) {
        if over[0] != 30 {
            *under = *over;
        }
    }
    let rays = CameraRays::new(camera, None);
    let (stage, prop) = (prepared(vec![cloth(1)]), prepared(vec![prop]));
    let (mut levels, mut unexplained) = (FrameLevels::default(), Unexplained::default());
    levels.update(&frame);
    unexplained.look([(0, &stage, truth().inverse())].into_iter(), &mut levels, &rays);
    assert_eq!(unexplained.regions.len(), 1);
    for known in [[&stage, &prop], [&prop, &stage]] {
        unexplained.look((0..).zip(known).map(|(k, body)| (k, body, truth().inverse())), &mut levels, &rays);
        assert!(unexplained.regions.is_empty(), "{:?}", unexplained.regions.iter().map(|r| (r.origin, r.cells)).collect::<Vec<_>>());
    }
}

#[test]
fn a_region_keeps_the_frames_mask() {
    let mut frame = frame();
    image::imageops::replace(&mut frame, &texture(90, 70, 5), 300, 200);
    let region = regions(&frame).remove(0);
    let half_closed = GrayImage::from_fn(SIZE.0, SIZE.1, |x, _| Luma([if x < 345 { 0 } else { 255 }]));
    let (mut picture, mut mask) = (GrayImage::default(), GrayImage::default());
    // Its inner part: a window need not be the whole region.
    let (origin, size) = (region.origin.map(|v| v + 7), region.size().map(|n| n - 20));
    let window = Window { region: 0, origin, size, own: [origin, [0, 1].map(|k| origin[k] + size[k])] };
    region.cut_out(&window, &frame, Some(&half_closed), &mut picture, &mut mask);
    assert_eq!([picture.dimensions(), mask.dimensions()], [window.size.into(); 2]);
    for (x, y, pixel) in picture.enumerate_pixels() {
        let [u, v] = [x + window.origin[0], y + window.origin[1]];
        assert_eq!(pixel, frame.get_pixel(u, v));
        assert_eq!(mask.get_pixel(x, y)[0], if u < 345 { 0 } else { region.mask.get_pixel(x + 7, y + 7)[0] });
    }
}

#[test]
fn region_features_have_frame_coordinates() {
    let prop = texture(90, 70, 5);
    let mut frame = frame();
    image::imageops::replace(&mut frame, &prop, 300, 200);
    let (rays, body) = (CameraRays::new(lens(SIZE.0, SIZE.1), None), prepared(vec![cloth(1)]));
    let (mut levels, mut unexplained) = (FrameLevels::default(), Unexplained::default());
    levels.update(&frame);
    unexplained.look([(0, &body, truth().inverse())].into_iter(), &mut levels, &rays);
    let (mut extractor, workers, mut alone, mut all) = (FeatureExtractor::default(), Workers::new(1), Vec::new(), Vec::new());
    unexplained.extract(&frame, None, 500, &mut extractor, &workers, &mut alone);
    extractor.extract(&frame, None, &ExtractorOptions { count: 500, ..Default::default() }, &workers, &mut all);
    let on_prop = |f: &&Feature| (300.0..390.0).contains(&f.position.x) && (200.0..270.0).contains(&f.position.y);
    let [more, few] = [&alone, &all].map(|features| features.iter().filter(on_prop).count());
    assert!(more > 3 * few && more > 60, "{more} features on the prop where only it is looked at, {few} where all is");
    // Full-size features that both found must be at the same places.
    let fine = |f: &&Feature| f.scale == 1.0 && on_prop(f);
    let common = all.iter().filter(fine).filter(|f| alone.iter().any(|g| g.position == f.position && g.descriptor == f.descriptor)).count();
    assert!(2 * common >= all.iter().filter(fine).count(), "{common}");
    assert!(alone.iter().all(|f| covered(&unexplained.regions, f.position.map(|v| v.round() as u32).into(), [1, 1]) == 1.0));
}
