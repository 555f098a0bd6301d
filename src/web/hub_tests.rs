use image::Luma;
use nalgebra::Vector2;

use super::*;
use crate::frame::{Frame, Timestamp};
use crate::track::Reason;

/// Width and height of the pictures, pixels.
const SIZE: (u32, u32) = (64, 48);

fn sample(sequence: u64, state: State) -> PoseSample {
    PoseSample::new(sequence, Timestamp::from_ns(40), state)
}

fn row(sequence: u64, received: Option<Received>) -> ClipEntry {
    let picture = GrayImage::from_fn(SIZE.0, SIZE.1, |x, y| Luma([(40 + 2 * x + y) as u8]));
    let frame = Frame::new(picture, Timestamp::from_ns(40), sequence);
    ClipEntry { received, ..ClipEntry::new(sequence, Timestamp::from_ns(40), EntryContent::Frame(frame)) }
}

/// Returns the head and the JPEG of a message.
fn parts(message: &[u8]) -> (serde_json::Value, &[u8]) {
    let (length, rest) = message.split_first_chunk().unwrap();
    let (head, jpeg) = rest.split_at(u32::from_le_bytes(*length) as usize);
    (serde_json::from_slice(head).unwrap(), jpeg)
}

/// Returns heads of messages with all fields, and with none.
pub(in crate::web) fn heads() -> Vec<serde_json::Value> {
    let [tracked, mut lost] = crate::web::api::types_tests::samples();
    lost.reason = Some(Reason::Covered);
    let motion = CameraMotion { velocity: [0.5, 0.0, 0.25], angular_velocity: [0.0, 2.0, 0.0] };
    let used = Shown { pixels: vec![1, 2], hidden: vec![3, 4], displaced: vec![1.0, 2.0, 0.1, 0.2] };
    let whole = Taken { used: Some(used), ..taken(1, &row(1, None), &tracked, Some(motion)).unwrap() };
    [whole, taken(1, &row(2, None), &lost, None).unwrap()].iter().map(|row| parts(&message(row).unwrap()).0).collect()
}

#[test]
fn a_camera_jpeg_is_passed_through_with_its_frames_record() {
    let jpeg: Arc<[u8]> = std::fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/dolly/frames/000000.jpg")).unwrap().into();
    let mut lost = sample(7, State::Lost);
    let motion = CameraMotion { velocity: [0.5, 0.0, 0.25], angular_velocity: [0.0, 2.0, 0.0] };
    lost.reason = Some(Reason::Covered);
    let taken = taken(3, &row(7, Some(Received::Jpeg(jpeg.clone()))), &lost, Some(motion)).unwrap();
    let message = message(&taken).unwrap();
    let (head, picture) = parts(&message);
    assert_eq!(picture, &*jpeg);
    assert_eq!(head["record"].to_string(), serde_json::from_str::<serde_json::Value>(&lost.to_json_line()).unwrap().to_string());
    assert_eq!((&head["epoch"], &head["size"][0], &head["reason"]), (&3.into(), &64.into(), &"covered".into()));
    assert_eq!((&head["motion"]["velocity"][2], &head["motion"]["turn_rate"][1]), (&0.25.into(), &2.0.into()));
    assert_eq!((&head["says"], &head["mend"]), (&Reason::Covered.message().into(), &Reason::Covered.hint().into()));
}

#[test]
fn missing_huffman_tables_are_inserted() {
    let whole = std::fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/dolly/frames/000000.jpg")).unwrap();
    assert_eq!(*with_huffman_tables(&whole), *whole);
    // Encoded here with the standard tables, which are then cut out: FF C4, its length, its
    // content.
    let mut jpeg = Vec::new();
    let row = row(0, None);
    let EntryContent::Frame(frame) = &row.content else { unreachable!("it was made with a frame") };
    Encoder::new(&mut jpeg, QUALITY).encode(&frame.image, SIZE.0 as u16, SIZE.1 as u16, ColorType::Luma).unwrap();
    let mut bare = jpeg.clone();
    while let Some(at) = bare.windows(2).position(|two| two == [0xFF, 0xC4]) {
        let length = usize::from(u16::from_be_bytes([bare[at + 2], bare[at + 3]]));
        bare.drain(at..at + 2 + length);
    }
    assert!(image::load_from_memory(&with_huffman_tables(&bare)).unwrap().to_luma8() == image::load_from_memory(&jpeg).unwrap().to_luma8());
    assert_eq!(*with_huffman_tables(&bare[..200]), bare[..200], "half a picture stays half a picture");
}

