//! Decides whether a homography explains two views or an epipolar relation is needed.
//!
//! Torr's criterion ("Geometric motion segmentation and model selection", Phil. Trans. R. Soc. A
//! 356, 1998): GRIC = Σ min(e²/σ², 2 (r - d)) + n d ln r + k ln(r n), lower is better. A pair of
//! points is one datum of r = 4 numbers. A homography constrains it to a surface of d = 2
//! dimensions and has k = 8 parameters, a fundamental matrix 3 and 7, an essential matrix 3 and 5.
//!
//! Both models are compared by the same measure on the same data. e is the Sampson distance in the
//! space of the four numbers for both (transfer errors are not, and would favour the epipolar
//! relation). The data are the inliers of either model. A pair of neither says nothing about which
//! is right, but would cost the model with the smaller d less, and many of them would decide.
//!
//! A pair farther than two sigmas from the homography indicates relief, a closer one a plane. The
//! epipolar relation wins once about a sixth of the pairs is off the plane. A single plane and pure
//! camera rotation are homographies.

use nalgebra::Matrix3;

use super::distances::squared_sampson_of_homography;
use super::line_noise::from_line;
use crate::geometry::correspondence::Correspondence;
use crate::geometry::distances::squared_sampson;
use crate::geometry::homography::{Homography, PointPair};
use crate::geometry::noise::{self, between_points};
use crate::geometry::robust::RobustModel;

/// Numbers per datum (r).
const NUMBERS: f64 = 4.0;
/// Minimum noise as a fraction of the inlier threshold, a tenth of a pixel for three. Hardly
/// anything in a picture is located more precisely, and one wrong pair within the threshold shifts
/// a model by about as much. Raised, small relief is lost.
const MIN_NOISE: f64 = 1.0 / 30.0;
/// Maximum ratio between two estimates of the same noise: a hundred pairs determine each to about a
/// tenth. Raised, relief of the noise's size is taken for noise; lowered, chance decides which
/// estimate is used.
const SAME_NOISE: f64 = 1.25;
/// Number of other pairs that each point is mispaired with. Raised, the chance that a wrong pair
/// agrees is estimated better.
const MISPAIRINGS: usize = 8;

/// The two explanations.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TwoViewModel {
    /// One plane, or pure camera rotation.
    Homography,
    /// A scene with relief.
    Epipolar,
}

/// The epipolar relation to compare.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EpipolarKind {
    /// Seven parameters.
    Fundamental,
    /// Five parameters: an essential matrix, converted to a fundamental matrix for the cameras'
    /// pixels.
    Essential,
}

/// The choice and its basis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModelChoice {
    /// The model with the lower criterion.
    pub model: TwoViewModel,
    /// GRIC of the homography.
    pub homography: f64,
    /// GRIC of the epipolar relation.
    pub epipolar: f64,
    /// Noise of one coordinate, pixels, estimated from both models' inlier residuals.
    pub sigma: f64,
    /// Number of pairs compared, weighted by how certainly they are inliers.
    pub data: f64,
}

