//! `[filter]`: which filter, its strength, and how far it predicts.

use super::ConfigError;
use super::as_typed;
use super::origin::Origin;
use super::values::Section;
use crate::pose::{FilterKind, FilterSettings, KalmanSettings, OneEuroSettings};

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Off,
    OneEuro,
    Kalman,
}

/// Reads `[filter]`.
pub(super) fn filter(origin: &Origin<'_>, typed: Option<&as_typed::Filter>) -> Result<FilterSettings, ConfigError> {
    let Some(typed) = typed else { return Ok(FilterSettings::default()) };
    let section = Section { origin, name: "[filter]" };
    let kinds = [("off", Kind::Off), ("one-euro", Kind::OneEuro), ("kalman", Kind::Kalman)];
    let kind = section.word("kind", typed.kind.as_ref(), Kind::Off, &kinds, "off, one-euro or kalman")?;
    let predict_s = section.number("predict_s", typed.predict_s.as_ref(), 0.0, |v| (0.0..=0.2).contains(&v), "seconds from 0 to 0.2")?;
    let one_euro = OneEuroSettings::default();
    let hertz = "a frequency above 0, at most 1000";
    let one_euro = OneEuroSettings {
        min_cutoff_hz: section.number(
            "min_cutoff_hz",
            typed.min_cutoff_hz.as_ref(),
            one_euro.min_cutoff_hz,
            |v| v > 0.0 && v <= 1e3,
            hertz,
        )?,
        beta: section.number("beta", typed.beta.as_ref(), one_euro.beta, |v| (0.0..=1e4).contains(&v), "a number from 0 to 10000")?,
    };
    let kalman = KalmanSettings::default();
    let above = |v: f64| v > 0.0 && v <= 1e5;
    let kalman = KalmanSettings {
        acceleration_m_s2: section.number(
            "acceleration_m_s2",
            typed.acceleration_m_s2.as_ref(),
            kalman.acceleration_m_s2,
            above,
            "metres per second squared, above 0",
        )?,
        angular_acceleration_rad_s2: section
            .number(
                "turn_acceleration_deg_s2",
                typed.turn_acceleration_deg_s2.as_ref(),
                kalman.angular_acceleration_rad_s2.to_degrees(),
                above,
                "degrees per second squared, above 0",
            )?
            .to_radians(),
    };
    let kind = match (kind, &typed.predict_s) {
        (Kind::Off, Some(predict)) if predict_s > 0.0 => {
            let problem = "a prediction needs the velocity that a filter estimates; add kind = \"kalman\"";
            return Err(section.conflict("predict_s", predict, problem));
        }
        (Kind::Off, _) => FilterKind::Off,
        (Kind::OneEuro, _) => FilterKind::OneEuro(one_euro),
        (Kind::Kalman, _) => FilterKind::Kalman(kalman),
    };
    Ok(FilterSettings { kind, predict_s })
}
