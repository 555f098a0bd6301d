//! Errors shared by neighbours. Keypoint noise is independent, but a surface that is not quite flat
//! or an imperfectly known lens shifts all pairs of a patch alike, so that a hundred of them say
//! little more than one.
//!
//! The correlation of neighbours' errors is estimated from the errors themselves (the intraclass
//! correlation). Each pair is weighted by the inverse design effect of its patch, 1 + (n - 1) ρ,
//! the factor by which a cluster of n data counts less than n independent ones (Kish, Survey
//! Sampling, 1965, section 5.4). In a flat scene ρ is 0 and all pairs count equally.

use nalgebra::Vector2;

/// Radius of a patch, in units of the positions' mean distance from their centre: a twentieth of
/// the diagonal of an evenly filled picture. Raised, smaller bends go unnoticed; lowered, patches
/// have too few pairs to show a correlation.
const PATCH: f64 = 0.18;

/// Which positions share a patch.
#[derive(Debug, Clone, PartialEq)]
pub struct Patches {
    places: Vec<Vector2<f64>>,
    /// Indices of the positions, from left to right.
    from_left: Vec<usize>,
    /// Radius of a patch, and the distance within which two positions count as one, in the
    /// positions' units.
    radius: f64,
    same: f64,
    /// Number of other positions within the radius of each.
    neighbours: Vec<f64>,
}

impl Patches {
    /// Builds the neighbourhoods. `same`: distance within which two positions count as one; their
    /// errors are alike for other reasons.
    pub fn new(places: Vec<Vector2<f64>>, same: f64) -> Self {
        let n = places.len() as f64;
        let middle = places.iter().sum::<Vector2<f64>>() / n;
        let radius = PATCH * places.iter().map(|p| (p - middle).norm()).sum::<f64>() / n;
        let mut from_left: Vec<usize> = (0..places.len()).collect();
        from_left.sort_by(|a, b| places[*a].x.total_cmp(&places[*b].x));
        let neighbours = vec![0.0; places.len()];
        let mut patches = Self { places, from_left, radius, same, neighbours };
        let mut neighbours = std::mem::take(&mut patches.neighbours);
        patches.each_two(|a, b, _| {
            neighbours[a] += 1.0;
            neighbours[b] += 1.0;
        });
        patches.neighbours = neighbours;
        patches
    }

    /// Calls `with` for each pair of neighbours and their squared distance.
    fn each_two(&self, mut with: impl FnMut(usize, usize, f64)) {
        for (k, &a) in self.from_left.iter().enumerate() {
            for &b in &self.from_left[k + 1..] {
                let between = self.places[b] - self.places[a];
                if between.x > self.radius {
                    break;
                }
                let squared = between.norm_squared();
                if squared <= self.radius * self.radius {
                    with(a, b, squared);
                }
            }
        }
    }

    /// Estimates the correlation of neighbours' errors, 0 to 1. `errors` have unit covariance times
    /// a common factor, and a weight each: 0 for wrong pairs.
    pub fn correlation(&self, errors: &[(Vector2<f64>, f64)]) -> f64 {
        let (mut shared, mut whole) = (0.0, 0.0);
        self.each_two(|a, b, squared| {
            if squared > self.same * self.same {
                let ((p, of_p), (q, of_q)) = (errors[a], errors[b]);
                shared += of_p * of_q * p.dot(&q);
                whole += of_p * of_q * 0.5 * (p.norm_squared() + q.norm_squared());
            }
        });
        if whole > 0.0 { (shared / whole).clamp(0.0, 1.0) } else { 0.0 }
    }

    /// Returns the weight of each pair for this correlation of neighbours' errors.
    pub fn shares(&self, correlation: f64) -> Vec<f64> {
        self.neighbours.iter().map(|n| 1.0 / (1.0 + n * correlation)).collect()
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    /// Positions all over a picture, with errors of which neighbours share this fraction.
    fn errors(shared: f64) -> (Patches, Vec<(Vector2<f64>, f64)>) {
        let mut random = Pcg64Mcg::seed_from_u64(4);
        let mut uniform = |size: f64| random.random_range(-0.5 * size..0.5 * size);
        let places: Vec<_> = (0..1500).map(|_| Vector2::new(uniform(800.0), uniform(600.0))).collect();
        let slow = |p: &Vector2<f64>| Vector2::new((p.x / 130.0).sin(), (p.y / 110.0).cos()) * 2.0_f64.sqrt();
        let of = |p| slow(p) * shared.sqrt() + Vector2::new(uniform(12.0_f64.sqrt()), uniform(12.0_f64.sqrt())) * (1.0 - shared).sqrt();
        let errors = places.iter().map(of).map(|e| (e * 0.3, 1.0)).collect();
        (Patches::new(places, 2.0), errors)
    }

    #[test]
    fn the_correlation_of_neighbouring_errors_is_found() {
        for shared in [0.0, 0.2, 0.5, 0.9] {
            let (patches, errors) = errors(shared);
            let found = patches.correlation(&errors);
            assert!((found - shared).abs() < 0.05, "{shared}: {found}");
        }
    }

    #[test]
    fn a_dense_patch_with_shared_errors_counts_as_one() {
        let far = (0..4).map(|k| Vector2::new(f64::from(k) * 1000.0, 0.0));
        let dense = (0..100).map(|k| Vector2::new(500.0 + f64::from(k) * 0.1, 0.0));
        let patches = Patches::new(far.chain(dense).collect(), 0.05);
        let independent = patches.shares(0.0);
        assert!(independent.iter().all(|share| *share == 1.0));
        let shares = patches.shares(1.0);
        let of_dense: f64 = shares[4..].iter().sum();
        assert!(shares[..4].iter().all(|share| *share == 1.0) && (of_dense - 1.0).abs() < 1e-9, "{of_dense}");
    }

    #[test]
    fn empty_and_single_patches_have_no_correlation() {
        for places in [vec![], vec![Vector2::zeros()], vec![Vector2::zeros(); 5]] {
            let errors = vec![(Vector2::new(1.0, 0.0), 1.0); places.len()];
            assert_eq!(Patches::new(places, 2.0).correlation(&errors), 0.0);
        }
    }
}
