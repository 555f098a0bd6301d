//! The delay between two cameras: a search over all shifts, then the most likely one.

use nalgebra::UnitQuaternion;
use thiserror::Error;

use super::lagged::{Lagged, Window};
use super::regression::Regression;
use super::turns::{Turn, Turns};

/// Minimum number of intervals that both cameras have at a shift. Lowered, the
/// nine numbers of the matrix fit the noise.
const MIN_ROWS: usize = 24;
/// Minimum share of the motion, as a sum of squared rotations, that both cameras have at a shift,
/// relative to the shift with the most. Lowered, a shift is believed for the sake of a moment of
/// motion at the end of a clip.
const MIN_MOTION: f64 = 0.2;
/// Time for which a camera must turn fast, seconds, and the least rate, radians per second. Chosen:
/// at 5 degrees per second a millisecond is 0.005 degrees, as much as the error of a lens or a
/// moving actor adds within a second. Raised, slower pans are refused; lowered, the tracker's own
/// errors are taken for motion.
const FAST_FOR_S: f64 = 1.0;
const MIN_RATE: f64 = 5.0 * std::f64::consts::PI / 180.0;
/// Step between the shifts that are tried: as a share of the frame interval, and its minimum in
/// seconds. Pans and shake vary over tenths of a second. Raised, the best shift is missed.
const STEP_SHARE: f64 = 0.25;
const MIN_STEP_S: f64 = 0.005;
/// Half of the window in which the best shift is searched, in steps.
const WINDOW_STEPS: f64 = 2.0;
/// Unexplained share of the rotation above which the cameras do not turn together. Chosen: half.
/// Raised, other motions pass for the same.
const MAX_UNEXPLAINED: f64 = 0.5;
/// Distance from the best shift, in steps, within which a minimum is the same one.
const SAME_STEPS: f64 = 4.0;
/// Maximum number of other shifts that are refined and reported.
const MAX_RIVALS: usize = 8;
/// One of the two cameras.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// The first, whose stamps are the reference.
    First,
    /// The second, whose delay is measured.
    Second,
}

/// Why there is no delay.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum Undetermined {
    /// A camera has no rotations.
    #[error("{} camera has no rotation between successive frames", .0.words())]
    Nothing(Side),
    /// The stamps do not overlap, not even after the largest shift; seconds of begin and end.
    #[error("the clips do not overlap: the first spans {:.3} to {:.3} s, the second {:.3} to {:.3} s", first[0], first[1], second[0], second[1])]
    Apart {
        /// The first camera's.
        first: [f64; 2],
        /// The second camera's.
        second: [f64; 2],
    },
    /// The clips overlap too little, or are too short.
    #[error("the cameras have {found} frame intervals in common, {MIN_ROWS} are needed")]
    TooFew {
        /// The most at any shift.
        found: usize,
    },
    /// A camera turned too slowly.
    #[error("{} camera turned at no more than {deg_per_s:.1} degrees per second, or for less than a second", side.words())]
    TooSlow {
        /// Which.
        side: Side,
        /// The rate that it reached for a second, degrees per second.
        deg_per_s: f64,
    },
    /// No shift makes the rotations agree.
    #[error("the cameras do not turn together: at the best shift, {:.0} % of the rotation stays unexplained", unexplained * 100.0)]
    Unlike {
        /// Unexplained share of the rotation.
        unexplained: f64,
    },
    /// The best shift is the largest that was tried.
    #[error("the best shift is the largest that was tried, {:+.3} s", .0)]
    AtTheEnd(f64),
}

impl Side {
    /// Names it in a sentence.
    pub fn words(self) -> &'static str {
        match self {
            Self::First => "the first",
            Self::Second => "the second",
        }
    }
}

/// Another shift at which the cameras agree, as after a period of a periodic motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rival {
    /// The delay there, seconds.
    pub delay_s: f64,
    /// How many times more rotation stays unexplained there.
    pub factor: f64,
}

/// The measured delay.
#[derive(Debug, Clone, PartialEq)]
pub struct Delay {
    /// How much later the second camera's stamps are than the first's, seconds.
    pub delay_s: f64,
    /// One sigma, seconds.
    pub sigma_s: f64,
    /// Share of the rotation, as a sum of squares, that stays unexplained.
    pub unexplained: f64,
    /// The second camera's turn rate over the first's.
    pub gain: f64,
    /// Rotation from the second camera's axes to the first's; `None` if the rig turned about one
    /// axis only.
    pub rotation: Option<UnitQuaternion<f64>>,
    /// Number of frame intervals used.
    pub used: usize,
    /// Number of frame intervals left out, because they contradict the others.
    pub left_out: usize,
    /// Time that they span, seconds.
    pub span_s: f64,
    /// Turn rates that the first and the second camera reach for a second, radians per second.
    pub rates: [f64; 2],
    /// Delay in the second half minus that in the first, and its sigma, seconds; `None` if the
    /// halves by themselves are too short.
    pub drift_s: Option<[f64; 2]>,
    /// Other shifts, best first.
    pub rivals: Vec<Rival>,
}

