//! Every frame that is not tracked has a reason, both in the summary and in a sentence at the end.

use image::{GrayImage, Luma, imageops};

use super::scene::{Scene, texture};

/// Replays the scene with every frame changed, and returns the summary and the printed text.
fn replay_changed(scene: &Scene, change: impl Fn(&GrayImage) -> GrayImage) -> (serde_json::Value, String) {
    scene.change_frames(change);
    let run = scene.replay(&["--summary", "summary.json", "--overlay", "seen"]);
    run.assert_success();
    (serde_json::from_str(&scene.read("summary.json")).unwrap(), run.stdout)
}

fn levels(frame: &GrayImage, change: impl Fn(f32) -> f32) -> GrayImage {
    GrayImage::from_fn(frame.width(), frame.height(), |x, y| Luma([change(f32::from(frame.get_pixel(x, y)[0])).clamp(0.0, 255.0) as u8]))
}

/// Asserts that all six frames have this reason, that the final sentence says so, and that nothing
/// was tracked.
#[track_caller]
fn assert_reason(word: &str, says: &str, change: impl Fn(&GrayImage) -> GrayImage) {
    let (summary, printed) = replay_changed(&Scene::new(), change);
    assert_eq!(summary["tracking"], 0, "{word}: {summary}");
    assert_eq!(summary["reasons"][word], 6, "{word}: {summary}");
    assert!(printed.contains(says), "`{says}` is not in: {printed}");
}

#[test]
fn faults_of_the_frame_are_named_as_reasons() {
    assert_reason("too_dark", "In 6 frames the frame is too dark: give more light", |f| levels(f, |v| 0.02 * v));
    assert_reason("too_bright", "overexposed", |f| levels(f, |v| 6.0 * v + 200.0));
    assert_reason("blank", "without detail", |f| levels(f, |_| 120.0));
    assert_reason("too_blurred", "blurred: focus the lens", |f| imageops::blur(f, 9.0));
}

#[test]
fn a_picture_absent_or_far_too_small_is_the_reason() {
    let other = imageops::flip_horizontal(&texture(320, 240));
    assert_reason("not_recognised", "recognised in none of 6 frames. In 6 frames the frame has detail", |_| other.clone());
    // The picture is too small for its features to be distinguished.
    assert_reason("not_recognised", "point the camera at the stage, from near enough", |frame| {
        let small = imageops::resize(frame, 64, 48, imageops::FilterType::Triangle);
        let mut wide = GrayImage::from_pixel(320, 240, Luma([90]));
        imageops::replace(&mut wide, &small, 140, 100);
        wide
    });
}

/// The features of a poster 50 pixels wide are recognised, but a pose from so few pixels would be
/// too uncertain.
#[test]
fn a_picture_too_small_is_the_reason() {
    let scene = Scene::new();
    let poster = stagepose::diagnostics::calibrate::paint_poster(850, 1100, 1);
    poster.save(scene.path("art.png")).unwrap();
    scene.config_with("size_m = [4.0, 3.0]", "size_m = [0.2, 0.25882]");
    let lens = "fx = 550.0\nfy = 550.0\ncx = 319.5\ncy = 239.5\nskew = 0.0\ndistortion = [0.0, 0.0, 0.0, 0.0, 0.0]\n";
    scene.write("camera.toml", &format!("width = 640\nheight = 480\n{lens}"));
    let small = imageops::resize(&poster, 50, 65, imageops::FilterType::Triangle);
    let (summary, printed) = replay_changed(&scene, |_| {
        let mut wide = GrayImage::from_pixel(640, 480, Luma([90]));
        imageops::replace(&mut wide, &small, 300, 200);
        wide
    });
    assert_eq!((&summary["tracking"], &summary["reasons"]["too_small"]), (&0.into(), &6.into()), "{summary}");
    assert!(printed.contains("the picture is recognised, but it is too small in the frame: go nearer"), "{printed}");
}

#[test]
fn a_misfitting_picture_is_distinguished_from_an_absent_one() {
    let scene = Scene::new();
    scene.config_with("[4.0, 3.0]", "[3.0, 4.0]");
    let (summary, printed) = replay_changed(&scene, GrayImage::clone);
    assert_eq!((&summary["tracking"], &summary["reasons"]["no_pose_fits"]), (&0.into(), &6.into()), "{summary}");
    assert!(
        printed
            .contains("recognised in 6 of 6 frames, and tracked in none. In 6 frames the picture is recognised, but no pose fits: check"),
        "{printed}"
    );
}

#[test]
fn every_frame_is_counted_exactly_once() {
    let scene = Scene::new();
    scene.truncate("clip/frames/000003.png", 400);
    let (summary, printed) = replay_changed(&scene, GrayImage::clone);
    let reasons: u64 = summary["reasons"].as_object().unwrap().values().map(|n| n.as_u64().unwrap()).sum();
    assert_eq!(summary["reasons"]["undecodable"], 1, "{summary}");
    assert_eq!(reasons + summary["tracking"].as_u64().unwrap(), 6, "{summary}");
    assert!(printed.contains("The picture is recognised in 5 of 6 frames"), "{printed}");
}
