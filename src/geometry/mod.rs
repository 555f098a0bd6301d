//! Pure geometry: rigid transforms between named frames, and solvers that turn point
//! correspondences into homographies, fundamental and essential matrices, and poses.
//!
//! Nothing here uses threads, files or clocks. Every solver is a function of its arguments;
//! randomised ones take a seed. Frames are types: a [`Pose<Stage, Camera>`](Pose) maps camera
//! coordinates to stage coordinates and can only be multiplied with a pose that maps to the camera.
//! docs/solvers.md lists the solvers with sources and run times.

pub mod bspline;
pub mod catmull_rom;
pub mod correspondence;
pub mod covariance;
mod direct_linear;
pub mod distances;
pub mod essential;
pub mod essential_decomposition;
pub mod five_point;
mod four_point;
pub mod homography;
pub mod least_squares;
pub mod local_affinities;
pub mod motion_refinement;
pub mod noise;
mod normalisation;
pub mod planar_pose;
pub mod pose;
pub mod ransac;
pub mod relative_pose;
pub mod resection;
pub mod robust;
pub mod robust_homography;
pub mod robust_kernel;
mod scoring;
#[cfg(test)]
mod test_planes;
#[cfg(test)]
mod test_views;
#[cfg(feature = "cli")]
pub mod three_point;
mod transfer_refinement;
pub mod triangulation;
#[cfg(feature = "two-views")]
pub mod two_views;

pub use homography::{Homography, PointPair};
pub use pose::{Body, Camera, FilmingCamera, Pose, ReferenceCamera, Stage, SurfaceFrame, skew};
