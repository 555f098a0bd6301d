//! Outputs from outside: `replay` and `send-test` send, `check` tries what the machine offers, and
//! `listen` prints what arrives.

use std::io::{BufRead, BufReader};
use std::net::{TcpListener, UdpSocket};
use std::process::Stdio;
use std::time::Duration;

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

use super::scene::{CONFIG, Scene};

fn receiver() -> (UdpSocket, u16) {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    socket.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
    let port = socket.local_addr().unwrap().port();
    (socket, port)
}

#[test]
fn a_replay_sends_its_records() {
    let scene = Scene::new();
    let (socket, port) = receiver();
    let output = format!(
        "[[output]]\nkind = \"json\"\non_loss = \"flag\"\nto = [\"127.0.0.1:{port}\"]\nfile = \"sent.jsonl\"\n[safety]\nstale_after_s = 60\n"
    );
    scene.write("stage.toml", &format!("{CONFIG}{output}"));
    scene.replay(&["--outputs", "--poses", "poses.jsonl"]).assert_success();
    let (sent, poses) = (scene.read("sent.jsonl"), scene.read("poses.jsonl"));
    assert_eq!((sent.lines().count(), poses.lines().count()), (6, 6));
    for (sent, record) in sent.lines().zip(poses.lines()) {
        assert!(sent.starts_with(record.trim_end_matches('}')) && sent.contains("\"age_ms\":"), "{sent}\n{record}");
        let mut buffer = vec![0; 65_536];
        let length = socket.recv(&mut buffer).unwrap();
        assert_eq!(std::str::from_utf8(&buffer[..length]).unwrap().trim_end(), sent);
    }
}

#[test]
fn a_replay_that_is_not_asked_to_sends_nothing() {
    let scene = Scene::new();
    let (socket, port) = receiver();
    let output = format!("[[output]]\nkind = \"json\"\non_loss = \"flag\"\nto = [\"127.0.0.1:{port}\"]\nfile = \"sent.jsonl\"\n");
    scene.write("stage.toml", &format!("{CONFIG}{output}"));
    scene.replay(&["--poses", "poses.jsonl"]).assert_success();
    socket.set_nonblocking(true).unwrap();
    let heard = socket.recv(&mut [0; 64]);
    assert_eq!(heard.map_err(|e| e.kind()), Err(std::io::ErrorKind::WouldBlock));
    assert!(!scene.path("sent.jsonl").exists());
}

#[test]
fn check_names_the_outputs_and_refuses_a_port_in_use() {
    let scene = Scene::new();
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let at = taken.local_addr().unwrap();
    let freed = "[[output]]\nkind = \"freed\"\nname = \"studio\"\nto = [\"127.0.0.1:40000\"]\nrate_hz = 50\n";
    scene.write("stage.toml", &format!("{CONFIG}{freed}"));
    let run = scene.run(&["check", "--config", "stage.toml"]);
    run.assert_success();
    let wanted = "output      studio: freed to 127.0.0.1:40000, 50.00 times a second, free-running, 80 ms late, stops on loss";
    assert!(run.stdout.contains(wanted), "{}", run.stdout);
    scene.write("stage.toml", &format!("{CONFIG}{freed}[[output]]\nkind = \"json\"\ntcp_listen = \"{at}\"\n"));
    let parts = ["`tcp_listen` in [[output]], line 13: cannot wait for clients on", &at.to_string(), "give a free port"];
    scene.run(&["check", "--config", "stage.toml"]).assert_refused(2, &parts);
    scene.replay(&["--outputs"]).assert_refused(1, &["output json-11: cannot wait for clients on"]);
    scene.write("stage.toml", &format!("{CONFIG}[http]\nlisten = \"{at}\"\n"));
    scene.run(&["check", "--config", "stage.toml"]).assert_refused(2, &["`listen` in [http], line 7: cannot listen on"]);
}

#[test]
fn check_lists_the_allowed_hosts() {
    let scene = Scene::new();
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    scene.write("stage.toml", &format!("{CONFIG}[http]\nlisten = \"127.0.0.1:{port}\"\nhosts = [\"Stage.example.org\"]\n"));
    let run = scene.run(&["check", "--config", "stage.toml"]);
    run.assert_success();
    let line = run.stdout.lines().find(|line| line.contains("answers for the hosts localhost, ")).expect("a line for the hosts");
    assert!(line.contains(", 127.0.0.1, ::1, ") && line.ends_with(", stage.example.org"), "{line}");
    scene.write("stage.toml", &format!("{CONFIG}[http]\nhosts = [\"http://stage\"]\n"));
    scene.run(&["check", "--config", "stage.toml"]).assert_refused(2, &["`hosts` in [http], line 7: `http://stage` cannot be used"]);
}

#[test]
fn a_test_pose_is_sent_and_listened_to() {
    let scene = Scene::new();
    let port = {
        let (_socket, port) = receiver();
        port
    };
    // A config with outputs alone is enough; there is no stage yet.
    scene.write("outputs.toml", &format!("[[output]]\nkind = \"freed\"\nto = [\"127.0.0.1:{port}\"]\n"));
    let mut sender = scene.command(&["send-test", "--config", "outputs.toml"]).stderr(Stdio::piped()).spawn().unwrap();
    let heard = scene.run(&["listen", "freed", &port.to_string(), "--count", "3"]);
    kill(Pid::from_raw(sender.id() as i32), Signal::SIGINT).unwrap();
    let mut said = String::new();
    BufReader::new(sender.stderr.take().unwrap()).read_line(&mut said).unwrap();
    assert_eq!(sender.wait().unwrap().code(), Some(0));
    assert!(said.starts_with("sending a test pose to freed-1"), "{said}");
    heard.assert_success();
    assert_eq!(heard.stdout.lines().filter(|line| line.contains(" camera 1 pan ")).count(), 3, "{}", heard.stdout);
}

#[test]
fn send_test_without_outputs_is_refused() {
    let scene = Scene::new();
    scene.run(&["send-test", "--config", "stage.toml"]).assert_refused(2, &["stage.toml: there is no [[output]] section to send to"]);
}
