//! Robust search by random samples (RANSAC, Fischler and Bolles 1981), one driver for all models: samples drawn evenly or in the order of
//! the data's quality (PROSAC, Chum and Matas 2005), each new best model improved locally (Chum, Matas and Kittler 2003).
//!
//! The generator is seeded, so the same data give the same models.

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// What is searched for, from samples of `N` data.
pub trait Estimator<const N: usize> {
    /// A model of the data.
    type Model;

    /// How many data there are.
    fn count(&self) -> usize;

    /// The models that pass through a sample, as indices of data.
    fn models(&self, sample: [usize; N]) -> impl Iterator<Item = Self::Model>;

    /// How well a model explains all data; higher is better.
    fn score(&self, model: &Self::Model) -> f64;

    /// A model that beats all before, improved by the data that agree with it; with its score.
    fn improved(&self, model: Self::Model, score: f64) -> (Self::Model, f64) {
        (model, score)
    }

    /// The share of the data that agree with a model.
    fn inlier_share(&self, model: &Self::Model) -> f64;
}

/// What a search may spend, and what it gives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Samples at most.
    pub samples: usize,
    /// Stop when the chance of having missed a better model is below 1 - this; `None` draws all samples.
    pub confidence: Option<f64>,
    /// Whether the data are sorted, best first, so that samples are drawn from the best of them first.
    pub is_progressive: bool,
    /// Scores up to this are no model.
    pub least_score: f64,
    /// Models to give.
    pub keep: usize,
    /// Seed of the sampler.
    pub seed: u64,
}

/// The best models with their scores, best first.
pub fn search<const N: usize, E: Estimator<N>>(estimator: &E, options: &Options) -> Vec<(f64, E::Model)> {
    let mut best: Vec<(f64, E::Model)> = Vec::with_capacity(options.keep + 1);
    if estimator.count() < N {
        return best;
    }
    let mut rng = Pcg64Mcg::seed_from_u64(options.seed);
    let mut sampler = Sampler::<N>::new(estimator.count(), options);
    let (mut drawn, mut wanted) = (0, options.samples);
    while drawn < wanted {
        drawn += 1;
        for model in estimator.models(sampler.next(&mut rng)) {
            let score = estimator.score(&model);
            let bar = if best.len() < options.keep { options.least_score } else { best.last().map_or(f64::INFINITY, |(worst, _)| *worst) };
            if score.is_nan() || score <= bar {
                continue;
            }
            let (model, score) = estimator.improved(model, score);
            if let Some(confidence) = options.confidence {
                let miss = (1.0 - estimator.inlier_share(&model).powi(N as i32)).clamp(1e-12, 1.0 - 1e-12).ln();
                let needed = ((1.0 - confidence).ln() / miss).ceil();
                wanted = options.samples.min(drawn.max(needed.min(1e9) as usize));
            }
            best.push((score, model));
            best.sort_by(|a, b| b.0.total_cmp(&a.0));
            best.truncate(options.keep);
        }
    }
    best
}

/// Draws samples, from a pool that grows from the best data to all of them.
struct Sampler<const N: usize> {
    total: usize,
    pool: usize,
    /// T_n of the paper: expected samples from the first n of all that are drawn.
    average: f64,
    /// T'_n: the draw after which the pool grows.
    grow_at: usize,
    drawn: usize,
}

impl<const N: usize> Sampler<N> {
    fn new(total: usize, options: &Options) -> Self {
        let average = (0..N).fold(options.samples as f64, |t, i| t * (N - i) as f64 / (total - i) as f64);
        Self { total, pool: if options.is_progressive { N } else { total }, average, grow_at: 1, drawn: 0 }
    }

