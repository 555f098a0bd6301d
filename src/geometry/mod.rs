//! Pure geometry: rigid transforms between named frames, and the solvers that turn point
//! correspondences into homographies, fundamental and essential matrices and poses.
//!
//! Nothing here knows threads, files or clocks. Every solver is a function of its arguments; the
//! random ones take their seed. Frames are types: a [`Pose<Stage, Camera>`](Pose) maps camera
//! coordinates into stage coordinates and cannot be multiplied with anything that does not start
//! in the camera. docs/solvers.md has a table of the solvers, with their sources and times.

pub mod bspline;
pub mod correspondence;
pub mod covariance;
mod direct_linear;
pub mod distances;
pub mod eight_point;
pub mod epipolar;
pub mod essential;
pub mod essential_decomposition;
pub mod false_alarms;
pub mod five_point;
mod four_point;
pub mod frame_chain;
pub mod fundamental_refinement;
pub mod gold_standard;
pub mod homography;
pub mod homography_decomposition;
pub mod least_squares;
pub mod local_affinities;
pub mod marginal_homography;
mod marginal_noise;
pub mod model_choice;
pub mod motion_refinement;
pub mod noise;
mod normalisation;
pub mod planar_pose;
mod pose;
pub mod ransac;
pub mod relative_pose;
pub mod resection;
pub mod robust;
pub mod robust_essential;
pub mod robust_fundamental;
pub mod robust_homography;
pub mod robust_kernel;
mod sampson_refinement;
mod scoring;
pub mod seven_point;
mod shared_errors;
#[cfg(test)]
mod test_planes;
#[cfg(test)]
mod test_views;
mod transfer_refinement;
pub mod triangulation;

pub use homography::{Homography, PointPair};
pub use pose::{Body, Camera, FilmingCamera, Pose, ReferenceCamera, Stage, SurfaceFrame, quaternion, skew};
