//! A camera that starts and stops abruptly, at any instant of the exposure: the covariance still
//! covers the error of the pose.
//!
//! `STAGEPOSE_STOPS=2000` asks for more starts and stops than a normal run has.

use std::num::NonZero;
use std::sync::atomic::{AtomicU64, Ordering};

use nalgebra::{Vector3, Vector6};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use stagepose::diagnostics::capture::VirtualCamera;
use stagepose::{CameraPath, EntryContent, FrameSource, PoseSample, SensorNoise, Spline, Tracker, TrackerSetup, VirtualStage};

use super::scene::{FPS, backdrop, camera, quiet, truth_of};

/// Starts and stops of a normal run: a dozen for each of three shutters.
const USUAL_EVENTS: usize = 36;
/// Events per scene, which costs one tracker: in a normal run, and if more are requested.
const EVENTS_A_SCENE: [usize; 2] = [12, 40];
/// Frames scored as an event's own, from the event on.
const FRAMES_AFTER: u64 = 2;

/// Returns the squared error normalised by the covariance (C3: p_true = p + δp, R_true = Exp(δθ)
/// R), and the position error in metres; `None` without a measurement.
fn squared_error(scene: &VirtualStage, sample: &PoseSample) -> Option<(f64, f64)> {
    let m = sample.measurement.as_ref()?;
    let truth = truth_of(scene, sample);
    let shift = truth.translation - m.pose.translation;
    let rotation = (truth.rotation * m.pose.rotation.inverse()).scaled_axis();
    let e = Vector6::new(shift.x, shift.y, shift.z, rotation.x, rotation.y, rotation.z);
    Some((e.dot(&(m.covariance.try_inverse().expect("positive definite") * e)), shift.norm()))
}

/// A camera that alternately moves and rests, and the times of its starts and stops.
fn stop_and_go(random: &mut Pcg64Mcg, events_a_scene: usize) -> (CameraPath, Vec<f64>) {
    let place = |random: &mut Pcg64Mcg| {
        let mut near = |most: f64| random.random_range(-most..most);
        (Vector3::new(near(0.8), -2.6 + near(0.5), near(0.4)), Vector3::new(near(0.3), 0.0, near(0.25)))
    };
    let mut t = 0.5;
    let (position, target) = place(random);
    let (mut positions, mut targets, mut events) = (vec![(0.0, position)], vec![(0.0, target)], Vec::new());
    let (mut position, mut target) = (position, target);
    for event in 0..events_a_scene {
        events.push(t);
        positions.push((t, position));
        targets.push((t, target));
        if event % 2 == 0 {
            // Up to a metre a second, panning at the same time.
            let aim = place(random);
            let lasts_s = random.random_range(0.25..0.4);
            let share = (lasts_s * random.random_range(0.2..1.0) / (aim.0 - position).norm()).min(1.0);
            (position, target) = (position + (aim.0 - position) * share, target + (aim.1 - target) * share);
            t += lasts_s;
        } else {
            t += random.random_range(0.2..0.35);
        }
    }
    positions.push((t, position));
    targets.push((t, target));
    let path = |keys: &[(f64, Vector3<f64>)]| Spline::straight(keys).expect("keys in order");
    (CameraPath { position: path(&positions), target: path(&targets), roll_rad: 0.02, shake: None }, events)
}

/// A frame's squared error and position error, and which frame it was.
#[derive(Debug, Clone, Copy)]
struct Scored {
    nees: f64,
    error_m: f64,
    scene: u64,
    frame: u64,
}

/// The scored frames of one or more scenes.
#[derive(Debug, Default)]
struct Scores {
    /// Frames touched by a start or a stop, or right after one.
    near: Vec<Scored>,
    others: Vec<Scored>,
    withheld: usize,
}

