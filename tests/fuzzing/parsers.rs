//! The parsers in this process: a panic, a minute without an end, or memory beyond the bound is a
//! failure.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use stagepose::diagnostics::calibrate::Board;
use stagepose::diagnostics::capture::{AviReader, MjpegReader, Y4mReader, decode_oriented, ffmpeg_account, picture_size, read_timestamps};
use stagepose::diagnostics::delay::read_pose_log;
use stagepose::diagnostics::export::Take;
use stagepose::diagnostics::timecode::{LtcDecoder, LtcSignal, RawFormat, Sound, TimecodeRate, TimecodeRows, wav};
use stagepose::diagnostics::web::judge_model;
use stagepose::protocols::freed::FreedPacket;
use stagepose::protocols::opentrackio::{self, Encoding};
use stagepose::protocols::otp::{OtpHeader, OtpMessage, OtpModule, OtpPoint, OtpTransform};
use stagepose::protocols::psn::{PsnHeader, PsnPacket, PsnTracker};
use stagepose::{Facet, FacetTexture, LearntCamera, Pose, Settings, StageMap, parse_calibration};

use super::memory::taken_by;
use super::mutator::{Form, Mutator};
use super::{inputs, keep, seed, seeds};

/// Maximum time for one input; a parser that takes longer hangs.
const HANG: Duration = Duration::from_secs(60);
/// Maximum memory for a text, bytes. A config reads pictures; all other texts take less.
const MAX_OF_TEXT: usize = 256 << 20;
/// Maximum memory for a picture, bytes: 67 million pixels of 16-bit RGBA, and what is made from
/// them.
const MAX_OF_PICTURES: usize = 1200 << 20;

/// Allows one parser at a time, because the memory count covers the whole process.
static ALONE: Mutex<()> = Mutex::new(());

fn fuzz(name: &'static str, mutator: Mutator, most: usize, parse: impl Fn(&[u8]) + Send + 'static) {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let count = inputs();
    let (begun, told) = std::sync::mpsc::channel();
    let (outcome, ended) = std::sync::mpsc::channel();
    let mut mutator = mutator;
    let worker = std::thread::Builder::new().name(format!("fuzz {name}")).spawn(move || {
        let mut peak = 0;
        for number in 0..count {
            let input = mutator.next_input();
            begun.send(input.clone()).expect("the judge waits");
            let mut panicked = false;
            let taken = taken_by(|| panicked = catch_unwind(AssertUnwindSafe(|| parse(&input))).is_err());
            peak = peak.max(taken);
            if panicked || taken > most {
                let fault = if panicked { "panics".to_owned() } else { format!("takes {} MB", taken >> 20) };
                let kept = keep(name, number, &input);
                outcome.send(Err(format!("{name} {fault} on input {number}; see {kept}"))).expect("the judge waits");
                return;
            }
        }
        outcome.send(Ok(peak)).expect("the judge waits");
    });
    worker.expect("a thread");
    let mut last = Vec::new();
    let mut number = 0;
    loop {
        match told.recv_timeout(HANG) {
            Ok(input) => {
                last = input;
                number += 1;
            }
            Err(std::sync::mpsc::RecvTimeoutError::Disconnected) => break,
            Err(_) => panic!("{name} hangs on input {number}; see {}", keep(name, number, &last)),
        }
    }
    let verdict: Result<usize, String> = ended.recv().expect("the worker tells");
    let peak = verdict.unwrap_or_else(|fault| panic!("{fault}"));
    assert_eq!(number, count);
    println!("{name}: {count} inputs, no fault; largest peak {} kB", peak >> 10);
}

fn text(seeds: &[&str]) -> Mutator {
    Mutator::new(seed(), Form::Text, seeds.iter().map(|s| s.as_bytes().to_vec()).collect())
}

#[test]
fn configs() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("camera.toml"), seeds::CAMERA).unwrap();
    seeds::picture(120, 90).save(folder.path().join("art.png")).unwrap();
    seeds::picture(120, 90).save(folder.path().join("mask.png")).unwrap();
    let file = folder.path().join("stage.toml");
    Settings::from_text(seeds::STAGE, &file).expect("the seed is good");
    fuzz("config", text(&[seeds::STAGE, seeds::CONFIG]), MAX_OF_TEXT, move |bytes| {
        let _kept = &folder;
        let _ = Settings::from_text(&String::from_utf8_lossy(bytes), &file).map_err(|e| assert!(!e.to_string().is_empty()));
    });
}

