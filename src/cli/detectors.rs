//! `stagepose detectors`: benchmarks every detector and descriptor on given pictures and prints a
//! table.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::time::Instant;

use clap::Args;
use image::GrayImage;
use nalgebra::Matrix3;
use serde_json::json;

use super::calibrate::write_whole;
use super::compare::{FeatureArguments, read_picture};
use super::failure::Failure;
use super::interrupt;
use super::output_file::print;
use super::replay::progress::Progress;
use super::spared::Spared;
use crate::compare::CompareOptions;
use crate::compare::detector_scores::{DetectorScore, score};
use crate::compare::known_views::{CHANGES, changed};
use crate::features::two_views::{DescriptorKind, DetectorKind, FeatureSettings, extract_watched};
use crate::geometry::Homography;
use crate::printable::printable_lines;
use crate::safe_file;
use crate::simulate;

/// Measure every detector and descriptor on pairs of pictures whose homography is known.
#[derive(Debug, Clone, Args)]
#[command(after_help = "Examples:\n  stagepose detectors backdrop.png\n  stagepose detectors 1.png 2.png 3.png --homography H_1_2 \
                        --homography H_1_3 --json table.json\n\nExample:\n  stagepose detectors\n\nEach picture is rendered again rolled, \
                        zoomed, tilted, out of focus and dimmed, so the true position of every point is known. With --homography, one for \
                        each picture after the first, the pictures are photographs of the same scene instead: nine numbers, row by row, \
                        that map the first picture's pixels to the other's.")]
pub(super) struct DetectorsArguments {
    /// Pictures [default: a painted backdrop]
    images: Vec<PathBuf>,
    /// A text file with the homography from the first picture to the second, then one to the third,
    /// …
    #[arg(long, value_name = "FILE")]
    homography: Vec<PathBuf>,
    /// Only these detectors, separated by commas [default: all]
    #[arg(long, value_name = "NAMES", value_delimiter = ',', conflicts_with = "detector")]
    only: Vec<String>,
    /// Combine each detector with every descriptor, not only with its usual one
    #[arg(long, conflicts_with = "descriptor")]
    every_descriptor: bool,
    #[command(flatten)]
    features: FeatureArguments,
    /// Write the table as JSON
    #[arg(long, value_name = "OUT.json")]
    json: Option<PathBuf>,
}

/// Two pictures with the known homography between them.
struct KnownPair {
    name: String,
    pictures: [GrayImage; 2],
    homography: Homography,
}

struct Row {
    pair: String,
    settings: FeatureSettings,
    score: DetectorScore,
    /// Time to detect and describe both pictures, milliseconds.
    features_ms: f64,
}

/// Size of the painted backdrop, pixels: a webcam's. Raised, the table takes longer.
const BACKDROP: (u32, u32) = (640, 480);

/// Runs the command.
///
/// # Errors
/// Bad usage, an unreadable picture or homography, an output that cannot be written, an interrupt.
pub(super) fn run(arguments: &DetectorsArguments) -> Result<(), Failure> {
    let mut spared =
        Spared::default().with_files(&arguments.images, "one of the pictures").with_files(&arguments.homography, "a homography");
    spared.claim_whole_files(&[("--json", &arguments.json)])?;
    let chosen = chosen_detectors(arguments)?;
    let pairs = pairs(arguments)?;
    let options = CompareOptions { matching: arguments.features.matching()?, ..CompareOptions::default() };
    interrupt::watch();
    let progress = Progress::with(Some((pairs.len() * chosen.len()) as u64), ["{bar:32} {pos}/{len}, {eta} left", "{spinner} {pos}"]);
    let mut rows = Vec::new();
    for pair in &pairs {
        for settings in &chosen {
            let interrupted = || Failure::Comparison("interrupted; nothing is written".to_owned());
            rows.push(measured(pair, settings, &options).ok_or_else(interrupted)?);
            progress.advance();
        }
    }
    progress.finish();
    print(printable_lines(&(table(&rows) + &overview(&rows, &chosen))).as_bytes())?;
    if let Some(file) = &arguments.json {
        write_whole(file, text(&rows))?;
    }
    Ok(())
}

