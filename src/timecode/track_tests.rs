use super::*;
use crate::timecode::synthetic::{LtcSignal, wav};

const SETTINGS: TrackSettings = TrackSettings { rate: None, free_wheel_s: 10.0 };

fn at_s(s: f64) -> Timestamp {
    Timestamp::from_seconds(s)
}

/// Returns the track of a signal that begins at 100 s.
fn track(signal: &LtcSignal, settings: TrackSettings) -> TimecodeTrack {
    let bytes = wav(signal.sample_rate, &signal.samples().0);
    let sound = Sound::open(bytes.as_slice(), None, 1).unwrap();
    TimecodeTrack::of_sound(sound, at_s(100.0), settings).unwrap().0
}

fn signal(rate: TimecodeRate, first: &str, frames: usize) -> LtcSignal {
    let first = first.parse().unwrap();
    LtcSignal { sample_rate: 48_000, rate, speed: 1.0, first, frames, amplitude: 0.5, noise: 0.02, lead: 0.0, seed: 3 }
}

#[test]
fn the_rate_is_heard_from_counting_and_speed() {
    for rate in TimecodeRate::ALL {
        let first = if rate.is_drop() { "00:00:58;00" } else { "00:00:58:00" };
        let track = track(&signal(rate, first, 80), SETTINGS);
        assert_eq!((track.rate(), track.heard_rate()), (Some(rate), Some(rate)));
        assert!((track.speed().unwrap() - 1.0).abs() < 1e-5);
    }
    // The counting tells 24 from 30 also where the speed does not.
    let slow = track(&LtcSignal { speed: 0.8, ..signal(TimecodeRate::Fps30, "00:00:58:00", 80) }, SETTINGS);
    assert_eq!((slow.rate().map(TimecodeRate::count), (slow.speed().unwrap() * 100.0).round()), (Some(30), 80.0));
}

#[test]
fn an_instant_has_its_frame_and_fraction() {
    let track = track(&signal(TimecodeRate::Fps29_97Drop, "00:00:58;00", 100), SETTINGS);
    for k in [10, 59, 60, 61, 90] {
        let stamped = track.at(at_s(100.0 + (f64::from(k) + 0.25) * 1001.0 / 30_000.0)).unwrap();
        assert_eq!(stamped.code, Timecode::of_number(58 * 30 + i64::from(k), TimecodeRate::Fps29_97Drop));
        assert!((stamped.fraction - 0.25).abs() < 0.01 && stamped.state == TimecodeState::Locked);
    }
}

#[test]
fn a_gap_free_wheels_and_is_lost_at_the_end_of_its_time() {
    let track = track(&signal(TimecodeRate::Fps25, "10:00:00:00", 100), TrackSettings { free_wheel_s: 3.0, ..SETTINGS });
    assert_eq!(track.state(at_s(99.0)), TimecodeState::NeverFound);
    assert_eq!(track.state(at_s(104.05)), TimecodeState::Locked);
    let stamped = track.at(at_s(106.01)).unwrap();
    assert_eq!((stamped.code.to_string().as_str(), stamped.state.word()), ("10:00:06:00", "free-wheeling"));
    assert!(matches!(stamped.state, TimecodeState::FreeWheeling { for_s } if (for_s - 2.05).abs() < 0.01));
    assert_eq!((track.state(at_s(107.1)), track.at(at_s(107.1))), (TimecodeState::Lost, None));
}

#[test]
fn a_tape_at_another_speed_is_followed_but_not_continued() {
    for (speed, after) in [(1.3, "10:00:04:00"), (0.6, "10:00:04:00"), (-1.0, "09:59:55:24")] {
        let track = track(&LtcSignal { speed, ..signal(TimecodeRate::Fps25, "10:00:00:00", 102) }, SETTINGS);
        let frame_s = 0.04 / f64::abs(speed);
        // Between its frames 100 and 101.
        let stamped = track.at(at_s(100.0 + 100.5 * frame_s)).unwrap();
        assert_eq!(stamped.code.to_string(), after, "{speed}");
        assert!((stamped.fraction - 0.5).abs() < 0.02);
        assert_eq!(track.state(at_s(100.0 + 102.0 * frame_s + 0.5)), TimecodeState::Lost);
    }
}

#[test]
fn marks_out_of_order_change_nothing_and_old_ones_are_forgotten() {
    let mut track = TimecodeTrack::live(SETTINGS);
    for k in 0..5000 {
        let code = Timecode::of_number(k, TimecodeRate::Fps25);
        track.push(TimecodeMark { at: Timestamp::from_ns(k * 40_000_000), code, is_reverse: false });
        track.push(TimecodeMark { at: Timestamp::from_ns(k * 40_000_000 - 1), code, is_reverse: false });
    }
    assert_eq!(track.marks().count(), KEPT);
    assert_eq!(track.at(at_s(150.01)).unwrap().code.to_string(), "00:02:30:00");
    assert_eq!(track.rate(), Some(TimecodeRate::Fps25));
}

#[test]
fn a_wrong_configured_rate_changes_no_timecode() {
    for (rate, configured) in [
        (TimecodeRate::Fps29_97Drop, TimecodeRate::Fps25),
        (TimecodeRate::Fps25, TimecodeRate::Fps30),
        (TimecodeRate::Fps30, TimecodeRate::Fps24),
        (TimecodeRate::Fps24, TimecodeRate::Fps29_97Drop),
    ] {
        for speed in [0.8, 1.0] {
            let first = if rate.is_drop() { "00:00:58;05" } else { "00:00:58:05" };
            let track = track(&LtcSignal { speed, ..signal(rate, first, 80) }, TrackSettings { rate: Some(configured), ..SETTINGS });
            let frame_s = 1.0 / (rate.fps() * speed);
            for k in 2..79 {
                let stamped = track.at(at_s(100.0 + (f64::from(k) + 0.5) * frame_s)).unwrap();
                let wanted = Timecode::of_number(58 * i64::from(rate.count()) + 5 + i64::from(k), rate);
                assert_eq!(stamped.code, wanted, "{rate} x {speed} configured as {configured}");
            }
            assert!(track.heard_rate().is_some_and(|heard| heard.count() == rate.count() && heard != configured));
        }
    }
}

#[test]
fn the_first_second_is_right_at_any_speed() {
    for rate in TimecodeRate::ALL {
        for speed in [0.5, 0.8, 1.25, 1.5] {
            let (mut live, sent) = (TimecodeTrack::live(SETTINGS), Timecode { is_drop: rate.is_drop(), ..Timecode::of_number(0, rate) });
            for k in 0..i64::from(rate.count()) {
                let at = at_s(k as f64 / (rate.fps() * speed));
                let code = Timecode::of_number(i64::from(sent.number(rate)) + k, rate);
                live.push(TimecodeMark { at, code, is_reverse: false });
                assert!(live.at(at.after_s(0.001)).is_none_or(|stamped| stamped.code == code), "{rate} x {speed}, frame {k}");
            }
        }
    }
}
