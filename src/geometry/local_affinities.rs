//! Finds the affine map of a plane that a few matches among many wrong ones agree with.
//!
//! A described corner has a position, a size and an orientation, so one match alone says how the
//! plane around it is seen. Each match is a complete hypothesis, where a homography sample needs
//! four (Philbin, Chum, Isard, Sivic and Zisserman, "Object retrieval with large vocabularies and
//! fast spatial matching", CVPR 2007, section 5). With five right matches among fifty, no sample of
//! four is likely to be right, but each of the five is. The map is affine: it suits planes that are
//! small relative to their distance, whose perspective a handful of matches does not show.

use nalgebra::{Matrix2, Matrix2x3, Matrix3, Vector2};

use super::homography::{Homography, PointPair};

/// A match with the local affine map of the plane around it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LocalAffinity {
    /// The matched positions.
    pub pair: PointPair,
    /// Derivative of the position in the second plane by that in the first.
    pub derivative: Matrix2<f64>,
    /// Noise of the position in the second plane, one sigma, in its units.
    pub noise: f64,
}

/// Maximum number of matches tried, best first. Raised, the search time grows with the square;
/// lowered, right matches of weak pictures are left out.
const TRIED: usize = 100;
/// Maximum distance of other matches from where one match predicts them: this fraction of their
/// distance from it (corner orientations are accurate to about ten degrees, sizes to a tenth) plus
/// this many sigmas. Raised, wrong matches agree by chance; lowered, right ones do not.
const NEAR_SHARE: f64 = 0.3;
const NEAR_SIGMAS: f64 = 4.0;
/// Maximum difference between the shifts of two matches, as a fraction of the distance between
/// them, since the plane may be rotated or larger than expected. Raised, wrong matches agree by
/// chance; lowered, right ones of a rotated plane do not.
const SHIFT_SHARE: f64 = 0.06;
/// Maximum difference in rotation (tangent of 0.6 radians) and maximum scale factor between
/// agreeing matches. Raised, wrong matches agree by chance; lowered, right ones of tilted planes do
/// not.
const MAX_ROTATION: f64 = 0.684;
const MAX_GROWTH: f64 = 2.0;
/// Noise of a derivative relative to its size, one sigma. It matters only where the positions leave
/// a direction undetermined, e.g. along a line. Raised, derivatives count less.
const DERIVATIVE_NOISE: f64 = 0.3;
/// After the first fit, a match agrees if it is off by at most some sigmas plus this fraction of
/// its distance from the centre. The fraction falls from round to round, so that chance agreements
/// drop out before they pull the map; in the last rounds it is 0. With fewer rounds, wrong matches
/// pull the map.
const SHARES: [f64; 5] = [0.15, 0.07, 0.0, 0.0, 0.0];
/// Number of single-match hypotheses to refine, those with most agreement. Raised, the search takes
/// longer; lowered, a match with an inaccurate orientation may be the only one.
const FITTED: usize = 6;

/// Finds the map, as a homography without perspective, and the ascending indices of the matches
/// that agree with it, at most one per position; `None` if fewer than `least` agree. `matches` must
/// be sorted best first.
pub fn robust_affine(matches: &[LocalAffinity], least: usize) -> Option<(Homography, Vec<usize>)> {
    let matches = &matches[..matches.len().min(TRIED)];
    let mut first: Vec<Vec<usize>> = matches
        .iter()
        .filter_map(|m| agreeing_with_one(matches, m))
        // Distinct positions never outnumber the matches.
        .filter(|a| a.len() >= least)
        .map(|a| distinct(matches, a.into_iter()))
        .filter(|a| a.len() >= least)
        .collect();
    first.sort_by_key(|agreeing| std::cmp::Reverse(agreeing.len()));
    first.dedup();
    let settled = first.into_iter().take(FITTED).filter_map(|agreeing| settled(matches, agreeing, least));
    // On a tie, the first.
    settled.reduce(|best, next| if next.1.len() > best.1.len() { next } else { best })
}

