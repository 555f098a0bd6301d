//! One finding of a diagnosis, and its severity.

/// Severity of a finding, worst first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Grade {
    /// The stage cannot be tracked, or poses are wrong, until it is fixed.
    Fault,
    /// The stage may be tracked, but something is almost certainly not as intended.
    Doubt,
    /// It works, but less well than it could, or by relying on an assumption.
    Warning,
    /// For information.
    Note,
}

/// A finding, with its fix.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// Severity.
    pub grade: Grade,
    /// A plain sentence without its full stop: what is wrong, and what to write or do instead.
    pub message: String,
}

impl Finding {
    /// Creates a finding that must be fixed.
    pub fn fault(message: impl Into<String>) -> Self {
        Self { grade: Grade::Fault, message: message.into() }
    }

    /// Creates a finding that should be fixed, though tracking works without.
    pub fn doubt(message: impl Into<String>) -> Self {
        Self { grade: Grade::Doubt, message: message.into() }
    }

    /// Creates a finding that should be checked.
    pub fn warning(message: impl Into<String>) -> Self {
        Self { grade: Grade::Warning, message: message.into() }
    }

    /// Creates a finding for information.
    pub fn note(message: impl Into<String>) -> Self {
        Self { grade: Grade::Note, message: message.into() }
    }
}

/// Formats a number as one would write it in a config: four significant digits, without trailing
/// zeros.
pub fn written(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return "0.0".to_owned();
    }
    let digits = (3 - value.abs().log10().floor() as i32).clamp(0, 9) as usize;
    let text = format!("{value:.digits$}");
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text };
    if text.contains('.') { text } else { format!("{text}.0") }
}

/// Rounds a number to the decimal place of three sigmas.
pub fn known_to(value: f64, sigma: f64) -> f64 {
    let place = 10_f64.powf((3.0 * sigma).log10().floor());
    if place.is_normal() { (value / place).round() * place } else { value }
}

/// Formats `[a, b]` as written in a config.
pub fn list(values: &[f64]) -> String {
    format!("[{}]", values.iter().map(|v| written(*v)).collect::<Vec<_>>().join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_written_as_in_a_config() {
        let cases =
            [(4.0, "4.0"), (0.1354, "0.1354"), (1.0 / 3.0, "0.3333"), (1234.6, "1235.0"), (-0.5, "-0.5"), (0.0, "0.0"), (1e-5, "0.00001")];
        for (value, text) in cases {
            assert_eq!(written(value), text);
        }
        assert_eq!(list(&[4.0, 2.25]), "[4.0, 2.25]");
    }

    #[test]
    fn numbers_are_rounded_to_their_uncertainty() {
        assert_eq!(written(known_to(2.998, 0.006)), "3.0");
        assert_eq!(written(known_to(0.1354, 0.0002)), "0.1354");
        assert_eq!(written(known_to(1234.0, 40.0)), "1200.0");
        assert_eq!(known_to(1.25, 0.0), 1.25);
        assert_eq!(known_to(1.25, f64::INFINITY), 1.25);
        assert_eq!(known_to(1.25, f64::NAN), 1.25);
    }

    #[test]
    fn faults_come_first() {
        assert!(Grade::Fault < Grade::Doubt && Grade::Doubt < Grade::Warning && Grade::Warning < Grade::Note);
    }
}
