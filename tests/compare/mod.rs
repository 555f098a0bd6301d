//! `stagepose compare` and `stagepose detectors` as a user runs them: on rendered pairs with exact
//! ground truth, on photographs with known ground truth, and on inputs that are not a pair.

mod bad;
mod detectors;
mod ended;
mod photographs;
mod rendered;

use std::path::Path;
use std::process::Command;

use serde_json::Value;

/// The result of a run.
struct Compared {
    code: Option<i32>,
    stdout: String,
    stderr: String,
    json: Value,
}

/// Runs `stagepose compare A B` with further arguments, and reads its JSON.
fn compare(folder: &Path, a: &str, b: &str, more: &[&str]) -> Compared {
    let json = folder.join("out.json");
    let _ = std::fs::remove_file(&json);
    let mut command = Command::new(env!("CARGO_BIN_EXE_stagepose"));
    command.current_dir(folder).args(["compare", a, b, "--json", "out.json"]).args(more);
    let output = command.output().expect("the program runs");
    Compared {
        code: output.status.code(),
        stdout: String::from_utf8_lossy(&output.stdout).into_owned(),
        stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
        json: std::fs::read(&json).ok().and_then(|bytes| serde_json::from_slice(&bytes).ok()).unwrap_or(Value::Null),
    }
}

fn numbers<const N: usize>(value: &Value) -> [f64; N] {
    let numbers: Vec<f64> = value.as_array().expect("numbers").iter().map(|v| v.as_f64().expect("a number")).collect();
    numbers.try_into().expect("as many as that")
}