/// Returns the ascending indices of the matches that agree with one match's local map: with the
/// first that more than half of all agree with, else with the one with most agreement. At most one
/// match per position counts, but all are returned; `None` if fewer than `least` agree. Takes a
/// fifth of the time of a homography search. `matches` must be sorted best first.
pub fn most_agreeing(matches: &[LocalAffinity], least: usize) -> Option<Vec<usize>> {
    let matches = &matches[..matches.len().min(TRIED)];
    let (mut best, mut most) = (None, least.saturating_sub(1));
    for agreeing in matches.iter().filter_map(|m| agreeing_with_one(matches, m)) {
        // Distinct positions never outnumber the matches, so most hypotheses need not be counted.
        let places = if agreeing.len() > most { distinct(matches, agreeing.iter().copied()).len() } else { 0 };
        if places > most {
            (best, most) = (Some(agreeing), places);
        }
        if 2 * most > matches.len() {
            break;
        }
    }
    best
}

/// Estimates how far the matches are off their expected positions: the mean over those that agree,
/// and their ascending indices, at most one per position; `None` if fewer than `least` agree.
/// `pair.from` is the expected position and `derivative` that of the actual by the expected
/// position. Matches farther off than `furthest` are ignored.
///
/// If only the plane's position is unknown, a few matches suffice: hardly any wrong match is nearby
/// and equally rotated, and no two wrong ones have the same shift.
pub fn robust_shift(matches: &[LocalAffinity], furthest: f64, least: usize) -> Option<(Vector2<f64>, Vec<usize>)> {
    let shift = |m: &LocalAffinity| m.pair.to - m.pair.from;
    let near: Vec<usize> =
        (0..matches.len()).filter(|&k| shift(&matches[k]).norm() < furthest && is_alike(&matches[k].derivative)).collect();
    let agreeing_with = |one: &LocalAffinity| {
        let agrees = |m: &LocalAffinity| {
            let apart = SHIFT_SHARE * (m.pair.from - one.pair.from).norm() + NEAR_SIGMAS * m.noise.max(one.noise);
            (shift(m) - shift(one)).norm() < apart
        };
        distinct(matches, near.iter().copied().filter(|&k| agrees(&matches[k])))
    };
    // On a tie, the first.
    let agreeing =
        near.iter().map(|&k| agreeing_with(&matches[k])).reduce(|best, next| if next.len() > best.len() { next } else { best })?;
    let mean = agreeing.iter().map(|&k| shift(&matches[k])).sum::<Vector2<f64>>() / agreeing.len() as f64;
    (agreeing.len() >= least).then_some((mean, agreeing))
}

/// Alternates between fitting a map and collecting the matches that agree with it.
fn settled(matches: &[LocalAffinity], mut agreeing: Vec<usize>, least: usize) -> Option<(Homography, Vec<usize>)> {
    let mut map = fitted(matches, &agreeing)?;
    for share in SHARES {
        agreeing = agreeing_with_map(matches, &map, share, middle(matches, &agreeing));
        if agreeing.len() < least.max(1) {
            return None;
        }
        map = fitted(matches, &agreeing)?;
    }
    map.keeps_orientation().then_some((map, agreeing))
}

fn middle(matches: &[LocalAffinity], agreeing: &[usize]) -> Vector2<f64> {
    agreeing.iter().map(|&k| matches[k].pair.from).sum::<Vector2<f64>>() / agreeing.len().max(1) as f64
}

/// Returns the matches that agree with one match's local map, including itself; `None` if that map
/// is not invertible or mirrors.
fn agreeing_with_one(matches: &[LocalAffinity], one: &LocalAffinity) -> Option<Vec<usize>> {
    let inverse = one.derivative.try_inverse().filter(|_| one.derivative.determinant() > 0.0)?;
    let agrees = |m: &LocalAffinity| {
        let reach = one.derivative * (m.pair.from - one.pair.from);
        let (off, reach) = ((m.pair.to - one.pair.to - reach).norm_squared(), reach.norm_squared());
        let noise = NEAR_SIGMAS * m.noise.max(one.noise);
        // A squared sum is at most twice the sum of squares: this rejects nearly all without a
        // square root.
        off < 2.0 * (NEAR_SHARE * NEAR_SHARE * reach + noise * noise)
            && off < (NEAR_SHARE * reach.sqrt() + noise).powi(2)
            && is_alike(&(m.derivative * inverse))
    };
    Some((0..matches.len()).filter(|&k| agrees(&matches[k])).collect())
}

