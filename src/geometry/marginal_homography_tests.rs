//! Planes, flat and a little bent, with noise that is known.

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::*;
use crate::geometry::ransac::Order;
use crate::geometry::robust_homography::robust_homography;
use crate::geometry::test_planes::{corner_error, truth};

/// Two independent normal numbers (Box and Muller).
fn normal(random: &mut Pcg64Mcg) -> Vector2<f64> {
    let (r, angle) = ((-2.0 * (1.0 - random.random::<f64>()).ln()).sqrt(), random.random_range(0.0..std::f64::consts::TAU));
    Vector2::new(angle.cos(), angle.sin()) * r
}

/// Where a point of a plane is in the second picture; the plane is a piece of a roll, by up to `bend` pixels at its sides.
fn place(from: Vector2<f64>, bend: f64) -> Vector2<f64> {
    let from_middle: f64 = from.x / 400.0 - 1.0;
    truth().map(from).expect("in front") + Vector2::new(0.8, 0.6) * bend * from_middle * from_middle
}

/// Pairs of a plane with noise in both pictures, the first `right` of them true, the others anywhere.
fn seen(right: usize, wrong: usize, noise: f64, bend: f64, seed: u64) -> Vec<PointPair> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut pairs = Vec::new();
    for _ in 0..right {
        let from = Vector2::new(random.random_range(0.0..800.0), random.random_range(0.0..600.0));
        pairs.push(PointPair { from: from + normal(&mut random) * noise, to: place(from, bend) + normal(&mut random) * noise });
    }
    pairs.extend((0..wrong).map(|_| {
        let mut at = || Vector2::new(random.random_range(0.0..800.0), random.random_range(0.0..600.0));
        PointPair { from: at(), to: at() }
    }));
    pairs
}

/// Root mean square over a bent plane of how far a homography puts its points off, pixels.
fn off(h: &Homography, bend: f64) -> f64 {
    let grid = (0..13 * 10).map(|k| Vector2::new((k % 13) as f64 * 800.0 / 12.0, (k / 13) as f64 * 600.0 / 9.0));
    (grid.map(|from| (h.map(from).expect("in front") - place(from, bend)).norm_squared()).sum::<f64>() / 130.0).sqrt()
}

/// What `compare` searches with: 1.2 pixels, and its multiples.
fn options(seed: u64) -> RobustOptions {
    let order = Order::BestFirst { even_after: 2000, stops_by_best: false, draws_each: 1 };
    RobustOptions { threshold: 1.5, order, seed, ..RobustOptions::default() }
}

const MOST_NOISE: f64 = 3.0;

/// The root mean square over seeds of the largest error at a corner.
fn rms(error: impl Fn(u64) -> f64) -> f64 {
    const SEEDS: u64 = 12;
    ((0..SEEDS).map(|seed| error(seed).powi(2)).sum::<f64>() / SEEDS as f64).sqrt()
}

/// The homography of the true pairs alone, by least squares.
fn oracle(pairs: &[PointPair]) -> Homography {
    truth().refined(pairs, 1e3, 30).expect("regular")
}

#[test]
fn flat_planes_are_found_as_by_who_knows_the_right_pairs_at_any_noise() {
    for noise in [0.3, 0.6, 1.0, 2.0, 3.0] {
        let of = |seed| seen(300, 150, noise, 0.0, seed);
        let found = rms(|seed| {
            let found = homography_of_unknown_noise(&of(seed), MOST_NOISE, &options(seed)).expect("a plane");
            let right = found.inliers.iter().filter(|k| **k < 300).count();
            assert!(right >= 270 && found.inliers.len() - right <= 6, "noise {noise}, seed {seed}: {right} of {}", found.inliers.len());
            assert!((0.8..1.2).contains(&(found.sigma / noise)), "noise {noise}: {}", found.sigma);
            corner_error(&found.model)
        });
        let least = rms(|seed| corner_error(&oracle(&of(seed)[..300])));
        assert!(found < 1.15 * least, "noise {noise}: {found} beside {least}");
    }
}

