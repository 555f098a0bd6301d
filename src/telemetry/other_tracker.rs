//! The other tracker's state for health and metrics.

use serde::Serialize;

/// The states by their names.
pub(super) const STATES: [&str; 7] = ["never heard", "unreadable", "other source", "heard", "no pose", "stale", "lost"];

/// What is known of the other tracker now.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct OtherTrackerStatus {
    /// `never heard`, `unreadable`, `other source`, `heard`, `no pose`, `stale` or `lost`.
    pub state: &'static str,
    /// Who is followed; null before the first packet.
    pub source: Option<String>,
    /// Packets per second; null before the second.
    pub rate_hz: Option<f64>,
    /// From 0 at the wide end to 1 at the long end; null if it is not known.
    pub zoom: Option<f64>,
    /// In the sender's counts.
    pub zoom_raw: Option<f64>,
    /// The same for focus.
    pub focus_raw: Option<f64>,
    /// How the two trackers differ; null until it is known.
    pub difference: Option<TrackerDifference>,
    /// What is the case, in words.
    pub sentence: String,
    /// What to do about it; null if there is nothing to do.
    pub hint: Option<String>,
}

/// Differences over the last minute, after the alignment.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrackerDifference {
    /// Number of instants.
    pub pairs: usize,
    /// How much later the other's packets arrive, seconds, and its sigma; null if it is not known.
    pub delay_s: Option<[f64; 2]>,
    /// In position: root mean square, metres.
    pub rms_m: f64,
    /// The 95th percentile.
    pub p95_m: f64,
    /// In rotation: root mean square, degrees.
    pub rms_deg: f64,
    /// The 95th percentile.
    pub p95_deg: f64,
    /// Our metre in the other's, minus 1.
    pub scale: f64,
    /// `good`, `usable` or `do not use`.
    pub verdict: String,
}