/// Whether a map between two derivatives is close to the identity.
fn is_alike(between: &Matrix2<f64>) -> bool {
    // Sine and cosine of the rotation, with a common factor.
    let (sin, cos) = (between.m21 - between.m12, between.m11 + between.m22);
    let growth = between.determinant();
    sin.abs() < MAX_ROTATION * cos && growth > MAX_GROWTH.powi(-2) && growth < MAX_GROWTH.powi(2)
}

/// Returns the matches that a map predicts within some sigmas plus a fraction of their distance
/// from the centre, and whose local maps agree with it.
fn agreeing_with_map(matches: &[LocalAffinity], map: &Homography, share: f64, middle: Vector2<f64>) -> Vec<usize> {
    let linear: Matrix2<f64> = map.0.fixed_view::<2, 2>(0, 0).into();
    let Some(inverse) = linear.try_inverse() else { return Vec::new() };
    let agrees = |m: &LocalAffinity| {
        let near = NEAR_SIGMAS * m.noise + share * (linear * (m.pair.from - middle)).norm();
        map.squared_error(&m.pair) < near * near && is_alike(&(m.derivative * inverse))
    };
    distinct(matches, (0..matches.len()).filter(|&k| agrees(&matches[k])))
}

/// Keeps the first of several matches at one position, on either plane.
fn distinct(matches: &[LocalAffinity], indices: impl Iterator<Item = usize>) -> Vec<usize> {
    let mut kept: Vec<usize> = Vec::new();
    for k in indices {
        let own = &matches[k];
        let is_same = |other: &LocalAffinity| {
            let near = 2.0 * own.noise.max(other.noise);
            (own.pair.to - other.pair.to).norm() < near || (own.derivative * (own.pair.from - other.pair.from)).norm() < near
        };
        if !kept.iter().any(|&other| is_same(&matches[other])) {
            kept.push(k);
        }
    }
    kept
}

/// Weighted least squares over positions and derivatives.
fn fitted(matches: &[LocalAffinity], agreeing: &[usize]) -> Option<Homography> {
    let middle = middle(matches, agreeing);
    let (mut normal, mut right) = (Matrix3::zeros(), Matrix2x3::zeros());
    for m in agreeing.iter().map(|&k| &matches[k]) {
        let row = (m.pair.from - middle).push(1.0);
        let weight = m.noise.powi(-2);
        normal += row * row.transpose() * weight;
        right += m.pair.to * row.transpose() * weight;
        // A derivative's noise is proportional to its scale; the squared scale is the determinant.
        let weight = (DERIVATIVE_NOISE.powi(2) * m.derivative.determinant().abs()).recip();
        for (k, column) in m.derivative.column_iter().enumerate() {
            normal[(k, k)] += weight;
            right.fixed_view_mut::<2, 1>(0, k).axpy(weight, &column, 1.0);
        }
    }
    let solved = right * normal.try_inverse()?;
    let linear = solved.fixed_view::<2, 2>(0, 0);
    let offset = solved.column(2) - linear * middle;
    let map = Matrix3::new(linear[(0, 0)], linear[(0, 1)], offset.x, linear[(1, 0)], linear[(1, 1)], offset.y, 0.0, 0.0, 1.0);
    map.iter().all(|v| v.is_finite()).then_some(Homography(map))
}

#[cfg(test)]
mod tests {
    use nalgebra::Rotation2;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    const TRUTH: Matrix2<f64> = Matrix2::new(0.4, -0.2, 0.1, 0.3);
    const OFFSET: Vector2<f64> = Vector2::new(100.0, 80.0);