#[test]
fn shapes() {
    let folder = tempfile::tempdir().unwrap();
    let picture = seeds::picture(120, 90);
    picture.save(folder.path().join("art.png")).unwrap();
    let at = |name: &str| folder.path().join(name);
    let (shape, file, good) = (at("shape.toml"), at("stage.toml"), seeds::shape(&picture));
    std::fs::write(at("camera.toml"), seeds::CAMERA).unwrap();
    let config =
        "[camera]\ncalibration = \"camera.toml\"\n[[stage.surface]]\nimage = \"art.png\"\nsize_m = [4.0, 3.0]\nshape = \"shape.toml\"\n";
    std::fs::write(&shape, &good).unwrap();
    Settings::from_text(config, &file).expect("the seed is good");
    fuzz("shape", text(&[&good]), MAX_OF_TEXT, move |bytes| {
        let _kept = &folder;
        std::fs::write(&shape, bytes).unwrap();
        let _ = Settings::from_text(config, &file).map_err(|e| assert!(e.to_string().contains("shape.toml"), "{e}"));
    });
}

#[test]
fn maps() {
    let texture = FacetTexture { width: 9, height: 7, light: (0..63).map(|n| 900 * n).collect() };
    let facet = Facet { name: "facet 1".to_owned(), size_m: [0.4, 0.3], pose: Pose::identity(), shape: Default::default(), texture };
    let map = StageMap { bend: [0.0; 7], keyframes: vec![Pose::identity(); 2], facets: vec![facet.clone(), facet] };
    let good = map.to_bytes();
    let binary = |bytes: &[u8]| Mutator::new(seed(), Form::Binary, vec![bytes.to_vec()]);
    fuzz("map", binary(&good), MAX_OF_TEXT, |bytes| {
        let _ = StageMap::from_bytes(bytes).map_err(|e| assert!(!e.to_string().is_empty()));
    });
    // Nothing is read behind a wrong digest, so the body is changed and sealed anew.
    let head = good[..20].to_vec();
    fuzz("map body", binary(&good[36..]), MAX_OF_TEXT, move |body| {
        let digest = body.iter().fold(0xcbf2_9ce4_8422_2325_u64, |h, b| (h ^ u64::from(*b)).wrapping_mul(0x0100_0000_01b3));
        let whole = [&head[..], &(body.len() as u64).to_le_bytes(), &digest.to_le_bytes(), body].concat();
        match StageMap::from_bytes(&whole) {
            Ok(map) => {
                assert_eq!(map.to_bytes(), whole);
                let _ = map.surfaces();
            }
            Err(e) => assert!(e.to_string().contains("map the set again"), "{e}"),
        }
    });
}

#[test]
fn packets() {
    let binary = |seed_bytes: Vec<u8>| Mutator::new(seed(), Form::Binary, vec![seed_bytes]);
    fuzz("freed", binary(FreedPacket::default().encode().0.to_vec()), MAX_OF_TEXT, |bytes| {
        let _ = FreedPacket::decode(bytes);
    });
    let tracker =
        PsnTracker { id: 1, position_m: Some([1.0, 2.0, 3.0]), validity: Some(1.0), timestamp_us: Some(9), ..PsnTracker::default() };
    let psn = PsnPacket::Data(PsnHeader::default(), vec![tracker]).encode().expect("short enough");
    fuzz("psn", binary(psn), MAX_OF_TEXT, |bytes| drop(PsnPacket::decode(bytes)));
    let point = OtpPoint { position_um: Some([1, 2, 3]), rotation_udeg: Some([4, 5, 6]), ..OtpPoint::default() };
    let messages = [
        OtpMessage::Transform(OtpTransform { system: 1, is_full: true, points: vec![point; 2], ..OtpTransform::default() }),
        OtpMessage::Modules(OtpModule::STANDARD.to_vec()),
    ];
    for message in messages {
        let packet = message.encode(&OtpHeader::default()).expect("short enough");
        fuzz("otp", binary(packet), MAX_OF_TEXT, |bytes| {
            // What is understood can be said again, except for a position that came in millimetres.
            if let Ok((header, message)) = OtpMessage::decode(bytes) {
                let _ = message.encode(&header).map(|again| assert!(OtpMessage::decode(&again).is_ok()));
            }
        });
    }
    // Nothing is read behind a wrong checksum, so the payload is changed, not the datagram.
    let json = br#"{"protocol":{"name":"OpenTrackIO","version":[1,0,1]},"transforms":[{"translation":{"x":1.5,"y":0,"z":2}}]}"#;
    let mut cbor = Vec::new();
    ciborium::into_writer(&serde_json::from_slice::<serde_json::Value>(json).expect("JSON"), &mut cbor).expect("CBOR");
    for (name, encoding, payload) in [("opentrackio-json", Encoding::Json, json.to_vec()), ("opentrackio-cbor", Encoding::Cbor, cbor)] {
        let decode = move |bytes: &[u8]| opentrackio::datagram(encoding, 7, bytes).map(|datagram| opentrackio::decode(&datagram));
        decode(&payload).expect("short enough").expect("the seed is good");
        fuzz(name, binary(payload), MAX_OF_TEXT, move |bytes| drop(decode(bytes)));
    }
}

