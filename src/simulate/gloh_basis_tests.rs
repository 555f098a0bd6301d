//! Computes the principal components of GLOH from features of the virtual backdrops, and checks the
//! committed ones against them.
//!
//! `STAGEPOSE_REMAKE=1 cargo test --lib --features simulate gloh_basis` rewrites
//! src/features/two_views/descriptors/gloh.basis. It renders a backdrop for each seed from random
//! viewpoints with noise, describes at most 400 SIFT keypoints per picture by 272 numbers each, and
//! takes the eigenvectors of the covariance.

use nalgebra::{DMatrix, Point3, SymmetricEigen, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::{CameraPath, Renderer, SensorNoise, VirtualStage, artwork_surface, grey, paint, upright};
use crate::camera::CameraModel;
use crate::features::two_views::descriptors::{Basis, Describer, GlohDescriber};
use crate::features::two_views::detectors::{Detector, SiftDetector};
use crate::features::two_views::{Descriptors, PictureForms};
use crate::track::BodySpec;

/// Numbers in a descriptor before reduction.
const NUMBERS: usize = 272;
/// Backdrops from which the basis is computed. Raised, it changes by less than its rounding to
/// bytes.
const BACKDROPS: u64 = 24;
/// Pictures of each backdrop. Raised, making the basis takes longer.
const VIEWS: u64 = 3;

/// Returns descriptors of a backdrop's features from random viewpoints.
fn descriptions(seed: u64) -> Vec<f32> {
    let artwork = grey(&paint(1200, 900, seed));
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut all = Vec::new();
    for view in 0..VIEWS {
        let cloth = artwork_surface("cloth", artwork.clone(), [4.0, 3.0], upright(Vector3::zeros(), 0.0));
        let camera = CameraModel::pinhole(480, 360, 480.0, 480.0, 239.5, 179.5).unwrap();
        // Within 55 degrees of the normal. The cloth is twice as wide as the picture at the
        // nearest, and 80 % of its width at the farthest.
        let (distance, side, height) =
            (random.random_range(2.0..5.0_f64), random.random_range(-0.95..0.95_f64), random.random_range(-0.4..0.4));
        let place = Point3::new(distance * side.sin(), -distance * side.cos(), distance * height);
        let mut path = CameraPath::fixed(place, Point3::new(random.random_range(-0.5..0.5), 0.0, random.random_range(-0.4..0.4)));
        path.roll_rad = random.random_range(-3.0..3.0);
        let mut stage = VirtualStage::new(camera, path, BodySpec::new("stage", vec![cloth]));
        stage.background = 110.0;
        stage.noise = SensorNoise::webcam();
        stage.seed = seed;
        let picture = Renderer::new(stage).render(0.0, view);
        let forms = PictureForms::new(&picture);
        let keypoints = SiftDetector { count: 400, ..Default::default() }.detect(&forms);
        let Descriptors::Vectors { length, values } = GlohDescriber { reduced: false }.describe(&forms, &keypoints).descriptors else {
            panic!("GLOH gives vectors");
        };
        assert_eq!(length, NUMBERS);
        all.extend(values);
    }
    all
}

/// Returns the mean and covariance of descriptors.
fn statistics(values: &[f32]) -> (Vec<f32>, DMatrix<f32>) {
    let matrix = DMatrix::from_column_slice(NUMBERS, values.len() / NUMBERS, values);
    let mean = matrix.column_mean();
    let mut centred = matrix;
    centred.column_iter_mut().for_each(|mut column| column -= &mean);
    let covariance = &centred * centred.transpose() / centred.ncols() as f32;
    (mean.iter().copied().collect(), covariance)
}

/// Computes the principal components, by descending variance, each signed so that its largest
/// number is positive.
fn made() -> Basis {
    let values: Vec<f32> = (1..=BACKDROPS).flat_map(descriptions).collect();
    let (mean, covariance) = statistics(&values);
    let eigen = SymmetricEigen::new(covariance);
    let mut order: Vec<usize> = (0..NUMBERS).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    let component = |k: &usize| {
        let column = eigen.eigenvectors.column(*k);
        let sign = column[column.iamax()].signum();
        column.iter().map(|v| v * sign).collect::<Vec<f32>>()
    };
    Basis { mean, components: order.iter().take(128).flat_map(component).collect() }
}

/// Returns the fraction of the variance that a basis keeps.
fn kept(basis: &Basis, covariance: &DMatrix<f32>) -> f32 {
    let components = DMatrix::from_column_slice(NUMBERS, 128, &basis.components);
    (components.transpose() * covariance * &components).trace() / covariance.trace()
}

#[test]
fn the_basis_keeps_the_variance_of_unseen_backdrops() {
    if std::env::var_os("STAGEPOSE_REMAKE").is_some() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/src/features/two_views/descriptors/gloh.basis");
        std::fs::write(file, made().to_bytes()).unwrap();
        return;
    }
    // Seeds from which the basis was not computed.
    let values: Vec<f32> = (1001..1004).flat_map(descriptions).collect();
    let (mean, covariance) = statistics(&values);
    let own = Basis::own();
    assert!(kept(&own, &covariance) > 0.93, "{}", kept(&own, &covariance));
    let off = mean.iter().zip(&own.mean).map(|(a, b)| (a - b) * (a - b)).sum::<f32>().sqrt();
    assert!(off < 0.15, "the mean is off by {off}");
    // The first components keep more of it than the same number of others could by chance.
    let first = Basis { components: own.components[..16 * NUMBERS].iter().copied().chain(vec![0.0; 112 * NUMBERS]).collect(), ..own };
    assert!(kept(&first, &covariance) > 0.35, "{}", kept(&first, &covariance));
}
