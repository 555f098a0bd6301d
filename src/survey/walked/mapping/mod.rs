//! Maps a set without pictures from a walk around it (C13).
//!
//! The walk's own tracker follows a configured surface, the poster, which gives the keyframes a
//! start and the map its frame and scale. `tracks` recognises corners of the set in several
//! keyframes, `bundle` adjusts their places jointly with the cameras, `flat_parts` finds the planes
//! that they lie on, `outlines` finds how far each plane really reaches, and `texture` paints it
//! from the keyframes. From there on the set is a stage with pictures, and the survey's adjustment
//! refines it on grey values (`rounds`). `anchoring` moves the result into the poster's frame.
//! `map` runs all of this; `judgement` says what the map is worth.

mod anchoring;
pub mod bundle;
pub mod error;
mod facets;
mod flat_parts;
mod frame_and_scale;
mod growth;
mod hold_out;
mod job;
pub mod judgement;
mod locator;
pub mod map;
mod mapped_facet;
mod measuring;
mod missing;
mod outlines;
mod picture_fault;
mod posed_walk;
mod rolling_readout;
mod rounds;
mod seed;
mod set_points;
mod stage_of_facets;
mod texture;
mod tracks;
mod views;