#[test]
fn raw_pictures_are_encoded_and_empty_rows_skipped() {
    let taken_of = |row: &ClipEntry| taken(1, row, &sample(0, State::Tracking), None);
    let row = row(0, Some(Received::Raw));
    let message = message(&taken_of(&row).unwrap()).unwrap();
    let (head, jpeg) = parts(&message);
    assert!(head["says"].is_null() && head["reason"].is_null(), "{head}");
    let shown = image::load_from_memory_with_format(jpeg, image::ImageFormat::Jpeg).unwrap();
    let EntryContent::Frame(frame) = &row.content else { unreachable!("it was made with a frame") };
    let worst = shown.to_luma8().iter().zip(frame.image.iter()).map(|(a, b)| a.abs_diff(*b)).max();
    assert!(shown.width() == SIZE.0 && worst <= Some(6), "{worst:?}");
    let damaged = ClipEntry::new(0, Timestamp::from_ns(40), EntryContent::Undecodable("cut off".to_owned()));
    assert!(taken_of(&damaged).is_none());
}

#[test]
fn nothing_is_copied_while_nobody_waits() {
    let hub = Hub::start(Arc::default()).unwrap();
    let mut observer = hub.observer(None);
    let mut messages = hub.messages();
    (0..100).for_each(|k| observer(&row(k, None), &sample(k, State::Tracking)));
    assert_eq!(hub.copied(), 0);
    let waiting = hub.wait();
    observer(&row(100, None), &sample(100, State::Tracking));
    drop(waiting);
    (101..200).for_each(|k| observer(&row(k, None), &sample(k, State::Tracking)));
    assert_eq!(hub.copied(), 1);
    let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
    runtime.block_on(messages.changed()).unwrap();
    assert_eq!(parts(&messages.borrow_and_update()).0["record"]["sequence"], 100);
}

#[test]
fn each_session_has_its_own_number() {
    let hub = Hub::start(Arc::default()).unwrap();
    let (mut first, mut second) = (hub.observer(None), hub.observer(None));
    let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
    let _waiting = hub.wait();
    let mut messages = hub.messages();
    let mut epoch = |observer: &mut dyn FnMut(&ClipEntry, &PoseSample)| {
        observer(&row(0, None), &sample(0, State::Tracking));
        runtime.block_on(messages.changed()).unwrap();
        parts(&messages.borrow_and_update()).0["epoch"].as_u64()
    };
    assert_eq!((epoch(&mut first), epoch(&mut second)), (Some(1), Some(2)));
}

#[test]
fn used_pixels_are_sent_with_their_frame_on_request() {
    let hub = Hub::start(Arc::default()).unwrap();
    let (tracker, pixels) = crossbeam_channel::unbounded();
    let mut observer = hub.observer(Some(pixels));
    let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
    let mut messages = hub.messages();
    let wants = hub.wants_pixels();
    assert!(!wants.load(Ordering::Relaxed));
    let asking = (hub.ask_pixels(), hub.ask_pixels());
    drop(asking.0);
    assert!(wants.load(Ordering::Relaxed), "one still asks");
    let pixel = |k: usize| UsedPixel { centre_px: [k as f32 + 0.4, 7.0], sigmas: if k == 1 { 9.0 } else { 1.0 }, takes_part: k % 10 != 3 };
    for sequence in 4..7 {
        let tile = |k: f64| Displaced { centre_px: Vector2::new(10.0 * k, 3.00049), shift_px: Vector2::new(-0.1234, 0.25) };
        let displaced = (0..400).map(|k| tile(f64::from(k))).collect();
        tracker.send(UsedPixels { sequence, pixels: (0..2000).map(pixel).collect(), displaced }).unwrap();
    }
    let _waiting = hub.wait();
    observer(&row(5, None), &sample(5, State::Tracking));
    runtime.block_on(messages.changed()).unwrap();
    let head = parts(&messages.borrow_and_update()).0;
    let numbers = |key: &str| -> Vec<f64> { head[key].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect() };
    let (used, hidden, displaced) = (numbers("used"), numbers("hidden"), numbers("displaced"));
    // Every fourth of 1999: all but the one without weight. One in ten is hidden.
    assert_eq!((used.len(), &used[..6]), (800, &[0.0, 7.0, 5.0, 7.0, 9.0, 7.0][..]));
    assert_eq!((hidden.len(), &hidden[..4]), (200, &[13.0, 7.0, 33.0, 7.0][..]));
    assert_eq!((displaced.len(), &displaced[..5]), (800, &[0.0, 3.0, -0.123, 0.25, 20.0][..]));
    drop(asking.1);
    assert!(!wants.load(Ordering::Relaxed));
    observer(&row(8, None), &sample(8, State::Tracking));
    runtime.block_on(messages.changed()).unwrap();
    let head = parts(&messages.borrow_and_update()).0;
    assert!(head["used"].is_null() && head["hidden"].is_null() && head["displaced"].is_null(), "{head}");
}