/// Tracks one camera that starts and stops.
fn track_scene(seed: u64, events_a_scene: usize) -> Scores {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let (path, events) = stop_and_go(&mut random, events_a_scene);
    let mut scene = quiet(camera(480, 270), path, backdrop());
    scene.noise = SensorNoise { read: 1.2, shot: 0.015 };
    (scene.shutter.exposure_s, scene.shutter.readout_s, scene.samples) =
        (random.random_range(0.004..0.02), [0.0, 0.006, 0.014][seed as usize % 3], 16);
    let mut tracker = Tracker::new(TrackerSetup::from(&scene)).expect("a setup that fits");
    let frames = (events[events_a_scene - 1] * FPS) as u64 + 5;
    let mut source = VirtualCamera::new(scene.clone(), FPS, frames);
    let mut scores = Scores::default();
    while let Some(row) = source.next_entry() {
        let EntryContent::Frame(frame) = &row.content else { continue };
        let sample = tracker.track(frame).expect("a virtual camera's frame");
        // The first frame that an event touches, and the frames after it.
        let t = frame.timestamp.seconds();
        let reach = 0.5 * (scene.shutter.exposure_s + scene.shutter.readout_s);
        let is_near = events.iter().any(|e| t + reach > *e && t - reach < *e + FRAMES_AFTER as f64 / FPS);
        match squared_error(&scene, &sample) {
            Some((nees, error_m)) => {
                let scored = Scored { nees, error_m, scene: seed, frame: frame.sequence };
                if is_near { scores.near.push(scored) } else { scores.others.push(scored) }
            }
            None => scores.withheld += usize::from(frame.sequence > 1),
        }
    }
    scores
}

/// Tracks all scenes, as many at a time as there are cores.
fn track_scenes(scenes: u64, events_a_scene: usize) -> Scores {
    let next = AtomicU64::new(0);
    let cores = std::thread::available_parallelism().map_or(1, NonZero::get);
    let mut all = Scores::default();
    std::thread::scope(|scope| {
        let worker = || {
            let seeds = std::iter::from_fn(|| Some(next.fetch_add(1, Ordering::Relaxed)).filter(|seed| *seed < scenes));
            seeds.map(|seed| track_scene(seed, events_a_scene)).collect::<Vec<_>>()
        };
        let workers: Vec<_> = (0..cores).map(|_| scope.spawn(worker)).collect();
        for scores in workers.into_iter().flat_map(|w| w.join().expect("a scene is tracked without a panic")) {
            all.near.extend(scores.near);
            all.others.extend(scores.others);
            all.withheld += scores.withheld;
        }
    });
    all
}

/// Returns the mean of NEES / 6, after printing it with the errors and the worst frames.
fn printed(what: &str, scored: &mut [Scored]) -> f64 {
    let n = scored.len().max(1) as f64;
    let mean_nees = scored.iter().map(|s| s.nees).sum::<f64>() / 6.0 / n;
    let rms_mm = (scored.iter().map(|s| s.error_m.powi(2)).sum::<f64>() / n).sqrt() * 1e3;
    scored.sort_by(|a, b| a.error_m.total_cmp(&b.error_m));
    let median_mm = scored.get(scored.len() / 2).map_or(0.0, |s| s.error_m * 1e3);
    scored.sort_by(|a, b| b.nees.total_cmp(&a.nees));
    println!("{what}: {} frames, NEES / 6 {mean_nees:.2}, root mean square {rms_mm:.3} mm, median {median_mm:.3} mm", scored.len());
    for Scored { nees, error_m, scene, frame } in scored.iter().take(6) {
        println!("    {:.1} sigma, {:.3} mm in scene {scene}, frame {frame}", nees.sqrt(), error_m * 1e3);
    }
    println!("    {} beyond 6 sigma", beyond_six_sigma(scored));
    mean_nees
}

fn beyond_six_sigma(scored: &[Scored]) -> usize {
    scored.iter().filter(|s| s.nees > 36.0).count()
}

#[test]
fn the_covariance_holds_where_a_camera_starts_or_stops() {
    let wanted = std::env::var("STAGEPOSE_STOPS").ok().and_then(|text| text.parse().ok()).unwrap_or(USUAL_EVENTS);
    let events_a_scene = EVENTS_A_SCENE[usize::from(wanted > USUAL_EVENTS)];
    let Scores { mut near, mut others, withheld } = track_scenes(wanted.div_ceil(events_a_scene) as u64, events_a_scene);
    let of_near = printed("at starts and stops", &mut near);
    let of_others = printed("others", &mut others);
    println!("{withheld} withheld");
    assert!(near.len() > wanted, "{} frames at {wanted} events", near.len());
    assert!(of_near <= 2.0 && of_others <= 2.0, "{of_near} {of_others}");
    assert_eq!(beyond_six_sigma(&near) + beyond_six_sigma(&others), 0, "beyond 6 sigma, as printed");
    assert!(10 * withheld < near.len(), "{withheld} withheld");
}