/// Measures how much later the second camera's stamps are, within `range_s` to either side.
///
/// # Errors
/// When the rotations do not determine it, with what is missing.
pub fn measure_delay(first: &Turns, second: &Turns, range_s: f64) -> Result<Delay, Undetermined> {
    let rates = rates_of(first, second, range_s)?;
    // The camera with more frames is interpolated, and compared over the other's intervals.
    let is_swapped = first.typical_s() > second.typical_s();
    let mut lagged = if is_swapped { Lagged::new(first, second) } else { Lagged::new(second, first) };
    let sign = if is_swapped { -1.0 } else { 1.0 };
    let found = search(&lagged, range_s)?;
    let window = Window { center_s: found.lag_s, margin_s: found.step_s * WINDOW_STEPS };
    let (lag_s, least) = lagged.least_unexplained(window);
    if least > MAX_UNEXPLAINED {
        return Err(Undetermined::Unlike { unexplained: least });
    }
    if found.lag_s.abs() > range_s - found.step_s {
        return Err(Undetermined::AtTheEnd(sign * found.lag_s));
    }
    let left_out = leave_outliers(&mut lagged, lag_s, window);
    let rivals = rivals(&lagged, &found, window, least, sign);
    let fit = lagged.fit(window);
    let rows = lagged.rows(fit.lag_s, Window { center_s: fit.lag_s, margin_s: 0.0 });
    let ends = rows.first().zip(rows.last()).map_or([0.0; 2], |(a, b)| [a.middle_s, b.middle_s]);
    let (gain, rotation) = (fit.regression.gain(), fit.regression.rotation());
    Ok(Delay {
        delay_s: sign * fit.lag_s,
        sigma_s: fit.regression.sigma_s(),
        unexplained: fit.regression.unexplained(),
        gain: if is_swapped { 1.0 / gain } else { gain },
        rotation: if is_swapped { rotation } else { rotation.map(|r| r.inverse()) },
        used: rows.len(),
        left_out,
        span_s: ends[1] - ends[0],
        rates,
        drift_s: drift(&lagged, window, 0.5 * (ends[0] + ends[1])).map(|[drift, sigma]| [sign * drift, sigma]),
        rivals,
    })
}

/// Returns the rates that both cameras reach, if they overlap and turn fast enough.
fn rates_of(first: &Turns, second: &Turns, range_s: f64) -> Result<[f64; 2], Undetermined> {
    let span = |turns: &Turns, side| turns.span_s().ok_or(Undetermined::Nothing(side));
    let spans = [span(first, Side::First)?, span(second, Side::Second)?];
    if spans[0][1] + range_s <= spans[1][0] || spans[1][1] + range_s <= spans[0][0] {
        return Err(Undetermined::Apart { first: spans[0], second: spans[1] });
    }
    let rates = [fast_rate(first.as_slice()), fast_rate(second.as_slice())];
    let slow = rates.into_iter().zip([Side::First, Side::Second]).find(|(rate, _)| *rate < MIN_RATE);
    slow.map_or(Ok(rates), |(rate, side)| Err(Undetermined::TooSlow { side, deg_per_s: rate.to_degrees() }))
}

/// Returns the other shifts at which the cameras agree, best first; `least` stays unexplained at
/// the best one.
fn rivals(lagged: &Lagged<'_>, found: &Found, window: Window, least: f64, sign: f64) -> Vec<Rival> {
    let refined = found.rivals.iter().map(|lag_s| lagged.least_unexplained(Window { center_s: *lag_s, ..window }));
    let alike = refined.filter(|(_, unexplained)| *unexplained < MAX_UNEXPLAINED);
    let mut rivals: Vec<Rival> =
        alike.map(|(lag_s, left)| Rival { delay_s: sign * lag_s, factor: left / least.max(f64::MIN_POSITIVE) }).collect();
    rivals.sort_by(|a, b| a.factor.total_cmp(&b.factor));
    // Neighbouring minima may have become one.
    let mut taken: Vec<f64> = Vec::new();
    rivals.retain(|rival| {
        let is_new = taken.iter().all(|other| (other - rival.delay_s).abs() > found.step_s);
        taken.push(rival.delay_s);
        is_new
    });
    rivals
}

