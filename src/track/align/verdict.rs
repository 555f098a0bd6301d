//! Whether an alignment may be believed: tiles that agree, residuals of the noise's size, and a pose that is where it was expected.

use nalgebra::Matrix6;

use super::evidence::RunEvidence;
use crate::geometry::{Body, Camera, Pose};
use crate::motion::{Motion, MotionEstimate};

/// What an alignment came to.
#[derive(Debug, Clone, Copy)]
pub struct Alignment {
    /// Pose and motion at the frame's stamp, and what the picture and the prior leave open of them.
    pub estimate: MotionEstimate,
    /// Where the camera was at the stamp. The motion differs from it where the velocity jumped later in the frame.
    pub pose: Pose<Body, Camera>,
    /// Covariance of [δp, δθ] of the pose (axes as in the motion's error): noise and model error.
    pub covariance: Matrix6<f64>,
    /// Robust standard deviation of the residuals, in sigmas of the expected noise.
    pub scale: f64,
    /// Pixels that fit.
    pub inliers: f64,
    /// Root mean square of residual over gradient, pixels of the frame.
    pub rms_px: f64,
    /// Tiles with detail, and those that agree.
    pub tiles: usize,
    /// See `tiles`.
    pub agreeing: usize,
    /// Squared Mahalanobis distance of the found pose from the expected one, by the covariance of what was expected; about 6 where that is right.
    pub squared_mahalanobis: f64,
}

impl Alignment {
    /// Share of the tiles with detail that agree.
    pub fn share(&self) -> f64 {
        self.agreeing as f64 / self.tiles.max(1) as f64
    }

    /// Whether the picture alone leaves no doubt.
    pub fn is_conclusive(&self) -> bool {
        self.tiles >= CONCLUSIVE_TILES && self.share() >= CONCLUSIVE_SHARE
    }

    /// Whether the pose was found so far from where it was expected that earlier frames say nothing of it.
    pub fn is_pushed(&self) -> bool {
        self.squared_mahalanobis > LARGEST_SQUARED_MAHALANOBIS
    }

    /// Whether the pose may be given: clearly right, or less clearly where it was expected.
    pub fn is_credible(&self, is_expected: bool) -> bool {
        let continues = is_expected
            && self.share() >= CONTINUED_SHARE
            && self.squared_mahalanobis < LARGEST_SQUARED_MAHALANOBIS
            && self.scale < CONTINUED_SCALE;
        self.agreeing >= LEAST_TILES && (self.share() >= NEW_SHARE || continues)
    }
}

/// Fewest agreeing tiles of a pose that is given. Chosen, not tuned. Raised, pictures seen small are lost; lowered, a few tiles that agree
/// by chance are enough.
const LEAST_TILES: usize = 8;
/// Least share of the tiles with detail that agree: of any pose, and of one that is where the motion filter expected it. Of 405 wrong poses
/// below 10 % agree, of 638 right ones three quarters above 90 % (docs/alignment.md). Raised, partly covered stages are lost;
/// `CONTINUED_SHARE` below 0.1 would let wrong poses pass.
const NEW_SHARE: f64 = 0.5;
const CONTINUED_SHARE: f64 = 0.12;
/// Largest squared Mahalanobis distance of a pose that is where it was expected: ten sigmas, as jerk is not white. Chosen, not tuned.
/// Raised, a jump into a wrong minimum passes for motion; lowered, starts and stops must prove themselves like new poses.
const LARGEST_SQUARED_MAHALANOBIS: f64 = 100.0;
/// Largest residuals of such a pose, sigmas, of what takes part. It came with `LEVELS` and `LARGEST_LAST_STEP_PX`: with all three, none of
/// every third frame of d-steep is wrong, before 12.5 % were. Raised, such poses may come back; lowered, a stage that is partly covered is
/// lost sooner.
const CONTINUED_SCALE: f64 = 2.5;
/// Tiles and their agreeing share that leave no doubt: noise is learnt from such a frame, and where all rows are exposed together it needs
/// no second one to confirm it. Chosen well above `NEW_SHARE`. Raised, bodies are found a frame later; lowered, a single wrong frame could
/// be given.
const CONCLUSIVE_TILES: usize = 40;
const CONCLUSIVE_SHARE: f64 = 0.7;

/// See [`Alignment::squared_mahalanobis`].
pub fn squared_mahalanobis(expected: &MotionEstimate, found: &Motion) -> f64 {
    let error = expected.motion.error_to(found).fixed_rows::<6>(0).into_owned();
    let covariance: Matrix6<f64> = expected.covariance.fixed_view::<6, 6>(0, 0).into_owned();
    covariance.cholesky().map_or(f64::INFINITY, |c| error.dot(&c.solve(&error)))
}

/// Whether a tile agrees with the prediction; `None` where it has too little detail to tell.
pub fn agreement(e: &RunEvidence) -> Option<bool> {
    if e.count < 12.0 {
        return None;
    }
    let n = e.count;
    let [s, p, ss, pp, sp] = e.moments.map(|m| m / n);
    let (seen, predicted, both) = (ss - s * s, pp - p * p, sp - s * p);
    let noise = e.noise / n;
    if predicted < 4.0 * noise {
        return None;
    }
    Some(both > 0.0 && both * both > 0.81 * seen * predicted)
}
