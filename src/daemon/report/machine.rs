//! Describes the machine: system, processor, memory, ffmpeg.

use std::fs;
use std::process::{Command, Stdio};

/// Returns one line per property.
pub(super) fn describe() -> String {
    let mut text = String::new();
    let mut line = |name: &str, value: Option<String>| text += &format!("{name}: {}\n", value.as_deref().unwrap_or("not known"));
    line("system", field("/etc/os-release", "PRETTY_NAME", '='));
    line("kernel", fs::read_to_string("/proc/sys/kernel/osrelease").ok().map(|s| s.trim().to_owned()));
    line("processor", field("/proc/cpuinfo", "model name", ':'));
    line("processors", std::thread::available_parallelism().ok().map(|n| n.to_string()));
    line("memory", field("/proc/meminfo", "MemTotal", ':'));
    line("memory free", field("/proc/meminfo", "MemAvailable", ':'));
    line("load", fs::read_to_string("/proc/loadavg").ok().map(|s| s.trim().to_owned()));
    line("ffmpeg", ffmpeg());
    text
}

/// Returns the first value for a name in a file of `name separator value` lines.
fn field(file: &str, name: &str, separator: char) -> Option<String> {
    let text = fs::read_to_string(file).ok()?;
    let value = text.lines().filter_map(|line| line.split_once(separator)).find(|(key, _)| key.trim() == name)?.1;
    Some(value.trim().trim_matches('"').to_owned())
}

fn ffmpeg() -> Option<String> {
    let output = Command::new("ffmpeg").arg("-version").stdin(Stdio::null()).output().ok()?;
    String::from_utf8_lossy(&output.stdout).lines().next().map(str::to_owned)
}
