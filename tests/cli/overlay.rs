//! `replay --overlay`: colour pictures, or a video through ffmpeg.

use std::process::Command;

use image::{Rgb, RgbImage};

use super::scene::Scene;

/// Whether ffmpeg is installed; prints a message if it is not.
fn has_ffmpeg() -> bool {
    let runs = Command::new("ffmpeg").arg("-version").output().is_ok_and(|output| output.status.success());
    if !runs {
        eprintln!("skipped: ffmpeg is not installed");
    }
    runs
}

/// Returns a scene with tinted frames, so that colour and grey differ.
fn tinted() -> Scene {
    let scene = Scene::new();
    for k in 0..6 {
        let file = scene.path(&format!("clip/frames/{k:06}.png"));
        let grey = image::open(&file).unwrap().into_luma8();
        let tint = |level: u8| Rgb([level, (u16::from(level) * 3 / 4) as u8, level / 2]);
        RgbImage::from_fn(grey.width(), grey.height(), |x, y| tint(grey.get_pixel(x, y).0[0])).save(&file).unwrap();
    }
    scene
}

/// Returns the fraction of pixels below the panel that are redder than they are blue.
fn tinted_share(picture: &RgbImage) -> f64 {
    let tinted = picture.enumerate_pixels().filter(|(_, y, p)| (60..200).contains(y) && p.0[0] > p.0[2].saturating_add(12)).count();
    tinted as f64 / f64::from(picture.width() * 140)
}

#[test]
fn a_colour_clip_has_a_colour_overlay_and_the_same_poses() {
    let scene = tinted();
    scene.replay(&["--overlay", "seen", "--poses", "with.jsonl"]).assert_success();
    scene.replay(&["--poses", "without.jsonl"]).assert_success();
    assert_eq!(scene.read("with.jsonl"), scene.read("without.jsonl"));
    let picture = image::open(scene.path("seen/000003.jpg")).unwrap().into_rgb8();
    assert!(tinted_share(&picture) > 0.5, "{}", tinted_share(&picture));
}

#[test]
fn a_video_file_name_produces_a_video() {
    if !has_ffmpeg() {
        return;
    }
    let scene = tinted();
    for name in ["seen.mp4", "seen.mkv", "seen.webm", "seen.avi", "seen.mov"] {
        scene.replay(&["--overlay", name]).assert_success();
        let decoded = Command::new("ffmpeg")
            .args(["-v", "error", "-i", name, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"])
            .current_dir(scene.path("."))
            .output()
            .unwrap();
        let frames: Vec<&[u8]> = decoded.stdout.chunks(320 * 240 * 3).collect();
        assert_eq!(frames.len(), 6, "{name}: {}", String::from_utf8_lossy(&decoded.stderr));
        let picture = RgbImage::from_raw(320, 240, frames[3].to_vec()).unwrap();
        assert!(tinted_share(&picture) > 0.5, "{name} {}", tinted_share(&picture));
    }
}

#[test]
fn a_video_clip_gets_an_overlay_video() {
    if !has_ffmpeg() {
        return;
    }
    let scene = tinted();
    let made = Command::new("ffmpeg")
        .args(["-v", "error", "-framerate", "30", "-i", "clip/frames/%06d.png", "-pix_fmt", "yuv444p", "clip.mkv"])
        .current_dir(scene.path("."))
        .status();
    assert!(made.unwrap().success());
    scene.run(&["replay", "clip.mkv", "--config", "stage.toml", "--overlay", "seen"]).assert_success();
    let picture = image::open(scene.path("seen/000003.jpg")).unwrap().into_rgb8();
    assert!(tinted_share(&picture) > 0.5, "{}", tinted_share(&picture));
    // The clip itself is not overwritten.
    scene.run(&["replay", "clip.mkv", "--config", "stage.toml", "--overlay", "clip.mkv"]).assert_refused(2, &["--overlay", "clip.mkv"]);
}

#[test]
fn without_ffmpeg_a_video_is_refused_before_anything_is_written() {
    let scene = Scene::new();
    scene.write("poses.jsonl", "kept");
    let mut run = scene.command(&["replay", "clip", "--config", "stage.toml", "--overlay", "seen.mp4", "--poses", "poses.jsonl"]);
    let output = run.env("PATH", scene.path("nothing")).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("seen.mp4") && said.contains("ffmpeg") && said.contains("install"), "{said}");
    assert_eq!(scene.read("poses.jsonl"), "kept");
}

#[test]
fn a_video_that_cannot_be_written_is_named() {
    if !has_ffmpeg() {
        return;
    }
    let scene = Scene::new();
    scene.replay(&["--overlay", "gone/seen.mp4"]).assert_refused(1, &["gone/seen.mp4: cannot be written"]);
    // Without a readable frame, no video is written.
    scene.write("clip/timestamps.csv", "#timestamp [ns],filename\n0,gone.png\n");
    scene.replay(&["--overlay", "seen.mp4"]).assert_refused(1, &["clip"]);
    assert!(!scene.path("seen.mp4").exists());
}
