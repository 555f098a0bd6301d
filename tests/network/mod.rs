//! What comes from the network is anything: datagrams for `listen`, requests for the HTTP server, and clients that mean no good.
//!
//! The inputs are made from good ones by a seeded mutator, so that every run has the same. `STAGEPOSE_NETWORK_INPUTS` says how many
//! of each kind; `benches/network.sh` runs many more and judges the time.

mod datagrams;
mod mutator;
mod packets;
#[cfg(all(feature = "http", feature = "live"))]
mod requests;
#[cfg(all(feature = "http", feature = "live"))]
mod service;
#[cfg(all(feature = "http", feature = "live"))]
mod siege;

/// Inputs of each kind; the default is for every run of the tests.
fn inputs() -> u64 {
    std::env::var("STAGEPOSE_NETWORK_INPUTS").ok().and_then(|n| n.parse().ok()).unwrap_or(2000)
}

/// Peak memory of a process so far, kB.
fn peak_memory_kb(process: u32) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).expect("Linux tells the peak of every process");
    line.trim().trim_end_matches(" kB").parse().unwrap()
}