    fn next(&mut self, rng: &mut Pcg64Mcg) -> [usize; N] {
        self.drawn += 1;
        while self.drawn > self.grow_at && self.pool < self.total {
            let next = self.average * (self.pool + 1) as f64 / (self.pool + 1 - N) as f64;
            self.grow_at += (next - self.average).ceil().max(1.0) as usize;
            self.average = next;
            self.pool += 1;
        }
        let mut sample = [0; N];
        // While the pool grows, its newest datum is always part of the sample.
        let is_growing = self.pool < self.total && self.drawn <= self.grow_at;
        let (from_rest, range) = if is_growing { (N - 1, self.pool - 1) } else { (N, self.pool) };
        for k in 0..from_rest {
            sample[k] = loop {
                let pick = rng.random_range(0..range);
                if !sample[..k].contains(&pick) {
                    break pick;
                }
            };
        }
        if is_growing {
            sample[N - 1] = self.pool - 1;
        }
        sample
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lines y = a x + b through points, of which two make a sample.
    struct Line(Vec<[f64; 2]>);

    impl Line {
        fn agree<'a>(&'a self, model: &'a [f64; 2]) -> impl Iterator<Item = &'a [f64; 2]> {
            self.0.iter().filter(|[x, y]| (model[0] * x + model[1] - y).abs() < 0.1)
        }
    }

    impl Estimator<2> for Line {
        type Model = [f64; 2];

        fn count(&self) -> usize {
            self.0.len()
        }

        fn models(&self, [a, b]: [usize; 2]) -> impl Iterator<Item = [f64; 2]> {
            let ([x, y], [u, v]) = (self.0[a], self.0[b]);
            let slope = (v - y) / (u - x);
            Some([slope, y - slope * x]).filter(|m| m[0].is_finite()).into_iter()
        }

        fn score(&self, model: &[f64; 2]) -> f64 {
            self.agree(model).count() as f64
        }

        fn inlier_share(&self, model: &[f64; 2]) -> f64 {
            self.score(model) / self.0.len() as f64
        }
    }

    /// 40 points on one line, 25 on another, 60 anywhere.
    fn points() -> Line {
        let mut random = Pcg64Mcg::seed_from_u64(3);
        let mut at = |k: usize| {
            let x = random.random_range(-10.0..10.0);
            match k {
                0..40 => [x, 0.5 * x + 1.0],
                40..65 => [x, -2.0 * x + 3.0],
                _ => [x, random.random_range(-20.0..20.0)],
            }
        };
        Line((0..125).map(&mut at).collect())
    }

    const OPTIONS: Options = Options { samples: 2000, confidence: None, is_progressive: false, least_score: 10.0, keep: 1, seed: 5 };

    #[test]
    fn the_model_that_most_data_agree_with_is_found() {
        for is_progressive in [false, true] {
            for confidence in [None, Some(0.9999)] {
                let found = search(&points(), &Options { is_progressive, confidence, ..OPTIONS });
                let (score, [slope, level]) = found[0];
                assert!(score >= 40.0 && (slope - 0.5).abs() < 0.05 && (level - 1.0).abs() < 0.1, "{found:?}");
            }
        }
    }

    #[test]
    fn the_best_models_come_first_and_poor_ones_not_at_all() {
        let found = search(&points(), &Options { keep: 2000, ..OPTIONS });
        assert!(found.len() > 2 && found.windows(2).all(|w| w[0].0 >= w[1].0) && found.iter().all(|(score, _)| *score > 10.0));
        assert!(found.iter().any(|(_, [slope, _])| (slope + 2.0).abs() < 0.05));
        assert!(search(&points(), &Options { least_score: 1000.0, ..OPTIONS }).is_empty());
        assert!(search(&Line(vec![[0.0, 0.0]]), &OPTIONS).is_empty());
    }

    #[test]
    fn a_sure_search_stops_early_and_a_seed_gives_the_same() {
        let options = Options { samples: usize::MAX, confidence: Some(0.99), ..OPTIONS };
        assert_eq!(search(&points(), &options), search(&points(), &options));
    }

    #[test]
    fn samples_are_distinct_and_begin_with_the_best() {
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let mut sampler = Sampler::<4>::new(100, &Options { samples: 500, is_progressive: true, ..OPTIONS });
        let samples: Vec<[usize; 4]> = (0..500).map(|_| sampler.next(&mut rng)).collect();
        assert!(samples[0].iter().all(|k| *k < 4) && samples.iter().flatten().all(|k| *k < 100));
        assert!(samples.iter().all(|s| (0..4).all(|k| !s[..k].contains(&s[k]))));
        let reach = |of: &[[usize; 4]]| of.iter().flatten().max().copied().unwrap_or(0);
        assert!(reach(&samples[..20]) < reach(&samples[480..]));
    }
}