/// Chooses between the refined models of the same pairs (in pixels), whose inliers are nearer than
/// `threshold` pixels. Relief below `relief` pixels is ignored: real planes are bent, and so are
/// straight lines under uncalibrated lenses.
///
/// Some wrong pairs agree with an epipolar relation by chance, because its band crosses the whole
/// picture. Their number is estimated by deliberate mispairing. Inliers of the epipolar relation
/// alone count only as far as they exceed that number.
pub fn choose_model(
    pairs: &[PointPair],
    homography: &RobustModel<Homography>,
    fundamental: &RobustModel<Matrix3<f64>>,
    kind: EpipolarKind,
    threshold: f64,
    relief: f64,
) -> ModelChoice {
    let on_plane = |k: usize| squared_sampson_of_homography(&homography.model, &pairs[k]);
    let on_line = |k: usize| squared_sampson(&fundamental.model, &pairs[k]);
    let is_of_plane = |k: &usize| homography.inliers.binary_search(k).is_ok();
    let of_lines_alone: Vec<usize> = fundamental.inliers.iter().copied().filter(|k| !is_of_plane(k)).collect();
    let by_chance = wrong_pairs_that_agree(pairs, homography, &fundamental.model, threshold);
    let surely = (of_lines_alone.len() as f64 - by_chance - 2.0 * by_chance.sqrt()).max(0.0);
    let weight_alone = if of_lines_alone.is_empty() { 0.0 } else { surely / of_lines_alone.len() as f64 };

    let sigma = {
        let mut of_plane: Vec<f64> = homography.inliers.iter().map(|&k| on_plane(k)).collect();
        let mut of_lines: Vec<f64> = fundamental.inliers.iter().map(|&k| on_line(k)).collect();
        let plane = noise::of_inliers(&mut of_plane, threshold, between_points);
        let lines = noise::of_inliers(&mut of_lines, threshold, from_line);
        pooled([plane, lines], [2 * of_plane.len(), of_lines.len()]).max(MIN_NOISE * threshold).max(relief)
    };
    let data = homography.inliers.len() as f64 + weight_alone * of_lines_alone.len() as f64;
    let sum = |squared: &dyn Fn(usize) -> f64, most: f64| {
        let cut = |k: &usize| (squared(*k) / (sigma * sigma)).min(most);
        homography.inliers.iter().map(cut).sum::<f64>() + weight_alone * of_lines_alone.iter().map(cut).sum::<f64>()
    };
    let gric = |squared: &dyn Fn(usize) -> f64, d: f64, k: f64| {
        sum(squared, 2.0 * (NUMBERS - d)) + data * d * NUMBERS.ln() + k * (NUMBERS * data).max(1.0).ln()
    };
    let parameters = match kind {
        EpipolarKind::Fundamental => 7.0,
        EpipolarKind::Essential => 5.0,
    };
    let (plane, epipolar) = (gric(&on_plane, 2.0, 8.0), gric(&on_line, 3.0, parameters));
    // On a tie, the simpler model.
    let model = if epipolar < plane { TwoViewModel::Epipolar } else { TwoViewModel::Homography };
    ModelChoice { model, homography: plane, epipolar, sigma, data }
}

/// Pools the noise estimates of both models, weighted by their residual counts: two per pair for a
/// plane, one per pair for lines. If the plane's exceeds the lines' by more than [`SAME_NOISE`],
/// the excess is relief, and only the lines' estimate is used.
fn pooled([plane, lines]: [f64; 2], [of_plane, of_lines]: [usize; 2]) -> f64 {
    let numbers = (of_plane + of_lines) as f64;
    if plane > SAME_NOISE * lines || numbers == 0.0 {
        return lines;
    }
    ((of_plane as f64 * plane * plane + of_lines as f64 * lines * lines) / numbers).sqrt()
}

