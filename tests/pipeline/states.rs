//! What the record says while the stage cannot be seen.

use stagepose::State::{Coasting, Lost, Searching, Tracking};
use stagepose::{ClipEntry, EntryContent, Frame, FrameError, Reason, SetupError, Timestamp, Tracker, TrackerSetup, VirtualStage};

use super::scene::{FPS, aside, backdrop, camera, errors, past, quiet, rows, setup, states, track, track_rows, truth_of};

fn frame_of(content: EntryContent) -> Option<Frame> {
    match content {
        EntryContent::Frame(frame) => Some(frame),
        _ => None,
    }
}

fn small() -> VirtualStage {
    quiet(camera(480, 360), past(), backdrop())
}

#[test]
fn a_blackout_coasts_is_lost_and_is_found_again() {
    let mut scene = small();
    scene.blackouts.push(3.5 / FPS..14.5 / FPS);
    let samples = track(&scene, 18);
    // The last tracked frame is 3; 0.2 s later is frame 9.
    let expected = [vec![Tracking; 4], vec![Coasting; 6], vec![Lost; 5], vec![Tracking; 3]].concat();
    assert_eq!(states(&samples), expected);
    for sample in samples.iter().filter(|s| s.state == Coasting) {
        let pose = sample.pose.expect("coasting predicts");
        let off = (pose.translation - truth_of(&scene, sample).translation).norm();
        assert!(off < 0.15, "frame {} is {off} m off", sample.sequence);
    }
    for sample in samples.iter().filter(|s| s.state == Tracking) {
        let (shift, _) = errors(&scene, sample);
        assert!(shift < 0.002);
    }
}

#[test]
fn coasting_ends_by_stamps_not_by_frames() {
    let mut scene = small();
    scene.blackouts.push(2.5 / FPS..100.0);
    let mut rows = rows(&scene, 8);
    // The camera hangs for a second while the stage is dark.
    for row in &mut rows[4..] {
        row.timestamp = row.timestamp.after_s(1.0);
        if let EntryContent::Frame(frame) = &mut row.content {
            frame.timestamp = row.timestamp;
        }
    }
    let states = states(&track_rows(setup(&scene), &rows));
    assert_eq!(states, [Tracking, Tracking, Tracking, Coasting, Lost, Lost, Lost, Lost]);
}

fn undecodable(row: &ClipEntry) -> ClipEntry {
    ClipEntry::new(row.sequence, row.timestamp, EntryContent::Undecodable("the file ends too soon".into()))
}

fn skipped(row: &ClipEntry, timestamp: Timestamp) -> ClipEntry {
    ClipEntry::new(row.sequence, timestamp, EntryContent::Skipped("out of order".into()))
}

#[test]
fn undecodable_and_skipped_rows_yield_records_only() {
    let scene = small();
    let whole = rows(&scene, 9);
    let undisturbed = track_rows(setup(&scene), &whole);
    let mut rows = whole.clone();
    rows[4] = undecodable(&whole[4]);
    rows[6] = skipped(&whole[6], whole[5].timestamp);
    let samples = track_rows(setup(&scene), &rows);
    assert_eq!(samples.len(), rows.len());
    assert_eq!(states(&samples), [Tracking, Tracking, Tracking, Tracking, Coasting, Tracking, Lost, Tracking, Tracking]);
    for (row, (sample, before)) in rows.iter().zip(samples.iter().zip(&undisturbed)) {
        assert_eq!((sample.sequence, sample.timestamp), (row.sequence, row.timestamp));
        if matches!(row.content, EntryContent::Frame(_)) {
            // After a gap, the motion estimate differs, and with it the start of the next
            // alignment.
            let (pose, undisturbed) = (sample.pose.expect("it tracks"), before.pose.expect("it tracks"));
            assert!((pose.translation - undisturbed.translation).norm() < 5e-4 && pose.angle_to(&undisturbed) < 2e-4);
        }
    }
}

/// A capture card without a new picture repeats the last one byte for byte, with a new timestamp.
#[test]
fn a_repeated_picture_is_not_a_measurement() {
    let scene = small();
    let mut rows = rows(&scene, 14);
    let EntryContent::Frame(frozen) = rows[3].content.clone() else { panic!("rendered rows are frames") };
    for row in &mut rows[4..12] {
        row.content = EntryContent::Frame(Frame::new(frozen.image.clone(), row.timestamp, row.sequence));
        row.repeats = true;
    }
    let samples = track_rows(setup(&scene), &rows);
    assert_eq!(states(&samples), [vec![Tracking; 4], vec![Coasting; 6], vec![Lost; 2], vec![Tracking; 2]].concat());
    assert!(samples[4..12].iter().all(|s| s.reason == Some(Reason::Repeated)));
    // If the picture yielded no pose the first time, its repetition may.
    let mut found_late = vec![undecodable(&rows[3]), rows[4].clone()];
    found_late.push(rows[5].clone());
    let states = states(&track_rows(setup(&scene), &found_late));
    assert_eq!(states, [Searching, Tracking, Coasting]);
}

