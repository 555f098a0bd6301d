//! The delay of a camera's stamps from the times that its frames show.
//!
//! A frame that sees the code change says exactly when it was exposed. One that sees a single code
//! only says within which refreshes. So delay, drift and the exposure time are fitted to the former
//! by least squares, with Tukey's weights; the latter show which frames are not the picture that
//! their stamp says. Where too few frames see a change, as with very short exposures, the middle of
//! what is possible is used, and the spread is known less well.

use nalgebra::{Matrix3, Vector3};

use super::layout::PERIOD_MS;
use super::read::Reading;
use crate::geometry::robust_kernel::{median, tukey_weight};

/// Minimum number of frames that show the code. Lowered, a glimpse of the screen is enough.
pub const MIN_LOOKS: usize = 24;
/// Minimum number of frames that see a change. Lowered, a few frames decide about the spread.
const MIN_EXACT: usize = 12;
/// Minimum scatter for robust weights, milliseconds: that of the code's whole milliseconds and of
/// the shares read. Raised, late frames count.
const MIN_SCATTER_MS: f64 = 0.5;
/// Residual in scatters beyond which a frame is no member of the others. Raised, late frames pass.
const OUTLIER_SCATTERS: f64 = 5.0;
/// Minimum excess over the possible times, milliseconds, of a frame that counts as late. Raised,
/// repeated frames of fast cameras go unmentioned.
const MIN_LATE_MS: f64 = 4.0;
/// Relative prior sigma of the exposure time guessed from how many frames see a change. Raised, few
/// frames determine it by chance.
const GUESSED_EXPOSURE_SIGMA: f64 = 0.5;
/// Share of the exposure within which a change is seen (`read`'s certainty).
const SEEN_SHARE: f64 = 0.76;
/// Maximum deviation of the step between the two codes of a frame from the time for which most are
/// shown, as a share of it. Raised, misread frames count; lowered, screens that refresh unevenly
/// are not measured.
const MAX_HOLD_DEVIATION: f64 = 0.4;
/// Reweightings of the fit. Raised, no effect.
const REWEIGHTINGS: usize = 8;

/// A frame that shows the code.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Look {
    /// When the code's rows were exposed by the frame's stamp, seconds on the screen's clock.
    pub stamp_s: f64,
    /// The time that it shows.
    pub reading: Reading,
}

/// How late stamps are after the exposure that they stand for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lateness {
    /// Mean delay of the stamps, seconds, with the screen's own lag.
    pub delay_s: f64,
    /// One sigma of it, without that of the screen's lag.
    pub sigma_s: f64,
    /// Standard deviation of single stamps around the mean, seconds.
    pub spread_s: f64,
    /// Change of the delay, seconds per second, with its sigma.
    pub drift: [f64; 2],
    /// Frames that show the code, and those of them that saw it change.
    pub looks: usize,
    pub changes: usize,
    /// Frames that show another time than their stamps say: repeated, held back, or stamped late.
    pub late: usize,
    /// Time for which the screen shows a code, seconds.
    pub hold_s: f64,
}

/// The frames' times by the code, in milliseconds.
struct Times {
    /// Seconds after the middle of the stamps; stamp minus code; and the share after the change: of
    /// frames that saw one.
    exact: Vec<[f64; 3]>,
    /// The same without a share, of the others.
    vague: Vec<[f64; 2]>,
    hold_ms: f64,
}

/// A line through the delays: its value at the middle, its slope per second, and the exposure.
#[derive(Debug, Clone, Copy)]
struct Line {
    at: [f64; 3],
    covariance: Matrix3<f64>,
    scatter_ms: f64,
}

