//! Pure geometry: rigid transforms between named frames, and the solvers that turn point
//! correspondences into homographies, essential matrices and poses.
//!
//! Nothing here knows threads, files or clocks. Every solver is a function of its arguments; the
//! random ones take their seed. Frames are types: a [`Pose<Stage, Camera>`](Pose) maps camera
//! coordinates into stage coordinates and cannot be multiplied with anything that does not start
//! in the camera.

pub mod covariance;
pub mod essential;
pub mod homography;
pub mod least_squares;
pub mod planar_pose;
mod pose;
pub mod ransac;
pub mod relative_pose;
pub mod resection;
pub mod robust;
pub mod robust_kernel;
pub mod triangulation;

pub use homography::{Homography, PointPair};
pub use pose::{Body, Camera, FilmingCamera, Pose, ReferenceCamera, Stage, SurfaceFrame, quaternion, skew};
