//! Anything may arrive from the network: datagrams for `listen`, requests for the HTTP server, and
//! hostile clients.
//!
//! A seeded mutator makes the inputs from good ones, so that every run has the same inputs.
//! `STAGEPOSE_NETWORK_INPUTS` sets the number of each kind; `benches/network.sh` runs many more and
//! checks the time.

mod datagrams;
mod mutator;
mod packets;
#[cfg(all(feature = "http", feature = "live"))]
mod requests;
#[cfg(all(feature = "http", feature = "live"))]
mod service;
#[cfg(all(feature = "http", feature = "live"))]
mod siege;

/// Returns the number of inputs of each kind; the default suits every test run.
fn inputs() -> u64 {
    std::env::var("STAGEPOSE_NETWORK_INPUTS").ok().and_then(|n| n.parse().ok()).unwrap_or(2000)
}

/// Returns the peak memory of a process so far, kB.
fn peak_memory_kb(process: u32) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).expect("Linux tells the peak of every process");
    line.trim().trim_end_matches(" kB").parse().unwrap()
}