    struct Scatter(Pcg64Mcg);

    impl Scatter {
        fn new(seed: u64) -> Self {
            Self(Pcg64Mcg::seed_from_u64(seed))
        }

        fn point(&mut self, side: f64) -> Vector2<f64> {
            Vector2::new(self.0.random_range(0.0..=side), self.0.random_range(0.0..=side))
        }

        /// A right match whose position is off by up to `noise` and whose derivative by up to
        /// `rotation` and `growth`.
        fn right(&mut self, noise: f64, rotation: f64, growth: f64) -> LocalAffinity {
            let from = self.point(400.0);
            self.right_at(from, noise, rotation, growth)
        }

        fn right_at(&mut self, from: Vector2<f64>, noise: f64, rotation: f64, growth: f64) -> LocalAffinity {
            let shift = self.point(2.0 * noise) - Vector2::repeat(noise);
            let rotated = Rotation2::new(rotation * self.0.random_range(-1.0..1.0)) * TRUTH * growth.powf(self.0.random_range(-1.0..1.0));
            LocalAffinity { pair: PointPair { from, to: TRUTH * from + OFFSET + shift }, derivative: rotated, noise: 1.0 }
        }

        fn wrong(&mut self) -> LocalAffinity {
            LocalAffinity { pair: PointPair { from: self.point(400.0), to: self.point(300.0) }, ..self.right(0.0, 3.1, 2.0) }
        }
    }

    fn off(map: &Homography) -> f64 {
        (map.0.fixed_view::<2, 2>(0, 0) - TRUTH).norm()
    }

    #[test]
    fn exact_matches_give_the_exact_map() {
        let mut scatter = Scatter::new(1);
        let matches: Vec<_> = (0..12).map(|_| scatter.right(1e-9, 1e-9, 1.0 + 1e-9)).collect();
        let (map, agreeing) = robust_affine(&matches, 5).expect("a map");
        assert!(off(&map) < 1e-7 && (map.0.fixed_view::<2, 1>(0, 2) - OFFSET).norm() < 1e-5, "{}", map.0);
        assert!(agreeing.len() >= 10, "{agreeing:?}");
    }

    #[test]
    fn six_right_matches_are_found_among_sixty_wrong_ones() {
        for seed in 0..30 {
            let mut scatter = Scatter::new(seed);
            let spots = [(20.0, 30.0), (350.0, 60.0), (200.0, 210.0), (60.0, 370.0), (330.0, 340.0), (190.0, 40.0)];
            let mut matches: Vec<_> = (0..60).map(|_| scatter.wrong()).collect();
            for (k, (x, y)) in spots.into_iter().enumerate() {
                let right = scatter.right_at(Vector2::new(x, y), 0.8, 0.15, 1.1);
                matches.insert(9 * k, right);
            }
            let (map, agreeing) = robust_affine(&matches, 5).expect("a map");
            let right = agreeing.iter().filter(|k| *k % 9 == 0 && **k <= 45).count();
            assert!(right >= 5 && right + 1 >= agreeing.len(), "{seed}: {agreeing:?}");
            assert!(off(&map) < 0.02, "{seed}: {}", map.0);
        }
    }

    #[test]
    fn wrong_matches_yield_no_affine_map() {
        for seed in 0..200 {
            let mut scatter = Scatter::new(seed);
            let matches: Vec<_> = (0..60).map(|_| scatter.wrong()).collect();
            assert_eq!(robust_affine(&matches, 5), None, "{seed}");
        }
    }

    #[test]
    fn several_matches_of_one_place_count_once() {
        let mut scatter = Scatter::new(2);
        let one_place: Vec<_> = (0..9).map(|_| scatter.right_at(Vector2::new(120.0, 90.0), 0.5, 0.1, 1.1)).collect();
        assert_eq!(robust_affine(&one_place, 2), None);
        let other = scatter.right_at(Vector2::new(300.0, 200.0), 0.5, 0.1, 1.1);
        let (_, agreeing) = robust_affine(&[one_place, vec![other]].concat(), 2).expect("two places");
        assert_eq!(agreeing.len(), 2, "{agreeing:?}");
    }

