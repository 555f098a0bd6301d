//! What the system's clock is worth, as the kernel knows it (adjtimex): whether a time service
//! keeps it, and how far it may be off.

use std::mem::MaybeUninit;

use nix::libc;

/// The quality of `CLOCK_REALTIME`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClockQuality {
    /// Whether a time service (NTP, PTP) keeps it. The kernel does not know which one.
    pub is_synchronised: bool,
    /// Maximum error, seconds. It grows by 500 ppm while no service corrects it.
    pub max_error_s: f64,
    /// Correction of its rate, parts per million.
    pub frequency_ppm: f64,
    /// TAI minus UTC, seconds; `None` if no service has set it in the kernel.
    pub tai_offset_s: Option<i32>,
}

/// TAI minus UTC since 2017, seconds (IERS Bulletin C).
const TAI_OFFSET_S: i32 = 37;
/// The kernel's unit of frequency: 2^-16 ppm.
const FREQUENCY_UNIT: f64 = 65_536.0;

impl ClockQuality {
    /// Asks the kernel; `None` if it refuses (a sandbox).
    pub fn read() -> Option<Self> {
        let mut timex = MaybeUninit::<libc::timex>::zeroed();
        // SAFETY: all zeros is a valid `timex`, whose `modes` of 0 only reads; the call writes into
        // it and keeps no pointer.
        let (state, timex) = unsafe { (libc::adjtimex(timex.as_mut_ptr()), timex.assume_init()) };
        (state >= 0).then(|| Self {
            is_synchronised: state != libc::TIME_ERROR && timex.status & libc::STA_UNSYNC == 0,
            max_error_s: timex.maxerror as f64 * 1e-6,
            frequency_ppm: timex.freq as f64 / FREQUENCY_UNIT,
            tai_offset_s: Some(timex.tai).filter(|offset| *offset != 0),
        })
    }
}

/// Returns TAI minus UTC, seconds: the kernel's, or today's.
pub(super) fn tai_offset_s() -> i64 {
    ClockQuality::read().and_then(|quality| quality.tai_offset_s).unwrap_or(TAI_OFFSET_S).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_kernel_answers_with_possible_numbers() {
        let quality = ClockQuality::read().expect("reading needs no rights");
        assert!(quality.max_error_s >= 0.0 && quality.frequency_ppm.abs() <= 500.0, "{quality:?}");
        assert!(tai_offset_s() >= 37);
    }
}
