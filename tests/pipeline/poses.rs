//! Poses of a still and of a moving camera, poses past occluders, and pictures that must never be
//! mistaken for the stage.

use image::imageops;
use nalgebra::{Point3, Vector3};
use stagepose::{Occluder, State};

use super::scene::{aside, assert_tracks_within, backdrop, backdrop_art, body, camera, other_art, past, quiet, setup, surface};
use super::scene::{rows, track, track_rows};

const SHARE: f64 = 0.001;
const DEGREES: f64 = 0.05;

#[test]
fn a_still_camera_is_tracked_accurately() {
    let scene = quiet(camera(640, 360), aside(), backdrop());
    assert_tracks_within(&scene, &track(&scene, 6), SHARE, DEGREES);
}

#[test]
fn a_moving_camera_is_tracked_accurately() {
    let scene = quiet(camera(640, 360), past(), backdrop());
    assert_tracks_within(&scene, &track(&scene, 15), SHARE, DEGREES);
}

#[test]
fn surfaces_at_several_depths_make_one_stage() {
    let flats = vec![
        surface("backdrop", backdrop_art(), [4.0, 3.0], Vector3::zeros(), 0.0),
        surface("left", other_art(), [1.2, 0.9], Vector3::new(-0.9, -0.7, -0.3), 0.3),
        surface("right", &imageops::flip_vertical(other_art()), [1.2, 0.9], Vector3::new(0.8, -1.0, 0.1), -0.4),
    ];
    let scene = quiet(camera(640, 360), past(), body(flats));
    assert_tracks_within(&scene, &track(&scene, 8), SHARE, DEGREES);
}

#[test]
fn an_occluder_over_a_third_of_the_picture_moves_nothing() {
    let mut scene = quiet(camera(640, 360), aside(), backdrop());
    // 1.2 m from the camera, the frame covers 1.4 x 0.8 m: the ellipse has its full height and
    // almost half its width.
    let centre = Point3::new(-0.75, -2.0, 0.1);
    let (swing, half_size_m) = (Vector3::new(0.1, 0.0, 0.0), [0.32, 0.4]);
    scene.occluders.push(Occluder { centre, swing, period_s: 1.0, half_size_m, grey: 90.0 });
    let rows = rows(&scene, 8);
    let mut bare = scene.clone();
    bare.occluders.clear();
    let open = super::scene::rows(&bare, 1);
    let covered = share_that_differs(&rows[0], &open[0]);
    println!("covered: {covered:.2}");
    assert!((0.28..0.5).contains(&covered));
    assert_tracks_within(&scene, &track_rows(setup(&scene), &rows), 1.5 * SHARE, 1.5 * DEGREES);
}

/// Returns the fraction of two frames' pixels that differ by more than noise.
fn share_that_differs(a: &stagepose::ClipEntry, b: &stagepose::ClipEntry) -> f64 {
    use stagepose::EntryContent::Frame;
    let (Frame(a), Frame(b)) = (&a.content, &b.content) else { panic!("rendered rows are frames") };
    let differ = a.image.iter().zip(b.image.iter()).filter(|(x, y)| x.abs_diff(**y) > 8).count();
    differ as f64 / a.image.len() as f64
}

#[test]
fn another_picture_is_never_taken_for_the_stage() {
    let shown = body(vec![surface("decoy", other_art(), [4.0, 3.0], Vector3::zeros(), 0.0)]);
    let scene = quiet(camera(640, 360), past(), shown);
    let mut told = setup(&scene);
    told.stage = backdrop();
    assert!(track_rows(told, &rows(&scene, 8)).iter().all(|s| s.state == State::Searching));
}

#[test]
fn a_mirrored_picture_is_never_taken_for_the_stage() {
    let mirrored = imageops::flip_horizontal(backdrop_art());
    let scene = quiet(camera(640, 360), past(), body(vec![surface("mirrored", &mirrored, [4.0, 3.0], Vector3::zeros(), 0.0)]));
    let mut told = setup(&scene);
    told.stage = backdrop();
    assert!(track_rows(told, &rows(&scene, 8)).iter().all(|s| s.state == State::Searching));
}
