//! A tracked object in front of the stage.

use nalgebra::Vector3;
use stagepose::diagnostics::simulate::paint;
use stagepose::{BodySpec, MovingObject, ObjectPath, Spline, State, VirtualStage};

use super::scene::{FPS, aside, backdrop, camera, quiet, surface, track};

fn with_prop() -> VirtualStage {
    let mut scene = quiet(camera(640, 480), aside(), backdrop());
    let art = stagepose::diagnostics::simulate::grey(&paint(400, 400, 77));
    let prop = surface("prop", &art, [0.9, 0.9], Vector3::new(0.0, -0.1, 0.45), 0.0);
    let keys = [(0.0, Vector3::new(-0.5, -1.0, -0.5)), (1.0, Vector3::new(0.1, -1.1, -0.4))];
    let path = ObjectPath { position: Spline::new(&keys).unwrap(), turn_rad: -0.3, turn_rate_rad_s: 0.2 };
    scene.objects.push(MovingObject { body: BodySpec::new("prop", vec![prop]), path });
    scene
}

#[test]
fn an_object_is_posed_in_the_stage() {
    let scene = with_prop();
    let mut worst = (0.0_f64, 0.0_f64);
    for sample in track(&scene, 8).iter().skip(1) {
        assert_eq!((sample.state, sample.objects[0].state), (State::Tracking, State::Tracking), "frame {}", sample.sequence);
        assert_eq!(sample.objects[0].name, "prop");
        let truth = scene.object_truth(0, sample.timestamp.seconds()).unwrap();
        let found = sample.objects[0].pose.unwrap();
        worst.0 = worst.0.max((found.translation - truth.translation).norm());
        worst.1 = worst.1.max(found.angle_to(&truth).to_degrees());
    }
    println!("worst: {:.4} m, {:.3} degrees", worst.0, worst.1);
    assert!(worst.0 < 0.003 && worst.1 < 0.1, "{worst:?}");
}

#[test]
fn an_object_does_not_track_in_a_blackout() {
    let mut scene = with_prop();
    scene.blackouts.push(3.5 / FPS..11.5 / FPS);
    for sample in track(&scene, 15) {
        let dark = (4..12).contains(&sample.sequence);
        let found = (1..4).contains(&sample.sequence) || sample.sequence >= 13;
        if dark {
            assert_ne!(sample.objects[0].state, State::Tracking, "frame {}", sample.sequence);
        }
        if found {
            assert_eq!(sample.objects[0].state, State::Tracking, "frame {}", sample.sequence);
        }
    }
}