#[test]
fn pose_logs() {
    let read = |bytes: &[u8]| drop(read_pose_log(bytes).map_err(|e| assert!(!e.to_string().is_empty())));
    read_pose_log(seeds::TUM.as_bytes()).expect("the seed is good");
    read_pose_log(seeds::RECORD.as_bytes()).expect("the seed is good");
    fuzz("pose-log", text(&[seeds::TUM, seeds::RECORD]), MAX_OF_TEXT, read);
    let capture = seeds::freed_capture();
    assert_eq!(read_pose_log(&capture).expect("the seed is good").rows.len(), 2);
    fuzz("freed-capture", Mutator::new(seed(), Form::Binary, vec![capture]), MAX_OF_TEXT, read);
    let capture = seeds::opentrackio_capture();
    assert_eq!(read_pose_log(&capture).expect("the seed is good").rows.len(), 1);
    fuzz("opentrackio-capture", Mutator::new(seed(), Form::Binary, vec![capture]), MAX_OF_TEXT, read);
}

/// Decodes all samples of a sound; every frame lies in it, and is a possible one.
fn decode_sound(bytes: &[u8], raw: Option<RawFormat>) {
    let Ok(mut sound) = Sound::open(bytes, raw, 1).map_err(|e| assert!(!e.to_string().is_empty())) else { return };
    let (mut decoder, mut samples, mut count) = (LtcDecoder::new(sound.sample_rate()), Vec::new(), 0);
    while sound.read(&mut samples).expect("memory can be read") {
        count += samples.len();
        decoder.push(&samples, &mut |frame| {
            assert!(frame.code.is_valid() && frame.length > 0.0 && (-9.0..=count as f64).contains(&frame.edge), "{frame:?}");
        });
        samples.clear();
    }
}

#[test]
fn sounds() {
    let signal = LtcSignal {
        sample_rate: 16_000,
        rate: TimecodeRate::Fps24,
        speed: 1.0,
        first: "00:00:59:20".parse().expect("a timecode"),
        frames: 4,
        amplitude: 0.5,
        noise: 0.0,
        lead: 20.0,
        seed: 1,
    };
    let file = wav(16_000, &signal.samples().0);
    let binary = |seed_bytes: Vec<u8>| Mutator::new(seed(), Form::Binary, vec![seed_bytes]);
    fuzz("wav", binary(file.clone()), MAX_OF_TEXT, |bytes| decode_sound(bytes, None));
    let raw = RawFormat { sample_rate: 16_000, channels: 1 };
    fuzz("ltc", binary(file[44..].to_vec()), MAX_OF_TEXT, move |bytes| decode_sound(bytes, Some(raw)));
}

#[test]
fn timecode_files() {
    let read = |bytes: &[u8]| drop(TimecodeRows::parse(bytes).map_err(|e| assert!(!e.to_string().is_empty())));
    TimecodeRows::parse(seeds::TIMECODE.as_bytes()).expect("the seed is good");
    fuzz("timecode-file", text(&[seeds::TIMECODE]), MAX_OF_TEXT, read);
}

#[test]
fn calibrations() {
    let forms: [(_, &[&str]); 5] = [
        ("c.toml", &[seeds::CAMERA]),
        ("c.yml", &[seeds::OPENCV]),
        ("c.yaml", &[seeds::ROS, seeds::ROS_ROI, seeds::ROS_WHOLE]),
        ("kalibr.yaml", &[seeds::KALIBR]),
        ("c.m", &[seeds::BOUGUET]),
    ];
    for (name, good) in forms {
        for seed in good {
            parse_calibration(seed.as_bytes(), Path::new(name)).expect("the seed is good");
        }
        fuzz(name, text(good), MAX_OF_TEXT, move |bytes| {
            match parse_calibration(bytes, Path::new(name)) {
                Ok(read) => assert!(read.model.intrinsics().fx.is_finite()),
                Err(e) => assert!(e.to_string().starts_with(name) && !e.to_string().contains('\n'), "{e}"),
            }
            let _ = parse_calibration(bytes, Path::new("unnamed"));
        });
    }
}

