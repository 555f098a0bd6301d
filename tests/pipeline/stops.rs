//! A camera that starts and stops at once, at any instant of the exposure: the covariance still says how far off the pose is.
//!
//! `STAGEPOSE_STOPS=2000` asks for more starts and stops than the few of every day.

use nalgebra::{Vector3, Vector6};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use stagepose::diagnostics::capture::VirtualCamera;
use stagepose::{CameraPath, EntryContent, FrameSource, PoseSample, SensorNoise, Spline, Tracker, TrackerSetup, VirtualStage};

use super::scene::{FPS, backdrop, camera, quiet, truth_of};

/// Starts and stops of every day: a dozen for each of three shutters.
const USUAL_EVENTS: usize = 36;
/// In each scene, which costs one tracker: of every day, and where more are asked for.
const EVENTS_A_SCENE: [usize; 2] = [12, 40];
/// Frames from one event on that are scored as its own.
const FRAMES_AFTER: u64 = 2;

/// Squared error in units of the covariance: C3's p_true = p + δp, R_true = Exp(δθ) R.
fn nees(scene: &VirtualStage, sample: &PoseSample) -> Option<f64> {
    let m = sample.measurement.as_ref()?;
    let truth = truth_of(scene, sample);
    let shift = truth.translation - m.pose.translation;
    let turn = (truth.rotation * m.pose.rotation.inverse()).scaled_axis();
    let e = Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z);
    Some(e.dot(&(m.covariance.try_inverse().expect("positive definite") * e)))
}

/// A camera that goes and rests in turn, and the times of its starts and stops.
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
            // Up to a metre a second, panning meanwhile.
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

#[test]
fn the_covariance_holds_where_a_camera_starts_or_stops() {
    let wanted = std::env::var("STAGEPOSE_STOPS").ok().and_then(|text| text.parse().ok()).unwrap_or(USUAL_EVENTS);
    let events_a_scene = EVENTS_A_SCENE[usize::from(wanted > USUAL_EVENTS)];
    let (mut near, mut others, mut withheld) = (Vec::new(), Vec::new(), 0);
    for seed in 0..wanted.div_ceil(events_a_scene) as u64 {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let (path, events) = stop_and_go(&mut random, events_a_scene);
        let mut scene = quiet(camera(480, 270), path, backdrop());
        scene.noise = SensorNoise { read: 1.2, shot: 0.015 };
        (scene.shutter.exposure_s, scene.shutter.readout_s, scene.samples) =
            (random.random_range(0.004..0.02), [0.0, 0.006, 0.014][seed as usize % 3], 16);
        let mut tracker = Tracker::new(TrackerSetup::from(&scene)).expect("a setup that fits");
        let frames = (events[events_a_scene - 1] * FPS) as u64 + 5;
        let mut source = VirtualCamera::new(scene.clone(), FPS, frames);
        while let Some(row) = source.next_entry() {
            let EntryContent::Frame(frame) = &row.content else { continue };
            let sample = tracker.track(frame).expect("a virtual camera's frame");
            // The first frame that an event touches, and those after it.
            let t = frame.timestamp.seconds();
            let reach = 0.5 * (scene.shutter.exposure_s + scene.shutter.readout_s);
            let is_near = events.iter().any(|e| t + reach > *e && t - reach < *e + FRAMES_AFTER as f64 / FPS);
            match nees(&scene, &sample) {
                Some(nees) if is_near => near.push((nees, seed, frame.sequence)),
                Some(nees) => others.push(nees),
                None => withheld += usize::from(frame.sequence > 1),
            }
        }
    }
    let mean = |all: &mut dyn Iterator<Item = f64>, n: usize| all.sum::<f64>() / 6.0 / n.max(1) as f64;
    let of_near = mean(&mut near.iter().map(|(nees, _, _)| *nees), near.len());
    let of_others = mean(&mut others.iter().copied(), others.len());
    near.sort_by(|a, b| b.0.total_cmp(&a.0));
    let worst: Vec<_> =
        near.iter().take(8).map(|(nees, seed, frame)| format!("{:.1} sigma in scene {seed}, frame {frame}", nees.sqrt())).collect();
    println!(
        "NEES / 6 of {} frames at starts and stops {of_near:.2}, of {} others {of_others:.2}; {withheld} withheld",
        near.len(),
        others.len()
    );
    println!("{}", worst.join("; "));
    assert!(near.len() > wanted, "{} frames at {wanted} events", near.len());
    assert!(of_near <= 2.0 && of_others <= 2.0, "{of_near} {of_others}");
    // A jump that hides within one frame may still have too small a covariance: 1 in 200 of many, no more than 1 in 20 of few.
    let beyond = near.iter().filter(|(nees, _, _)| *nees > 36.0).count();
    println!("{beyond} of {} beyond 6 sigma", near.len());
    assert!(20 * beyond <= near.len(), "{beyond} of {}", near.len());
    assert!(10 * withheld < near.len(), "{withheld} withheld");
}
