//! The program itself, stopped as with the shell's Ctrl-Z and continued. What was under way is old
//! by then, and must not be sent as good.

use std::net::UdpSocket;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::Value;

const FIXTURE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/dolly");
/// Duration of a stop.
const STOP: Duration = Duration::from_millis(2500);

/// A program that is killed at the end of its test, whatever happens.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Returns the age of a line's frame by this process's own clock, seconds.
fn age_s(line: &Value) -> f64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap();
    now.as_secs_f64() - line["unix_ns"].as_i64().unwrap() as f64 * 1e-9
}

/// Returns the next line, and the age of its frame on arrival.
fn next(socket: &UdpSocket) -> (Value, f64) {
    let mut buffer = vec![0; 65_536];
    let length = socket.recv(&mut buffer).expect("a line comes");
    let line: Value = serde_json::from_slice(&buffer[..length]).unwrap();
    let age_s = age_s(&line);
    (line, age_s)
}

fn is_good(line: &Value) -> bool {
    line["state"] == "tracking"
}

#[test]
fn after_a_stop_no_old_pose_is_sent_as_tracking() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["backdrop.png", "flat.png", "camera.toml"] {
        std::fs::copy(format!("{FIXTURE}/{name}"), folder.path().join(name)).unwrap();
    }
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    socket.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    let stage = std::fs::read_to_string(format!("{FIXTURE}/stage.toml")).unwrap();
    let to = socket.local_addr().unwrap();
    // Sends per frame and at a fixed rate. One second is enough for a slow machine, and much less
    // than the stop.
    let output = |more: &str| format!("[[output]]\nkind = \"json\"\non_loss = \"flag\"\nto = [\"{to}\"]\n{more}");
    let config = format!("{stage}\n{}{}[safety]\nstale_after_s = 1.0\n", output(""), output("rate_hz = 30\n"));
    std::fs::write(folder.path().join("stage.toml"), config).unwrap();
    let frames: Vec<u8> =
        (0..40).chain((1..39).rev()).flat_map(|n| std::fs::read(format!("{FIXTURE}/frames/{n:06}.jpg")).unwrap()).collect();
    std::fs::write(folder.path().join("long.mjpeg"), frames.repeat(40)).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_stagepose"));
    command.current_dir(folder.path()).env_remove("NOTIFY_SOCKET").stdout(Stdio::null()).stderr(Stdio::null());
    let child = Running(command.args(["run", "--config", "stage.toml", "--play", "long.mjpeg"]).spawn().unwrap());
    let signal = |signal| kill(Pid::from_raw(child.0.id() as i32), signal).unwrap();

    let until_good = || {
        let begun = Instant::now();
        while !is_good(&next(&socket).0) {
            assert!(begun.elapsed() < Duration::from_secs(60), "nothing is tracked");
        }
    };
    until_good();
    for _ in 0..2 {
        signal(Signal::SIGSTOP);
        std::thread::sleep(STOP);
        // Drops what was sent before the stop.
        socket.set_nonblocking(true).unwrap();
        while socket.recv(&mut [0; 65_536]).is_ok() {}
        socket.set_nonblocking(false).unwrap();
        signal(Signal::SIGCONT);
        let (mut has_stale, mut good) = (false, 0);
        let begun = Instant::now();
        while good < 10 {
            assert!(begun.elapsed() < Duration::from_secs(60), "nothing is tracked after the stop");
            let (line, age_s) = next(&socket);
            has_stale |= line["event"] == "stale";
            if is_good(&line) {
                good += 1;
                // Checks the age by the program's own statement, and by this process's clock with
                // room for transport on a busy machine.
                assert!(line["age_ms"].as_f64().unwrap() < 1000.0 && age_s < 2.0, "{age_s} s old: {line}");
            }
        }
        assert!(has_stale, "the stop was not told");
    }
}