#[test]
fn a_frame_that_does_not_fit_is_refused_without_effect() {
    let scene = small();
    let frames: Vec<Frame> = rows(&scene, 4).into_iter().filter_map(|row| frame_of(row.content)).collect();
    let (mut told, mut alone) =
        (Tracker::new(setup(&scene)).expect("a setup that fits"), Tracker::new(setup(&scene)).expect("a setup that fits"));
    for frame in &frames {
        let last = frame.timestamp;
        let sample = told.track(frame).expect("it fits");
        assert_eq!(sample.to_json_line(), alone.track(frame).expect("it fits").to_json_line());
        let small = Frame::new(image::GrayImage::new(100, 80), last.after_ns(1), frame.sequence);
        assert_eq!(told.track(&small), Err(FrameError::Size { size: (100, 80), wanted: (480, 360) }));
        for timestamp in [last, last.after_ns(-1)] {
            let late = Frame::new(frame.image.clone(), timestamp, frame.sequence);
            assert_eq!(told.track(&late), Err(FrameError::Stamp { timestamp, last }));
        }
    }
}

#[test]
fn a_setup_that_does_not_fit_is_an_error() {
    let scene = small();
    let mask = |width, height| Some(image::GrayImage::from_pixel(width, height, image::Luma([255])));
    let tracker = |mask| {
        let mut setup = setup(&scene);
        setup.mask = mask;
        Tracker::new(setup)
    };
    assert!(tracker(mask(480, 360)).is_ok());
    let refused = |change: fn(&mut TrackerSetup)| {
        let mut setup = setup(&scene);
        change(&mut setup);
        Tracker::new(setup).err().map(|e| e.to_string()).expect("it does not fit")
    };
    let small_mask = tracker(mask(100, 80)).err();
    assert_eq!(small_mask, Some(SetupError::MaskSize { size: (100, 80), wanted: (480, 360) }));
    assert_eq!(refused(|s| s.shutter.exposure_s = Some(-0.1)), "exposure_s is -0.1 s; give a number of 0 or more");
    assert_eq!(refused(|s| s.shutter.readout_s = Some(f64::NAN)), "readout_s is NaN s; give a number");
    assert_eq!(
        refused(|s| s.stage.surfaces.clear()),
        format!("the body `{}` has no surface; give it one, or leave it out", scene.stage.name)
    );
    assert!(refused(|s| s.stage.surfaces[0].artwork = Default::default()).contains("the picture is 0 x 0 pixels"));
    assert!(refused(|s| s.stage.surfaces[0].size_m = [4.0, f64::NAN]).contains("both must be above 0 metres"));
}

#[test]
fn a_skipped_row_does_not_end_a_track() {
    let scene = small();
    let mut rows = rows(&scene, 8);
    rows[4] = skipped(&rows[4], rows[3].timestamp);
    rows[5] = undecodable(&rows[5]);
    let samples = track_rows(setup(&scene), &rows);
    assert_eq!(states(&samples), [Tracking, Tracking, Tracking, Tracking, Lost, Coasting, Tracking, Tracking]);
}

#[test]
fn a_first_row_without_a_picture_has_state_searching() {
    let scene = quiet(camera(320, 240), aside(), backdrop());
    let mut rows = rows(&scene, 4);
    rows[0] = undecodable(&rows[0]);
    rows[1] = skipped(&rows[1], Timestamp::default());
    assert_eq!(states(&track_rows(setup(&scene), &rows)), [Searching, Searching, Tracking, Tracking]);
}

#[test]
fn a_frame_of_another_size_is_not_tracked() {
    let scene = small();
    let mut rows = rows(&scene, 4);
    let EntryContent::Frame(frame) = &mut rows[2].content else { panic!("rendered rows are frames") };
    frame.image = image::GrayImage::new(100, 80);
    assert_eq!(states(&track_rows(setup(&scene), &rows)), [Tracking, Tracking, Coasting, Tracking]);
}
