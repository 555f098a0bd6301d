use std::io::Write;
use std::path::PathBuf;

use super::*;
use crate::timecode::synthetic::{LtcSignal, wav};
use crate::timecode::{TimecodeRate, TimecodeState, TrackSettings};

fn settings(file: PathBuf) -> TimecodeSettings {
    let track = TrackSettings { rate: Some(TimecodeRate::Fps30), free_wheel_s: 0.6 };
    TimecodeSettings { input: TimecodeInput::File(file), channel: 1, raw: None, track, latency_s: 0.0, begins_s: 0.0 }
}

/// Returns three seconds of timecode.
fn sound() -> Vec<u8> {
    let signal = LtcSignal {
        sample_rate: 48_000,
        rate: TimecodeRate::Fps25,
        speed: 1.0,
        first: "01:00:00:00".parse().unwrap(),
        frames: 75,
        amplitude: 0.5,
        noise: 0.02,
        lead: 0.0,
        seed: 5,
    };
    wav(48_000, &signal.samples().0)
}

/// Looks at the state until it is the wanted one; returns when it was.
fn await_state(reader: &TimecodeReader, link: &LiveLink, wanted: &str) -> crate::frame::Timestamp {
    for _ in 0..1_000 {
        let now = monotonic_now();
        reader.look(link);
        if reader.source().with_live(|track| track.state(now).word()) == Some(wanted) {
            return now;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    panic!("it never became {wanted}");
}

fn events_of(link: &LiveLink, happen: impl FnOnce()) -> Vec<Event> {
    let listener = link.events.listen();
    happen();
    listener.try_iter().map(|stamped| stamped.event).collect()
}

#[test]
fn a_file_plays_at_its_speed_and_every_state_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("ltc.wav");
    std::fs::write(&file, sound()).unwrap();
    let link = LiveLink::default();
    let events = events_of(&link, || {
        let reader = TimecodeReader::start(settings(file), &link).unwrap();
        let begun = await_state(&reader, &link, "never found");
        await_state(&reader, &link, "locked");
        std::thread::sleep(Duration::from_millis(2_500));
        let now = monotonic_now();
        let stamped = reader.source().at(now).unwrap();
        let wanted_s = now.seconds_since(begun);
        let found_s = f64::from(stamped.code.number(TimecodeRate::Fps25)) / 25.0 - 3600.0;
        // `rate` is 30, but frame numbers are those of the sound up to the last mark.
        assert!((found_s - wanted_s).abs() < 0.3, "{found_s} {wanted_s}");
        reader.look(&link);
        await_state(&reader, &link, "lost");
    });
    let states: Vec<_> = events.iter().filter_map(|e| if let Event::Timecode { state, .. } = e { Some(&**state) } else { None }).collect();
    assert!(states.starts_with(&["never found", "locked"]) && states.ends_with(&["lost"]), "{states:?}");
    assert!(events.iter().any(|e| matches!(e, Event::TimecodeRate { heard, .. } if heard == "25")), "{events:?}");
}

#[test]
fn a_pipe_may_come_go_and_come_again() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("ltc.fifo");
    let link = LiveLink::default();
    let mut plain = settings(file.clone());
    (plain.track.rate, plain.track.free_wheel_s) = (None, 30.0);
    let listener = link.events.listen();
    let reader = TimecodeReader::start(plain, &link).unwrap();
    std::thread::sleep(Duration::from_millis(200));
    assert!(listener.try_iter().any(|e| matches!(&e.event, Event::TimecodeWaiting { reason } if reason.contains("mkfifo"))));
    nix::unistd::mkfifo(&file, nix::sys::stat::Mode::S_IRWXU).unwrap();
    for _ in 0..2 {
        let mut pipe = std::fs::OpenOptions::new().write(true).open(&file).unwrap();
        let bytes = sound();
        pipe.write_all(&bytes[..44]).unwrap();
        // A second, a tenth at a time.
        for piece in bytes[44..].chunks(9_600).take(10) {
            pipe.write_all(piece).unwrap();
            std::thread::sleep(Duration::from_millis(100));
        }
        drop(pipe);
        await_state(&reader, &link, "locked");
        await_state(&reader, &link, "free-wheeling");
    }
    let stamped = reader.source().at(monotonic_now()).unwrap();
    assert!(stamped.rate == TimecodeRate::Fps25 && matches!(stamped.state, TimecodeState::FreeWheeling { .. }));
    let begun = Instant::now();
    drop(reader);
    assert!(begun.elapsed() < Duration::from_secs(1));
}
