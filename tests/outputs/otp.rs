//! OTP's poses are JSON's, within the format's micrometre and millionth of a degree; and the whole
//! way from one program to another.

use std::net::UdpSocket;
use std::process::{Command, Stdio};
use std::time::Duration;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use serde_json::Value;

use super::decoders;

/// Returns a port that is free now.
fn free_port() -> u16 {
    UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// Returns the rotation of the camera's body (x right, y forward, z up) from a line's optical pose.
fn body(line: &Value) -> UnitQuaternion<f64> {
    let [x, y, z, w] = [0, 1, 2, 3].map(|k| line["pose"]["orientation_xyzw"][k].as_f64().unwrap());
    let quarter = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::FRAC_PI_2);
    UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)) * quarter
}

#[test]
fn what_listen_asks_for_arrives_and_equals_json() {
    let (folder, sink) = (tempfile::tempdir().unwrap(), UdpSocket::bind("127.0.0.1:0").unwrap());
    let (asked_at, shown_at) = (free_port(), free_port());
    sink.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    let config = folder.path().join("otp.toml");
    let lines = folder.path().join("lines.jsonl");
    std::fs::write(
        &config,
        format!(
            "[[output]]\nkind = \"otp\"\nto = [\"{}\", \"127.0.0.1:{shown_at}\"]\nlisten = \"127.0.0.1:{asked_at}\"\n\
             [[output]]\nkind = \"json\"\nfile = \"{}\"\n",
            sink.local_addr().unwrap(),
            lines.display()
        ),
    )
    .unwrap();
    let program = env!("CARGO_BIN_EXE_stagepose");
    let mut sender =
        Command::new(program).args(["send-test", "--seconds", "16", "--config"]).arg(&config).stderr(Stdio::null()).spawn().unwrap();
    let listener = Command::new(program)
        .args(["listen", "otp", &shown_at.to_string(), "--ask", &format!("127.0.0.1:{asked_at}"), "--count", "3"])
        .output()
        .unwrap();
    let shown = String::from_utf8(listener.stdout).unwrap();
    assert_eq!(shown.lines().count(), 3, "{shown}");
    assert!(shown.lines().all(|line| line.contains("all points: point 1/1/1 priority 100 at ") && line.contains(" deg/s")), "{shown}");
    let mut buffer = [0; 2048];
    let packets: Vec<Vec<u8>> = (0..30).map(|_| sink.recv(&mut buffer).map(|length| buffer[..length].to_vec()).unwrap()).collect();
    assert!(sender.wait().unwrap().success());
    let lines = std::fs::read_to_string(lines).unwrap();
    let lines: Vec<Value> =
        lines.lines().map(|line| serde_json::from_str(line).unwrap()).filter(|l: &Value| !l["pose"].is_null()).collect();
    let mut last_us = 0;
    for packet in packets {
        let point = decoders::otp(&packet).unwrap().remove(0);
        assert!(point.number == 1 && point.time_us > last_us, "the camera, at rising times");
        last_us = point.time_us;
        let (position, angles) = (point.position_m.unwrap(), point.angles_deg.unwrap().map(f64::to_radians));
        let rotation = UnitQuaternion::from_euler_angles(angles[0], angles[1], angles[2]);
        let off = |line: &Value| (0..3).map(|k| (line["pose"]["position_m"][k].as_f64().unwrap() - position[k]).abs()).fold(0.0, f64::max);
        let nearest = lines.iter().min_by(|a, b| off(a).total_cmp(&off(b))).unwrap();
        assert!(off(nearest) <= 0.501e-6, "{position:?} is off by {} m", off(nearest));
        // Half a unit in each of three angles.
        let turned = (body(nearest).inverse() * rotation).imag().norm() * 2.0;
        assert!(turned.to_degrees() <= 1.51e-6, "{angles:?} is off by {turned} rad");
    }
}
