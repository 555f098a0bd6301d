//! The record's covariance, compared with the actual errors.

use nalgebra::Vector3;
use stagepose::{CameraModel, CameraPath, LensGuess, PoseSample, SensorNoise, Spline, State};

use super::scene::{aside, backdrop, camera, nees_per_freedom, quiet, rows, setup, track, track_rows, truth_of};

#[test]
fn errors_are_as_large_as_the_covariance_says() {
    let keys = [(0.0, Vector3::new(-1.1, -3.4, 0.4)), (1.0, Vector3::new(1.0, -3.0, -0.2))];
    let targets = [(0.0, Vector3::new(-0.3, 0.0, 0.1)), (1.0, Vector3::new(0.2, 0.0, 0.0))];
    let path = CameraPath { position: Spline::new(&keys).unwrap(), target: Spline::new(&targets).unwrap(), roll_rad: 0.0, shake: None };
    let mut scene = quiet(camera(640, 360), path, backdrop());
    scene.noise = SensorNoise::webcam();
    let samples = track(&scene, 28);
    let all: Vec<f64> = samples.iter().filter(|s| s.state == State::Tracking).map(|s| nees_per_freedom(&scene, s)).collect();
    let mean = all.iter().sum::<f64>() / all.len() as f64;
    println!("mean NEES / 6 over {} frames: {mean:.2}", all.len());
    assert_eq!(all.len(), 28);
    // Expected below 1: every covariance includes a minimum error per frame, and a start or stop
    // that the frame's motion may hide.
    assert!((0.2..3.0).contains(&mean), "{mean}");
}

#[test]
fn the_covariance_covers_a_guessed_lens() {
    for (off, k1) in [(0.97, 0.0), (1.0, 0.03), (1.03, -0.03)] {
        let mut real = *camera(640, 360).intrinsics();
        real.distortion = [k1, 0.0, 0.0, 0.0, 0.0];
        let scene = quiet(CameraModel::new(real).unwrap(), aside(), backdrop());
        let across = 2.0 * (320.0 / (real.fx * off)).atan().to_degrees();
        let guess = LensGuess::FieldOfView(across).camera(640, 360).unwrap();
        let mut guessed = setup(&scene);
        guessed.camera = guess;
        let samples = track_rows(guessed, &rows(&scene, 8));
        let tracked: Vec<&PoseSample> = samples.iter().filter(|s| s.state == State::Tracking).collect();
        assert!(tracked.len() >= 6, "{off} {k1}: {} frames of 8", tracked.len());
        for sample in tracked {
            let told = sample.measurement.unwrap().covariance;
            let distance = truth_of(&scene, sample).translation.norm();
            let sigma = (told[(0, 0)] + told[(1, 1)] + told[(2, 2)]).sqrt() / distance;
            let nees = nees_per_freedom(&scene, sample);
            println!("focal length {off}, k1 {k1}: told {:.2} % of the distance, NEES / 6 {nees:.3}", 100.0 * sigma);
            assert!((0.025..0.08).contains(&sigma) && nees < 3.0, "{off} {k1}: {sigma} {nees}");
        }
    }
}
