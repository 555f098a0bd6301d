//! The filming camera through the outputs: its pose, lens, delay, and covariance.

use nalgebra::Matrix6;

use super::super::super::mounted::{Mount, MountSettings};
use super::*;
use crate::record::{Measurement, TwoViewModel};

/// Half a metre to the right of its carrier, 0.1 m above it, and rotated to the left by 90 degrees.
fn mount(carrier: BodyChoice, camera: Option<CameraModel>, delay: Duration) -> MountSettings {
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
    let mount = Mount { carrier, pose: Pose::new(rotation, Vector3::new(0.5, 0.0, 0.1)), covariance: Matrix6::zeros() };
    MountSettings { name: "film".to_owned(), mount, camera, delay }
}

fn of_film(protocol: Protocol, ear: &Ear) -> OutputSettings {
    OutputSettings { bodies: vec![BodyChoice::Mount], ..output(protocol, ear) }
}

fn started(outputs: &[OutputSettings], mount: MountSettings) -> Publisher {
    Publisher::start(outputs, &Context { mount: Some(mount), ..context(patient()) }).unwrap()
}

#[test]
fn the_filming_camera_is_reported_with_its_own_lens() {
    let lens = CameraModel::pinhole(1920, 1080, 1600.0, 1600.0, 959.5, 539.5).unwrap();
    for (lens, zoom) in [(Some(lens), 4000), (None, 0)] {
        let (film, own) = (Ear::new(), Ear::new());
        let outputs = [of_film(freed(Spare::Quality), &film), OutputSettings { name: "own".into(), ..output(freed(Spare::Quality), &own) }];
        let publisher = started(&outputs, mount(BodyChoice::Camera, lens, Duration::ZERO));
        publisher.send(&sample(0, State::Tracking, 1.0));
        publisher.close();
        let received = film.freed();
        assert_eq!((received.position_mm, received.zoom, received.spare), ([1500.0, -4000.0, 100.0], zoom, 1));
        // FreeD's pan is positive to the right.
        assert!((received.pan_deg + 90.0).abs() < 1e-4 && received.tilt_deg.abs() < 1e-4, "{received:?}");
        assert_eq!(own.freed().position_mm, [1000.0, -4000.0, 0.0]);
    }
}

#[test]
fn a_mounted_camera_follows_its_carrier_even_when_lost() {
    let ear = Ear::new();
    let publisher = started(&[of_film(freed(Spare::Quality), &ear)], mount(BodyChoice::Object(0), None, Duration::ZERO));
    story().iter().for_each(|s| publisher.send(s));
    assert_eq!(publisher.close()[0].sent, 3);
    let received: Vec<_> = (0..3).map(|_| ear.freed()).map(|p| (p.position_mm, p.spare)).collect();
    assert_eq!(received, [([9500.0, 0.0, 100.0], 1), ([9500.0, 0.0, 100.0], 2), ([9500.0, 0.0, 100.0], 1)]);
}

#[test]
fn all_poses_are_delayed_like_the_mounted_picture() {
    let ear = Ear::new();
    let delay = Duration::from_nanos(FRAME_NS as u64 * 5 / 2);
    let late = OutputSettings { delay, bodies: vec![BodyChoice::Mount, BodyChoice::Camera], ..output(json(), &ear) };
    let publisher = started(&[late], mount(BodyChoice::Camera, None, delay));
    (0..8).for_each(|k| publisher.send(&sample(k, State::Tracking, k as f64)));
    let sent = publisher.close()[0].sent;
    let lines: Vec<_> = (0..sent).map(|_| ear.json()).filter(|l| !l["pose"].is_null()).collect();
    let x = |l: &serde_json::Value, key: &str| l[key]["position_m"][0].as_f64().unwrap();
    let received: Vec<_> = lines.iter().map(|l| (l["sequence"].as_u64().unwrap(), x(l, "pose"))).collect();
    // Two and a half frames ago, from the third frame on.
    let wanted: Vec<_> = (3..8).map(|k| (k, k as f64 - 2.5)).collect();
    assert!(
        received.iter().zip(&wanted).all(|(t, w)| t.0 == w.0 && (t.1 - w.1).abs() < 1e-6) && received.len() == wanted.len(),
        "{received:?}"
    );
    for line in &lines {
        assert_eq!((&line["state"], &line["mount"]["state"]), (&"tracking".into(), &"tracking".into()));
        let film = line["mount"]["pose"]["position_m"][0].as_f64().unwrap();
        assert!((film - x(line, "pose") - 0.5).abs() < 1e-6, "{line}");
        // The stamp is that of the pose: x counts frames.
        assert!((line["timestamp_ns"].as_f64().unwrap() / FRAME_NS as f64 - x(line, "pose")).abs() < 1e-6, "{line}");
        assert!(line["measured"].is_null());
    }
}

#[test]
fn json_reports_the_mounted_cameras_frame_and_covariance() {
    let ear = Ear::new();
    let mut tracked = sample(0, State::Tracking, 0.0);
    let covariance = Matrix6::from_diagonal(&[0.0, 0.0, 0.0, 0.0, 0.0, 0.01 * 0.01].into());
    tracked.measurement = Some(Measurement {
        pose: golden_camera(),
        covariance,
        common: Matrix6::zeros(),
        model: Some(TwoViewModel::Homography),
        homography: None,
        essential: None,
        inliers: Some(9),
        rms_px: Some(0.1),
    });
    let all = OutputSettings { bodies: vec![BodyChoice::Camera, BodyChoice::Mount], ..output(json(), &ear) };
    let publisher = started(&[all], mount(BodyChoice::Camera, None, Duration::ZERO));
    publisher.send(&tracked);
    publisher.close();
    let line = ear.json();
    let film = &line["mount"];
    assert_eq!((&film["name"], &film["state"]), (&"film".into(), &"tracking".into()));
    // Looking left, level: its optical z is -x of the stage, its optical y is down.
    let q: Vec<f64> = film["pose"]["orientation_xyzw"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
    let rotation = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(q[3], q[0], q[1], q[2]));
    assert!((rotation * Vector3::z() + Vector3::x()).norm() < 1e-9 && (rotation * Vector3::y() + Vector3::z()).norm() < 1e-9, "{rotation}");
    // A hundredth of a radian about the vertical moves a point half a metre to the right by 5 mm
    // forward.
    let received: Vec<f64> = film["covariance"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
    assert!(
        (received[7].sqrt() - 0.005).abs() < 1e-9 && received[0].abs() < 1e-15 && (received[35].sqrt() - 0.01).abs() < 1e-9,
        "{received:?}"
    );
    assert_eq!(line["objects"], serde_json::json!([]));
}
