//! Dates for names: the proleptic Gregorian calendar from seconds since 1970 (Howard Hinnant's `civil_from_days`).

use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// "2026-11-21T07:45:00Z".
pub(super) fn text(seconds: u64) -> String {
    let (days, of_day) = (seconds / 86_400, seconds % 86_400);
    let z = days + 719_468;
    let (era, day_of_era) = (z / 146_097, z % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = if month_from_march < 10 { month_from_march + 3 } else { month_from_march - 9 };
    let year = year_of_era + era * 400 + u64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02}T{:02}:{:02}:{:02}Z", of_day / 3600, of_day / 60 % 60, of_day % 60)
}

/// A name below `folder` that is not taken: clip-20261121T074500Z, with a number behind it where need be.
pub fn new_clip_name(folder: &Path) -> PathBuf {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs();
    let plain: String = text(now).chars().filter(|c| *c != '-' && *c != ':').collect();
    let first = folder.join(format!("clip-{plain}"));
    let mut others = (2..).map(|n: u32| folder.join(format!("clip-{plain}-{n}")));
    if first.exists() { others.find(|p| !p.exists()).unwrap_or(first) } else { first }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_those_of_the_calendar() {
        // From `date -u -d @… +%FT%TZ`.
        let known = [
            (0, "1970-01-01T00:00:00Z"),
            (951_782_399, "2000-02-28T23:59:59Z"),
            (951_782_400, "2000-02-29T00:00:00Z"),
            (1_795_247_100, "2026-11-21T07:45:00Z"),
            (4_107_542_400, "2100-03-01T00:00:00Z"),
        ];
        known.iter().for_each(|(seconds, date)| assert_eq!(text(*seconds), *date));
    }
}