impl Times {
    fn of(looks: &[Look]) -> Option<Self> {
        let (first, last) = (looks.first()?.stamp_s, looks.last()?.stamp_s);
        let middle_s = 0.5 * (first + last);
        // The code begins again after three days; a clip is shorter.
        let period = f64::from(PERIOD_MS);
        let near = |delay: f64, reference: f64| delay - period * ((delay - reference) / period).round();
        let behind = |look: &Look, code_ms: u32| 1e3 * look.stamp_s - f64::from(code_ms);
        let reference = near(behind(looks.first()?, looks.first()?.reading.shown_ms), 0.0);
        let behind = |look: &Look, code_ms: u32| near(behind(look, code_ms), reference);
        let hold_ms = hold_ms(looks)?;
        let (mut exact, mut vague) = (Vec::new(), Vec::new());
        for look in looks {
            let since_s = look.stamp_s - middle_s;
            match look.reading.change {
                None => vague.push([since_s, behind(look, look.reading.shown_ms)]),
                Some((second, share)) if (step_ms(look.reading.shown_ms, second) - hold_ms).abs() < MAX_HOLD_DEVIATION * hold_ms => {
                    exact.push([since_s, behind(look, second), share]);
                }
                // Three codes in one exposure, taken for two.
                Some(_) => {}
            }
        }
        Some(Self { exact, vague, hold_ms })
    }

    /// Fits delay, slope and exposure to the frames that saw a change.
    fn fit_changes(&self, exposure_ms: Option<f64>) -> Option<Line> {
        let guessed = self.hold_ms * self.exact.len() as f64 / (self.exact.len() + self.vague.len()) as f64 / SEEN_SHARE;
        let (mean, sigma) = exposure_ms.map_or((guessed, GUESSED_EXPOSURE_SIGMA * guessed), |known| (known, 0.02 * known + 0.05));
        let rows = self.exact.iter().map(|[since_s, delay_ms, share]| (Vector3::new(1.0, *since_s, share - 0.5), *delay_ms));
        fit(&rows.collect::<Vec<_>>(), [mean, sigma])
    }

    /// Fits delay and slope to the middles of what is possible.
    fn fit_middles(&self) -> Option<Line> {
        let middles = self.vague.iter().map(|[since_s, delay_ms]| [*since_s, delay_ms - 0.5 * self.hold_ms]);
        let rows = middles.chain(self.exact.iter().map(|[since_s, delay_ms, _]| [*since_s, *delay_ms]));
        fit(&rows.map(|[since_s, delay_ms]| (Vector3::new(1.0, since_s, 0.0), delay_ms)).collect::<Vec<_>>(), [0.0, 1.0])
    }

    /// Counts the frames that were exposed at another time than their stamps say.
    fn late(&self, line: &Line) -> usize {
        let [delay, slope, exposure] = line.at;
        let tolerance = MIN_LATE_MS.max(OUTLIER_SCATTERS * line.scatter_ms);
        let exact = self
            .exact
            .iter()
            .filter(|[since_s, seen, share]| (seen - delay - slope * since_s - exposure * (share - 0.5)).abs() > tolerance);
        let vague = self.vague.iter().filter(|[since_s, seen]| {
            let after = seen - delay - slope * since_s;
            after < -tolerance || after > self.hold_ms + tolerance
        });
        exact.count() + vague.count()
    }
}

fn step_ms(from: u32, to: u32) -> f64 {
    f64::from(to.wrapping_sub(from) % PERIOD_MS)
}

/// Returns the time for which the screen shows a code; `None` if it never changes.
fn hold_ms(looks: &[Look]) -> Option<f64> {
    let seen = looks.iter().filter_map(|look| look.reading.change.map(|(second, _)| step_ms(look.reading.shown_ms, second)));
    let mut steps: Vec<f64> = seen.collect();
    if steps.len() < MIN_EXACT {
        let between = looks.windows(2).map(|pair| step_ms(pair[0].reading.shown_ms, pair[1].reading.shown_ms));
        steps = between.filter(|step| *step > 0.0).collect();
    }
    steps.sort_by(f64::total_cmp);
    // A slow camera misses codes, so the shorter steps count.
    steps.get(steps.len() / 3).copied()
}

