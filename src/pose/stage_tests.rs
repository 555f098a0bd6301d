use nalgebra::{Matrix6, UnitQuaternion, Vector3};

use super::*;
use State::{Coasting, Lost, Searching, Tracking};

fn body(state: State) -> BodyObservation {
    let pose = Pose::new(UnitQuaternion::from_euler_angles(1.5, 0.1, 0.0), Vector3::new(0.1, 0.2, 3.0));
    let verified = Verified {
        pose,
        covariance: Matrix6::identity() * 1e-6,
        by_model: None,
        share: 1.0,
        inliers: 0,
        solver_rms_px: 0.1,
        is_conclusive: false,
    };
    BodyObservation { state, verified: (state == Tracking).then_some(verified), rms_px: (state == Tracking).then_some(0.1), reason: None }
}

fn observation(sequence: u64, stage: State, object: State) -> FrameObservation {
    FrameObservation {
        sequence,
        timestamp: Timestamp::from_ns(sequence as i64 * 33_333_333),
        is_timed: true,
        stage: body(stage),
        two_view: None,
        objects: vec![body(object)],
        misfit: None,
        mixture: None,
        shutter_news: None,
        learnt: Default::default(),
        acquire_ms: 0.0,
        align_ms: 0.0,
    }
}

/// The published states of the camera and the object, one observation after another.
fn published(seen: &[(State, State)]) -> Vec<(State, State)> {
    let mut stage = PoseStage::default();
    let estimates = seen.iter().enumerate().map(|(k, (camera, object))| stage.estimate(&observation(k as u64, *camera, *object)));
    estimates.map(|e| (e.camera.state, e.objects[0].state)).collect()
}

#[test]
fn an_object_needs_the_stage() {
    let seen = [(Tracking, Tracking), (Coasting, Tracking), (Lost, Tracking), (Tracking, Tracking)];
    assert_eq!(published(&seen), [(Tracking, Tracking), (Coasting, Coasting), (Lost, Lost), (Tracking, Tracking)]);
}

#[test]
fn an_object_that_never_had_a_stage_is_still_searched() {
    let seen = [(Searching, Tracking), (Tracking, Searching), (Coasting, Tracking), (Lost, Tracking)];
    assert_eq!(published(&seen), [(Searching, Searching), (Tracking, Searching), (Coasting, Searching), (Lost, Searching)]);
}

#[test]
fn an_object_with_an_uncertain_pose_is_not_reported() {
    let mut stage = PoseStage::default();
    let states = [1e-6, 1e-4, 1e-6].into_iter().enumerate().map(|(k, variance)| {
        let mut seen = observation(k as u64, Tracking, Tracking);
        seen.objects[0].verified.iter_mut().for_each(|v| v.covariance = Matrix6::identity() * variance);
        let estimate = stage.estimate(&seen);
        assert_eq!(estimate.camera.state, Tracking);
        assert_eq!(estimate.objects[0].pose.is_some(), estimate.objects[0].state == Tracking);
        estimate.objects[0].state
    });
    // A hundredth of a radian on each axis is one degree in total.
    assert_eq!(states.collect::<Vec<_>>(), [Tracking, Lost, Tracking]);
}

#[test]
fn a_skipped_row_leaves_the_motion_as_it_was() {
    let mut stage = PoseStage::default();
    stage.estimate(&observation(0, Tracking, Tracking));
    let skipped = stage.estimate(&FrameObservation { is_timed: false, ..observation(0, Lost, Lost) });
    assert_eq!((skipped.camera.state, skipped.objects[0].state), (Lost, Lost));
    assert!(skipped.camera.pose.is_none() && skipped.objects[0].pose.is_none());
    let after = stage.estimate(&observation(2, Coasting, Coasting));
    assert_eq!((after.camera.state, after.objects[0].state), (Coasting, Coasting));
    assert!(after.camera.pose.is_some() && after.objects[0].pose.is_some());
}

#[test]
fn covariance_comes_with_a_measurement_only() {
    let mut stage = PoseStage::default();
    let tracked = stage.estimate(&observation(0, Tracking, Tracking));
    let (camera, object) = (tracked.camera.measured.expect("measured"), tracked.objects[0].measured.expect("measured"));
    let (camera, object) = (camera.covariance(), object.covariance());
    // The object's error adds to the camera's.
    assert!(camera.trace() > 0.0 && object.trace() > camera.trace());
    let coasting = stage.estimate(&observation(1, Coasting, Coasting));
    assert!(coasting.camera.measured.is_none() && coasting.objects[0].measured.is_none());
}

#[test]
fn lens_uncertainty_is_reported_but_not_filtered() {
    let doubtful = |mut seen: BodyObservation| {
        seen.verified.iter_mut().for_each(|v| v.by_model = Some(Matrix6::identity() * 1e-2));
        seen
    };
    let kalman = FilterSettings { kind: crate::pose::FilterKind::Kalman(crate::pose::KalmanSettings::default()), predict_s: 0.0 };
    let (mut sure, mut doubting) = (PoseStage::with_filter(kalman), PoseStage::with_filter(kalman));
    for k in 0..5 {
        let known = observation(k, Tracking, Tracking);
        let open =
            FrameObservation { stage: doubtful(known.stage.clone()), objects: vec![doubtful(known.objects[0].clone())], ..known.clone() };
        let (known, open) = (sure.estimate(&known), doubting.estimate(&open));
        assert_eq!(known.camera.pose.map(|p| p.translation), open.camera.pose.map(|p| p.translation));
        let trace = |estimate: &PoseEstimate| estimate.camera.measured.unwrap().covariance().trace();
        assert!(trace(&open) > trace(&known) + 0.05);
        let trace = |estimate: &PoseEstimate| estimate.objects[0].measured.unwrap().covariance().trace();
        assert!(trace(&open) > trace(&known) + 0.1);
    }
}
