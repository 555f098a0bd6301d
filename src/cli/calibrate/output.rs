//! Writing results: whole files or none, and the date that goes into them.

use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use super::CalibrateArguments;
use crate::cli::failure::Failure;

/// Writes a file beside its place and moves it there, so that what was there is replaced by a whole file or not at all.
pub(in crate::cli) fn write(file: &Path, text: &str) -> Result<(), Failure> {
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    let beside = file.with_file_name(format!(".{name}.{}", std::process::id()));
    // What is no plain file - a pipe, /dev/stdout - cannot be replaced, only written to.
    if std::fs::metadata(file).is_ok_and(|m| !m.is_file()) {
        return std::fs::write(file, text).map_err(Failure::output(file));
    }
    let written = std::fs::write(&beside, text).and_then(|()| std::fs::rename(&beside, file));
    if written.is_err() {
        let _ = std::fs::remove_file(&beside);
    }
    written.map_err(Failure::output(file))
}

/// Finds an output's missing folder before the work is done, not after.
pub(super) fn refuse_unwritable(arguments: &CalibrateArguments) -> Result<(), Failure> {
    let files: Vec<&PathBuf> = [&arguments.output, &arguments.report, &arguments.json].into_iter().flatten().collect();
    for file in files {
        let folder = file.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        if !folder.is_dir() || file.is_dir() {
            let source = std::io::Error::from(if file.is_dir() { std::io::ErrorKind::IsADirectory } else { std::io::ErrorKind::NotFound });
            return Err(Failure::output(file)(source));
        }
    }
    Ok(())
}

/// Today's date, UTC, as 2026-11-21.
pub(super) fn today() -> String {
    let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
    let (year, month, day) = civil(seconds / 86_400);
    format!("{year:04}-{month:02}-{day:02}")
}

/// Year, month and day of a day counted from 1970-01-01 (Hinnant's algorithm: years begin in March, leap days end them).
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
}