/// Fits a line by least squares with Tukey's weights. `exposure`: its prior mean and sigma.
fn fit(rows: &[(Vector3<f64>, f64)], [mean, sigma]: [f64; 2]) -> Option<Line> {
    let median = |mut values: Vec<f64>| median(&mut values);
    let mut at = Vector3::new(median(rows.iter().map(|row| row.1).collect())?, 0.0, mean);
    let mut line = None;
    for _ in 0..REWEIGHTINGS {
        let residuals: Vec<f64> = rows.iter().map(|(by, seen)| seen - by.dot(&at)).collect();
        let scatter_ms = (1.4826 * median(residuals.iter().map(|r| r.abs()).collect())?).max(MIN_SCATTER_MS);
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for ((by, seen), residual) in rows.iter().zip(&residuals) {
            let weight = tukey_weight(residual.powi(2), scatter_ms);
            normal += by * by.transpose() * weight;
            right += by * (weight * seen);
        }
        let prior = (scatter_ms / sigma.max(1e-3)).powi(2);
        normal[(2, 2)] += prior;
        right[2] += prior * mean;
        let inverse = normal.cholesky()?.inverse();
        at = inverse * right;
        let kept: Vec<f64> = rows.iter().map(|(by, seen)| seen - by.dot(&at)).filter(|r| r.abs() < OUTLIER_SCATTERS * scatter_ms).collect();
        let scatter_ms = (kept.iter().map(|r| r * r).sum::<f64>() / kept.len().saturating_sub(3).max(1) as f64).sqrt();
        line = Some(Line { at: at.into(), covariance: inverse * scatter_ms.powi(2), scatter_ms });
    }
    line.filter(|line| line.at.iter().all(|v| v.is_finite()))
}