/// Returns the detectors for the table, each with its usual descriptor, the requested one, or every
/// one.
fn chosen_detectors(arguments: &DetectorsArguments) -> Result<Vec<FeatureSettings>, Failure> {
    let kinds = DetectorKind::ALL.map(|(name, _)| name);
    if let Some(unknown) = arguments.only.iter().find(|name| !kinds.contains(&name.as_str())) {
        return Err(Failure::Usage(format!("--only {unknown}: there is no such detector; give one of {}", kinds.join(", "))));
    }
    let only: Vec<&String> = arguments.only.iter().chain(&arguments.features.detector).collect();
    let wanted = DetectorKind::ALL.into_iter().filter(|(name, _)| only.is_empty() || only.iter().any(|o| o == name));
    let mut chosen = Vec::new();
    for (_, kind) in wanted {
        let settings = arguments.features.settings_of(kind)?;
        match arguments.every_descriptor {
            true => chosen.extend(DescriptorKind::ALL.map(|(_, descriptor)| FeatureSettings { descriptor, ..settings })),
            false => chosen.push(settings),
        }
    }
    Ok(chosen)
}

fn pairs(arguments: &DetectorsArguments) -> Result<Vec<KnownPair>, Failure> {
    let pictures = arguments.images.iter().map(|file| Ok(read_picture(file)?.picture)).collect::<Result<Vec<_>, Failure>>()?;
    let name = |k: usize| arguments.images[k].file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    if !arguments.homography.is_empty() {
        if arguments.homography.len() + 1 != pictures.len() {
            return Err(Failure::Usage(format!(
                "there are {} pictures and {} homographies; give one --homography for each picture after the first",
                pictures.len(),
                arguments.homography.len()
            )));
        }
        let given = arguments.homography.iter().enumerate().map(|(k, file)| {
            let homography = read_homography(file)?;
            let pictures = [pictures[0].clone(), pictures[k + 1].clone()];
            Ok(KnownPair { name: format!("{} {}", name(0), name(k + 1)), pictures, homography })
        });
        return given.collect();
    }
    let sources: Vec<(String, GrayImage)> = if pictures.is_empty() {
        vec![("backdrop".to_owned(), simulate::grey(&simulate::paint(BACKDROP.0, BACKDROP.1, 1)))]
    } else {
        pictures.into_iter().enumerate().map(|(k, picture)| (name(k), picture)).collect()
    };
    let views = |(name, picture): &(String, GrayImage)| -> Vec<KnownPair> {
        let of = |(k, (words, change)): (usize, &(&str, _))| {
            let (view, homography) = changed(picture, *change, k as u64);
            KnownPair { name: format!("{name}, {words}"), pictures: [picture.clone(), view], homography }
        };
        CHANGES.iter().enumerate().map(of).collect()
    };
    Ok(sources.iter().flat_map(views).collect())
}

/// Maximum size of a homography file, bytes. Raised, a wrong file is read further before it is
/// refused.
const MAX_HOMOGRAPHY: u64 = 1 << 12;

fn read_homography(file: &std::path::Path) -> Result<Homography, Failure> {
    let wrong = |why: &str| Failure::Usage(format!("{}: {why}; give nine numbers, row by row", file.display()));
    let bytes = safe_file::read(file, MAX_HOMOGRAPHY).map_err(|e| wrong(&format!("cannot be read ({e})")))?;
    let text = String::from_utf8(bytes).map_err(|_| wrong("is not text"))?;
    let numbers = text.split_whitespace().map(str::parse).collect::<Result<Vec<f64>, _>>().map_err(|_| wrong("has more than numbers"))?;
    if numbers.len() != 9 || !numbers.iter().all(|v| v.is_finite()) {
        return Err(wrong(&format!("has {} numbers", numbers.len())));
    }
    let matrix = Matrix3::from_row_slice(&numbers);
    if matrix.determinant().abs() < 1e-12 * matrix.norm().powi(3) || matrix[(2, 2)] == 0.0 {
        return Err(wrong("maps the picture to a line"));
    }
    Ok(Homography(matrix / matrix[(2, 2)]))
}

/// Measures one pair with one detector; `None` after Ctrl-C.
fn measured(pair: &KnownPair, settings: &FeatureSettings, options: &CompareOptions) -> Option<Row> {
    let begun = Instant::now();
    let found = |picture| extract_watched(picture, settings, &|_| !interrupt::is_interrupted());
    let features = [found(&pair.pictures[0])?, found(&pair.pictures[1])?];
    let features_ms = begun.elapsed().as_secs_f64() * 1e3;
    let sizes = pair.pictures.each_ref().map(|picture| picture.dimensions());
    let score = score([&features[0], &features[1]], sizes, &pair.homography, options);
    Some(Row { pair: pair.name.clone(), settings: *settings, score, features_ms })
}