/// Estimates how many of the pairs off the plane would agree with the epipolar relation if they
/// were all wrong.
fn wrong_pairs_that_agree(pairs: &[PointPair], plane: &RobustModel<Homography>, f: &Matrix3<f64>, threshold: f64) -> f64 {
    let usable: Vec<&PointPair> = pairs.iter().filter(|p| p.is_usable()).collect();
    let n = usable.len();
    if n < 2 {
        return 0.0;
    }
    // Steps spread over the list, so that neighbours are not paired.
    let steps = (1..=MISPAIRINGS).map(|k| (k * n / (MISPAIRINGS + 1)).max(1));
    let (mut agree, mut made) = (0, 0);
    for step in steps {
        for (k, p) in usable.iter().enumerate() {
            let wrong = PointPair { from: p.from, to: usable[(k + step) % n].to };
            made += 1;
            agree += usize::from(squared_sampson(f, &wrong) < threshold * threshold);
        }
    }
    agree as f64 / made as f64 * (n - plane.inliers.len().min(n)) as f64
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector2, Vector3};
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::geometry::relative_pose::RayPair;
    use crate::geometry::robust::RobustOptions;
    use crate::geometry::robust_homography::robust_homography;
    use crate::geometry::two_views::robust_essential::robust_essential;
    use crate::geometry::two_views::robust_fundamental::robust_fundamental;

    const FOCAL: f64 = 700.0;

    /// A scene of 150 points behind a plane by up to `relief` of its distance, seen before and
    /// after a move, with noise in both pictures and 100 wrong pairs.
    fn seen(relief: f64, t: Vector3<f64>, noise: f64, seed: u64) -> Vec<PointPair> {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let rotation = UnitQuaternion::from_euler_angles(0.05, -0.15, 0.1);
        let middle = Vector2::new(400.0, 300.0);
        let mut pairs = Vec::new();
        while pairs.len() < 150 {
            let ray = Vector3::new(random.random_range(-0.5..0.5), random.random_range(-0.4..0.4), 1.0);
            // The plane is tilted sideways.
            let p = ray * (4.0 / (1.0 - 0.3 * ray.x)) * (1.0 + relief * random.random_range(0.0..1.0));
            let q = rotation * p + t;
            // Nearly normal noise of that standard deviation.
            let mut jitter = || Vector2::from_fn(|_, _| (0..12).map(|_| random.random_range(-0.5..0.5)).sum::<f64>()) * noise;
            let (from, to) = (p.xy() / p.z * FOCAL + middle + jitter(), q.xy() / q.z * FOCAL + middle + jitter());
            pairs.push(PointPair { from, to });
        }
        for _ in 0..100 {
            let mut at = || Vector2::new(random.random_range(0.0..800.0), random.random_range(0.0..600.0));
            pairs.push(PointPair { from: at(), to: at() });
        }
        pairs
    }

    /// The choice without and with cameras.
    fn chosen(pairs: &[PointPair], noise: f64, seed: u64) -> [ModelChoice; 2] {
        let options = RobustOptions { threshold: (3.0 * noise).max(1.5), seed, max_samples: 2000, ..RobustOptions::default() };
        let h = robust_homography(pairs, &options).expect("a homography");
        let f = robust_fundamental(pairs, &options).expect("a relation");
        let k = Matrix3::new(FOCAL, 0.0, 400.0, 0.0, FOCAL, 300.0, 0.0, 0.0, 1.0);
        let inverse = k.try_inverse().expect("regular");
        let ray = |p: Vector2<f64>| (inverse * p.push(1.0)).xy();
        let rays: Vec<RayPair> = pairs.iter().map(|p| RayPair { first: ray(p.from), second: ray(p.to) }).collect();
        let e = robust_essential(&rays, [FOCAL; 2], &RobustOptions { max_samples: 300, ..options }).expect("a motion");
        let e = e.map(|m| inverse.transpose() * m.motion.essential() * inverse);
        [
            choose_model(pairs, &h, &f, EpipolarKind::Fundamental, options.threshold, 0.0),
            choose_model(pairs, &h, &e, EpipolarKind::Essential, options.threshold, 0.0),
        ]
    }

    #[test]
    fn planes_and_pure_rotations_select_the_homography() {
        let sideways = Vector3::new(0.8, 0.1, 0.1);
        for noise in [0.3, 1.0, 2.0] {
            for seed in 0..3 {
                // Points behind the plane by the fraction s move by about s / (1 + s) of the
                // parallax, 140 px.
                let scenes = [
                    ("a plane", 0.0, sideways, TwoViewModel::Homography),
                    ("nearly a plane: moves below the noise", 0.005 * noise, sideways, TwoViewModel::Homography),
                    ("a camera that only turned", 1.0, Vector3::zeros(), TwoViewModel::Homography),
                    ("relief of ten sigmas", 0.1 * noise, sideways, TwoViewModel::Epipolar),
                    ("relief", 0.6, sideways, TwoViewModel::Epipolar),
                    ("relief, ahead", 0.8, Vector3::new(0.1, 0.0, -1.2), TwoViewModel::Epipolar),
                ];
                for (what, relief, t, expected) in scenes {
                    let pairs = seen(relief, t, noise, seed);
                    for choice in chosen(&pairs, noise, seed) {
                        assert_eq!(choice.model, expected, "{what}, noise {noise}, seed {seed}: {choice:?}");
                        if relief == 0.0 {
                            assert!((0.7..1.3).contains(&(choice.sigma / noise)), "{what}, noise {noise}: {choice:?}");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn model_choice_handles_exact_and_empty_data() {
        let exact = |relief| seen(relief, Vector3::new(0.8, 0.1, 0.1), 0.0, 1);
        assert!(chosen(&exact(0.0), 0.0, 1).iter().all(|c| c.model == TwoViewModel::Homography));
        assert!(chosen(&exact(0.5), 0.0, 1).iter().all(|c| c.model == TwoViewModel::Epipolar));
        let none = |m: Matrix3<f64>| RobustModel { model: m, inliers: Vec::new(), score: 0.0, sigma: 0.0 };
        let choice =
            choose_model(&[], &none(Matrix3::identity()).map(Homography), &none(Matrix3::identity()), EpipolarKind::Fundamental, 3.0, 0.0);
        assert_eq!(choice.model, TwoViewModel::Homography);
    }
}