/// Returns how late the stamps of these frames, in their order, are. `exposure_s`: the exposure
/// time if it is known, seconds. `None` for too few frames, or where the code never changes.
pub fn measure_lateness(looks: &[Look], exposure_s: Option<f64>) -> Option<Lateness> {
    if looks.len() < MIN_LOOKS {
        return None;
    }
    let times = Times::of(looks)?;
    let line = if times.exact.len() >= MIN_EXACT { times.fit_changes(exposure_s.map(|s| 1e3 * s))? } else { times.fit_middles()? };
    let is_exact = times.exact.len() >= MIN_EXACT;
    // A middle is off by up to half of the time for which a code is shown.
    let by_middles = if is_exact { 0.0 } else { times.hold_ms.powi(2) / 12.0 };
    let spread_ms = (line.scatter_ms.powi(2) - by_middles).max(0.0).sqrt();
    Some(Lateness {
        delay_s: 1e-3 * line.at[0],
        sigma_s: 1e-3 * line.covariance[(0, 0)].max(0.0).sqrt(),
        spread_s: 1e-3 * spread_ms,
        drift: [1e-3 * line.at[1], 1e-3 * line.covariance[(1, 1)].max(0.0).sqrt()],
        looks: looks.len(),
        changes: times.exact.len(),
        late: times.late(&line),
        hold_s: 1e-3 * times.hold_ms,
    })
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    /// A camera that films a screen.
    struct Filmed {
        fps: f64,
        exposure_s: f64,
        /// Time for which the screen shows a code.
        hold_s: f64,
        late_s: f64,
        jitter_s: f64,
        drift: f64,
        /// The device repeats the previous picture once in so many frames; 0: never.
        repeats_every: usize,
    }

    impl Filmed {
        const USUAL: Self = Self { fps: 30.0, exposure_s: 0.01, hold_s: 0.05, late_s: 0.041, jitter_s: 0.0, drift: 0.0, repeats_every: 0 };

        /// Returns what a minute of frames shows. The screen's refreshes are not in step with the
        /// camera: 59.94 and 30 per second.
        fn looks(&self, seconds: f64, seed: u64) -> Vec<Look> {
            let mut random = Pcg64Mcg::seed_from_u64(seed);
            let begin_s = 1_790_000_000.0;
            let hold_s = self.hold_s * 60.0 / 59.94;
            let frame = |k: usize, random: &mut Pcg64Mcg| {
                let shown = if self.repeats_every > 0 && k % self.repeats_every == self.repeats_every - 1 { k - 1 } else { k };
                let middle_s = shown as f64 / self.fps + 0.003;
                let stamped_s = k as f64 / self.fps + 0.003;
                let [from, to] = [middle_s - 0.5 * self.exposure_s, middle_s + 0.5 * self.exposure_s].map(|s| (s / hold_s).floor());
                let code = |n: f64| ((begin_s + n * hold_s) * 1e3).round().rem_euclid(f64::from(PERIOD_MS)) as u32;
                let share = (middle_s + 0.5 * self.exposure_s - to * hold_s) / self.exposure_s;
                let noise: f64 = (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
                let is_change = from < to && (0.12..0.88).contains(&share);
                let single = if share < 0.5 { from } else { to };
                let reading = Reading {
                    shown_ms: code(if is_change { from } else { single }),
                    change: is_change.then(|| (code(to), share)),
                    row_px: 0.0,
                };
                Look { stamp_s: begin_s + stamped_s + self.late_s + self.drift * stamped_s + self.jitter_s * noise, reading }
            };
            (1..(seconds * self.fps) as usize).map(|k| frame(k, &mut random)).collect()
        }

        fn check(&self, known: bool, seed: u64) -> Lateness {
            let looks = self.looks(40.0, seed);
            let found = measure_lateness(&looks, known.then_some(self.exposure_s)).expect("a delay");
            let middle_s = self.late_s + 20.0 * self.drift;
            assert!((found.delay_s - middle_s).abs() < 0.001, "{found:?}");
            assert!((found.spread_s - self.jitter_s).abs() < 0.001, "{found:?}");
            assert!((found.drift[0] - self.drift).abs() * 60.0 < 0.001, "{found:?}");
            found
        }
    }

    #[test]
    fn delay_spread_and_drift_are_right_to_a_millisecond() {
        let usual = Filmed::USUAL;
        for (k, filmed) in [
            Filmed { ..usual },
            Filmed { jitter_s: 0.002, ..usual },
            Filmed { jitter_s: 0.005, drift: 1e-4, late_s: 0.0073, ..usual },
            Filmed { exposure_s: 0.004, late_s: 0.118, jitter_s: 0.001, ..usual },
            Filmed { exposure_s: 0.03, fps: 25.0, hold_s: 1.0 / 20.0, ..usual },
            Filmed { exposure_s: 0.002, hold_s: 1.0 / 60.0, fps: 59.0, ..usual },
        ]
        .into_iter()
        .enumerate()
        {
            for known in [true, false] {
                let found = filmed.check(known, k as u64);
                assert_eq!(found.late, 0, "{k} {known}: {found:?}");
            }
        }
    }

    #[test]
    fn repeated_frames_are_counted_and_do_not_pull_the_delay() {
        let found = Filmed { repeats_every: 20, ..Filmed::USUAL }.check(false, 1);
        // 60 of 1200; where two frames see the same code, the second is no contradiction.
        assert!((15..=60).contains(&found.late), "{found:?}");
    }

    #[test]
    fn sigmas_are_honest() {
        let filmed = Filmed { jitter_s: 0.003, ..Filmed::USUAL };
        let squared: f64 = (0..40)
            .map(|seed| {
                let found = measure_lateness(&filmed.looks(20.0, seed), None).unwrap();
                ((found.delay_s - filmed.late_s) / found.sigma_s).powi(2)
            })
            .sum::<f64>()
            / 40.0;
        assert!((0.3..2.5).contains(&squared), "{squared}");
    }

    #[test]
    fn short_exposures_are_measured_by_middles() {
        let filmed = Filmed { exposure_s: 0.0002, jitter_s: 0.001, ..Filmed::USUAL };
        let found = measure_lateness(&filmed.looks(40.0, 3), None).unwrap();
        assert!(found.changes < 12 && (found.delay_s - filmed.late_s).abs() < 0.002, "{found:?}");
    }

    #[test]
    fn too_little_is_no_delay() {
        let looks = Filmed::USUAL.looks(40.0, 1);
        assert!(measure_lateness(&looks[..MIN_LOOKS - 1], None).is_none());
        let still = vec![Look { stamp_s: 1.0, reading: Reading { shown_ms: 5, change: None, row_px: 0.0 } }; 50];
        assert!(measure_lateness(&still, None).is_none(), "a screen that stands still");
        assert!(measure_lateness(&[], None).is_none());
    }

    #[test]
    fn the_code_may_begin_again_within_a_clip() {
        let mut looks = Filmed::USUAL.looks(10.0, 1);
        let shift = PERIOD_MS - looks[100].reading.shown_ms;
        for look in &mut looks {
            let moved = |code: u32| (code + shift) % PERIOD_MS;
            look.reading.shown_ms = moved(look.reading.shown_ms);
            look.reading.change = look.reading.change.map(|(second, share)| (moved(second), share));
        }
        let found = measure_lateness(&looks, None).unwrap();
        assert!(found.spread_s < 0.001 && found.late == 0, "{found:?}");
    }
}