#[test]
fn calibrations_in_utf_16() {
    for (name, good) in [("u.toml", seeds::CAMERA), ("u.yaml", seeds::ROS_ROI), ("u.m", seeds::BOUGUET)] {
        let seeds = seeds::utf16s(good);
        for seed in &seeds {
            parse_calibration(seed, Path::new(name)).expect("the seed is good");
        }
        fuzz(name, Mutator::new(seed(), Form::Binary, seeds), MAX_OF_TEXT, move |bytes| {
            let _ = parse_calibration(bytes, Path::new(name)).map_err(|e| assert!(e.to_string().starts_with(name), "{e}"));
        });
    }
}

#[test]
fn timestamps() {
    fuzz("timestamps.csv", text(&[seeds::STAMPS, seeds::STAMPS_MS]), MAX_OF_TEXT, |bytes| drop(read_timestamps(bytes)));
}

#[test]
fn poses() {
    Take::parse(seeds::POSES.as_bytes().to_vec()).expect("the seed is good");
    fuzz("poses", text(&[seeds::POSES]), MAX_OF_TEXT, |bytes| match Take::parse(bytes.to_vec()) {
        Ok(take) => assert!(take.camera.iter().all(|key| key.pose.is_finite() && key.row < take.rows())),
        Err(e) => assert!(!e.to_string().is_empty()),
    });
}

#[test]
fn learnt_cameras() {
    LearntCamera::from_bytes(seeds::LEARNT.as_bytes()).expect("the seed is good");
    fuzz("learnt", text(&[seeds::LEARNT]), MAX_OF_TEXT, |bytes| match LearntCamera::from_bytes(bytes) {
        // What is accepted survives a round trip.
        Ok(learnt) => assert_eq!(LearntCamera::from_bytes(&learnt.to_bytes()), Ok(learnt)),
        Err(e) => assert!(e.to_string().contains("learnt anew"), "{e}"),
    });
}

#[test]
fn models() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.glb");
    for good in seeds::glbs() {
        std::fs::write(&file, good).unwrap();
        judge_model(&file).expect("the seed is good");
    }
    fuzz("glb", Mutator::new(seed(), Form::Binary, seeds::glbs()), MAX_OF_TEXT, move |bytes| {
        let _kept = &folder;
        std::fs::write(&file, bytes).unwrap();
        let _ = judge_model(&file).map_err(|reason| assert!(!reason.is_empty()));
    });
}

#[test]
fn ffmpeg_log_lines() {
    assert_eq!(ffmpeg_account(seeds::FFMPEG_LOG), (Some("yuv420p".to_owned()), Some(-90.0)));
    fuzz("ffmpeg", text(&[seeds::FFMPEG_LOG]), MAX_OF_TEXT, |bytes| drop(ffmpeg_account(&String::from_utf8_lossy(bytes))));
}

#[test]
fn boards() {
    fuzz("board", text(&["9x6", "8 x 5"]), MAX_OF_TEXT, |bytes| drop(Board::parse(&String::from_utf8_lossy(bytes), 25.0)));
}

#[test]
fn pictures() {
    let decode = |bytes: &[u8]| {
        let _ = picture_size(bytes);
        let _ = decode_oriented(bytes);
    };
    fuzz("png", Mutator::new(seed(), Form::Png, seeds::pngs()), MAX_OF_PICTURES, decode);
    fuzz("jpeg", Mutator::new(seed(), Form::Binary, seeds::jpegs()), MAX_OF_PICTURES, decode);
    fuzz("pnm", Mutator::new(seed(), Form::Text, seeds::pnms()), MAX_OF_PICTURES, decode);
    let (heads, rest) = seeds::exif_heads();
    fuzz("exif", Mutator::new(seed(), Form::Binary, heads), MAX_OF_PICTURES, move |head| decode(&[head, &rest].concat()));
}

#[test]
fn videos() {
    fuzz("y4m", Mutator::new(seed(), Form::Text, seeds::y4ms()), MAX_OF_PICTURES, |bytes| {
        let Ok(mut reader) = Y4mReader::new(bytes) else { return };
        let _ = (reader.rate(), reader.frames_in(bytes.len() as u64));
        while reader.next_luma().is_some() {}
    });
    fuzz("avi", Mutator::new(seed(), Form::Binary, seeds::avis()), MAX_OF_PICTURES, |bytes| {
        let Ok(mut reader) = AviReader::new(bytes) else { return };
        while let Some(jpeg) = reader.next_jpeg() {
            let _ = jpeg.map(|bytes| decode_oriented(&bytes));
        }
    });
    fuzz("mjpeg", Mutator::new(seed(), Form::Binary, seeds::mjpegs()), MAX_OF_PICTURES, |bytes| {
        let mut reader = MjpegReader::new(bytes);
        while let Some(Ok(jpeg)) = reader.next_jpeg() {
            let _ = decode_oriented(&jpeg);
        }
    });
}