    #[test]
    fn derivatives_resolve_the_map_of_collinear_matches() {
        let mut scatter = Scatter::new(3);
        let matches: Vec<_> = (0..8).map(|k| scatter.right_at(Vector2::new(50.0 * f64::from(k), 100.0), 0.5, 0.1, 1.05)).collect();
        let (map, agreeing) = robust_affine(&matches, 5).expect("a map");
        assert!(off(&map) < 0.06 && agreeing.len() == 8, "{} {agreeing:?}", map.0);
    }

    #[test]
    fn mirrored_and_invalid_matches_yield_no_map() {
        let mut scatter = Scatter::new(4);
        let mirror = Matrix2::new(1.0, 0.0, 0.0, -1.0);
        let mut matches: Vec<_> = (0..9).map(|_| scatter.right(0.2, 0.05, 1.05)).collect();
        for m in &mut matches {
            (m.pair.to, m.derivative) = (mirror * m.pair.to, mirror * m.derivative);
        }
        assert_eq!(robust_affine(&matches, 5), None);
        let mut matches: Vec<_> = (0..9).map(|_| scatter.right(0.2, 0.05, 1.05)).collect();
        matches.iter_mut().for_each(|m| m.pair.to.x = f64::NAN);
        assert_eq!(robust_affine(&matches, 5), None);
        matches.iter_mut().for_each(|m| m.derivative = Matrix2::zeros());
        assert_eq!(robust_affine(&matches, 5), None);
        assert_eq!(robust_affine(&[], 0), None);
    }

    #[test]
    fn few_wrong_matches_join_the_largest_agreeing_set() {
        for seed in 0..20 {
            let mut scatter = Scatter::new(seed);
            let mut matches: Vec<LocalAffinity> = (0..60).map(|_| scatter.wrong()).collect();
            assert!(most_agreeing(&matches, 1).is_some() && most_agreeing(&matches, 5).is_none(), "{seed}");
            matches.extend((0..8).map(|_| scatter.right(0.5, 0.1, 1.1)));
            // A few wrong ones agree by chance.
            let found = most_agreeing(&matches, 5).expect("eight are right");
            assert!(found.len() <= 12 && found.iter().filter(|k| **k >= 60).count() >= 5, "{seed}: {found:?}");
        }
        assert_eq!(most_agreeing(&[], 0), None);
    }

    #[test]
    fn the_most_common_shift_is_found_among_wrong_matches() {
        for seed in 0..20 {
            let mut scatter = Scatter::new(seed);
            let shift = Vector2::new(25.0, -12.0);
            let mut off = |shift: Vector2<f64>, rotation: f64| {
                let from = scatter.point(400.0);
                LocalAffinity { pair: PointPair { from, to: from + shift }, derivative: Rotation2::new(rotation).into(), noise: 1.0 }
            };
            // Four are right; some have the same shift but are rotated, and the others are
            // anywhere.
            let mut matches: Vec<LocalAffinity> = (0..4).map(|k| off(shift + Vector2::new(f64::from(k), 0.0), 0.2)).collect();
            matches.extend((0..6).map(|_| off(shift, 1.5)));
            matches.extend((0..30).map(|k| off(Rotation2::new(2.4 * f64::from(k)) * Vector2::new(20.0 + 12.0 * f64::from(k), 0.0), 0.1)));
            let (found, agreeing) = robust_shift(&matches, 50.0, 3).expect("a shift");
            assert!(agreeing[..4] == [0, 1, 2, 3] && agreeing.len() <= 5, "{seed}: {agreeing:?}");
            assert!((found - shift).norm() < 5.0, "{seed}: {found}");
            assert_eq!(robust_shift(&matches, 10.0, 3), None);
            assert_eq!(robust_shift(&matches, 50.0, 8), None);
        }
        assert_eq!(robust_shift(&[], 50.0, 0), None);
    }
}
