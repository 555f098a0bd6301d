//! Filter output when a body is kicked, stopped or cut elsewhere, at all rates and noise levels.

use nalgebra::{Matrix6, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

use super::tests::{WhiteAcceleration, kalman, one_euro, pose};
use super::*;
use crate::geometry::Camera;

const RATES: [f64; 6] = [5.0, 12.5, 30.0, 60.0, 120.0, 240.0];
const SIGMAS: [f64; 4] = [1e-6, 1e-4, 1e-3, 1e-2];
/// Time of the event, seconds.
const EVENT_S: f64 = 2.0;

/// What happens to a body, along x, and to its rotation with the same numbers.
#[derive(Debug, Clone, Copy)]
enum Event {
    Kick,
    EndStop,
    Cut,
}

impl Event {
    fn at(self, t: f64) -> f64 {
        let is_after = t >= EVENT_S;
        match self {
            Self::Kick => 0.005 * f64::from(is_after),
            Self::EndStop => 0.6 * (t.min(EVENT_S) - EVENT_S),
            Self::Cut => 0.4 * f64::from(is_after),
        }
    }

    /// Maximum distance the body moves within the prediction span.
    fn way(self, seconds: f64) -> f64 {
        match self {
            Self::Kick => 0.005,
            Self::EndStop => 0.6 * seconds,
            Self::Cut => 0.4,
        }
    }
}

/// Stamps of four seconds: even, uneven by a third, or with every fifth frame dropped.
fn stamps(rate: f64, kind: usize, begin: f64) -> Vec<f64> {
    let frames = 0..(4.0 * rate) as usize;
    let uneven = |k: usize| if kind == 1 { 0.33 * ((k * 7919 % 13) as f64 / 13.0 - 0.5) } else { 0.0 };
    frames.filter(|k| kind != 2 || k % 5 != 3).map(|k| (k as f64 + begin + uneven(k)) / rate).collect()
}

/// (seconds, output, output rotation) along x of each frame.
fn output(settings: FilterSettings, stamps: &[f64], sigma: f64, noise: f64, path: impl Fn(f64) -> f64) -> Vec<(f64, f64, f64)> {
    let mut filter = PoseFilter::<Camera>::new(settings);
    let mut random = Pcg64::seed_from_u64(7);
    let mut normal = move || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
    let mut one = |t: &f64| {
        let mut off = || Vector3::new(normal(), normal(), normal()) * noise;
        let measured = pose(Vector3::x() * path(*t) + off(), Vector3::x() * path(*t) + off());
        let output = filter.measured(Timestamp::from_seconds(*t), &measured, &(Matrix6::identity() * sigma * sigma));
        (*t, output.translation.x, output.rotation.scaled_axis().x)
    };
    stamps.iter().map(&mut one).collect()
}

/// Rates the output after the event for one of the two: maximum overshoot, maximum error later than
/// 0.3 s, number of oscillations.
fn judged(row: &[(f64, f64)], end: f64) -> (f64, f64, usize) {
    let after: Vec<(f64, f64)> = row.iter().filter(|(t, _)| *t >= EVENT_S).map(|(t, x)| (*t, x - end)).collect();
    let greatest = |since: f64| after.iter().filter(|(t, _)| *t >= since).map(|(_, x)| x.abs()).fold(0.0, f64::max);
    // Only visible deviations count: a tenth of a millimetre.
    let seen: Vec<f64> = after.iter().map(|(_, x)| *x).filter(|x| x.abs() > 1e-4).collect();
    let sign_changes = seen.windows(2).filter(|w| w[0] * w[1] < 0.0).count();
    (greatest(EVENT_S), greatest(EVENT_S + 0.3), sign_changes)
}

#[test]
fn jolts_stops_and_cuts_settle_without_oscillation() {
    let cases = [Event::Kick, Event::EndStop, Event::Cut];
    for (event, rate, sigma) in product(&cases) {
        for (kind, begin) in [(0, 0.0), (0, 0.4), (1, 0.0), (2, 0.0), (2, 0.4)] {
            for predict_s in [0.0, 0.1, 0.2] {
                let stamps = stamps(rate, kind, begin);
                let rows = output(kalman(predict_s), &stamps, sigma, 0.0, |t| event.at(t));
                // The window of the reach extends to the frame before it.
                let longest_step = stamps.windows(2).map(|w| w[1] - w[0]).fold(0.0, f64::max);
                let bound = PREDICTED_WAYS * event.way(predict_s + longest_step) + 1e-3;
                let positions: Vec<_> = rows.iter().map(|r| (r.0, r.1)).collect();
                let rotations: Vec<_> = rows.iter().map(|r| (r.0, r.2)).collect();
                for row in [positions, rotations] {
                    let (overshoot, late, to_and_fro) = judged(&row, event.at(4.0));
                    let case = format!("{event:?} {rate} Hz sigma {sigma} stamps {kind} {begin} +{predict_s} s");
                    assert!(late < 1e-3, "{case}: {late} m off after 0.3 s");
                    assert!(to_and_fro <= 2, "{case}: {to_and_fro} times to and fro");
                    assert!(overshoot < bound, "{case}: overshoot {overshoot}");
                }
            }
        }
    }
}

#[test]
fn an_oscillating_filter_is_rejected() {
    let (sigma, predict_s, rate): (f64, f64, f64) = (1e-6, 0.1, 30.0);
    for event in [Event::Kick, Event::EndStop, Event::Cut] {
        let mut filter = WhiteAcceleration::at_rest(30.0);
        let row: Vec<(f64, f64)> = stamps(rate, 0, 0.0)
            .into_iter()
            .map(|t| {
                filter.update(1.0 / rate, event.at(t), sigma * sigma);
                (t, filter.state.x + filter.state.y * predict_s)
            })
            .collect();
        let (_, late, to_and_fro) = judged(&row, event.at(4.0));
        assert!(late > 1e-3 && to_and_fro > 2, "{event:?}: {late} m off after 0.3 s, {to_and_fro} times to and fro");
    }
}

fn product(events: &[Event]) -> Vec<(Event, f64, f64)> {
    let with = |event: Event| RATES.iter().flat_map(move |rate| SIGMAS.iter().map(move |sigma| (event, *rate, *sigma)));
    events.iter().flat_map(|event| with(*event)).collect()
}

#[test]
fn jolts_stops_and_cuts_settle_despite_noise() {
    for event in [Event::Kick, Event::EndStop, Event::Cut] {
        for (rate, sigma) in RATES.iter().flat_map(|rate| [1e-6, 1e-5, 1e-4].map(|sigma| (*rate, sigma))) {
            for predict_s in [0.0, 0.1, 0.2] {
                let rows = output(kalman(predict_s), &stamps(rate, 0, 0.0), sigma, sigma, |t| event.at(t));
                let positions: Vec<_> = rows.iter().map(|r| (r.0, r.1)).collect();
                let (_, late, _) = judged(&positions, event.at(4.0));
                assert!(late < 1e-3, "{event:?} {rate} Hz sigma {sigma} +{predict_s} s: {late} m off after 0.3 s");
            }
        }
    }
}

#[test]
fn scatter_returns_to_normal_after_a_jump() {
    for (rate, sigma) in RATES.iter().flat_map(|rate| [1e-5, 1e-4, 1e-3].map(|sigma| (*rate, sigma))) {
        let rows = output(kalman(0.1), &stamps(rate, 0, 0.0), sigma, sigma, |t| Event::Cut.at(t));
        let scatter = |from: f64, end: f64| {
            let off: Vec<f64> = rows.iter().filter(|r| (from..from + 1.0).contains(&r.0)).map(|r| r.1 - end).collect();
            (off.iter().map(|x| x * x).sum::<f64>() / off.len() as f64).sqrt()
        };
        let (before, after) = (scatter(0.99, 0.0), scatter(2.99, 0.4));
        assert!(after < 2.0 * before.max(0.5 * sigma), "{rate} Hz {sigma}: {before} before, {after} after");
    }
}

/// For any input: a prediction reaches at most twice as far as the body moved in the last
/// `predict_s`.
#[test]
fn predictions_reach_at_most_twice_the_recent_motion() {
    let mut random = Pcg64::seed_from_u64(3);
    let predict_s = 0.1;
    for kind in [kalman(0.0).kind, one_euro().kind] {
        for rate in RATES {
            let settings = |predict_s| FilterSettings { kind, predict_s };
            let (mut now, mut ahead) = (PoseFilter::<Camera>::new(settings(0.0)), PoseFilter::new(settings(predict_s)));
            let (mut at, mut past) = (Vector3::zeros(), Vec::new());
            for k in 0..1000 {
                let mut way = || Vector3::new(random.random::<f64>() - 0.5, random.random::<f64>() - 0.5, 0.0);
                // Noise, then a random walk, then alternating positions.
                at = [way() * 0.01, at + way() * 0.02, Vector3::x() * (k % 2) as f64 * 0.05][k / 100 % 3];
                let t = k as f64 / rate;
                past.push((t, at));
                let measured = pose(at, Vector3::zeros());
                let covariance = Matrix6::identity() * 1e-8;
                let here = now.measured(Timestamp::from_seconds(t), &measured, &covariance);
                let output = ahead.measured(Timestamp::from_seconds(t), &measured, &covariance);
                let since = past.iter().rposition(|(then, _)| *then <= t - predict_s - 1e-6).unwrap_or(0);
                let moved = past[since..].iter().map(|(_, p)| (p - at).norm()).fold(0.0, f64::max);
                let reach = (output.translation - here.translation).norm();
                assert!(reach <= PREDICTED_WAYS * moved + 1e-9, "{kind:?} {rate} Hz frame {k}: {reach}, moved {moved}");
            }
        }
    }
}

#[test]
fn one_euro_never_oscillates_or_predicts_a_body_at_rest() {
    for event in [Event::Kick, Event::EndStop, Event::Cut] {
        for rate in RATES {
            for predict_s in [0.0, 0.1, 0.2] {
                let settings = FilterSettings { predict_s, ..one_euro() };
                let rows = output(settings, &stamps(rate, 0, 0.0), 1e-4, 0.0, |t| event.at(t));
                let unpredicted = output(one_euro(), &stamps(rate, 0, 0.0), 1e-4, 0.0, |t| event.at(t));
                let positions: Vec<_> = rows.iter().map(|r| (r.0, r.1)).collect();
                let (overshoot, _, to_and_fro) = judged(&positions, event.at(4.0));
                assert!(to_and_fro <= 2, "{event:?} {rate} Hz +{predict_s} s: {to_and_fro} times to and fro");
                assert!(overshoot <= (1.0 + PREDICTED_WAYS) * event.way(predict_s + 1.0 / rate) + 1e-3, "{event:?} {rate}: {overshoot}");
                let stands = EVENT_S + predict_s + 2.0 / rate;
                for (with, without) in rows.iter().zip(&unpredicted).filter(|(r, _)| r.0 > stands) {
                    assert!((with.1 - without.1).abs() < 1e-9, "{event:?} {rate} Hz +{predict_s} s at {}", with.0);
                }
            }
        }
    }
}

#[test]
fn coasting_does_not_run_away() {
    // If a centimetre may be noise, three frames at 240 frames per second show no stop.
    let cases = product(&[Event::Kick, Event::EndStop, Event::Cut]);
    for (event, rate, sigma) in cases.into_iter().filter(|(.., sigma)| *sigma <= 1e-3) {
        for (predict_s, frames) in [(0.0, 1), (0.0, 2), (0.1, 1), (0.0, 5)] {
            let mut filter = PoseFilter::<Camera>::new(kalman(predict_s));
            let mut last = Timestamp::default();
            // The light fails after this many frames showing the event; at the end stop's own
            // instant nothing is visible of it yet.
            let frames = frames + i64::from(matches!(event, Event::EndStop));
            for k in 0..(EVENT_S * rate).ceil() as i64 + frames {
                last = Timestamp::from_seconds(k as f64 / rate);
                let measured = pose(Vector3::x() * event.at(last.seconds() + 1e-6), Vector3::zeros());
                filter.measured(last, &measured, &(Matrix6::identity() * sigma * sigma));
            }
            for gap_s in [0.0, 0.02, 0.1, 0.5, 10.0] {
                let off = filter.predicted(last.after_s(gap_s)).expect("running").translation.x - event.at(4.0);
                assert!(off.abs() < 2e-3, "{event:?} {rate} Hz sigma {sigma} +{predict_s} s, {frames} frames after: {off}");
            }
        }
    }
}

#[test]
fn coasting_moves_no_further_than_the_recent_motion() {
    for rate in RATES {
        let mut filter = PoseFilter::<Camera>::new(kalman(0.0));
        let mut random = Pcg64::seed_from_u64(5);
        let mut past = Vec::new();
        for k in 0..500 {
            let t = k as f64 / rate;
            let x = 0.3 * (4.0 * t).sin() + 0.004 * (random.random::<f64>() - 0.5);
            past.push((t, x));
            filter.measured(Timestamp::from_seconds(t), &pose(Vector3::x() * x, Vector3::zeros()), &(Matrix6::identity() * 1e-6));
            let since = past.iter().rposition(|(then, _)| *then <= t - FADE_S - 1e-6).unwrap_or(0);
            let moved = past[since..].iter().map(|(_, p)| (p - x).abs()).fold(0.0, f64::max);
            let at = |gap_s: f64| filter.predicted(Timestamp::from_seconds(t + gap_s)).expect("running").translation.x;
            // Seen for less than that, it is assumed to have moved before.
            assert!(t < FADE_S || (at(5.0) - at(0.0)).abs() <= moved + 1e-9, "{rate} Hz {k}");
        }
    }
}

#[test]
fn five_frames_per_second_tolerate_a_dropped_frame() {
    for rate in [2.0, 5.0, 7.5] {
        let stamps = stamps(rate, 2, 0.0);
        let rows = output(kalman(0.1), &stamps, 1e-4, 0.0, |t| 0.4 * t);
        for (t, x, _) in rows.iter().filter(|r| r.0 > 2.0) {
            assert!((x - 0.4 * (t + 0.1)).abs() < 1e-3, "{rate} Hz at {t}: {x}");
        }
    }
}
