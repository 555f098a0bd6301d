//! Settings of an output, from the validated config.

use std::net::SocketAddr;
use std::time::Duration;

use super::freed::FreedSettings;
use super::json::JsonSettings;
use super::opentrackio::OpenTrackIoSettings;
use super::osc::OscSettings;
use super::otp::OtpSettings;
use super::placement::Placement;
use super::psn::PsnSettings;
use super::report::BodyChoice;
use super::transport::{StreamSettings, UdpSettings};

/// One `[[output]]`.
#[derive(Debug, Clone, PartialEq)]
pub struct OutputSettings {
    /// Its name in messages and metrics.
    pub name: String,
    /// Whether it sends at all.
    pub enabled: bool,
    /// Its protocol.
    pub protocol: Protocol,
    /// UDP destinations.
    pub udp: UdpSettings,
    /// The bodies it reports, the main one first.
    pub bodies: Vec<BodyChoice>,
    /// When it sends.
    pub rate: Rate,
    /// Delay when sending with every frame: the poses sent are those of this long before it. A
    /// fixed rate has its own delay.
    pub delay: Duration,
    /// What it does when no pose is known.
    pub on_loss: OnLoss,
    /// The receiver's origin, axes and units.
    pub placement: Placement,
    /// Whether `[safety]` applies to it.
    pub is_guarded: bool,
    /// Whether zoom and focus are those that the other tracker sends.
    pub passes_rings: bool,
}

impl OutputSettings {
    /// Returns the destinations of its lines besides UDP.
    pub(crate) fn stream(&self) -> Option<&StreamSettings> {
        match &self.protocol {
            Protocol::Json(json) => Some(&json.stream),
            _ => None,
        }
    }

    /// Returns where receivers ask it for something.
    pub(crate) fn listen(&self) -> Option<SocketAddr> {
        match &self.protocol {
            Protocol::Otp(otp) => Some(otp.listen),
            _ => None,
        }
    }
}

/// The protocol of an output, with its settings.
#[derive(Debug, Clone, PartialEq)]
pub enum Protocol {
    /// FreeD D1.
    Freed(FreedSettings),
    /// OpenTrackIO 1.0.1.
    OpenTrackIo(OpenTrackIoSettings),
    /// PosiStageNet 2.03.
    Psn(PsnSettings),
    /// OTP, ANSI E1.59-2021.
    Otp(OtpSettings),
    /// Open Sound Control 1.0.
    Osc(OscSettings),
    /// Lines of JSON.
    Json(JsonSettings),
}

impl Protocol {
    /// Returns its name in the config.
    pub fn word(&self) -> &'static str {
        match self {
            Self::Freed(_) => "freed",
            Self::OpenTrackIo(_) => "opentrackio",
            Self::Psn(_) => "psn",
            Self::Otp(_) => "otp",
            Self::Osc(_) => "osc",
            Self::Json(_) => "json",
        }
    }
}

/// When an output sends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Rate {
    /// With every n-th sample of the tracker.
    Every(u32),
    /// On its own ticks, with poses interpolated or extrapolated to the tick.
    Fixed {
        /// Ticks per second.
        rate: FixedRate,
        /// Delay: the pose sent is the one of this long ago.
        delay: Duration,
        /// Where the ticks lie.
        phase: TickPhase,
    },
}

/// Where the ticks of a fixed rate lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TickPhase {
    /// They begin with the output.
    FreeRunning,
    /// On the frames of the system's clock, counted from 1970 in TAI (SMPTE ST 2059-1).
    Clock,
}

impl Rate {
    /// Returns reports per second, for a tracker of `frame_rate` frames per second.
    pub fn hz(self, frame_rate: f64) -> f64 {
        match self {
            Self::Every(n) => frame_rate / f64::from(n.max(1)),
            Self::Fixed { rate, .. } => rate.hz(),
        }
    }
}

/// Ticks per second as a fraction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FixedRate {
    /// Ticks in `per_s` seconds.
    pub ticks: u32,
    /// Length of the period, seconds.
    pub per_s: u32,
}

impl FixedRate {
    /// The supported rates by their names in the config: video rates, of which 29.97 and 59.94 are
    /// fractions over 1001 (SMPTE).
    pub const KNOWN: [(f64, FixedRate); 6] = [
        (25.0, FixedRate { ticks: 25, per_s: 1 }),
        (29.97, FixedRate { ticks: 30_000, per_s: 1001 }),
        (30.0, FixedRate { ticks: 30, per_s: 1 }),
        (50.0, FixedRate { ticks: 50, per_s: 1 }),
        (59.94, FixedRate { ticks: 60_000, per_s: 1001 }),
        (60.0, FixedRate { ticks: 60, per_s: 1 }),
    ];

