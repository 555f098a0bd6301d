//! `Tracker` and `Daemon` on frames of the virtual stage, compared with its exact ground truth.

mod acquisition;
mod any_frame;
mod bent;
mod copies;
mod daemon;
mod fixed;
mod misfit;
mod mixtures;
mod objects;
mod one_picture;
mod photo;
mod poses;
mod poster;
mod record_line;
pub mod scene;
mod shutter;
mod states;
mod stops;
mod two_view;
mod uncertainty;
