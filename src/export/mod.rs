//! Poses and stages for other programs, as bytes in their formats (contract C14); no files.
//!
//! - [`take`]: reads the records of contract C3 as the runs of poses in them
//! - [`rate`], [`shot`]: frame rate, time codes, and where a pose is missing
//! - [`film`]: the lens in the terms of film cameras; [`axes`]: other programs' axes
//! - [`scenery`]: surfaces as they hang, as meshes with texture coordinates
//! - [`identifiers`]: names that every format accepts
//! - one module per format: [`usd`], [`chan`], [`blender`], [`after_effects`], [`gltf`], [`mcap`],
//!   [`obj`]
//!
//! All formats hold an undistorted pinhole. USD and MCAP also hold the distortion, as numbers.
//! `docs/export.md` says what each format can and cannot express.

pub mod after_effects;
pub mod axes;
pub mod blender;
pub mod chan;
pub mod film;
pub mod gltf;
mod identifiers;
pub mod mcap;
pub mod obj;
pub mod rate;
pub mod scenery;
pub mod shot;
#[cfg(test)]
mod synthetic;
pub mod take;
pub mod usd;
