use super::*;
use crate::timecode::TimecodeRate;
use crate::timecode::synthetic::LtcSignal;

fn signal(rate: TimecodeRate, speed: f64) -> LtcSignal {
    let first = if rate.is_drop() { "09:59:58;20" } else { "09:59:58:20" }.parse().unwrap();
    LtcSignal { sample_rate: 48_000, rate, speed, first, frames: 100, amplitude: 0.5, noise: 0.0, lead: 1000.3, seed: 7 }
}

/// Returns what is decoded, in pieces of odd sizes.
fn decoded(sample_rate: u32, samples: &[f32]) -> Vec<LtcFrame> {
    let (mut decoder, mut frames) = (LtcDecoder::new(sample_rate), Vec::new());
    samples.chunks(777).for_each(|piece| decoder.push(piece, &mut |frame| frames.push(frame)));
    frames
}

/// Decodes a signal and requires that every decoded frame is one of its frames; returns how many
/// are absent, and the largest error of an edge, samples.
fn absent(signal: &LtcSignal) -> (usize, f64) {
    let (samples, frames) = signal.samples();
    let found = decoded(signal.sample_rate, &samples);
    let (mut next, mut error) = (0, 0.0_f64);
    for frame in &found {
        let at = (next..frames.len()).find(|k| frames[*k].0 == frame.code).unwrap_or_else(|| panic!("{frame:?} is not there: {signal:?}"));
        assert_eq!(frame.is_reverse, signal.speed < 0.0);
        error = error.max((frame.edge - frames[at].1).abs());
        next = at + 1;
    }
    (frames.len() - found.len(), error)
}

#[test]
fn all_rates_speeds_directions_and_polarities_are_decoded() {
    for rate in TimecodeRate::ALL {
        for speed in [0.5, 0.71, 0.9, 1.0, 1.1, 1.31, 1.5] {
            for (direction, amplitude) in [(1.0, 0.5), (-1.0, 0.5), (1.0, -0.02), (-1.0, -1.0)] {
                let (absent, error) = absent(&LtcSignal { amplitude, ..signal(rate, direction * speed) });
                // The first frame teaches the length of a bit.
                assert!(absent <= 1 && error < 0.25, "{rate} x {speed}: {absent} absent, edges off by {error}");
            }
        }
    }
}

#[test]
fn noise_makes_frames_absent_never_wrong() {
    for (noise, most) in [(0.05, 1), (0.1, 1), (0.2, 1), (0.3, 1), (0.5, 40), (1.0, 100)] {
        for (k, speed) in [0.5, 0.75, 1.0, 1.25, 1.5, -1.0].into_iter().enumerate() {
            for rate in TimecodeRate::ALL {
                let (absent, error) = absent(&LtcSignal { noise, seed: k as u64, ..signal(rate, speed) });
                assert!(absent <= most, "noise {noise}, {rate} x {speed}: {absent} absent, edges off by {error}");
            }
        }
    }
}

#[test]
fn other_sample_rates_are_decoded() {
    for sample_rate in [16_000, 22_050, 32_000, 44_100, 96_000, 192_000] {
        for (rate, speed) in [(TimecodeRate::Fps24, 0.5), (TimecodeRate::Fps25, 1.0), (TimecodeRate::Fps30, 1.5)] {
            let (absent, error) = absent(&LtcSignal { sample_rate, ..signal(rate, speed) });
            assert!(absent <= 1 && error < 0.25, "{sample_rate}, {rate} x {speed}: {absent} absent, edges off by {error}");
        }
    }
}

#[test]
fn what_is_no_timecode_gives_no_frame() {
    let tone = |hz: f64| (0..200_000).map(move |k| (f64::from(k) * hz / 48_000.0 * std::f64::consts::TAU).sin() as f32);
    for hz in [50.0, 440.0, 1_000.0, 1_200.0, 2_400.0, 9_000.0] {
        assert_eq!(decoded(48_000, &tone(hz).collect::<Vec<_>>()), []);
    }
    let noise = LtcSignal { frames: 0, noise: 1.0, lead: 1e6, ..signal(TimecodeRate::Fps25, 1.0) };
    assert_eq!(decoded(48_000, &noise.samples().0), []);
    assert_eq!(decoded(48_000, &[f32::NAN, f32::INFINITY, -1e30, 0.0].repeat(9_999)), []);
}

#[test]
fn a_cut_or_damaged_frame_is_absent_and_its_neighbours_stay() {
    let signal = signal(TimecodeRate::Fps25, 1.0);
    let (mut samples, frames) = signal.samples();
    // Frame 40 loses a bit of its hours; a second is cut out after frame 60.
    let bit = |frame: usize, bit: f64| (frames[frame].1 + bit * 24.0) as usize;
    let at = bit(40, 50.0);
    samples[at..at + 24].fill(0.2);
    samples.drain(bit(60, 0.0)..bit(85, 0.0));
    let codes: Vec<_> = decoded(48_000, &samples).iter().map(|frame| frame.code).collect();
    assert!(!codes.contains(&frames[40].0));
    for kept in (1..39).chain(42..60).chain(87..100) {
        assert!(codes.contains(&frames[kept].0), "frame {kept}");
    }
    assert!(codes.windows(2).all(|pair| pair[0] < pair[1]));
}