#[test]
fn a_plane_that_is_a_little_bent_is_found_as_a_whole() {
    for (noise, bend) in [(0.3, 4.0), (0.5, 6.0), (0.5, 9.0)] {
        let of = |seed| seen(300, 100, noise, bend, seed);
        let found = rms(|seed| off(&homography_of_unknown_noise(&of(seed), MOST_NOISE, &options(seed)).expect("a plane").model, bend));
        let fixed = rms(|seed| off(&robust_homography(&of(seed), &options(seed)).expect("a plane").model, bend));
        let whole = rms(|seed| off(&oracle(&of(seed)[..300]), bend));
        assert!(found < 1.1 * whole, "noise {noise}, bend {bend}: {found} beside {whole}");
        // What a threshold of a pixel and a half takes is a part.
        assert!(fixed > 1.15 * whole, "noise {noise}, bend {bend}: {fixed} beside {whole}");
    }
}

#[test]
fn a_wall_behind_does_not_pull_the_plane_before_it() {
    // A fifth of the pairs is on another plane, eight pixels off: beyond what noise of three pixels leaves behind.
    let of = |seed| {
        let mut pairs = seen(300, 50, 0.5, 0.0, seed);
        pairs[..60].iter_mut().for_each(|p| p.to += Vector2::new(9.6, 0.0));
        pairs
    };
    let found = rms(|seed| corner_error(&homography_of_unknown_noise(&of(seed), MOST_NOISE, &options(seed)).expect("a plane").model));
    let least = rms(|seed| corner_error(&oracle(&of(seed)[60..300])));
    assert!(found < 1.3 * least, "{found} beside {least}");
}

#[test]
fn the_same_seed_gives_the_same_and_exact_pairs_are_met() {
    let pairs = seen(100, 40, 1.0, 0.0, 5);
    let found = homography_of_unknown_noise(&pairs, MOST_NOISE, &options(3));
    assert!(found.is_some() && found == homography_of_unknown_noise(&pairs, MOST_NOISE, &options(3)));
    let exact = homography_of_unknown_noise(&seen(60, 20, 0.0, 0.0, 1), MOST_NOISE, &options(1)).expect("a plane");
    assert!(exact.inliers.len() == 60 && corner_error(&exact.model) < 1e-3, "{} {}", exact.inliers.len(), corner_error(&exact.model));
}

#[test]
fn what_is_no_plane_gives_none() {
    let pairs = seen(60, 20, 0.5, 0.0, 2);
    for few in [&pairs[..0], &pairs[..3]] {
        assert_eq!(homography_of_unknown_noise(few, MOST_NOISE, &options(1)), None);
    }
    for (most_noise, threshold) in [(0.0, 1.5), (-1.0, 1.5), (f64::NAN, 1.5), (3.0, 0.0), (3.0, f64::NAN)] {
        assert_eq!(homography_of_unknown_noise(&pairs, most_noise, &RobustOptions { threshold, ..options(1) }), None);
    }
    let broken = PointPair { from: Vector2::new(f64::NAN, 0.0), to: Vector2::zeros() };
    assert_eq!(homography_of_unknown_noise(&[broken; 30], MOST_NOISE, &options(1)), None);
    assert_eq!(homography_of_unknown_noise(&[pairs[0]; 30], MOST_NOISE, &options(1)), None);
    let with_holes = [&[broken; 3][..], &pairs].concat();
    let plain = homography_of_unknown_noise(&pairs, MOST_NOISE, &options(1)).expect("a plane");
    let holes = homography_of_unknown_noise(&with_holes, MOST_NOISE, &options(1)).expect("a plane");
    assert_eq!(holes.inliers, plain.inliers.iter().map(|k| k + 3).collect::<Vec<_>>());
}
