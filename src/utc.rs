//! UTC dates and times of day: the proleptic Gregorian calendar from seconds since 1970 (Howard
//! Hinnant's `civil_from_days`: years start in March, so leap days come last).

use std::time::{SystemTime, UNIX_EPOCH};

/// Returns whole seconds since 1970 by the system clock; 0 if it is set before that.
pub fn now_s() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs())
}

/// Formats a date as "2026-11-21".
pub fn date(seconds: u64) -> String {
    let (year, month, day) = civil(seconds / 86_400);
    format!("{year:04}-{month:02}-{day:02}")
}

/// Formats date and time as "2026-11-21T07:45:00Z".
pub fn date_and_time(seconds: u64) -> String {
    let of_day = seconds % 86_400;
    format!("{}T{:02}:{:02}:{:02}Z", date(seconds), of_day / 3600, of_day / 60 % 60, of_day % 60)
}

/// Formats the current date and time for a report: "2026-11-21 07:45:00 UTC".
pub fn report_date() -> String {
    date_and_time(now_s()).replace('T', " ").replace('Z', " UTC")
}

/// Converts days since 1970-01-01 to year, month and day.
fn civil(days: u64) -> (u64, u64, u64) {
    let shifted = days + 719_468;
    let (era, day_of_era) = (shifted / 146_097, shifted % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1_460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = if month_from_march < 10 { month_from_march + 3 } else { month_from_march - 9 };
    (year_of_era + 400 * era + u64::from(month <= 2), month, day)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_become_dates() {
        assert_eq!(civil(0), (1970, 1, 1));
        assert_eq!(civil(11_016), (2000, 2, 29));
        assert_eq!(civil(20_778), (2026, 11, 21));
    }

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
        known.iter().for_each(|(seconds, date)| assert_eq!(date_and_time(*seconds), *date));
    }
}