fn table(rows: &[Row]) -> String {
    let mut text = String::new();
    let mut last = "";
    for row in rows {
        if row.pair != last {
            last = &row.pair;
            // Writing to a String cannot fail.
            let _ = writeln!(
                text,
                "{}{}\n{:<16}{:<18}{:>10}{:>10}{:>12}{:>10}{:>8}{:>12}{:>10}",
                if text.is_empty() { "" } else { "\n" },
                row.pair,
                "detector",
                "descriptor",
                "keypoints",
                "repeat %",
                "place px",
                "matches",
                "right %",
                "corners px",
                "ms"
            );
        }
        let DetectorScore { keypoints, repeated, matches, right, corner_error_px } = &row.score;
        let number = |value: Option<f64>| value.map_or("-".to_owned(), |v| format!("{v:.2}"));
        let _ = writeln!(
            text,
            "{:<16}{:<18}{:>10}{:>10.1}{:>12}{matches:>10}{:>8.1}{:>12}{:>10.0}",
            row.settings.detector.name(),
            row.settings.descriptor.name(),
            keypoints[0].min(keypoints[1]),
            100.0 * repeated.share,
            number(repeated.error_px),
            100.0 * right,
            number(*corner_error_px),
            row.features_ms
        );
    }
    text
}

/// Maximum corner error of a homography that counts as found, pixels: the contract's limit for
/// steep views. Raised, worse ones count.
const FOUND_PX: f64 = 5.0;

/// Returns the means over all pairs and how many pairs were related. Sorted by pairs related, then
/// by correct matches per unit of time.
fn overview(rows: &[Row], chosen: &[FeatureSettings]) -> String {
    let pairs = rows.len() / chosen.len().max(1);
    if pairs < 2 {
        return String::new();
    }
    let mut lines: Vec<(usize, f64, String)> = Vec::new();
    for settings in chosen {
        let own: Vec<&Row> = rows.iter().filter(|row| row.settings == *settings).collect();
        let mean = |of: &dyn Fn(&Row) -> Option<f64>| {
            let values: Vec<f64> = own.iter().filter_map(|row| of(row)).collect();
            values.iter().sum::<f64>() / values.len() as f64
        };
        let found = own.iter().filter(|row| row.score.corner_error_px.is_some_and(|e| e <= FOUND_PX)).count();
        let ms = mean(&|row| Some(row.features_ms));
        let right_per_ms = mean(&|row| Some(row.score.matches as f64 * row.score.right)) / ms;
        let line = format!(
            "{:<16}{:<18}{:>10}{:>10.1}{:>12.2}{:>10}{:>8.1}{:>12}{ms:>10.0}\n",
            settings.detector.name(),
            settings.descriptor.name(),
            mean(&|row| Some(row.score.keypoints[0].min(row.score.keypoints[1]) as f64)).round(),
            100.0 * mean(&|row| Some(row.score.repeated.share)),
            mean(&|row| row.score.repeated.error_px),
            mean(&|row| Some(row.score.matches as f64)).round(),
            100.0 * mean(&|row| Some(row.score.right)),
            format!("{found} of {pairs}"),
        );
        lines.push((found, right_per_ms, line));
    }
    lines.sort_by(|a, b| b.0.cmp(&a.0).then(b.1.total_cmp(&a.1)));
    let words = ["detector", "descriptor", "keypoints", "repeat %", "place px", "matches", "right %", "related", "ms"];
    let mut text = format!("\nall pairs (means; related: to {FOUND_PX} px at the corners)\n");
    for (k, word) in words.iter().enumerate() {
        let width = [16, 18, 10, 10, 12, 10, 8, 12, 10][k];
        text += &if k < 2 { format!("{word:<width$}") } else { format!("{word:>width$}") };
    }
    lines.into_iter().fold(text + "\n", |text, (.., line)| text + &line)
}

fn text(rows: &[Row]) -> String {
    let row = |row: &Row| {
        let DetectorScore { keypoints, repeated, matches, right, corner_error_px } = &row.score;
        json!({
            "pair": row.pair, "detector": row.settings.detector.name(), "descriptor": row.settings.descriptor.name(),
            "keypoints": keypoints, "repeatability": repeated.share, "localisation_error_px": repeated.error_px,
            "matches": matches, "right": right, "corner_error_px": corner_error_px, "features_ms": row.features_ms,
        })
    };
    format!("{:#}\n", json!(rows.iter().map(row).collect::<Vec<_>>()))
}