/// Returns the turn rate that is reached or exceeded for [`FAST_FOR_S`] altogether, radians per
/// second; 0 if all of it is shorter.
fn fast_rate(turns: &[Turn]) -> f64 {
    let mut fastest: Vec<&Turn> = turns.iter().collect();
    fastest.sort_by(|a, b| b.rate().total_cmp(&a.rate()));
    let mut time_s = 0.0;
    let reached = fastest.into_iter().find(|turn| {
        time_s += turn.duration_s();
        // A sum of frame intervals may miss the second by rounding.
        time_s >= FAST_FOR_S - 1e-6
    });
    reached.map_or(0.0, Turn::rate)
}

/// The result of the search over all shifts.
struct Found {
    lag_s: f64,
    step_s: f64,
    /// Other shifts at which the cameras agree better than around them.
    rivals: Vec<f64>,
}

/// One shift that was tried.
#[derive(Clone, Copy)]
struct Tried {
    lag_s: f64,
    unexplained: f64,
    rows: usize,
    /// Sum of squared rotations.
    motion: f64,
}

impl Tried {
    /// Logarithm of the likelihood ratio to no agreement at all: more intervals count more.
    fn evidence(&self) -> f64 {
        -(self.rows as f64) * self.unexplained.max(1e-12).ln()
    }
}

fn search(lagged: &Lagged<'_>, range_s: f64) -> Result<Found, Undetermined> {
    let step_s = (lagged.turns.typical_s() * STEP_SHARE).max(MIN_STEP_S).min(0.25 * range_s);
    let steps = (range_s / step_s).floor() as i64;
    let tried: Vec<Tried> = (-steps..=steps)
        .map(|k| {
            let lag_s = k as f64 * step_s;
            let rows = lagged.rows(lag_s, Window { center_s: lag_s, margin_s: 0.0 });
            let motion = rows.iter().map(|row| row.wanted.norm_squared()).sum();
            let unexplained = Regression::trimmed(&rows).0.unexplained();
            Tried { lag_s, unexplained, rows: rows.len(), motion }
        })
        .collect();
    let most_rows = tried.iter().map(|tried| tried.rows).max().unwrap_or(0);
    let most_motion = tried.iter().map(|tried| tried.motion).fold(0.0, f64::max);
    let counts = |tried: &Tried| tried.rows >= MIN_ROWS && tried.motion >= MIN_MOTION * most_motion;
    let best = tried.iter().filter(|tried| counts(tried)).max_by(|a, b| a.evidence().total_cmp(&b.evidence()));
    let Some(best) = best.copied() else { return Err(Undetermined::TooFew { found: most_rows }) };
    let is_rival = |three: &&[Tried]| {
        let is_least = three[1].unexplained <= three[0].unexplained && three[1].unexplained <= three[2].unexplained;
        is_least && three.iter().all(counts) && (three[1].lag_s - best.lag_s).abs() > SAME_STEPS * step_s
    };
    let mut rivals: Vec<Tried> = tried.windows(3).filter(is_rival).map(|three| three[1]).collect();
    rivals.sort_by(|a, b| a.unexplained.total_cmp(&b.unexplained));
    let rivals = rivals.into_iter().take(MAX_RIVALS).map(|rival| rival.lag_s).collect();
    Ok(Found { lag_s: best.lag_s, step_s, rivals })
}

/// Leaves out intervals that contradict the others at a shift; returns how many.
fn leave_outliers(lagged: &mut Lagged<'_>, lag_s: f64, window: Window) -> usize {
    let (_, far) = Regression::trimmed(&lagged.rows(lag_s, window));
    far.iter().for_each(|row| lagged.kept[row.index] = false);
    far.len()
}

/// Returns the delay in the second half of the time minus that in the first, with its sigma.
fn drift(lagged: &Lagged<'_>, window: Window, middle_s: f64) -> Option<[f64; 2]> {
    let half = |is_later: bool| {
        let half = lagged.only(|time_s| (time_s > middle_s) == is_later);
        let fit = half.fit(window);
        let rows = half.rows(fit.lag_s, window).len();
        let sigma_s = fit.regression.sigma_s();
        (rows >= MIN_ROWS && sigma_s.is_finite()).then_some((fit.lag_s, sigma_s))
    };
    let ((early, early_sigma), (late, late_sigma)) = (half(false)?, half(true)?);
    Some([late - early, early_sigma.hypot(late_sigma)])
}
