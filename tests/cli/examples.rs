//! The first command of every shipped example of an output, run as it is written.

use std::process::Command;

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

#[test]
fn every_example_sends_before_there_is_a_camera() {
    let folder = tempfile::tempdir().unwrap();
    let mut examples = 0;
    for example in std::fs::read_dir(format!("{ROOT}/config")).unwrap().flatten() {
        let text = std::fs::read_to_string(example.path()).unwrap();
        if !text.lines().any(|line| line == "[[output]]") {
            continue;
        }
        // Nothing leaves this machine. Ports of receivers that somebody runs here may hear it: they are asked for no more than that.
        let here: String = text.lines().map(|line| to_this_machine(line) + "\n").collect();
        let name = example.file_name().into_string().unwrap();
        std::fs::write(folder.path().join(&name), here).unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_stagepose"));
        let run = command.args(["send-test", "--config", &name, "--seconds", "0.2"]).current_dir(folder.path()).output().unwrap();
        let said = String::from_utf8_lossy(&run.stderr);
        assert_eq!(run.status.code(), Some(0), "{name}: {said}");
        assert!(said.contains("camera.toml is not there yet") && said.contains("sending a test pose to "), "{name}: {said}");
        examples += 1;
    }
    assert!(examples >= 6, "{examples}");
}

/// A config's line with the addresses of other machines replaced by this one's.
fn to_this_machine(line: &str) -> String {
    match line.split_once("192.168.").filter(|_| !line.starts_with('#')) {
        Some((before, after)) => {
            let rest = after.trim_start_matches(|c: char| c.is_ascii_digit() || c == '.');
            format!("{before}127.0.0.1{rest}")
        }
        None => line.to_owned(),
    }
}