    /// Returns the time from tick 0 to tick `k`, without accumulating rounding.
    pub fn tick(self, k: u64) -> Duration {
        let ns = u128::from(k) * u128::from(self.per_s) * 1_000_000_000 / u128::from(self.ticks);
        Duration::from_nanos(u64::try_from(ns).unwrap_or(u64::MAX))
    }

    /// Returns the last tick that has begun at this time after tick 0.
    pub fn tick_at(self, time: Duration) -> u64 {
        let per_s = u128::from(self.per_s) * 1_000_000_000;
        // A tick's time is rounded down, so the estimate may be one too low.
        let next = u64::try_from(time.as_nanos().saturating_mul(u128::from(self.ticks)) / per_s).unwrap_or(u64::MAX - 1) + 1;
        if self.tick(next) <= time { next } else { next - 1 }
    }

    /// Returns ticks per second.
    pub fn hz(self) -> f64 {
        f64::from(self.ticks) / f64::from(self.per_s)
    }
}

/// What an output does when no pose is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OnLoss {
    /// Sends no pose; a format that can mark a loss does so once a second.
    Stop,
    /// Repeats the last pose.
    Hold,
    /// Marks in every packet that no pose is known.
    Flag,
}

/// Default maximum speed of a sent pose, m/s: no stage camera is as fast, nor a thrown prop.
/// Raised, a pose that jumps to a look-alike moves the scenery more easily; lowered, fast motion is
/// withheld.
pub const FASTEST_M_S: f64 = 20.0;
/// Default maximum angular speed, degrees per second; see [`FASTEST_M_S`].
pub const FASTEST_DEG_S: f64 = 1000.0;

/// Limits that keep machinery from being moved by a bad pose; each output applies them separately.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SafetySettings {
    /// Maximum speed, metres per second; a pose that could only be reached faster is withheld.
    pub max_speed_m_s: Option<f64>,
    /// Maximum angular speed, radians per second.
    pub max_angular_speed_rad_s: Option<f64>,
    /// Minimum and maximum corner of the permitted box, stage frame, metres; a pose outside is
    /// withheld.
    pub permitted_box_m: Option<[[f64; 3]; 2]>,
    /// After a loss the output returns to the pose at these rates instead of jumping.
    pub blend: Option<BlendRates>,
    /// Time without a frame after which the failure is reported to the receiver.
    pub stale_after: Duration,
}

/// Maximum speed of an output's return after a loss.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlendRates {
    /// Metres per second.
    pub speed_m_s: f64,
    /// Radians per second.
    pub angular_speed_rad_s: f64,
}

impl SafetySettings {
    /// Returns the default limits, which no stage camera exceeds. [`Default`] has none.
    pub fn usual() -> Self {
        Self { max_speed_m_s: Some(FASTEST_M_S), max_angular_speed_rad_s: Some(FASTEST_DEG_S.to_radians()), ..Self::default() }
    }

    /// Returns a warning if frames come so rarely that each is stale before the next one arrives.
    pub fn note_on_rate(&self, frames_per_s: f64) -> Option<String> {
        let (stale_s, interval_s) = (self.stale_after.as_secs_f64(), 1.0 / frames_per_s);
        (frames_per_s > 0.0 && stale_s < interval_s).then(|| {
            format!(
                "stale_after_s in [safety] is {stale_s} s, but at {:.4} frames a second a frame comes every {interval_s:.3} s: receivers \
                 get `stale` between all frames; give at least {:.1}",
                frames_per_s,
                (30.0 * interval_s).ceil() / 10.0
            )
        })
    }
}

impl Default for SafetySettings {
    fn default() -> Self {
        Self {
            max_speed_m_s: None,
            max_angular_speed_rad_s: None,
            permitted_box_m: None,
            blend: None,
            stale_after: Duration::from_millis(500),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_do_not_drift() {
        let rate = FixedRate::KNOWN[1].1;
        assert_eq!(rate.tick(30_000), Duration::from_secs(1_001));
        assert_eq!(rate.tick(30_000 * 1_000_000), Duration::from_secs(1_001_000_000));
        assert!((rate.hz() - 29.97).abs() < 1e-4);
    }

    #[test]
    fn the_tick_of_an_instant_is_the_latest_started_one() {
        for (_, rate) in FixedRate::KNOWN {
            for k in [0, 1, 7, 59, 1_000_003] {
                let (at, instant) = (rate.tick(k), Duration::from_nanos(1));
                assert_eq!([rate.tick_at(at), rate.tick_at(at + instant), rate.tick_at(rate.tick(k + 1) - instant)], [k; 3]);
            }
        }
    }
}
